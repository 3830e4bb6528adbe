"""Frame after frame of new scenes, nothing is read from the device but what is declared, and nothing is stale."""

import sys
from dataclasses import replace
from functools import cache

import cameras
import numpy as np
import pytest
from devices import KINDS

import gpusim as gs
from gpusim.domain.content import Basis, Cube
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.mosaics import MOSAICS
from gpusim.domain.psf import PointSpread
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.spectrum import Spectrum
from gpusim.kernels.processor.color import color
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.loop import Loop

SIZE, FRAMES = (64, 48), 5


PHONE = cameras.camera_with(processor={"demosaic": "bilinear"})


def camera_with(base=PHONE, **parts):
    return cameras.camera_with(base, **parts)


def clear_pixels():
    """Red, green, blue and clear pixels."""
    qe = PHONE.sensor.qe
    values = np.concatenate([qe.values, np.full((1, qe.values.shape[1]), 0.6)])
    return camera_with(
        sensor={
            "qe": Spectrum(qe.wavelengths, values),
            "channels": ("R", "G", "B", "W"),
            "cfa": MOSAICS["rgbw"],
        }
    )


def measured():
    """A lens of measured spreads, wider to the right."""
    line = np.exp(-(np.linspace(-2, 2, 15) ** 2))
    spread = np.outer(line, line * (1 + 0.4 * np.linspace(-1, 1, 15)))
    optics = {
        "model": "measured",
        "psf": PointSpread(np.array([400.0, 700.0]), np.stack([spread] * 2), 2e-7),
    }
    return camera_with(optics=optics)


FOCUSED = camera_with(
    gs.open_camera("mono"),
    sensor={"pixel_pitch": 2e-6},
    optics={"f_number": 2.0, "focal_length": 5e-3, "object_distance": 0.4},
)
FIXED = {"sensor": {"exposure_time": 0.01}}
FEATURES = {  # name -> camera, kind of scene, options of the Simulator
    **{f"camera {name}": (gs.open_camera(name), "materials", {}) for name in cameras.FIRST},
    **{
        f"exposed by {method}": (
            camera_with(sensor={"auto_exposure": gs.AutoExposure(method)}),
            "materials",
            {},
        )
        for method in ("percentile", "mean", "centre")
    },
    **{
        f"white by {method}": (camera_with(processor={"white_balance": method}), "materials", {})
        for method in ("gray-world", "red-blue", "bayesian")
    },
    **{
        f"binned, {mode}": (
            camera_with(
                sensor={"binning": (2, 2), "binning_mode": mode}, **{"processor": {"denoise": 0.5}}
            ),
            "materials",
            {},
        )
        for mode in ("digital", "charge")
    },
    **{
        f"demosaicked by {name}": (
            camera_with(**FIXED, processor={"demosaic": name}),
            "materials",
            {},
        )
        for name in ("bilinear", "malvar", "adaptive", "best", "learned", "network")
    },
    "no converter": (
        camera_with(sensor={"bits": FLOAT_BITS}, processor={"demosaic": "malvar"}),
        "materials",
        {},
    ),
    "known defects": (
        camera_with(noise={"dead_pixels": 0.01}, processor={"defects": "known"}),
        "materials",
        {},
    ),
    "hot pixels": (
        camera_with(noise={"hot_pixels": 0.02, "hot_current": 2e3}, processor={"defects": "known"}),
        "materials",
        {},
    ),
    "found defects": (
        camera_with(**FIXED, noise={"dead_pixels": 0.01}, processor={"defects": "detect"}),
        "cube",
        {},
    ),
    "denoised and shaded": (
        camera_with(processor={"denoise": 1.0, "shading": True}),
        "materials",
        {},
    ),
    "stacked": (
        camera_with(
            noise={"dead_pixels": 0.01},
            sensor={"stacked": True},
            processor={"defects": "known", "shading": True, "denoise": 1.0, "look": "phone"},
        ),
        "materials",
        {},
    ),
    "stacked, no converter": (
        camera_with(**{"sensor": {"stacked": True, "bits": FLOAT_BITS}}),
        "cube",
        {},
    ),
    "quad": (camera_with(sensor={"cfa": MOSAICS["quad-bayer"]}), "materials", {}),
    "clear pixels": (clear_pixels(), "materials", {}),
    "noise of every kind": (
        camera_with(
            noise={
                "telegraph_pixels": 0.1,
                "telegraph": 50.0,
                "telegraph_switching": 0.5,
                "row": 2.0,
                "column": 3.0,
                "prnu": 0.01,
                "dsnu": 2.0,
                "reset": 3.0,
                "dark_current": 10.0,
                "adc": 0.5,
            }
        ),
        "materials",
        {},
    ),
    "distorted": (
        camera_with(optics={"distortion": RadialPolynomial(-0.12, 0.02, 1e-4)}),
        "materials",
        {},
    ),
    "lateral colour": (camera_with(**FIXED, optics={"lateral_color": 0.002}), "bands", {}),
    "measured": (measured(), "cube", {}),
    "no blur": (camera_with(optics={"model": "none"}), "cube", {}),
    "no blur, surroundings": (camera_with(optics={"model": "none"}), "surrounded", {}),
    "depth": (FOCUSED, "depth", {"tolerance": 1e-3}),
    "highlights": (PHONE, "points", {}),
    "highlights between pixels": (PHONE, "fine points", {}),
    "fine": (PHONE, "fine", {}),
    "cube, fused": (camera_with(**FIXED), "cube", {"tolerance": 4e-4}),
    "basis, fused": (camera_with(**FIXED), "basis", {"tolerance": 4e-4}),
    "picture": (camera_with(**FIXED), "picture", {"tolerance": 4e-4}),
    "picture, surroundings": (PHONE, "surrounded picture", {}),
    "materials, fused": (camera_with(**FIXED), "materials", {"tolerance": 4e-4}),
    "surroundings, fused": (PHONE, "surrounded", {"tolerance": 4e-4}),
    "surroundings": (PHONE, "surrounded", {}),
}


