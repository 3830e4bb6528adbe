"""The colour transform against cases with known answers, and against colour-science with a real camera."""

import numpy as np
import pytest

from gpusim.color.color import LIGHTS, METHODS, color_matrix, transform_set
from gpusim.color.root_polynomial import EXPONENTS
from gpusim.data.colorimetry import BRADFORD, cmf
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import product_weights
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum, energy_from_photons, photons_from_energy
from gpusim.kernels.processor.color import color

pytestmark = pytest.mark.filterwarnings(
    "ignore:[^$]*Aligning", "ignore:[^$]*Matplotlib"
)  # colour's chatter
D65, A = (photons_from_energy(illuminant(name)) for name in ("D65", "A"))
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
KEEP_WHITE = ("white-preserving", "cielab", "diagonal", "fixed-diagonal")
FINE = np.arange(3600, 8301) / 10  # the step of the planner's quadrature


@pytest.fixture(scope="module")
def nikon(shared_data):
    """A real camera: Nikon D100 filters on a CMOS photodiode behind an infrared filter."""
    with np.load(shared_data / "isetcam" / "isetcam_spectra.npz") as spectra:
        channels = (
            spectra["cf_NikonD100"].T * spectra["qe_photodetector"] * spectra["qe_ircf_public"]
        )
        return Spectrum(spectra["wave"], channels, "Nikon D100")


def some_camera(channels):
    """Smooth overlapping filters."""
    centres = np.linspace(450, 610, channels)[:, None] if channels > 1 else np.array([[550]])
    return Spectrum(WAVELENGTHS, 0.5 * np.exp(-(((WAVELENGTHS - centres) / 45) ** 2)))


def as_colorimeter():
    """A camera whose efficiencies are a mixture of the matching functions per photon: it can be inverted exactly."""
    mixture = np.array([[0.5, 0.2, 0.1], [0.1, 0.6, 0.05], [0.0, 0.1, 0.4]])
    return Spectrum(FINE, mixture @ cmf().at(FINE) / FINE * 560, "colorimeter")


def rgb_camera():
    """Measured red, green and blue curves behind an infrared cut."""
    curves, cut = curve("mt9v024"), curve("ir-cut-phone")
    return Spectrum(curves.wavelengths, curves.values[:3] * cut.values, "MT9V024")


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
    np.testing.assert_allclose(
        transform.matrix @ transform.white, 1, atol=2.0**-46 * np.abs(transform.matrix).max()
    )
    assert transform.white.max() == 1
    assert transform.xyz.shape == transform.matrix.shape == (3, channels)
    assert (transform.xyz @ transform.white)[1] == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("light", ["A", "D65", "FL11", "LED-B3"])
@pytest.mark.parametrize("method", KEEP_WHITE)
def test_white_is_kept_by_the_methods_that_promise_it(method, light):
    transform = color_matrix(rgb_camera(), light, "objects", method=method)
    # rounding: entries below 10, condition of the display's primaries below 10
    np.testing.assert_allclose(transform.matrix @ transform.white, 1, atol=100 * 2.0**-52)
    assert (transform.xyz @ transform.white)[1] == pytest.approx(1, abs=100 * 2.0**-52)


@pytest.mark.parametrize(
    "method", [method for method in METHODS if method not in ("diagonal", *EXPONENTS)]
)
def test_a_colorimeter_is_inverted_exactly(method):
    """Then the residual is zero and L H-mixture = 1: XYZ is reproduced for surfaces outside the training too."""
    light = Spectrum(FINE, D65.at(FINE))  # energy and photons agree only at a table's entries
    # snr: the ridge is 1e-18 of the responses' squares, below rounding
    transform = color_matrix(
        as_colorimeter(), light, "munsell", target_light=light, method=method, snr=1e9
    )
    mixture = np.linalg.inv(transform.xyz)
    # Rows of the mixture are known up to one common factor (the normalisation to white).
    expected = np.array([[0.5, 0.2, 0.1], [0.1, 0.6, 0.05], [0.0, 0.1, 0.4]])
    # XYZ of the 64 chips have condition number ~30, their square enters no step (QR): rounding stays below 1e-11.
    np.testing.assert_allclose(mixture / mixture[0, 0] * 0.5, expected, atol=1e-10)


