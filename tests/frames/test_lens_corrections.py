"""Lens corrections: dots on a straight grid stay where a pinhole puts them, in every channel; labels follow."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS

import gpusim as gs
from gpusim.domain.errors import OutOfRange
from gpusim.domain.spectrum import Spectrum
from gpusim.kernels.processor.rectify import rectify
from gpusim.optics.correction import magnification

ROWS, COLS, STEP, SIGMA = 160, 240, 40, 3.0
QUIET = {"photon": "none", "read_e": 0, "prnu": 0, "dsnu_e": 0, "dark_current_e_per_s": 0}
CORNER_MM = 1e3 * 1.4e-6 * np.hypot(ROWS, COLS) / 2
GRID = np.array([(y, x) for y in range(20, ROWS, STEP) for x in range(20, COLS, STEP)], float)
MIDDLE = np.array([(ROWS - 1) / 2, (COLS - 1) / 2])
STAGE = "processor.rectify"


def _dots():
    """A grid of Gaussian dots on black, white light."""
    y, x = np.mgrid[:ROWS, :COLS]
    light = sum(np.exp(-((y - a) ** 2 + (x - b) ** 2) / (2 * SIGMA**2)) for a, b in GRID)
    return gs.scene_from(np.repeat(light[..., None], 3, -1), linear=True, luminance=300)


def _camera(k2=0.0, lateral=0.0, **changes):
    """A camera whose pixels have all channels, with distortion and lateral colour of this size in the corner."""
    distortion = {"distortion": {"k1": 0.0, "k2": k2, "radius_mm": CORNER_MM}} if k2 else {}
    camera = gs.open_camera("phone").with_(
        **QUIET, **distortion, bits=16, stacked=True, color="none", **changes
    )
    curve = Spectrum(np.array([450.0, 550.0, 650.0]), np.array([-lateral, 0, lateral]))
    return replace(camera, optics=replace(camera.optics, lateral_color=curve if lateral else 0.0))


def _centres(linear, places):
    """Centres of the dots next to these places, (dots, 2, channels)."""
    found = []
    for place in places:
        first = np.round(place).astype(int) - 14
        part = linear[tuple(slice(max(at, 0), at + 29) for at in first)].astype(float)
        part = np.where(part > 0.02 * part.max((0, 1)), part, 0)
        index = np.indices(part.shape[:2]) + np.maximum(first, 0)[:, None, None]
        found.append(np.einsum("ayx,yxc->ac", index, part) / part.sum((0, 1)))
    return np.array(found)


def _moved(camera):
    """Largest distance of green dots from a pinhole's, and of red and blue ones from these [pixel]."""
    sensor = camera.sensor
    zoom = magnification(camera.optics, (ROWS, COLS), sensor.pixel_pitch, sensor.displacement)
    zoom = zoom if camera.processor.corrects_lens else 1.0
    wanted = (GRID - MIDDLE) / zoom + MIDDLE - sensor.displacement
    wanted = wanted[(np.abs(wanted - MIDDLE) < MIDDLE - 12).all(1)]
    found = _centres(gs.Simulator(camera, device="opencl")(_dots()).linear, wanted)
    beside = found[..., [0, 2]] - found[..., [1]]
    return np.hypot(*(found[..., 1] - wanted).T).max(), np.hypot(*beside.transpose(1, 0, 2)).max()


@pytest.mark.parametrize("k2", [-0.08, pytest.param(0.08, marks=pytest.mark.slow)])
def test_a_grid_comes_out_straight(k2):
    """Within 0.1 pixel: the measure of a dot of 3 pixels on its cubic interpolants errs by 0.02."""
    crooked, _ = _moved(_camera(k2))
    straight, _ = _moved(_camera(k2, lens_corrections=True))
    assert crooked > 3 and straight < 0.1


def test_a_displaced_chip_is_corrected_around_the_axis():
    """The same bound 24 and 36 pixels beside the axis."""
    straight, _ = _moved(_camera(-0.08, lens_corrections=True, offset=(24.0, -36.0)))
    assert straight < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("k2", [0.0, -0.08])
def test_channels_lie_on_each_other(k2):
    """One percent of the corner's height at the ends of the spectrum parts the channels by 0.7 pixel, then by 0.1."""
    _, apart = _moved(_camera(k2, 0.01))
    off_grid, together = _moved(_camera(k2, 0.01, lens_corrections=True))
    assert apart > 0.7 and together < 0.1 and off_grid < 0.1


