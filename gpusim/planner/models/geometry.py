"""Geometry: where the lens puts the samples."""

import numpy as np

from gpusim.domain.account import SAFETY, UNKNOWN, total
from gpusim.domain.calibration import Calibration
from gpusim.planner.geometry import DistortionGrid, distortion_grid
from gpusim.planner.notes import Notes
from gpusim.planner.probes import Probes
from gpusim.planner.question import Question

NEGLIGIBLE = 0.01  # of a sample: a distortion below it may be left out


def viewed(question: Question, probes: Probes, notes: Notes):
    """Say that the frame is a view of the scene, and what its interpolation errs."""
    notes.bounds["view"] = probes.resampled(question.scene.view, question.ratio)
    notes.models["optics.distort"] = ("a view of the scene, interpolated by cubics: displaced, turned or magnified as "
                                      "each frame says")


def distorted(question: Question, probes: Probes | None, notes: Notes) -> DistortionGrid | None:
    """The lens's distortion of the samples, the margin's where there is blur to need it; None: as a pinhole would.

    probes: of the scene, where there is a tolerance. Raises OutOfRange.
    """
    distortion = question.distortion
    if distortion is None:
        return None
    seen = question.size if question.is_blurred else question.scene.samples
    made = distortion_grid(distortion, seen, question.pitch, question.size)
    move = float(np.hypot(made.nodes[..., 0], made.nodes[..., 1]).max())
    if probes is not None and move < NEGLIGIBLE:
        assert question.tolerance is not None
        bound = probes.moved(move)
        if SAFETY * total([*notes.bounds.values(), bound]).ratio(question.tolerance) <= 1:
            notes.leave_out(f"distortion by up to {move:.2g} of a sample", bound, "distortion left out")
            return None
    seen_by = notes.models.get("optics.distort")
    notes.models["optics.distort"] = f"{f'{seen_by}; ' if seen_by else ''}distortion: {made.report}"
    return made


def describe_calibration(question: Question, notes: Notes):
    """Say what the frame takes from a calibration in place of the scene's own field of view."""
    calibration = question.optics.distortion
    if not isinstance(calibration, Calibration):
        return
    if "optics.distort" in notes.models:
        notes.models["optics.distort"] += f"; {calibration}"
    across = calibration.width / calibration.fx  # of the pinhole's picture, in focal lengths
    fov = question.scene.fov
    if fov and abs(2 * np.tan(fov / 2) / across - 1) > NEGLIGIBLE:
        notes.leave_out(f"the scene's field of view, {np.degrees(fov):.4g} deg: taken for that of the "
                        f"calibration's pinhole, {np.degrees(2 * np.arctan(across / 2)):.4g} deg", UNKNOWN,
                        "field of view")