def test_scales_of_light_and_efficiency_cancel():
    base = color_matrix(some_camera(3), A, reflectances("munsell")).matrix
    scaled = color_matrix(
        Spectrum(WAVELENGTHS, 1e-3 * some_camera(3).values), A.scale(1e20), reflectances("munsell")
    )
    np.testing.assert_allclose(scaled.matrix, base, rtol=1e-11)  # condition ~1e3 times 2^-52


def test_no_matrix_with_the_same_white_fits_the_training_better():
    surfaces, camera = reflectances("munsell"), some_camera(3)
    transform = color_matrix(camera, D65, surfaces)
    seen = responses(camera, D65, surfaces, surfaces.wavelengths)
    wanted = responses(
        Spectrum(cmf().wavelengths, cmf().values),
        energy_from_photons(D65),
        surfaces,
        surfaces.wavelengths,
    )
    wanted /= responses(
        cmf(), energy_from_photons(D65), Spectrum([400, 700], [[1, 1]]), [400, 700]
    )[1]
    best = np.sum((transform.xyz @ seen - wanted) ** 2)
    random = np.random.default_rng(1)
    for _ in range(50):
        step = random.normal(0, 1e-2, (3, 3))
        step -= np.outer(step @ transform.white, transform.white) / (
            transform.white @ transform.white
        )
        # 1e-6: the product-integrated weights of the planner and this trapezoid differ by the spline between nodes.
        assert np.sum(((transform.xyz + step) @ seen - wanted) ** 2) > best * (1 - 1e-6)


def training(camera, light, surfaces):
    """Responses and white of the camera, XYZ and white in D65, by the planner's own quadrature."""
    weights = product_weights(surfaces.wavelengths, camera, light)
    eye = product_weights(surfaces.wavelengths, cmf(), energy_from_photons(D65))
    scale, luminance = weights.sum(1).max(), eye.sum(1)[1]
    return (
        weights @ surfaces.values.T / scale,
        weights.sum(1) / scale,
        eye @ surfaces.values.T / luminance,
        eye.sum(1) / luminance,
    )


def test_pseudo_inverse_is_the_least_squares_of_colour_science():
    from colour.characterisation import matrix_colour_correction_Cheung2004

    seen, _, wanted, _ = training(rgb_camera(), A, reflectances("objects"))
    ours = color_matrix(rgb_camera(), A, "objects", method="pseudo-inverse").xyz
    # Theirs solves normal equations: the square of the condition number, below 100^2, times 2^-52.
    np.testing.assert_allclose(
        ours, matrix_colour_correction_Cheung2004(seen.T, wanted.T, terms=3), atol=1e-11
    )


def test_responses_and_colors_are_integrals():
    """The planner's quadrature in the pseudo-inverse against plain trapezoids.

    The reflectances are tabulated at every nm of smooth curves. Between two entries spline and line differ by
    h^2/8 f'' <= 1/8 (0.5 / 30^2) = 7e-5, and the condition number is below 20.
    """
    nodes = np.arange(400.0, 701.0)
    centres, widths = np.meshgrid(np.linspace(420, 680, 8), [30.0, 60.0, 120.0])
    surfaces = Spectrum(
        nodes,
        0.2 + 0.5 * np.exp(-(((nodes - centres.reshape(-1, 1)) / widths.reshape(-1, 1)) ** 2)),
    )
    seen = responses(rgb_camera(), A, surfaces, nodes)
    wanted = responses(cmf(), energy_from_photons(D65), surfaces, nodes)
    white = responses(cmf(), energy_from_photons(D65), Spectrum([400, 700], [[1, 1]]), nodes)
    ours = color_matrix(rgb_camera(), A, surfaces, method="pseudo-inverse").xyz
    expected = np.linalg.lstsq(seen.T, wanted.T / white[1], rcond=None)[0].T
    np.testing.assert_allclose(ours, expected, atol=20 * 7e-5)


