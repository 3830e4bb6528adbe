"""Lights, colorimetry and measured reflectances against colour-science, ISETCam and closed forms."""

import warnings

import numpy as np
import pytest

from gpusim.data.colorimetry import cmf, tables, xyz
from gpusim.data.lights import blackbody, daylight, illuminant, illuminant_names, white_radiance
from gpusim.data.reflectances import reflectances
from gpusim.data.srgb import srgb_primaries, srgb_to_xyz
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.spectrum import (
    BOLTZMANN,
    LIGHT_SPEED,
    PLANCK,
    Spectrum,
    energy_from_photons,
    photons_from_energy,
)


@pytest.fixture(scope="module")
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about optional packages
        import colour
    return colour


@pytest.fixture(scope="module")
def isetcam(data):
    return np.load(data / "isetcam_illuminants.npz")


# ---- tables


def test_observer_is_the_table_of_colour_science(colour):
    theirs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    np.testing.assert_array_equal(cmf().wavelengths, theirs.wavelengths)
    np.testing.assert_array_equal(cmf().values, theirs.values.T)


def test_every_cie_illuminant_is_the_table_of_colour_science(colour):
    names = [name for name in colour.SDS_ILLUMINANTS if not name.startswith("ISO")]
    assert illuminant_names()[:-2] == names and {"A", "D65", "E", "FL3.15", "LED-B1", "HP5"} <= set(
        names
    )
    for name in names:
        np.testing.assert_array_equal(
            illuminant(name).wavelengths, colour.SDS_ILLUMINANTS[name].wavelengths
        )
        np.testing.assert_array_equal(
            illuminant(name.lower()).values, colour.SDS_ILLUMINANTS[name].values
        )


def test_colorchecker_is_the_table_of_colour_science(colour):
    theirs = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    np.testing.assert_array_equal(
        reflectances("colorchecker").values, [patch.values for patch in theirs.values()]
    )
    assert tables("cie")["colorchecker_names"].tolist() == list(theirs)


def test_observer_and_daylight_basis_are_those_of_isetcam(isetcam):
    np.testing.assert_array_equal(cmf().at(isetcam["wave"]).T, isetcam["XYZ_energy_cmf"])
    basis = Spectrum(tables("cie")["daylight_wavelengths"], tables("cie")["daylight"])
    np.testing.assert_array_equal(basis.at(isetcam["wave"]).T, isetcam["cieDaylightBasis"])


@pytest.mark.parametrize(
    "name, count",
    [
        ("macbeth", 24),
        ("munsell", 64),
        ("dupont", 120),
        ("objects", 170),
        ("nature", 79),
        ("skin", 19),
        ("colorchecker-sg", 140),
        ("colorchecker", 24),
    ],
)
def test_reflectances_are_physical(name, count):
    samples = reflectances(name)
    assert samples.values.shape[0] == count
    assert samples.values.min() > 0 and samples.values.max() < 1


def test_reflectances_are_isetcams(shared_data):
    theirs = np.load(shared_data / "isetcam" / "isetcam_reflectances.npz")
    for name, key in (
        ("munsell", "MunsellSamples_Vhrel"),
        ("nature", "Nature_Vhrel"),
        ("macbeth", "macbethChart"),
    ):
        wanted = Spectrum(theirs["wave"], theirs[f"refl_{key}"].T).at(
            reflectances(name).wavelengths
        )
        # Stored as float32: 2^-24 of values below 1.
        np.testing.assert_allclose(reflectances(name).values, wanted, rtol=0, atol=2.0**-24)


# ---- lights


@pytest.mark.parametrize("temperature", [4000, 5000, 6504, 7000, 7001, 9000, 25000])
def test_daylight_is_that_of_colour_science(colour, temperature):
    theirs = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(temperature))
    # The same formula in float64, values about 100: a few units in the last place.
    np.testing.assert_allclose(daylight(temperature).values, theirs.values, rtol=0, atol=1e-12)


