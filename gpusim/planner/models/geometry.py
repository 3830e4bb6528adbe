"""Geometry: where the lens puts the samples."""

import numpy as np

from gpusim.domain.account import SAFETY, total
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
            notes.without(f"distortion by up to {move:.2g} of a sample", bound, "distortion left out")
            return None
    seen_by = notes.models.get("optics.distort")
    notes.models["optics.distort"] = f"{f'{seen_by}; ' if seen_by else ''}distortion: {made.report}"
    if isinstance(question.optics.distortion, Calibration):
        _note_calibration(question, question.optics.distortion, notes)
    return made


def _note_calibration(question, calibration, notes):
    """Say what the frame takes from a calibration, and what goes on about the frame's middle."""
    notes.models["optics.distort"] += f"; {calibration}"
    across = calibration.width / calibration.fx  # of the pinhole's picture, in focal lengths
    given = question.scene.fov and 2 * np.tan(question.scene.fov / 2)
    if given and abs(given / across - 1) > NEGLIGIBLE:
        notes.left_out.append(f"the scene's field of view, {np.degrees(question.scene.fov):.4g} deg: taken for that of "
                              f"the calibration's pinhole, {np.degrees(2 * np.arctan(across / 2)):.4g} deg")
    move = np.hypot(*calibration.off_middle)
    if move > 0.5 and (question.optics.varies or not isinstance(question.optics.relative_illumination, str)):
        notes.left_out.append(f"principal point {move:.3g} pixels off the middle: distortion and cos^4 follow it; blur "
                              "and a given relative illumination stay about the frame's middle")
