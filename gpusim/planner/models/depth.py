"""Depth: whether the blur goes by the distance of things."""

from gpusim.domain.account import Bound
from gpusim.domain.errors import OutOfRange
from gpusim.planner.depth import DepthPlan, plan_depth
from gpusim.planner.notes import Notes
from gpusim.planner.probes import Probes
from gpusim.planner.question import Question

OTHERS = "depth, if "  # begins the names of errors of what was not chosen


def by_depth(question: Question) -> tuple[DepthPlan | None, str]:
    """How the blur goes by distance, None where it does not; and why it does not although the scene tells distances.

    Raises BadData, OutOfRange.
    """
    optics, facts, scene = question.optics, question.facts, question.scene
    if facts.depth is None:
        return None, ""
    for why, is_so in (("there is no blur", optics.model == "none"), ("the lens was measured at one", optics.psf),
                       ("the blur varies over the field", optics.varies), ("there is distortion", optics.distortion)):
        if is_so:
            return None, why
    made = plan_depth(optics, question.pitch, facts.depth, facts.brightness(question.light), question.limit,
                      scene=scene)
    for distance in made.distances[[0, -1]]:
        try:
            optics.waves(scene.wavelengths[:1], distance=distance)
        except OutOfRange as error:
            raise OutOfRange("depth", f"{distance:.4g} m with the focus at {optics.object_distance:.4g} m",
                             f"nearer to the focus, or a smaller aperture: {error}") from None
    return made, ""


def bounds_of(depth: DepthPlan | None, probes: Probes | None) -> dict[str, Bound]:
    """Named errors of the blur by distance: where there are edges."""
    own = {} if depth is None else depth.predicted
    local = Bound if probes is None else probes.local
    return {name: local(error) for name, error in own.items() if not name.startswith(OTHERS)}


def describe(depth: DepthPlan | None, notes: Notes):
    """Say how the blur goes by distance."""
    if depth is None:
        return
    notes.models["optics.composite"] = depth.model
    notes.beside |= {name: error for name, error in depth.predicted.items() if name.startswith(OTHERS)}
    if depth.layers > 1 and not depth.sheets:
        notes.left_out.append("what nearer things hide: one picture does not tell it, so what is beside it goes on "
                              "there")
