"""Plans frames of a Simulator, within the limits of its transforms and its device's memory."""

from dataclasses import replace
from math import ceil, prod
from typing import TYPE_CHECKING

import numpy as np

from gpusim.domain.account import UNKNOWN, Account
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, DoesNotFit, NotMet, OutOfRange, format_value
from gpusim.domain.progress import announced
from gpusim.domain.scene import Scene, View, checked_scene
from gpusim.optics.depth import DepthPlan, checked_confusion
from gpusim.optics.lengths import LENGTHS
from gpusim.optics.outside import BORDER_REACH
from gpusim.pipeline.cache import same
from gpusim.pipeline.reading import bytes_read_on_device, is_read_on_device
from gpusim.pipeline.step import steps_needed
from gpusim.planner.choices import Goal
from gpusim.planner.draft import RESIZED, TURNED
from gpusim.planner.facts import Facts, OnHost
from gpusim.planner.given import PIXELS, account_given, judge_given, named_parts, plan_inputs
from gpusim.planner.knobs import highlights, spectral
from gpusim.planner.plan import Plan, plan
from gpusim.planner.probes import Probes
from gpusim.planner.question import Question

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

MOST_REACH = LENGTHS[-1] // 4  # largest width of the surroundings [pixel]


def checked_reach(reach: int | None) -> int | None:
    """Return the width of the surroundings [pixel], or None, checked. Raises OutOfRange."""
    if reach is not None and (int(reach) != reach or not 1 <= reach <= MOST_REACH):
        raise OutOfRange("reach", reach, f"a whole number of pixels, 1 .. {MOST_REACH}")
    return reach


def draft_key(camera: Camera) -> tuple:
    """Return the camera settings that invalidate a draft: all but TURNED of the lens and RESIZED of the sensor."""
    pixels = (getattr(camera.sensor, name) for name in PIXELS if name not in RESIZED)
    return (replace(camera.optics, **TURNED), *pixels)


def make_plan(
    simulator: "Simulator",
    scene: Scene,
    facts: Facts | None = None,
    exposure_time: float | None = None,
    least: int = 0,
    brightness: float = 1.0,
) -> Plan:
    """Return the plan of a scene, see `Simulator.plan`."""
    checked_scene(scene)
    if simulator.camera.sensor.lenslets is not None:
        raise BadData(
            f"camera {simulator.camera.name}: pixels behind lenslets see the pupil's parts; make their frames by "
            "gpusim.expose_lenslets or gpusim simulate --views, or remove [sensor] lenslets"
        )
    reach, period, device = simulator.reach, simulator.period, simulator.device
    most = (
        LENGTHS[-1] // 2 - 2 * scene.margin
        if scene.border == "zero"
        else (
            LENGTHS[-1]
            - 2 * (ceil((reach or BORDER_REACH) * scene.samples_per_pixel) + scene.margin)
        )
    )
    if max(scene.samples) > most and not period:
        raise OutOfRange(
            "scene size", "x".join(map(str, scene.samples[::-1])), f"up to {most} samples each way"
        )
    simulator.readout.output_shape(scene.shape)
    with announced("planning"):
        made = plan(
            scene,
            simulator.camera,
            tolerance=simulator.tolerance,
            facts=facts,
            exposure_time=exposure_time,
            single=device.kind != "numpy",
            on_gpu=device.is_gpu,
            **_plan_options(simulator),
            least=least,
            brightness=brightness,
        )
    _require_met(simulator, made)
    needed = require_memory(made, simulator)
    return replace(made, bytes_needed=needed, left_out=[*made.left_out, *simulator.left_out])


def _require_met(simulator: "Simulator", made):
    """Raise NotMet if the simulator is strict and the plan's tolerance is not met in its scene."""
    if simulator.strict and made.verdict is not None and not made.verdict.is_met:
        raise NotMet(f"{made.scene.name}: tolerance {made.verdict}")


def require_memory(made: Plan, simulator: "Simulator") -> int:
    """Return the device memory of a frame made with a plan [byte].

    It is the sum over the steps. SciPy's transforms count if they use the device's memory. Constants of a few thousand
    bytes are left out. For depth and for a blur that varies over the field it is an upper bound. Raises DoesNotFit.
    """
    scene, device = made.scene, simulator.device
    steps = steps_needed(simulator.steps(made), ["codes", "mean of pixels"])
    needed = int(sum(step.nbytes for step in steps) + bytes_read_on_device(made, device))
    largest = largest_array(made, steps)
    needed *= 4 if device.kind == "numpy" else 1  # float64 and complex temporaries
    what = f"{scene.name} ({scene.shape[1]}x{scene.shape[0]})"
    if needed > device.memory:
        raise DoesNotFit(what, needed, device.memory, device.name)
    if largest > device.largest_array:
        raise DoesNotFit(f"one array of {what}", largest, device.largest_array, device.name)
    return needed


def largest_array(plan: Plan, steps) -> int:
    """Return the memory of the largest array of the content, the planes or the transfer tables [byte]."""
    content = plan.content
    stored = [
        prod(getattr(content, name).shape) * content.stored_type(name).itemsize
        for name in content.samples
    ]
    names = ("planes", "transfer")
    return max(*stored, *(step.nbytes for step in steps if step.output in names))


