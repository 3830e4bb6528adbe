"""Noise of two stacks of frames side by side: differences of statistics with bootstrap intervals."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.fit.noise_sums import BANDS, LAGS, NoiseSums

RESAMPLES = 400
LEAST_FRAMES = 6  # from which the variation of frames counts, too


@dataclass(frozen=True, eq=False)
class Statistic:
    """A statistic of real and simulated frames.

    Args:
        name: Its name, in words.
        difference: Of real and simulated.
        error: Standard error of the difference, by bootstrap over blocks, and from frames if these vary
            more.
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
    freedom: float = math.inf
    real: float | None = None
    simulated: float | None = None


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
    random = np.random.default_rng(seed)

    def bootstrap(of: Callable, names: tuple[str, ...]) -> np.ndarray:
        """Return the values of a function of resampled sums, (RESAMPLES, ...)."""
        return np.array(
            [
                of(*(_resample(sums, names, random) for sums in (real, simulated)))
                for _ in range(RESAMPLES)
            ]
        )

    def made(of, names):
        """Return the difference and its standard error."""
        value = of(*([getattr(sums, name) for name in names] for sums in (real, simulated)))
        return np.asarray(value), bootstrap(of, names).std(axis=0)

    found = []
    found += _variance_statistics(real, simulated, channels, made)
    found.append(_divergence(real, simulated, made))
    for word, name in (("rows", "rows"), ("columns", "columns")):
        value, error = made(lambda a, b: _line_share(a[0]) - _line_share(b[0]), (name,))
        pair = _line_share(real.__dict__[name]), _line_share(simulated.__dict__[name])
        found.append(
            Statistic(
                f"noise of {word} in the variance",
                float(value),
                float(error),
                0.0025,
                "%",
                real=pair[0],
                simulated=pair[1],
            )
        )
    for word, name in (("rows", "along_rows"), ("columns", "along_columns")):
        value, error = made(lambda a, b: np.log(a[0].mean(axis=0) / b[0].mean(axis=0)), (name,))
        found.append(_largest(f"spectrum along {word}", value, error, 0.05, "%", BANDS))
    value, error = made(lambda a, b: _correlation(a[0]) - _correlation(b[0]), ("products",))
    found.append(_largest("correlation of neighbours", value, error, 0.02, "", len(LAGS)))
    names = ("pattern", "squares", "numbers")
    value, error = made(
        lambda a, b: _pattern_share(a, real.frames) - _pattern_share(b, simulated.frames), names
    )
    pair = [
        _pattern_share([getattr(sums, name) for name in names], sums.frames)
        for sums in (real, simulated)
    ]
    found.append(
        Statistic(
            "fixed pattern over the variance",
            float(value),
            float(error),
            0.05,
            "%",
            real=pair[0],
            simulated=pair[1],
        )
    )
    if is_dark:
        found.append(_level(real, simulated, made))
    return found


def _resample(sums, names, random):
    """Return sums of as many groups, drawn with replacement; equal draws for arrays of equal length."""
    drawn, found = {}, []
    for name in names:
        values = getattr(sums, name)
        if len(values) not in drawn:
            drawn[len(values)] = random.integers(len(values), size=len(values))
        found.append(values[drawn[len(values)]])
    return found


def _variance(squares, numbers):
    return squares.sum(axis=0) / numbers.sum(axis=0)


def _variance_statistics(real, simulated, channels, made):
    value, error = made(
        lambda a, b: _variance(*a) / np.maximum(_variance(*b), 1e-12) - 1, ("squares", "numbers")
    )
    ratio = value + 1
    from_frames = np.zeros_like(error)
    for sums in (real, simulated):
        frames = sums.by_frame
        if len(frames) >= LEAST_FRAMES:
            mean = frames.mean(axis=0)
            from_frames += frames.var(axis=0, ddof=1) / len(frames) / np.maximum(mean, 1e-12) ** 2
    error = np.maximum(error, ratio * np.sqrt(from_frames))
    values = [_variance(sums.squares, sums.numbers) for sums in (real, simulated)]
    return [
        Statistic(
            f"variance of {letter}" if len(channels) > 1 else "variance",
            float(value[k]),
            float(error[k]),
            0.02,
            "%",
            real=float(values[0][k]),
            simulated=float(values[1][k]),
        )
        for k, letter in enumerate(channels)
    ]


def _divergence(real, simulated, made):
    """Return the Kullback-Leibler divergence of residuals, the channels' mean [nat].

    Its bias, (bins - 1) / 2 (1 / n + 1 / m), is subtracted.
    """

    def divergence(a, b):
        p, q = a[0].sum(axis=0), b[0].sum(axis=0)  # (channels, bins)
        total, number = 0.0, 0.0
        for one, other in zip(p, q, strict=True):
            one, other = _merge_rare(one, other)
            n, m = one.sum(), other.sum()
            value = float(np.sum(one / n * np.log((one / n) / (other / m))))
            total += n * (value - (len(one) - 1) / 2 * (1 / n + 1 / m))
            number += n
        return total / number

    value, error = made(divergence, ("bins",))
    return Statistic(
        "distribution (KL divergence)", float(value), float(error), 0.002, "nat", is_distance=True
    )


LEAST_COUNT = 20  # of a bin of both


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


def _line_share(lines):
    """Return the variance that a line's pixels have in common, relative to a pixel's own."""
    number, squares, reciprocal = lines.sum(axis=0)
    return float((squares - reciprocal) / number)


def _correlation(products):
    summed, number = products.sum(axis=0)
    return summed / number


def _pattern_share(parts, frames):
    """Return the fixed pattern's variance relative to the temporal one, the channels' mean."""
    pattern, squares, numbers = parts
    temporal = _variance(squares, numbers)
    spatial = pattern[:, 0].sum(axis=0) / pattern[:, 1].sum(axis=0) - temporal / frames
    weight = numbers.sum(axis=0)
    return float(np.sum(weight * spatial / np.maximum(temporal, 1e-12)) / weight.sum())


def _level(real, simulated, made):
    deviation = np.sqrt(np.mean(_variance(real.squares, real.numbers)))
    value, error = made(lambda a, b: _mean_of(a[0]) - _mean_of(b[0]), ("totals",))
    return Statistic(
        "level of dark frames", float(value), float(error), 0.1 * float(deviation), "DN",
        real=_mean_of(real.totals), simulated=_mean_of(simulated.totals),
    )  # fmt: skip


def _mean_of(totals):
    summed, number = totals.sum(axis=0)
    return float(summed / number)


def _largest(name, value, error, within, unit, chances):
    """Return the statistic of the difference that is most standard errors from 0."""
    place = int(np.argmax(np.abs(value) / np.maximum(error, 1e-12)))
    return Statistic(name, float(value[place]), float(error[place]), within, unit, chances)
