"""The camera's parts, the built-in cameras and camera files."""

import dataclasses

import numpy as np
import pytest
from cameras import FIRST
from scipy.special import jn_zeros

import gpusim as gs
from gpusim.data.curves import CHANNELS, curve
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.digest import digest
from gpusim.domain.display import Display
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.noise import Noise, reset_noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import camera_names, open_camera

ULPS = 1e-14  # some ten float64 operations, each rounding by at most 1.1e-16

# ---------------------------------------------------------------------------------------------------------- optics


def test_irradiance_factor_is_the_projected_solid_angle_of_the_aperture():
    # pi sin^2(theta), with the marginal ray from the image point to the edge of the aperture.
    optics = Optics(f_number=2.8, focal_length=50e-3, object_distance=0.4)
    marginal = np.arctan2(50e-3 / 2.8 / 2, optics.image_distance)
    assert optics.irradiance_factor == pytest.approx(np.pi * np.sin(marginal) ** 2, rel=ULPS)


def test_irradiance_factor_agrees_with_isetcam():
    # ISETCam 3b10ec1: f/4, 3.9 mm, object at 1.2 m; its result is known to 5 digits, so to half of the last.
    assert Optics(4.0, 3.9e-3, object_distance=1.2).irradiance_factor == pytest.approx(
        0.048023, abs=5e-7
    )


def test_irradiance_factor_tends_to_the_textbook_limit():
    slow = Optics(f_number=100.0, focal_length=0.05)
    # pi / (1 + x) against pi / x with x = 4 N^2 = 4e4: differs by 1 / x to first order.
    assert slow.irradiance_factor == pytest.approx(np.pi / 4e4, rel=2.6e-5)
    assert slow.irradiance_factor < np.pi / 4e4


def test_magnification_and_image_distance_obey_the_thin_lens_equation():
    optics = Optics(2.0, 0.05, object_distance=0.3)
    assert 1 / optics.image_distance + 1 / 0.3 == pytest.approx(1 / 0.05, rel=ULPS)
    assert optics.magnification == pytest.approx(-optics.image_distance / 0.3, rel=ULPS)
    far = Optics(2.0, 0.05)
    assert (far.magnification, far.image_distance, far.working_f_number) == (0, 0.05, 2.0)


def test_airy_radius_is_the_first_zero_of_j1():
    wavelengths = np.array([400.0, 550.0, 700.0])
    expected = jn_zeros(1, 1)[0] / np.pi * wavelengths * 1e-9 * 5.6
    np.testing.assert_allclose(Optics(5.6, 0.017).airy_radius(wavelengths), expected, rtol=ULPS)
    # The chapter's example says 3.76 um for the radius at 550 nm and f/5.6, with 1.22 for 1.21967.
    assert Optics(5.6, 0.017).airy_radius(550) == pytest.approx(3.76e-6, abs=0.005e-6)


def test_transmission_holds_its_end_values():
    glass = Optics(2.0, 0.05, transmission=Spectrum([400, 700], [0.8, 0.9]))
    np.testing.assert_allclose(glass.transmission_at([300, 550, 900]), [0.8, 0.85, 0.9], rtol=ULPS)
    np.testing.assert_array_equal(
        Optics(2.0, 0.05, transmission=0.5).transmission_at([400, 500]), [0.5, 0.5]
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("f_number", 0),
        ("f_number", -2.8),
        ("f_number", np.nan),
        ("f_number", np.inf),
        ("focal_length", 0),
        ("focal_length", np.inf),
        ("object_distance", 0.05),
        ("object_distance", np.nan),
        ("transmission", 1.01),
        ("transmission", np.nan),
        ("transmission", Spectrum([400, 700], [-0.1, 0.9])),
    ],
)
def test_optics_out_of_range(key, value):
    with pytest.raises(OutOfRange, match=f"optics.{key} = .*allowed is"):
        Optics(**{"f_number": 2.0, "focal_length": 0.05, key: value})


def test_optics_names_and_shapes():
    with pytest.raises(UnknownName, match="did you mean 'diffraction'"):
        Optics(2.0, 0.05, model="difraction")
    with pytest.raises(UnknownName, match=r"optics\.relative_illumination"):
        Optics(2.0, 0.05, relative_illumination="cosine")
    with pytest.raises(BadData, match="one function"):
        Optics(2.0, 0.05, transmission=Spectrum([400, 700], np.ones((3, 2))))


# ---------------------------------------------------------------------------------------------------------- sensor

RGB = Spectrum(
    [400, 500, 600, 700], np.array([[0, 0, 0.5, 0.5], [0, 0.6, 0.3, 0], [0.5, 0.4, 0, 0]])
)


def sensor(**changes):
    return Sensor(**{"pixel_pitch": 1.4e-6, "qe": RGB, "full_well": 6000.0, "bits": 10, **changes})


@pytest.mark.parametrize(
    ("cfa", "indices", "red"),
    [
        (("RG", "GB"), [[0, 1], [1, 2]], (0, 0)),
        (("GR", "BG"), [[1, 0], [2, 1]], (0, 1)),
        (("GB", "RG"), [[1, 2], [0, 1]], (1, 0)),
        (("BG", "GR"), [[2, 1], [1, 0]], (1, 1)),
        (("RB", "GG"), [[0, 2], [1, 1]], None),
        (("RGB",), [[0, 1, 2]], None),
    ],
)
def test_mosaic(cfa, indices, red):
    made = sensor(cfa=cfa)
    assert made.cfa_indices.dtype == np.int32
    np.testing.assert_array_equal(made.cfa_indices, indices)
    assert made.bayer_phase == red
    assert not made.is_monochrome


def test_monochrome_is_one_by_one():
    made = sensor(channels=("Y",), cfa=("Y",), qe=Spectrum([400, 700], [[0.5, 0.6]]))
    np.testing.assert_array_equal(made.cfa_indices, [[0]])
    assert made.is_monochrome and made.bayer_phase is None


