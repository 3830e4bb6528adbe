"""The report of a frame: its cost, its models and its errors."""

from dataclasses import asdict, dataclass, field, replace
from math import hypot

import numpy as np

from gpusim.domain.account import SAMPLING, Account, Bound, Tolerance, Verdict
from gpusim.domain.labels import Tabled
from gpusim.domain.short_repr import shorten_repr
from gpusim.pipeline.report_text import write_table, write_words


@dataclass(frozen=True)
class Error:
    """True error of the mean electrons against the float64 reference.

    Attributes:
        rms: RMS error over the RMS of the reference [1].
        max_local: Largest |error| / max(reference, 1 e-) [1].
        p999_sigma: 99.9 % quantile of |error| over the pixel's noise sigma [1].
        max_sigma: Maximum of |error| over the pixel's noise sigma [1].
        places: The compared pixels in words; "" means all.
    """

    rms: float
    max_local: float
    p999_sigma: float
    max_sigma: float
    places: str = ""

    @classmethod
    def between(cls, mean: np.ndarray, reference: np.ndarray, read_noise: float) -> "Error":
        """Compare two images of mean electrons. sigma^2 is reference + read_noise^2, at least 1 e-^2.

        Args:
            mean: Mean electrons [e-].
            reference: True mean electrons, same shape [e-].
            read_noise: Standard deviation of the read noise [e-].

        Returns:
            The error.
        """
        reference = np.asarray(reference, np.float64)
        difference = np.abs(mean - reference)
        sigma = difference / np.sqrt(np.maximum(reference + read_noise**2, 1.0))
        size = np.sqrt(np.mean(reference**2))
        return cls(
            float(np.sqrt(np.mean(difference**2)) / size) if size else float(difference.max() > 0),
            float((difference / np.maximum(reference, 1.0)).max()),
            float(np.quantile(sigma, 0.999)),
            float(sigma.max()),
        )

    def with_bound(self, bound: Bound | None) -> "Error":
        """Return the error together with one that the reference shares, in quadrature."""
        if bound is None:
            return self
        return replace(
            self,
            rms=hypot(self.rms, bound.rms),
            p999_sigma=hypot(self.p999_sigma, bound.p999_sigma),
            max_sigma=hypot(self.max_sigma, bound.max_sigma),
        )

    def meets(self, tolerance: Tolerance) -> bool:
        """Return True if the error is within all bounds of a tolerance.

        Args:
            tolerance: The tolerance.

        Returns:
            True or False.
        """
        return self.nearest(tolerance)[0] <= 1

    def nearest(self, tolerance: Tolerance) -> tuple[float, str]:
        """Return the bound with the largest ratio of error to bound.

        Args:
            tolerance: The tolerance.

        Returns:
            The ratio, and error and bound in words.
        """
        bounds = (
            (self.rms, tolerance.rms, "rms"),
            (self.p999_sigma, tolerance.p999_sigma, "sigma at 99.9 %"),
            (self.max_sigma, tolerance.max_sigma, "sigma"),
        )
        return max(
            (value / bound, f"{value:.2g} of {bound:.2g} {unit}")
            for value, bound, unit in bounds
            if bound is not None
        )


@dataclass(frozen=True)
class StageReport:
    """One stage of one frame.

    Attributes:
        stage: Name of the stage.
        model: Its model in words.
        ms: Milliseconds; 0 if the result of an earlier frame was reused.
    """

    stage: str
    model: str
    ms: float


@dataclass(frozen=True)
class Report(Tabled):
    """The report of one frame: its settings, times, models and errors.

    Attributes:
        scene: Properties of the scene.
        camera: Settings of the camera.
        device: Name and kind of the device.
        frame: Number of the frame.
        seed: Seed of the noise.
        stages: The stages, in the order of the light.
        account: Predicted errors of the scene as sampled.
        beside: Predicted errors that are not in the account, for example of the scene's sampling.
        left_out: Effects that were not modelled.
        error: True error, if it was requested.
        tolerance: The tolerance, if there is one.
        notes: Further notes.
        verdict: Whether the predicted errors meet the tolerance.
        wall_ms: Milliseconds from the scene to the picture, with planning, waiting and copying.
        plan: Name of the plan.
    """

    scene: dict
    camera: dict
    device: dict
    frame: int
    seed: int
    stages: list[StageReport]
    account: Account
    beside: dict
    left_out: list[str]
    error: Error | None = None
    tolerance: Tolerance | None = None
    notes: list[str] = field(default_factory=list)
    verdict: Verdict | None = None
    wall_ms: float = 0.0
    plan: str = ""

    @property
    def ms(self) -> float:
        """Milliseconds of all stages."""
        return sum(stage.ms for stage in self.stages)

    @property
    def meets_tolerance(self) -> bool | None:
        """True if the true error is within the tolerance; None unless both are known.

        The reference shares the scene's samples: the error of what lies between them is added.
        """
        if self.judged_error is None or self.tolerance is None:
            return None
        return self.judged_error.meets(self.tolerance)

    @property
    def judged_error(self) -> Error | None:
        """The true error, with the error that its reference shares; None if it is not known."""
        return self.error and self.error.with_bound(self.account.bounds.get(SAMPLING))

    @property
    def prediction_ratio(self) -> float | None:
        """Predicted over true relative RMS error; None unless both are known and not 0."""
        predicted = self.account.total.rms
        return predicted / self.error.rms if predicted and self.error and self.error.rms else None

    def as_dict(self) -> dict:
        """Return the report as plain data for JSON.

        Returns:
            A dictionary.
        """
        return asdict(self) | {
            "account": self.account.as_dict(),
            "ms": self.ms,
            "meets_tolerance": self.meets_tolerance,
            "prediction_ratio": self.prediction_ratio,
            "predicted": self.account.total.as_dict(),
            "verdict": self.verdict and self.verdict.as_dict(),
        }

    @property
    def errors(self) -> list[tuple[str, Bound]]:
        """Name and bound of each predicted error, and the total of the known ones."""
        bounds = self.account.bounds
        last = (
            "all together"
            if all(bound.is_known for bound in bounds.values())
            else "all known together"
        )
        return [*bounds.items(), (last, self.account.total)]

    def __repr__(self):
        named = f"{self.scene['name']} {self.scene['cols']}x{self.scene['rows']} by {self.camera['name']}"
        verdict = "" if self.verdict is None else f", tolerance {self.verdict.shown}"
        return shorten_repr(
            f"Report({named} on {self.device['name']}, {1e3 * self.camera['exposure_time_s']:.4g} ms, "
            f"frame {self.frame}, predicted rms {self.account.total.rms:.2g}{verdict})"
        )

    def __str__(self):
        return write_words(self)

    def table(self) -> str:
        """Return the report as a table: a line for each stage, error, effect left out and note.

        Returns:
            The text; its first line is the verdict, as in `str(report)`.
        """
        return write_table(self)
