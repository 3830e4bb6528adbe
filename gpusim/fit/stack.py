"""Statistics of a stack of frames with equal settings, from one pass over its frames.

Frame k + 1 differs from the mean of the k frames before it by e; sqrt(k / (k + 1)) e has the
variance of one frame and is independent of the others (recursive residuals, as in Welford's
algorithm). All temporal noise is measured on them, with one mean frame in memory.
"""

import math
from collections.abc import Iterator

import numpy as np

from gpusim.fit.intervals import MeanSquare

FAR = 6.0  # standard deviations to which a pixel is limited in means of rows and columns
SAMPLE = 100_000  # pixels of a robust estimate
FRAMES_OF_SPECTRA = 4
LAGS = ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0))  # rows and columns of neighbours


class FrameStack:
    """Frames of one setting, added one by one.

    Args:
        period: Rows and columns of the mosaic's period.
        is_dark: The frames have no light: all places of the period have equal noise. The sum of squares
            of each pixel and the last residual are kept.
        good: Pixels to count, shape (rows, cols); None: all.

    Attributes:
        count: Number of frames.
        mean: Mean frame [DN], float32.
        halves: Mean of the frames 0, 2, 4 ... and of 1, 3, 5 ... [DN].
        names: Names of the frames.
        lowest, highest: Smallest and largest value [DN].
        at_highest: Share of the pixels of the last frame at `highest`.
        shift: Displacement between frames, rows and columns [pixel], and its standard error.
    """

    def __init__(self, period, is_dark=False, good=None):
        self.period, self.good = period, good
        self.count, self.names = 0, []
        self.mean = None
        self.halves = [None, None]
        self.lowest, self.highest, self.at_highest = math.inf, -math.inf, 0.0
        self._is_dark = is_dark
        self.squares = self.residual = None
        # number, squares, fourth powers and their number
        self._squares_of = np.zeros((math.prod(period), 4))
        self.row_means, self.column_means = [], []
        self.phase_means = []
        self.row_spectrum, self.column_spectrum = [], []
        self.lag_sums = []
        self.shifts = []

    def add(self, values: np.ndarray, name: str = "") -> None:
        """Add a frame. values: raw values [DN], shape (rows, cols)."""
        frame = values.astype(np.float32)
        self.names.append(name)
        self.phase_means.append([_mean(frame[place]) for place in self.places()])
        self.lowest = min(self.lowest, float(frame.min()))
        highest = float(frame.max())
        self.highest = max(self.highest, highest)
        self.at_highest = np.count_nonzero(frame == self.highest) / frame.size
        half, order = self.count % 2, self.count // 2
        if order == 0:
            self.halves[half] = frame.copy() if half else frame
        else:
            if self.halves[half] is frame:
                self.halves[half] = frame.copy()
            self.halves[half] += (frame - self.halves[half]) / np.float32(order + 1)
        if self.count == 0:
            self.mean = frame.copy()
        else:
            frame = frame - self.mean
            self.mean += frame / np.float32(self.count + 1)
            frame *= np.float32(math.sqrt(self.count / (self.count + 1)))
            self._add_residual(frame)
        self.count += 1

    def places(self) -> Iterator[tuple[slice, slice]]:
        """Yield the pixels of each place of the period as slices."""
        rows, cols = self.period
        for row in range(rows):
            for col in range(cols):
                yield slice(row, None, rows), slice(col, None, cols)

    def _add_residual(self, residual):
        """Add sqrt(k / (k + 1)) times a frame's difference from the mean of k frames before."""
        if self._is_dark:
            residual -= _mean(residual)
        limited = np.empty_like(residual)
        for place in self.places():
            plane = residual[place]
            if not self._is_dark:  # the light may differ from frame to frame
                plane -= _mean(plane)
            limit = np.float32(FAR * max(_robust_deviation(plane), 1e-3))
            np.clip(plane, -limit, limit, out=limited[place])
        self.row_means.append(_rows(limited))
        self.column_means.append(_columns(limited))
        if len(self.shifts) < 1:
            self.shifts.append(_shift(self.mean, limited, self.period))
        if len(self.lag_sums) < FRAMES_OF_SPECTRA:
            self._add_correlations(limited)
        for index, place in enumerate(self.places()):
            self._add_plane(index, residual[place], limited[place], place)
        if self._is_dark:
            square = residual * residual
            self.squares = square if self.squares is None else self.squares + square
            self.residual = residual

    def _add_plane(self, index, plane, limited, place):
        """Remove rows and columns from the residual of one place of the period; add its moments."""
        rows, cols = _rows(limited), _columns(limited)
        rows = rows[:, None] - np.float32(rows.mean())
        cols = cols.astype(np.float32)
        plane -= rows
        plane -= cols
        limited -= rows
        limited -= cols
        height, width = plane.shape
        chosen = plane if self.good is None else plane[self.good[place]]
        square = np.square(chosen, dtype=np.float32)
        left = (1 - 1 / height) * (1 - 1 / width)  # of the variance, without rows and columns
        number = chosen.size * left
        fourth = limited if self.good is None else limited[self.good[place]]
        self._squares_of[index] += (
            number,
            float(square.sum(dtype=np.float64)),
            float((np.square(fourth) ** 2).sum(dtype=np.float64)),
            number * left,
        )

    def _add_correlations(self, limited):
        """Add spectra along rows and columns and products of neighbours of a standardised residual."""
        white = limited - self.row_means[-1][:, None] - self.column_means[-1]
        white += _mean(limited)
        for place in [(slice(None), slice(None))] if self._is_dark else self.places():
            white[place] /= np.float32(max(math.sqrt(_mean(np.square(white[place]))), 1e-6))
        sums = []
        for down, right in LAGS:
            first = white[: len(white) - down, : white.shape[1] - right]
            second = white[down:, right:]
            product = float(np.mean(first * second, dtype=np.float64))
            sums.append((product, first.size))
        self.lag_sums.append(sums)
        self.row_spectrum.append(_spectrum(white))
        self.column_spectrum.append(_spectrum(np.ascontiguousarray(white.T)))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.mean.shape

    @property
    def freedom(self) -> int:
        """Number of independent residuals of each pixel."""
        return self.count - 1

    def variances(self) -> np.ndarray:
        """Return temporal variances of pixels [DN^2] and their relative variances, for each place.

        What rows and columns have in common is left out. Shape (places, 2).
        """
        number, square, fourth, of_fourth = self._squares_of.T
        value = square / number
        kurtosis = np.clip(fourth / of_fourth / np.maximum(value, 1e-12) ** 2, 1.2, 20.0)
        return np.stack([value, (kurtosis - 1) / number], axis=1)

    def pixel_square(self, good: np.ndarray) -> MeanSquare:
        """Return the mean square of pixels' temporal noise [DN^2] over good pixels of all places."""
        total = number = 0.0
        for place in self.places():
            height, width = self.squares[place].shape
            chosen = self.squares[place][good[place]]
            total += float(chosen.sum(dtype=np.float64))
            number += chosen.size * (1 - 1 / height) * (1 - 1 / width)
        return MeanSquare(total / (number * self.freedom), number * self.freedom)

    def row_square(self) -> MeanSquare:
        """Return the mean square of the rows' temporal means [DN^2]."""
        return _line_square(self.row_means, 1 if self._is_dark else self.period[0])

    def column_square(self) -> MeanSquare:
        """Return the mean square of the columns' temporal means [DN^2]."""
        return _line_square(self.column_means, 1 if self._is_dark else self.period[1])


