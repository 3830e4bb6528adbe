"""Fixed patterns: offsets and responses of pixels, rows and columns, from two halves of a stack."""

import math
from dataclasses import dataclass

import numpy as np

from gpusim.fit.intervals import MeanSquare, Range, difference_of

DEGREE = 4  # of the polynomial that removes uneven light
OUTLIER = 6.0  # standard deviations of a pixel that is a defect


@dataclass(frozen=True, eq=False)
class Pattern:
    """A fixed pattern's parts as variances, with their intervals.

    Args:
        pixel, row, column: Variances of pixels, rows and columns.
        values: The pattern of pixels, rows and columns together, shape (rows, cols).
        row_means, column_means: Means of rows and columns.
    """

    pixel: Range
    row: Range
    column: Range
    values: np.ndarray
    row_means: np.ndarray
    column_means: np.ndarray


def split_pattern(first, second, good, period, degree: int = 0) -> Pattern:
    """Return the parts of the pattern that two independent maps have in common.

    Half the sum of the maps has the pattern and noise, half their difference the noise only. Means
    of the mosaic's places are removed, or polynomials if the light is uneven.

    Args:
        first: A map of the pixels, shape (rows, cols); it is overwritten.
        second: One of the same pixels from other frames.
        good: Pixels to count, shape (rows, cols).
        period: Rows and columns of the mosaic's period.
        degree: Of the polynomial that is removed from the pattern of each place of the period.

    Returns:
        The parts.
    """
    total = first + second
    total *= np.float32(0.5)
    noise = np.subtract(first, second, out=first)
    noise *= np.float32(0.5)
    rows, cols = period
    shape = total.shape
    lost = 1
    for row in range(rows):
        for col in range(cols):
            place = slice(row, None, rows), slice(col, None, cols)
            chosen = good[place]
            lost = min(degree, min(chosen.shape) // 4) + 1
            _remove_trend(total[place], chosen, lost - 1)
            _remove_trend(noise[place], chosen, 0)
    for plane in (total, noise):
        plane[~good] = 0
    share = np.count_nonzero(good) / good.size
    rows_of = [plane.mean(axis=1, dtype=np.float64) / share for plane in (total, noise)]
    columns_of = [plane.mean(axis=0, dtype=np.float64) / share for plane in (total, noise)]
    values = total.copy()
    squares = [
        _pixel_square(plane, good, period, freedom)
        for plane, freedom in ((total, lost), (noise, 1))
    ]
    pixel = difference_of(*squares)
    lines = []
    for means, number, step in ((rows_of, shape[1], rows), (columns_of, shape[0], cols)):
        sums = [
            _line_square(means[0], step * lost),
            _line_square(means[1], step),
            MeanSquare(max(pixel.value, 0.0) / (number * share), good.size),
        ]
        lines.append(difference_of(*sums))
    row_part, column_part = lines
    return Pattern(pixel, row_part, column_part, values, rows_of[0], columns_of[0])


def _line_square(means, lost):
    freedom = max(len(means) - lost, 1)
    return MeanSquare(float(np.sum(means**2)) / freedom, freedom)


def _pixel_square(plane, good, period, lost):
    """Return the mean square of pixels less their rows and columns; `plane` is overwritten."""
    rows, cols = period
    squares, numbers = [], []
    for row in range(rows):
        for col in range(cols):
            place = slice(row, None, rows), slice(col, None, cols)
            part, chosen = plane[place], good[place]
            part -= part.mean(axis=1, dtype=np.float32)[:, None]
            part -= part.mean(axis=0, dtype=np.float32)
            height, width = part.shape
            number = np.count_nonzero(chosen)
            squares.append(float(np.sum(np.square(part[chosen]), dtype=np.float64)))
            terms = (lost * (lost - 1)) // 2 - (lost - 1)  # mixed terms of the polynomial
            freedom = max((height - 1) * (width - 1) - max(terms, 0), 1)
            numbers.append(max(freedom * number / part.size, 1.0))
    # places differ in their noise: Satterthwaite's degrees of freedom
    total, number = sum(squares), sum(numbers)
    spread = sum(square**2 / count for square, count in zip(squares, numbers, strict=True))
    return MeanSquare(total / number, total**2 / spread if spread > 0 else number)


def _remove_trend(plane, good, degree):
    """Subtract the polynomial of total degree `degree` that fits good pixels; in place."""
    plane -= trend(plane, good, degree)


def trend(plane, good, degree: int) -> np.ndarray:
    """Return the polynomial of a total degree that fits the good pixels of a plane.

    Args:
        plane: Values, shape (rows, cols).
        good: Pixels to count, shape (rows, cols).
        degree: Total degree; 0 is the mean.

    Returns:
        The polynomial, float32, shape (rows, cols) or (1, 1).
    """
    values = plane[good]
    centre = np.float32(values.mean(dtype=np.float64)) if values.size else np.float32(0)
    if degree == 0:
        return np.full((1, 1), centre, np.float32)
    filled = np.where(good, plane, centre)
    down, right = (_legendre(size, degree) for size in plane.shape)
    # the basis is orthogonal on a full grid: coefficients are projections
    coefficients = down.T @ filled.astype(np.float64) @ right
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    coefficients[order > degree] = 0
    return (down @ coefficients @ right.T).astype(np.float32)


def _legendre(size, degree):
    """Return orthonormal polynomials on an even grid, shape (size, degree + 1)."""
    x = np.linspace(-1, 1, size) if size > 1 else np.zeros(1)
    return np.linalg.qr(np.vander(x, degree + 1, increasing=True))[0]


def outliers(values, good, period) -> np.ndarray:
    """Return the pixels far from the others of their place in the period, as a mask.

    Args:
        values: A map, shape (rows, cols).
        good: Pixels to count.
        period: Rows and columns of the mosaic's period.
    """
    found = np.zeros(values.shape, bool)
    rows, cols = period
    for row in range(rows):
        for col in range(cols):
            place = slice(row, None, rows), slice(col, None, cols)
            part = values[place]
            chosen = part[good[place]]
            step = max(1, chosen.size // 400_000)
            low, middle, high = np.percentile(chosen[::step], (15.866, 50, 84.134))
            deviation = max((high - low) / 2, 1e-9)
            found[place] = np.abs(part - middle) > OUTLIER * deviation
    return found & good


def share_range(count: int, total: int) -> Range:
    """Return the share of pixels with a property, with Wilson's interval."""
    z2, share = 1.959963984540054**2, count / total
    middle = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = math.sqrt(z2 * (share * (1 - share) / total + z2 / (4 * total**2))) / (1 + z2 / total)
    return Range(share, max(middle - half, 0.0), middle + half)
