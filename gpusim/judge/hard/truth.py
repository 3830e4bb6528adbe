"""Pictures of a round lens by sums in real space alone, float64: no transfer function, no period, no planes."""

from functools import lru_cache

import numpy as np
from scipy.signal import fftconvolve
from scipy.special import j0, j1


def relative(result, truth) -> float:
    """Root mean square error over the root mean square."""
    return float(np.sqrt(np.mean((result - truth) ** 2) / np.mean(truth**2)))


def airy(radius, q: float) -> np.ndarray:
    """Energy per square pixel at `radius` [pixel] of a point: (pi / 4 q^2) (2 J1(v) / v)^2, v = pi r / q (Airy)."""
    v = np.maximum(np.pi * radius / q, 1e-9)
    return np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2


def defocused(q: float, waves: float, reach: float):
    """The same out of focus by `waves` of W020 at the pupil's rim, up to `reach`: a function of the radius [pixel].

    The integral of J0 over the pupil (Born and Wolf, 8.8), tabled 24 times a ring.
    """
    from scipy.interpolate import CubicSpline

    radius = np.arange(0, reach + q, q / 24)
    nodes, mass = np.polynomial.legendre.leggauss(int(np.pi * reach / q / 2 + 8 * abs(waves) + 40))
    rho = (1 + nodes) / 2
    pupil = mass / 2 * rho * np.exp(2j * np.pi * waves * rho**2)
    field = np.concatenate(
        [j0(np.pi / q * np.outer(part, rho)) @ pupil for part in np.array_split(radius, 64)]
    )
    return CubicSpline(radius, np.pi / (q * q) * np.abs(field) ** 2)


def in_pixels(light, dy, dx, order: int) -> np.ndarray:
    """Integral of `light(radius)` over the pixels whose middles are (dy, dx) from a point, shape (len dy, len dx).

    order: of the Gauss-Legendre rule along a side; 6 points and more to a ring give 1e-9.
    """
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(order))
    y, x = (np.asarray(d)[:, None] + nodes for d in (dy, dx))
    out = np.empty((len(y), len(x)))
    for row, at in zip(out, y, strict=True):
        row[:] = np.einsum("axb,a,b->x", light(np.hypot(at[:, None, None], x)), mass, mass)
    return out


def point(q: float, dy, dx) -> np.ndarray:
    """Light of a point in focus in the pixels whose middles are (dy, dx) from it."""
    return in_pixels(lambda radius: airy(radius, q), dy, dx, int(np.ceil(6 + 3 / q)))


@lru_cache(maxsize=64)
def kernel(q: float, reach: int) -> np.ndarray:
    """Light of a point in the pixels around it, shape (2 reach + 1, 2 reach + 1)."""
    at = np.arange(reach + 1)
    return whole(point(q, at, at))


def whole(quarter) -> np.ndarray:
    """A kernel that is even along both axes from its quarter."""
    at = np.abs(np.arange(-len(quarter) + 1, len(quarter)))
    return quarter[np.ix_(at, at)]


def spread(values, q, weights) -> np.ndarray:
    """Channels of a scene in a dark world: every wavelength's light spread by its own kernel, (C, rows, cols).

    values: shape (L, rows, cols). q: of each wavelength. weights: shape (C, L).
    """
    reach = max(values.shape[1:]) - 1
    out = np.zeros((len(weights), *values.shape[1:]))
    for plane, one, weight in zip(values, q, weights.T, strict=True):
        if plane.any():
            out += weight[:, None, None] * fftconvolve(plane, kernel(float(one), reach), "same")
    return out


def mosaic_of(channels, cfa) -> np.ndarray:
    """Every pixel's own channel, (rows, cols)."""
    y, x = np.indices(channels.shape[1:])
    return np.take_along_axis(channels, np.asarray(cfa)[y % len(cfa), x % len(cfa[0])][None], 0)[0]


def of_points(values, base, q, weights, cfa) -> np.ndarray:
    """The mosaic of what single pixels have more than an even base, the world outside dark.

    values: shape (L, rows, cols). base: the spectrum of all other pixels, shape (L,).
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
    """The mosaic of an even world of the spectrum `base` (L,)."""
    return mosaic_of(np.broadcast_to((weights @ base)[:, None, None], (len(weights), *shape)), cfa)


def folded_otf(q: float, period: tuple[int, int]) -> np.ndarray:
    """Transfer function of a round lens and square pixels, real (period rows, cols): O(|f|) sinc, all replicas added.

    The autocorrelation of a circle (Goodman, Introduction to Fourier Optics, 6.3) ends at 1 / q cycles per pixel.
    """
    fy, fx = (np.fft.fftfreq(n) for n in period)
    reach = int(np.ceil(1 / q + 0.5))
    out = np.zeros(period)
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            y, x = fy[:, None] + a, fx + b
            s = np.minimum(q * np.hypot(y, x), 1)
            out += 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s)) * np.sinc(y) * np.sinc(x)
    return out


def repeated(values, q, weights, period) -> np.ndarray:
    """Channels in a world that goes on as the outermost pixels do and repeats with `period`, band by band.

    For what is said of such a world: stages that transform take the period as it is.
    """
    shape = values.shape[1:]
    pad = [
        ((length - n) // 2, length - n - (length - n) // 2)
        for length, n in zip(period, shape, strict=True)
    ]
    total = np.zeros((len(weights), *period), complex)
    for plane, one, weight in zip(values, q, weights.T, strict=True):
        total += weight[:, None, None] * (
            folded_otf(float(one), period) * np.fft.fft2(np.pad(plane, pad, mode="edge"))
        )
    (top, _), (left, _) = pad
    return np.fft.ifft2(total).real[:, top : top + shape[0], left : left + shape[1]]
