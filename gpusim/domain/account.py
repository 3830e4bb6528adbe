"""Errors of a plan, cause by cause, and the verdict: whether they are within a tolerance."""

from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass, field
from math import hypot, inf, isfinite
from typing import Any

from gpusim.domain.tolerance import Tolerance

SAFETY = 1.5  # over what is predicted: with it "met" was true in 119 of 119 random frames (bench/README.md, Triples)


@dataclass(frozen=True)
class Bound:
    """Error of the mean electrons by one cause.

    rms: root mean square over that of the frame [1]. p999_sigma, max_sigma: 99.9 % quantile and maximum over the pixels
    of |error| over the pixel's own noise sigma [1].
    """

    rms: float = 0.0
    p999_sigma: float = 0.0
    max_sigma: float = 0.0

    @property
    def is_known(self) -> bool:
        """Whether all figures are finite; those of UNKNOWN are not."""
        return all(map(isfinite, astuple(self)))

    def as_dict(self) -> dict[str, float | None]:
        """Plain data, for JSON, which has no infinity: figures that nobody knows are None."""
        return {name: value if isfinite(value) else None for name, value in asdict(self).items()}

    def times(self, factor: float) -> "Bound":
        """The error of a cause that is `factor` times as strong."""
        return Bound(self.rms * factor, self.p999_sigma * factor, self.max_sigma * factor)

    def ratio(self, tolerance: Tolerance) -> float:
        """Error over tolerance, of the figure that is nearest to being broken or farthest beyond."""
        return self.nearest(tolerance)[0]

    def nearest(self, tolerance: Tolerance) -> tuple[float, str, float, float, str]:
        """Error over tolerance, name of the figure, its error, its tolerance and their unit: of the one nearest."""
        figures = (
            (self.rms, tolerance.rms, "rms", " rms"),
            (self.p999_sigma, tolerance.p999_sigma, "p999_sigma", " sigma at 99.9 %"),
            (self.max_sigma, tolerance.max_sigma, "max_sigma", " sigma"),
        )
        return max(
            (value / bound, name, value, bound, unit)
            for value, bound, name, unit in figures
            if bound is not None
        )


UNKNOWN = Bound(
    inf, inf, inf
)  # of a cause whose error nobody can tell: with it no tolerance is called met


def total(bounds: Iterable[Bound]) -> Bound:
    """The known errors of several causes together, which are independent: their largest are seldom at one pixel."""
    bounds = [bound for bound in bounds if bound.is_known]
    return (
        Bound(*(hypot(*figures) for figures in zip(*map(astuple, bounds), strict=True)))
        if bounds
        else Bound()
    )


@dataclass(frozen=True)
class Account:
    """Named errors of the mean electrons, predicted for the scene as sampled.

    seconds: exposure time that they are predicted for [s]. The root mean square does not depend on it. doubt: why they
    are not sure enough for a tolerance to be called met, "" where they are.
    """

    bounds: dict[str, Bound] = field(default_factory=dict)
    seconds: float = 1.0
    doubt: str = ""

    def __repr__(self):
        return f"Account(rms {self.total.rms:.2g} in all, of {len(self.bounds)} causes, {1e3 * self.seconds:.4g} ms)"

    @property
    def total(self) -> Bound:
        """All together."""
        return total(self.bounds.values())

    def at(self, seconds: float) -> "Account":
        """The same at another exposure time [s]: sigmas grow no more than with the time, and shrink as shot noise.

        Twice the light is twice the error, and a sigma that is at least as large and at most 2^(1/2) times.
        """
        ratio = seconds / self.seconds
        factor = ratio if ratio > 1 else ratio**0.5
        return Account(
            {
                name: Bound(one.rms, one.p999_sigma * factor, one.max_sigma * factor)
                for name, one in self.bounds.items()
            },
            seconds,
            self.doubt,
        )

    @property
    def unknown(self) -> tuple[str, ...]:
        """Causes whose errors nobody can tell, and the doubt."""
        names = tuple(name for name, bound in self.bounds.items() if not bound.is_known)
        return (*names, self.doubt) if self.doubt else names

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {
            "bounds": {name: bound.as_dict() for name, bound in self.bounds.items()},
            "seconds": self.seconds,
            "doubt": self.doubt,
        }

    def verdict(self, tolerance: Tolerance, remedy: str = "") -> "Verdict":
        """Whether the tolerance is met, by what is predicted.

        remedy: what would meet it, if it is not. It is not met if the known errors break it. It is met if they do not,
        and every cause is known. Else it cannot be judged.
        """
        ratio, figure, value, bound, unit = self.total.nearest(tolerance)
        shares = {name: getattr(one, figure) for name, one in self.bounds.items() if one.is_known}
        keeps, by = SAFETY * ratio <= 1, max(shares, key=lambda name: shares[name], default="")
        words = f"{value:.2g} of {bound:.2g}{unit}, predicted"
        if not keeps:
            words += f" (times {SAFETY:g} to be sure), most of it {by}: {shares[by]:.2g}"
            return Verdict("not met", words, by, remedy)
        if self.unknown:
            return Verdict("not judged", words, self.unknown[0], unknown=self.unknown)
        return Verdict("met", words, by)


SHOWN = {
    "met": "met",
    "not met": "NOT met",
    "not judged": "cannot be judged",
}  # states of a verdict, in reports
STATUS = {"met": 0, "not met": 1, "not judged": 3}  # exit statuses of commands


@dataclass(frozen=True)
class Verdict:
    """Whether a tolerance is met.

    state: "met", "not met" or "not judged": the known errors are within the tolerance, but there are unknown ones.
    words: the figures. by: the cause of most of the error. remedy: what would meet it, "" if it is met. unknown: causes
    whose errors nobody can tell.
    """

    state: str
    words: str
    by: str
    remedy: str = ""
    unknown: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """Whether the state is "met"."""
        return self.state == "met"

    @property
    def shown(self) -> str:
        """The state as reports show it."""
        return SHOWN[self.state]

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return asdict(self) | {"met": self.met}

    def __str__(self):
        cause = f"{'; '.join(self.unknown)}; the known errors are " if self.unknown else ""
        return f"{self.shown}: {cause}{self.words}{self.remedy and f'; {self.remedy}'}"


def worst_state(states: Iterable[str]) -> str:
    """The worst of several verdicts' states: "not met" before "not judged" before "met"."""
    return max(states, key=("met", "not judged", "not met").index, default="met")
