"""Displays: curves, tone, what the screen radiates; measured ones against ISETCam's figures."""

import numpy as np
import pytest

from gpusim.data.colorimetry import xyz
from gpusim.data.displays import display_names, display_picture, open_display
from gpusim.data.lights import illuminant
from gpusim.domain.display import DISPLAYS, Display, decoding
from gpusim.domain.errors import BadData, UnknownName
from gpusim.domain.spectrum import Spectrum, energy_from_photons
from gpusim.domain.tone import TONES

CODES = np.arange(256) / 255


@pytest.mark.parametrize(
    "display", [Display(), Display(curve=1.0), Display(curve=2.2), DISPLAYS["display-p3"]]
)
def test_curves_go_there_and_back(display):
    light = display.decode(CODES)
    assert (light[0], light[-1]) == (0, pytest.approx(1, abs=1e-15)) and (np.diff(light) > 0).all()
    # IEC's rounded constants leave the two branches 3e-8 apart where they meet; elsewhere roundings
    np.testing.assert_allclose(display.encode(light), CODES, atol=1e-7)
    np.testing.assert_array_equal(display.decode(-CODES), -light)


def test_srgb_curve_is_that_of_colour_science():
    import colour

    np.testing.assert_allclose(
        Display().decode(CODES), colour.models.eotf_sRGB(CODES), atol=1e-12
    )  # roundings


def test_display_p3_is_that_of_colour_science():
    import colour

    p3 = colour.RGB_COLOURSPACES["Display P3"]
    # derived from the same chromaticities, some ten roundings times the condition number, below 10
    np.testing.assert_allclose(DISPLAYS["display-p3"].xyz_from_rgb, p3.matrix_RGB_to_XYZ, atol=1e-6)


def test_a_red_beyond_srgb_fits_display_p3():
    """The P3 red: outside of sRGB, inside of P3, so that one display clips it and the other shows it."""
    red = DISPLAYS["display-p3"].xyz_from_rgb @ [1, 0, 0]
    assert (DISPLAYS["srgb"].rgb_from_xyz @ red).min() < -0.03
    np.testing.assert_allclose(DISPLAYS["display-p3"].rgb_from_xyz @ red, [1, 0, 0], atol=1e-14)


@pytest.mark.parametrize(
    ("name", "white"),
    [
        # Y of white [cd m-2] as ISETCam's displays have it (`whitexyz` of its files)
        ("lcd-apple", 118.13991102),
        ("lcd-dell", 161.60696464),
        ("crt-dell", 98.82545429),
        ("oled-sony", 157.23115481),
    ],
)
def test_measured_displays_have_isetcam_s_luminance(name, white):
    """ISETCam sums 10 nm samples, ours integrates the curves between them: 0.5 % apart on spectra with narrow peaks."""
    display = open_display(name)
    assert display.luminance == pytest.approx(white, rel=5e-3)
    np.testing.assert_allclose(
        display.xyz([255, 255, 255]), xyz(display.spectra).sum(axis=0), rtol=1e-6
    )


@pytest.mark.parametrize("name", ["srgb", "lcd-apple", "crt-dell"])
def test_the_screen_radiates_what_the_display_model_says(name):
    """XYZ of the radiance, integrated, against primaries x curve.

    Spectra are float32 (6e-8); of "srgb", their white is the tabulated D65, 3e-4 from the standard's chromaticity.
    """
    display = open_display(name)
    codes = np.random.default_rng(1).integers(0, 256, (3, 4, 3)).astype(np.uint8)
    scene = display_picture(codes, display)
    content = scene.content
    nodes = content.wavelengths
    for y in range(3):
        for x in range(4):
            reflectance = content.planes[:, y, x].astype(float) @ content.basis
            light = scene.illuminant.at(nodes)
            radiance = energy_from_photons(Spectrum(nodes, reflectance * light))
            tolerance = (
                5e-3 if name == "srgb" else 1e-6
            )  # srgb: basis and light have different nodes, products differ
            np.testing.assert_allclose(
                xyz(radiance), display.xyz(codes[y, x]), rtol=0, atol=tolerance * display.luminance
            )


def test_displayed_refuses():
    picture = np.zeros((2, 2, 3), np.uint8)
    with pytest.raises(BadData, match="no spectra"):
        display_picture(picture, open_display("display-p3"))
    for wrong in (picture[..., :2], picture.astype(float), picture[0]):
        with pytest.raises(BadData, match=r"wanted (uint8|\(rows, cols, 3\))"):
            display_picture(wrong, open_display("srgb"))
    with pytest.raises(UnknownName, match="did you mean 'lcd-apple'"):
        open_display("lcd-aple")
    assert {"srgb", "display-p3", "oled-sony"} <= {*display_names()}


# ------------------------------------------------------------------------------------------------------------- tone


def test_no_tone_is_the_display_s_curve():
    np.testing.assert_array_equal(decoding(Display())(CODES), Display().decode(CODES))


@pytest.mark.parametrize("display", [Display(), Display(curve=2.2)])
def test_a_straight_tone_curve_changes_nothing(display):
    """Bisection of 60 steps is exact to rounding; at the dark end sRGB's branches are 3e-8 apart."""
    straight = decoding(display, ((0, 0), (0.3, 0.3), (1, 1)))
    np.testing.assert_allclose(straight(CODES), display.decode(CODES), atol=1e-7)


