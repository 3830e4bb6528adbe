"""A convolution in two parts: a near kernel for tiles of the frame, and the smooth rest on a coarser grid.

Far from its middle a point spread is smooth. With a window w that falls to 0 at the sides of m x m samples, the kernel
k is k w + k (1 - w). The second part has little beyond the frequencies of a grid SPACING times coarser. Light is
gathered on that grid with weights b, convolved, and spread again with the same weights, b a discrete B-spline whose
transfer function B has zeros where copies of the spectrum fall on the frequency 0. The table of the coarse grid is that
of the kernel, less that of the near part, over B^2, so that within its band only the copies are wrong.
"""

from dataclasses import dataclass

import numpy as np

from gpusim.optics.field import error_scale, weigh
from gpusim.optics.lengths import fft_length

SPACING = 4  # [sample] of the coarse grid
ORDER = 4  # boxes that are convolved
INNER = 0.3  # of half the side: the window is 1 within
WIDER = 4  # sides of a near kernel over which errors are computed
LARGE = 2**17  # samples of a frame from which on transforms of the whole are slow


def gather_weights() -> np.ndarray:
    """Return weights of samples around one of the coarse grid, odd in number, sum 1."""
    weights, box = np.ones(1), np.full(SPACING, 1 / SPACING)
    for _ in range(ORDER):
        weights = np.convolve(weights, box)
    return weights


def transfer_of_weights(frequencies: np.ndarray) -> np.ndarray:
    """Return the transfer function of `gather_weights` at frequencies [cycle per sample]."""
    weights = gather_weights()
    at = np.arange(len(weights)) - len(weights) // 2
    return np.cos(2 * np.pi * np.asarray(frequencies)[..., None] * at) @ weights


def window(size: int) -> np.ndarray:
    """Return the window of a near kernel, shape (size, size)."""
    at = np.arange(size) - size // 2
    place = (np.hypot(at[:, None], at) / (size / 2) - INNER) / (1 - INNER)
    return np.cos(np.pi / 2 * np.clip(place, 0, 1)) ** 2