def test_daylight_reproduces_the_published_d65():
    published = illuminant("D65")
    computed = daylight(6500 * 1.4388 / 1.4380)  # the radiation constant's change since 1931
    # The published values have six digits, 0.0005 where they exceed 100, and between the original 10 nm nodes they were
    # averaged from rounded ones: once more as much.
    np.testing.assert_allclose(
        computed.at(published.wavelengths), published.values, rtol=0, atol=1e-3
    )


def test_daylight_agrees_with_isetcam_but_for_the_rounding_of_its_factors(isetcam):
    wave = isetcam["wave"]
    s1, s2 = Spectrum(tables("cie")["daylight_wavelengths"], tables("cie")["daylight"][1:]).at(wave)
    for temperature, theirs in zip(
        isetcam["daylight_T"], isetcam["daylight_energy"].T, strict=True
    ):
        ours = daylight(temperature).at(wave)
        theirs = theirs * 100 / theirs[wave == 560]
        # CIE 15 rounds M1 and M2 to three decimals, ISETCam does not: each may differ by 0.0005.
        assert (np.abs(ours - theirs) <= 0.0005 * (np.abs(s1) + np.abs(s2)) + 1e-9).all()


def test_blackbody_agrees_with_isetcam_but_for_the_constants(isetcam):
    wave = isetcam["wave"]
    # ISETCam has c2 = 1.438786e-2 m K, rounded before 2019; gpusim has h c / k of the exact SI constants. Planck's law
    # holds c2 only as c2 / T, so at this temperature ours must be theirs.
    ratio = PLANCK * LIGHT_SPEED / BOLTZMANN / 1.438786e-2
    assert abs(ratio - 1) > 5e-6
    for temperature, theirs in zip(isetcam["bb_T"], isetcam["blackbody_energy"].T, strict=True):
        ours = blackbody(temperature * ratio, wave).values
        # float64; the ratio's own rounding is amplified by x = c2 / (lambda T) <= 18.
        np.testing.assert_allclose(theirs * 100 / theirs[wave == 560], ours, rtol=1e-13)


def test_blackbody_obeys_wien_and_stefan_boltzmann():
    wavelengths = np.arange(100.0, 60000.0, 0.5)
    power = blackbody(5000, wavelengths).values
    # Wien: 2.897771955e-3 m K (CODATA 2018), to half the step.
    assert wavelengths[power.argmax()] == pytest.approx(2.897771955e6 / 5000, abs=0.5)
    planck = (
        2
        * PLANCK
        * LIGHT_SPEED**2
        / 560e-9**5
        / np.expm1(PLANCK * LIGHT_SPEED / (BOLTZMANN * 5000 * 560e-9))
    )
    total = planck * (power / 100).sum() * 0.5e-9
    # sigma T^4 / pi; the tail beyond 60 um is (15 / pi^4) x^3 / 3 with x = 0.048: 6e-6 of the whole.
    assert total == pytest.approx(5.670374419e-8 * 5000**4 / np.pi, rel=1e-5)


@pytest.mark.parametrize(
    "name", ["D65", "daylight-5000K", "blackbody-3200K", "BLACKBODY-3200k", "Daylight-6503.6K"]
)
def test_light_at_given_wavelengths(name):
    nodes = [420.0, 560.0, 617.0]
    light = illuminant(name, nodes)
    np.testing.assert_array_equal(light.wavelengths, nodes)
    assert light.values[1] == 100
    # Its own table, linear between nodes of 1 nm: (1 nm)^2 / 8 times the second derivative, below 1e-4 relative here.
    np.testing.assert_allclose(light.values, illuminant(name).at(nodes), rtol=1e-4)


@pytest.mark.parametrize(
    "name, message",
    [
        ("D66", "did you mean 'D65'?"),
        ("fl13", "unknown light 'fl13'"),
        ("", "unknown light ''"),
        ("blackbody", "did you mean 'blackbody-<T>K'?"),
        ("daylight-K", "did you mean 'daylight-<T>K'?"),
    ],
)
def test_unknown_light(name, message):
    with pytest.raises(UnknownName) as error:
        illuminant(name)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["daylight-3999K", "daylight-25001K", "blackbody-299K", "blackbody-100001K"]
)
def test_temperature_out_of_range(name):
    with pytest.raises(OutOfRange, match=r"temperature = \d+ K: allowed is"):
        illuminant(name)


