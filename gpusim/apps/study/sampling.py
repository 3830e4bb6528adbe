"""Values of the varied keys of each camera: distributions, and the ways to draw from them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from statistics import NormalDist
from typing import Any

import numpy as np

from gpusim.domain.errors import (
    BadData,
    OutOfRange,
    UnknownName,
    checked_count,
    format_value,
)
from gpusim.domain.short_repr import short_repr

METHODS = ("latin", "montecarlo", "grid", "one-at-a-time")
RANDOM = ("latin", "montecarlo")  # methods with a count and a seed, whose cameras are a sample
MOST = 10**7  # cameras
STEPS = 5  # values of each key of "one-at-a-time"
LOW, HIGH = 0.05, 0.95  # quantiles between which these lie
KINDS = {
    "uniform": "low, high",
    "loguniform": "low, high, above 0",
    "normal": "mean, standard deviation",
    "lognormal": "median, above 0, standard deviation of the logarithm",
    "grid": "numbers",
    "choice": "values",
}


@dataclass(frozen=True)
class Distribution:
    """Values of a key.

    Args:
        kind: One of KINDS.
        values: Its numbers, or the values that are listed.
        limits: Ends at which a normal or lognormal distribution is truncated.
    """

    kind: str
    values: tuple
    limits: tuple[float, float] = (-math.inf, math.inf)

    __repr__ = short_repr

    @classmethod
    def parse(cls, key: str, given: Any) -> "Distribution":
        """Return the distribution of a study file, such as {normal = [0, 5]}.

        Raises BadData, OutOfRange, UnknownName.
        """
        words = f'vary "{key}"'
        if not isinstance(given, Mapping):
            raise BadData(
                f"{words} = {format_value(given)}: wanted a table, such as {{uniform = [1, 5]}}"
            )
        kinds = [name for name in given if name != "limits"]
        for name in kinds:
            if name not in KINDS:
                raise UnknownName(f"distribution of {words}", name, KINDS)
        if len(kinds) != 1:
            raise BadData(f"{words}: {len(kinds)} distributions; wanted one of {', '.join(KINDS)}")
        kind = kinds[0]
        values = _values(words, kind, given[kind])
        if "limits" not in given:
            return cls(kind, values)
        if kind not in ("normal", "lognormal"):
            raise BadData(f"{words}: limits are of normal and lognormal; leave them out")
        limits = _pair(f"{words} limits", given["limits"])
        _require_order(f"{words} limits", limits)
        made = cls(kind, values, limits)
        if not np.diff(made._shares)[0] > 1e-12:
            raise OutOfRange(f"{words} limits", list(limits), "limits that hold some of its values")
        return made

    @property
    def is_listed(self) -> bool:
        """Whether the values are listed."""
        return self.kind in ("grid", "choice")

    @property
    def is_number(self) -> bool:
        """Whether all values are numbers."""
        return all(isinstance(value, int | float) for value in self.values) and not any(
            isinstance(value, bool) for value in self.values
        )

    @property
    def typical(self) -> list:
        """Values that a camera must accept: those listed, both ends of a range, or the middle."""
        if self.is_listed:
            return list(self.values)
        return [*self.values] if "uniform" in self.kind else [self.at(0.5)]

    def at(self, share: float) -> Any:
        """Return the value below which a share of all values lies, 0 < share < 1."""
        if self.is_listed:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        low, high = self.values
        if self.kind == "uniform":
            return low + share * (high - low)
        if self.kind == "loguniform":
            return math.exp(math.log(low) + share * math.log(high / low))
        first, last = self._shares
        if not high:
            found = 0.0
        else:
            # an end of the normal distribution is infinite
            inside = min(max(first + share * (last - first), 1e-300), 1 - 2**-53)
            found = high * NormalDist().inv_cdf(inside)
        value = low + found if self.kind == "normal" else low * math.exp(found)
        return min(max(value, self.limits[0]), self.limits[1])

    @cached_property
    def _shares(self) -> tuple[float, float]:
        """Shares of the values of a normal distribution below its limits."""
        low, spread = self.values
        found = []
        for limit in self.limits:
            if math.isinf(limit):
                found.append(float(limit > 0))
                continue
            if self.kind == "lognormal":
                limit = math.log(limit / low) if limit > 0 else -math.inf
            else:
                limit = limit - low
            found.append(NormalDist().cdf(limit / spread) if spread else float(limit >= 0))
        return found[0], found[1]


def _values(words, kind, given) -> tuple:
    """Return the numbers or values of a distribution, checked."""
    if kind in ("grid", "choice"):
        if not isinstance(given, list | tuple) or not given:
            raise BadData(f"{words} {kind} = {format_value(given)}: wanted a list of {KINDS[kind]}")
        if kind == "grid":
            return tuple(_number(f"{words} grid", value) for value in given)
        return tuple(given)
    low, high = _pair(f"{words} {kind}", given, KINDS[kind])
    if kind in ("uniform", "loguniform"):
        _require_order(f"{words} {kind}", (low, high))
    elif not high >= 0:
        raise OutOfRange(f"{words} {kind}", list(given), f"[{KINDS[kind]}], deviation 0 or more")
    if kind in ("loguniform", "lognormal") and not low > 0:
        raise OutOfRange(f"{words} {kind}", list(given), f"[{KINDS[kind]}]")
    return low, high


def _number(words, value) -> float:
    """Return a finite number, whole ones as they are."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise BadData(f"{words}: {format_value(value)}, wanted a number")
    return value