def test_a_pincushion_is_magnified_until_it_fills_the_frame():
    """1 + 0.08 z^2 times the corner's own height z must be the corner: Newton's root of z + 0.08 z^3 = 1."""
    corners = magnification(_camera(0.08).optics, (ROWS, COLS), 1.4e-6)
    root = 1.0
    for _ in range(20):
        root -= (root + 0.08 * root**3 - 1) / (1 + 0.24 * root**2)
    assert corners == pytest.approx(root, abs=1e-6)
    assert magnification(_camera(-0.08).optics, (ROWS, COLS), 1.4e-6) == 1.0


def test_looks_correct_the_lens_and_linear_does_not():
    scene = gs.chart("flat", size=(24, 16))
    stages = {}
    for look in ("linear", "camera", "phone"):
        camera = _camera(-0.08, look=look)
        stages[look] = [
            row.stage for row in gs.Simulator(camera, device="numpy")(scene).report.stages
        ]
    assert [STAGE in stages[look] for look in stages] == [False, True, True]
    assert ["processor.shade" in stages[look] for look in stages] == [False, True, True]


def test_a_lens_without_faults_has_nothing_to_correct():
    scene = gs.chart("flat", size=(24, 16))
    own = gs.open_camera("phone").with_(lens_corrections=True)
    report = gs.Simulator(own, device="numpy")(scene).report
    assert STAGE not in [row.stage for row in report.stages]
    assert "nothing is to correct" in str(report)
    by_look = gs.Simulator(gs.open_camera("phone").with_(look="camera"), device="numpy")(scene)
    assert "nothing is to correct" not in str(by_look.report)


def test_labels_are_those_of_the_corrected_picture():
    """A map of columns, looked up by a corrected camera, is what a pinhole of the same magnification sees."""
    labels = {"column": np.tile(np.arange(COLS), (ROWS, 1))}
    scene = replace(_dots(), labels=labels)
    for k2 in (-0.08, 0.08):
        camera = _camera(k2, lens_corrections=True)
        zoom = magnification(camera.optics, (ROWS, COLS), camera.sensor.pixel_pitch)
        found = gs.carry_labels(scene, camera)["column"][0]
        wanted = (np.arange(COLS) - MIDDLE[1]) * zoom + MIDDLE[1]
        assert np.abs(found - wanted).max() <= 0.5 + 1e-6
        assert np.abs(gs.carry_labels(scene, _camera(k2))["column"][0] - wanted).max() > 2


@pytest.mark.slow
def test_binned_pixels_are_corrected_as_pixels_of_their_area():
    """Dots of a camera with 2 x 2 binning lie where a pinhole puts them, in its pixels, within 0.1."""
    camera = _camera(-0.08, lens_corrections=True, binning=[2, 2])
    linear = gs.Simulator(camera, device="opencl")(_dots()).linear
    wanted = (GRID - 0.5) / 2
    wanted = wanted[(np.abs(wanted - MIDDLE / 2) < MIDDLE / 2 - 12).all(1)]
    found = _centres(linear, wanted)

    assert np.hypot(*(found[..., 1] - wanted).T).max() < 0.1


@pytest.mark.parametrize("device", ALL_KINDS)
def test_whole_pixels_are_moved_without_change(device):
    planes = np.random.default_rng(1).random((2, 9, 12), np.float32)
    nodes = np.zeros((1, 2, 2, 2), np.float32)
    nodes[:, 0], nodes[:, 1] = 1, -2
    wanted = planes[:, np.minimum(np.arange(9) + 1, 8)][:, :, np.maximum(np.arange(12) - 2, 0)]
    np.testing.assert_array_equal(rectify(planes, nodes, device=device), wanted)


def test_a_loop_turns_corrections_on_and_off():
    scene = gs.chart("colorchecker", size=(72, 48))
    loop = gs.Simulator(_camera(-0.08), device="opencl").loop(scene)
    for k2, is_corrected in ((-0.08, True), (0.08, True), (0.08, False), (-0.08, True)):
        camera = _camera(k2, lens_corrections=is_corrected)
        loop.update(camera=camera)
        found = np.array(loop.simulator.device.numpy(loop.codes(seed=1)))
        wanted = gs.Simulator(camera, device="opencl")(scene, seed=1).rgb
        np.testing.assert_array_equal(found, wanted)


def test_a_bad_setting_is_refused():
    with pytest.raises(OutOfRange, match="lens_corrections"):
        gs.Processor(lens_corrections=2)
