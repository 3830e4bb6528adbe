"""What a frame takes of a device's memory is predicted within a tenth, and refused before anything is allocated."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import apart

import gpusim as gs
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.errors import DoesNotFit
from gpusim.domain.sensor import FLOAT_BITS

SIZE = (330, 250)


CAMERAS = {
    "phone": PHONE,
    **{name: gs.open_camera(name) for name in ("machine-vision", "mono", "figure8")},
    "stacked": camera_with(sensor={"stacked": True}),
    "best": camera_with(processor={"demosaic": "best"}),
    "learned": camera_with(processor={"demosaic": "learned"}),
    "corrected": camera_with(processor={"denoise": 1.0, "shading": True, "defects": "detect"}),
    "no converter": camera_with(sensor={"bits": FLOAT_BITS}),
    "noise of every kind": camera_with(noise={"hot_pixels": 0.01, "hot_current": 10.0, "dsnu": 1.0,
                                              "telegraph_pixels": 0.01, "telegraph": 5.0, "row": 1.0}),
    "binned": camera_with(sensor={"binning": (2, 2), "binning_mode": "charge"}),
}


def counting(device):
    """The device, and a list of what it allocates from now on [byte]."""
    taken, allocate = [], device._allocate
    device._allocate = lambda nbytes: taken.append(nbytes) or allocate(nbytes)
    return taken


def scene_of(form):
    picture = gs.chart("deadleaves", size=SIZE)
    if form == "materials":
        return picture
    if form == "picture":
        return gs.picture(np.random.default_rng(1).integers(0, 256, (*SIZE[::-1], 3), np.uint8))
    bands = np.ascontiguousarray(picture.content.bands_at(slice(None)), np.float32)
    return replace(picture, content=gs.Cube(picture.wavelengths, bands.astype(form)))


@pytest.mark.parametrize("form", ["materials", np.float32, "picture"])
@pytest.mark.parametrize("tolerance", [None, 4e-4])
@pytest.mark.parametrize("camera", CAMERAS)
def test_a_programs_memory_is_predicted(camera, tolerance, form):
    """Three frames of two scenes, on a device whose driver is asked for all of it; a tenth, and 100 kB of constants."""
    device, scene = apart(), scene_of(form)
    simulator = gs.Simulator(CAMERAS[camera], device=device, tolerance=tolerance)
    program = simulator.program(scene, 0.01)
    needed, taken = program.plan.bytes_needed, counting(device)
    for seed, name in enumerate(("first", "first", "second")):
        program.update(scene=replace(scene, name=name)).frame(seed=seed)
    assert abs(needed - sum(taken)) < 0.1 * sum(taken) + 1e5


def test_nothing_is_allocated_of_what_does_not_fit(monkeypatch):
    device, scene = apart(), scene_of("materials")
    simulator = gs.Simulator(PHONE, device=device, tolerance=4e-4)
    needed, taken = simulator.plan(scene).bytes_needed, counting(device)
    monkeypatch.setattr(OpenCLDevice, "memory", needed - 1)
    with pytest.raises(DoesNotFit, match="330x250"):
        simulator(scene)
    monkeypatch.setattr(OpenCLDevice, "memory", needed)
    monkeypatch.setattr(OpenCLDevice, "largest_array", 1000)
    with pytest.raises(DoesNotFit, match="one array of"):
        simulator(scene)
    assert sum(taken) < 1e5  # constants