def check_given(made, camera: Camera, scene: Scene):
    """Raise BadData if a given plan is not for this camera and this scene."""
    if not isinstance(made, Plan):
        raise BadData(f"plan: {type(made).__name__}, wanted a Plan, see Simulator.plan")
    named = f"plan {made.name} of {format_value(made.scene.name)}"
    if made.is_draft:
        raise BadData(
            f"{named}: a draft for a lens slider that moves; wanted a plan from Simulator.plan"
        )
    if camera is not made.camera:
        own, its = named_parts(made.camera), named_parts(camera)
        for name in own:
            if not same(own[name], its[name]):
                raise BadData(
                    f"{named} is for a camera with another {name}: {_shorten(own[name])}; this camera has "
                    f"{_shorten(its[name])}"
                )
    if scene is not made.scene and (why := made.misfit(scene)) and not same(scene, made.scene):
        raise BadData(f"{named} does not serve {format_value(scene.name)}: {why}")


def adopt_plan(
    simulator: "Simulator", made: Plan, scene: Scene, exposure_time: float | None = None
) -> Plan:
    """Return a given plan, checked, with its errors in a scene.

    Raises BadData, see `check_given`, DoesNotFit, or NotMet, see `predict_errors`.
    """
    check_given(made, simulator.camera, scene)
    require_memory(made, simulator)
    return predict_errors(simulator, made, scene, Facts.of(scene), exposure_time)


def _shorten(value):
    """Return a value for a message; for long values its type."""
    return (
        format_value(value)
        if isinstance(value, int | float | str | tuple | type(None))
        else type(value).__name__
    )


def predict_errors(
    simulator: "Simulator",
    made: Plan,
    scene: Scene,
    facts: Facts,
    exposure_time: float | None,
    brightness: float = 1.0,
) -> Plan:
    """Return a given plan with the errors predicted for a scene, and a verdict for this simulator's tolerance.

    Raises NotMet if the simulator is strict.
    """
    tolerance, single = simulator.tolerance, simulator.device.kind != "numpy"
    own, its = (plan_inputs(camera, tolerance) for camera in (made.camera, simulator.camera))
    is_own = made.scene is scene or same(made.scene, scene)
    is_judged = (
        is_own
        and brightness == 1
        and not made.planned_for
        and made.single == single
        and made.tolerance == tolerance
        and same(own, its)
    )
    if not is_judged and made.misfit(scene):  # another tolerance, device or noise
        unknown = {
            "a plan for this scene only, made for another tolerance, exposure or device": UNKNOWN
        }
        account = replace(made.account, bounds=made.account.bounds | unknown)
        goal = () if tolerance is None else (Goal(tolerance),)
        made = made.exchange(*goal, without=(Goal,), account=account)
    elif not is_judged:
        question = Question.of(
            scene, simulator.camera, facts, tolerance or made.tolerance, **_plan_options(simulator)
        )
        made = judge_given(made, question, exposure_time, tolerance, single, brightness)
        made = replace(made, left_out=[*made.left_out, *simulator.left_out])
    _require_met(simulator, made)
    return replace(made, scene=scene)


def probe_plan(
    simulator: "Simulator",
    made: Plan,
    scene: Scene,
    seconds: float | None,
    facts: Facts,
    brightness: float = 1.0,
) -> Account:
    """Return a plan's errors in another scene that it serves.

    seconds: exposure time [s]; None: the camera's choice. facts: Of the scene. brightness: factor on its light.
    """
    question = Question.of(
        scene, simulator.camera, facts, simulator.tolerance, **_plan_options(simulator)
    )
    single = simulator.device.kind != "numpy"
    return account_given(made, question, seconds, single, brightness)


def probes_for(simulator: "Simulator", scene: Scene, view: View, seconds: float) -> Probes:
    """Return the windows of a view of a scene in which errors are computed. seconds: exposure time [s]."""
    question = Question.of(
        scene.viewed(view), simulator.camera, Facts.of(scene), None, **_plan_options(simulator)
    )
    picture = highlights.whole(question)  # of which no light is split off while it moves
    return spectral.probes_of(question, picture, picture.operation(question, seconds))


def is_planned(simulator: "Simulator", made: Plan, facts: Facts, scene: Scene) -> bool:
    """Return whether a plan of a scene is right for it again, although its arrays may have been written to.

    All that the planner reads of the whole scene is read again and compared: brightness, distance, and pairs of rows.
    facts: those of which the plan was made.
    """
    if made.scene is not scene or scene.layers or is_read_on_device(simulator.device, scene):
        return False
    if scene.depth is not None:
        depth, own = made.find(DepthPlan), np.asarray(scene.depth, np.float64)
        pitch = simulator.camera.sensor.pixel_pitch / float(scene.samples_per_pixel)
        try:
            found = checked_confusion(simulator.camera.optics, pitch, own, own.shape)
        except (BadData, OutOfRange):
            return False
        if depth is None or not np.array_equal(found, depth.confusion):
            return False
    return scene.content.is_seen and facts.is_read_again(OnHost(scene.content))


def _plan_options(simulator: "Simulator"):
    """Return the options of a simulator's plans, without the tolerance."""
    return {name: getattr(simulator, name) for name in ("guaranteed", "reach", "period")} | {
        "cache": simulator.cache
    }
