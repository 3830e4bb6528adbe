"""Frames through masks in the pupil against the truth, which cuts the pupil by its own code."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.content import Cube

pytestmark = pytest.mark.slow
WAVELENGTHS = np.linspace(440.0, 640.0, 3)
PHONE = gs.open_camera("phone").with_(exposure_time_ms=5, object_distance_m=1.0)
CAMERAS = {
    "cell": PHONE.with_(mask=gs.pupil_cells((3, 3))[0][1]),
    "code": PHONE.with_(mask=[[1, 0, 1], [0, 1, 0.5], [1, 1, 0]], pupil={"blades": 6}),
    "field": PHONE.with_(mask=[[1, 0.3], [0, 1]], seidel_waves=[0, 0.1, 0.1, 0, 0]),
}


def scene(has_depth, is_small):
    """A scene of squares. The truth of a lens that varies takes minutes for a larger one."""
    random = np.random.default_rng(3)
    values = np.kron(random.random((3, 8, 12)), np.ones((1, 4, 4))).astype(np.float32)
    base = gs.open_scene("colorchecker", size=(48, 32), light="D65", luminance=100)
    found = replace(base, content=Cube(WAVELENGTHS, values))
    if is_small:
        return replace(base, content=Cube(WAVELENGTHS[1:2], values[1:2, :16, :24]))
    if not has_depth:
        return found
    depth = np.full((32, 48), 2.0)
    depth[8:24, 16:32] = 0.7
    return replace(found, depth=depth)


@pytest.mark.parametrize(
    ("name", "has_depth"),
    [("cell", False), ("cell", True), ("code", False), ("code", True), ("field", False)],
)
def test_a_frame_meets_its_tolerance(name, has_depth):
    """The true error is at most the tolerance, in the mean: 1 % is far above all tables' errors, 1e-3."""
    simulate = gs.Simulator(CAMERAS[name], device="numpy", tolerance=1e-2)
    report = simulate(scene(has_depth, name == "field"), seed=1, verify=True).report
    assert report.meets_tolerance
    assert report.error.rms < 1e-2
