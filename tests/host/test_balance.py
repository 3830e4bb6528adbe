"""Estimates of the light from pictures that are made to satisfy what each of them assumes."""

import numpy as np
import pytest

from gpusim.color.balance import COMPARES_LIGHTS, ESTIMATES, estimate_white
from gpusim.color.color import ColorTransform, TransformSet, transform_set
from gpusim.data.curves import curve
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum
from gpusim.kernels.processor.thumbnail import thumbnail

WHITE = np.array([0.7, 1.0, 0.4])
ROUNDING = 1e-14  # means of some thousand numbers, in pairs: 12 roundings of 2^-53, and powers


@pytest.fixture(scope="module")
def transforms():
    """A measured camera's, in the stored lights."""
    curves, cut = curve("mt9v024"), curve("ir-cut-phone")
    return transform_set(
        Spectrum(curves.wavelengths, curves.values[:3] * cut.values), "objects", channels="RGB"
    )


def reflecting(channels=3, rows=12, cols=16):
    """Reflectances as each channel sees them, (channels, rows, cols), unlike from channel to channel."""
    powers = np.array([0.5, 1.0, 2.0, 3.0, 1.5, 0.7])[:channels, None, None]
    return np.random.default_rng(6).uniform(0.02, 0.9, (channels, rows, cols)) ** powers


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_gray_world_finds_the_white_of_a_scene_that_is_gray_on_average(channels):
    surfaces, white = reflecting(channels), np.linspace(1, 0.3, channels)
    picture = white[:, None, None] * surfaces / surfaces.mean((1, 2), keepdims=True)
    np.testing.assert_allclose(estimate_white(picture, "gray-world").white, white, rtol=ROUNDING)
    if channels > 1:  # and the others do not
        for other in ("max-rgb", "shades-of-gray"):
            assert np.abs(estimate_white(picture, other).white - white).max() > 0.05


def test_max_rgb_finds_the_white_of_a_scene_with_a_white_surface():
    surfaces = reflecting()
    surfaces[:, 3, 5] = 1
    picture = WHITE[:, None, None] * surfaces
    np.testing.assert_allclose(estimate_white(picture, "max-rgb").white, WHITE, rtol=ROUNDING)
    assert np.abs(estimate_white(picture, "gray-world").white - WHITE).max() > 0.05


def test_shades_of_gray_finds_the_white_where_the_sixth_powers_are_equal():
    surfaces = reflecting()
    surfaces /= np.mean(surfaces**6, (1, 2), keepdims=True) ** (1 / 6)
    picture = WHITE[:, None, None] * surfaces
    np.testing.assert_allclose(
        estimate_white(picture, "shades-of-gray").white, WHITE, rtol=ROUNDING
    )
    assert np.abs(estimate_white(picture, "max-rgb").white - WHITE).max() > 0.02


def test_red_blue_finds_every_light_that_it_was_trained_in(transforms):
    for name, responses, own in zip(
        transforms.names, transforms.responses, transforms.transforms, strict=True
    ):
        found = estimate_white(responses.reshape(3, 10, -1) * 0.3, "red-blue", transforms)
        np.testing.assert_array_equal(found.white, own.white)
        assert found.model == f"red-blue correlation 1.00 with {name}"