def test_ridge_is_the_pseudo_inverse_without_noise():
    ridge = color_matrix(rgb_camera(), A, "objects", method="ridge", snr=np.inf)
    plain = color_matrix(rgb_camera(), A, "objects", method="pseudo-inverse")
    np.testing.assert_array_equal(ridge.matrix, plain.matrix)
    # The ridge falls as 1 / snr^2, and so does what it changes.
    steps = [
        np.abs(
            color_matrix(rgb_camera(), A, "objects", method="ridge", snr=snr).xyz - plain.xyz
        ).max()
        for snr in (300, 3000)
    ]
    assert steps[0] / steps[1] == pytest.approx(
        100, rel=0.05
    )  # the next order of the series: 1 % at 300


def test_ridge_is_the_least_squares_of_noisy_pictures():
    """Against pictures that are drawn, with the noise that was said: white's snr^2 electrons, Poisson."""
    snr, random = 10, np.random.default_rng(4)
    seen, _, wanted, _ = training(rgb_camera(), A, reflectances("objects"))
    drawn = []
    for _ in range(24):
        noisy = (
            random.poisson(seen[:, :, None] * snr**2, (*seen.shape, 400)).reshape(3, -1) / snr**2
        )
        drawn.append(np.linalg.lstsq(noisy.T, np.repeat(wanted, 400, 1).T, rcond=None)[0].T)
    ours = color_matrix(rgb_camera(), A, "objects", method="ridge", snr=snr).xyz
    error = np.std(drawn, 0, ddof=1) / np.sqrt(len(drawn))
    # Student's t of 23 degrees of freedom passes 6 once in 4e-6; the bias of a fit to 68,000 colours is 1e-5.
    assert (np.abs(np.mean(drawn, 0) - ours) < 6 * error + 1e-5 * np.abs(ours).max()).all()
    plain = color_matrix(rgb_camera(), A, "objects", method="pseudo-inverse").xyz
    assert np.abs(plain - ours).max() > 100 * error.max()  # the noise matters here


def mean_lab_difference(matrix, seen, wanted, white):
    import colour

    lab = [
        colour.XYZ_to_Lab(colors.T, white[:2] / white.sum()) for colors in (matrix @ seen, wanted)
    ]
    return np.linalg.norm(lab[0] - lab[1], axis=1).mean()


@pytest.mark.parametrize("surfaces", ["objects", "munsell", "macbeth"])
@pytest.mark.parametrize(
    "light", [D65, A, photons_from_energy(illuminant("FL11"))], ids=["D65", "A", "FL11"]
)
def test_cielab_search_is_a_minimum_and_better_than_its_start(light, surfaces):
    seen, camera_white, wanted, white = training(rgb_camera(), light, reflectances(surfaces))
    found, start = (
        color_matrix(rgb_camera(), light, surfaces, method=method).xyz
        for method in ("cielab", "white-preserving")
    )
    least = mean_lab_difference(found, seen, wanted, white)
    assert least < mean_lab_difference(start, seen, wanted, white)
    random = np.random.default_rng(2)
    for size in (1e-3, 1e-2, 1e-1):
        for _ in range(20):
            step = random.normal(0, size, (3, 3))
            step -= np.outer(step @ camera_white, camera_white) / (camera_white @ camera_white)
            # Rounding the root's corner by 1e-2 moves each of the differences, 2 and more on average, by 5e-5/2.
            assert mean_lab_difference(found + step, seen, wanted, white) > least - 1e-4


def test_cielab_of_more_channels_counts_the_noise():
    curves, cut = curve("mt9v024"), curve("ir-cut-phone")
    rgbw = Spectrum(curves.wavelengths, curves.values * cut.values)
    found, start = (
        color_matrix(rgbw, A, "objects", method=method) for method in ("cielab", "white-preserving")
    )
    np.testing.assert_allclose(found.matrix @ found.white, 1, atol=1e-13)
    seen, _, wanted, white = training(rgbw, A, reflectances("objects"))
    assert mean_lab_difference(found.xyz, seen, wanted, white) < mean_lab_difference(
        start.xyz, seen, wanted, white
    )
    plain = color_matrix(rgbw, A, "objects", method="pseudo-inverse")
    assert noise_of_white(found).max() < noise_of_white(plain).max() / 2


