"""Plans that the caller gives: whether they fit a camera, and their error in a scene of another plan."""

from dataclasses import fields
from functools import cache

import numpy as np

from gpusim.domain.account import SAFETY, UNKNOWN, Account, Bound, Tolerance, total
from gpusim.domain.camera import Camera
from gpusim.domain.sensor import Sensor
from gpusim.optics.field import FieldBlur
from gpusim.optics.fusion import Watch
from gpusim.optics.geometry import DistortionGrid
from gpusim.optics.kernel_space import KernelSpace
from gpusim.optics.lengths import Tiling
from gpusim.planner.choices import Blur, Falloff, Fusion, Goal, Sampling, WorstKernels
from gpusim.planner.facts import Operation
from gpusim.planner.knobs import border, highlights, pixels, spectral
from gpusim.planner.knobs.blur import doubt_of
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.knobs.field import field_bound
from gpusim.planner.plan import Plan, rounding_of
from gpusim.planner.probes import SIDE, Probes
from gpusim.planner.question import Notes, Question
from gpusim.planner.search import HEADROOM

# fields of a sensor that matter after the light is collected: plans depend on all others
READ_OUT = {
    "full_well",
    "bits",
    "exposure_time",
    "auto_exposure",
    "row_time",
    "binning_mode",
    "gain",
    "conversion_gain",
    "adc_range",
    "analog_gain",
    "analog_offset",
    "black_level",
    "noise",
}
PIXELS = tuple(part.name for part in fields(Sensor) if part.name not in READ_OUT)
REMEDY = "a plan made for this scene may meet it"


def plan_inputs(camera: Camera, asked: Tolerance | None) -> tuple:
    """Return everything but the scene that a plan depends on.

    asked: the tolerance; None: everything that the frames of a plan depend on.
    """
    sensor = camera.sensor
    in_sigma = asked is not None and (asked.p999_sigma is not None or asked.max_sigma is not None)
    noise = (sensor.exposure_time, sensor.saturation, sensor.read_sigma) if in_sigma else ()
    return (camera.optics, *(getattr(sensor, name) for name in PIXELS), noise)


def named_parts(camera: Camera) -> dict:
    """Return the settings of a camera that frames by a plan depend on, by name."""
    optics, sensor = camera.optics, camera.sensor
    return {f"optics.{part.name}": getattr(optics, part.name) for part in fields(optics)} | {
        f"sensor.{name}": getattr(sensor, name) for name in PIXELS
    }


def judge_given(
    plan: Plan,
    question: Question,
    exposure_time: float | None,
    asked: Tolerance | None,
    single: bool,
    brightness: float = 1.0,
) -> Plan:
    """Return the plan for another scene that it serves, with all errors predicted for that scene.

    Args:
        plan: The plan.
        question: Of that scene, with the plan's tolerance if no other is set.
        exposure_time: [s], or None.
        asked: Tolerance of the verdict, or None.
        single: See `gpusim.planner.plan.plan`.
        brightness: Likewise.

    Raises:
        BadData, OutOfRange: As `plan` does.
    """
    account, notes, question = _account(plan, question, exposure_time, single, brightness)
    taps = plan.find(Sampling)
    spectral.describe_unseen(question, notes)
    pixels.describe(question, taps and (taps.rows, taps.cols), notes)
    goal = () if asked is None else (Goal(asked, REMEDY),)
    return plan.exchange(
        *goal,
        without=(Goal,),
        scene=question.scene,
        camera=question.camera,
        content=question.content,
        account=account,
        single=single,
        left_out=notes.left_out,
        beside=notes.beside,
        planned_for="",
        probed="",
        given_of=plan.scene.name,
    )


def account_given(
    plan: Plan,
    question: Question,
    exposure_time: float | None,
    single: bool,
    brightness: float = 1.0,
) -> Account:
    """Return the account of `judge_given`, without what is reported beside it."""
    return _account(plan, question, exposure_time, single, brightness)[0]