def test_full_well_is_white_unless_a_gain_is_given():
    made = sensor(black_level=64)
    assert made.white_level == 1023
    assert 64 + made.gain_dn_per_electron * 6000 == pytest.approx(1023, rel=ULPS)
    assert made.saturation == 6000
    assert (
        sensor(black_level=64, gain=0.1).saturation == 6000
    )  # 9590 e- would fill the converter: the well is first
    assert sensor(black_level=64, gain=1.0).saturation == 959  # the converter is first


def test_aperture_has_the_area_of_the_fill_factor():
    height, width = sensor(fill_factor=0.75).aperture
    assert height == width
    assert height * width == pytest.approx(0.75 * 1.4e-6**2, rel=ULPS)


def test_photodetector_is_the_aperture_and_gives_the_fill_factor():
    made = sensor(photodetector=(0.5, 0.8), centre=(0.2, -0.1), offset=(0.25, 0.5))
    assert made.aperture == pytest.approx((0.7e-6, 1.12e-6), rel=ULPS)
    assert made.fill_factor == 0.4  # 0.5 x 0.8 is exact to the last bit of the literal
    assert made.displacement == pytest.approx((0.45, 0.4), rel=ULPS)
    assert dataclasses.replace(made, bits=12).aperture == made.aperture  # a copy keeps it


def test_gain_of_conversion_and_converter_range():
    # By hand: 40 uV/e- x 4095 DN / 0.8 V = 0.20475 DN/e-, and four times that behind an analog gain of 4.
    made = sensor(bits=12, conversion_gain=40e-6, adc_range=0.8, black_level=95)
    assert made.gain_dn_per_electron == pytest.approx(0.20475, rel=ULPS)
    assert made.saturation == 6000  # 4000 DN are 19536 e-: the well is first
    louder = dataclasses.replace(made, analog_gain=4.0, analog_offset=100.0)
    assert louder.gain_dn_per_electron == pytest.approx(0.819, rel=ULPS)
    assert louder.saturation == pytest.approx(
        4000 / 0.819 - 100, rel=ULPS
    )  # the converter is, less the offset


def test_without_a_converter_values_are_electrons_unless_a_gain_is_given():
    made = sensor(bits=32, black_level=100)
    assert (made.gain_dn_per_electron, made.saturation, made.white_level) == (1, 6000, 6100)
    assert sensor(bits=32, gain=0.5, analog_offset=10.0).white_level == 3005  # of a full well


def test_one_read_adds_variances():
    made = sensor(gain=0.5, analog_gain=2.0, noise=Noise(read=3.0, reset=4.0, adc=12.0))
    assert made.read_sigma == pytest.approx(
        13, rel=ULPS
    )  # 3, 4 and 12 DN at 1 DN/e-: 9 + 16 + 144 = 169


def test_dark_current_doubles_every_doubling():
    assert Noise(temperature=25.0).warmth == 1
    assert Noise(temperature=41.0, doubling=8.0).warmth == 4
    assert Noise(temperature=-10.0, reference_temperature=20.0, doubling=6.0).warmth == 1 / 32


def test_reset_noise_is_that_of_a_capacitor():
    # kT = 1.380649e-23 x 300.15 = 4.144018e-21 J. At 50 uV/e-, C = 1.602176634e-19 / 50e-6 = 3.204353 fF, so
    # sqrt(kTC) = sqrt(1.3278896e-35) = 3.644022e-18 C = 22.7442 e-, to the six digits carried by hand.
    assert reset_noise(50e-6, 27.0) == pytest.approx(22.7442, rel=5e-6)
    assert reset_noise(200e-6, 27.0) == pytest.approx(
        reset_noise(50e-6, 27.0) / 2, rel=ULPS
    )  # as sqrt(C)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("bits", 33),
        ("bits", -1),
        ("exposure_time", -0.01),
        ("exposure_time", np.nan),
        ("row_time", -1e-6),
        ("row_time", np.nan),
        ("photodetector", (0.5, 1.1)),
        ("photodetector", (0, 0.5)),
        ("photodetector", (0.5,)),
        ("centre", (0.6, 0)),
        ("centre", (0.0, 0.1)),
        ("offset", (np.nan, 0)),
        ("conversion_gain", 0),
        ("adc_range", -1),
        ("analog_gain", 0),
        ("analog_gain", np.inf),
        ("analog_offset", np.nan),
        ("analog_offset", 7000.0),
        ("binning", (0, 2)),
        ("binning", (9, 1)),
        ("binning", (2,)),
        ("binning", (1.5, 2)),
        ("pixel_pitch", 0),
        ("pixel_pitch", -1e-6),
        ("pixel_pitch", np.nan),
        ("pixel_pitch", 1.4),
        ("fill_factor", 0),
        ("fill_factor", 1.4),
        ("exposure_time", 0),
        ("exposure_time", np.inf),
        ("full_well", 0),
        ("bits", 0),
        ("bits", 17),
        ("bits", 9.5),
        ("black_level", -1),
        ("black_level", 1023),
        ("black_level", 0.5),
        ("gain", 0),
        ("gain", np.nan),
    ],
)
def test_sensor_out_of_range(key, value):
    with pytest.raises(OutOfRange, match=f"sensor.{key} = .*allowed is"):
        sensor(**{key: value})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(
            (key, value)
            for key in (
                "read",
                "reset",
                "adc",
                "row",
                "column",
                "dsnu",
                "row_dsnu",
                "column_dsnu",
                "telegraph",
                "dark_current",
                "hot_current",
            )
            for value in (-1.0, np.nan, np.inf)
        ),
        *(
            (key, value)
            for key in ("prnu", "row_prnu", "column_prnu")
            for value in (-0.1, 1.0, np.nan)
        ),
        *(
            (key, value)
            for key in ("hot_pixels", "dead_pixels", "telegraph_pixels")
            for value in (-0.01, 1.01, np.nan)
        ),
        ("temperature", -273.15),
        ("temperature", np.nan),
        ("reference_temperature", 1e4),
        ("doubling", 0.0),
        ("telegraph_switching", 0.0),
        ("telegraph_switching", 1.1),
        ("seed", -1),
        ("seed", 2**64),
        ("seed", 0.5),
    ],
)
def test_noise_out_of_range(key, value):
    with pytest.raises(OutOfRange, match=f"noise.{key} = .*allowed is") as caught:
        Noise(**{key: value})
    assert (
        f"{value:.6g}" in str(caught.value)
        if isinstance(value, float)
        else str(value) in str(caught.value)
    )


