"""Sums over blocks of a stack of raw frames, from which the noise statistics of any choice of blocks follow.

Noise is measured on residuals without fixed pattern: each frame's difference from the mean of the frames before it,
scaled to the variance of one frame (recursive residuals, which are independent). Means of rows and columns are measured
by themselves and removed from all else: what a line has in common would count as many independent pixels. The
distribution is measured on differences of two frames, which are whole numbers as raw values are.
"""

from dataclasses import dataclass

import numpy as np

BLOCKS = 8  # along rows and columns of a frame
BANDS = 6  # of frequency, from 0 to half a cycle a pixel
LAGS = ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0))  # rows and columns of neighbours
# ends of the bins of residuals, in standard deviations: fine in the middle, and tails
EDGES = np.concatenate([np.arange(0, 2.51, 0.25), [3, 3.5, 4, 5, 7]])
FAR, TINY = 6.0, 1e-12  # standard deviations of the pattern from which a pixel is a defect
DEGREE = 2  # of the polynomial that is an evenly lit frame's light


@dataclass(frozen=True, eq=False)
class NoiseSums:
    """Sums of blocks, the first axis of each array.

    Args:
        numbers, squares: Number and sum of squares of residuals of each channel [DN^2], shape (B, C).
        bins: Number of differences in each bin of each channel, shape (B, C, K).
        rows, columns: Number of groups of lines, sums over their lines of the squared mean of a line
            over the variance of a pixel, and of 1 / length, shapes (G, 3).
        along_rows, along_columns: Power of white noise 1 in each band, of groups of lines, (G, BANDS).
        products: Products of neighbours at each lag over the variance, and their numbers, shape
            (B, 2, lags).
        pattern: Squared deviations of the mean frame from a smooth surface, without lines and defects
            [DN^2], and numbers, of each channel, (B, 2, C).
        defects: Number of pixels of the mean frame that are far from the others, and of all, (B, 2).
        fixed_rows: As `rows`, of the mean frame over the temporal deviation; the third sum has the
            pixels' part.
        fixed_columns: As `fixed_rows`, of columns.
        totals: Sum of values and number of pixels, (B, 2).
        levels: Mean of each frame [DN], (n,).
        frames: Number of frames.
        by_frame: Variance of each channel in each residual [DN^2], (n - 1, C).
    """

    numbers: np.ndarray
    squares: np.ndarray
    bins: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    along_rows: np.ndarray
    along_columns: np.ndarray
    products: np.ndarray
    pattern: np.ndarray
    defects: np.ndarray
    fixed_rows: np.ndarray
    fixed_columns: np.ndarray
    totals: np.ndarray
    frames: int
    by_frame: np.ndarray
    levels: np.ndarray