def test_diagonal_is_exact_where_channels_see_the_displays_primaries():
    """Efficiencies that are the display's own matching functions, each with a gain of its own, which it takes off.

    The display's white is the target light's within the training's wavelengths, so that nothing is adapted.
    """
    light, nodes = Spectrum(FINE, D65.at(FINE)), reflectances("munsell").wavelengths
    white = product_weights(nodes, cmf(), energy_from_photons(light)).sum(1)
    display = Display(white=tuple(white[:2] / white.sum()))
    functions = display.rgb_from_xyz @ cmf().at(FINE) / FINE
    camera = Spectrum(FINE, np.array([[0.3], [1.0], [7.0]]) * functions)
    transform = color_matrix(
        camera, light, "munsell", target_light=light, method="diagonal", display=display
    )
    surfaces = reflectances("munsell").values.T
    seen = product_weights(nodes, camera, light)
    eye = product_weights(nodes, cmf(), energy_from_photons(light))
    # rounding; the sums have terms of both signs, ten times their value
    np.testing.assert_allclose(
        transform.matrix @ seen @ surfaces / seen.sum(1).max(),
        display.rgb_from_xyz @ eye @ surfaces / white[1],
        atol=1e-13,
    )
    np.testing.assert_allclose(transform.xyz, display.xyz_from_rgb @ transform.matrix, atol=1e-12)
    assert np.count_nonzero(transform.matrix) == 3


def test_diagonal_finds_its_channels_by_name():
    camera = rgb_camera()
    turned = Spectrum(
        camera.wavelengths,
        np.vstack([camera.values[[2, 0]], camera.values.sum(0), camera.values[1]]),
    )
    plain = color_matrix(camera, A, "objects", method="diagonal").matrix
    found = color_matrix(turned, A, "objects", method="diagonal", channels="BRWG")
    np.testing.assert_allclose(
        found.matrix[:, [1, 3, 0]] / found.matrix[0, 1], plain / plain[0, 0], rtol=1e-14
    )
    assert not found.matrix[:, 2].any()
    for qe, letters in ((turned, "RGBW"[:3]), (turned, "RGGB"), (camera, "CMY")):
        with pytest.raises(BadData, match="R, G and B"):
            color_matrix(qe, A, "objects", method="diagonal", channels=letters)


def test_fixed_diagonal_is_one_matrix_and_von_kries():
    fixed = color_matrix(rgb_camera(), "D65", "objects").xyz
    same = color_matrix(rgb_camera(), "D65", "objects", method="fixed-diagonal").xyz
    np.testing.assert_allclose(same, fixed, atol=1e-14)
    for light in ("A", "FL11"):
        found = color_matrix(rgb_camera(), light, "objects", method="fixed-diagonal").xyz
        between = BRADFORD @ found @ np.linalg.inv(fixed) @ np.linalg.inv(BRADFORD)
        # three factors of condition below 10 each
        np.testing.assert_allclose(between, np.diag(np.diag(between)), atol=1e-12)
        assert np.abs(np.diag(between) - 1).max() > 0.05


def test_monochrome_gives_gray():
    transform = color_matrix(Spectrum(WAVELENGTHS, np.full(31, 0.4)), A, reflectances("munsell"))
    np.testing.assert_allclose(transform.matrix, 1, atol=1e-12)  # rounding


def checker_differences(camera, light, training):
    """CIEDE2000 of the 24 ColorChecker patches, photographed in `light` and shown as if in D65."""
    return colorchecker_differences(camera, light, color_matrix(camera, light, training).matrix)