def test_noise_names():
    with pytest.raises(UnknownName, match=r"noise\.photon 'exat'; did you mean 'exact'"):
        Noise(photon="exat")


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        (
            {"gain": 0.01, "full_well": 3000, "black_level": 64},
            OutOfRange,
            r"sensor\.full_well = 3000 e- = 30 DN above black: allowed is at least the black level, 64 DN",
        ),
        ({"conversion_gain": 50e-6}, BadData, "adc_range"),
        ({"adc_range": 1.0}, BadData, "conversion_gain"),
        ({"gain": 1.0, "conversion_gain": 50e-6, "adc_range": 1.0}, BadData, "wanted only gain"),
        ({"photodetector": (0.5, 0.5), "fill_factor": 0.5}, BadData, "wanted one of them"),
        (
            {"binning_mode": "analog"},
            UnknownName,
            r"sensor\.binning_mode 'analog'.*charge, digital",
        ),
        (
            {"binning": (2, 2), "binning_mode": "digital", "bits": 32},
            BadData,
            "without a converter",
        ),
        (
            {"bits": 32, "analog_offset": -6000.0},
            OutOfRange,
            r"sensor\.analog_offset",
        ),  # a full well reads 0
        ({"vignetting": [[1.0, 0.5]]}, BadData, r"sensor\.vignetting"),
        ({"vignetting": [[1.0, np.nan], [1.0, 1.0]]}, BadData, r"sensor\.vignetting"),
    ],
)
def test_sensor_parts_that_do_not_go_together(changes, error, words):
    with pytest.raises(error, match=words) as caught:
        sensor(**changes)
    assert "\n" not in str(caught.value)


def test_bits_are_those_of_converters_or_float():
    assert [sensor(bits=bits).white_level for bits in (1, 8, 16)] == [1, 255, 65535]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cfa": ("RG", "GW")}, "letters must be the channels' letters"),
        (
            {"cfa": ("RG", "GR")},
            "letters must be the channels' letters",
        ),  # no blue pixel: nothing to make blue of
        ({"cfa": ("RG", "B")}, "equally many"),
        ({"cfa": ()}, "1 to 8 rows"),
        ({"cfa": ("RGB" * 3,)}, "at most 8"),
        ({"channels": ("R", "G", "R")}, "twice"),
        ({"channels": ("red", "G", "B")}, "one letter"),
        ({"channels": ("R", "G")}, r"wanted \(2, wavelengths\)"),
        ({"qe": Spectrum([400, 700], [0.5, 0.5])}, "wanted"),
    ],
)
def test_sensor_mosaic_and_curves_must_agree(changes, words):
    with pytest.raises(BadData, match=words):
        sensor(**changes)


@pytest.mark.parametrize("value", [-0.01, 1.01])
def test_quantum_efficiency_is_a_fraction(value):
    with pytest.raises(OutOfRange, match=r"sensor\.qe"):
        sensor(qe=Spectrum([400, 700], [[0.5, value]] * 3))


# ------------------------------------------------------------------------------ processor, display, camera, tolerance


@pytest.mark.parametrize("key", ["defects", "demosaic", "white_balance", "color"])
def test_processor_names(key):
    with pytest.raises(UnknownName, match=f"processor.{key}"):
        Processor(**{key: "finest"})


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"denoise": -1}, OutOfRange, "denoise"),
        ({"denoise": float("nan")}, OutOfRange, "denoise"),
        ({"sharpen": 2.1}, OutOfRange, "sharpen"),
        ({"table": object()}, OutOfRange, "a FilterTable"),
        ({"tone": (0, 1)}, BadData, "tone"),
        ({"tone": ((0, 0),)}, BadData, "two or more"),
        ({"tone": ((0, 0), (1, 0.9))}, BadData, "from 0 to 1"),
        ({"tone": ((0, 0), (0.5, 1.2), (1, 1))}, BadData, "increase"),
        ({"tone": ((-1, 0), (1, 1))}, BadData, "x from 0"),
        ({"tone": ((0, 0), (float("inf"), 1))}, BadData, "finite"),
        ({"tone": "filmic"}, UnknownName, "reinhard"),
        ({"tone": 7}, BadData, "two or more"),
        ({"tone": ((0, 0), (1, "x"))}, BadData, "two or more"),
        ({"tone": ((0, 0), (1,))}, BadData, "two or more"),
        ({"tone": ((0, 0), (1e4, 1))}, BadData, "at most 1000"),
        ({"shading": "no"}, OutOfRange, "True or False"),
        ({"defects": None}, UnknownName, "defects"),
        ({"demosaic": "learned", "table": "x"}, OutOfRange, "a FilterTable"),
    ],
)
def test_processor_refuses(changes, error, words):
    with pytest.raises(error, match=words):
        Processor(**changes)


def test_srgb_matrix_is_the_standard_one():
    # IEC 61966-2-1 prints four decimals, so half a unit of the last.
    printed = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    np.testing.assert_allclose(Display().xyz_from_rgb, printed, atol=5.1e-5)
    # The condition number is below 10: ten roundings of 1.1e-16, times that.
    np.testing.assert_allclose(
        Display().rgb_from_xyz @ Display().xyz_from_rgb, np.eye(3), atol=1e-14
    )
    x, y, z = Display().xyz_from_rgb.sum(1)
    assert (x / (x + y + z), y / (x + y + z), y) == pytest.approx((0.3127, 0.3290, 1), rel=ULPS)


