"""Verdicts on the differences between real and simulated frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

from gpusim.domain.short_repr import short_repr
from gpusim.fit.noise_statistics import Statistic

CONFIDENCE = 0.95  # of all intervals together, and of each agreement
AGREES, DIFFERS, UNKNOWN = "agrees", "differs", "cannot be judged"
PERCENT = "%"


@dataclass(frozen=True)
class Finding:
    """A statistic of a group of frames, its interval and the verdict.

    Args:
        group: The frames, in words.
        statistic: Name of the statistic.
        difference: Of real and simulated.
        low, high: Ends of its interval. All intervals together hold with 95 %.
        reach: Largest size of the difference, a bound of 95 %.
        within: Difference that counts as agreement.
        state: "agrees", "differs" or "cannot be judged".
        unit: Unit of the numbers; "%" for relative differences, which are fractions here.
        real, simulated: The two values, or None.
    """

    group: str
    statistic: str
    difference: float
    low: float
    high: float
    reach: float
    within: float
    state: str
    unit: str = ""
    real: float | None = None
    simulated: float | None = None

    __repr__ = short_repr

    @property
    def words(self) -> str:
        """The verdict in words, with its figure."""
        if self.state == AGREES:
            return f"agrees within {self._shown(self.reach)}"
        if self.state == DIFFERS:
            ends = f"{self._shown(self.low)} .. {self._shown(self.high)}"
            return f"differs by {self._shown(self.difference)} ({ends})"
        return (
            f"cannot be judged: it may differ by {self._shown(self.reach)}, agreement is "
            f"{self._shown(self.within)}; take more frames"
        )

    def _shown(self, value):
        if self.unit == PERCENT:
            return f"{100 * value:.2g} %"
        return f"{value:.2g} {self.unit}".rstrip()


def judge(groups: Sequence[tuple[str, Sequence[Statistic]]]) -> list[Finding]:
    """Return the findings of statistics by group.

    A statistic agrees if the difference has the agreed size or less with a confidence of 95 %: two
    one-sided tests of 5 %. All must agree for the verdict, so that the verdict of agreement has an
    error of 5 % or less, too, for any number of statistics. A statistic differs if its interval
    excludes 0 and the difference is larger than agreed. One is enough for the verdict, so that
    these intervals are widened for their number (Bonferroni). Otherwise it cannot be judged: there
    are too few frames.

    Args:
        groups: Words and statistics of each group.

    Returns:
        The findings.

    Source:
        Schuirmann, "A comparison of the two one-sided tests procedure and the power approach for
        assessing the equivalence of average bioavailability", J. Pharmacokinet. Biopharm. 15
        (1987), 657; Berger, "Multiparameter hypothesis testing and acceptance sampling",
        Technometrics 24 (1982), 295, on tests that must all hold.
    """
    number = sum(one.chances for _, statistics in groups for one in statistics)
    tail = (1 - CONFIDENCE) / (2 * max(number, 1))
    return [_find(words, one, tail) for words, statistics in groups for one in statistics]


def _quantile(tail, freedom):
    """Return the standard errors that are exceeded with a probability on one side."""
    if math.isinf(freedom):
        return NormalDist().inv_cdf(1 - tail)
    import scipy.special

    return float(scipy.special.stdtrit(freedom, 1 - tail))


def _find(words, one, tail):
    low, high = _ends(one, tail)
    reach = max(map(abs, _ends(one, 1 - CONFIDENCE)))
    if not (math.isfinite(low) and math.isfinite(high)):
        state = UNKNOWN
    elif reach <= one.within:
        state = AGREES
    elif (low > 0 or high < 0) and abs(one.difference) > one.within:
        state = DIFFERS
    else:
        state = UNKNOWN
    return Finding(
        words,
        one.name,
        one.difference,
        low,
        high,
        reach,
        one.within,
        state,
        one.unit,
        one.real,
        one.simulated,
    )


def _ends(one, tail):
    """Return the ends of an interval that leaves a probability on either side."""
    half = _quantile(tail, one.freedom) * one.error
    low, high = one.difference - half, one.difference + half
    if one.is_distance:  # 0 is its least value, chance makes estimates smaller
        low, high = max(low, 0.0), max(high, 0.0)
    return low, high