def colorchecker_differences(camera, light, matrix):
    """The same with a matrix that is given."""
    import colour

    patches = list(colour.SDS_COLOURCHECKERS["ISO 17321-1"].values())
    nodes = np.arange(400.0, 701.0, 5.0)
    shape = colour.SpectralShape(400, 700, 5)
    surfaces = Spectrum(nodes, [patch.copy().interpolate(shape).values for patch in patches])
    rgb = color(responses(camera, light, surfaces, nodes)[:, None], matrix, device="numpy")[:, 0].T
    shown = rgb @ DISPLAYS["srgb"].xyz_from_rgb.T
    # The truth shares nothing with gpusim: ASTM E308 tables of colour-science.
    true = (
        np.array(
            [colour.sd_to_XYZ(patch, illuminant=colour.SDS_ILLUMINANTS["D65"]) for patch in patches]
        )
        / 100
    )
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return colour.delta_E(
        colour.XYZ_to_Lab(shown, white), colour.XYZ_to_Lab(true, white), method="CIE 2000"
    )


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
    errors = [
        checker_differences(camera, light, reflectances("objects")).mean() for camera in (rgbw, rgb)
    ]
    assert errors[0] <= errors[1] + 1e-9
    np.testing.assert_allclose(
        four.matrix @ four.white, 1, atol=1e-13
    )  # white is met exactly: rounding of the sums
    same_exposure = noise_of_white(three).max() / np.sqrt(four.white[:3].max())
    assert noise_of_white(four).max() < 4 / 3 * same_exposure
    monkeypatch.setattr("gpusim.color.color.WHITE_ELECTRONS", 1e30)
    assert (
        noise_of_white(color_matrix(rgbw, light, reflectances("objects"))).max() > 2 * same_exposure
    )


def test_bad_training_is_refused_in_one_line():
    camera, munsell = some_camera(3), reflectances("munsell")
    few = Spectrum(munsell.wavelengths, munsell.values[:2])
    same = Spectrum(munsell.wavelengths, np.outer(np.arange(1, 6), munsell.values[0]) / 6)
    infrared = Spectrum([800, 900], np.ones((3, 2)))
    for qe, surfaces in ((camera, few), (camera, same), (infrared, munsell)):
        with pytest.raises(BadData) as refusal:
            color_matrix(qe, D65, surfaces)
        assert "\n" not in str(refusal.value)


def test_what_is_asked_for_wrongly_is_refused_in_one_line():
    def match(qe=None, light=A, surfaces="objects", **options):
        return color_matrix(qe or rgb_camera(), light, surfaces, **options)

    infrared, sodium = (
        Spectrum([800, 900], [1.0, 1.0], "infrared"),
        Spectrum([588, 589, 590], [0, 1.0, 0], "sodium"),
    )
    for error, words, options in (
        (UnknownName, "white-preserving", {"method": "magic"}),
        (UnknownName, "light", {"light": "X"}),
        (UnknownName, "set", {"surfaces": "no"}),
        (OutOfRange, "snr", {"method": "ridge", "snr": 0}),
        (BadData, "no overlap", {"light": infrared}),
        (BadData, "no overlap", {"target_light": infrared}),
        (BadData, "span only", {"light": sodium}),
        (BadData, "span only", {"light": sodium, "method": "ridge"}),
        (BadData, "scaled to white", {"light": sodium, "method": "fixed-diagonal"}),
        (BadData, "training", {"surfaces": Spectrum(WAVELENGTHS, np.ones((2, 31)))}),
        (BadData, "no lights", None),
    ):
        with pytest.raises(error, match=words) as refusal:
            match(**options) if options else transform_set(rgb_camera(), "objects", [])
        assert "\n" not in str(refusal.value)
    # a diagonal is not fitted: white is white in sodium light too
    shown = match(light=sodium, method="diagonal")
    np.testing.assert_allclose(shown.matrix @ shown.white, 1, rtol=1e-14)


@pytest.fixture(scope="module")
def transforms():
    return transform_set(rgb_camera(), "objects", channels="RGB")