def test_display_agrees_with_colour_science():
    import colour

    wide = Display("p3", ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)), (0.3127, 0.3290))
    judge = colour.normalised_primary_matrix(wide.primaries, wide.white)
    # The condition number of the primaries is about 10, and either side solves once: 10 x some ten roundings.
    np.testing.assert_allclose(wide.xyz_from_rgb, judge, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"white": (0.3, 0.3, 0.4)}, BadData),
        ({"white": (0.9, 0.3)}, OutOfRange),
        ({"primaries": ((0.2, 0.2), (0.3, 0.3), (0.4, 0.4))}, BadData),
        ({"white": (0.3, 0.0)}, OutOfRange),
        ({"white": (0.7, 0.2)}, BadData),
        ({"curve": "gamma"}, OutOfRange),
        ({"curve": 0.4}, OutOfRange),
        ({"luminance": 0.0}, OutOfRange),
        ({"luminance": float("nan")}, OutOfRange),
        ({"spectra": Spectrum([400, 700], [1, 1])}, BadData),
        ({"spectra": 5}, BadData),
        ({"primaries": (("a", 1), (0.3, 0.6), (0.15, 0.06))}, BadData),
    ],
)
def test_display_refuses(changes, error):
    with pytest.raises(error, match="display"):
        Display(**changes)


def test_monochrome_has_no_colour():
    mono = sensor(channels=("Y",), cfa=("Y",), qe=Spectrum([400, 700], [[0.5, 0.6]]))
    with pytest.raises(OutOfRange, match=r"processor\.color"):
        Camera("mono", Optics(2.0, 0.05), mono)
    assert Camera("mono", Optics(2.0, 0.05), mono, Processor(color="none")).display.name == "srgb"


def test_tolerance_presets_and_numbers():
    assert Tolerance.parse("preview") == Tolerance(p999_sigma=0.5)
    assert Tolerance.parse("video") == Tolerance(p999_sigma=0.1)
    assert Tolerance.parse("metrology") == Tolerance(max_sigma=0.01)
    assert Tolerance.parse("1e-4") == Tolerance.parse(1e-4) == Tolerance(rms=1e-4)
    assert Tolerance.parse(Tolerance(rms=0.1)) == Tolerance(rms=0.1)


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("vidoe", UnknownName, "did you mean 'video'"),
        ("fast!", UnknownName, "metrology, preview, video"),
        ("0", OutOfRange, "tolerance.rms = 0"),
        ("-1e-3", OutOfRange, "tolerance.rms"),
        ("nan", OutOfRange, "tolerance.rms"),
        ("inf", OutOfRange, "tolerance.rms"),
    ],
)
def test_tolerance_refuses(text, error, words):
    with pytest.raises(error, match=words):
        Tolerance.parse(text)


def test_tolerance_must_bind_something():
    with pytest.raises(OutOfRange, match="at least one"):
        Tolerance()


# ------------------------------------------------------------------------------------------- curves, built-in cameras

# The source array of every table in ISETCam's spectra, and what it is divided by: one is in percent.
SOURCES = {
    "mt9v024": ("cf_MT9V024_RGBW", 1),
    "iset-rgb": ("cf_RGB", 1),
    "ir-cut-phone": ("qe_ircf_public", 1),
    "ir-cut-schott": ("qe_irFilter_schott", 1),
    "cmos-photodetector": ("qe_cmosPhotodetectorQE", 100),
}


@pytest.mark.parametrize("name", sorted(CHANNELS))
def test_curves_are_fractions_with_a_letter_each(name):
    values = curve(name).values
    assert values.shape == ((len(CHANNELS[name]), 31) if CHANNELS[name] else (31,))
    assert values.min() >= 0 and 0.3 < values.max() <= 1


@pytest.mark.parametrize("name", sorted(CHANNELS))
def test_curves_are_those_of_the_source(name, shared_data):
    with np.load(shared_data / "isetcam" / "isetcam_spectra.npz") as spectra:
        array, divisor = SOURCES[name]
        np.testing.assert_array_equal(curve(name).values, spectra[array].T / divisor)
        np.testing.assert_array_equal(curve(name).wavelengths, spectra["wave"])


def test_unknown_curve():
    with pytest.raises(UnknownName, match="did you mean 'mt9v024'"):
        curve("mt9v034")


def test_every_built_in_camera_opens():
    assert len(camera_names()) == 14 and {*FIRST} < {*camera_names()}
    for name in camera_names():
        assert open_camera(name).name == name


@pytest.mark.parametrize("name", ["figure8", "machine-vision", "phone"])
def test_colour_cameras_see_red_green_and_blue_where_they_are(name):
    made = open_camera(name).sensor
    assert made.channels == ("R", "G", "B") and made.bayer_phase is not None
    red, green, blue = made.qe.at(np.array([610.0, 540.0, 460.0]))
    assert (
        red.argmax() == 0 and green.argmax() == 1 and blue.argmax() == 2
    )  # each is best in its own band


def test_figure8_is_the_camera_of_the_chapter():
    camera = open_camera("figure8")
    assert (camera.optics.f_number, camera.optics.focal_length, camera.optics.object_distance) == (
        2.4,
        3.9e-3,
        np.inf,
    )
    assert (camera.sensor.pixel_pitch, camera.sensor.fill_factor) == (1.4e-6, 0.75)
    assert (camera.optics.model, camera.processor.demosaic) == ("diffraction", "bilinear")


def test_pitches():
    pitches = {
        name: open_camera(name).sensor.pixel_pitch for name in ("phone", "machine-vision", "mono")
    }
    assert pitches == {"phone": 1.4e-6, "machine-vision": 3e-6, "mono": pytest.approx(5.86e-6)}


