"""Noise of two stacks of frames side by side: differences of statistics with bootstrap intervals."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.fit.noise_sums import BANDS, BLOCKS, LAGS, NoiseSums

RESAMPLES = 200
LEAST_FRAMES = 6  # from which the variation of frames counts, too
LEAST_COUNT = 20  # of a bin of residuals in both stacks
TINY = 1e-12
# differences that are still agreement; those of lines and patterns grow with these themselves
VARIANCE_WITHIN, DIVERGENCE_WITHIN, SPECTRUM_WITHIN, CORRELATION_WITHIN = 0.02, 0.002, 0.05, 0.02
LINES_WITHIN, FIXED_LINES_WITHIN, PATTERN_WITHIN = (0.0025, 0.2), (0.01, 0.3), (0.05, 0.1)
DEFECTS_WITHIN = 2e-4, 0.5  # part of the pixels
LEVEL_WITHIN = 0.1  # of the standard deviation of a pixel


@dataclass(frozen=True, eq=False)
class Statistic:
    """A statistic of real and simulated frames.

    Args:
        name: Its name, in words.
        difference: Of real and simulated.
        error: Standard error of the difference, by bootstrap over blocks, and from frames if these
            vary more.
        within: Difference that is still agreement.
        unit: "" or the unit of the difference; "%" shows it in percent.
        chances: Number of differences of which this is the largest.
        is_distance: Whether it cannot be below 0, as a divergence.
        freedom: Degrees of freedom of the standard error.
        real, simulated: The two values, for tables.
    """

    name: str
    difference: float
    error: float
    within: float
    unit: str = ""
    chances: int = 1
    is_distance: bool = False
    freedom: float = BLOCKS * BLOCKS - 1
    real: float | None = None
    simulated: float | None = None


class _Pair:
    """Sums of the real and the simulated stack, and differences of their statistics."""

    def __init__(self, real: NoiseSums, simulated: NoiseSums, random: np.random.Generator):
        self.stacks, self._random = (real, simulated), random
        self._weights: dict = {}

    def totals(self, name: str) -> list[np.ndarray]:
        """Return the sums over all blocks of both stacks."""
        return [getattr(sums, name).sum(axis=0) for sums in self.stacks]

    def difference(self, of: Callable, *names: str) -> tuple[np.ndarray, np.ndarray]:
        """Return a difference and its standard error.

        Args:
            of: Function of totals of the real stack and of the simulated one, lists in the order of
                `names`.
            names: Sums of blocks.
        """
        value = of(*zip(*map(self.totals, names), strict=True))
        drawn = [[self._drawn(stack, name) for name in names] for stack in self.stacks]
        values = [of(*([part[k] for part in stack] for stack in drawn)) for k in range(RESAMPLES)]
        return np.asarray(value), np.std(values, axis=0)

    def _drawn(self, stack, name):
        """Return totals of blocks drawn with replacement, (RESAMPLES, ...).

        Draws of equal numbers of blocks are equal, and those of both stacks: the light of a block is the same in both.
        """
        values = getattr(stack, name)
        count = len(values)
        if count not in self._weights:
            even = np.full(count, 1 / count)
            self._weights[count] = self._random.multinomial(count, even, RESAMPLES)
        return np.tensordot(self._weights[count].astype(np.float64), values, 1)


def noise_statistics(
    real: NoiseSums,
    simulated: NoiseSums,
    channels: tuple[str, ...],
    *,
    is_dark: bool,
    seed: int = 0,
) -> list[Statistic]:
    """Compare the noise of two stacks at equal signals.

    Args:
        real: Sums of the real frames.
        simulated: Sums of the simulated frames.
        channels: Letters of the channels.
        is_dark: Whether levels are compared; the level of light is not known.
        seed: Seed of the bootstrap.

    Returns:
        The statistics.
    """
    pair = _Pair(real, simulated, np.random.default_rng(seed))
    found = _variances(pair, channels)
    found.append(_divergence(pair))
    found += [_lines(pair, name) for name in ("rows", "columns")]
    for name in ("rows", "columns"):
        value, error = pair.difference(lambda a, b: np.log(a[0] / b[0]), f"along_{name}")
        value = value + np.log(len(getattr(simulated, f"along_{name}")))
        value = value - np.log(len(getattr(real, f"along_{name}")))
        found.append(_largest(f"spectrum along {name}", value, error, SPECTRUM_WITHIN, "%", BANDS))
    value, error = pair.difference(lambda a, b: _ratio(a[0]) - _ratio(b[0]), "products")
    found.append(
        _largest("correlation of neighbours", value, error, CORRELATION_WITHIN, "", len(LAGS))
    )
    found += [_pattern(pair), _defects(pair)]
    found += [_lines(pair, name) for name in ("fixed_rows", "fixed_columns")]
    return [*found, _level(pair)] if is_dark else found


def _ratio(totals):
    """Return the first over the second of totals."""
    return totals[0] / np.maximum(totals[1], TINY)


def _variances(pair, channels):
    def relative(a, b):
        return a[0] / a[1] / np.maximum(b[0] / b[1], TINY) - 1

    value, error = pair.difference(relative, "squares", "numbers")
    between = np.zeros_like(error)
    for sums in pair.stacks:
        frames = sums.by_frame
        if len(frames) >= LEAST_FRAMES:
            mean = np.maximum(frames.mean(axis=0), TINY)
            between += frames.var(axis=0, ddof=1) / len(frames) / mean**2
    error = np.maximum(error, (value + 1) * np.sqrt(between))
    values = [
        squares / numbers
        for squares, numbers in zip(pair.totals("squares"), pair.totals("numbers"), strict=True)
    ]
    return [
        Statistic(
            f"variance of {letter}" if len(channels) > 1 else "variance",
            float(value[k]),
            float(error[k]),
            VARIANCE_WITHIN,
            "%",
            real=float(values[0][k]),
            simulated=float(values[1][k]),
        )
        for k, letter in enumerate(channels)
    ]


def _divergence(pair):
    """Return the Kullback-Leibler divergence of residuals, the channels' mean [nat].

    Its bias, (bins - 1) / 2 (1 / n + 1 / m), is subtracted.
    """
    value, error = pair.difference(lambda a, b: _mean_divergence(a[0], b[0]), "bins")
    return Statistic(
        "distribution (KL divergence)",
        float(value),
        float(error),
        DIVERGENCE_WITHIN,
        "nat",
        is_distance=True,
    )


def _mean_divergence(real, simulated):
    """Return the mean divergence of counts (channels, bins)."""
    total = number = 0.0
    for one, other in zip(real, simulated, strict=True):
        one, other = _merge_rare(one, other)
        n, m = one.sum(), other.sum()
        value = float(np.sum(one / n * np.log((one / n) / (other / m))))
        total += n * (value - (len(one) - 1) / 2 * (1 / n + 1 / m))
        number += n
    return total / number


def _merge_rare(one, other):
    """Return the counts with rare bins joined to their inner neighbours."""
    joined: list = []
    for pair in zip(one[::-1], other[::-1], strict=True):
        if joined and min(joined[-1]) < LEAST_COUNT:
            joined[-1] = [joined[-1][0] + pair[0], joined[-1][1] + pair[1]]
        else:
            joined.append(list(pair))
    if len(joined) > 1 and min(joined[-1]) < LEAST_COUNT:
        last = joined.pop()
        joined[-1] = [joined[-1][0] + last[0], joined[-1][1] + last[1]]
    counts = np.maximum(np.array(joined, np.float64), 0.5)
    return counts[:, 0], counts[:, 1]


def _lines(pair, name):
    value, error = pair.difference(lambda a, b: _line_share(a[0]) - _line_share(b[0]), name)
    real, simulated = map(_line_share, pair.totals(name))
    is_fixed = name.startswith("fixed_")
    least, part = FIXED_LINES_WITHIN if is_fixed else LINES_WITHIN
    lines = name.removeprefix("fixed_")
    return Statistic(
        f"fixed pattern of {lines}" if is_fixed else f"noise of {lines}",
        float(value),
        float(error),
        least + part * max(simulated, 0.0),
        "%",
        real=real,
        simulated=simulated,
    )


def _line_share(lines):
    """Return the variance that a line's pixels have in common, relative to a pixel's temporal one."""
    number, squares, of_pixels = lines
    return float((squares - of_pixels) / number)


def _pattern(pair):
    frames = [sums.frames for sums in pair.stacks]
    names = "pattern", "squares", "numbers"

    def share(parts, count):
        """Return the fixed pattern's variance relative to the temporal one, the channels' mean."""
        pattern, squares, numbers = parts
        temporal = np.maximum(squares / numbers, TINY)
        spatial = pattern[0] / np.maximum(pattern[1], 1) - temporal / count
        return float(np.sum(numbers * spatial / temporal) / numbers.sum())

    value, error = pair.difference(lambda a, b: share(a, frames[0]) - share(b, frames[1]), *names)
    totals = zip(*map(pair.totals, names), strict=True)
    real, simulated = (share(one, count) for one, count in zip(totals, frames, strict=True))
    least, part = PATTERN_WITHIN
    return Statistic(
        "fixed pattern of pixels",
        float(value),
        float(error),
        least + part * max(simulated, 0.0),
        "%",
        real=real,
        simulated=simulated,
    )


def _defects(pair):
    value, error = pair.difference(lambda a, b: _ratio(a[0]) - _ratio(b[0]), "defects")
    real, simulated = map(_ratio, pair.totals("defects"))
    # in counts of 0 a bootstrap sees no spread: one pixel more or less
    least = math.hypot(*(1 / total[1] for total in pair.totals("defects")))
    within, part = DEFECTS_WITHIN
    return Statistic(
        "defects",
        float(value),
        max(float(error), least),
        within + part * float(simulated),
        "%",
        real=float(real),
        simulated=float(simulated),
    )


def _level(pair):
    squares, numbers = pair.totals("squares")[0], pair.totals("numbers")[0]
    deviation = math.sqrt(float(np.mean(squares / numbers)))
    value, error = pair.difference(lambda a, b: _ratio(a[0]) - _ratio(b[0]), "totals")
    real, simulated = map(_ratio, pair.totals("totals"))
    # lines and drift move whole frames
    frames = math.sqrt(sum(one.levels.var(ddof=1) / one.frames for one in pair.stacks))
    return Statistic(
        "level of dark frames",
        float(value),
        max(float(error), frames),
        LEVEL_WITHIN * deviation,
        "DN",
        freedom=min(one.frames for one in pair.stacks) - 1,
        real=float(real),
        simulated=float(simulated),
    )


def _largest(name, value, error, within, unit, chances):
    """Return the statistic of the difference that is most standard errors from 0."""
    place = int(np.argmax(np.abs(value) / np.maximum(error, TINY)))
    return Statistic(name, float(value[place]), float(error[place]), within, unit, chances)
