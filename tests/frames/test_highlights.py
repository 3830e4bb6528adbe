"""Rebuilt highlights and the display's gamut: against the same light on a sensor with fifteen times the full well."""

import colour
import numpy as np
import pytest
from scipy.ndimage import maximum_filter

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.processor.gamut import BRIGHT, gamut, lms_matrix
from gpusim.kernels.processor.highlights import highlights

ROWS, COLS = 160, 160
LAMPS = {
    "red": (1.0, 0.12, 0.05),
    "orange": (1, 0.55, 0.1),
    "green": (0.1, 1, 0.3),
    "blue": (0.2, 0.35, 1),
}
PLACES = dict(zip(LAMPS, ((100, 40), (100, 120), (140, 40), (140, 120)), strict=True))
SKY = slice(0, 60)
LARGER = 15.0  # full well of the truth
SRGB = gs.Display()


def _scene():
    """A blue sky with a gradient to 1.7 times its light, and four coloured lamps of 6 times white."""
    y, x = np.mgrid[:ROWS, :COLS]
    light = np.full((ROWS, COLS, 3), 0.05)
    light[SKY] = np.array([0.45, 0.75, 1.3]) * (0.5 + 1.2 * (1 - y[SKY, :, None] / 60))
    for name, (a, b) in PLACES.items():
        spot = 6 * np.exp(-((y - a) ** 2 + (x - b) ** 2) / (2 * 8**2))
        light = light + spot[..., None] * np.array(LAMPS[name])
    return gs.scene_from(light, linear=True, luminance=300)


def _frame(**changes):
    camera = gs.open_camera("phone").with_(exposure_time_ms=21.0, demosaic="adaptive", **changes)
    return gs.Simulator(camera, device="opencl")(_scene())


def _oklab(rgb):
    """OKLab of linear sRGB, by the colour-science package."""
    return colour.XYZ_to_Oklab(rgb @ SRGB.xyz_from_rgb.T)


def _hue_errors(found, truth):
    """Angle between the hues of two pictures [degree]."""
    hues = [np.arctan2(lab[..., 2], lab[..., 1]) for lab in (_oklab(found), _oklab(truth))]
    return np.degrees(np.abs(np.angle(np.exp(1j * (hues[0] - hues[1])))))


@pytest.fixture(scope="module")
def frames():
    truth = _frame(
        full_well_e=6000 * LARGER, bits=16, gain_dn_per_e="auto", photon="none", read_e=0
    )
    assert (truth.raw < truth.raw.max()).mean() > 0.999
    found = {name: _frame(highlights=name) for name in ("clip", "rebuild")}
    clipped = maximum_filter(found["clip"].raw == found["clip"].raw.max(), 3)
    return truth.linear * LARGER, found, clipped


@pytest.mark.parametrize("part", ["sky", *LAMPS])
def test_clipped_colours_are_those_of_a_larger_well(frames, part):
    """Where a pixel or a neighbour clips: hue within 4 degrees and light within 20 % in the mean.

    The sky's and the lamps' colours are the same at all brightnesses, so what is left is the noise of the channels
    that do not clip, a few percent of these at 100 .. 1000 electrons, times the ratio of the channels. Clipping errs
    by more than 25 degrees and 25 %.
    """
    truth, found, clipped = frames
    where = np.zeros_like(clipped)
    if part == "sky":
        where[SKY] = clipped[SKY]
    else:
        near = tuple(slice(at - 20, at + 20) for at in PLACES[part])
        where[near] = clipped[near]
    assert where.sum() > 200
    hue, light = {}, {}
    for name, frame in found.items():
        hue[name] = _hue_errors(frame.linear[where], truth[where]).mean()
        wrong = np.abs(frame.linear[where] - truth[where]).mean()
        light[name] = wrong / truth[where].mean()
    assert hue["rebuild"] < 4 and light["rebuild"] < 0.2
    assert hue["clip"] > 25 and light["clip"] > 0.25


def test_light_that_does_not_clip_stays(frames):
    """Eleven pixels from all that clip, which demosaicking reaches, values are those of the clipped camera."""
    _, found, clipped = frames
    away = ~maximum_filter(clipped | (found["clip"].linear.max(-1) > 0.8), 23)
    assert away.sum() > 1000
    np.testing.assert_array_equal(found["rebuild"].linear[away], found["clip"].linear[away])


def test_an_overexposed_white_is_white():
    frame = gs.Simulator(
        gs.open_camera("phone").with_(exposure_time_ms=100.0, look="camera"), device="opencl"
    )(gs.chart("flat", size=(48, 48), reflectance=0.9))
    assert (frame.rgb[8:-8, 8:-8] >= 253).all()