def test_stored_transforms_are_exact_in_their_lights(transforms):
    assert transforms.names == LIGHTS
    for name, own in zip(LIGHTS, transforms.transforms, strict=True):
        alone, found = color_matrix(rgb_camera(), name, "objects"), transforms.at(3 * own.white)
        for part in ("matrix", "xyz", "white"):
            np.testing.assert_array_equal(getattr(own, part), getattr(alone, part))
            np.testing.assert_allclose(
                getattr(found, part), getattr(own, part), rtol=1e-14
            )  # times w, over w


def test_stored_transforms_keep_every_white(transforms):
    for white in np.exp(np.random.default_rng(3).normal(0, 1, (50, 3))):
        found = transforms.at(white)
        np.testing.assert_allclose(
            found.matrix @ found.white, 1, atol=1e-13
        )  # rounding: the sum of weights is 1
        assert found.white.max() == 1


def test_stored_transforms_are_continuous(transforms):
    """Along lines through lights and between them: the largest step shrinks with the spacing; a jump would stay."""
    logs = np.log(transforms.whites)
    random = np.random.default_rng(5)
    for _ in range(4):
        begin, end = logs[random.choice(len(logs), 2, replace=False)]
        middle = random.normal(0, 0.5, 3)  # a third way, not along the lights
        path = [begin - 0.3 * (end - begin), begin, end, end + middle]
        largest = []
        for count in (201, 1601):
            places = np.linspace(0, 3, count)
            walk = np.exp(
                [[np.interp(p, range(4), axis) for axis in np.transpose(path)] for p in places]
            )
            found = np.array([transforms.at(white).matrix for white in walk])
            largest.append(np.abs(np.diff(found, axis=0)).max())
        assert largest[1] < largest[0] / 4  # 8 where the slope is even


def test_stored_transforms_serve_the_lights_between(transforms):
    """Halfway between two stored lights colours are those of the light's own matrix: no eye sees 0.1."""
    for light in (
        "blackbody-2580K",
        "blackbody-3200K",
        "daylight-4700K",
        "daylight-6100K",
        "daylight-9000K",
    ):
        own = color_matrix(rgb_camera(), light, "objects")
        photons = photons_from_energy(illuminant(light))
        differences = [
            colorchecker_differences(rgb_camera(), photons, transform.matrix).mean()
            for transform in (own, transforms.at(own.white))
        ]
        assert abs(differences[0] - differences[1]) < 0.1


def test_one_stored_light_is_white_balance_and_one_matrix():
    one = transform_set(rgb_camera(), "objects", ["D65"])
    white = color_matrix(rgb_camera(), A, "objects").white
    own = one.transforms[0]
    np.testing.assert_allclose(one.at(white).matrix, own.matrix * (own.white / white), rtol=1e-14)
    for wrong in ([1.0, 1.0], [1.0, 0.0, 1.0], [1.0, np.nan, 1.0]):
        with pytest.raises(BadData, match="white"):
            one.at(wrong)


def test_the_wrong_light_is_worse_than_its_own():
    """Figure 12 of Farrell & Wandell: a transform in another light than its own."""
    lights = ("D65", "A", "FL11")
    means = [
        [
            colorchecker_differences(
                rgb_camera(),
                photons_from_energy(illuminant(light)),
                color_matrix(rgb_camera(), taken, "objects").matrix,
            ).mean()
            for taken in lights
        ]
        for light in lights
    ]
    right = np.diag(means)
    assert (np.array(means)[~np.eye(3, dtype=bool)].reshape(3, 2) > 3 * right[:, None]).all(), means


def test_ceiling_keeps_saturated_highlights_neutral():
    """At saturation every channel reads 1; clipped at the white's response it renders gray instead of tinted."""
    transform = color_matrix(some_camera(3), A, reflectances("munsell"))
    saturated = np.ones((3, 1, 1))
    tinted = color(saturated, transform.matrix, device="numpy").ravel()
    neutral = color(saturated, transform.matrix, ceiling=transform.white, device="numpy").ravel()
    assert np.ptp(tinted) > 0.1
    np.testing.assert_allclose(neutral, 1, atol=1e-12)
