"""Summary of a plan before any frame: its models, predicted errors and cost: `gpusim plan`."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from gpusim.domain.account import Tolerance
from gpusim.domain.scene import Scene
from gpusim.judge.speeds import Speeds, frame_ms
from gpusim.optics.lengths import Tiling
from gpusim.pipeline.report_text import write_account
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Blur, Fusion, Planes
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.plan import Plan
from gpusim.planner.search import Candidate

BAR = 30  # letters of the longest bar


@dataclass(frozen=True, eq=False)
class Forecast:
    """A plan, and the predicted time of its frames on a device.

    Attributes:
        plan: The plan.
        device: Name of the device.
        ms: Predicted time of every stage of a frame after the first [ms].
        front: Alternatives that are cheaper or more accurate, each with its time per frame on the
            device [ms], fastest first.
    """

    plan: Plan
    device: str
    ms: dict[str, float]
    front: tuple[tuple[float, Candidate], ...]

    @classmethod
    def of(cls, simulator: Simulator, scene: Scene) -> "Forecast":
        """Return the forecast for a scene.

        Args:
            simulator: Camera, device and tolerance.
            scene: The scene.

        Raises:
            GpusimError: As `Simulator.plan` does.
        """
        plan, speeds = simulator.plan(scene), Speeds(simulator.device)
        front = [
            (sum(frame_ms(simulator, _vary_plan(plan, option), speeds).values()), option)
            for option in plan.front
        ]
        front.sort(key=lambda one: one[0])
        ms = frame_ms(simulator, plan, speeds)
        return cls(plan, simulator.device.name, ms, tuple(front))

    @property
    def _tolerance(self) -> Tolerance:
        return self.plan.tolerance or Tolerance(rms=1.0)

    def as_dict(self) -> dict:
        """Return plain data for JSON."""
        plan = self.plan
        return {
            "plan": plan.name,
            "scene": plan.scene.name,
            "camera": plan.camera.name,
            "device": self.device,
            "models": plan.models,
            "left_out": plan.left_out,
            "bounds": {name: bound.as_dict() for name, bound in plan.account.bounds.items()},
            "predicted": plan.account.total.as_dict(),
            "beside": plan.beside,
            "tolerance": plan.tolerance and asdict(plan.tolerance),
            "verdict": plan.verdict and plan.verdict.as_dict(),
            "ms": self.ms,
            "frame_ms": sum(self.ms.values()),
            "bytes": plan.bytes_needed,
            "front": [{"ms": ms, **option.as_dict()} for ms, option in self.front],
        }

    def __str__(self):
        plan, rows = self.plan, self.plan.scene.shape[0]
        lines = [
            write_account(plan.account) if plan.verdict is None else f"tolerance {plan.verdict}",
            f"{plan.scene.name} {plan.scene.shape[1]}x{rows} by {plan.camera.name} on {self.device}: about "
            f"{sum(self.ms.values()):.3g} ms a frame, {plan.bytes_needed / 2**20:.0f} MiB, predicted",
        ]
        lines += [
            f"  {stage:22s} {self.ms.get(stage, 0.0):9.3f} ms  {plan.models.get(stage, '')}".rstrip()
            for stage in [*plan.models, *(stage for stage in self.ms if stage not in plan.models)]
        ]
        lines.append(f"  plan: {plan.name}")
        lines += [f"  not modelled: {what}" for what in plan.left_out]
        lines += self._errors()
        lines += [f"  not in the total: {name} {value:.2g}" for name, value in plan.beside.items()]
        for ms, option in self.front:
            _, _, value, _, unit = option.error.nearest(self._tolerance)
            chosen = (
                " (chosen)"
                if option.words in " ".join(plan.models.values())
                and (
                    (option.period, option.tiling) == (plan.period, plan.find(Tiling))
                    and (option.far is None) is (plan.find(FarField) is None)
                )
                else ""
            )
            lines.append(
                f"  {ms:9.3f} ms  {value:8.2g}{unit}  {option.words}, {option.surroundings}{chosen}"
            )
        return "\n".join(lines)

    def _errors(self):
        """Return one line with a bar per error, in the figure that is closest to the tolerance."""
        bounds = self.plan.account.bounds
        _, figure, *_, unit = self.plan.account.total.nearest(self._tolerance)
        values = {name: getattr(bound, figure) for name, bound in bounds.items() if bound.is_known}
        values["all together"] = getattr(self.plan.account.total, figure)
        most = max(values.values()) or 1.0
        return [
            f"  error: {name:22s} {value:8.2g}{unit}  {'#' * int(np.ceil(BAR * value / most))}"
            for name, value in values.items()
        ] + [
            f"  error: {name:22s} not known" for name, bound in bounds.items() if not bound.is_known
        ]


def _vary_plan(plan, option):
    """Return the plan with the cost-relevant fields of another option."""
    count, channels = option.planes, len(plan.weights)
    is_made = count != len(plan.content.entry_spectra) or plan.content.labels is not None
    choices = (
        replace(plan.find(Blur), period=option.period, mix=np.empty((channels, count))),
        Fusion(np.empty((channels, count, 0))),
        option.tiling,
        option.far,
        Planes(np.empty((count, 0))) if is_made else None,
    )
    return plan.exchange(
        *(choice for choice in choices if choice is not None), without=(Tiling, FarField, Planes)
    )