def test_other_cameras_rebuild_too_or_have_nothing_to_rebuild():
    scene = gs.chart("ramp", size=(24, 16))
    for name, changes, is_rebuilt in (
        ("mono", {}, False),
        ("phone", {"stacked": True}, True),
        ("phone", {"cfa": ["RG", "WB"]}, True),
        ("phone", {"white_balance": "gray-world"}, True),
    ):
        camera = gs.open_camera(name).with_(highlights="rebuild", **changes)
        report = gs.Simulator(camera, device="numpy")(scene).report
        assert ("processor.highlights" in [row.stage for row in report.stages]) == is_rebuilt


def test_merged_brackets_rebuild_by_the_merged_saturation():
    """A bracket of which all frames clip in the lamps: hue as in a single frame, and each stage once."""
    camera = gs.open_camera("phone").with_(exposure_time_ms=42.0, look="phone", tone="none")
    simulator = gs.Simulator(camera, device="opencl")
    merged = gs.merge_bracket(simulator, gs.bracket(simulator, _scene(), (-1, 0)))
    stages = [row.stage for row in merged.report.stages]
    assert len({*stages}) == len(stages)
    order = ["highlights", "color", "sharpen", "local_tone", "gamut"]
    assert [row for row in stages if row.removeprefix("processor.") in order] == [
        f"processor.{name}" for name in order
    ]
    y, x = PLACES["red"]
    red, green, blue = merged.linear[y, x]
    assert red > 1.2 * green and red > 1.2 * blue


# ---- gamut


def test_hue_and_lightness_of_colours_outside_stay():
    """Colours of up to 1.3 and down to -0.3 of the display's primaries, against clipping.

    The hue is that of the colour-science package, whose matrices are Ottosson's own to 1e-6; float32
    and 2^-16 of the chroma move colours with a chroma of 0.03 and more by less than 0.1 degrees.
    """
    random = np.random.default_rng(2)
    rgb = random.uniform(-0.3, 1.3, (3, 60, 80)).astype(np.float32)
    wanted = np.moveaxis(rgb.astype(float), 0, -1)
    outside = (wanted < 0).any(-1) | (wanted > 1).any(-1)
    lab = _oklab(wanted)
    found = np.moveaxis(gamut(rgb, lms_matrix(SRGB.xyz_from_rgb), device="opencl"), 0, -1)
    assert found.min() >= 0 and found.max() <= 1
    np.testing.assert_array_equal(found[~outside], np.moveaxis(rgb, 0, -1)[~outside])
    seen = outside & (lab[..., 0] > 0.2) & (lab[..., 0] < BRIGHT)
    found_lab = _oklab(found.astype(float))
    coloured = seen & (np.hypot(found_lab[..., 1], found_lab[..., 2]) > 0.03)
    assert coloured.sum() > 1000
    errors = _hue_errors(found, wanted)[coloured]
    clipped = _hue_errors(np.clip(wanted, 0, 1), wanted)[coloured]
    assert errors.max() < 0.1 and clipped.mean() > 5
    assert np.abs(found_lab - lab)[..., 0][seen].max() < 1e-3


def test_a_picture_s_colours_outside_keep_their_hue(frames):
    """The lamps' hue is right on the display as well: within 4 degrees; clipping the channels errs by 10."""
    truth, _, clipped = frames
    shown = {
        name: np.clip(_frame(highlights="rebuild", gamut=name).linear, 0, 1)
        for name in ("clip", "map")
    }
    errors = {name: _hue_errors(one, truth)[clipped].mean() for name, one in shown.items()}
    assert errors["map"] < 4 and errors["clip"] > 10


def test_bad_settings_are_refused_in_a_line():
    for key in ("highlights", "gamut"):
        with pytest.raises(UnknownName, match=f"processor.{key}"):
            gs.Processor(**{key: "keep"})
    planes = np.zeros((3, 4, 4), np.float32)
    with pytest.raises(BadData, match="highlights: camera"):
        highlights(planes, np.ones(2), saturation=1.0)
    with pytest.raises(OutOfRange, match="highlights: neutral"):
        highlights(planes, np.array([1, 0, 1]), saturation=1.0)
    with pytest.raises(BadData, match="gamut: rgb"):
        gamut(planes[:2], np.eye(3))
    with pytest.raises(BadData, match="no inverse"):
        gamut(planes, np.ones((3, 3)))