def test_phone_efficiency_is_filter_times_infrared_cut():
    made = open_camera("phone").sensor
    nodes = np.arange(400.0, 701.0, 10.0)
    expected = curve("mt9v024").at(nodes)[:3] * curve("ir-cut-phone").at(nodes)
    np.testing.assert_allclose(made.qe.at(nodes), expected, rtol=ULPS)
    assert (
        made.qe.at([700.0]).max() < 0.01 < 0.3 < curve("mt9v024").at([700.0]).max()
    )  # the infrared is cut


def test_mono_is_one_unfiltered_channel():
    made = open_camera("mono").sensor
    assert made.is_monochrome
    nodes = curve("mt9v024").wavelengths
    np.testing.assert_array_equal(made.qe.at(nodes)[0], curve("mt9v024").values[3])


@pytest.mark.parametrize("name", camera_names())
def test_built_in_cameras_count_nothing_beyond_their_tables(name):
    """So that they see photographs and lamps, whose light goes on into the ultraviolet and infrared."""
    assert open_camera(name).sensor.qe.at([300.0, 398.9, 701.1, 1000.0]).max() == 0


# ----------------------------------------------------------------------------------------------------- camera files

MINIMAL = """base = "none"
[optics]
f_number = 2.8
focal_length_mm = 4.5

[sensor]
pixel_pitch_um = 1.4
qe = "mt9v024"
full_well_e = 6000
bits = 10
"""


def written(tmp_path, text):
    path = tmp_path / "cam.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_minimal_file_takes_the_defaults(tmp_path):
    camera = open_camera(written(tmp_path, MINIMAL))
    assert camera.name == "cam"
    assert camera.optics == Optics(2.8, 4.5e-3)
    expected = Sensor(1.4e-6, camera.sensor.qe, 6000.0, 10)
    assert camera.sensor == expected
    assert (camera.processor, camera.display) == (Processor(), Display())


def test_every_key_reaches_its_field_in_si(tmp_path):
    camera = open_camera(
        written(
            tmp_path,
            """
name = "bench"
[optics]
f_number = 4
focal_length_mm = 50.0
model = "none"
transmission = {wavelengths_nm = [400, 700], values = [0.9, 0.8]}
relative_illumination = "none"
object_distance_m = 1.5
[sensor]
pixel_pitch_um = 5
fill_factor = 0.5
cfa = ["GB", "RG"]
qe = "iset-rgb"
exposure_time_ms = 20
full_well_e = 20000.5
bits = 14
black_level_dn = 512
gain_dn_per_e = 0.25
stacked = false
photodetector_centre = [0.1, -0.05]
offset = [0.5, 0.25]
vignetting = [[0.8, 0.9], [1, 0.7]]
microlens = {angles_deg = [0, 30], response = [1, 0.6], shift = 0.5}
auto_exposure = {method = "percentile", level = 0.8, percentile = 98, longest_ms = 40, most_gain = 16}
row_time_us = 15
binning = [2, 1]
binning_mode = "digital"
analog_gain = 2
analog_offset_e = 20
[noise]
photon = "exact"
dark_current_e_per_s = 0.1
temperature_c = 40
reference_temperature_c = 20
doubling_k = 6
read_e = 1.5
reset_e = 3
adc_dn = 0.7
row_e = 0.2
column_e = 0.1
telegraph_pixels = 0.01
telegraph_e = 12
telegraph_switching = 0.25
prnu = 0.01
row_prnu = 0.002
column_prnu = 0.003
dsnu_e = 0.5
row_dsnu_e = 0.4
column_dsnu_e = 0.3
hot_pixels = 0.001
hot_current_e_per_s = 200
dead_pixels = 0.0001
seed = 7
[processor]
defects = "detect"
shading = true
denoise = 0.5
demosaic = "adaptive"
white_balance = "gray-world"
color = "ridge"
training = "munsell"
target = "D50"
scaling = "normalised"
tone = [[0, 0], [0.5, 0.6], [1.2, 1]]
[display]
name = "projector"
primaries = [[0.65, 0.33], [0.3, 0.6], [0.15, 0.05]]
white = [0.33, 0.34]
curve = 2.4
luminance_cd_per_m2 = 48
""",
        )
    )
    optics, made = camera.optics, camera.sensor
    assert camera.name == "bench"
    assert dataclasses.replace(optics, transmission=1.0) == Optics(
        4.0, 0.05, "none", 1.0, "none", 1.5
    )
    assert optics.transmission_at([550.0])[0] == pytest.approx(0.85, rel=ULPS)
    assert made == Sensor(
        pixel_pitch=5e-6,
        qe=made.qe,
        full_well=20000.5,
        bits=14,
        cfa=("GB", "RG"),
        fill_factor=0.5,
        exposure_time=0.02,
        black_level=512,
        gain=0.25,
        centre=(0.1, -0.05),
        offset=(0.5, 0.25),
        vignetting=((0.8, 0.9), (1.0, 0.7)),
        microlens=made.microlens,
        auto_exposure=AutoExposure("percentile", 0.8, 98.0, 0.04, 16.0),
        row_time=15e-6,
        binning=(2, 1),
        binning_mode="digital",
        analog_gain=2.0,
        analog_offset=20.0,
        noise=Noise(
            photon="exact",
            dark_current=0.1,
            temperature=40.0,
            reference_temperature=20.0,
            doubling=6.0,
            read=1.5,
            reset=3.0,
            adc=0.7,
            row=0.2,
            column=0.1,
            prnu=0.01,
            row_prnu=0.002,
            column_prnu=0.003,
            dsnu=0.5,
            row_dsnu=0.4,
            column_dsnu=0.3,
            hot_pixels=0.001,
            hot_current=200.0,
            dead_pixels=0.0001,
            telegraph_pixels=0.01,
            telegraph=12.0,
            telegraph_switching=0.25,
            seed=7,
        ),
    )
    np.testing.assert_allclose(made.microlens.angles, [0, np.pi / 6], rtol=ULPS)
    assert (list(made.microlens.response), made.microlens.shift) == ([1, 0.6], 0.5)
    assert camera.processor == Processor(
        "detect",
        True,
        0.5,
        "adaptive",
        None,
        "gray-world",
        "ridge",
        "munsell",
        "D50",
        "normalised",
        ((0, 0), (0.5, 0.6), (1.2, 1)),
    )
    assert camera.display == Display(
        "projector", ((0.65, 0.33), (0.3, 0.6), (0.15, 0.05)), (0.33, 0.34), 2.4, 48.0
    )


