"""Distances from views: textured patches at known distances, their uncertainty, and pictures sharp everywhere."""

import numpy as np
import pytest
from textured_views import HALF_DEPTH_OF_FOCUS, Waves, made_views, plane_views, thin_lens_slope

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange, UnknownName

PATCH, ACROSS = 32, 6  # [pixel], patches along an axis
NEAR, FAR = 0.35, 1.0  # [m]


@pytest.fixture(scope="module")
def patches():
    """Views of 6 x 6 textured patches, each at a distance of its own, and the distances."""
    random = np.random.default_rng(12)
    distances = 1 / random.uniform(1 / FAR, 1 / NEAR, (ACROSS, ACROSS))
    side = PATCH * ACROSS
    values = np.empty((9, 9, side, side, 1), np.float32)
    for a in range(ACROSS):
        for b in range(ACROSS):
            place = np.s_[:, :, a * PATCH : (a + 1) * PATCH, b * PATCH : (b + 1) * PATCH]
            slope = thin_lens_slope(distances[a, b])
            waves = Waves(random, count=10)
            values[place] = plane_views(waves, slope, (9, 9), (PATCH, PATCH))
    return values, distances


def middles(maps):
    """The values at the middle of each patch."""
    return maps[PATCH // 2 :: PATCH, PATCH // 2 :: PATCH]


@pytest.mark.parametrize("electrons", [None, 100])
@pytest.mark.parametrize("method", ["correspondence", "contrast"])
def test_patches_are_at_their_distance(patches, method, electrons):
    """Within half the depth of focus for 95 % of the patches, without noise and at 100 electrons a view."""
    values, distances = patches
    if electrons:
        noisy = np.random.default_rng(8).poisson(electrons * np.maximum(values, 0)) / electrons
        values = noisy.astype(np.float32)
    found = gs.depth_from_views(
        made_views(values), distances=(0.3, 1.5), method=method, device="opencl"
    )
    error = np.abs(middles(found.slope) - thin_lens_slope(distances))
    assert np.mean(error <= HALF_DEPTH_OF_FOCUS) >= 0.95
    # the same in distances, by the lens's own formula
    slope = thin_lens_slope(middles(found.distance))
    assert slope == pytest.approx(middles(found.slope), abs=1e-3)


def test_the_uncertainty_is_the_scatter():
    """Ten textures and noise of 10 %: errors over the predicted deviation have a mean square of 1.

    600 errors, of windows that do not overlap, scatter by 6 %; the estimates of noise and curvature in one window of 25
    pixels by some 20 % more; a factor of 1.5 is allowed in the root.
    """
    random, shares = np.random.default_rng(9), []
    for _ in range(10):
        slope = random.uniform(-2, 2)
        values = plane_views(Waves(random), slope, (5, 5), (80, 80))
        values = values + 0.1 * random.standard_normal(values.shape)
        found = gs.depth_from_views(
            made_views(values), distances=(0.35, 0.8), window=5, device="opencl"
        )
        inner = np.s_[10:-10:8, 10:-10:8]
        assert np.isfinite(found.uncertainty[inner]).all()
        shares.append((found.slope[inner] - slope) / found.uncertainty[inner])
        assert (found.nearest <= found.distance).all() and (found.distance <= found.farthest).all()
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(1, rel=0.5)


def test_no_texture_has_no_distance():
    flat = gs.depth_from_views(made_views(np.ones((3, 3, 40, 40, 1))), device="opencl")
    assert np.isinf(flat.uncertainty).all()
    random = np.random.default_rng(6)
    noisy = 1 + 0.1 * random.standard_normal((5, 5, 60, 60, 1))
    found = gs.depth_from_views(made_views(noisy), distances=(0.4, 0.8), device="opencl")
    # four standard deviations; gradients of noise are not quite normal
    assert np.isinf(found.uncertainty).mean() > 0.99
    views = made_views(plane_views(Waves(np.random.default_rng(1)), 1.0, (3, 3), (60, 60)))
    found = gs.depth_from_views(views, distances=(0.4, 0.8), device="opencl")
    assert np.isinf(found.uncertainty[0]).all() and np.isfinite(found.uncertainty[30, 30])
    assert np.isnan(
        gs.depth_from_views(views, method="contrast", device="opencl").uncertainty
    ).all()


def test_all_in_focus_is_sharp_at_two_distances():
    """Two halves at two distances: as sharp as the views themselves, which a picture of one focus is not.

    Waves up to 0.8 rad a pixel: the cubic loses up to w^4 / 64 = 0.6 %, and half a step of slope, 0.25 pixel of the
    outermost view, 1 - sinc(0.25 x 0.8) = 0.7 % along each axis: 1.3 % of waves that add up to 0.2 x 4.
    """
    random, halves, sharp = np.random.default_rng(7), [], []
    slopes = thin_lens_slope(0.42), thin_lens_slope(0.7)
    y, x = np.arange(64) - 31.5, np.arange(40) - 19.5
    for slope in slopes:
        waves = Waves(random, 0.8)
        halves.append(plane_views(waves, slope, (5, 5), (64, 40)))
        sharp.append(waves(y[:, None], x[None]))
    views = made_views(np.concatenate(halves, axis=3))
    before = views.values.copy()
    picture = gs.all_in_focus(views, distances=(0.35, 1.0), device="opencl")[..., 0]
    one = gs.refocus(views, slope=slopes[0], device="opencl")[..., 0]
    inner = np.s_[10:-10, 10:-10]
    for part, wanted in zip(np.split(picture, 2, axis=1), sharp, strict=True):
        assert np.abs(part - wanted)[inner].max() < 0.021
    assert np.abs(np.split(one, 2, axis=1)[1] - sharp[1])[inner].max() > 0.1
    assert np.array_equal(views.values, before)


def test_bad_requests():
    views = made_views(np.ones((2, 2, 9, 9, 1)))
    with pytest.raises(UnknownName, match="method"):
        gs.depth_from_views(views, method="sharpness")
    with pytest.raises(OutOfRange, match="window"):
        gs.depth_from_views(views, window=0)
    with pytest.raises(BadData, match="two views or more"):
        gs.depth_from_views(made_views(np.ones((1, 1, 9, 9, 1))))
    with pytest.raises(BadData, match="wanted ViewImages"):
        gs.all_in_focus(np.ones(3))
    small = gs.depth_from_views(made_views(np.ones((2, 2, 5, 5, 1))), device="opencl")
    with pytest.raises(BadData, match="9"):
        gs.all_in_focus(views, small)
