"""Scenes and cameras of the pipelines, and the checks of their frames."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.bench.subject import Check
from gpusim.data.charts import chart
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene
from gpusim.io.camera.cameras import open_camera
from gpusim.judge.truth import true_error
from gpusim.pipeline.simulator import Simulator

SECONDS = 0.01  # exposure time
GAINS = np.float32(1.0), np.float32(1.01)  # of the light of two scenes that are used in turn
# tests/frames/test_simulate.py: 2.4e-6 of the peak for the blur and 1e-6 for its tables
MEAN, MEAN_WHY = 3.4e-6, "2.4e-6 of the peak by the blur, 1e-6 by its tables; the rest is smaller"
# kernels/optics/sample.py, of four taps
MOVED, MOVED_WHY = MEAN + 7.2e-6, f"{MEAN_WHY}; 7.2e-6 by the four taps that move samples"
EQUAL_WHY = "from mean electrons to digital numbers, all devices give the same bits"
CODE_WHY = "float32 may round to either neighbour of a code"
SAME_WHY = "a frame depends only on its scene, settings, seed and number"


@lru_cache(maxsize=1)
def make_surfaces(size: tuple[int, int], bands: int = 31) -> Scene:
    """Return random surfaces in daylight, of some columns and rows. bands: from 400 to 700 nm."""
    return chart("deadleaves", size=size, wavelengths=np.linspace(400.0, 700.0, bands))


def make_cubes(size: tuple[int, int], bands: int = 31) -> list[Scene]:
    """Return two scenes of all bands, of which one is 1 % brighter."""
    scene = make_surfaces(size, bands)
    values = np.float32(scene.content.bands_at(slice(None)))
    return [
        replace(scene, content=Cube(scene.wavelengths, np.multiply(values, gain))) for gain in GAINS
    ]


def make_materials(size: tuple[int, int]) -> list[Scene]:
    """Return two scenes of materials and shading, of which one is 1 % brighter."""
    scene = make_surfaces(size)

    def brighten(array, gain):
        return array if array.dtype.kind in "iu" else array * gain

    contents = [scene.content.with_samples(partial(brighten, gain=gain)) for gain in GAINS]
    return [replace(scene, content=content) for content in contents]


def on_device(device: Device, scene: Scene) -> Scene:
    """Return a scene with its samples on the device."""

    def move(array):
        return device.array(array, np.uint16 if array.dtype.kind in "iu" else np.float32)

    return replace(scene, content=scene.content.with_samples(move))


def open_phone(**changes: Any) -> Camera:
    """Return a phone. changes: keys of camera files."""
    return open_camera("phone").with_(**changes)


def open_coma_phone() -> Camera:
    """Return a phone whose lens has coma: its blur varies over the field."""
    return open_phone(seidel_waves=(0.0, 0.4, 0.0, 0.0, 0.0))


def open_near_phone() -> Camera:
    """Return a phone that is focused at 1 m."""
    return open_phone(object_distance_m=1.0)


def open_l3_phone() -> Camera:
    """Return a phone whose processor has learned filters."""
    return open_phone(demosaic="learned", scaling="normalised")


def make_deep(size: tuple[int, int]) -> list[Scene]:
    """Return the two scenes of materials on a ramp from 4 m to 0.5 m."""
    cols, rows = size
    depth = np.linspace(4.0, 0.5, rows, dtype=np.float32)[:, None].repeat(cols, axis=1)
    return [replace(scene, depth=depth) for scene in make_materials(size)]


def to_host(device: Device, array: Any) -> np.ndarray:
    """Return a copy of an array that the next frame does not overwrite."""
    return np.array(device.numpy(array))


def find_difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest difference of two arrays; infinite if the shapes differ."""
    if found.shape != wanted.shape:
        return float("inf")
    largest = np.abs(np.asarray(found, np.float64) - np.asarray(wanted, np.float64)).max()
    return float("inf") if np.isnan(largest) else float(largest)


def check_camera(device: Device, camera: Camera, scene: Scene) -> Iterator[Check]:
    """Yield the checks of one frame against the NumPy device.

    Args:
        device: The device.
        camera: The camera.
        scene: The scene.
    """
    reference = Simulator(camera, device="numpy").expose(scene, SECONDS)
    wanted = np.asarray(reference.mean, np.float32)
    simulator = Simulator(camera, device=device)
    exposure = simulator.expose(scene, SECONDS)
    error = find_difference(to_host(device, exposure.mean), wanted) / float(wanted.max())
    yield Check("mean electrons against NumPy", error, MEAN, MEAN_WHY)
    drawn = [
        made.readout.draw_electrons(wanted, SECONDS, seed=1)
        for made in (simulator, reference.simulator)
    ]
    yield Check("digital numbers against NumPy", find_difference(*drawn), 0.0, EQUAL_WHY)
    codes = to_host(device, exposure.codes(device.array(drawn[1], np.uint16)))
    error = find_difference(codes, np.asarray(reference.codes(drawn[1])))
    yield Check("display codes against NumPy", error, 1.0, CODE_WHY)


def check_truth(device: Device, scene: Scene, tolerance: float) -> Iterator[Check]:
    """Yield the check of the mean electrons against the float64 truth.

    Args:
        device: The device.
        scene: The scene.
        tolerance: Relative RMS error that is asked for.
    """
    allowed = Tolerance.parse(tolerance)
    simulator = Simulator(open_phone(), device=device, tolerance=allowed)
    error = true_error(simulator, scene, simulator.expose(scene, SECONDS)).rms
    yield Check("mean electrons against the truth", error, tolerance, "the tolerance asked for")


def check_same(device: Device, found: Any, wanted: Any) -> Check:
    """Return the check of a pipeline's frame against the same frame made by itself, bit for bit.

    Args:
        device: The device.
        found: Array of the device.
        wanted: Array of the device.
    """
    error = find_difference(to_host(device, found), to_host(device, wanted))
    return Check("frame against one made by itself", error, 0.0, SAME_WHY)


def check_mean(found: np.ndarray, wanted: np.ndarray, tolerance: float, why: str) -> Check:
    """Return the check of mean electrons against the NumPy device.

    Args:
        found: Mean electrons of the device.
        wanted: Mean electrons of the NumPy device.
        tolerance: Allowed difference over the peak.
        why: Derivation of the tolerance.
    """
    error = find_difference(found, wanted) / float(np.abs(wanted).max())
    return Check("mean electrons against NumPy", error, tolerance, why)


def check_rms(found: np.ndarray, wanted: np.ndarray, tolerance: float) -> Check:
    """Return the check of mean electrons with a tolerance against the NumPy device's without.

    Args:
        found: Mean electrons of the device.
        wanted: Exact mean electrons of the NumPy device.
        tolerance: Relative RMS error that was asked for.
    """
    wanted = np.asarray(wanted, np.float64)
    error = np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2))
    case = "mean electrons with a tolerance against NumPy without"
    return Check(case, float(error), tolerance, "the tolerance asked for")
