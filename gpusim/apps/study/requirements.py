"""Requirements on measures, and the yield: the share of cameras that meet them, with its interval."""

import math
import operator
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

from gpusim.domain.errors import BadData, UnknownName, format_value
from gpusim.domain.short_repr import short_repr

SIGNS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
CONFIDENCE = 0.95
_FORM = re.compile(r"\s*([^\s<>=@]+)\s*(?:@\s*([^\s<>=@]+)\s*)?(>=|<=|>|<)\s*(\S+)\s*")


@dataclass(frozen=True)
class Requirement:
    """A limit of a measure.

    Args:
        name: Name of its column.
        measure: Name of the measure.
        scene: Name of the scene; "": every scene in which it is measured.
        sign: One of SIGNS.
        limit: The limit.
    """

    name: str
    measure: str
    scene: str
    sign: str
    limit: float

    __repr__ = short_repr

    @classmethod
    def parse(cls, name: str, text: Any, scenes: Mapping[str, Iterable[str]]) -> "Requirement":
        """Return the requirement of a text such as "mtf50 >= 0.3" or "snr@flat > 30".

        Args:
            name: Its name.
            text: The text.
            scenes: The measures, and the scenes in which each is made.

        Raises:
            BadData: The text has another form.
            UnknownName: There is no such measure, or it is not made in this scene.
        """
        found = _FORM.fullmatch(text) if isinstance(text, str) else None
        try:
            limit = float(found[4]) if found else math.nan
        except ValueError:
            limit = math.nan
        if found is None or not math.isfinite(limit):
            raise BadData(
                f'requirement {name} = {format_value(text)}: wanted a text such as "mtf50 >= 0.3" or '
                f'"snr@flat > 30" with one of {", ".join(SIGNS)}'
            )
        measure, scene, sign = found[1], found[2] or "", found[3]
        if measure not in scenes:
            raise UnknownName(f"measure of the requirement {name}", measure, scenes)
        if scene and scene not in scenes[measure]:
            raise UnknownName(f"scene of the requirement {name}", scene, scenes[measure])
        return cls(name, measure, scene, sign, limit)

    @property
    def words(self) -> str:
        """The requirement in words."""
        at = f" in {self.scene}" if self.scene else ""
        return f"{self.measure}{at} {self.sign} {self.limit:g}"

    def judge(self, scene: str, measured: Mapping[str, float | None]) -> bool | None:
        """Return whether a row meets it; None if it is not about the row.

        Args:
            scene: The row's scene.
            measured: The row's measures; a value that could not be measured is None, and meets nothing.
        """
        if (self.scene and scene != self.scene) or self.measure not in measured:
            return None
        value = measured[self.measure]
        return value is not None and bool(SIGNS[self.sign](value, self.limit))


@dataclass(frozen=True)
class Yield:
    """The share of cameras that meet a requirement.

    Args:
        name: Name of the requirement, or "all".
        words: The requirement in words.
        passed: Cameras that meet it in all scenes and seeds.
        count: All cameras.
        wilson: Interval of the yield by Wilson's score; None if the cameras are not a random sample.
        exact: Interval by Clopper and Pearson, which holds at least the stated share of true values; None likewise.
    """

    name: str
    words: str
    passed: int
    count: int
    wilson: tuple[float, float] | None = None
    exact: tuple[float, float] | None = None

    __repr__ = short_repr

    @classmethod
    def of(cls, name: str, words: str, passed: int, count: int, is_random: bool) -> "Yield":
        """Return the yield with its intervals of 95 % confidence."""
        if not is_random or not count:
            return cls(name, words, passed, count)
        return cls(
            name,
            words,
            passed,
            count,
            wilson_interval(passed, count),
            clopper_pearson_interval(passed, count),
        )

    @property
    def share(self) -> float:
        """The yield."""
        return self.passed / self.count if self.count else math.nan


def wilson_interval(passed: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the interval of a share by Wilson's score.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference", JASA 22.
    """
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    share, spread = passed / count, z**2 / count
    middle = (share + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(share * (1 - share) / count + spread / (4 * count))
    return (0.0 if passed == 0 else middle - half), (1.0 if passed == count else middle + half)


def clopper_pearson_interval(
    passed: int, count: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the exact interval of a share, from quantiles of beta distributions.

    Source: Clopper and Pearson 1934, "The use of confidence or fiducial limits illustrated in the case of the
    binomial", Biometrika 26.
    """
    from scipy.special import betaincinv

    tail, failed = (1 - confidence) / 2, count - passed
    low = float(betaincinv(passed, failed + 1, tail)) if passed else 0.0
    high = float(betaincinv(passed + 1, failed, 1 - tail)) if failed else 1.0
    return low, high
