"""A picture by a round lens of a world without end, by sums in real space alone: no transfer function, no period.

A point's light is the lens's pattern integrated over the pixels by Gauss's rule up to some distance. Beyond it only
the mean of its rings counts, that of Airy's pattern q / (pi^3 r^3), with a hole of radius h in the pupil 1 / (1 - h) of
it (rim over area), in closed form: over half a strip of width dv that begins at the distance a,

    integral of (x^2 + v^2)^(-3/2) dx over x > a  =  (1 - a / sqrt(a^2 + v^2)) / v^2,

whose integral over v is (sqrt(a^2 + v^2) - a) / (a v).
"""

from functools import lru_cache

import numpy as np
from scipy.signal import fftconvolve

from gpusim.judge.hard import truth

REACH = 320  # pixels summed one by one: what rings beyond leave is 4e-8 at q = 4
IMAGES = 6  # mirror images along each axis that are summed one by one


@lru_cache(maxsize=4)
def kernel(q, waves=0.0, hole=0.0, reach=REACH):
    """Energy of pixels at whole distances (dy, dx) up to `reach` from a point, shape (reach + 1, reach + 1).

    waves: defocus at the edge of the pupil. hole: radius of its obstruction over its own radius.
    """
    at = np.arange(reach + 1)
    if not waves and not hole:
        return truth.point(q, at, at)
    light = truth.defocused_airy(q, waves, np.sqrt(2) * (reach + 2), hole)
    return truth.in_pixels(light, at, at, int(np.ceil(6 + 3 / q)))


def picture(image, q, border, waves=0.0, hole=0.0):
    """What the lens makes of an image that goes on as "zero", "edge" or "reflect" says; pixels at full fill.

    q: wavelength times f-number over the pixels' pitch. waves, hole: see `kernel`.
    """
    image, own, tail = (
        np.asarray(image, np.float64),
        kernel(q, waves, hole),
        q / np.pi**3 / (1 - hole),
    )
    if border == "zero":
        return fftconvolve(image, truth.whole(own), "same")
    if border == "reflect":
        return _mirrored(image, own, tail)
    near = fftconvolve(np.pad(image, REACH, mode="edge"), truth.whole(own), "valid")
    down, across = (
        _beside(image[[0, -1]]),
        _beside(image.T[[0, -1]]),
    )  # above and below, left and right
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]].sum() * (2 - np.sqrt(2)) / (REACH + 0.5)
    return near + tail * (down + across[:, None] + corners)


def _beside(lines):
    """Light from both sides farther than REACH, of lines that go on along themselves and outwards, at each place."""
    n, a = lines.shape[1], REACH + 0.5
    v = np.clip(
        np.arange(n + 1) - 0.5 - np.arange(n)[:, None], -a, a
    )  # edges of the lines' pixels from each pixel
    v[:, 0], v[:, -1] = -a, a  # the outermost go on
    v[v == 0] = 1e-30
    strips = np.diff(
        v / (a * (np.sqrt(a * a + v * v) + a)), axis=1
    )  # the closed form above, without cancellation
    return strips @ lines.sum(axis=0)


def _mirrored(image, near, tail):
    """A circular sum over two frames, with a point's images in all others."""
    period = [2 * n for n in image.shape]
    total = np.zeros(period)
    for j in range(-IMAGES, IMAGES + 1):
        for i in range(-IMAGES, IMAGES + 1):
            y, x = (
                np.abs(at + k * length)
                for at, k, length in zip(
                    (np.fft.fftfreq(n, 1 / n).astype(int) for n in period),
                    (j, i),
                    period,
                    strict=True,
                )
            )
            far = np.hypot(y[:, None], x)
            some = (y[:, None] <= REACH) & (x <= REACH)
            rows, cols = np.minimum(y, REACH), np.minimum(x, REACH)
            total += np.where(some, near[np.ix_(rows, cols)], tail / np.maximum(far, 1) ** 3)
    # the rest of the lattice, as if even: beyond half-widths of b and c
    b, c = ((IMAGES + 0.5) * n for n in period)
    wide = np.hypot(b, c)
    total += tail * 4 * wide / (b * c) / np.prod(period)
    world = np.pad(image, [(0, n) for n in image.shape], mode="symmetric")
    out = np.fft.irfft2(np.fft.rfft2(world) * np.fft.rfft2(total), world.shape)
    return out[: image.shape[0], : image.shape[1]]
