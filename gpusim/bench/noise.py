"""Statistics of a comparison: which rows of a benchmark became slower, in spite of the noise.

**Figures.** A row has n rounds on each side. A round gives y, the log of a low percentile or of
the median of its repetitions. Rounds alternate in time, so they make pairs:

    d[row, pair] = y[other] - y[base]

A slow drift of the machine is in both rounds of a pair and cancels.

**Common change.** c[pair] is the median of d over all rows, and C its mean over pairs. The changes
of c from pair to pair are the machine's (load, clock) and are subtracted from every row. C itself
may be the machine's or real: it gets a verdict of its own. A row is *slower* only if it is slower
than both 0 and C by more than its margin. It is then slower than the base and also slower than the
other rows, whatever C is. If C itself is beyond its margin, it counts as real, and rows are also
compared with 0, with both margins. With fewer than LEAST_ROWS rows there is no common change.

**Margin.** The mean over pairs has the squared standard error v = s^2 / n, with n - 1 degrees of
freedom: too few for a correction for a hundred rows. Rows share information. If their true
variances follow a scaled inverse chi-square distribution with d0 degrees of freedom and scale v0,
the mean of the posterior's precision gives

    v' = (d0 v0 + (n - 1) v) / (d0 + n - 1)

and mean / sqrt(v') has a t distribution with d0 + n - 1 degrees of freedom. v0 and d0 come from
the mean and the variance of log v over rows. Rows of very different noise make d0 small, so that
each row stands for itself. The margin is the quantile of this t distribution at
ALPHA / 2 / tests, two-sided (Bonferroni, over all rows of all columns); the other half of ALPHA is
for the common change. No margin is below LEAST_MARGIN.

**Bursts.** Other programs slow some rounds by tens of percent. One slow round widens its own
row's margin. That all pairs of one row are hit in the same direction happens too: a row needs
pairs that agree. All n pairs must lie beyond a size m, or n - n // 5 of them if means are
trimmed. The deviations of all pairs from the median of their rows give the share p(m) of
deviations beyond m, in one direction and with one added, so that it is never 0. m is the least
size that so many of n pairs pass by chance with less probability than
ALPHA / 4 / tests (binomial distribution).

**Choice of the estimate.** With low noise the mean is best, with bursts a trimmed one: its
variance is the winsorised one (Yuen). A processor that others use
too, for parts of a second, leaves the least time of a round nearly alone, if the round is long
enough: measured there, it varied by 1.5 %, the 20th percentile by 9 %, the median by 13 %. On a quiet
machine the 20th varies least, on a loaded one often the median. All six are computed. The one whose least visible
slowdown, below, has the smallest median over rows is used for the whole table. It depends on
deviations only, not on the change.

**Least visible slowdown.** Given v', the estimate is distributed around the true change as t. A
slowdown of margin + t(p) sqrt(v') passes the margin with the probability p. All n pairs pass m with
the probability p if each does with p^(1 / n), i.e. for a slowdown of m + t(p^(1 / n)) sqrt(n v'). The
larger of both, with p = (1 + POWER) / 2, passes both with a probability of at least POWER.

**Rounds that do not alternate.** A process has a level of its own: memory layout, placement of
threads, neighbours. Rounds of one process do not show it, and rounds of two processes differ by
it. Measured on 25 stages, 14 processes and 4 rounds each on a shared machine, the standard
deviation of the level was 0.3 to 2.5 times the standard deviation of rounds in a process. PROCESS
is the largest of these. The variance is then taken within each side, and 1 / n becomes
1 / n + PROCESS^2.

Source: G. K. Smyth, Statistical Applications in Genetics and Molecular Biology 3 (2004), article 3,
for moderated variances; K. K. Yuen, Biometrika 61 (1974) 165, for trimmed means.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ALPHA = 0.01  # of a false alarm anywhere in the table
POWER = 0.9  # of finding the least visible slowdown
LEAST_ROUNDS = 3
LEAST_ROWS = 8  # for a common change
PERCENTILES = (0, 20, 50)  # of a round's repetitions, one of them is chosen
LEAST_MARGIN = 0.005  # the place of code and data in memory changes times by as much
PROCESS = 2.5  # level of a process over the deviation of rounds in it
MOST_PRIOR = 50.0  # degrees of freedom; more change a quantile by less than 3 %

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Change:
    """A change of time and its uncertainty, as logs of the ratio to the base.

    Attributes:
        change: The estimate.
        margin: Half the simultaneous interval.
        visible: The least slowdown that would have been found with the probability POWER.
        sign: 1 slower, -1 faster, 0 the same.
    """

    change: float
    margin: float
    visible: float
    sign: int


@dataclass(frozen=True)
class Judgement:
    """Changes of all rows.

    Attributes:
        rows: A change for each row.
        common: The change of the median row; None with fewer than LEAST_ROWS rows.
        percentile: The percentile of a round that was used.
        is_trimmed: Whether the means are trimmed.
    """

    rows: tuple[Change, ...]
    common: Change | None
    percentile: int
    is_trimmed: bool


@dataclass(frozen=True)
class _Estimate:
    """An estimate of all rows: mean and margin (rows,).

    visible: least slowdown (rows,) without the common change.
    pairs: differences of pairs (rows, pairs) without the common change's variation.
    least: size that the pairs of one row pass together by chance too rarely to count.
    agreeing: pairs of a row that must pass it.
    common, common_error, common_freedom: mean, standard error, degrees of freedom of the common change.
    """

    mean: Array
    margin: Array
    visible: Array
    pairs: Array
    least: float
    agreeing: int
    common: float
    common_error: float
    common_freedom: float


def judge(
    base: Array, other: Array, alternate: bool = True, tests: int | None = None, columns: int = 1
) -> Judgement:
    """Return the change of each row and of all rows.

    Args:
        base: Logs of the PERCENTILES of each round, shape (percentiles, rows, rounds).
        other: The same for the other side.
        alternate: Whether the rounds of both sides alternate in time.
        tests: Comparisons in the whole table, for the correction. None: the rows.
        columns: Sides that are compared with the base in the whole table.
    """
    tests = tests or base.shape[1]
    trims = sorted({0, base.shape[2] // 5})
    choices = [
        (_estimate(before, after, alternate, trim, tests), percentile, trim)
        for percentile, before, after in zip(PERCENTILES, base, other, strict=True)
        for trim in trims
    ]
    best, percentile, trim = min(choices, key=lambda choice: float(np.median(choice[0].visible)))
    has_common = base.shape[1] >= LEAST_ROWS
    common = _common_change(best, columns) if has_common else None
    return Judgement(_row_changes(best, common), common, percentile, trim > 0)


def _estimate(before, after, alternate, trim, tests):
    """Return the estimate from logs of both sides, shape (rows, rounds)."""
    from scipy.stats import t

    rows, rounds = before.shape
    shift = np.zeros(rounds)
    if rows >= LEAST_ROWS:
        shift = np.median(after - before, axis=0)
    common, common_square, common_freedom = _locate(shift[None], trim)
    pairs = after - before - (shift - common)
    mean, square, freedom = _locate(pairs, trim)
    if not alternate:
        square, freedom = _widen(before, after, trim)
        level = (np.median(side - side.mean(1, keepdims=True), 0) for side in (before, after))
        common_square, common_freedom = _widen(*(side[None] for side in level), trim)
    square, freedom = moderate(square, freedom)
    error = np.sqrt(square)
    margin = np.maximum(t.isf(ALPHA / 4 / tests, freedom) * error, LEAST_MARGIN)
    agreeing = rounds - trim
    least = _burst_limit(pairs, agreeing, tests)
    each = (1 + POWER) / 2  # of the margin, and of the limit of bursts
    spread = t.ppf(each ** (1 / rounds), freedom) * error * np.sqrt(rounds)
    visible = np.maximum(margin + t.ppf(each, freedom) * error, least + spread)
    return _Estimate(
        mean,
        margin,
        visible,
        pairs,
        least,
        agreeing,
        float(common[0]),
        float(np.sqrt(common_square[0])),
        common_freedom,
    )


def _locate(values, trim):
    """Return the mean, its squared error and its degrees of freedom, over the last axis.

    trim: values to leave out at each end. The variance is then the winsorised one.
    """
    count = values.shape[-1]
    kept = count - 2 * trim
    ordered = np.sort(values, axis=-1)
    clipped = np.clip(ordered, ordered[..., trim, None], ordered[..., count - 1 - trim, None])
    square = clipped.var(-1, ddof=1) * (count - 1) / (kept * (kept - 1))
    return ordered[..., trim : count - trim].mean(-1), square, kept - 1.0


def _widen(before, after, trim):
    """Return the squared error and degrees of freedom if the rounds of both sides do not alternate."""
    sides = [_locate(side, trim) for side in (before, after)]
    square = sides[0][1] + sides[1][1]
    return square * (1 + PROCESS**2 * before.shape[-1]), sides[0][2] + sides[1][2]


def moderate(square: Array, freedom: float) -> tuple[Array, float]:
    """Return squared errors that use those of the other rows, and their degrees of freedom.

    Args:
        square: Squared errors of rows, shape (rows,).
        freedom: Degrees of freedom of each.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    square = np.maximum(square, 1e-12)  # a timer of coarse steps gives equal rounds
    if len(square) < LEAST_ROWS:
        return square, freedom
    logs = np.log(square) - digamma(freedom / 2) + np.log(freedom / 2)
    # of the true variances: what the chi-square distribution does not explain
    excess = logs.var(ddof=1) - polygamma(1, freedom / 2)
    half = MOST_PRIOR / 2
    if excess > polygamma(1, half):
        half = brentq(lambda half: polygamma(1, half) - excess, 1e-6, half)
    scale = np.exp(logs.mean() + digamma(half) - np.log(half))
    total = 2 * half + freedom
    return (2 * half * scale + freedom * square) / total, total


