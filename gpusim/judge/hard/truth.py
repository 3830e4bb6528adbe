"""Images of a round lens as sums in real space, float64.

There is no transfer function, no period and no plane, except in the two functions on periodic
worlds.
"""

from functools import lru_cache

import numpy as np
from scipy.signal import fftconvolve
from scipy.special import j0, j1

from gpusim.judge.truth_light import centre_pads


def relative(result, truth) -> float:
    """Return the RMS error over the RMS of the truth."""
    return float(np.sqrt(np.mean((result - truth) ** 2) / np.mean(truth**2)))


def airy(radius, q: float) -> np.ndarray:
    """Return the energy per square pixel at a distance from a point in focus.

    (pi / 4 q^2) (2 J1(v) / v)^2, v = pi r / q.

    Args:
        radius: Distance [pixel].
        q: Wavelength times f-number over pitch.

    Source: Airy.
    """
    v = np.maximum(np.pi * radius / q, 1e-9)
    return np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2


def defocused_airy(q: float, waves: float, reach: float, hole: float = 0.0):
    """Return the same out of focus, as a function of the distance [pixel].

    The integral of J0 over the pupil, in a table of 24 entries per ring.

    Args:
        q: Wavelength times f-number over pitch.
        waves: Defocus W020 at the edge of the pupil [wave].
        reach: Largest distance [pixel].
        hole: Radius of a central obstruction over the radius of the pupil.

    Source: Born and Wolf, 8.5 and 8.8.
    """
    from scipy.interpolate import CubicSpline

    radius = np.arange(0, reach + q, q / 24)
    nodes, mass = np.polynomial.legendre.leggauss(int(np.pi * reach / q / 2 + 8 * abs(waves) + 40))
    rho = (1 + hole) / 2 + (1 - hole) / 2 * nodes
    pupil = (1 - hole) / 2 * mass * rho * np.exp(2j * np.pi * waves * rho**2)
    field = np.concatenate(
        [j0(np.pi / q * np.outer(part, rho)) @ pupil for part in np.array_split(radius, 64)]
    )
    return CubicSpline(radius, np.pi / (q * q) * np.abs(field) ** 2 / (1 - hole**2))


def in_pixels(light, dy, dx, order: int) -> np.ndarray:
    """Return the integral of `light(radius)` over pixels, shape (len dy, len dx).

    Args:
        light: Energy per square pixel as a function of the distance [pixel].
        dy: Rows of the pixel centres, from the point.
        dx: Columns of the pixel centres, from the point.
        order: Points of the Gauss-Legendre rule along a side; 6 or more per ring give 1e-9.
    """
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(order))
    y, x = (np.asarray(d)[:, None] + nodes for d in (dy, dx))
    out = np.empty((len(y), len(x)))
    for row, at in zip(out, y, strict=True):
        row[:] = np.einsum("axb,a,b->x", light(np.hypot(at[:, None, None], x)), mass, mass)
    return out


def point(q: float, dy, dx) -> np.ndarray:
    """Return the light of a point in focus in the pixels whose centres are (dy, dx) from it."""
    return in_pixels(lambda radius: airy(radius, q), dy, dx, int(np.ceil(6 + 3 / q)))


@lru_cache(maxsize=64)
def kernel(q: float, reach: int) -> np.ndarray:
    """Return the light of a point in the pixels around it, shape (2 reach + 1, 2 reach + 1)."""
    at = np.arange(reach + 1)
    return whole(point(q, at, at))


def whole(quarter) -> np.ndarray:
    """Return a kernel that is even along both axes, from its quarter."""
    at = np.abs(np.arange(-len(quarter) + 1, len(quarter)))
    return quarter[np.ix_(at, at)]


def spread(values, q, weights) -> np.ndarray:
    """Return the channels of a scene in a dark world, (C, rows, cols).

    The light of every wavelength is spread by its own kernel.

    Args:
        values: Shape (L, rows, cols).
        q: Wavelength times f-number over pitch, per wavelength.
        weights: Shape (C, L).
    """
    reach = max(values.shape[1:]) - 1
    out = np.zeros((len(weights), *values.shape[1:]))
    for plane, one, weight in zip(values, q, weights.T, strict=True):
        if plane.any():
            out += weight[:, None, None] * fftconvolve(plane, kernel(float(one), reach), "same")
    return out


def mosaic_of(channels, cfa) -> np.ndarray:
    """Return the own channel of every pixel, (rows, cols)."""
    y, x = np.indices(channels.shape[1:])
    return np.take_along_axis(channels, np.asarray(cfa)[y % len(cfa), x % len(cfa[0])][None], 0)[0]


def of_points(values, base, q, weights, cfa) -> np.ndarray:
    """Return the mosaic of the excess of single pixels over a uniform base, in a dark world.

    Args:
        values: Shape (L, rows, cols).
        base: Spectrum of all other pixels, shape (L,).
        q: Wavelength times f-number over pitch, per wavelength.
        weights: Shape (C, L).
        cfa: Channel of every pixel of the mosaic.
    """
    rows, cols = values.shape[1:]
    total = np.zeros((len(weights), rows, cols))
    for y, x in np.argwhere(np.any(values != base[:, None, None], axis=0)):
        more = values[:, y, x] - base
        for band in np.flatnonzero(more):
            total += (weights[:, band] * more[band])[:, None, None] * point(
                float(q[band]), np.arange(rows) - y, np.arange(cols) - x
            )
    return mosaic_of(total, cfa)


def even(base, weights, shape, cfa) -> np.ndarray:
    """Return the mosaic of a uniform world of the spectrum `base` (L,)."""
    return mosaic_of(np.broadcast_to((weights @ base)[:, None, None], (len(weights), *shape)), cfa)


def folded_otf(q: float, period: tuple[int, int], aperture: float = 1.0) -> np.ndarray:
    """Return the transfer function of a round lens and square pixels, real (period rows, cols).

    It is O(|f|) sinc, the sum of all replicas. The autocorrelation of a circle ends at 1 / q cycles
    per pixel. aperture: side of the light-sensitive area [pixel].

    Source: Goodman, Introduction to Fourier Optics, 6.3.
    """
    fy, fx = (np.fft.fftfreq(n) for n in period)
    reach = int(np.ceil(1 / q + 0.5))
    out = np.zeros(period)
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            y, x = fy[:, None] + a, fx + b
            s = np.minimum(q * np.hypot(y, x), 1)
            lens = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
            out += lens * np.sinc(aperture * y) * np.sinc(aperture * x)
    return out


def blur_periodic(values, q, weights, period) -> np.ndarray:
    """Return channels in a world that continues its outermost pixels and repeats with `period`.

    It is computed band by band, and judges stages that transform a period.
    """
    shape = values.shape[1:]
    pad = centre_pads(period, shape)
    total = np.zeros((len(weights), *period), complex)
    for plane, one, weight in zip(values, q, weights.T, strict=True):
        total += weight[:, None, None] * (
            folded_otf(float(one), period) * np.fft.fft2(np.pad(plane, pad, mode="edge"))
        )
    (top, _), (left, _) = pad
    return np.fft.ifft2(total).real[:, top : top + shape[0], left : left + shape[1]]
