"""A lens whose axis does not meet the middle of the frame: the frame is a part of a wider one that is centred."""

from dataclasses import replace

import numpy as np
import pytest
from lights import as_photons

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum

ROWS, COLS, MORE = (
    64,
    88,
    40,
)  # the wide frame has MORE columns on the right: the axis is MORE / 2 off
INNER = np.s_[10:-10, 10:-18]  # what the border of either frame does not reach
# Wavefront of the wide frame [waves] at its corner, and the power of the field height with which each term grows
SEIDEL = {
    "coma": ((0, 1.0, 0, 0, 0), 1),
    "astigmatism": ((0, 0, 1.0, 0, 0), 2),
    "displacement": ((0, 0, 0, 0, 1.0), 3),
}


def scene_of(cols):
    random = np.random.default_rng(5)
    values = random.random((3, ROWS // 4, (COLS + MORE) // 4)).repeat(4, 1).repeat(4, 2)[..., :cols]
    return Scene(Cube(np.array([450.0, 550.0, 650.0]), np.float32(values)), as_photons("D65"))


def mean_of(cols, right, **lens):
    camera = gs.open_camera("phone").with_(exposure_time_ms=5)
    focal = (
        camera.optics.focal_length / camera.sensor.pixel_pitch / 20
    )  # [pixel]; a wide angle, so that angles count
    optics = replace(
        camera.optics,
        distortion=gs.Calibration(cols, ROWS, focal, focal, (cols - 1) / 2 + right, (ROWS - 1) / 2),
        **lens,
    )
    camera = replace(camera, optics=optics)
    return np.asarray(gs.Simulator(camera, device="opencl").expose(scene_of(cols)).mean, np.float64)


def cut_is_the_wide_frame(wide, narrow, limit):
    """Compare a part of the wide frame with the frame off the axis, and with one that is centred by mistake."""
    whole = mean_of(COLS + MORE, 0, **wide)[:, :COLS][INNER]
    off, centred = (mean_of(COLS, right, **narrow)[INNER] for right in (MORE / 2, 0))
    size = np.sqrt(np.mean(whole**2))
    assert np.sqrt(np.mean((off - whole) ** 2)) < limit * size
    assert np.sqrt(np.mean((centred - whole) ** 2)) > 10 * limit * size


NARROWER = np.hypot(ROWS, COLS) / np.hypot(
    ROWS, COLS + MORE
)  # corner over corner: field heights are relative to it


@pytest.mark.slow  # a minute each: pupils without symmetry, at many places
@pytest.mark.parametrize("name", SEIDEL)
def test_blur_follows_the_axis(name):
    """Each of the two frames keeps the blur to 5e-4 of a natural picture (planner/knobs/field.py); this one, of
    random squares, has up to four times its contrast."""
    waves, power = SEIDEL[name]
    wavefront = gs.open_camera("phone").optics.wavefront
    wide, narrow = (
        replace(wavefront, seidel=tuple(scale * one for one in waves))
        for scale in (1, NARROWER**power)
    )
    cut_is_the_wide_frame({"wavefront": wide}, {"wavefront": narrow}, 4e-3)


@pytest.mark.slow
def test_lateral_colour_follows_the_axis():
    """As above; 0.7 samples at the corner."""
    colour = Spectrum(np.array([400.0, 700.0]), np.array([-0.01, 0.01]))
    cut_is_the_wide_frame({"lateral_color": colour}, {"lateral_color": colour}, 4e-3)


def test_relative_illumination_follows_the_axis():
    """A polynomial of the field height; float32 gains."""
    cut_is_the_wide_frame(
        {"relative_illumination": (0.0, -0.3)},
        {"relative_illumination": (0.0, -0.3 * NARROWER**2)},
        1e-3,
    )


def test_microlenses_follow_the_axis():
    """Chief rays come from the axis; the planner's own gains, as they need no light."""
    from gpusim.planner.choices import Falloff
    from gpusim.planner.plan import plan

    def gains(cols, right):
        camera = gs.open_camera("phone")
        focal = camera.optics.focal_length / camera.sensor.pixel_pitch
        optics = replace(
            camera.optics,
            relative_illumination="none",
            focal_length=camera.optics.focal_length / 20,
            distortion=gs.Calibration(
                cols, ROWS, focal, focal, (cols - 1) / 2 + right, (ROWS - 1) / 2
            ),
        )
        lens = Microlens(np.array([0.0, 0.5, 1.5]), np.array([1.0, 0.8, 0.1]))
        sensor = replace(camera.sensor, microlens=lens)
        made = plan(scene_of(cols), replace(camera, optics=optics, sensor=sensor))
        return made.find(Falloff).gains

    wide, off, centred = gains(COLS + MORE, 0)[:, :COLS], gains(COLS, MORE / 2), gains(COLS, 0)
    assert np.abs(off - wide).max() < 1e-12 and np.abs(centred - wide).max() > 1e-3
