"""Distances from the views of a light field, with their uncertainty, and pictures sharp everywhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.captures.refocus import checked_views, focus_each, slopes_between, view_planes
from gpusim.domain.errors import BadData, check_known, checked_count
from gpusim.domain.memory import require_memory
from gpusim.domain.short_repr import short_repr
from gpusim.domain.view_images import ViewImages

METHODS = ("correspondence", "contrast")
SMOOTH = (0.25, 0.5, 0.25)  # of views before they are compared
# correlation of white noise that was smoothed so, at 0, 1 and 2 pixels either way
CORRELATION = np.array([1, 4, 6, 4, 1]) / 6
GRADIENT = 5 / 12  # mean square of its gradient along an axis, over its variance: (1 - 1 / 6) / 2
SURE = 4.0  # standard deviations by which a texture has to exceed the noise
SAME = 6.0  # gradients of noise in a window, over those that are independent of one another
ROUNDING = 8 * 2.0**-24  # of an interpolated view, relative to its light
MOST_WINDOW = 201


@dataclass(frozen=True, eq=False)
class ViewDepth:
    """Distances of a picture's pixels.

    Attributes:
        slope: Displacement in the views, float32, shape (rows, cols) [pixel per radius].
        uncertainty: Standard deviation of the slope by the views' own noise, infinite if it is
            not known, shape (rows, cols); NaN for the method "contrast", which does not know it.
        distance: Distance from the lens [m], shape (rows, cols).
        nearest: Distance at one standard deviation nearer, shape (rows, cols) [m].
        farthest: Distance at one standard deviation farther, shape (rows, cols) [m].
    """

    slope: np.ndarray
    uncertainty: np.ndarray
    distance: np.ndarray
    nearest: np.ndarray
    farthest: np.ndarray

    __repr__ = short_repr


def depth_from_views(
    views: ViewImages,
    *,
    distances: Sequence[float] | None = None,
    method: str = "correspondence",
    window: int = 9,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
) -> ViewDepth:
    """Return the distance of every pixel.

    Views are smoothed by (1, 2, 1) / 4 along both axes, so that interpolation leaves their noise
    alike at all slopes. For slopes half a pixel of the outermost view apart, "correspondence" takes
    the variance over the views, displaced by the slope, and "contrast" the squared gradient of their
    mean, both averaged over a window. The slope is the vertex of a parabola through the best value
    and its two neighbours.

    "correspondence" has the uncertainty of a least-squares fit. The variance C at the best
    slope, times n / (n - 1), is the noise of n views, and C'' twice the mean square of the change
    of a view with the slope, so that over a window of w pixels in c channels

        uncertainty^2 = 2 r C / ((n - 1) w c C''),

    with C and C'' summed over channels. r is the noise's power at the frequencies of the texture
    over its mean power, from the gradient of the picture and the correlation of smoothed noise. A
    thing that only a part of the views sees, a texture that repeats, and a pattern of the sensor,
    which is at one place in all views and looks like a thing in focus, are not in it. It is infinite
    for pixels whose window the outermost views do not show, at the ends of the range, without a
    minimum, and without texture: if the gradient of the mean of all views is no larger, by SURE
    standard deviations, than its noise explains.

    Args:
        views: The views, 2 or more.
        distances: Nearest and farthest distance [m]; None: from half the object distance to
            infinity.
        method: "correspondence" or "contrast".
        window: Side of the window [pixel]; an even one is made one pixel larger.
        aperture: As for `refocus`.
        device: As for `refocus`.

    Returns:
        The distances.

    Raises:
        BadData: `views` is no ViewImages, or only one view has a weight.
        OutOfRange: The range or the window is not allowed.
        UnknownName: The method is not known.
        DoesNotFit: The views do not fit into memory.

    Source:
        Tao et al. 2013, "Depth from combining defocus and correspondence using light-field
        cameras", for the two measures.
    """
    checked_views(views)
    check_known("method", method, METHODS)
    window = checked_count("window", window, 1, MOST_WINDOW) // 2 * 2 + 1
    weights = views.weigh(aperture)
    if np.count_nonzero(weights) < 2:
        raise BadData("distances need two views or more with a weight")
    slopes = slopes_between(views, distances)
    rows, cols, channels = views.values.shape[2:]
    what = f"distances of {rows} x {cols} pixels by {len(slopes)} slopes"
    require_memory(what, 2 * views.values.nbytes + 4 * rows * cols * (len(slopes) + 4 * channels))
    by_contrast = method == "contrast"
    costs = np.empty((len(slopes), rows, cols), np.float32)
    picture = np.zeros((channels, rows, cols), np.float32)
    least = np.full((rows, cols), np.inf, np.float32)
    planes = _smooth(view_planes(views.values))
    pictures = focus_each(views, planes, slopes, aperture, device, not by_contrast)
    for k, found in enumerate(pictures):
        mean = found[:channels]
        cost = -_energy(mean) if by_contrast else found[channels:].sum(axis=0)
        costs[k] = scipy.ndimage.uniform_filter(cost, window, mode="nearest")
        picture = np.where(costs[k] < least, mean, picture)
        least = np.minimum(costs[k], least)
    slope, value, curvature = _vertex(costs, slopes)
    if by_contrast:
        uncertainty = np.full((rows, cols), np.nan)
    else:
        count = weights.sum() ** 2 / (weights**2).sum()
        value = np.maximum(value, np.square(ROUNDING * picture).sum(axis=0))
        places = np.average(np.square(views.places), axis=(0, 1), weights=weights)
        energy, noisy = _texture_energy(picture, places, window)
        noise = GRADIENT * places.sum() * value / count
        is_textured = energy > (1 + SURE * np.sqrt(SAME / (channels * window**2))) * noise
        samples = (count - 1) * channels * window**2
        with np.errstate(divide="ignore", invalid="ignore"):
            uncertainty = np.sqrt(2 * noisy / energy * value / (samples * curvature))
        is_known = np.isfinite(uncertainty) & is_textured
        is_known &= _is_seen(slope, views.places, window)
        uncertainty = np.where(is_known, uncertainty, np.inf)
    slope = np.clip(slope, slopes[1], slopes[-2])
    low, high = (views.distance_at(slope + sign * _finite(uncertainty)) for sign in (-1, 1))
    return ViewDepth(
        slope.astype(np.float32),
        uncertainty.astype(np.float32),
        views.distance_at(slope),
        np.minimum(low, high),
        np.maximum(low, high),
    )


def all_in_focus(
    views: ViewImages,
    depth: ViewDepth | None = None,
    *,
    distances: Sequence[float] | None = None,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
) -> np.ndarray:
    """Return the picture in which each pixel is focused at its own distance.

    Pictures at the slopes of `depth_from_views` are interpolated linearly between the two nearest.

    Args:
        views: The views.
        depth: Distances of `depth_from_views`; None: computed from all views.
        distances: Range of distances, as for `depth_from_views`.
        aperture: As for `refocus`.
        device: As for `refocus`.

    Returns:
        Linear picture, float32, shape (rows, cols, C).

    Raises:
        BadData: As for `depth_from_views`, or `depth` has another size.
        OutOfRange: As for `depth_from_views`.
        DoesNotFit: The views do not fit into memory.
    """
    checked_views(views)
    if depth is None:
        depth = depth_from_views(views, distances=distances, device=device)
    if depth.slope.shape != views.values.shape[2:4]:
        raise BadData(f"depth {depth.slope.shape}, wanted one of {views.values.shape[2:4]} pixels")
    slopes = slopes_between(views, distances)
    step = slopes[1] - slopes[0]
    at = np.clip(depth.slope, slopes[0], slopes[-1])
    out = np.zeros(views.values.shape[2:], np.float32)
    pictures = focus_each(views, view_planes(views.values), slopes, aperture, device)
    for slope, found in zip(slopes, pictures, strict=True):
        share = np.maximum(1 - np.abs(at - slope) / step, 0).astype(np.float32)
        out += share[..., None] * np.moveaxis(found, 0, -1)
    return out


def _smooth(planes):
    """Return views smoothed along both axes, in memory of their own."""
    smoothed = np.empty_like(planes)
    for view, out in zip(planes, smoothed, strict=True):
        along = scipy.ndimage.convolve1d(view, SMOOTH, 1, mode="nearest")
        scipy.ndimage.convolve1d(along, SMOOTH, 2, out, "nearest")
    return smoothed


def _gradients(picture):
    """Return the change per pixel along rows and columns, shape (2, C, rows, cols)."""
    half = (0.5, 0, -0.5)
    return np.stack(
        [scipy.ndimage.convolve1d(picture, half, axis, mode="nearest") for axis in (1, 2)]
    )


def _energy(picture):
    """Return the squared gradient, summed over channels, shape (rows, cols)."""
    return np.square(_gradients(picture)).sum(axis=(0, 1))


def _vertex(costs, slopes):
    """Return the slope, value and second derivative at the minimum of each pixel's costs.

    Derivatives are 0 if the least cost is the first or the last one.
    """
    best = costs.argmin(axis=0)
    inner = np.clip(best, 1, len(slopes) - 2)
    before, at, after = (
        np.take_along_axis(costs, (inner + move)[None], 0)[0].astype(np.float64)
        for move in (-1, 0, 1)
    )
    bend, tilt = before - 2 * at + after, (after - before) / 2
    is_inside = (best == inner) & (bend > 0)
    move = np.where(is_inside, -tilt / np.where(is_inside, bend, 1), 0)
    step = slopes[1] - slopes[0]
    value = np.maximum(at + move * tilt / 2, 0)
    return slopes[best] + move * step, value, np.where(is_inside, bend / step**2, 0)


def _texture_energy(picture, places, window):
    """Return the mean squared change with the slope in a window, and the same with correlated noise's weights.

    picture: planes. places: mean squares of the places along rows and columns: a view at the place (y, x)
    changes by its gradient times the place. The second over the first is the power of smoothed noise at
    the frequencies of the changes, over its mean.
    """
    both = np.zeros((2, *picture.shape[1:]))
    for gradient, share in zip(_gradients(picture), places, strict=True):
        noise = gradient
        for axis in (1, 2):
            noise = scipy.ndimage.convolve1d(noise, CORRELATION, axis, mode="nearest")
        for part, product in zip(both, (gradient**2, gradient * noise), strict=True):
            part += share * scipy.ndimage.uniform_filter(product.sum(axis=0), window)
    return both[0], np.maximum(both[1], 0)


def _is_seen(slope, places, window):
    """Return whether all views show a pixel's window, bool (rows, cols)."""
    seen = np.ones(slope.shape, bool)
    for axis in (0, 1):
        count, shape = slope.shape[axis], [1, 1]
        shape[axis] = count
        place = np.arange(count).reshape(shape)
        to_edge = np.minimum(place, count - 1 - place)
        seen &= to_edge >= np.abs(slope) * np.abs(places[..., axis]).max() + ceil(window / 2)
    return seen


def _finite(uncertainty):
    """Return an uncertainty with large numbers in place of infinite ones and of NaN."""
    return np.nan_to_num(uncertainty, nan=0.0, posinf=1e9)
