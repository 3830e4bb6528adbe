"""The colour transform against cases with known answers, and against colour-science with a real camera."""

import numpy as np
import pytest

from gpusim.data.colorimetry import cmf
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum, energy_from_photons, photons_from_energy
from gpusim.kernels.processor.color import color
from gpusim.planner.color import color_matrix

pytestmark = pytest.mark.filterwarnings("ignore:[^$]*Aligning", "ignore:[^$]*Matplotlib")  # colour's chatter
D65, A = (photons_from_energy(illuminant(name)) for name in ("D65", "A"))
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
FINE = np.arange(3600, 8301) / 10  # the step of the planner's quadrature


@pytest.fixture(scope="module")
def nikon(shared_data):
    """A real camera: Nikon D100 filters on a CMOS photodiode behind an infrared filter."""
    with np.load(shared_data / "isetcam" / "isetcam_spectra.npz") as spectra:
        channels = spectra["cf_NikonD100"].T * spectra["qe_photodetector"] * spectra["qe_ircf_public"]
        return Spectrum(spectra["wave"], channels, "Nikon D100")


def some_camera(channels):
    """Smooth overlapping filters."""
    centres = np.linspace(450, 610, channels)[:, None] if channels > 1 else np.array([[550]])
    return Spectrum(WAVELENGTHS, 0.5 * np.exp(-(((WAVELENGTHS - centres) / 45) ** 2)))


def as_colorimeter():
    """A camera whose efficiencies are a mixture of the matching functions per photon: it can be inverted exactly."""
    mixture = np.array([[0.5, 0.2, 0.1], [0.1, 0.6, 0.05], [0.0, 0.1, 0.4]])
    return Spectrum(FINE, mixture @ cmf().at(FINE) / FINE * 560, "colorimeter")


def responses(camera, light, surfaces, nodes):
    """Camera responses by plain trapezoids on a fine grid, normalised to white."""
    grid = np.arange(nodes[0], nodes[-1] + 0.05, 0.1)
    seen = camera.at(grid) * light.at(grid)
    white = np.trapezoid(seen, grid).max()
    return np.trapezoid(seen[:, None] * surfaces.at(grid), grid) / white


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("light", [D65, A], ids=["D65", "A"])
def test_perfect_white_is_display_white(channels, light):
    transform = color_matrix(some_camera(channels), light, reflectances("munsell"))
    # The constraint is met to rounding, 2^-52 times the largest products: entries of six channels reach thousands.
    np.testing.assert_allclose(transform.matrix @ transform.white, 1, atol=2.0**-46 * np.abs(transform.matrix).max())
    assert transform.white.max() == 1
    assert transform.xyz.shape == transform.matrix.shape == (3, channels)
    assert (transform.xyz @ transform.white)[1] == pytest.approx(1, abs=1e-12)


def test_a_colorimeter_is_inverted_exactly():
    """Then the residual is zero and L H-mixture = 1: XYZ is reproduced for surfaces outside the training too."""
    light = Spectrum(FINE, D65.at(FINE))  # energy and photons agree only at a table's entries
    transform = color_matrix(as_colorimeter(), light, reflectances("munsell"), target_light=light)
    mixture = np.linalg.inv(transform.xyz)
    # Rows of the mixture are known up to one common factor (the normalisation to white).
    expected = np.array([[0.5, 0.2, 0.1], [0.1, 0.6, 0.05], [0.0, 0.1, 0.4]])
    # XYZ of the 64 chips have condition number ~30, their square enters no step (QR): rounding stays below 1e-11.
    np.testing.assert_allclose(mixture / mixture[0, 0] * 0.5, expected, atol=1e-10)


def test_scales_of_light_and_efficiency_cancel():
    base = color_matrix(some_camera(3), A, reflectances("munsell")).matrix
    scaled = color_matrix(Spectrum(WAVELENGTHS, 1e-3 * some_camera(3).values), A.scaled(1e20), reflectances("munsell"))
    np.testing.assert_allclose(scaled.matrix, base, rtol=1e-11)  # condition ~1e3 times 2^-52


def test_no_matrix_with_the_same_white_fits_the_training_better():
    surfaces, camera = reflectances("munsell"), some_camera(3)
    transform = color_matrix(camera, D65, surfaces)
    seen = responses(camera, D65, surfaces, surfaces.wavelengths)
    wanted = responses(Spectrum(cmf().wavelengths, cmf().values), energy_from_photons(D65), surfaces,
                       surfaces.wavelengths)
    wanted /= responses(cmf(), energy_from_photons(D65), Spectrum([400, 700], [[1, 1]]), [400, 700])[1]
    best = np.sum((transform.xyz @ seen - wanted) ** 2)
    random = np.random.default_rng(1)
    for _ in range(50):
        step = random.normal(0, 1e-2, (3, 3))
        step -= np.outer(step @ transform.white, transform.white) / (transform.white @ transform.white)
        # 1e-6: the product-integrated weights of the planner and this trapezoid differ by the spline between nodes.
        assert np.sum(((transform.xyz + step) @ seen - wanted) ** 2) > best * (1 - 1e-6)


def test_monochrome_gives_gray():
    transform = color_matrix(Spectrum(WAVELENGTHS, np.full(31, 0.4)), A, reflectances("munsell"))
    np.testing.assert_allclose(transform.matrix, 1, atol=1e-12)  # rounding


