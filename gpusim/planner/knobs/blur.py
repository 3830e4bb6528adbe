"""Blur form: straight to the mosaic or of whole channels, by transforms of the frame or of tiles."""

from gpusim.domain.account import SAFETY, total
from gpusim.optics.depth import DepthPlan
from gpusim.planner.knobs.border import Surroundings
from gpusim.planner.knobs.highlights import Picture
from gpusim.planner.probes import SIDE, Probes
from gpusim.planner.question import Notes, Question, displacement_suffix

ENDINGS = {
    "optics.mosaic": ", folded into the mosaic",
    "optics.blur": "",
    "optics.tiles": ", by tiles",
}


def form_of(question: Question, around: Surroundings, depth: DepthPlan | None) -> tuple[str, bool]:
    """The stage that blurs, and whether it gives the mosaic at once.

    around: what takes part. Layers by depth are laid over one another channel by channel.
    """
    lens, sensor = question.lens, question.sensor
    folded = (
        around.folds
        and question.ratio == 1
        and not sensor.is_monochrome
        and not sensor.stacked
        and lens.symmetry.is_round
        and lens.is_uniform
        and not any(lens.displacement)
        and depth is None
    )
    if around.tiling is not None:
        return "optics.tiles", folded
    return "optics.mosaic" if folded else "optics.blur", folded


def describe(question: Question, form: str, words: str, has_depth: bool, notes: Notes):
    """Note the blur's stages. words: the planes."""
    over = "each scene sample"
    if question.ratio == 1:
        over = f"the pixel{displacement_suffix(question.moved)}"
    stage, pupil = question.lens.describe(has_depth)
    notes.models[stage] = f"{pupil}, integrated over {over}"
    notes.models[form] = words + ENDINGS[form]


def left_out(question: Question, picture: Picture, probes: Probes, notes: Notes) -> Question:
    """Return the question without the blur if the error is small enough; else the same.

    The blur is kept whatever its error if its form, or exactness for every spectrum, is prescribed;
    if it follows distance or field, which one window does not show; if point lights are added to
    it; if it displaces the pixels by parts of samples; or if scenes of its kind were found to need
    it.
    """
    assert question.tolerance is not None
    if (
        question.least
        or question.period
        or question.reach
        or question.guaranteed
        or question.facts.depth is not None
        or not question.lens.is_uniform
        or picture.highlights is not None
        or (question.more and question.ratio == 1)
    ):
        return question
    bound = probes.without_blur
    if SAFETY * bound.ratio(question.tolerance) <= 1:
        bound = total([bound, probes.even_error(picture.from_afar(question, SIDE / 2))])
    if SAFETY * bound.ratio(question.tolerance) > 1:
        return question
    notes.leave_out("blur", bound, "blur left out")
    return question.without_blur()