@cache
def first_scene(kind):
    """A scene of the kind."""
    if kind in ("points", "fine points"):
        return gs.chart(
            "points", size=SIZE, count=3, highest=1e5, samples_per_pixel=2 if "fine" in kind else 1
        )
    if "picture" in kind:
        codes = np.random.default_rng(1).integers(60, 220, (SIZE[1], SIZE[0], 3), np.uint8)
        return gs.picture(
            codes, **({"border": "scene", "margin": 6} if "surrounded" in kind else {})
        )
    scene = gs.chart(
        "deadleaves",
        size=SIZE,
        samples_per_pixel=2 if kind == "fine" else 1,
        wavelengths=np.linspace(420, 680, 3) if kind in ("bands", "depth") else None,
    )
    if kind in ("materials", "fine"):
        return scene
    bands = np.ascontiguousarray(scene.content.bands_at(slice(None)), np.float32)
    if kind == "basis":
        basis = np.linalg.svd(bands.reshape(len(bands), -1).T.astype(float), full_matrices=False)[
            2
        ][:4]
        return replace(
            scene,
            content=Basis(
                scene.wavelengths, np.tensordot(basis, bands, 1).astype(np.float32), basis
            ),
        )
    scene = replace(scene, content=Cube(scene.wavelengths, bands))
    if kind == "surrounded":
        return replace(scene, border="scene", margin=6)
    if kind == "depth":
        return replace(
            scene, depth=np.full(scene.samples, 0.4) + 0.3 * (np.indices(scene.samples)[1] > 30)
        )
    return scene


def scenes_of(kind, device):
    """Scenes of one kind, a little brighter each, whose samples are on the device where that is usual."""
    scene = first_scene(kind)
    if "picture" in kind:
        codes = [scene.content.codes + np.uint8(number) for number in range(FRAMES)]
        return [
            replace(scene, content=replace(scene.content, codes=device.array(one, np.uint8)))
            for one in codes
        ]
    made = [
        replace(
            scene,
            content=scene.content.with_planes(scene.content.planes * np.float32(1 + 0.02 * number)),
        )
        for number in range(FRAMES)
    ]
    if kind in ("depth", "points", "fine points"):
        return made

    def there(array):
        return device.array(array, np.uint16 if array.dtype.kind in "iu" else np.float32)

    return [replace(one, content=one.content.with_samples(there)) for one in made]


# of a loop's own work between its steps
PLANNING = {"facts", "probes", "plan"}


def may_read(loop):
    """Names of the values in whose making the host may read the device."""
    return PLANNING | {name for name, step in loop.values.steps.items() if step.host}