def _pair(words, given, names="low, high") -> tuple[float, float]:
    """Return two numbers. Raises BadData."""
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise BadData(f"{words} = {format_value(given)}: wanted [{names}]")
    return float(_number(words, given[0])), float(_number(words, given[1]))


def _require_order(words, ends):
    if not ends[0] < ends[1]:
        raise OutOfRange(words, [*ends], "low < high")


@dataclass(frozen=True)
class Sampling:
    """The way to choose the values of the varied keys of each camera.

    Args:
        method: One of METHODS.
        count: Cameras of "latin" and "montecarlo"; values of each key of "one-at-a-time".
        seed: Seed of "latin" and "montecarlo".
        keys: The varied keys and their distributions.
    """

    method: str
    count: int
    seed: int
    keys: Mapping[str, Distribution] = field(default_factory=dict)

    __repr__ = short_repr

    @classmethod
    def parse(cls, given: Any, keys: Mapping[str, Distribution]) -> "Sampling":
        """Return the sampling of a study file: {method = "latin", count = 1000, seed = 1}.

        Raises BadData, OutOfRange, UnknownName.
        """
        if not isinstance(given, Mapping) or "method" not in given:
            raise BadData(
                f"sampling = {format_value(given)}: wanted a table, such as "
                '{method = "latin", count = 100, seed = 1}'
            )
        for name in given:
            if name not in ("method", "count", "seed"):
                raise UnknownName("key of sampling", name, ("method", "count", "seed"))
        method = given["method"]
        if method not in METHODS:
            raise UnknownName("method of sampling", str(method), METHODS)
        seed = checked_count("sampling seed", given.get("seed", 0), 0, 2**63)
        if method == "grid":
            own = [key for key, one in keys.items() if not one.is_listed]
            if own or "count" in given:
                raise BadData(
                    "sampling: a grid has all combinations of listed values; "
                    + (f'list those of "{own[0]}" as grid or choice' if own else "leave count out")
                )
            count = math.prod(len(one.values) for one in keys.values())
            if count > MOST:
                raise OutOfRange("cameras of the grid", count, f"up to {MOST}")
            return cls(method, count, seed, keys)
        if method in RANDOM and "count" not in given:
            raise BadData(f"sampling: {method} needs count, the number of cameras")
        least, most = (1, MOST) if method in RANDOM else (2, 1000)
        count = checked_count("sampling count", given.get("count", STEPS), least, most)
        return cls(method, count, seed, keys)

    @property
    def is_random(self) -> bool:
        """Whether the cameras are a random sample of all cameras."""
        return self.method in RANDOM

    def __len__(self):
        if self.method == "one-at-a-time":
            return len(self._alone)
        return self.count

    def draw(self, camera: int) -> dict[str, Any]:
        """Return the values of a camera, which depend only on its number."""
        if self.method == "grid":
            return dict(zip(self.keys, self._grid(camera), strict=True))
        if self.method == "one-at-a-time":
            key, value = self._alone[camera]
            middle = {name: one.at(0.5) for name, one in self.keys.items()}
            return middle if key is None else middle | {key: value}
        shares = self._shares[camera]
        return {
            key: one.at(float(share))
            for (key, one), share in zip(self.keys.items(), shares, strict=True)
        }

    def _grid(self, camera):
        """Return one combination. The last key changes from camera to camera."""
        found = []
        for one in reversed(self.keys.values()):
            camera, place = divmod(camera, len(one.values))
            found.append(one.values[place])
        return found[::-1]

    @cached_property
    def _alone(self) -> list[tuple[str | None, Any]]:
        """The middle of all keys, then each key's values with the others in the middle."""
        found: list[tuple[str | None, Any]] = [(None, None)]
        for key, one in self.keys.items():
            shares = np.linspace(LOW, HIGH, self.count)
            values = one.values if one.is_listed else [one.at(float(share)) for share in shares]
            found += product([key], values)
        return found

    @cached_property
    def _shares(self) -> np.ndarray:
        """Shares between 0 and 1 of all cameras and keys, (count, keys)."""
        found = np.empty((self.count, len(self.keys)))
        for place in range(len(self.keys)):
            random = np.random.Generator(np.random.Philox(key=[self.seed, place]))
            inside = random.random(self.count)
            if self.method == "latin":  # one camera in each of `count` equal shares
                inside = (random.permutation(self.count) + inside) / self.count
            found[:, place] = inside
        return np.clip(found, 2**-60, 1 - 2**-53)