def _common_change(estimate, columns):
    """Return the change of the median row."""
    from scipy.stats import t

    margin = float(t.isf(ALPHA / 4 / columns, estimate.common_freedom)) * estimate.common_error
    margin = max(margin, LEAST_MARGIN)
    visible = margin + float(t.ppf(POWER, estimate.common_freedom)) * estimate.common_error
    sign = int(np.sign(estimate.common)) if abs(estimate.common) > margin else 0
    return Change(estimate.common, margin, visible, sign)


def _row_changes(estimate, common):
    """Return the change of each row."""
    ordered, agreeing = np.sort(estimate.pairs, axis=1), estimate.agreeing
    # the largest size beyond which enough pairs lie, upwards and downwards
    agreed = {1: ordered[:, -agreeing], -1: -ordered[:, agreeing - 1]}
    drift = 0.0 if common is None else common.change
    sign = np.zeros(len(ordered), int)
    for way in (1, -1):
        found = np.zeros(len(sign), bool)
        floors = [(max(0.0, way * drift), 0.0)]
        if common is not None and common.sign:
            floors.append((0.0, common.margin))
        for floor, more in floors:
            beyond = way * estimate.mean - floor > estimate.margin + more
            found |= beyond & (agreed[way] - floor > estimate.least + more)
        sign[found] = way
    visible = estimate.visible
    if common is not None:
        visible = visible + (common.margin if common.sign else max(0.0, -drift))
    return tuple(
        Change(*map(float, row), int(way))
        for *row, way in zip(estimate.mean, estimate.margin, visible, sign, strict=True)
    )


def _burst_limit(pairs, agreeing, tests):
    """Return the size that `agreeing` pairs of one row pass together by chance too rarely to count."""
    from scipy.special import betaincinv

    rounds = pairs.shape[1]
    # P(at least k of n) is the regularised incomplete beta function of the share
    share = betaincinv(agreeing, rounds - agreeing + 1, ALPHA / 4 / tests)
    sizes = np.sort(np.abs(pairs - np.median(pairs, axis=1, keepdims=True)), axis=None)
    # one pair of each row, or the middle two together, make the median
    count = len(pairs) * (rounds - 1)
    allowed = 2 * (share * (1 + count) - 1)  # in both directions
    return float("inf") if allowed < 0 else float(sizes[-1 - min(int(allowed), len(sizes) - 1)])