def checker_differences(camera, light, training):
    """CIEDE2000 of the 24 ColorChecker patches, photographed in `light` and shown as if in D65."""
    import colour

    patches = list(colour.SDS_COLOURCHECKERS["ISO 17321-1"].values())
    nodes = np.arange(400.0, 701.0, 5.0)
    shape = colour.SpectralShape(400, 700, 5)
    surfaces = Spectrum(nodes, [patch.copy().interpolate(shape).values for patch in patches])
    transform = color_matrix(camera, light, training)
    rgb = color(responses(camera, light, surfaces, nodes)[:, None], transform.matrix, device="numpy")[:, 0].T
    shown = rgb @ DISPLAYS["srgb"].xyz_from_rgb.T
    # The truth shares nothing with gpusim: ASTM E308 tables of colour-science.
    true = np.array([colour.sd_to_XYZ(patch, illuminant=colour.SDS_ILLUMINANTS["D65"]) for patch in patches]) / 100
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return colour.delta_E(colour.XYZ_to_Lab(shown, white), colour.XYZ_to_Lab(true, white), method="CIE 2000")


def test_colorimeter_shows_the_colorchecker_as_it_is():
    """The whole chain without a camera's error.

    What is left: the truth integrates 360 .. 780 nm and the training surfaces end at 400 and 700 nm (the eye has 0.2 %
    of its luminous and 1.6 % of its z response outside), and interpolation of 10 nm tables. Below 0.3 no eye sees it.
    """
    assert checker_differences(as_colorimeter(), D65, reflectances("munsell")).max() < 0.3


def test_real_camera_on_the_colorchecker_in_daylight(nikon):
    """A linear transform of a consumer camera errs by 1 to 2 on average, rarely above 6, on the ColorChecker.

    Range of published values: Jiang, Liu, Gu & Suesstrunk 2013 (WACV, 28 cameras); Finlayson, Mackiewicz & Hurlbert
    2015 (IEEE TIP 24, table II: linear 3 x 3, CIELUV 1.5 .. 1.9 mean).
    """
    errors = checker_differences(nikon, D65, reflectances("objects"))
    assert errors.mean() < 2.0
    assert errors.max() < 6.0


def test_real_camera_keeps_surface_colors_in_tungsten_light(nikon):
    """Without the transform for its light, tungsten is orange: the matrix for D65 must be several times worse."""
    in_tungsten = checker_differences(nikon, A, reflectances("objects"))
    wrong = color_matrix(nikon, D65, reflectances("objects"))
    white = responses(nikon, A, Spectrum([400, 700], [[1, 1]]), [400, 700])[:, 0]
    assert (wrong.matrix @ white)[2] < 0.5  # a third of D65's blue is left, relative to red
    assert in_tungsten.mean() < 4.0


def noise_of_white(transform):
    """Standard deviation of each display primary per that of a white's strongest channel, shot noise alone."""
    return np.sqrt(transform.matrix**2 @ transform.white)


@pytest.mark.parametrize("light", [D65, A], ids=["D65", "A"])
def test_a_clear_channel_helps_color_without_its_noise(light, monkeypatch):
    """Measured red, green, blue and clear curves behind an infrared cut, against the first three alone.

    Without noise the fourth channel can only help: no surface is reproduced worse on average. Least squares alone buys
    that with differences of nearly dependent channels. Judged at the same exposure, the clear channel at its full well,
    noise of red, green and blue alone is 1 / sqrt(their white) larger. The fourth channel may cost a third more than
    that in the worst primary, as its error does not vanish either; it was six times without the noise term.
    """
    curves, cut = curve("mt9v024"), curve("ir-cut-phone")
    rgbw = Spectrum(curves.wavelengths, curves.values * cut.values, "MT9V024")
    rgb = Spectrum(curves.wavelengths, rgbw.values[:3], "MT9V024, three of four")
    four, three = (color_matrix(camera, light, reflectances("objects")) for camera in (rgbw, rgb))
    errors = [checker_differences(camera, light, reflectances("objects")).mean() for camera in (rgbw, rgb)]
    assert errors[0] <= errors[1] + 1e-9
    np.testing.assert_allclose(four.matrix @ four.white, 1, atol=1e-13)  # white is met exactly: rounding of the sums
    same_exposure = noise_of_white(three).max() / np.sqrt(four.white[:3].max())
    assert noise_of_white(four).max() < 4 / 3 * same_exposure
    monkeypatch.setattr("gpusim.planner.color.WHITE_ELECTRONS", 1e30)
    assert noise_of_white(color_matrix(rgbw, light, reflectances("objects"))).max() > 2 * same_exposure


def test_bad_training_is_refused_in_one_line():
    camera, munsell = some_camera(3), reflectances("munsell")
    few = Spectrum(munsell.wavelengths, munsell.values[:2])
    same = Spectrum(munsell.wavelengths, np.outer(np.arange(1, 6), munsell.values[0]) / 6)
    infrared = Spectrum([800, 900], np.ones((3, 2)))
    for qe, surfaces in ((camera, few), (camera, same), (infrared, munsell)):
        with pytest.raises(BadData) as refusal:
            color_matrix(qe, D65, surfaces)
        assert "\n" not in str(refusal.value)


def test_ceiling_keeps_saturated_highlights_neutral():
    """At saturation every channel reads 1; clipped at the white's response it renders gray instead of tinted."""
    transform = color_matrix(some_camera(3), A, reflectances("munsell"))
    saturated = np.ones((3, 1, 1))
    tinted = color(saturated, transform.matrix, device="numpy").ravel()
    neutral = color(saturated, transform.matrix, ceiling=transform.white, device="numpy").ravel()
    assert np.ptp(tinted) > 0.1
    np.testing.assert_allclose(neutral, 1, atol=1e-12)
