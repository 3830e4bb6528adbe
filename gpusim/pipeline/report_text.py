"""A report as text: in words for a reader, or as a table of all stages and errors."""

from typing import TYPE_CHECKING

from gpusim.pipeline.causes import BESIDE, CAUSES, Cause

if TYPE_CHECKING:  # a report calls these functions
    from gpusim.domain.account import Account, Bound
    from gpusim.pipeline.report import Report

SLOWEST = 3  # stages named in the line of the time
SMALL = 0.1  # errors below this part of the largest are named without words
FIGURES = {"rms": "relative rms", "p999_sigma": "sigma at 99.9 %", "max_sigma": "sigma at worst"}
WITH_ERROR = (
    ", predicted",
    "its error is not known",
)  # ends of left-out effects that have a named error


def write_verdict(report: "Report") -> str:
    """Return one line: whether the tolerance is met, with the figures."""
    tolerance = report.tolerance
    if tolerance is None:
        return write_account(report.account)
    judged = report.judged_error
    predicted = "not judged: the plan is a draft"
    if report.verdict is not None:
        predicted = str(report.verdict)
    if judged is None:
        return f"tolerance {predicted}"
    predicted = predicted.replace(", predicted", "")  # the line has the word
    state = "met" if judged.meets(tolerance) else "NOT met"
    return f"tolerance {state}: true error {judged.nearest(tolerance)[1]}; predicted {predicted}"


def write_account(account: "Account") -> str:
    """Return one line: the predicted error of a frame without a tolerance, and its unknown parts."""
    known = {name: bound.rms for name, bound in account.bounds.items() if bound.is_known}
    by = max(known, key=lambda name: known[name], default="")
    words = f"no tolerance given: predicted error {account.total.rms:.2g} relative rms"
    if by:
        words += f", most of it {by}: {known[by]:.2g}"
    return f"{words}; not known: {'; '.join(account.unknown)}" if account.unknown else words


def write_heading(report: "Report") -> str:
    """Return one line: scene, camera, device and exposure."""
    scene, camera = report.scene, report.camera
    return (
        f"{scene['name']} {scene['cols']}x{scene['rows']} by {camera['name']} on "
        f"{report.device['name']}: exposure {1e3 * camera['exposure_time_s']:.4g} ms, ISO "
        f"{camera['iso']:.4g}, frame {report.frame}"
    )


def write_words(report: "Report") -> str:
    """Return the report in words: verdict, time, errors with their causes, notes."""
    lines = [write_verdict(report), f"  {write_heading(report)}", f"  {_write_time(report)}"]
    lines += _write_errors(report)
    if report.error:
        lines.append(f"  true error: {_write_figures(report.error)}")
    if report.beside:
        lines.append("  not in these errors:")
        lines += [
            _write_cause(name, f"{value:.2g} of the light", BESIDE)
            for name, value in report.beside.items()
        ]
    left = [effect for effect in report.left_out if not effect.endswith(WITH_ERROR)]
    if left:
        lines.append(f"  not modelled: {'; '.join(left)}")
    lines += [f"  note: {note}" for note in report.notes]
    return "\n".join(lines)


def _write_time(report):
    """Return the line of the time, with the slowest stages."""
    slowest = sorted(report.stages, key=lambda stage: -stage.ms)[:SLOWEST]
    named = ", ".join(f"{stage.stage} {stage.ms:.2f} ms" for stage in slowest if stage.ms > 0)
    words = (
        f"time: {report.ms:.2f} ms for the stages, {report.wall_ms:.2f} ms with planning and copies"
    )
    return f"{words}; slowest: {named}" if named else words


def _write_errors(report):
    """Return the lines of the predicted error: the sum, then its causes in words, largest first."""
    account = report.account
    figure = "rms" if report.tolerance is None else account.total.nearest(report.tolerance)[1]
    known = {
        name: getattr(bound, figure) for name, bound in account.bounds.items() if bound.is_known
    }
    most = max(known.values(), default=0.0)
    large = sorted((name for name in known if known[name] >= SMALL * most), key=known.__getitem__)
    lines = [f"  predicted error: {_write_figures(account.total)}"]
    lines += [
        _write_cause(name, f"{known[name]:.2g} {FIGURES[figure]}") for name in reversed(large)
    ]
    lines += [_write_cause(name, "not known") for name in account.bounds if name not in known]
    lines += [f"    not certain: {account.doubt}"] * bool(account.doubt)
    small = [name for name in known if name not in large]
    if small:
        lines.append(f"    smaller: {', '.join(f'{name} {known[name]:.2g}' for name in small)}")
    return lines


def _write_cause(name, size, known=CAUSES):
    """Return the line of a cause. size: its error in words. known: causes in words."""
    words: Cause | None = known.get(name)
    return f"    {name}, {size}: {words}" if words else f"    {name}, {size}"


def _write_figures(error):
    """Return the three figures of an error."""
    return (
        f"{error.rms:.2g} relative rms, {error.p999_sigma:.2g} sigma of a pixel's noise at 99.9 % of the pixels, "
        f"{error.max_sigma:.2g} at worst"
    )


def write_table(report: "Report") -> str:
    """Return the verdict, then a line for each stage, error, effect left out and note."""
    lines = [write_verdict(report), f"  {write_heading(report)}"]
    lines += [
        f"  {stage.stage:22s} {stage.ms:9.2f} ms  {stage.model}".rstrip() for stage in report.stages
    ]
    lines.append(
        f"  {'sum of stages':22s} {report.ms:9.2f} ms  of {report.wall_ms:.2f} ms with planning and copies"
    )
    lines += [f"  predicted: {name:22s} {_write_bound(bound)}" for name, bound in report.errors]
    lines += [f"  not in the total: {name} {value:.2g}" for name, value in report.beside.items()]
    if error := report.error:
        lines.append(
            f"  true error: rms {error.rms:.2g}, largest local {error.max_local:.2g}, "
            f"99.9 % {error.p999_sigma:.2g} sigma, largest {error.max_sigma:.2g} sigma"
        )
    if report.prediction_ratio:
        lines.append(f"  predicted over true relative rms: {report.prediction_ratio:.2g}")
    lines += [f"  not modelled: {effect}" for effect in report.left_out]
    lines += [f"  plan: {report.plan}"] * bool(report.plan)
    lines += [f"  note: {note}" for note in report.notes]
    return "\n".join(lines)


def _write_bound(bound: "Bound") -> str:
    """Return the figures of a named error, or that it is not known."""
    if not bound.is_known:
        return "not known"
    return f"rms {bound.rms:.2g}, 99.9 % {bound.p999_sigma:.2g} sigma, largest {bound.max_sigma:.2g} sigma"