def test_red_blue_correlation_is_overlap_by_root_of_product():
    """Triangles: black, red 1, blue 1 of area 1/2, and the picture's black, (1, 0), (0.6, 0.8) of area 0.4.

    The line to (0.6, 0.8) leaves the first at 1/1.4 of it: overlap 0.8/1.4/2 = 0.2857, by sqrt(0.2) = 0.64. The other
    light has no blue: no area, no correlation.
    """
    responses = np.array(
        [[[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], [[1.0, 0.5], [0.0, 0.5], [0.0, 0.0]]]
    )
    own = [ColorTransform(np.eye(3), np.eye(3), white) for white in (WHITE, WHITE[::-1])]
    lights = TransformSet(("one", "other"), tuple("RGB"), tuple(own), responses, np.ones(3))
    picture = np.array([[1.0, 0.6], [0.0, 0.0], [0.0, 0.8]])[:, None] * 7
    picture[1] = 1e-12  # a channel without any light is dark
    found = estimate_white(picture, "red-blue", lights)
    assert found.model == "red-blue correlation 0.64 with one"
    np.testing.assert_array_equal(found.white, WHITE)


def test_red_blue_knows_a_light_by_surfaces_it_was_not_trained_on(transforms):
    """The classes are 25 MK-1 apart; other surfaces shift the choice by a class or two, not from tungsten to sky."""
    from gpusim.data.lights import illuminant
    from gpusim.data.reflectances import reflectances
    from gpusim.data.weights import product_weights
    from gpusim.domain.spectrum import photons_from_energy

    surfaces, found = reflectances("macbeth"), {}
    curves, cut = curve("mt9v024"), curve("ir-cut-phone")
    camera = Spectrum(curves.wavelengths, curves.values[:3] * cut.values)
    for light in ("A", "D65"):
        weights = product_weights(
            surfaces.wavelengths, camera, photons_from_energy(illuminant(light))
        )
        picture = (weights @ surfaces.values.T).reshape(3, 4, 6)
        found[light] = estimate_white(picture, "red-blue", transforms).white
        white = weights.sum(1)
        angle = np.arccos(
            found[light] @ white / np.linalg.norm(found[light]) / np.linalg.norm(white)
        )
        assert np.rad2deg(angle) < 6
    assert found["A"][0] / found["A"][2] > 1.5 * found["D65"][0] / found["D65"][2]


@pytest.mark.parametrize("method", ESTIMATES)
def test_exposure_does_not_matter(method, transforms):
    picture = WHITE[:, None, None] * reflecting()
    base = estimate_white(picture, method, transforms)
    for factor in (2.0**-20, 2.0**20):  # powers of two round alike, their logarithms do not
        found = estimate_white(picture * factor, method, transforms).white
        np.testing.assert_allclose(found, base.white, rtol=ROUNDING if method == "bayesian" else 0)
    assert base.white.max() == 1


@pytest.mark.parametrize("method", ESTIMATES)
def test_clipped_pixels_are_left_out(method, transforms):
    """A lamp in the picture, with blocks beside it that it cuts: the estimate is that of the rest alone."""
    blocks = WHITE[:, None, None] * reflecting(rows=10, cols=10)
    picture = np.repeat(np.repeat(blocks, 6, 1), 6, 2).astype(np.float32)
    lit = picture.copy()
    lit[0, :12, :27] = 1.0  # red alone is clipped, the other channels would tell their own tale
    small = thumbnail(lit, 0.95, rows=10, cols=10, device="numpy")
    assert np.isnan(small).all(0).sum() == 8
    rest = blocks.astype(np.float32).astype(np.float64)
    rest[:, :2, :4] = np.nan
    np.testing.assert_array_equal(np.isnan(small), np.isnan(rest))
    np.testing.assert_allclose(small, rest, rtol=1e-15)  # the mean of equal numbers
    found, wanted = (estimate_white(values, method, transforms).white for values in (small, rest))
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING)


@pytest.mark.parametrize("method", ESTIMATES)
def test_a_picture_without_light_falls_back_and_says_so(method, transforms):
    black, clipped = np.zeros((3, 4, 4)), np.full((3, 4, 4), np.nan)
    blue = np.ones((3, 4, 4)) * np.array([0.0, 0.0, 1.0])[:, None, None]
    for picture, reason in (
        (black, "dark"),
        (clipped, "clipped"),
        (blue, "dark"),
        (black - 1e-3, "dark"),
    ):
        found = estimate_white(picture, method, transforms)
        np.testing.assert_array_equal(found.white, transforms.target_white)
        assert reason in found.model and "target light" in found.model
    noise = np.abs(np.random.default_rng(8).normal(0, 1e-4, (3, 4, 4)))
    assert "dark" in estimate_white(noise, method, transforms, floor=1e-3).model
    if method not in COMPARES_LIGHTS:
        np.testing.assert_array_equal(estimate_white(black, method).white, [1, 1, 1])


def test_target_white_is_that_of_the_target_light(transforms):
    np.testing.assert_allclose(
        transforms.target_white, transforms.whites[transforms.names.index("D65")], rtol=1e-14
    )


def test_red_blue_needs_more_than_one_color(transforms):
    found = estimate_white(
        WHITE[:, None, None] * np.linspace(0.5, 1, 12).reshape(3, 4), "red-blue", transforms
    )
    assert "one color" in found.model


def test_wrong_calls_are_refused_in_one_line(transforms):
    picture = reflecting()
    nameless = TransformSet(
        transforms.names, (), transforms.transforms, transforms.responses, transforms.target_white
    )
    for error, words, arguments, options in (
        (UnknownName, "gray-world", (picture, "grey-world"), {}),
        (BadData, "shape", (picture[0], "gray-world"), {}),
        (BadData, "4", (reflecting(4), "gray-world", transforms), {}),
        (OutOfRange, "floor", (picture, "gray-world"), {"floor": -1}),
        (BadData, "give it", (picture, "red-blue"), {}),
        (BadData, "channels R and B", (picture, "red-blue", nameless), {}),
    ):
        with pytest.raises(error, match=words) as refusal:
            estimate_white(*arguments, **options)
        assert "\n" not in str(refusal.value)
