"""The Bayesian estimate of the light, on surfaces and in lights whose white is known."""

import numpy as np
import pytest

from gpusim.color.balance import BLOCKS, ESTIMATES, blocks_of, estimate_white
from gpusim.color.color import LIGHTS, transform_set
from gpusim.color.likely_light import CLOSE
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import product_weights
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum, photons_from_energy

UNLISTED = ("blackbody-2850K", "D55", "FL7", "FL3.14", "LED-B4", "LED-V1")  # in no transform set
SETS = ("macbeth", "colorchecker-sg", "munsell", "dupont", "objects")


def camera(name, letters=3):
    curves = curve(name)
    cut = curve("ir-cut-phone").values if name == "mt9v024" else 1.0
    return Spectrum(curves.wavelengths, curves.values[:letters] * cut)


@pytest.fixture(scope="module", params=["mt9v024", "iset-rgb"])
def known(request):
    """A measured camera and its transforms."""
    qe = camera(request.param)
    return qe, transform_set(qe, "objects", channels="RGB")


def seen(qe, light, surfaces):
    """Return responses to surfaces (N, L), shape (C, N), and to white, from their integrals."""
    weights = product_weights(surfaces.wavelengths, qe, photons_from_energy(illuminant(light)))
    return weights @ surfaces.values.T, weights.sum(1)


def discs(count, rows=48, cols=64):
    """Return numbers of surfaces, (rows, cols): discs on top of each other."""
    random = np.random.default_rng(11)
    y, x = np.mgrid[:rows, :cols]
    picture = np.zeros((rows, cols), int)
    for _ in range(200):
        radius = 1 / np.sqrt(random.uniform(1 / 16**2, 1 / 1.5**2))
        inside = (y - random.uniform(0, rows)) ** 2 + (x - random.uniform(0, cols)) ** 2
        picture[inside < radius**2] = random.integers(count)
    return picture


def degrees(one, other):
    one, other = one / np.linalg.norm(one), other / np.linalg.norm(other)
    return np.degrees(2 * np.arcsin(np.linalg.norm(one - other) / 2))


def errors_of(known, change=lambda surfaces: surfaces, lights=UNLISTED):
    """Return the mean error of each estimate over discs of SETS in some lights [degree]."""
    qe, transforms = known
    errors: dict[str, list] = {method: [] for method in ESTIMATES}
    for name in SETS:
        surfaces = change(reflectances(name))
        picture = discs(len(surfaces.values))
        for light in lights:
            colors, white = seen(qe, light, surfaces)
            for method, found in errors.items():
                estimate = estimate_white(colors[:, picture], method, transforms)
                found.append(degrees(estimate.white, white))
    return {method: np.mean(found) for method, found in errors.items()}


def test_it_finds_lights_that_it_does_not_know(known):
    """Discs of five measured sets: at most 2.5 degrees in the mean, what the project asks for.

    Without noise, and with white surfaces in most sets, "max-rgb" is nearly perfect; the other
    estimates err more.
    """
    assert not {*UNLISTED} & {*LIGHTS}
    means = errors_of(known)
    assert means["bayesian"] <= 2.5
    assert all(means["bayesian"] < means[other] for other in ("gray-world", "shades-of-gray"))


def few(surfaces, random):
    """Return six surfaces that reflect less than half in some part of the spectrum."""
    colored = surfaces.values[surfaces.values.min(1) < 0.5]
    return Spectrum(surfaces.wavelengths, random.permutation(colored)[:6])


def test_it_errs_less_than_all_others_on_few_surfaces_without_white(known):
    """A photograph may have few surfaces. Sixty pictures: twelve draws of each set."""
    random = np.random.default_rng(4)
    draws = [
        errors_of(known, lambda surfaces: few(surfaces, random), [light]) for light in 2 * UNLISTED
    ]
    means = {method: np.mean([draw[method] for draw in draws]) for method in ESTIMATES}
    own = means.pop("bayesian")
    assert own < min(means.values()), (own, means)


def test_a_picture_of_leaves_does_not_make_the_light_green(known):
    """No usual light is as green as the greenest third of natural surfaces. Others take it for one."""
    qe, transforms = known
    nature = reflectances("nature")
    greenness = nature.values[:, 15] / nature.values[:, [5, 25]].mean(1)  # 550 over 450 and 650 nm
    leaves = Spectrum(nature.wavelengths, nature.values[greenness > np.quantile(greenness, 0.67)])
    colors, white = seen(qe, "D55", leaves)
    picture = colors[:, discs(len(leaves.values))]
    errors = {
        method: degrees(estimate_white(picture, method, transforms).white, white)
        for method in ("bayesian", "gray-world", "max-rgb")
    }
    assert errors["bayesian"] < min(errors["gray-world"], errors["max-rgb"])