def test_voltages_and_reset_noise_of_the_capacitor(tmp_path):
    text = (
        MINIMAL
        + "conversion_gain_uv_per_e = 50\nadc_range_v = 1\nphotodetector_size = [0.9, 0.5]\n"
        '[noise]\nreset_e = "kTC"\ntemperature_c = 27\n'
    )
    made = open_camera(written(tmp_path, text)).sensor
    assert made.gain_dn_per_electron == pytest.approx(50e-6 * 1023, rel=ULPS)
    assert made.noise.reset == pytest.approx(22.7442, rel=5e-6)  # by hand, see above
    assert made.photodetector == (0.9, 0.5) and made.fill_factor == 0.45


@pytest.mark.parametrize(
    ("name", "rows", "first"),
    [
        ("bayer-gbrg", ("GB", "RG"), "R"),
        ("mono", ("Y",), "Y"),
        ("rgbw", ("RG", "WB"), "R"),
        ("rgbn", ("RG", "NB"), "R"),
        ("quad-bayer", ("RRGG", "RRGG", "GGBB", "GGBB"), "R"),
        ("rccc", ("RW", "WW"), "R"),
        ("x-trans", ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"), "R"),
    ],
)
def test_mosaics_have_names(tmp_path, name, rows, first):
    curves = (
        "qe = {wavelengths_nm = [400, 700], "
        + ", ".join(f"{c} = [0.5, 0.4]" for c in "RGBWNY")
        + "}"
    )
    text = (
        MINIMAL.replace('qe = "mt9v024"', f'{curves}\ncfa = "{name}"')
        + '[processor]\ncolor = "none"\n'
    )
    made = open_camera(written(tmp_path, text)).sensor
    assert made.cfa == rows and made.channels[0] == first
    assert set(made.channels) == set("".join(rows))


def test_generalised_sensor_multiplies_its_parts_where_all_are_known(tmp_path):
    text = MINIMAL.replace(
        'qe = "mt9v024"',
        """
qe = {wavelengths_nm = [400, 500, 600, 700], B = [0.8, 0.4, 0.1, 0], R = [0, 0, 0.9, 0.9], G = [0.2, 0.8, 0.2, 0]}
photodetector = {wavelengths_nm = [350, 750], values = [0.4, 0.8]}
ir_cut = {wavelengths_nm = [450, 650, 655], values = [1, 1, 0]}
""",
    )
    made = open_camera(written(tmp_path, text)).sensor
    assert made.channels == ("R", "G", "B")  # by letter, whatever the order in the file
    np.testing.assert_array_equal(made.qe.wavelengths, [450, 500, 600, 650, 655])
    # By hand at 500 and 600 nm: photodetector 0.55 and 0.65, infrared cut 1.
    np.testing.assert_allclose(
        made.qe.at([500, 600]),
        np.array([[0, 0.9], [0.8, 0.2], [0.4, 0.1]]) * [0.55, 0.65],
        rtol=ULPS,
    )
    assert made.qe.at([440.0, 655.0, 700.0]).max() == 0


def test_efficiency_from_csv(tmp_path):
    (tmp_path / "mine.csv").write_text(
        "wavelength_nm,Y,R\n400,0.1,0.2\n550.5,0.5,0.3\n\n700,0.3,0.1\n"
    )
    text = (
        MINIMAL.replace('qe = "mt9v024"', 'qe = "mine.csv"\ncfa = ["Y"]')
        + '[processor]\ncolor = "none"\n'
    )
    made = open_camera(written(tmp_path, text)).sensor
    assert made.channels == ("Y",)
    np.testing.assert_array_equal(made.qe.wavelengths, [400, 550.5, 700])
    np.testing.assert_array_equal(made.qe.values, [[0.1, 0.5, 0.3]])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "bits = 10",
            "bits = 10\nexposuretime = 3",
            r"unknown key 'exposuretime' in \[sensor\]; did you mean 'exposure_time_ms'",
        ),
        (
            "bits = 10",
            "bits = 10\nzzz = 3",
            r"unknown key 'zzz' in \[sensor\]; known: pixel_pitch_um",
        ),
        ("[sensor]", "[sensr]", r"unknown section \[sensr\]; did you mean 'sensor'"),
        ("[optics]", "colour = 3\n[optics]", r"unknown section \[colour\]"),
        ("[optics]\n", "name = 3\n[optics]\n", "name = 3: wanted a text"),
        ("[optics]", "processor = 3\n[optics]", r"processor = 3: wanted a section \[processor\]"),
        ("bits = 10\n", "", r"\[sensor\] lacks bits"),
        (
            "f_number = 2.8\nfocal_length_mm = 4.5",
            "",
            r"\[optics\] lacks f_number, focal_length_mm",
        ),
        ("bits = 10", "bits = 10.0", r"\[sensor\] bits = 10.0: wanted a whole number"),
        ("bits = 10", "bits = true", r"\[sensor\] bits = True: wanted a whole number"),
        ("f_number = 2.8", 'f_number = "f/2.8"', r"\[optics\] f_number = 'f/2.8': wanted a number"),
        ("f_number = 2.8", "f_number = true", "wanted a number"),
        ("f_number = 2.8", f"f_number = 1{'0' * 400}", "wanted a smaller number"),
        ("f_number = 2.8", "f_number = -2.8", r"optics\.f_number = -2.8: allowed is"),
        ("f_number = 2.8", "f_number = nan", r"optics\.f_number = nan: allowed is"),
        (
            "f_number = 2.8",
            "f_number = 2.8\ntransmission = true",
            r"\[optics\] transmission = True: wanted",
        ),
        ("f_number = 2.8", "f_number = 2.8\ntransmission = 2", r"optics\.transmission"),
        (
            "f_number = 2.8",
            "f_number = 2.8\ntransmission = 'iset-rgb'",
            r"\[optics\] transmission: wanted one curve, got 3",
        ),
        ("f_number = 2.8", "f_number = 2.8\nf_number = 2.8", "line 4"),
        ("f_number = 2.8", "f_number = = 2.8", "not TOML: .*line 3"),
        (
            "bits = 10",
            "bits = 10\ncfa = 'RGGB'",
            r"\[sensor\] cfa: unknown mosaic 'RGGB'; known: bayer-bggr",
        ),
        (
            "bits = 10",
            "bits = 10\ncfa = 'xtrans'",
            r"\[sensor\] cfa: unknown mosaic 'xtrans'; did you mean 'x-trans'",
        ),
        (
            "bits = 10",
            "bits = 10\ncfa = 'mono'",
            "colour needs at least 3",
        ),
        (
            "bits = 10",
            "bits = 10\ncfa = ['RG', 3]",
            r"\[sensor\] cfa = \['RG', 3\]: wanted rows of letters, such as",
        ),
        # before there was a section [noise] its keys were the sensor's
        (
            "bits = 10",
            "bits = 10\nread_noise_e = 3",
            r"'read_noise_e' in \[sensor\]; did you mean 'read_e' in \[noise\]",
        ),
        (
            "bits = 10",
            "bits = 10\nphoton_noise = false",
            r"'photon_noise' in \[sensor\]; did you mean 'photon' in \[noise",
        ),
        (
            "bits = 10",
            "bits = 10\nprnu = 0.01",
            r"'prnu' in \[sensor\]; did you mean 'prnu' in \[noise\]",
        ),
        (
            "bits = 10",
            "bits = 10\ndsnu_e = 1",
            r"'dsnu_e' in \[sensor\]; did you mean 'dsnu_e' in \[noise\]",
        ),
        (
            "bits = 10",
            "bits = 10\ndark_current_e_per_s = 1",
            r"did you mean 'dark_current_e_per_s' in \[noise\]",
        ),
        ("bits = 10", "bits = 10\nfixed_pattern_seed = 1", r"did you mean 'seed' in \[noise\]"),
        (
            "bits = 10",
            "bits = 10\n[noise]\nread = 3",
            r"unknown key 'read' in \[noise\]; did you mean 'read_e'",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nprun = 0.1",
            r"unknown key 'prun' in \[noise\]; did you mean 'prnu'",
        ),
        (
            "bits = 10",
            "bits = 10\n[nosie]\nprnu = 0.1",
            r"unknown section \[nosie\]; did you mean 'noise'",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nbits = 9",
            r"'bits' in \[noise\]; did you mean 'bits' in \[sensor\]",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nread_e = '3'",
            r"\[noise\] read_e = '3': wanted a number",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nreset_e = 'ktc'",
            r"\[noise\] reset_e = 'ktc': wanted a number or \"kTC\"",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nreset_e = 'kTC'",
            r'reset_e = "kTC" needs \[sensor\] conversion_gain_uv_per_e',
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nphoton = 'poisson'",
            r"noise\.photon 'poisson'; known: exact, fast, none",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\nread_e = -1",
            r"noise\.read = -1 e-: allowed is 0 <= read",
        ),
        (
            "bits = 10",
            "bits = 10\n[noise]\ndead_pixels = 1.5",
            r"noise\.dead_pixels = 1\.5: allowed is 0 <= dead",
        ),
        (
            "bits = 10",
            "bits = 17",
            r"sensor\.bits = 17: allowed is a whole number, 1 <= bits <= 16, or 32",
        ),
        (
            "bits = 10",
            "bits = 10\nbinning = 2",
            r"\[sensor\] binning = 2: wanted a list of 2 whole numbers",
        ),
        (
            "bits = 10",
            "bits = 10\nauto_exposure = {method = 'peak'}",
            r"\[sensor\] auto_exposure: unknown exposure method",
        ),
        (
            "bits = 10",
            "bits = 10\nauto_exposure = {longest = 1}",
            "wanted a table of method, level, percentile, longest",
        ),
        (
            "bits = 10",
            "bits = 10\ngain_dn_per_e = 0.001\nblack_level_dn = 64",
            r"full_well = 6000 e- = 6 DN above black",
        ),
        (
            "bits = 10",
            "bits = 10\ncfa = ['RG', 'GX']",
            r"\[sensor\] qe has no curve for X; it has R, G, B, W",
        ),
        ("bits = 10", "bits = 10\ncfa = ['RG', 'B']", r"sensor\.cfa"),
        ("bits = 10", "bits = 10\ncfa = []", r"\[sensor\] cfa = \[\]"),
        ("bits = 10", "bits = 10\nstacked = 1", "wanted true or false"),
        ("bits = 10", "bits = 10\n[noise]\nphoton = 1", r"\[noise\] photon = 1: wanted a text"),
        ("bits = 10", "bits = 10\nexposure_time_ms = 'long'", 'wanted a number or "auto"'),
        (
            '"mt9v024"',
            '"mt9v034"',
            r"\[sensor\] qe: unknown curve 'mt9v034'; did you mean 'mt9v024'",
        ),
        (
            '"mt9v024"',
            '"cmos-photodetector"',
            r"\[sensor\] qe has no curve for B, G, R; it has one without a letter",
        ),
        ('"mt9v024"', '"mine.csv"', r"mine\.csv: no such file"),
        ('"mt9v024"', "{R = [1, 2]}", r"\[sensor\] qe: wanted wavelengths_nm"),
        (
            '"mt9v024"',
            "{wavelengths_nm = [400, 700], R = [0.1], G = [0.1, 0.2], B = [0.1, 0.2]}",
            "numbers with equal lengths",
        ),
        (
            '"mt9v024"',
            "{wavelengths_nm = [400, 700], R = ['a', 1], G = [0.1, 0.2], B = [0.1, 0.2]}",
            "numbers",
        ),
        (
            '"mt9v024"',
            "{wavelengths_nm = [700, 400], R = [0.1, 1], G = [0.1, 0.2], B = [0.1, 0.2]}",
            "increase strictly",
        ),
        (
            '"mt9v024"',
            "{wavelengths_nm = [400, 700], R = [0.1, nan], G = [0.1, 0.2], B = [0.1, 0.2]}",
            "NaN",
        ),
        (
            '"mt9v024"',
            '"mt9v024"\nir_cut = {wavelengths_nm = [800, 900], values = [1, 1]}',
            "no wavelengths in common",
        ),
        ("bits = 10", "bits = 10\n[processor]\ndemosaic = 'bilinaer'", "did you mean 'bilinear'"),
        ("bits = 10", "bits = 10\n[processor]\ntraining = 'munsel'", "did you mean 'munsell'"),
        ("bits = 10", "bits = 10\n[display]\nname = 'crt'", "unknown display 'crt'"),
        ("bits = 10", "bits = 10\n[display]\nname = 'srgb'\ncurve = 2.2", "is a known display"),
        ("bits = 10", "bits = 10\n[display]\ncurve = 'gamma'", "an exponent"),
        ("bits = 10", "bits = 10\n[display]\nprimaries = [[0.6, 0.3]]", "a list of 3 pairs"),
        ("bits = 10", "bits = 10\n[processor]\ntarget = 'D67'", "unknown light"),
        ("bits = 10", "bits = 10\n[processor]\ntone = [1, 2]", "the name of a tone curve, or"),
    ],
)
def test_bad_file_is_refused_by_file_and_key(tmp_path, old, new, words):
    assert old in MINIMAL
    with pytest.raises(BadFile, match=words) as caught:
        open_camera(written(tmp_path, MINIMAL.replace(old, new)))
    assert "cam.toml" in str(caught.value) or "mine.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "first line"),
        ("400,1,2\n", "first line"),
        ("wavelength_nm\n400\n", "first line"),
        ("wavelength_nm,R,G,B\n400,1,2\n", "4 numbers"),
        ("wavelength_nm,R,G,B\n400,a,2,3\n500,1,2,3\n", "4 numbers"),
        ("wavelength_nm,R,G,B\n", "at least 2 wavelengths"),
        ("wavelength_nm,R,G,B\n500,0,0,0\n400,0,0,0\n", "increase"),
    ],
)
def test_bad_csv_is_refused(tmp_path, content, words):
    (tmp_path / "mine.csv").write_text(content)
    with pytest.raises(BadFile, match=words) as caught:
        open_camera(written(tmp_path, MINIMAL.replace("mt9v024", "mine.csv")))
    assert "mine.csv" in str(caught.value)


