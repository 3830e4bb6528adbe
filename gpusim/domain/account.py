"""The error that a frame may have, the errors of a plan by cause, and the verdict on them."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from math import hypot, inf, isfinite
from numbers import Real
from typing import Any

from gpusim.domain.errors import OutOfRange, UnknownName, format_value


@dataclass(frozen=True)
class Tolerance:
    """Limits on the error of the mean electrons. None means no limit.

    Args:
        rms: Root mean square error, relative to the root mean square of the frame [1].
        p999_sigma: 99.9 % quantile over the pixels of |error| / noise sigma of the pixel [1].
        max_sigma: Maximum over the pixels of |error| / noise sigma of the pixel [1].

    Raises:
        OutOfRange: A limit is not positive and finite, or there is none.
    """

    rms: float | None = None
    p999_sigma: float | None = None
    max_sigma: float | None = None

    def __post_init__(self):
        bounds = {"rms": self.rms, "p999_sigma": self.p999_sigma, "max_sigma": self.max_sigma}
        for key, value in bounds.items():
            if value is not None and not (isinstance(value, Real) and 0 < value < float("inf")):
                raise OutOfRange(f"tolerance.{key}", format_value(value), f"0 < {key} < inf")
        if all(value is None for value in bounds.values()):
            raise OutOfRange("tolerance", "none", "at least one of rms, p999_sigma, max_sigma")

    @classmethod
    def parse(cls, text: "str | float | Tolerance") -> "Tolerance":
        """Read a tolerance from text.

        Args:
            text: Name of a preset ("preview", "video", "metrology"), a relative RMS error like
                "1e-4", or a Tolerance.

        Returns:
            The tolerance.

        Raises:
            OutOfRange: The number is not positive and finite.
            UnknownName: The text is neither a preset nor a number.
        """
        if isinstance(text, Tolerance):
            return text
        if text in PRESETS:
            return PRESETS[text]
        try:
            return cls(rms=float(text))
        except ValueError:
            raise UnknownName(
                "tolerance (a preset or a relative RMS error)", str(text), PRESETS
            ) from None


PRESETS = {
    "preview": Tolerance(p999_sigma=0.5),
    "video": Tolerance(p999_sigma=0.1),
    "metrology": Tolerance(max_sigma=0.01),
}


SAMPLING = "spectral sampling"  # name of an error that the reference of a true error shares

# Factor on predicted errors: with it "met" was true in 119 of 119 random frames
# (bench/README.md, Triples).
SAFETY = 1.5


@dataclass(frozen=True)
class Bound:
    """Error of the mean electrons that one cause adds.

    Attributes:
        rms: Root mean square error, relative to the root mean square of the frame [1].
        p999_sigma: 99.9 % quantile over the pixels of |error| / noise sigma of the pixel [1].
        max_sigma: Maximum over the pixels of |error| / noise sigma of the pixel [1].
    """

    rms: float = 0.0
    p999_sigma: float = 0.0
    max_sigma: float = 0.0

    @property
    def is_known(self) -> bool:
        """True if all three figures are finite; for UNKNOWN they are not."""
        return all(map(isfinite, self.figures))

    @property
    def figures(self) -> tuple[float, float, float]:
        """The three figures."""
        return self.rms, self.p999_sigma, self.max_sigma

    def as_dict(self) -> dict[str, float | None]:
        """Return plain data for JSON. Unknown figures become None, because JSON has no infinity."""
        return {name: value if isfinite(value) else None for name, value in asdict(self).items()}

    def times(self, factor: float) -> "Bound":
        """Return the error of a cause that is `factor` times as strong."""
        return Bound(self.rms * factor, self.p999_sigma * factor, self.max_sigma * factor)

    def largest(self, other: "Bound") -> "Bound":
        """Return the larger of each figure of two errors."""
        return Bound(*map(max, self.figures, other.figures))

    def ratio(self, tolerance: Tolerance) -> float:
        """Return error over tolerance for the figure closest to, or farthest beyond, its limit."""
        return self.nearest(tolerance)[0]

    def nearest(self, tolerance: Tolerance) -> tuple[float, str, float, float, str]:
        """Find the figure closest to its limit, or farthest beyond it.

        Args:
            tolerance: Limits; a figure whose limit is None does not count.

        Returns:
            Error over tolerance, name of the figure, its error, its tolerance, and its unit as
            text.
        """
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


# Bound of a cause whose error cannot be predicted. With it, no verdict is "met".
UNKNOWN = Bound(inf, inf, inf)


def total(bounds: Iterable[Bound]) -> Bound:
    """Add the known errors of independent causes in quadrature.

    Quadrature also serves for the maxima: they seldom fall on one pixel.
    """
    known = [bound.figures for bound in bounds if bound.is_known]
    if not known:
        return Bound()
    return Bound(*(hypot(*figures) for figures in zip(*known, strict=True)))


@dataclass(frozen=True)
class Account:
    """Named errors of the mean electrons, predicted for the scene as sampled.

    Attributes:
        bounds: Name and error of each cause.
        seconds: Exposure time that the errors are predicted for [s]. The RMS does not depend on it.
        doubt: Reason why the errors are too uncertain for the verdict "met", or "".
    """

    bounds: dict[str, Bound] = field(default_factory=dict)
    seconds: float = 1.0
    doubt: str = ""

    def __repr__(self):
        return f"Account(rms {self.total.rms:.2g} in all, of {len(self.bounds)} causes, {1e3 * self.seconds:.4g} ms)"

    @property
    def total(self) -> Bound:
        """All known errors, added in quadrature."""
        return total(self.bounds.values())

    def at(self, seconds: float) -> "Account":
        """Return the account for another exposure time.

        The RMS stays. With r times the light the error is r times as large, while the noise sigma
        grows by a factor between 1 and r^(1/2). Errors in sigma therefore grow by at most r, and
        shrink by at least r^(1/2).

        Args:
            seconds: Exposure time [s].

        Returns:
            The account for that time.
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
        """Names of the causes without a known error, and the doubt."""
        names = tuple(name for name, bound in self.bounds.items() if not bound.is_known)
        return (*names, self.doubt) if self.doubt else names

    def by_cause(self, tolerance: Tolerance | None) -> tuple[str, dict[str, float]]:
        """Return the known errors by cause, in the figure that is closest to its limit.

        Args:
            tolerance: Limits on the errors; None: the figure is the RMS.

        Returns:
            Name of the figure ("rms", "p999_sigma" or "max_sigma"), and its value for each cause
            that has one above 0, and for "all together".
        """
        _, name, *_ = self.total.nearest(tolerance or Tolerance(rms=1.0))
        errors = {cause: getattr(bound, name) for cause, bound in self.bounds.items()}
        errors = {cause: value for cause, value in errors.items() if 0 < value < inf}
        return name, errors | {"all together": getattr(self.total, name)}

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "bounds": {name: bound.as_dict() for name, bound in self.bounds.items()},
            "seconds": self.seconds,
            "doubt": self.doubt,
        }

    def verdict(self, tolerance: Tolerance, remedy: str = "") -> "Verdict":
        """Judge from the predicted errors whether the tolerance is met.

        "not met" if the known errors exceed it. "met" if they do not and every cause is known.
        Otherwise "not judged".

        Args:
            tolerance: Limits on the errors.
            remedy: Advice for meeting the tolerance, used if it is not met.

        Returns:
            The verdict with its figures.
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


# States of a verdict as reports write them.
SHOWN = {
    "met": "met",
    "not met": "NOT met",
    "not judged": "cannot be judged",
}
STATUS = {"met": 0, "not met": 1, "not judged": 3}  # exit statuses of commands


@dataclass(frozen=True)
class Verdict:
    """Result of comparing the errors of a plan with a tolerance.

    Attributes:
        state: "met", "not met", or "not judged" if the known errors are within the tolerance but
            others are unknown.
        words: The figures.
        by: The cause of most of the error.
        remedy: Advice for meeting the tolerance, "" if it is met.
        unknown: Names of the causes whose errors are unknown.
    """

    state: str
    words: str
    by: str
    remedy: str = ""
    unknown: tuple[str, ...] = ()

    @property
    def is_met(self) -> bool:
        """True if the state is "met"."""
        return self.state == "met"

    @property
    def shown(self) -> str:
        """The state as reports write it."""
        return SHOWN[self.state]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self) | {"met": self.is_met}

    def __str__(self):
        cause = f"{'; '.join(self.unknown)}; the known errors are " if self.unknown else ""
        return f"{self.shown}: {cause}{self.words}{self.remedy and f'; {self.remedy}'}"


def worst_state(states: Iterable[str]) -> str:
    """Return the worst of several verdict states: "not met", then "not judged", then "met"."""
    return max(states, key=("met", "not judged", "not met").index, default="met")