def test_tone_nodes_are_met():
    """A node (x, y): the light whose sRGB value is x is shown with the sRGB code y; 1.2 is brighter than white."""
    nodes = ((0.02, 0), (0.25, 0.2), (0.6, 0.75), (1.2, 1))
    light = decoding(Display(), nodes)
    x, y = np.array(nodes).T
    # the cubic may end level: a rounding of 1e-16 in y then is its root in x
    np.testing.assert_allclose(light(y), Display().decode(x), rtol=1e-7)
    assert (np.diff(light(np.linspace(0, 1, 1001))) > 0).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "tone",
    [
        ((0, 0), (1e3, 1)),
        ((0, 0), (1e-6, 0.5), (1e3, 1)),
        ((0, 0), (999.999999, 1e-9), (1e3, 1)),
        ((999.999, 0), (1e3, 1)),
        ((0, 0), (1e-9, 1e-9), (1, 1 - 1e-9), (1e3, 1)),
    ],
)
def test_steep_and_long_tone_curves_give_light_that_rises(tone):
    """To 1000, as sRGB encodes it: ((1000 + .055) / 1.055)^2.4 = 1.4e7 times white.

    The curve may end as level as a cubic can: four roundings of y, 2^-53, are then the cube of what x errs by, over
    what the last segment rises.
    """
    light = decoding(Display(), tone)(CODES)
    assert (np.diff(light) >= 0).all() and light[0] >= 0
    error = 2.4 * (4 * 2**-53 / (tone[-1][1] - tone[-2][1])) ** (1 / 3)
    assert light[-1] == pytest.approx(((tone[-1][0] + 0.055) / 1.055) ** 2.4, rel=error)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tone", [((0, 0), (1e-320, 0.9), (1, 1)), ((0, 0), (1e300, 1))])
def test_a_tone_curve_beyond_float64_is_named(tone):
    with pytest.raises(BadData, match=r"processor\.tone"):
        decoding(Display(), tone)


def _published(name, light):
    """The curve as its paper has it, with the constants that the package names."""
    if name == "reinhard":  # equation 4, of twice the light, L_white = 2
        scaled = 2 * light
        return scaled * (1 + scaled / 2**2) / (1 + scaled)
    if name == "sigmoid":  # V / V_max = I^n / (I^n + s^n), over that of white
        power, half = light**1.4, (0.55 ** (1 / 1.4)) ** 1.4
        return power / (power + half) / (1 / (1 + half))
    return np.log(5 * light + 1) / np.log(5 + 1)  # equation 1, L_max = 5


@pytest.mark.parametrize("name", ["reinhard", "sigmoid", "logarithmic"])
@pytest.mark.parametrize("display", [Display(), Display(curve=2.2)])
def test_tone_curves_by_name_are_those_of_their_papers(name, display):
    """The light at which a code begins is shown with that code: float64, few roundings, condition below 10.

    The logarithm of 1 + x loses 2^-53 of 1, over log 6.
    """
    light = decoding(display, name)(CODES)
    np.testing.assert_allclose(
        _published(name, light), display.decode(CODES), rtol=1e-13, atol=2**-53
    )
    assert light[0] == 0 and light[-1] == pytest.approx(1, rel=1e-14)
    assert (np.diff(light) > 0).all()


def test_every_tone_curve_has_a_test_and_none_is_none():
    assert {*TONES} == {"reinhard", "sigmoid", "logarithmic"}
    np.testing.assert_array_equal(decoding(Display(), "none")(CODES), Display().decode(CODES))


def test_white_of_d65_is_the_srgb_display_s():
    white = xyz(illuminant("D65"))
    # the standard's chromaticity is rounded to four decimals: half a unit over the smallest, 0.3127
    np.testing.assert_allclose(Display().xyz_from_rgb.sum(axis=1), white / white[1], rtol=3e-4)


# ------------------------------------------------------------------------------------------------------------- files


def test_pictures_say_what_display_they_are_for(tmp_path):
    """PNG: cICP 12, 13, 0, 1 is Display P3 (ITU-T H.273), read by Pillow's chunk reader; EXR: its chromaticities."""
    import OpenEXR
    from PIL import Image

    from gpusim.io.exr import write_rgb_exr
    from gpusim.io.frame.images import write_png

    picture = np.full((4, 5, 3), 100, np.uint8)
    p3, gamma = open_display("display-p3"), Display("mine", curve=1.8)
    chunks = {}
    for name, display in (("p3", p3), ("gamma", gamma), ("srgb", DISPLAYS["srgb"])):
        write_png(tmp_path / f"{name}.png", picture, display)
        np.testing.assert_array_equal(Image.open(tmp_path / f"{name}.png"), picture)
        chunks[name] = (tmp_path / f"{name}.png").read_bytes()
        write_rgb_exr(tmp_path / f"{name}.exr", np.ones((2, 2, 3)), display=display)
        found = OpenEXR.File(str(tmp_path / f"{name}.exr")).header()["chromaticities"]
        np.testing.assert_allclose(found, np.ravel((*display.primaries, display.white)), rtol=1e-7)
    assert b"cICP" + bytes([12, 13, 0, 1]) in chunks["p3"]
    assert (
        b"gAMA" + (55556).to_bytes(4, "big") in chunks["gamma"] and b"cICP" not in chunks["gamma"]
    )
    assert b"sRGB" in chunks["srgb"] and b"sRGB" not in chunks["p3"]
    assert (
        b"cHRM" + b"".join(x.to_bytes(4, "big") for x in (31270, 32900, 68000, 32000))
        in chunks["p3"]
    )