# ---- tristimulus values


def test_xyz_is_that_of_colour_science(colour):
    for name in ("A", "D50", "D65", "E"):
        light = illuminant(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that it aligns the tables
            theirs = colour.sd_to_XYZ(colour.SDS_ILLUMINANTS[name], method="Integration")
        # They sum over 360 .. 780 nm at 1 nm, the light interpolated by Sprague's polynomials rather than linearly: the
        # sums differ by up to (5 nm)^2 / 12 of the light's second derivative, some 1e-4 of the value for daylight.
        np.testing.assert_allclose(xyz(light) / xyz(light)[1], theirs / theirs[1], rtol=2e-4)


def test_white_point_of_d65_is_cies():
    white = xyz(illuminant("D65"))
    # CIE 15:2018, table 9.1: x = 0.31272, y = 0.32903, to the last digit given.
    assert white[:2] / white.sum() == pytest.approx([0.31272, 0.32903], abs=1e-5)


def test_xyz_is_exact_for_its_tables():
    # A light of one narrow triangle, 40 times narrower than the step of the observer's table: area x observer there.
    line = Spectrum([555.0, 555.0125, 555.025], [0, 80.0, 0])
    # The observer is linear within 555 .. 556 nm, so its mean over the symmetric triangle is its value in the middle.
    wanted = 683 * 1.0 * cmf().at(555.0125)
    np.testing.assert_allclose(xyz(line), wanted, rtol=1e-10)


def test_xyz_of_reflectances_in_a_light():
    samples = reflectances("munsell")
    light = illuminant("FL11")
    got = xyz(samples, light)
    grid = np.arange(400, 700.0001, 0.01)
    # Trapezoids of 0.01 nm on piecewise cubic products: errors of (0.01)^2 / 12 of the second derivative.
    wanted = 683 * np.trapezoid(
        samples.at(grid)[:, None] * light.at(grid) * cmf().at(grid), dx=0.01
    )
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


def test_xyz_without_overlap_is_dark():
    np.testing.assert_array_equal(xyz(Spectrum([900, 1000], [[1, 1], [2, 2]])), np.zeros((2, 3)))


@pytest.mark.parametrize("name", ["A", "D65", "FL11", "LED-B3", "blackbody-2000K"])
def test_white_has_the_luminance_asked_for(name):
    white = white_radiance(illuminant(name), 250.0)
    # Energy and photons there and back, the same integral: rounding.
    assert xyz(energy_from_photons(white))[1] == pytest.approx(250, rel=1e-13)


def test_one_candela_of_green():
    # By the definition of the candela 540 THz has 683 lm/W. At 555 nm y = 1 too (CIE 1931), so 683 cd m-2 are
    # 1 W sr-1 m-2 = 1 / (h c / 555 nm) photons.
    white = white_radiance(Spectrum([554.99, 555, 555.01], [0, 1.0, 0]), 683.0)
    photons = np.trapezoid(white.values, white.wavelengths)
    # h c = 1.98644586e-25 J m (CODATA 2018, nine digits); y is within 1e-6 of 1 there, the wavelength within 2e-5.
    assert photons == pytest.approx(555e-9 / 1.98644586e-25, rel=2e-5)


@pytest.mark.parametrize("name, key", [("E", "equal_energy"), ("C", "illuminant_c")])
def test_white_radiance_agrees_with_isetcam_but_for_its_sum(isetcam, name, key):
    ours = energy_from_photons(white_radiance(illuminant(name), 100.0)).at(isetcam["wave"])
    theirs = isetcam[f"e_{key}"]
    # ISETCam takes the luminance as a sum over 400, 410 .. 700 nm instead of the integral over 360 .. 830 nm. With this
    # sum for ours, both are the same but for ISETCam's single precision, 6e-8.
    by_sum = 683 * 10 * (ours * isetcam["vlambda"]).sum()
    assert by_sum != pytest.approx(100, rel=1e-4)
    np.testing.assert_allclose(theirs, ours * 100 / by_sum, rtol=2e-7)


def test_photons_agree_with_isetcam_but_for_plancks_constant(isetcam):
    ours = photons_from_energy(Spectrum(isetcam["wave"], isetcam["e_d65"])).values
    # ISETCam has h = 6.626176e-34 J s (CODATA 1973), gpusim the exact 6.62607015e-34.
    np.testing.assert_allclose(isetcam["q_d65"], ours * PLANCK / 6.626176e-34, rtol=1e-9)
    assert np.abs(isetcam["q_d65"] / ours - 1).min() > 1.5e-5


@pytest.mark.parametrize("luminance", [0, -1.0, np.nan, np.inf])
def test_luminance_out_of_range(luminance):
    with pytest.raises(OutOfRange, match="luminance"):
        white_radiance(illuminant("D65"), luminance)


def test_invisible_light_has_no_luminance():
    with pytest.raises(OutOfRange, match="luminous power"):
        white_radiance(Spectrum([900, 1000], [1, 1]), 100)


# ---- sRGB


def test_srgb_matrix_is_the_standards():
    # IEC 61966-2-1, to four decimals for a white point of four decimals; the exact D65 moves them by up to 3e-4.
    standard = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    np.testing.assert_allclose(srgb_to_xyz(), standard, rtol=0, atol=3e-4)


def test_srgb_primaries_have_their_chromaticities_and_make_white():
    from scipy.interpolate import CubicSpline

    primaries, light = srgb_primaries(), illuminant("D65")
    assert primaries.values.min() >= 0 and primaries.values.max() <= 1
    np.testing.assert_allclose(primaries.values.sum(0), 1, rtol=0, atol=1e-15)  # two roundings
    grid = np.arange(360, 780.001, 0.02)
    spectra = CubicSpline(primaries.wavelengths, primaries.values.T)(grid).T
    assert spectra.min() > -0.01 and spectra.max() < 1.01  # as the docstring of srgb_primaries says
    colours = np.trapezoid(spectra[:, None] * light.at(grid) * cmf().at(grid), dx=0.02)
    # Trapezoids of 0.02 nm against the exact integral of linear tables of 0.1 nm: 1e-7.
    np.testing.assert_allclose(
        colours[:, :2] / colours.sum(1, keepdims=True),
        [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]],
        rtol=0,
        atol=1e-6,
    )


