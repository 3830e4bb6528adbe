"""Twelve whole pipelines as subjects of the benchmark: what users wait for, on the host's clock.

Each is verified at a small size by the same code: against the float64 truth, the NumPy device, or
frames that are made one by one.
"""

import inspect
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, cycle
from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.bench import frames
from gpusim.bench.frames import (
    EQUAL_WHY,
    MEAN,
    MEAN_WHY,
    MOVED,
    MOVED_WHY,
    SECONDS,
    check_camera,
    check_mean,
    check_rms,
    check_same,
    check_truth,
    find_difference,
    make_cubes,
    make_deep,
    make_materials,
    make_surfaces,
    on_device,
    open_coma_phone,
    open_l3_phone,
    open_near_phone,
    open_phone,
    to_host,
)
from gpusim.bench.subject import Check, Work, digest_sources, digest_values
from gpusim.captures.burst import Burst, burst
from gpusim.captures.merge import merge_burst
from gpusim.domain.camera import Camera
from gpusim.domain.motion import Motion
from gpusim.kernels.common import fft
from gpusim.kernels.stage import dtype_name, public_function
from gpusim.optics.lengths import transform_lengths
from gpusim.pipeline.simulator import Simulator

SMALL = 96, 64  # columns and rows at which pipelines are verified
TINY = 48, 32  # the same if the reference is slow
VIDEO = 4e-4  # relative RMS error that a video frame may have
PREVIEW = 1e-2  # the same of a preview's
ITEMS = 4  # of a batch, and frames of a burst
PLANES = 4  # of the transforms
FIELD_BANDS = 7
HAND, FPS = Motion(shake=3.0, seed=1), 30
KEPT_BYTES = 160  # of a pixel in a loop: about forty planes of float32
DEMOSAICKERS = ("bilinear", "malvar", "adaptive", "best", "learned")


@dataclass(frozen=True)
class Pipeline:
    """A whole pipeline.

    Attributes:
        name: Its name.
        begin: Function of a device and a size (columns, rows) that returns the work.
        check: Function of a device that yields checks at the size SMALL.
    """

    name: str
    begin: Callable[[Device, tuple[int, int]], Work]
    check: Callable[[Device], Iterator[Check]]
    kind = "pipeline"
    family = "pipelines"

    def start(self, device: Device, size: tuple[int, int]) -> Work:
        """Return the work for a frame. device: the device. size: columns and rows."""
        return self.begin(device, size)

    def digest(self) -> str:
        """Return the SHA-256 of all kernels' sources, and of the modules that have the inputs."""
        modules = sys.modules[__name__], frames
        return digest_values(self.name, digest_sources(), *map(inspect.getsource, modules))


def _work(run, scenes, size, out_bytes=3) -> Work:
    """Return the work of a frame. out_bytes: bytes of the output for a pixel."""
    kept = sum(_samples(scene) for scene in scenes) + KEPT_BYTES * size[0] * size[1]
    moved = _samples(scenes[0]) + out_bytes * size[0] * size[1]
    return Work(run, moved, None, kept, is_wall=True)


def _samples(scene) -> int:
    """Return the bytes of a scene's samples."""
    arrays = [getattr(scene.content, name) for name in scene.content.samples]
    # Warp's arrays have no size in bytes
    return sum(prod(array.shape) * np.dtype(dtype_name(array)).itemsize for array in arrays)


def _begin_loop(camera, scenes, tolerance, device, size) -> Work:
    """Return the work of a loop over scenes of the device, to display codes."""
    given = [on_device(device, scene) for scene in scenes(size)]
    loop = Simulator(camera(), device=device, tolerance=tolerance).loop(given[0], SECONDS)
    following, numbers = cycle(given[::-1]), count()

    def run():
        return loop.update(scene=next(following)).codes(seed=1, first=next(numbers))

    return _work(run, given, size)