def sum_noise(
    stack: np.ndarray, letters: np.ndarray, deviations: np.ndarray, is_whole: bool = True
) -> NoiseSums:
    """Return the sums of a stack.

    Args:
        stack: Raw values [DN], shape (n, rows, cols), n >= 2.
        letters: Index of the channel of each pixel of one period, shape (period_y, period_x).
        deviations: Standard deviation of a frame's pixel in each channel, which scales bins [DN].
        is_whole: Whether values are whole numbers; then ends of bins lie between them.

    Returns:
        The sums.
    """
    values = stack.astype(np.float32)
    rows, cols = values.shape[1:]
    channel = np.tile(letters, (-(-rows // letters.shape[0]), -(-cols // letters.shape[1])))
    channel = channel[:rows, :cols]
    count, block = len(deviations), _blocks(rows, cols)
    where = (block * count + channel).ravel()
    most = BLOCKS * BLOCKS * count
    counts = np.bincount(where, minlength=most).astype(np.float64)
    lined = _residuals(values, letters.shape)
    residuals = _without_lines(lined)
    squares, by_frame = np.zeros(most), []
    for residual in residuals:
        summed = np.bincount(where, residual.ravel().astype(np.float64) ** 2, most)
        by_frame.append(_over_blocks(summed, count) / _over_blocks(counts, count))
        squares += summed
    bins = np.zeros((most, len(EDGES)))
    for first, second in zip(values[::2], values[1::2], strict=False):
        index = _bin_differences(first - second, channel, deviations, letters.shape, is_whole)
        bins += np.bincount(where * len(EDGES) + index, minlength=bins.size).reshape(bins.shape)
    shape = BLOCKS * BLOCKS, count
    variances = np.mean(by_frame, axis=0)
    scale = np.sqrt(np.maximum(variances, 1e-12))[channel].astype(np.float32)
    white, lined = residuals / scale, lined / scale
    mean = values.mean(axis=0, dtype=np.float64)
    pattern = _without_light(mean, letters, channel, count)
    is_defect = _find_defects(pattern, channel, count)
    even = np.where(is_defect, mean - pattern, mean)
    pattern = np.where(is_defect, 0.0, _without_light(even, letters, channel, count))
    fixed, rest = pattern / scale, _without_lines(pattern[None])[0]
    power = float(np.mean((rest / scale) ** 2))
    return NoiseSums(
        # removed lines take a part of the pixels' freedom
        numbers=len(residuals) * (1 - 1 / rows) * (1 - 1 / cols) * counts.reshape(shape),
        squares=squares.reshape(shape),
        bins=bins.reshape(*shape, len(EDGES)),
        rows=_line_sums(lined, 1),
        columns=_line_sums(lined, 2),
        along_rows=_spectra(white),
        along_columns=_spectra(white.transpose(0, 2, 1)),
        products=_products(white, block),
        pattern=_pattern_sums(rest, where, count),
        defects=np.stack(
            [np.bincount(block.ravel(), part.ravel()) for part in (is_defect, np.ones_like(mean))],
            axis=1,
        ),
        fixed_rows=_line_sums(fixed[None], 1, power),
        fixed_columns=_line_sums(fixed[None], 2, power),
        totals=np.stack(
            [np.bincount(block.ravel(), mean.ravel()), np.bincount(block.ravel())], axis=1
        ),
        frames=len(values),
        by_frame=np.array(by_frame),
        levels=values.mean(axis=(1, 2), dtype=np.float64),
    )


def smooth_light(mean: np.ndarray, letters: np.ndarray, count: int) -> np.ndarray:
    """Return the polynomials of the channels' light over the frame.

    Args:
        mean: Mean frame [DN], shape (rows, cols).
        letters: Index of the channel of each pixel of one period.
        count: Number of channels.

    Returns:
        Coefficients of `powers`, shape (count, n) [DN].
    """
    rows, cols = mean.shape
    y, x = _unit(rows), _unit(cols)
    found = []
    for number in range(count):
        normal, side = 0.0, 0.0
        for place in _places(letters.shape):
            if letters[place[0].start, place[1].start] == number:
                design = powers(y[place[0]][:, None], x[place[1]][None])
                design = design.reshape(design.shape[0], -1)
                normal = normal + design @ design.T
                side = side + design @ mean[place].ravel()
        found.append(np.linalg.lstsq(normal, side, rcond=None)[0])
    return np.array(found)


def light_at(coefficients: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Return one channel's light of `smooth_light` at the pixels of a frame, (rows, cols) [DN]."""
    return np.tensordot(coefficients, powers(_unit(rows)[:, None], _unit(cols)[None]), 1)


def powers(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the products of powers of y and x up to DEGREE, the first axis of the result."""
    exponents = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([y**i * x**j + 0 * (y + x) for i, j in exponents])


def _residuals(values, period):
    """Return the recursive residuals of frames, without the means of the period's places, (n - 1, ...)."""
    found = np.empty((len(values) - 1, *values.shape[1:]), np.float32)
    mean = values[0].astype(np.float64)
    for number in range(1, len(values)):
        scale = np.sqrt(number / (number + 1))
        found[number - 1] = _without_levels(scale * (values[number] - mean), period)
        mean += (values[number] - mean) / (number + 1)
    return found


def _bin_differences(difference, channel, deviations, period, is_whole):
    """Return the bin of each pixel's difference, (pixels,)."""
    for place in _places(period):  # flicker; whole numbers stay whole
        level = difference[place].mean(dtype=np.float64)
        difference[place] -= np.rint(level) if is_whole else level
    index = np.empty(difference.shape, np.int64)
    for number, deviation in enumerate(deviations):
        ends = EDGES * np.sqrt(2) * deviation
        if is_whole:
            ends = np.floor(ends) + 0.5
            ends[0] = 0.0
        chosen = channel == number
        index[chosen] = np.searchsorted(ends, np.abs(difference[chosen]), side="right") - 1
    return index.ravel()


def _without_levels(frame, period):
    """Subtract the mean of each place of the period: the light may flicker."""
    for place in _places(period):
        frame[place] -= frame[place].mean(dtype=np.float64)
    return frame


def _over_blocks(values, count):
    return values.reshape(-1, count).sum(axis=0)


def _unit(size):
    """Return the places of pixel centres between -1 and 1."""
    return (2 * np.arange(size) + 1) / size - 1


def _places(period):
    for row, col in np.ndindex(*period):
        yield slice(row, None, period[0]), slice(col, None, period[1])


def _blocks(rows, cols):
    """Return the number of the block of each pixel, (rows, cols)."""
    y, x = (np.arange(size) * BLOCKS // size for size in (rows, cols))
    return y[:, None] * BLOCKS + x


def _without_lines(frames):
    """Return frames without the means of rows and columns. Frames have a mean of 0."""
    rows = frames.mean(axis=2, keepdims=True, dtype=np.float64)
    columns = frames.mean(axis=1, keepdims=True, dtype=np.float64)
    return (frames - rows - columns).astype(frames.dtype)


def _line_sums(white, axis, power=1.0):
    """Return numbers, squared means and the pixels' part in these, of groups of lines, (G, 3).

    axis: 1 rows, 2 columns. power: variance of pixels.
    """
    means = white.mean(axis=3 - axis, dtype=np.float64)
    lines, length = white.shape[axis], white.shape[3 - axis]
    group = np.arange(lines) * BLOCKS * BLOCKS // lines
    number = len(white) * np.bincount(group, minlength=BLOCKS * BLOCKS).astype(np.float64)
    squares = np.bincount(group, (means**2).sum(axis=0), BLOCKS * BLOCKS)
    return np.stack([number, squares, power * number / length], axis=1)


def _spectra(white):
    """Return the mean power along the last axis in each band, of groups of lines, (G, BANDS).

    Lines lose their mean, which is the noise of lines.
    """
    pairs, lines, length = white.shape
    groups = min(BLOCKS * BLOCKS, lines)
    group = np.arange(lines) * groups // lines
    band = np.minimum((np.arange(1, length // 2 + 1) - 1) * BANDS // max(length // 2, 1), BANDS - 1)
    sizes = np.bincount(band, minlength=BANDS)
    found = np.zeros((groups, BANDS))
    for pair in white:
        power = np.abs(np.fft.rfft(pair, axis=1)[:, 1 : length // 2 + 1]) ** 2 / length
        summed = np.add.reduceat(power, np.searchsorted(group, np.arange(groups)))
        for number in range(BANDS):
            found[:, number] += summed[:, band == number].sum(axis=1)
    return found / np.maximum(np.outer(np.bincount(group, minlength=groups), sizes) * pairs, 1)


def _products(white, block):
    found = np.zeros((BLOCKS * BLOCKS, 2, len(LAGS)))
    rows, cols = white.shape[1:]
    for lag, (down, right) in enumerate(LAGS):
        product = np.einsum(
            "pij,pij->ij", white[:, : rows - down, : cols - right], white[:, down:, right:]
        )
        where = block[: rows - down, : cols - right].ravel()
        found[:, 0, lag] = np.bincount(where, product.ravel(), BLOCKS * BLOCKS)
        found[:, 1, lag] = len(white) * np.bincount(where, minlength=BLOCKS * BLOCKS)
    return found


def _without_light(mean, letters, channel, count):
    """Return a mean frame's deviations from the light; each place of the period has its level."""
    light = smooth_light(mean, letters, count)
    rest = mean.copy()
    for number, coefficients in enumerate(light):
        chosen = channel == number
        rest[chosen] -= light_at(coefficients, *mean.shape)[chosen]
    return _without_levels(rest, letters.shape)


def _find_defects(pattern, channel, count):
    """Return whether each pixel of a pattern is far from the others of its channel."""
    is_defect = np.zeros(pattern.shape, bool)
    for number in range(count):
        chosen = channel == number
        deviation = 1.4826 * np.median(np.abs(pattern[chosen]))  # of a normal distribution
        is_defect[chosen] = np.abs(pattern[chosen]) > FAR * max(deviation, TINY)
    return is_defect


def _pattern_sums(rest, where, count):
    """Return squared deviations, and numbers, (B, 2, C)."""
    most = BLOCKS * BLOCKS * count
    squares = np.bincount(where, (rest**2).ravel(), most)
    numbers = np.bincount(where, minlength=most)
    return np.stack([squares, numbers], axis=1).reshape(-1, count, 2).transpose(0, 2, 1)