def test_confidence_is_the_share_of_right_estimates(known):
    """Of the pictures that it is surer of, more are right; the share errs by its statistics.

    The share of n independent pictures errs by at most 0.5 / sqrt(n) rms. Seven pictures in six
    lights: the same picture errs alike in all lights, so that n = 7, 0.19 rms; twice that is
    allowed.
    """
    qe, transforms = known
    confidences, right = [], []
    for name in (*SETS, "nature", "skin"):
        surfaces = reflectances(name)
        picture = discs(len(surfaces.values))
        for light in UNLISTED:
            colors, white = seen(qe, light, surfaces)
            found = estimate_white(colors[:, picture], "bayesian", transforms)
            confidences.append(found.confidence)
            right.append(degrees(found.white, white) <= CLOSE)
            assert f"{100 * found.confidence:.0f} % sure" in found.model
    order = np.argsort(confidences)
    half = len(order) // 2
    right = np.array(right)[order]
    assert right[half:].mean() > right[:half].mean()
    assert abs(np.mean(confidences) - right.mean()) < 2 * 0.19
    colors, white = seen(qe, "D55", reflectances("skin"))
    others = [estimate_white(colors[:, discs(19)], method, transforms) for method in ESTIMATES[1:]]
    assert all(other.confidence is None for other in others)


def test_one_known_light_is_certain(known):
    """Bayes's rule with one possibility, whatever the picture shows."""
    qe, _ = known
    only = transform_set(qe, "objects", ["FL2"], channels="RGB")
    colors, _ = seen(qe, "A", reflectances("dupont"))
    found = estimate_white(colors[:, discs(120)], "bayesian", only)
    assert found.confidence == 1
    assert degrees(found.white, only.whites[0]) < 1e-5  # arccos next to 1 has half the digits


@pytest.mark.parametrize("letters", [2, 4])
def test_other_numbers_of_channels(letters):
    """A chart with a white patch in tungsten, 17 degrees and more from daylight's white."""
    qe = camera("mt9v024", letters)
    transforms = transform_set(qe, "objects", channels="RGBW"[:letters])
    colors, white = seen(qe, "blackbody-2850K", reflectances("macbeth"))
    found = estimate_white(colors[:, discs(24)], "bayesian", transforms)
    assert degrees(found.white, white) < CLOSE
    assert degrees(transforms.target_white, white) > 2 * CLOSE


def test_one_channel_has_one_white():
    found = estimate_white(np.ones((1, 4, 4)), "bayesian")
    assert (found.white.tolist(), found.confidence) == ([1.0], 1.0)


def test_a_picture_of_one_row_has_no_edges(known):
    """The other cues remain: a row of the chart's patches with its white."""
    qe, transforms = known
    colors, white = seen(qe, "A", reflectances("macbeth"))
    found = estimate_white(colors[:, None], "bayesian", transforms)
    assert degrees(found.white, white) < CLOSE


def test_thumbnails_are_finer_than_those_of_other_estimates_but_not_pixels():
    assert blocks_of("gray-world", (3000, 4000)) == BLOCKS == blocks_of("bayesian", (90, 120))
    rows, cols = blocks_of("bayesian", (3000, 4000))
    assert rows > BLOCKS[0] and cols > BLOCKS[1]
    rows, cols = blocks_of("bayesian", (280, 360))
    assert 280 / rows >= 4 <= 360 / cols


def test_wrong_calls_are_refused_in_one_line(known):
    qe, _ = known
    picture = np.ones((3, 4, 4))
    with pytest.raises(BadData, match="give it their transforms"):
        estimate_white(picture, "bayesian")
    greys = Spectrum(np.arange(400.0, 701, 10), np.outer([0.2, 0.5, 0.9, 1.0], np.ones(31)))
    grey = transform_set(qe, greys, channels="RGB", method="diagonal")
    with pytest.raises(BadData, match="grey") as refusal:
        estimate_white(picture, "bayesian", grey)
    assert "\n" not in str(refusal.value)


def test_large_blocks_serve_in_low_light(known):
    """Noise of 10 % of white in every block, as if each were a pixel; over eight drawings.

    Four blocks as one halve it. The floor says how noisy a pixel is; without it, the largest of 3072
    noisy blocks is taken for white.
    """
    qe, transforms = known
    colors, white = seen(qe, "D55", reflectances("macbeth"))
    clean = (colors / colors.max())[:, np.repeat(np.repeat(discs(24, 24, 32), 2, 0), 2, 1)]
    errors: dict[float, list] = {0.0: [], 0.1: []}
    for seed in range(8):
        noisy = clean + np.random.default_rng(seed).normal(0, 0.1, clean.shape)
        noisy[:, 5, 7] = np.nan  # a clipped block is left out of its four
        for floor, found in errors.items():
            estimate = estimate_white(noisy, "bayesian", transforms, floor=floor)
            found.append(degrees(estimate.white, white))
    assert np.mean(errors[0.1]) < np.mean(errors[0.0])