def test_names_and_files_that_are_not_there(tmp_path):
    with pytest.raises(UnknownName, match="unknown camera 'phoen'; did you mean 'phone'"):
        open_camera("phoen")
    with pytest.raises(BadFile, match=r"none\.toml: no such file"):
        open_camera(tmp_path / "none.toml")
    with pytest.raises(BadFile):
        open_camera(tmp_path)  # a folder
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe[optics]")
    with pytest.raises(BadFile, match="not TOML"):
        open_camera(tmp_path / "bytes.toml")


@pytest.mark.parametrize("key", [f"{one}.{key}" for one, keys in SECTIONS.items() for key in keys])
def test_any_value_of_any_key_makes_a_camera_or_is_refused_in_a_line(key):
    camera = gs.open_camera("phone")
    odd = (0.7, True, "x", [1.0], {"a": 1}, None, [[1.0]], "", float("nan"), -1, 1e300)
    for value in odd:
        try:
            camera.with_(**{key: value})
        except gs.GpusimError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize(
    "text", ["", "[optics]", "[noise]", "optics = {f_number = 1.8}", "name = 'x'"]
)
def test_without_a_base_keys_are_the_phones(tmp_path, text):
    """Whatever the file says that the phone says too, or an empty section: the same camera."""
    phone = open_camera("phone")
    found = open_camera(written(tmp_path, text))
    assert digest(dataclasses.replace(found, name=phone.name, notes=())) == digest(phone)