def _mean(plane):
    return np.float32(plane.mean(dtype=np.float64))


def _rows(plane):
    return plane.mean(axis=1, dtype=np.float32)


def _columns(plane):
    return plane.mean(axis=0, dtype=np.float32)


def _robust_deviation(plane):
    """Return the standard deviation from the middle 95.45 % of some of the pixels, which has four of them."""
    step = max(1, math.isqrt(plane.size // SAMPLE))
    low, high = np.percentile(plane[::step, ::step], (2.275, 97.725))
    return max(float(high - low) / 4, 0.3 if high == low else 0.0)


def _line_square(series, period):
    series = np.array(series, np.float64)
    freedom = series.shape[0] * max(series.shape[1] - period, 1)
    return MeanSquare(float(np.sum(series**2)) / freedom, freedom)


def _spectrum(white):
    """Return the mean power of lines at each frequency up to alternating pixels."""
    power = np.zeros(white.shape[1] // 2 + 1)
    for start in range(0, len(white), 256):
        lines = np.fft.rfft(white[start : start + 256], axis=1)
        power += np.sum(lines.real**2 + lines.imag**2, axis=0, dtype=np.float64)
    return power[1:] / (white.shape[0] * white.shape[1])


def _shift(mean, residual, period):
    """Return the displacement [pixel] that explains a residual by the gradient of the mean frame.

    What rows and columns have in common is left out: row noise would look like a displacement. Returns
    rows and columns, and their standard errors.
    """
    down, right = period
    first = _without_lines(residual[down:-down, right:-right])
    slopes = [
        (mean[2 * down :, right:-right] - mean[: -2 * down, right:-right]) / (2 * down),
        (mean[down:-down, 2 * right :] - mean[down:-down, : -2 * right]) / (2 * right),
    ]
    slopes = [_without_lines(one) for one in slopes]
    matrix = np.array([[np.mean(a * b, dtype=np.float64) for b in slopes] for a in slopes])
    right_side = np.array([np.mean(a * first, dtype=np.float64) for a in slopes])
    if not np.linalg.det(matrix) > 0:
        return np.zeros(2), np.full(2, np.inf)
    inverse = np.linalg.inv(matrix)
    variance = float(np.mean(first * first, dtype=np.float64)) / first.size
    return inverse @ right_side, np.sqrt(np.diag(inverse) * variance)


def _without_lines(plane):
    plane = plane - _rows(plane)[:, None]
    return plane - _columns(plane)