def _check_still(device):
    first, second = make_cubes(SMALL)
    simulator = Simulator(open_phone(), device=device)
    loop = simulator.loop(first, SECONDS)
    loop.codes(seed=1)
    found = to_host(device, loop.update(scene=second).codes(seed=1, first=1))
    yield from check_camera(device, open_phone(), second)
    yield check_same(device, found, simulator.loop(second, SECONDS).codes(seed=1, first=1))


def _begin_video(device, size):
    given = make_materials(size)
    simulator = Simulator(open_phone(), device=device, tolerance=VIDEO)
    pictures = simulator.stream(cycle(given), "codes", seed=1, exposure_time=SECONDS)
    return _work(partial(next, pictures), given, size)


def _check_video(device):
    scene = make_surfaces(SMALL)
    yield from check_truth(device, scene, VIDEO)
    simulator = Simulator(open_phone(), device=device, tolerance=VIDEO)
    plan = simulator.plan(scene, exposure_time=SECONDS)
    asked = {"seed": 1, "exposure_time": SECONDS, "plan": plan}
    found = [to_host(device, codes) for codes in simulator.stream([scene] * 2, "codes", **asked)]
    wanted = simulator.loop(scene, SECONDS, plan=plan).codes(seed=1, first=1)
    yield check_same(device, found[1], wanted)


def _shake(scene, number):
    """Return a scene as a shaking camera sees it in a frame of a video."""
    return scene.viewed(HAND.at(number / FPS))


def _begin_shaking(device, size):
    scene = on_device(device, make_surfaces(size))
    loop = Simulator(open_phone(), device=device, tolerance=VIDEO).loop(scene, SECONDS)
    numbers = count()

    def run():
        number = next(numbers)
        return loop.update(scene=_shake(scene, number)).codes(seed=1, first=number)

    return _work(run, [scene], size)


def _check_shaking(device):
    """The exact frame against NumPy's, and one within a tolerance against it."""
    scene = _shake(make_surfaces(SMALL), 5)
    exact = _expose(open_phone(), scene, "numpy")
    yield check_mean(_expose(open_phone(), scene, device), exact, MOVED, MOVED_WHY)
    yield check_rms(_expose(open_phone(), scene, device, VIDEO), exact, VIDEO)


def _begin_noise(device, size):
    exposure = Simulator(open_phone(), device=device).expose(make_surfaces(size), SECONDS)
    numbers, pixels = count(), size[0] * size[1]
    # four bytes of mean electrons, two of the result
    return Work(
        lambda: exposure.raw(seed=1, first=next(numbers)), 6 * pixels, None, 8 * pixels, True
    )


def _check_noise(device):
    means = np.linspace(0.0, 7000.0, SMALL[0] * SMALL[1], dtype=np.float32)
    drawn = [
        Simulator(open_phone(), device=where).readout.draw_electrons(
            means.reshape(SMALL[::-1]), SECONDS, seed=1, first=2
        )
        for where in (device, "numpy")
    ]
    yield Check("digital numbers against NumPy", find_difference(*drawn), 0.0, EQUAL_WHY)


def _turn_aperture(number: int) -> Camera:
    """Return the camera of a frame while a slider moves: the f-number goes from 2 to 2.9."""
    return open_phone(f_number=2.0 + 0.1 * (number % 10))


def _begin_preview(device, size):
    scene = on_device(device, make_surfaces(size))
    loop = Simulator(_turn_aperture(0), device=device, tolerance=PREVIEW).loop(scene, SECONDS)
    numbers = count()

    def run():
        number = next(numbers)
        return loop.update(camera=_turn_aperture(number), drafts=True).codes(seed=1, first=number)

    return _work(run, [scene], size)


def _check_preview(device):
    """A draft of the exact frame against NumPy's, and a draft within a tolerance against it."""

    def make(where, tolerance=None):
        simulator = Simulator(_turn_aperture(0), device=where, tolerance=tolerance)
        loop = simulator.loop(make_surfaces(SMALL), SECONDS)
        loop.codes(seed=1)
        draft = loop.update(camera=_turn_aperture(3), drafts=True)
        return to_host(simulator.device, draft.output("mean"))

    exact = make("numpy")
    yield check_mean(make(device), exact, MEAN, MEAN_WHY)
    yield check_rms(make(device, PREVIEW), exact, PREVIEW)