def test_a_file_without_a_base_says_which_keys_are_the_phones(tmp_path):
    (note,) = open_camera(written(tmp_path, MINIMAL.replace('base = "none"', ""))).notes
    assert note == (
        "cam.toml has no base: cfa, qe_ends, ir_cut, black_level_dn, read_e, dark_current_e_per_s, prnu, dsnu_e, "
        "demosaic are the phone's"
    )
    assert open_camera(written(tmp_path, MINIMAL.replace('"none"', '"phone"'))).notes == ()
    bare = open_camera(written(tmp_path, MINIMAL))
    assert bare.notes == () and bare.sensor.noise.read == 0 and bare.sensor.black_level == 0


def test_a_base_without_a_base_is_the_phone_with_changes(tmp_path):
    (tmp_path / "below.toml").write_text("[optics]\nf_number = 4\n")
    found = open_camera(written(tmp_path, 'base = "below.toml"\n[noise]\nread_e = 1\n'))
    assert (found.optics.f_number, found.optics.focal_length, found.sensor.noise.read) == (
        4,
        4.44e-3,
        1,
    )


def test_a_calibration_without_a_base_has_its_own_focal_length(tmp_path):
    numbers = "{width = 64, height = 48, fx = 100, fy = 100, cx = 32, cy = 24}"
    found = open_camera(written(tmp_path, f"[optics]\ncalibration = {numbers}\n"))
    assert found.optics.focal_length == pytest.approx(100 * 1.4e-6)
