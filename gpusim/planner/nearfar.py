"""A kernel as a pyramid of short separable kernels, so that a blur of any reach needs no transform. Float64, host.

At each level a window takes the middle of the kernel; a sum of products column x row stands for it, and everything
that is left, the rest of that approximation included, goes to an image of `factor` times fewer pixels a side, where it
is the next kernel. Blocks of pixels are added up on the way down and the result is interpolated on the way up, so that
a pixel's light goes to its neighbours by the kernel smoothed with both: two boxes, one tent per axis. Tents of one
spacing add up to one, which keeps the sum of the kernel exactly, however few products are taken.
"""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange


@dataclass(frozen=True)
class Level:
    """Sum of `rank` products of a column (taps) and a row (taps), on an image of factor**level pixels per pixel."""

    columns: np.ndarray
    rows: np.ndarray

    @property
    def kernel(self):
        """The kernel that the products add up to, (taps, taps)."""
        return self.columns.T @ self.rows


def split(kernel, radius, factor, rank):
    """Near products and the far kernel: kernel = near + far, near of 2 radius - 1 taps, far on the coarser image.

    kernel: shape (n, n), n odd. radius: where the window ends [pixel]. factor: pixels per coarse pixel along an axis.
    rank: products. Returns (Level, far), far of odd size; factor**2 sum(far) + sum(near) = sum(kernel).
    Raises OutOfRange for a radius, factor or rank below 2, 2 and 1; BadData for kernels of other shapes or not finite.
    """
    kernel = checked(kernel, radius, factor, rank)
    reach = min(radius - 1, len(kernel) // 2)
    middle = len(kernel) // 2
    at = np.arange(-reach, reach + 1)
    distance = np.hypot(at[:, None], at)
    window = 0.5 + 0.5 * np.cos(np.pi * np.clip((distance - radius / 2) / (radius / 2), 0, 1))
    inside = np.s_[middle - reach : middle + reach + 1]
    near = products(window * kernel[inside, inside], rank)
    rest = kernel.copy()
    rest[inside, inside] -= near.kernel
    size = (middle + factor - 1) // factor  # the farthest coarse pixel that a tent reaches
    tent = (factor - abs(np.arange(1 - factor, factor))) / factor**2
    # (rest conv tent) at every factor-th pixel, as a matrix along each axis
    coarse = np.zeros((2 * size + 1, len(kernel)))
    for m in range(-size, size + 1):
        for j, value in zip(range(1 - factor, factor), tent, strict=True):
            if 0 <= factor * m - j + middle < len(kernel):
                coarse[m + size, factor * m - j + middle] += value
    return near, coarse @ rest @ coarse.T


def pyramid(kernel, radius=8, factor=2, rank=3, coarse_rank=4):
    """Levels of a kernel from the finest to the coarsest, which holds whatever is left; the sum is kept to rounding.

    kernel, radius, factor, rank as `split`; coarse_rank: products of all but the finest level. For an Airy kernel at
    f/2.8 and 1.4 um pixels and a natural scene (3, 4) products of 15 taps err by 1.4e-4 relative RMS at 130 products a
    pixel, whatever the kernel's reach; radius 16, factor 4 and (4, 6) products by 9e-5 at 273.
    """
    levels = []
    while len(kernel) > 2 * radius + 1:
        level, kernel = split(kernel, radius, factor, coarse_rank if levels else rank)
        levels.append(level)
    last = products(kernel, coarse_rank)
    # what the last products leave out has no other place: its sum goes to the middle of the strongest one
    levels.append(_with_sum(last, kernel.sum()))
    return levels


def products(kernel, rank):
    """The `rank` products column x row nearest to a kernel: its largest singular values."""
    u, s, vt = np.linalg.svd(kernel)
    scale = np.sqrt(s[:rank])
    return Level((u[:, :rank] * scale).T, vt[:rank] * scale[:, None])


def _with_sum(level, wanted):
    sums = level.columns.sum(axis=1) * level.rows.sum(axis=1)
    first = np.argmax(abs(sums))
    rows = level.rows.copy()
    rows[first] *= 1 + (wanted - sums.sum()) / sums[first]
    return Level(level.columns, rows)


def levels_of(kernels, **options):
    """Levels of kernels as the stage optics.nearfar takes them: pairs (columns, rows), finest first, float32.

    kernels: shape (1 or channels, planes, n, n). options: of `pyramid`. Each array has shape (1 or channels, planes,
    products, taps). Raises BadData when a kernel is not finite or not square, or there is none.
    """
    kernels = np.asarray(kernels)
    if kernels.ndim != 4 or 0 in kernels.shape:
        raise BadData(f"kernels of shape {kernels.shape}: must be (1 or channels, planes, n, n), none of them zero")
    made = [[pyramid(kernel, **options) for kernel in group] for group in kernels]
    return [tuple(np.array([[getattr(levels[n], part) for levels in group] for group in made], np.float32)
                  for part in ("columns", "rows")) for n in range(len(made[0][0]))]


def kernel_of(table, period, reach):
    """The kernel, (2 reach + 1) a side, of an even transfer table (period[0] // 2 + 1, period[1] // 2 + 1).

    Light beyond the reach is put on the kernel's rim, evenly, so that the sum is the table's at 0.

    Raises OutOfRange when the period is too short for the reach.
    """
    if 2 * reach + 1 > min(period):
        raise OutOfRange("reach", reach, f"at most {(min(period) - 1) // 2}, half of the table's period {min(period)}")
    fold = np.minimum(np.arange(period[0]), period[0] - np.arange(period[0]))
    whole = np.fft.irfft2(np.asarray(table, np.float64)[fold], period)
    at = np.arange(-reach, reach + 1)
    kernel, rim = whole[np.ix_(at, at)], np.maximum.outer(abs(at), abs(at)) == reach
    kernel[rim] += (whole.sum() - kernel.sum()) / rim.sum()
    return kernel


def checked(kernel, radius, factor, rank):
    """The kernel in float64, or an error."""
    for name, value, least in (("radius", radius, 2), ("factor", factor, 2), ("rank", rank, 1)):
        if int(value) != value or value < least:
            raise OutOfRange(name, value, f"a whole number from {least}")
    kernel = np.asarray(kernel, np.float64)
    if kernel.ndim != 2 or kernel.shape[0] != kernel.shape[1] or not len(kernel) % 2:
        raise BadData(f"kernel of shape {kernel.shape}: must be square, of odd size")
    if not np.isfinite(kernel).all():
        i, j = np.argwhere(~np.isfinite(kernel))[0]
        raise BadData(f"kernel is {kernel[i, j]} at ({i}, {j}): every value must be finite")
    return kernel