class Reads:
    """The steps in which a device is read, whoever reads it."""

    def __init__(self, device, monkeypatch):
        self.steps, inner = set(), device._numpy

        def read(array):
            if not device._clock.host_work:
                self.steps |= self._steps(sys._getframe())
            return inner(array)

        monkeypatch.setattr(device, "_numpy", read)

    @staticmethod
    def _steps(frame):
        while frame is not None:
            if frame.f_code is Cache.run.__code__:
                return {frame.f_locals["name"]}
            if frame.f_code is Loop.judge.__code__:
                return set()  # numbers of the frame before
            frame = frame.f_back
        return {"between the steps"}


@pytest.mark.parametrize("name", FEATURES)
@pytest.mark.parametrize("device", KINDS)
def test_nothing_is_read_and_nothing_is_stale(device, name, monkeypatch):
    camera, kind, options = FEATURES[name]
    device = gs.open_device(device)
    simulator = gs.Simulator(camera, device=device, **options)
    scenes = scenes_of(kind, device)
    loop = simulator.loop(scenes[0])
    for number, scene in enumerate(scenes):
        if number == 3:
            reads = Reads(device, monkeypatch)
        loop.update(scene=scene)
        raw, codes = loop.raw(seed=1, first=number), loop.codes(seed=1, first=number)
    assert reads.steps <= may_read(loop)
    assert loop.values.unexpected_host_accesses() == []
    fresh = gs.Simulator(camera, device=device, **options).loop(scenes[0])
    assert fresh.plan.scene is scenes[0]
    fresh.update(scene=scenes[-1])
    for ours, its in (
        (raw, fresh.raw(seed=1, first=FRAMES - 1)),
        (codes, fresh.codes(seed=1, first=FRAMES - 1)),
    ):
        np.testing.assert_array_equal(np.array(device.numpy(ours)), np.array(device.numpy(its)))


CHANGING = (
    "hot pixels",
    "no converter",
    "stacked",
    "binned, digital",
    "demosaicked by best",
    "denoised and shaded",
    "white by gray-world",
    "noise of every kind",
)


@pytest.mark.parametrize("name", CHANGING)
@pytest.mark.parametrize("device", KINDS)
def test_nothing_is_stale_at_another_exposure_of_every_frame(device, name):
    """What depends on exposure time and gain alone, and on no array, is made anew with them."""
    camera, kind, options = FEATURES[name]
    device = gs.open_device(device)
    scene = scenes_of(kind, device)[0]
    loop = gs.Simulator(camera, device=device, **options).loop(scene)
    for number, seconds in enumerate((1e-3, 2e-3, 4e-3, 8e-3, 0.1)):
        found = loop.update(exposure_time=seconds, gain=1 + 0.1 * number).codes(
            seed=1, first=number
        )
    fresh = (
        gs.Simulator(camera, device=device, **options).loop(scene, 0.1, 1.4).codes(seed=1, first=4)
    )
    np.testing.assert_array_equal(np.array(device.numpy(found)), np.array(device.numpy(fresh)))


@pytest.mark.parametrize("device", KINDS)
def test_a_stream_does_not_wait_for_its_metering(device, monkeypatch):
    device = gs.open_device(device)
    simulator = gs.Simulator(PHONE, device=device, tolerance=4e-4)
    for number, _ in enumerate(simulator.stream(scenes_of("materials", device))):
        if number == 2:
            reads = Reads(device, monkeypatch)
    assert reads.steps <= {"probes"}


@pytest.mark.parametrize("device", KINDS)
def test_a_step_that_reads_is_found(device, monkeypatch):
    """The test above can fail: colours that go through the host are seen by the tape and by the watch of reads."""
    device = gs.open_device(device)

    def through_the_host(*arguments, **options):
        return device.array(np.array(device.numpy(color(*arguments, **options))))

    monkeypatch.setattr("gpusim.pipeline.finishing.color", through_the_host)
    loop = gs.Simulator(camera_with(**FIXED, processor={"denoise": 1.0}), device=device).loop(
        scenes_of("cube", device)[0]
    )
    reads = Reads(device, monkeypatch)
    for number, scene in enumerate(scenes_of("cube", device)):
        loop.update(scene=scene).codes(seed=1, first=number)
    assert "linear" in reads.steps - may_read(loop)
    assert loop.values.unexpected_host_accesses() == [("linear", "between the stages")]
