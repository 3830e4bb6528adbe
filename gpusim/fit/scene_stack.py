"""Variances over signal from pairs of frames of a static, structured scene.

Residuals of frames (as in `FrameStack`) have no scene in them. Pixels are grouped by the mean of their
neighbours of the same filter, whose noise is independent of theirs: the mean signal and the mean variance of a
group then lie on the photon transfer line, for any distribution of the scene.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.fit.intervals import MeanSquare, Range, chance_of, difference_of
from gpusim.fit.levels import Point

SHOOT_PAIRS = (
    "shoot two frames or more of each exposure time, raw, of one scene with shadows and highlights, "
    "from a firm tripod, in steady light"
)
GROUPS, LEAST = 24, 150  # groups of pixels of a channel, and pixels of a group
SAFE = 6.0  # standard deviations that pixels stay away from clipped values
FREE = 0.8  # least part of a pixel's variance that the removal of lines leaves
WIDE = 4.0  # standard deviations of dark pixels that a group's signals span
OUTLIER = 40.0  # variances above which a squared residual is no noise: a chance of 3e-10
CHANGED = 5.0  # standard errors of a change of the scene
LIGHT, SHARE, PART = (
    0.01,
    0.01,
    0.004,
)  # change of light, and shares of the variance, that are refused
BLOCK = 16  # [pixel] side of the parts that are tested for changes
SAMPLE = 200_000  # pixels of a first estimate of the variance


class SceneStack:
    """Frames of one static scene, added one by one.

    Args:
        cfa: Mosaic, rows of letters.

    Attributes:
        count, names: Number and names of frames.
        mean: Mean frame [DN], float32.
        squares: Sum of squared residuals without rows and columns [DN^2].
        is_free: Pixels that do not decide the mean of their row or column.
        tops: Largest value of each letter [DN].
        highest, lowest: Largest and smallest value [DN].
        rows, columns: Means of rows and columns, and their variances from pixels, of each residual.
    """

    def __init__(self, cfa: Sequence[str]):
        self._cfa, self._letters = cfa, "".join(cfa)
        self.count = 0
        self.names: list[str] = []
        self.mean: Any = None
        self.squares: Any = None
        self.is_free: Any = None
        self.tops = dict.fromkeys(self._letters, -math.inf)
        self.lowest = math.inf
        self.rows: list[tuple[np.ndarray, np.ndarray]] = []
        self.columns: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def highest(self) -> float:
        """Largest value [DN]."""
        return max(self.tops.values())

    def add(self, values: np.ndarray, name: str = "") -> None:
        """Add a frame.

        Args:
            values: Raw values [DN], shape (rows, cols).
            name: Its name.

        Raises:
            BadData: The scene moved, or its light changed.
        """
        frame = values.astype(np.float32)
        self.names.append(name)
        self.lowest = min(self.lowest, float(frame.min()))
        for letter, place in zip(self._letters, self._places(), strict=True):
            self.tops[letter] = max(self.tops[letter], float(frame[place].max()))
        if self.count == 0:
            self.mean = frame
            self.squares = np.zeros_like(frame)
        else:
            frame -= self.mean
            self.mean += frame / np.float32(self.count + 1)
            scale = math.sqrt(self.count / (self.count + 1))
            self._add_residual(frame * np.float32(scale), scale)
        self.count += 1

    def _places(self) -> Iterator[tuple[slice, slice]]:
        """Yield the pixels of each place of the period as slices."""
        rows, cols = len(self._cfa), len(self._cfa[0])
        for row in range(rows):
            for col in range(cols):
                yield slice(row, None, rows), slice(col, None, cols)

    def _add_residual(self, residual, scale):
        """Remove light, displacement, rows and columns from a residual; add its squares."""
        weight = np.float32(1) / _rough_variance(self.mean, residual)
        for _ in range(2):  # dark pixels have no part of the noise of bright ones in their lines
            rest, _, _ = _Lines(weight).split(residual)
            weight = np.float32(1) / variance_model(self.mean, rest * rest)
        lines = _Lines(weight)
        rest, rows, columns = lines.split(residual)
        changes = [lines.split(one) for one in (*self._lights(), *self._slopes())]
        size = len(changes)
        weighted = [weight * change for change, _, _ in changes]
        matrix = np.array([[_dot(one, other) for other, _, _ in changes] for one in weighted])
        matrix += np.diag(np.where(np.diag(matrix) > 0, 0.0, 1.0))
        found = np.linalg.lstsq(matrix, np.array([_dot(one, rest) for one in weighted]))[0]
        for amount, change in zip(found, changes, strict=True):
            for whole, part in zip((rest, rows, columns), change, strict=True):
                whole -= np.float32(amount) * part
        spread = _dot(weight, rest * rest) / rest.size
        errors = np.sqrt(np.maximum(np.diag(np.linalg.pinv(matrix)), 0) * spread)
        shares = np.array(
            [_dot(one, change[0]) for one, change in zip(weighted, changes, strict=True)]
        )
        shares *= found**2 / rest.size / spread
        self._check_light(found[: size - 2] / scale, errors[: size - 2] / scale)
        self._check_shift(found[size - 2 :] / scale, errors[size - 2 :] / scale, shares[size - 2 :])
        self._check_parts(rest * np.sqrt(weight / np.float32(spread)))
        squares = rest * rest
        for (change, _, _), power in zip(changes, np.diag(matrix), strict=True):
            squares += (
                change * change / np.float32(power)
            )  # the variance that each regressor took away
        squares, kept, of_row, of_column = lines.before(squares)
        self.squares += squares
        self.is_free = (kept > FREE) & (True if self.is_free is None else self.is_free)
        for series, found_lines, own in (
            (self.rows, rows, of_row),
            (self.columns, columns, of_column),
        ):
            series.append((found_lines.ravel().astype(np.float64), own))

    def _lights(self):
        """Yield the light of each channel as a frame, 0 elsewhere."""
        dark = float(np.quantile(self.mean[::7, ::5], 0.001))
        for letter in dict.fromkeys(self._letters):
            light = np.zeros_like(self.mean)
            for one, place in zip(self._letters, self._places(), strict=True):
                if one == letter:
                    light[place] = self.mean[place] - dark
            yield light

    def _slopes(self):
        """Yield the scene's change over a pixel along rows and along columns, 0 at the border."""
        down, right = len(self._cfa), len(self._cfa[0])
        for step, axis in ((down, 0), (right, 1)):
            slope = np.zeros_like(self.mean)
            inner = [slice(None), slice(None)]
            inner[axis] = slice(step, -step)
            ahead = np.roll(self.mean, -step, axis)[tuple(inner)]
            behind = np.roll(self.mean, step, axis)[tuple(inner)]
            slope[tuple(inner)] = (ahead - behind) / np.float32(2 * step)
            yield slope

    def _check_light(self, changes, errors):
        worst = int(np.argmax(np.abs(changes) / np.maximum(errors, 1e-12)))
        if abs(changes[worst]) > max(LIGHT, CHANGED * errors[worst]):
            raise BadData(
                f"the light changed by {100 * changes[worst]:+.1f} % before {self.names[-1]}, next to "
                f"{self.names[0]}; {SHOOT_PAIRS}"
            )

    def _check_shift(self, shift, errors, shares):
        if np.any((np.abs(shift) > CHANGED * errors) & (shares > SHARE)):
            raise BadData(
                f"{self.names[0]} and {self.names[-1]} are displaced by {np.hypot(*shift):.2f} pixel: "
                f"the tripod or the scene moved; {SHOOT_PAIRS}"
            )

    def _check_parts(self, white):
        """Raise BadData if parts of a standardised residual differ from noise."""
        steps = [-(-BLOCK // period) * period for period in (len(self._cfa), len(self._cfa[0]))]
        height, width = (side // step for side, step in zip(white.shape, steps, strict=True))
        if min(height, width) < 3:
            return
        part = white[: height * steps[0], : width * steps[1]]
        means = part.reshape(height, steps[0], width, steps[1]).mean((1, 3), dtype=np.float64)
        number, freedom = math.prod(steps), (height - 1) * (width - 1)
        squares = number * float(np.sum(means**2))
        is_changed = chance_of(squares, freedom) < 1e-6
        if is_changed and (squares / freedom - 1) / number > PART:
            row, col = (int(one) for one in np.unravel_index(np.argmax(means**2), means.shape))
            raise BadData(
                f"{self.names[0]} and {self.names[-1]} differ by more than noise, most near row "
                f"{row * steps[0]}, column {col * steps[1]}: a part of the scene moved or its light changed; "
                f"{SHOOT_PAIRS}"
            )

    def groups(self, ceilings: dict[str, float], black: dict[str, float]) -> dict[str, list[Point]]:
        """Return mean and variance of groups of pixels by letter.

        Args:
            ceilings: Value of each letter at which pixels may be clipped [DN].
            black: Black level of each letter less the mean one [DN].

        Returns:
            Points by letter, from dark to bright; no point of a channel that is clipped.
        """
        found = {}
        model = variance_model(self.mean, self.squares / np.float32(self.count - 1))
        for letter in dict.fromkeys(self._letters):
            columns = [
                part
                for one, place in zip(self._letters, self._places(), strict=True)
                if one == letter
                for part in [
                    _grouped(
                        *(one[place] for one in (self.mean, self.squares, model, self.is_free))
                    )
                ]
                if part is not None
            ]
            if columns:
                numbers = np.concatenate(columns, axis=1)
                found[letter] = self._points(numbers, ceilings[letter], black[letter])
        return found

    def _points(self, numbers, ceiling, black):
        signal, square, model, near = numbers
        deviation = np.sqrt(model)
        chosen = signal + SAFE * deviation < ceiling
        if self.lowest <= 0:
            chosen &= signal > SAFE * deviation
        freedom = self.count - 1
        chosen &= square < OUTLIER * model * max(freedom, 1)
        signal, square, model, near = (one[chosen] for one in (signal, square, model, near))
        number = min(GROUPS, len(signal) // LEAST)
        if number < 1:
            return []
        order = np.argsort(near, kind="stable")
        points, least = [], float(model.min())
        for part in _wide_parts(order, near / 4, number, WIDE * math.sqrt(least)):
            variance = float(square[part].mean(dtype=np.float64)) / freedom
            # Poisson numbers: the errors of mean and variance are correlated, and cancel along the line
            of_model = float(np.mean(model[part] ** 2) / np.mean(model[part]) ** 2)
            relative = 2 * of_model / (len(part) * freedom)
            mean = float(signal[part].mean(dtype=np.float64)) - black
            error = least / self.count / len(part)
            points.append(Point(mean, error, variance, relative * variance**2, mean, mean))
        return points


class _Lines:
    """Weighted means of rows and columns of a frame, and their removal.

    Args:
        weight: Reciprocal variances of pixels, shape (rows, cols).

    """

    def __init__(self, weight):
        self._weight = weight
        self._row = 1 / weight.sum(axis=1, dtype=np.float64)
        self._column = 1 / weight.sum(axis=0, dtype=np.float64)

    def split(self, values):
        """Return values without rows and columns, the rows, and the columns, shapes (rows, 1), (cols,)."""
        rest = values.copy()
        rows, columns = np.zeros((len(rest), 1), np.float32), np.zeros(rest.shape[1], np.float32)
        for _ in range(3):
            step = (np.einsum("ij,ij->i", rest, self._weight) * self._row).astype(np.float32)
            rest -= step[:, None]
            rows += step[:, None]
            step = (np.einsum("ij,ij->j", rest, self._weight) * self._column).astype(np.float32)
            rest -= step
            columns += step
        return rest, rows, columns

    def before(self, squares):
        """Return squares [DN^2] as they were before the removal, in expectation.

        A pixel of variance v and weight w in a line of weight W keeps v (1 - 2 w / W), and gets the variance of
        the line's mean.

        Args:
            squares: Squares of values without lines, shape (rows, cols).

        Returns:
            Squares; the part of each pixel's own variance that the lines left; variances of each row's
            mean, and each column's, from the noise of its pixels.
        """
        weight = self._weight
        row, column = self._row[:, None].astype(np.float32), self._column.astype(np.float32)
        kept = 1 - 2 * weight * (row + column)
        mine = weight * weight * (squares + row + column)
        of_row = mine.sum(axis=1, dtype=np.float64) * self._row**2
        of_column = mine.sum(axis=0, dtype=np.float64) * self._column**2
        whole = mine.sum(dtype=np.float64) / weight.sum(dtype=np.float64) ** 2
        kept += np.float32(2 / weight.sum(dtype=np.float64)) * weight
        squares = squares - of_row[:, None].astype(np.float32) - of_column.astype(np.float32)
        squares += np.float32(whole)
        return squares / np.maximum(kept, np.float32(FREE)), kept, of_row, of_column


def _dot(one, other):
    return float(np.sum(one * other, dtype=np.float64))


def _rough_variance(mean, residual):
    """Return the variance model of a residual with rows and columns [DN^2], shape (rows, cols)."""
    rest = residual - residual.mean(axis=1, keepdims=True)
    rest -= rest.mean(axis=0)
    return variance_model(mean, rest * rest)


def variance_model(mean: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Return the temporal variance of each pixel from a rough line over the mean [DN^2].

    Args:
        mean: Mean frame [DN], shape (rows, cols).
        square: Squared residuals [DN^2], shape (rows, cols).

    Returns:
        Variances, float32, shape (rows, cols).
    """
    step = max(1, mean.size // SAMPLE)
    signal, squares = mean.ravel()[::step].astype(np.float64), square.ravel()[::step]
    parts = np.array_split(
        np.argsort(signal, kind="stable"), min(GROUPS, max(len(signal) // 20, 1))
    )
    x = np.array([signal[part].mean() for part in parts])
    y = np.array([_trimmed_mean(squares[part]) for part in parts])
    design = np.column_stack([np.ones(len(x)), x]) / y[:, None]
    offset, slope = np.linalg.lstsq(design, np.ones(len(y)))[0]
    floor = max(0.5 * float(y.min()), 1e-3)
    model = np.float32(max(slope, 0.0)) * mean
    if slope > 0:
        model += np.float32(offset)
    else:
        model += np.float32(y.mean())
    return np.maximum(model, np.float32(floor), out=model)


def _trimmed_mean(squares):
    """Return the mean of squared numbers without those that are no noise."""
    for _ in range(2):
        squares = squares[squares <= OUTLIER / 2 * np.abs(squares).mean()]
    return max(float(squares.mean(dtype=np.float64)), 1e-3)


def _grouped(mean, squares, model, is_free):
    """Return free pixels of one place with their neighbours' mean, shape (4, n); None of too few."""
    if min(mean.shape) < 3:
        return None
    near = mean[:-2, 1:-1] + mean[2:, 1:-1] + mean[1:-1, :-2] + mean[1:-1, 2:]
    inner = slice(1, -1), slice(1, -1)
    chosen = is_free[inner]
    return np.stack([one[inner][chosen] for one in (mean, squares, model)] + [near[chosen]])


def _wide_parts(order, near, number, width):
    """Return equal parts of sorted pixels; parts narrower than a width are joined.

    Fine parts of a dark surface would sort its pixels by the fixed pattern of their line.
    """
    joined: list[list] = []
    for part in np.array_split(order, number):
        if joined and near[joined[-1][-1][-1]] - near[joined[-1][0][0]] < width:
            joined[-1].append(part)
        else:
            joined.append([part])
    return [np.concatenate(parts) for parts in joined]


def line_range(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> Range:
    """Return the temporal variance of lines: their means' scatter less the noise of their pixels.

    Lines count with the reciprocal variance of their squares; bright ones are known worse.

    Args:
        series: Means of the lines of each residual [DN], and their variances from pixels [DN^2].

    Returns:
        Variance with its interval [DN^2].
    """
    own = np.concatenate([variances for _, variances in series])
    variance = 0.0
    for _ in range(4):
        total = variance + own
        centred = [
            means - np.average(means, weights=1 / (variance + variances))
            for means, variances in series
        ]
        squares = np.concatenate(centred) ** 2 * (len(own) / max(len(own) - len(series), 1))
        weight = total**-2 / np.sum(total**-2)
        first, second = float(weight @ squares), float(weight @ own)
        variance = max(first - second, 0.0)
    freedom = (variance + second) ** 2 * float(np.sum((variance + own) ** -2))
    return difference_of(MeanSquare(first, freedom), MeanSquare(second, 1e6))
