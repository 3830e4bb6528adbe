"""The response of pixels to light, from flats of all levels."""

import math

import numpy as np

from gpusim.fit.patterns import DEGREE, outliers, share_range, split_pattern, trend

DEAD = 0.3  # response of a dead pixel, relative to the mean


class Response:
    """The response of pixels from all levels below saturation, in two halves of the frames.

    Args:
        halves: Mean of each half of the dark frames [DN], shape (rows, cols); None: not known yet, and
            levels do not count until it is.
        shape: Rows and columns of a frame.
        period: Rows and columns of the mosaic's period.
        letters: Letters of the places of the period.
    """

    def __init__(self, halves, shape, period, letters):
        self.halves, self._period, self._letters = halves, period, letters
        self._sums = [np.zeros(shape, np.float32) for _ in range(2)]
        self._weights = np.zeros(math.prod(period))

    def add(self, stack, level, black, limits):
        """Add the frames of a level; channels that are clipped, or above the limits [DN], do not count.

        Args:
            stack: The frames.
            level: Their level.
            black: Black level [DN].
            limits: Largest signal of each place of the period [DN].
        """
        if stack.count < 2 or self.halves is None:
            return
        for index, place in enumerate(stack.places()):
            letter = self._letters[index]
            point = level.points[letter]
            parts = [
                half[place] - dark[place]
                for half, dark in zip(stack.halves, self.halves, strict=True)
            ]
            steps = [part.mean(dtype=np.float64) for part in parts]
            is_weak = not min(steps) > 3 * math.sqrt(max(point.variance, 1e-9))
            if letter in level.clipped or is_weak or point.brightest - black > limits[index]:
                continue
            weight = np.mean(steps) ** 2 / max(point.variance, 1e-9) * stack.count
            for total, part, step in zip(self._sums, parts, steps, strict=True):
                total[place] += part * np.float32(weight / step)
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
