"""Point spreads of pixels that are far coarser than lambda N: the density of rays, with diffraction's tail, float64.

A ray through (u, v) meets the image at -2 q grad W. Diffraction takes the share c s from the transfer function at s =
q f of the cut-off, c = 4 / pi for a circle: pixels lose q times the light that the tail t r^-3 of `edge_strength`
throws out of them. Of the phases at the pupil's rim, which turn this share as they turn the light, only the mean is
kept: the transfer function errs by less than c q f, f <= sqrt(1/2) cycle per pixel.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.polynomial.polynomial import polyder, polygrid2d
from scipy.special import ndtr, roots_legendre

from gpusim.domain.pupil import Pupil
from gpusim.optics.mask_edges import edge_strength
from gpusim.optics.otf import defocus_only, transfer
from gpusim.optics.psf import coverage

FINEST, COARSEST = 16, 2  # bins to a pixel, in which rays are counted
MOST_BINS = 512  # from the middle to the farthest ray, if that takes more than COARSEST
RAYS = 3  # to a bin of the widest spread, along a side
LEAST_RAYS, MOST_RAYS = 96, 1536  # along the pupil
FEW_RINGS = 0.1  # of the cut-off, from which on errors of rays are measured
PROBES = 16  # frequencies
LEAST_PERIOD = 128  # [pixel] in which the tail is transformed
NEAR = 3  # [pixel] up to which the tail is integrated by a Gauss rule, and not by its value in the middle


def cusp(pupil: Pupil) -> float:
    """Return c of the transfer function 1 - c s near 0: the mean width that the pupil's edge loses."""
    # a tail t q r^-3 transforms to -2 pi t q 2 pi f
    return 4 * np.pi**2 * edge_strength(pupil)


