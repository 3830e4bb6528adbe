"""Blur form: by transforms straight to the mosaic, by transforms of whole channels, or by pyramids without any."""

from gpusim.domain.errors import OutOfRange
from gpusim.planner.depth import DepthPlan
from gpusim.planner.notes import Notes
from gpusim.planner.question import Question, displaced

ENDINGS = {"optics.mosaic": ", folded into the mosaic", "optics.nearfar": ", without transforms", "optics.blur": ""}


def form_of(question: Question, folds: bool, depth: DepthPlan | None) -> tuple[str, bool]:
    """The stage that blurs, and whether it gives the mosaic at once.

    folds: whether the mosaic folds into the transforms. Layers by depth are laid over one another channel by channel.
    Raises OutOfRange.
    """
    optics, sensor = question.optics, question.sensor
    if question.fft_free and question.is_blurred:
        if optics.varies or depth is not None or not optics.is_symmetric:
            raise OutOfRange("fft_free", f"{optics.description}{', by depth' if depth is not None else ''}",
                             "a blur that is the same all over the frame and at every angle")
        return "optics.nearfar", False
    folded = (folds and question.ratio == 1 and not sensor.is_monochrome and not sensor.stacked
              and optics.is_symmetric and not optics.varies and not any(question.moved) and depth is None)
    return "optics.mosaic" if folded else "optics.blur", folded


def describe(question: Question, form: str, has_depth: bool, notes: Notes):
    """Say what blurs."""
    optics, moved = question.optics, question.moved
    over = f"the pixel{displaced(moved)}" if question.ratio == 1 else "each scene sample"
    if optics.is_ideal and not has_depth and not any(moved):
        notes.models["optics.airy"] = f"diffraction-limited circular pupil, integrated over {over}"
    else:
        notes.models["optics.pupil"] = f"{optics.description}, integrated over {over}"
    notes.models[form] += ENDINGS[form]