def test_srgb_primaries_are_the_smoothest():
    from scipy.interpolate import CubicSpline
    from scipy.optimize import linprog

    primaries, light = srgb_primaries(), illuminant("D65")
    count = len(primaries.wavelengths)
    fine = np.linspace(360, 780, 4201)
    cardinal = CubicSpline(primaries.wavelengths, np.eye(count))(fine).T
    responses = xyz(Spectrum(fine, cardinal), light).T / xyz(light)[1]
    red, green, blue = primaries.values
    second = np.diff(np.eye(count), axis=0).T @ np.diff(np.eye(count), axis=0)
    # Gradient of the summed squared differences of red, blue and green = 1 - red - blue.
    gradient = 2 * np.concatenate([second @ red - second @ green, second @ blue - second @ green])
    # A convex function is least where no admissible point lies downhill of its gradient.
    best = linprog(
        gradient,
        A_ub=np.hstack([np.eye(count)] * 2),
        b_ub=np.ones(count),
        bounds=(0, 1),
        A_eq=np.kron(np.eye(2), responses),
        b_eq=np.concatenate([responses @ red, responses @ blue]),
    )
    assert best.status == 0
    # The roughness is about 1; the admissible set is about 1 wide, the solver stops at 1e-7 of each constraint.
    assert best.fun >= gradient @ np.concatenate([red, blue]) - 1e-4
    shifted = gradient @ (
        np.concatenate([red, blue]) + 1e-3 * np.random.default_rng(1).normal(size=2 * count)
    )
    assert abs(shifted - best.fun) > 1e-4  # the test can tell another point
