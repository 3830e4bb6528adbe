"""The response of pixels to light, from flats of all levels."""

import math

import numpy as np

from gpusim.fit.patterns import DEGREE, outliers, share_range, split_pattern, trend

DEAD = 0.3  # response of a dead pixel, relative to the mean


class Response:
    """The response of pixels from all levels below saturation, in two halves of the frames.

    Args:
        dark_halves: Mean of each half of the dark frames [DN], shape (rows, cols).
        period: Rows and columns of the mosaic's period.
        letters: Letters of the places of the period.
    """

    def __init__(self, dark_halves, period, letters):
        self._darks, self._period, self._letters = dark_halves, period, letters
        self._sums = [np.zeros(dark_halves[0].shape, np.float32) for _ in dark_halves]
        self._weights = np.zeros(math.prod(period))

    def add(self, stack, level, black, limits):
        """Add the frames of a level; channels that are clipped, or above the limits [DN], do not count.

        Args:
            stack: The frames.
            level: Their level.
            black: Black level [DN].
            limits: Largest signal of each place of the period [DN].
        """
        if stack.count < 2:
            return
        for index, place in enumerate(stack.places()):
            letter = self._letters[index]
            point = level.points[letter]
            signal = point.mean - black
            is_weak = not signal > 3 * math.sqrt(max(point.variance, 1e-9))
            if letter in level.clipped or is_weak or point.brightest - black > limits[index]:
                continue
            weight = signal**2 / max(point.variance, 1e-9) * stack.count
            for total, half, dark in zip(self._sums, stack.halves, self._darks, strict=True):
                part = half[place] - dark[place]
                total[place] += part * np.float32(weight / part.mean(dtype=np.float64))
            self._weights[index] += weight

    def finish(self, good):
        """Return the pattern of the response, the share of dead pixels, and good pixels.

        Args:
            good: Pixels to count, shape (rows, cols).
        """
        if not (self._weights > 0).all():
            return None, share_range(0, good.size), good
        for total in self._sums:
            for (row, col), weight in zip(np.ndindex(*self._period), self._weights, strict=True):
                total[row :: self._period[0], col :: self._period[1]] /= np.float32(weight)
        mean = (self._sums[0] + self._sums[1]) / 2
        dead = (mean < DEAD) & good
        everywhere = np.ones(good.shape, bool)
        flat = _flatten(mean, everywhere & ~dead, self._period)
        for total in self._sums:
            total /= flat
        mean /= flat
        bad = outliers(mean, good & ~dead, self._period)
        good = good & ~dead & ~bad
        pattern = split_pattern(*self._sums, good, self._period, DEGREE)
        return pattern, share_range(int(np.count_nonzero(dead)), good.size), good


def _flatten(mean, good, period):
    """Return the smooth surface of each place of the period, shape (rows, cols)."""
    smooth = np.ones_like(mean)
    rows, cols = period
    for row in range(rows):
        for col in range(cols):
            place = slice(row, None, rows), slice(col, None, cols)
            degree = min(DEGREE, min(mean[place].shape) // 4)
            smooth[place] = trend(mean[place], good[place], degree)
    return np.maximum(smooth, np.float32(0.05))