def _account(plan, question, exposure_time, single, brightness):
    """Return the account of a plan, the notes with its bounds, and the question as the plan takes it."""
    picture, notes, probes = highlights.whole(question), Notes(), None
    operation = picture.operation(question, exposure_time, brightness)
    form = plan.find(Blur)
    if form and picture.is_spiky and highlights.can_be_split(question):
        notes.leave_out(
            "highlights, which a plan made for this scene would add exactly", UNKNOWN, "highlights"
        )
    if question.tolerance is not None:
        probes = spectral.probes_of(question, picture, operation)
    is_declared = not question.is_blurred
    if form is None and question.is_blurred:
        assert probes is not None  # a blur is left out only for a tolerance
        afar = probes.even_error(picture.from_afar(question, SIDE / 2))
        notes.leave_out("blur", total([probes.without_blur, afar]), "blur left out")
        question = question.without_blur()
    told = cache(lambda: probes or spectral.probes_of(question, picture, operation))
    if not question.scene.view.is_plain:
        pixels.note_view(question, told(), notes)
    placed = pixels.plan_distortion(question, told, notes)
    rounding = rounding_of(question, probes, single)
    if question.is_blurred:
        rounding = _blur(plan, question, picture, operation, probes, rounding, notes)
    else:
        spectral.planes_without_blur(question, notes, is_declared)
    notes.bounds = rounding | notes.bounds
    _geometry(plan, placed, question, probes, notes)
    bounds = {name: bound for name, bound in notes.bounds.items() if bound != Bound()}
    return Account(bounds, operation.seconds, doubt_of(question)), notes, question


def holds(plan: Plan, account: Account) -> bool:
    """Return whether a plan is about as accurate for another scene, by its account, as for its own."""
    assert plan.tolerance is not None
    own, its = plan.account.total.ratio(plan.tolerance), account.total.ratio(plan.tolerance)
    return SAFETY * its <= max(1, HEADROOM * SAFETY * own)


def _blur(
    plan: Plan,
    question: Question,
    picture: highlights.Picture,
    operation: Operation,
    probes: Probes | None,
    rounding: dict[str, Bound],
    notes: Notes,
) -> dict[str, Bound]:
    """Predict the errors of planes and border. Returns the rounding of the transforms' input."""
    form = plan.find(Blur)
    assert form is not None
    around = border.surroundings_of(
        question, picture, operation.level, form.period, plan.find(FarField), plan.find(Tiling)
    )
    notes.bounds["planes"] = _planes(plan, probes)
    around.describe(question, notes)
    picture.describe_unsplit(notes)
    return {
        name: bound.times(around.brighter) if name == "transforms" else bound
        for name, bound in rounding.items()
    }


def _planes(plan, probes):
    """Error of the planes: exact in probes; for planes that fit every spectrum, as large as in the plan's scene."""
    own = plan.account.bounds.get("planes", Bound())
    if probes is None:
        return own
    watch, fusion = plan.find(Watch), plan.find(Fusion)
    if watch is None or fusion is None or not len(watch.inputs):
        varying = plan.find(KernelSpace) or plan.find(FieldBlur)
        if varying is None:
            return probes.local(own.rms)
        (rms, most), (_, shaded) = varying.error, varying.flat
        ratio = max(most / max(rms, 1e-300), 1.0)
        return field_bound(probes, own.rms, ratio, shaded, plan.find(WorstKernels))
    *_, (_, bound) = probes.fused_bounds(watch.inputs, fusion.transfers)
    return bound


def _geometry(plan, made, question, probes, notes):
    """Predict what the plan leaves out of distortion, `made` for the scene, and of fall-off."""
    own = Notes()  # without probes nothing is left out
    pixels.choose_distortion(question, made, None, own)
    if made is not None and plan.find(DistortionGrid) is None and probes is not None:
        notes.bounds.pop("distortion", None)
        notes.bounds.pop("distorted border", None)
        move = float(np.hypot(made.nodes[..., 0], made.nodes[..., 1]).max())
        notes.leave_out(
            f"distortion by up to {move:.2g} of a sample",
            probes.shift_error(move),
            "distortion left out",
        )
    pixels.describe_calibration(question, notes)
    falloff, _ = pixels.falloff_of(question, None, own)
    notes.left_out += own.left_out
    if falloff is not None and plan.find(Falloff) is None and probes is not None:
        most = float(np.abs(falloff.gains - 1).max())
        notes.leave_out(
            f"fall-off of up to {most:.2g}", probes.even_error(most), "fall-off left out"
        )
