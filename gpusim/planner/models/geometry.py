"""Geometry: where the lens puts the samples."""

from gpusim.planner.geometry import DistortionGrid, distortion_grid
from gpusim.planner.notes import Notes
from gpusim.planner.question import Question


def distorted(question: Question, notes: Notes) -> DistortionGrid | None:
    """The lens's distortion of the samples, the margin's where there is blur to need it; None: as a pinhole would.

    Raises OutOfRange.
    """
    distortion = question.optics.distortion
    if distortion is None:
        return None
    seen = question.size if question.is_blurred else question.scene.samples
    made = distortion_grid(distortion, seen, question.pitch, question.size)
    notes.models["optics.distort"] = f"distortion: {made.report}"
    return made
