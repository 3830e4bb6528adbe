"""Blur: its form, whether it is left out or follows the distance of objects, and doubts about its prediction."""

from collections.abc import Callable

import numpy as np
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from gpusim.domain.account import SAFETY, UNKNOWN, Bound, total
from gpusim.domain.errors import OutOfRange
from gpusim.optics.depth import DepthPlan, plan_depth
from gpusim.optics.field import FieldBlur
from gpusim.optics.fusion import SAMPLED_PERIOD
from gpusim.planner.knobs.border import Surroundings
from gpusim.planner.knobs.highlights import Picture
from gpusim.planner.probes import SIDE, Probes
from gpusim.planner.question import DECLARED, Notes, Question, displacement_suffix

SMALL = 400  # samples along a frame below which a field varies within a kernel: predicted over true was .1 to 1.7
DOUBT = f"the blur varies over a frame of less than {SMALL} samples; a larger frame can be judged"
# beyond it predicted over true was .4 to .7 in sigmas: the windows see little of so wide a blur
WIDEST_Q = 24.0
BETWEEN_DOUBT = (
    "pixels end between the scene's samples, and light between blurred samples is interpolated"
)
WIDE_DOUBT = f"wavelength x f-number is more than {WIDEST_Q:g} samples: too wide a blur for windows of {SAMPLED_PERIOD}"
ENDINGS = {
    "optics.mosaic": ", folded into the mosaic",
    "optics.blur": "",
    "optics.tiles": ", by tiles",
}
OTHERS = "depth, if "  # begins the names of errors of alternatives


def form_of(question: Question, around: Surroundings, depth: DepthPlan | None) -> tuple[str, bool]:
    """Return the stage that blurs, and whether it gives the mosaic at once.

    around: surroundings that take part. Layers by depth are composited channel by channel.
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


def doubt_of(question: Question) -> str:
    """Return why predicted errors are not certain (the lens varies within its kernels, a very wide blur), or ""."""
    if not question.is_blurred:
        return ""
    ratio = question.ratio
    if ratio != 1:  # of a pixel's aperture, among the cells of the samples
        width = np.array(question.aperture)
        side = np.array([[-0.5], [0.5]])
        edges = ratio * (0.5 + np.array(question.sensor.displacement) + side * width)
        if not ratio.is_integer() or (np.abs(edges - np.rint(edges)) > 1e-6).any():
            return BETWEEN_DOUBT
    if not question.lens.is_uniform and min(question.size) < SMALL:
        return DOUBT
    return WIDE_DOUBT if question.q.max() > WIDEST_Q else ""


def by_depth(question: Question, probes: Callable[[], Probes], notes: Notes) -> DepthPlan | None:
    """Return the plan of a blur that follows distance; None if it is the same at all distances.

    `notes` then gives the reason and the error. probes: gives the scene's. Raises BadData,
    OutOfRange.
    """
    optics, facts, scene = question.optics, question.facts, question.scene
    if facts.depth is None:
        return None
    if why := question.lens.fixed_distance:
        notes.leave_out(
            f"depth: {why}, so the blur is the same at all distances",
            _without_depth(question),
            "depth left out",
        )
        return None
    if model := question.lens.distance_model:
        notes.leave_out(
            f"measurements at each distance: {model}", UNKNOWN, "distance of measured spreads"
        )
    light = facts.brightness(question.light)
    made = plan_depth(
        optics,
        question.pitch,
        facts.depth,
        light,
        question.limit,
        scene=scene,
        curvature=_curvature(question),
    )
    for distance in () if question.lens.distance_model else made.distances[[0, -1]]:
        try:
            optics.waves(scene.wavelengths[:1], distance=distance)
        except OutOfRange as error:
            raise OutOfRange(
                "depth",
                f"{distance:.4g} m with the focus at {optics.object_distance:.4g} m",
                f"nearer to the focus, or a smaller aperture: {error}",
            ) from None
    if made.sheets:
        made.predicted["depth, light behind the edges of layers"] = _behind_edges(question, made)
    return made


def _curvature(question):
    """Range of circles of confusion by which the field is out of focus along any axis, with 0 (low, high) [sample].

    A wavefront of W waves at the rim is a circle of 8 q W.
    """
    optics = question.optics
    if question.lens.distance_model or question.lens.is_uniform:
        return 0.0, 0.0
    own = [optics.wavefront.polynomial(height) for height in np.linspace(0, 1, 5)]
    waves = [table[at] - own[0][at] for table in own for at in ((2, 0), (0, 2))]
    circle = 8 * optics.wavefront.reference * 1e-9 * optics.working_f_number / question.pitch
    return circle * min(waves), circle * max(waves)


def _behind_edges(question, depth):
    """Relative RMS error of a product: blurred light behind a layer times the layer's blurred transmission.

    Exact is the blur of their product. The two differ by the covariance of light and coverage
    within the kernel of a circular pupil and the pixel, at the mean wavelength in a mirrored world.
    First each is blurred for its own distance by a disc of diameter c, approximated by a Gaussian
    of standard deviation c / 4.
    """
    # of the cosines of a mirrored world
    fy, fx = (np.arange(n)[:, None] / (2 * n) for n in question.size)
    s = np.minimum(np.hypot(fy, fx.T) * question.mean_q, 1)
    seen = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    seen *= np.sinc(fy * question.cell[0])
    seen *= np.sinc(fx.T * question.cell[1])
    light, own, wrong = None, 0.0, 0.0
    for content, alpha, confusion in reversed(depth.sheets):
        front = content.on_host().brightness(question.light).astype(np.float64)
        width = np.abs(confusion).mean() / 4
        if light is not None:
            cover = gaussian_filter(np.asarray(alpha, np.float64), width)
            behind = gaussian_filter(light, own)
            apart = [idctn(dctn(one) * seen) for one in (cover * behind, cover, behind)]
            wrong += float(np.mean((apart[0] - apart[1] * apart[2]) ** 2))
        light = front if light is None else alpha * front + (1 - alpha) * light
        own = width
    size = float(np.mean(light**2))
    return (wrong / size) ** 0.5 if size > 0 else 0.0


def _without_depth(question):
    """Bound of the error of one picture of layers without blur: of samples that they cover in part, it is not known."""
    partial = (np.asarray(layer.alpha) % 1 for layer in question.scene.layers)
    return UNKNOWN if any(map(np.any, partial)) else DECLARED


def bounds_of(depth: DepthPlan | None, probes: Probes | None) -> dict[str, Bound]:
    """Return the named errors of the blur by distance, located at edges."""
    if depth is None:
        return {}
    local = Bound if probes is None else probes.local
    return {
        name: local(error) for name, error in depth.predicted.items() if not name.startswith(OTHERS)
    }


def describe_depth(depth: DepthPlan | None, varying: FieldBlur | None, notes: Notes):
    """Note how the blur follows distance. varying: its difference from the blur on the axis."""
    if depth is None:
        return
    notes.models["optics.composite"] = depth.model
    if varying is not None:
        notes.models["optics.field"] = f"at each kernel's distance, {varying.report}"
    notes.beside |= {
        name: error for name, error in depth.predicted.items() if name.startswith(OTHERS)
    }
    if depth.layers > 1 and not depth.sheets:
        name = next(name for name in depth.predicted if name.startswith("depth, in layers"))
        notes.leave_out(
            "surfaces hidden by nearer objects: one picture does not show them; the picture next to them is "
            "continued there",
            notes.bounds.get(name) or Bound(depth.predicted[name]),
            name,
        )
