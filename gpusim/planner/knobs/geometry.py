"""Geometry: places of the samples in the lens's picture."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import hypot

import numpy as np

from gpusim.domain.account import SAFETY, UNKNOWN, Bound, total
from gpusim.domain.calibration import Calibration
from gpusim.optics.geometry import DistortionGrid, distortion_grid, place_phases
from gpusim.planner.probes import Probes
from gpusim.planner.question import Notes, Question

NEGLIGIBLE = 0.01  # of a sample: a distortion below it may be left out


def note_view(question: Question, probes: Probes, notes: Notes):
    """Note that the frame is a view of the scene, with the error of its interpolation."""
    notes.bounds["view"] = _with_rim(
        question, probes, lambda seen: seen.resampling_error(question.scene.view, question.ratio)
    )
    notes.models["optics.distort"] = (
        "a view of the scene, interpolated by cubics: displaced, turned or magnified as "
        "each frame says"
    )


def plan_distortion(
    question: Question, told: Callable[[], Probes], notes: Notes
) -> DistortionGrid | None:
    """Return the lens's distortion of the samples, and note the error of its interpolation; None without distortion.

    The margin's samples are included if there is blur. told: gives the scene's probes. Raises
    OutOfRange.
    """
    distortion = question.distortion
    if distortion is None:
        return None
    seen = question.size if question.is_blurred else question.scene.samples
    made = distortion_grid(distortion, seen, question.pitch, question.size)
    (move, flux), (most, largest) = made.typical, made.error
    usual, worst = told().shift_error(move), told().shift_error(most)
    bright, brightest = told().brightness_error(flux), told().brightness_error(largest)
    notes.bounds["distortion grid"] = Bound(
        hypot(usual.rms, bright.rms),
        hypot(worst.p999_sigma, brightest.p999_sigma),
        hypot(worst.max_sigma, brightest.max_sigma),
    )
    # else it is an error of the view, whose places are anywhere
    if question.scene.view.is_whole(question.ratio):
        width = sum(made.ratio) / 2 if made.method == "area" else None
        everywhere, worst = (
            _with_rim(
                question, told(), partial(Probes.interpolation_bound, phases=phases, width=width)
            )
            for phases in place_phases(made, seen)
        )
        notes.bounds["distortion"] = replace(worst, rms=everywhere.rms)
    return made


def _with_rim(question: Question, probes: Probes, error: Callable[[Probes], Bound]) -> Bound:
    """The error of interpolated samples, and of the outermost ones that the border repeats: no blur evens that out."""
    bound = error(probes)
    if question.scene.border == "zero" or not question.deviation:
        return bound
    share = min(1.0, 2 * question.deviation / min(question.scene.samples))
    return total([bound, error(probes.sharp).times(share)])


def choose_distortion(
    question: Question, made: DistortionGrid | None, probes: Probes | None, notes: Notes
):
    """Return the distortion that the frame gets: `made`, or None if it may be left out.

    probes: of the scene, if there is a tolerance.
    """
    if made is None:
        return None
    move = float(np.hypot(made.nodes[..., 0], made.nodes[..., 1]).max())
    if probes is not None and move < NEGLIGIBLE:
        assert question.tolerance is not None
        bound = probes.shift_error(move)
        others = {**notes.bounds}
        others.pop("distortion", None)
        others.pop("distortion grid")
        if SAFETY * total([*others.values(), bound]).ratio(question.tolerance) <= 1:
            notes.bounds = others
            words = f"distortion by up to {move:.2g} of a sample"
            notes.leave_out(words, bound, "distortion left out")
            return None
    seen_by = notes.models.get("optics.distort")
    notes.models["optics.distort"] = f"{f'{seen_by}; ' if seen_by else ''}distortion: {made.report}"
    return made


def describe_calibration(question: Question, notes: Notes):
    """Note the parts of a calibration that replace the scene's own field of view."""
    calibration = question.optics.distortion
    if not isinstance(calibration, Calibration):
        return
    if "optics.distort" in notes.models:
        notes.models["optics.distort"] += f"; {calibration}"
    across = calibration.width / calibration.fx  # of the pinhole's picture, in focal lengths
    fov = question.scene.fov
    if fov and abs(2 * np.tan(fov / 2) / across - 1) > NEGLIGIBLE:
        notes.leave_out(
            f"the scene's field of view, {np.degrees(fov):.4g} deg: the calibration's, "
            f"{np.degrees(2 * np.arctan(across / 2)):.4g} deg, is used",
            UNKNOWN,
            "field of view",
        )