def _begin_batch(device, size):
    given = [on_device(device, scene) for scene in make_materials(size)]
    batch = Simulator(open_phone(), device=device, tolerance=VIDEO).batch(ITEMS, "codes")
    numbers, pairs = count(0, ITEMS), cycle([given, given[::-1]])

    def run():
        scenes = next(pairs) * (ITEMS // 2)
        return batch(scenes, exposure_time=SECONDS, seed=1, first=next(numbers))

    work = _work(run, given, size)
    return replace(work, moved=ITEMS * work.moved, nbytes=ITEMS * work.nbytes)


def _check_batch(device):
    scenes = make_materials(SMALL)
    yield from check_camera(device, open_phone(), scenes[1])
    simulator = Simulator(open_phone(), device=device)
    batch = simulator.batch(ITEMS, "codes")
    batch(scenes[::-1] * 2, exposure_time=SECONDS)
    found = batch(scenes * 2, exposure_time=SECONDS, seed=1)
    yield check_same(device, found[3], simulator.loop(scenes[1], SECONDS).codes(seed=1, first=3))


def _few_bands(size):
    """Return two scenes of FIELD_BANDS bands each: every band costs a second on two cores."""
    return make_cubes(size, FIELD_BANDS)


def _check_depth(device):
    scene = make_deep(TINY)[0]
    found, exact = (
        _expose(open_near_phone(), scene, device, VIDEO),
        _expose(open_near_phone(), scene, "numpy"),
    )
    yield check_rms(found, exact, VIDEO)


def _expose(camera, scene, device, tolerance=None):
    """Return the mean electrons of a scene, NumPy."""
    simulator = Simulator(camera, device=device, tolerance=tolerance)
    return to_host(simulator.device, simulator.expose(scene, SECONDS).mean)


def _check_field(device):
    found, exact = (
        _expose(open_coma_phone(), make_surfaces(SMALL), where) for where in (device, "numpy")
    )
    yield check_mean(found, exact, MEAN, f"{MEAN_WHY}; tiles add their own blurs, as exact")


def _begin_demosaickers(device, size):
    raw = _mosaic(size)
    there, options = device.array(raw, np.uint16), _demosaic_options()
    methods = [public_function(f"processor.{name}") for name in DEMOSAICKERS]

    def run():
        return [method(there, **options, device=device) for method in methods]

    # each reads two bytes of a pixel and writes three planes
    pixels = size[0] * size[1]
    return Work(run, len(methods) * (2 + 12) * pixels, None, 14 * pixels, True)


def _mosaic(size):
    """Return digital numbers of random surfaces seen by a phone."""
    simulator = Simulator(open_phone(), device="numpy", tolerance=PREVIEW)
    scene = make_surfaces(SMALL)
    raw = np.asarray(simulator.expose(scene, SECONDS).raw(seed=1))
    repeats = [-(-wanted // has) for wanted, has in zip(size[::-1], raw.shape, strict=True)]
    return np.ascontiguousarray(np.tile(raw, repeats)[: size[1], : size[0]])


def _demosaic_options():
    return {"phase": "RGGB", "black_level": 64.0, "scale": 1 / 959}


def _check_demosaickers(device):
    raw = _mosaic(SMALL)
    for name in DEMOSAICKERS:
        method = public_function(f"processor.{name}")
        found, wanted = (
            np.asarray(method(raw, **_demosaic_options(), device=where))
            for where in (device, "numpy")
        )
        error = find_difference(found, wanted) / max(1.0, float(np.abs(wanted).max()))
        # tests/frames/test_developer.py
        why = "float32 roundings times conditions of 20 at most"
        yield Check(f"{name} against NumPy", error, 4e-5, why)


def _begin_burst(device, size):
    scene = on_device(device, make_surfaces(size))
    capture = Burst(ITEMS, merged=True)
    loop = Simulator(open_phone(), device=device, tolerance=VIDEO).loop(
        scene, SECONDS, capture=capture
    )
    numbers = count(0, ITEMS)
    return _work(lambda: loop.output("codes", seed=1, first=next(numbers)), [scene], size)


def _check_burst(device):
    shots = burst(Simulator(open_phone(), device=device), make_surfaces(SMALL), ITEMS, seed=1)
    found, wanted = (
        np.asarray(merge_burst(Simulator(open_phone(), device=where), shots).mean)
        for where in (device, "numpy")
    )
    # the tolerance of processor.average, whose shifts have that of processor.align
    yield check_mean(found, wanted, 3e-4, "shifts agree to 2e-4 pixel, as processor.average's")


def _begin_l3(device, size):
    exposure = Simulator(open_l3_phone(), device=device, tolerance=VIDEO).expose(
        make_surfaces(size), SECONDS
    )
    numbers, pixels = count(), size[0] * size[1]
    # four bytes of mean electrons, three of the picture
    return Work(
        lambda: exposure.codes(seed=1, first=next(numbers)), 7 * pixels, None, 8 * pixels, True
    )


def _begin_transforms(device, size):
    planes = device.array(np.random.default_rng(1).random((PLANES, *size[::-1]), np.float32))
    period, _ = transform_lengths(size[::-1], (1, 1))

    def run():
        spectra = fft.forward_extended(device, planes, 0, PLANES, "edge", period)
        return fft.inverse(device, spectra, period[1])

    moved = 4 * PLANES * (size[0] * size[1] + period[0] * period[1])
    operations = int(2 * PLANES * fft.operations(period))
    return Work(run, moved, operations, moved, is_wall=True)


def _check_transforms(device):
    """There and back, and the spectra by themselves against float64."""
    period, _ = transform_lengths(SMALL[::-1], (1, 1))
    planes = np.random.default_rng(1).random((PLANES, *period), np.float32)
    there = device.array(planes)
    spectra = fft.forward_extended(device, there, 0, PLANES, "edge", period)
    found = to_host(device, spectra)[:, :, : period[1] // 2 + 1]
    wanted = np.fft.rfft2(planes.astype(np.float64))
    rms = np.sqrt(np.mean(np.abs(wanted) ** 2))
    error = np.sqrt(np.mean(np.abs(found[..., 0] + 1j * found[..., 1] - wanted) ** 2)) / rms
    # Van Loan, 1.3: relative rms errors of a transform grow with log2 N roundings of 2^-24, times
    # less than 5 for the complex multiplications and the roots
    tolerance = 5 * 2.0**-24 * float(np.log2(np.prod(period)))
    why = "5 log2 N roundings of 2^-24"
    yield Check("spectra against float64", float(error), tolerance, why)
    back = to_host(device, fft.inverse(device, spectra, period[1]))
    error = np.sqrt(np.mean((back - planes) ** 2) / np.mean(planes**2))
    yield Check("there and back", float(error), 2 * tolerance, f"twice {why}")


def list_pipelines() -> list[Pipeline]:
    """Return the twelve pipelines."""
    return [
        Pipeline("still", partial(_begin_loop, open_phone, make_cubes, None), _check_still),
        Pipeline("video", _begin_video, _check_video),
        Pipeline("hand-held", _begin_shaking, _check_shaking),
        Pipeline("noise only", _begin_noise, _check_noise),
        Pipeline("preview slider", _begin_preview, _check_preview),
        Pipeline("batch", _begin_batch, _check_batch),
        Pipeline(
            "depth",
            partial(_begin_loop, open_near_phone, make_deep, VIDEO),
            _check_depth,
        ),
        Pipeline("field", partial(_begin_loop, open_coma_phone, _few_bands, None), _check_field),
        Pipeline("demosaickers", _begin_demosaickers, _check_demosaickers),
        Pipeline("burst", _begin_burst, _check_burst),
        Pipeline(
            "L3",
            _begin_l3,
            lambda device: check_camera(device, open_l3_phone(), make_surfaces(SMALL)),
        ),
        Pipeline("transforms", _begin_transforms, _check_transforms),
    ]