def ray_error(pupil: Pupil, waves, q) -> float:
    """Return the error of `ray_tables` up to sqrt(1/2) cycle per pixel.

    In focus it is of second order. For defocus W of a circle the rim's phases 8 pi W s cos t leave 2.5 / (8 pi W
    s)^(1/2) of their mean, by their two stationary points.
    """
    s = min(float(np.max(q)) / np.sqrt(2), 1.0)
    lost = cusp(pupil) * s
    if not waves.any():
        return lost**2
    if pupil.is_clear_circle and defocus_only(pupil, waves):
        least = np.abs(waves[:, 2, 0]).min()
        return lost * min(1.0, 2.5 / np.sqrt(max(8 * np.pi * least * s, 1e-9)))
    return lost if s < FEW_RINGS else max(lost, _probe(pupil, waves[len(waves) // 2], s))


def _probe(pupil, wave, farthest):
    """Twice the largest error of rays at PROBES frequencies up to `farthest`, by quadrature."""
    number = np.arange(PROBES) + 0.5
    s, angle = farthest * (number / PROBES) ** 3, 2.4 * number
    x, y = s * np.cos(angle), s * np.sin(angle)
    moves = 2 * wave
    bins, width = _bins(pupil, moves.tobytes(), moves.shape)
    at = -2j * np.pi * (np.arange(len(bins)) - (len(bins) - 1) / 2) * width
    down, across = (np.exp(np.outer(f, at)) for f in (y, x))
    rays = np.einsum("fi,fi->f", down @ bins, across) * (1 - cusp(pupil) * s)
    return 2 * float(np.abs(rays - transfer(pupil, wave[None], x, y, error=1e-4)[0]).max())


def ray_kernel(
    pupil: Pupil, wave, q, shift, size: int, aperture, spots, soft: float, share: Any = None
) -> np.ndarray:
    """Return the light of rays in every pixel around a point's image, (size, size), of 1 over the aperture's area.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the pitch.
        shift: Displacement of the image, (rows, cols) [pixel].
        size: Side of the kernel [pixel], odd.
        aperture: Height and width over which each pixel is integrated [pixel].
        spots: Halves of the distances of a low-pass filter's images, (rows, cols) [pixel].
        soft: Standard deviation of a diffuser [pixel].
        share: Hashable, whose `of(y, x)` is the part of the light that counts at points of the pupil; None: all.
    """
    shape, first = (size, size), (-(size // 2),) * 2
    return _light(pupil, wave, q, shift, shape, first, aperture, spots, soft, False, share)


def _light(pupil, wave, q, shift, shape, first, aperture, spots, soft, is_periodic, share=None):
    """Light of rays in pixels of this shape, the first of them at `first`; or in a period's pixels."""
    # one optical path moves the rays of all wavelengths alike
    moves = np.round(2 * q * wave, 10)
    known = moves.tobytes(), moves.shape
    ends = (tuple(float(one) for one in both) for both in (shift, aperture, spots))
    return _count(pupil, *known, *ends, float(soft), shape, first, is_periodic, share)


@lru_cache(maxsize=8)
def _count(pupil, values, form, shift, aperture, spots, soft, shape, first, is_periodic, share):
    """See `_light`; values: see `_bins`."""
    bins, width = _bins(pupil, values, form, share)
    middle = (np.arange(len(bins)) - (len(bins) - 1) / 2) * width
    down, across = (
        _shares(middle + move, width, one, spot, soft, count, start, is_periodic)
        for move, spot, one, count, start in zip(shift, spots, aperture, shape, first, strict=True)
    )
    return (down @ (bins @ across.T)).astype(np.float64) / np.prod(aperture)


def _shares(places, width, aperture, spot, soft, count, first, is_periodic):
    """Part of the light of bins in each of `count` pixels, float32 (count, bins)."""
    out, bins = np.zeros((count, len(places)), np.float32), np.arange(len(places))
    reach = int(np.ceil((aperture + width + 1) / 2 + spot + 6 * soft))
    nearest = np.rint(places)
    for more in range(-reach, reach + 1):
        distance = nearest + more - places
        share = sum(_overlap(distance + side * spot, aperture, width, soft) / 2 for side in (-1, 1))
        pixel = (nearest + more).astype(int) - first
        inside = bins if is_periodic else np.flatnonzero((pixel >= 0) & (pixel < count))
        out[pixel[inside] % count, inside] += share[inside]
    return out


def _overlap(distance, aperture, width, soft):
    """Part of the light of a bin that is in an aperture at a distance."""
    if soft:
        return ndtr((distance + aperture / 2) / soft) - ndtr((distance - aperture / 2) / soft)
    low, high = ((distance + side * aperture / 2) / width + 0.5 for side in (-1, 1))
    return np.clip(high, 0, 1) - np.clip(low, 0, 1)


@lru_cache(maxsize=8)
def _bins(pupil, values, shape, share=None):
    """Light of rays in square bins, (n, n), of 1 in all, and their width [pixel].

    values: of 2 q times the wavefront's coefficients, whose slopes move the rays. share: see `ray_kernel`.
    """
    moves = np.frombuffer(values).reshape(shape)
    along = [polyder(moves, axis=k) for k in (0, 1)]
    if not any(one.any() for one in along):
        return np.full((1, 1), 1.0 if share is None else _mean_share(pupil, share)), 1e-9
    edge = np.linspace(-1, 1, 65)
    disc = np.hypot(edge[:, None], edge) <= 1
    slopes = [np.abs(polygrid2d(edge, edge, one).T[disc]).max() for one in along]
    reach = max(*slopes, 1e-9)
    finest = np.clip(MOST_BINS / reach, COARSEST, FINEST)
    count = int(np.clip(2 * np.ceil(finest * reach) + 1, 9, 6 * MOST_BINS + 1)) + 2
    width = 2 * reach / (count - 3)
    rays = int(np.clip(RAYS * count, LEAST_RAYS, MOST_RAYS))
    u = (np.arange(rays) + 0.5) / rays * 2 - 1
    open_ = coverage(pupil, rays)
    bins = np.zeros(count * count)
    inside = np.nonzero(open_)
    light = open_[inside] / open_.sum()
    if share is not None:
        light = light * share.of(u[:, None], u)[inside]
    place = [-polygrid2d(u, u, one).T[inside] / width + (count - 1) / 2 for one in reversed(along)]
    first = [np.clip(np.floor(one).astype(int), 0, count - 2) for one in place]
    rest = [np.clip(one - low, 0, 1) for one, low in zip(place, first, strict=True)]
    for dy in (0, 1):
        for dx in (0, 1):
            share = light * np.abs(1 - dy - rest[0]) * np.abs(1 - dx - rest[1])
            bins += np.bincount((first[0] + dy) * count + first[1] + dx, share, count * count)
    return bins.reshape(count, count).astype(np.float32), width


def _mean_share(pupil, share):
    """Part of the light of the whole pupil that counts."""
    open_ = coverage(pupil, LEAST_RAYS)
    u = (np.arange(LEAST_RAYS) + 0.5) / LEAST_RAYS * 2 - 1
    return (open_ * share.of(u[:, None], u)).sum() / open_.sum()


def ray_tables(pupil: Pupil, waves, q, rows, cols, aperture, spots, soft, shift) -> np.ndarray:
    """Return transfer tables, complex (bands, rows, cols // 2 + 1): see `ray_kernel`."""
    out = np.empty((len(waves), rows, cols // 2 + 1), complex)
    for own, wave, one in zip(out, waves, q, strict=True):
        light = _light(
            pupil, wave, one, shift, (rows, cols), (0, 0), aperture, spots, soft, is_periodic=True
        )
        own[:] = scipy.fft.rfft2(light) * _tail_factor(pupil, wave, one, aperture, rows, cols)
    return out


@lru_cache(maxsize=8)
def _tail(rows, cols, aperture):
    """Transform of the mean of r^-3 over the apertures of a period's pixels, less all that leaves the point's own."""
    down, across = (-(-LEAST_PERIOD // n) for n in (rows, cols))
    rows, cols = rows * down, cols * across
    y, x = (np.fft.fftfreq(n, 1 / n) for n in (rows, cols))
    radius = np.hypot(y[:, None], x)
    radius[0, 0] = np.inf
    light = radius**-3.0
    (height, width), (nodes, gauss) = aperture, roots_legendre(8)
    near = np.argwhere((np.abs(y)[:, None] <= NEAR) & (np.abs(x) <= NEAR))
    for i, j in near[1:]:
        cell = np.hypot(y[i] + height / 2 * nodes[:, None], x[j] + width / 2 * nodes) ** -3.0
        light[i, j] = gauss @ cell @ gauss / 4
    light[0, 0] = _outside(rows, cols) - _outside(height, width) / (height * width)
    spectrum = scipy.fft.rfft2(light)
    return spectrum[::down, ::across]  # every so many of a longer period's frequencies


def _outside(height, width):
    """Integral of r^-3 outside a rectangle."""
    return 8 * np.hypot(height, width) / (height * width)


def _tail_factor(pupil, wave, q, aperture, rows, cols):
    """Factor of the transform of a kernel of rays that diffraction's tail makes.

    Rays in one point leave its own aperture. Others leave apertures and gaps alike.
    """
    own = (1.0, 1.0) if wave.any() else tuple(aperture)
    return 1 + q * edge_strength(pupil) * np.prod(own) * _tail(rows, cols, own)


def coarse_kernel(pupil: Pupil, wave, q, shift, size: int, aperture, spots, soft) -> np.ndarray:
    """Return the light in every pixel around a point's image: see `gpusim.optics.sampled.sampled_kernel`."""
    kernel = ray_kernel(pupil, wave, q, shift, size, aperture, spots, soft)
    period = 2 * size
    wide = np.zeros((period, period))
    wide[:size, :size] = kernel
    factor = _tail_factor(pupil, wave, q, aperture, period, period)
    kernel = scipy.fft.irfft2(scipy.fft.rfft2(wide) * factor, (period, period))[:size, :size]
    return kernel / max(kernel.sum(), 1e-300)  # apertures with gaps share all light
