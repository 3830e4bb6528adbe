"""The error that a frame may have."""

from dataclasses import dataclass
from numbers import Real

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
