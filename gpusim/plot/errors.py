"""Errors of frames, and the time and error of a plan or frame by cause."""

from typing import Any

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene, checked_scene
from gpusim.judge.plan_summary import Forecast
from gpusim.judge.truth import mean_and_truth, require_truth
from gpusim.pipeline.report import Error, Report
from gpusim.pipeline.simulator import Simulator
from gpusim.plot.canvas import BAR, CHANNELS, QUIET, axes_of, error_map, panels, picture_size

HIGH = 99.9  # percentile of |error| at full colour
UNITS = {
    "rms": "relative rms error of the mean electrons",
    "p999_sigma": "error / noise sigma, 99.9 % of pixels",
    "max_sigma": "error / noise sigma, largest",
}


def error(simulator: Simulator, scene: Scene, ax: Any = None) -> Any:
    """Plot a map of a simulator's error against the float64 reference.

    The error is the difference of the mean electrons over each pixel's noise. For stacked pixels
    the layer with the largest error is shown.

    Args:
        simulator: simulator to judge.
        scene: scene to simulate.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or the blur varies over a frame too large for
            the reference.
        Missing: if matplotlib is not installed.
        GpusimError: as raised by `Simulator.expose`.
    """
    if not isinstance(simulator, Simulator):
        raise BadData(f"error: {type(simulator).__name__}, wanted a Simulator")
    require_truth(simulator.camera, checked_scene(scene))
    mean, truth = mean_and_truth(simulator, scene, simulator.expose(scene))
    if mean.ndim == 1:
        raise BadData(
            f"error: the blur varies over a frame of {scene.shape[1]}x{scene.shape[0]} pixels; the "
            "reference computes only parts of it; wanted a smaller scene"
        )
    read = simulator.camera.sensor.read_sigma
    sigma = (mean - truth) / np.sqrt(np.maximum(truth + read**2, 1.0))
    whole = Error.between(mean, truth, read)
    if sigma.ndim == 3:
        sigma = sigma[np.abs(sigma).max(axis=(1, 2)).argmax()]
    most = max(float(np.percentile(np.abs(sigma), HIGH)), 1e-12)
    words = f"rms {whole.rms:.2g}, largest {whole.max_sigma:.2g} sigma"
    if simulator.tolerance is not None:
        words = f"{whole.nearest(simulator.tolerance)[1]} allowed"
    return error_map(
        axes_of(ax, picture_size(sigma.shape, BAR)),
        sigma,
        f"{scene.name} by {simulator.camera.name}: error {words}",
        "error / sigma of the pixel's noise",
        cmap="RdBu_r",
        vmin=-most,
        vmax=most,
    )


def plan(what: Forecast | Report, figure: Any = None) -> Any:
    """Plot the time of every stage and the error of every cause of a plan or frame.

    The error shown is the one closest to its tolerance.

    Args:
        what: a Forecast, as printed by `gpusim plan`
            (`gpusim.judge.plan_summary.Forecast.of(simulator, scene)`), or a frame's Report.
        figure: matplotlib figure; None makes a new one.

    Returns:
        The figure.

    Raises:
        BadData: if `what` is neither a Forecast nor a Report.
        Missing: if matplotlib is not installed.
    """
    if isinstance(what, Forecast):
        account, tolerance, ms = what.plan.account, what.plan.tolerance, what.ms
        verdict = what.plan.verdict
        title = f"{what.plan.scene.name} by {what.plan.camera.name} on {what.device}: "
        title += f"about {sum(ms.values()):.3g} ms a frame, predicted"
    elif isinstance(what, Report):
        account, tolerance, verdict = what.account, what.tolerance, what.verdict
        ms = {stage.stage: stage.ms for stage in what.stages}
        title = (
            f"{what.scene['name']} by {what.camera['name']} on {what.device['name']}: {what.ms:.3g} ms of "
            f"{what.wall_ms:.3g} ms"
        )
    else:
        raise BadData(f"plan: {type(what).__name__}, wanted a Forecast or a frame's Report")
    name, errors = account.by_cause(tolerance)
    ms = {stage: value for stage, value in ms.items() if value > 0}
    height = 1.6 + 0.3 * max(len(ms), len(errors) + 1)
    figure, axes = panels(figure, 1, 2, (12.0, height))
    _bars(axes[0, 0], ms, CHANNELS["B"], "time [ms]", "{:.3g}")
    bars = _bars(axes[0, 1], errors, CHANNELS["R"], UNITS[name], "{:.2g}")
    bars[-1].set_color("0.3")
    limit = None if tolerance is None else getattr(tolerance, name)
    if limit:
        axes[0, 1].axvline(limit, color=QUIET, linestyle="--", label=f"tolerance {limit:.2g}")
        axes[0, 1].legend(frameon=False, fontsize="small", loc="best")
        axes[0, 1].set_xlim(right=1.2 * max(limit, *errors.values()))
    if verdict is not None:
        title += f"; tolerance {verdict.shown}"
    figure.suptitle(title, fontsize="medium")
    return figure


def _bars(ax, values, color, label, form):
    """Draw horizontal bars from the top down, each with its value."""
    bars = ax.barh(range(len(values)), list(values.values()), color=color, height=0.7)
    ax.set_yticks(range(len(values)), list(values))
    ax.invert_yaxis()
    ax.bar_label(
        bars, [form.format(value) for value in values.values()], padding=3, fontsize="small"
    )
    ax.set_xlim(right=1.18 * max(values.values(), default=0.0) or 1.0)
    ax.set_xlabel(label)
    ax.spines[["top", "right"]].set_visible(False)
    return bars
