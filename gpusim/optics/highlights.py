"""Highlights: pixels so bright that a float32 transform would drown the dark around them; each is added exactly.

A float32 transform has an error of 2.5e-7 of the field's root mean square everywhere: next to one
pixel 1e9 times as bright as the rest this is up to 68 % of the rest. So a pixel above THRESHOLD
times the median stays in the planes at the median, and its excess becomes a point light with its
own spectrum, whose kernel is summed in the image itself, without transforms. It never wraps around.
The border's rule holds for it too: a mirrored border mirrors it. A pixel at the edge of a picture
whose edge continues would become a line of light, and is not split.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from gpusim.domain.content import Content

THRESHOLD = 100.0  # times the median
MOST = 64  # points; others stay in the planes, and their error is reported
MOST_IMAGES = 1024  # of all points and their mirror images
TRANSFORM_ERROR = 2.5e-7  # of a float32 transform, over the field's root mean square
NEGLIGIBLE = 1e-6  # of the median: smaller contributions of a point are left out
CORE = 32  # [pixel] kernels are tabled pixel by pixel up to here, by radius beyond
PER_RING = 64  # samples of a radial table to a diffraction ring


@dataclass(frozen=True, eq=False)
class Highlights:
    """Point lights in the frame's pixels.

    places: rows and columns, int (N, 2), counted from the frame's first pixel; mirror images lie outside. light: which
    of the spectra, int (N,). strength: times that spectrum, (N,). spectra: (K, L). reach: farthest pixel each adds to
    [pixel], int (N,). residue: local error, over the median, from bright pixels beyond the MOST that stayed in the
    planes. missing: what mirror images beyond the reach would give to every pixel, in the unit of brightness.
    """

    places: np.ndarray
    light: np.ndarray
    strength: np.ndarray
    spectra: np.ndarray
    reach: np.ndarray
    residue: float
    missing: float


def unsplit_error(brightness) -> float:
    """Return the local error, over the median, next to highlights that stay in the planes; 0 without highlights."""
    median = median_of(brightness)
    if not 0 < THRESHOLD * median < brightness.max():
        return 0.0
    return _transform_error(brightness, median)


def _transform_error(brightness, median):
    rms = float(np.sqrt(np.square(brightness, dtype=np.float64).mean()))
    return TRANSFORM_ERROR * rms / median


def median_of(brightness) -> float:
    """Return the median; if more than MOST pixels are lit and the rest is dark, the median of the lit ones."""
    step = max(1, int(np.sqrt(brightness.size / 2**16)))
    median = float(np.median(brightness[::step, ::step]))
    if median > 0 or np.count_nonzero(brightness > 0) <= MOST:
        return max(median, 0.0)
    return float(np.median(brightness[brightness > 0]))


def split_highlights(content: Content, brightness, q: float, margin: int, border: str):
    """Return the content without its highlights, and the highlights (None if none can be split off).

    Args:
        content: The content.
        brightness: Of the content, see `Content.brightness`; written to: without the highlights
            on return.
        q: Largest wavelength times f-number over pitch.
        margin: Of the scene around the frame [pixel].
        border: "zero", "edge" or "reflect".
    """
    median = median_of(brightness)
    bright = np.flatnonzero(brightness > THRESHOLD * median)
    rows, cols = np.unravel_index(bright, brightness.shape)
    single = np.ones(len(bright), bool)
    high, wide = brightness.shape
    if border == "edge":
        single = (0 < rows) & (rows < high - 1) & (0 < cols) & (cols < wide - 1)
    elif border == "reflect":
        longest = max(high, wide)
        images = MOST * (2 * (longest // high) + 1) * (2 * (longest // wide) + 1)
        single[:] = images <= MOST_IMAGES  # no narrow strip between two mirrors
    chosen = bright[single]
    chosen = chosen[np.argsort(brightness.flat[chosen])[::-1][:MOST]]
    if not len(chosen):
        return content, None
    rows, cols = np.unravel_index(chosen, brightness.shape)
    level = brightness[rows, cols].astype(np.float64)
    keep = (median / level).astype(np.float32)
    spectra, light, strength = content.points(rows, cols)
    # a copy; the rest is exact
    planes = content.planes.astype(np.promote_types(content.planes.dtype, np.float32))
    rest = content.with_planes(planes)
    stored = planes[..., rows, cols].astype(np.float64)
    planes[..., rows, cols] *= keep
    # exactly what was taken away, the rounding of the stored remainder included
    left = planes[..., rows, cols] / np.where(stored == 0, 1, stored)
    if left.ndim > 1:
        left = np.where(stored == 0, 0, left).max(axis=0)
    strength = strength * (1 - left)
    brightness[rows, cols] = median
    residue = 0.0
    if len(bright) > len(chosen):
        residue = _transform_error(brightness, max(median, 1e-38))
    # beyond r pixels an Airy pattern stays below 2 q / (pi^3 r^3) a pixel (the envelope of its rings)
    floor = max(NEGLIGIBLE * median, 1e-12 * level.max())
    reach = np.ceil(np.cbrt(2 * q * level / (np.pi**3 * floor)))
    reach = np.minimum(np.maximum(reach, CORE), max(high, wide)).astype(np.int32)
    places = np.stack([rows, cols], axis=1)
    image = np.arange(len(rows))
    missing = 0.0
    if border == "reflect":
        # q / (pi^3 r^3) outside a square of half-width a has the integral 4 sqrt(2) a^-1 of it
        beyond = q / np.pi**3 * 4 * np.sqrt(2) * ((level - median) / reach).sum()
        missing = float(beyond / brightness.size)
        for axis, n in enumerate((high, wide)):
            places, image = _mirror(places, image, axis, n, reach)
    return rest, Highlights(
        places - margin,
        light[image].astype(np.int32),
        strength[image],
        spectra,
        reach[image],
        residue,
        missing,
    )


def _mirror(places, image, axis, n, reach):
    """Places with all mirror images along an axis of n pixels that reach into the frame, and which point each is of."""
    parts = []
    for turn in range(-(max(reach) // n) - 1, max(reach) // n + 2):  # a frame's width each
        at = turn * n + (places[:, axis] if turn % 2 == 0 else n - 1 - places[:, axis])
        near = np.maximum(-at, at - (n - 1)) <= reach[image]
        moved = places.copy()
        moved[:, axis] = at
        parts.append((moved[near], image[near]))
    found, images = zip(*parts, strict=True)
    return np.concatenate(found), np.concatenate(images)


def airy_density(radius, q):
    """Energy per square pixel at `radius` [pixel] of a point: (pi / 4 q^2) (2 J1(v) / v)^2, v = pi r / q (Airy)."""
    v = np.maximum(np.pi * radius / q, 1e-9)
    return np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2


@dataclass(frozen=True, eq=False)
class PointKernels:
    """Pixel-integrated Airy patterns, one per wavelength.

    cores: at whole pixels (dy, dx) up to CORE, shape (L, CORE + 1, CORE + 1). profiles: at radii 0, step, 2 step ...
    [pixel], shape (L, n), averaged over the `parts`-th part of a pixel's side in the mean over all directions: a mean
    of parts x parts of them is a pixel to 1e-3, from CORE on. spread: side of a part [pixel].
    """

    cores: np.ndarray
    profiles: np.ndarray
    step: float
    parts: int
    spread: float


def point_kernels(q, aperture: float, reach: int) -> PointKernels:
    """Return kernels up to `reach` pixels for wavelengths of `q` (lambda N / pitch).

    aperture: width of a pixel's aperture [pixel]. A ring pattern of period q averaged over a small
    square depends little on the square's direction: by +- 1 % for squares of half a ring. So a
    pixel is cut into `parts` per side, each replaced by its mean over directions.
    """
    q = np.asarray(q, np.float64)
    order = int(np.ceil(6 + 3 * aperture / q.min()))
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(order))
    offsets = (np.arange(CORE + 1)[:, None] + aperture * nodes).ravel()
    radius = np.hypot(offsets[:, None], offsets)
    cores = np.empty((len(q), CORE + 1, CORE + 1))
    for core, one in zip(cores, q, strict=True):
        values = airy_density(radius, one).reshape(CORE + 1, order, CORE + 1, order)
        core[:] = np.einsum("iajb,a,b->ij", values, mass, mass)
    parts = int(np.ceil(2 * aperture / q.min()))
    spread, step = aperture / parts, q.min() / PER_RING
    count = int(np.ceil((np.sqrt(2) * (reach + 1)) / step)) + 2
    radii = step * np.arange(count)
    smooth = _mean_over_directions(spread, step)
    margin = len(smooth) // 2
    padded = np.abs(step * np.arange(-margin, count + margin))
    profiles = np.stack([np.convolve(airy_density(padded, one), smooth, "valid") for one in q])
    return PointKernels(cores, profiles[:, : len(radii)], step, parts, spread)


def _mean_over_directions(side, step):
    """Weights, `step` apart, of the distribution of a square's points along a line, over all directions of the line."""
    angles = (np.arange(16) + 0.5) / 16 * np.pi / 4
    half = int(np.ceil(side / np.sqrt(2) / step)) + 1
    edges = step * (np.arange(-half, half + 2) - 0.5)
    total = 0
    for angle in angles:
        a, b = side * np.cos(angle) / 2, side * np.sin(angle) / 2
        corners = ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b))
        # the distribution function: the sum of two uniform variables, as a second integral of its corners
        total = total + sum(s * np.maximum(edges + c, 0) ** 2 for s, c in corners) / (8 * a * b)
    weights = np.diff(total / len(angles))
    return weights / weights.sum()