def split_error(kernels: np.ndarray, size: int) -> float:
    """Return the relative RMS error of a natural scene by the coarse grid.

    Args:
        kernels: The whole kernels, wider than the near part, shape (planes, m, m), m odd. Planes have equal weights.
        size: Side of the near part [sample], odd.
    """
    m = kernels.shape[-1]
    far, inner = kernels.copy(), slice(m // 2 - size // 2, m // 2 + size // 2 + 1)
    far[:, inner, inner] *= 1 - window(size)
    count = -(-m // SPACING)
    period = count * SPACING
    spectra = np.fft.fft2(far, (period, period))
    # a frequency as seen by the coarse grid, and the middle one of its copies
    fold = np.arange(period) % count
    middle = np.where(2 * fold < count, fold, fold - count) % period
    passed = transfer_of_weights(np.fft.fftfreq(period))
    both = passed[:, None] * passed
    at = np.ix_(middle, middle)
    edge = (2 * fold == count)[:, None] | (2 * fold == count)
    table = np.where(edge, 0, spectra[:, *at] / both[at] ** 2)
    spread = np.square(both).reshape(SPACING, count, SPACING, count).sum(axis=(0, 2))
    copies = spread[fold[:, None], fold] - both**2
    wrong = np.square(np.abs(table * both**2 - spectra))
    wrong += np.square(np.abs(table * both)) * copies
    half = period // 2 + 1
    weight = weigh(np.ones((1, 1)), period)[..., :half]
    return float(
        error_scale(period) * np.sqrt((wrong[..., :half] * np.square(weight)).sum() / len(kernels))
    )


@dataclass(frozen=True)
class CoarseGrid:
    """The grid of the far part along both axes of a frame.

    Attributes:
        shape: Rows and columns of the samples.
        period: Lengths of the transforms of the samples [sample], multiples of SPACING.
    """

    shape: tuple[int, int]
    period: tuple[int, int]

    @classmethod
    def of(cls, shape: tuple[int, int], period: tuple[int, int]) -> "CoarseGrid":
        """Return the grid of a frame. period: least lengths of the transforms [sample]."""
        rows, cols = (SPACING * fft_length(-(-length // SPACING)) for length in period)
        return cls((shape[0], shape[1]), (rows, cols))

    @property
    def lengths(self) -> tuple[int, int]:
        """Rows and columns of the coarse grid."""
        return self.period[0] // SPACING, self.period[1] // SPACING

    def gather(self, border: str) -> tuple[np.ndarray, ...]:
        """Return the samples and weights of each coarse row and column, as inputs of `optics.sample`.

        border: "zero", "edge" or "reflect", of the samples.
        """
        weights, found = gather_weights(), []
        for n, length, count in zip(self.shape, self.period, self.lengths, strict=True):
            at = SPACING * np.arange(count) - (length - n) // 2
            taps = at[:, None] + np.arange(len(weights)) - len(weights) // 2
            own = np.broadcast_to(weights, taps.shape)
            if border == "zero":
                own = own * ((taps >= 0) & (taps < n))
            if border == "reflect":
                taps = taps % (2 * n)
                taps = np.minimum(taps, 2 * n - 1 - taps)
            taps = np.clip(taps, 0, n - 1)
            width = min(len(weights), n)
            found += _contiguous(taps, own, width, n)
        return tuple(found)

    def spread(self, margin: int) -> tuple[np.ndarray, ...]:
        """Return the coarse samples and weights of each row and column of the result, as inputs of `optics.sample`.

        margin: samples on each side that are not in the result; negative: samples of it around the frame's.
        """
        weights, found = SPACING * gather_weights(), []
        reach = len(weights) // 2
        for n, length, count in zip(self.shape, self.period, self.lengths, strict=True):
            at = np.arange(margin, n - margin) + (length - n) // 2
            first = -(-(at - reach) // SPACING)
            taps = first[:, None] + np.arange(-(-len(weights) // SPACING))
            away = SPACING * taps - at[:, None] + reach
            own = np.where(away < len(weights), weights[np.minimum(away, len(weights) - 1)], 0)
            found += _contiguous(np.clip(taps, 0, count - 1), own, taps.shape[1], count)
        return tuple(found)


def _contiguous(taps, weights, width, size):
    """Return the first of `width` neighbours of each row of taps, int32, and their weights, float32."""
    start = np.clip(taps.min(axis=1), 0, size - width)
    own = np.zeros((len(taps), width))
    np.add.at(own, (np.arange(len(taps))[:, None], taps - start[:, None]), weights)
    return [start.astype(np.int32), own.astype(np.float32)]


def split_tables(
    tables: np.ndarray, period: tuple[int, int], size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the near kernels of transfer tables, and tables of the coarse grid.

    Args:
        tables: Transfer tables as of `optics.blur`, quarters or halves, shape (..., planes, rows, cols).
        period: Lengths of their transforms [sample], multiples of SPACING.
        size: Side of a near kernel [sample], odd.

    Returns:
        Kernels, shape (..., planes, size, size), and tables in the form of the given ones, float32.
    """
    rows, cols = period
    half = cols // 2 + 1
    at, along = np.arange(size) - size // 2, np.arange(half) / cols
    is_quarter = tables.shape[-1] == half
    values = tables if is_quarter else np.ascontiguousarray(tables).view(np.complex64)
    down = np.arange(values.shape[-2]) / rows
    # each frequency but those that are their own opposites stands for two
    twice = _opposites(half, cols)
    if is_quarter:
        of_rows = np.cos(2 * np.pi * at[:, None] * down) * _opposites(len(down), rows)
        of_cols = np.cos(2 * np.pi * along[:, None] * at) * twice[:, None]
    else:
        of_rows = np.exp(2j * np.pi * at[:, None] * down)
        of_cols = np.exp(2j * np.pi * along[:, None] * at) * twice[:, None]
    near = (of_rows @ values @ of_cols).real / (rows * cols) * window(size)
    # of the coarse grid
    count, wide = rows // SPACING, cols // SPACING
    low = np.arange(count // 2 + 1 if is_quarter else count)
    signed = np.where(2 * low > count, low - count, low)
    fy, fx = signed / rows, np.arange(wide // 2 + 1) / cols
    phase_y, phase_x = (-2j * np.pi * one[:, None] * at for one in (fy, fx))
    spectra = np.exp(phase_y) @ near @ np.exp(phase_x).T
    coarse = values[..., signed % rows if not is_quarter else low, :][..., : len(fx)] - (
        spectra.real if is_quarter else spectra
    )
    coarse = coarse / np.square(transfer_of_weights(fy)[:, None] * transfer_of_weights(fx))
    coarse[..., 2 * np.abs(signed) == count, :] = 0
    if wide % 2 == 0:
        coarse[..., -1] = 0
    if is_quarter:
        return near.astype(np.float32), np.ascontiguousarray(coarse, np.float32)
    coarse = np.ascontiguousarray(coarse, np.complex64).view(np.float32)
    return near.astype(np.float32), coarse


def _opposites(count, period):
    """Return how many frequencies of a period each of the first `count` stands for."""
    found = np.full(count, 2.0)
    found[0] = 1
    if 2 * (count - 1) == period:
        found[-1] = 1
    return found
