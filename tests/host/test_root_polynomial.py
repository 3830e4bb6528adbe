"""Root-polynomial colour correction: its terms, what it promises, and its errors on other surfaces."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim.apps.l3.train import colorimetric_channels
from gpusim.color.color import color_matrix, transform_set
from gpusim.color.rendering import Rendering
from gpusim.color.root_polynomial import EXPONENTS, linearise, slopes_of, terms_of
from gpusim.data.colorimetry import xyz
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import product_weights
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.io.camera.cameras import open_camera

ROOTS = tuple(EXPONENTS)
COLUMNS = {"root-polynomial": 6, "root-polynomial-3": 13}
COLORS = np.random.default_rng(2).uniform(0.01, 1, (40, 3))


def camera(name="mt9v024", letters=3):
    curves = curve(name)
    cut = curve("ir-cut-phone").values if name == "mt9v024" else 1.0
    return Spectrum(curves.wavelengths, curves.values[:letters] * cut)


def seen(qe, light, surfaces):
    """Return responses (N, C) to surfaces, white 1 in its strongest channel."""
    weights = product_weights(surfaces.wavelengths, qe, photons_from_energy(illuminant(light)))
    return (weights @ surfaces.values.T / weights.sum(1).max()).T


def test_terms_are_the_roots_that_the_paper_names():
    r, g, b = COLORS.T
    second = [r, g, b, np.sqrt(r * g), np.sqrt(g * b), np.sqrt(r * b)]
    third = [r * g**2, g * b**2, r * b**2, r**2 * g, g**2 * b, r**2 * b, r * g * b]
    wanted = np.stack([*second, *np.cbrt(third)], -1)
    for columns in COLUMNS.values():
        np.testing.assert_allclose(terms_of(COLORS, columns), wanted[:, :columns], rtol=1e-14)
    np.testing.assert_array_equal(terms_of(COLORS, 3), COLORS)
    dark = terms_of([-0.1, 0.5, 0.2], 6)
    np.testing.assert_allclose(dark, [-0.1, 0.5, 0.2, 0, np.sqrt(0.1), 0], rtol=1e-14)


@pytest.mark.parametrize("columns", COLUMNS.values())
def test_terms_are_proportional_to_light_and_slopes_are_their_derivatives(columns):
    np.testing.assert_allclose(
        terms_of(8 * COLORS, columns), 8 * terms_of(COLORS, columns), rtol=1e-14
    )
    step = 1e-6
    for channel in range(3):
        away = step * np.eye(3)[channel]
        rise = terms_of(COLORS + away, columns) - terms_of(COLORS - away, columns)
        # the third derivative of a root at 0.01 is below 1e6: step^2 of it; rounding 2^-52 / step
        np.testing.assert_allclose(
            rise / (2 * step), slopes_of(COLORS, columns)[..., channel], atol=1e-5
        )


@pytest.mark.parametrize("light", ["D65", "A", "FL11", "LED-B3"])
@pytest.mark.parametrize("method", ROOTS)
def test_greys_are_exact_at_every_exposure(method, light):
    found = color_matrix(camera(), light, "objects", method=method)
    assert found.matrix.shape == (3, COLUMNS[method])
    for level in (1e-3, 0.2, 1.0, 5.0):
        shown = found.matrix @ terms_of(level * found.white, COLUMNS[method])
        # rounding: the sum of the magnitudes of 13 terms with entries below 20
        np.testing.assert_allclose(shown, level, rtol=300 * 2.0**-52)


@pytest.mark.parametrize("method", ROOTS)
def test_stored_transforms_keep_every_white(method):
    lights = ["A", "D65", "FL11"]
    transforms = transform_set(camera(), "objects", lights, channels="RGB", method=method)
    for white in np.exp(np.random.default_rng(3).normal(0, 1, (20, 3))):
        found = transforms.at(white)
        np.testing.assert_allclose(
            found.matrix @ terms_of(found.white, COLUMNS[method]), 1, atol=1e-13
        )


def mean_difference(qe, light, method):
    """Return the mean CIEDE2000 of the ColorChecker, trained on objects, by colour-science."""
    import colour

    patches = reflectances("colorchecker")
    found = color_matrix(qe, light, "objects", method=method)
    terms = terms_of(seen(qe, light, patches), found.matrix.shape[1])
    shown = terms @ (DISPLAYS["srgb"].xyz_from_rgb @ found.matrix).T
    true = xyz(patches, illuminant("D65")) / xyz(illuminant("D65"))[1]
    white = np.array([0.3127, 0.3290])
    return colour.delta_E(
        colour.XYZ_to_Lab(shown, white), colour.XYZ_to_Lab(true, white), method="CIE 2000"
    ).mean()


@pytest.mark.parametrize("light", ["D65", "A"])
@pytest.mark.parametrize("name", ["mt9v024", "iset-rgb"])
def test_surfaces_that_were_not_trained_on_are_nearer(name, light):
    """Every degree beats the one below, as Finlayson et al. report in their table II."""
    errors = [
        mean_difference(camera(name), light, method) for method in ("white-preserving", *ROOTS)
    ]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("method", ROOTS)
def test_noise_is_hardly_more_than_that_of_a_matrix(method):
    """The 24 patches at 100 electrons of white with 5 electrons of read noise: noise rms, 2000 draws.

    The docs promise at most a tenth more than "white-preserving". The standard deviation of 48,000
    draws errs by 0.3 %, a few times that where its distribution has long tails.
    """
    electrons, random = 100, np.random.default_rng(7)
    for light in ("D65", "A"):
        clean = seen(camera(), light, reflectances("colorchecker"))[:, None]
        spread = np.sqrt(clean / electrons + (5 / electrons) ** 2)
        noisy = clean + random.normal(0, 1, (24, 2000, 3)) * spread
        noise = {}
        for name in ("white-preserving", method):
            matrix = color_matrix(camera(), light, "objects", method=name).matrix
            shown = terms_of(noisy, matrix.shape[1]) @ matrix.T
            noise[name] = np.sqrt((shown.std(1) ** 2).mean())
        assert noise[method] < 1.1 * noise["white-preserving"]


@pytest.mark.parametrize("method", ROOTS)
def test_the_linear_matrix_of_a_rendering_is_its_slope_at_white(method):
    found = color_matrix(camera(), "A", "objects", method=method)
    made = Rendering(found.matrix, 0.9 * found.white, found.white, "", 1.0, 0.9, 1.0)
    np.testing.assert_allclose(made.linear_matrix @ found.white, 1, rtol=1e-12)
    step = 1e-5 * np.array([1.0, -2.0, 1.5])
    shown = found.matrix @ terms_of(found.white + step, COLUMNS[method])
    # second derivatives below 10 times the step squared
    np.testing.assert_allclose(shown - 1, made.linear_matrix @ step, atol=1e-8)
    # an exposure's scale of white does not matter
    np.testing.assert_allclose(linearise(found.matrix, 0.3 * found.white), made.linear_matrix)
    plain = color_matrix(camera(), "A", "objects")
    rendering = replace(made, display_from_camera=plain.matrix)
    assert rendering.linear_matrix is plain.matrix


@pytest.mark.parametrize("method", ROOTS)
def test_what_cannot_be_is_refused_in_one_line(method):
    few = Spectrum(np.arange(400.0, 701, 10), reflectances("objects").values[:5])
    phone = open_camera("phone").with_(color=method)
    for error, words, call in (
        (
            BadData,
            "3 channels",
            lambda: color_matrix(camera("mt9v024", 4), "A", few, method=method),
        ),
        (BadData, "got 3 and 5", lambda: color_matrix(camera(), "A", few, method=method)),
        (OutOfRange, "at least 3", lambda: open_camera("mono").with_(color=method)),
        (OutOfRange, "linear method", lambda: colorimetric_channels(phone, "D65")),
    ):
        with pytest.raises(error, match=words) as refusal:
            call()
        assert "\n" not in str(refusal.value)


def test_another_mosaic_takes_a_matrix_again():
    """A clear channel is a fourth: the processor is set to fit, as for other settings."""
    phone = open_camera("phone").with_(color="root-polynomial")
    assert phone.with_(cfa="rgbw").processor.color == "white-preserving"
    with pytest.raises(OutOfRange, match="three channels"):
        phone.with_(cfa="rgbw", color="root-polynomial")


def test_one_pass_serves_only_matrices():
    phone = open_camera("phone").with_(demosaic="bilinear")
    assert phone.is_developed_at_once
    assert not phone.with_(color="root-polynomial").is_developed_at_once
