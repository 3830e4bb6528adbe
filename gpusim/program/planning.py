"""The planner asked for a Simulator: what its transforms and its device's memory can hold is planned."""

from dataclasses import replace
from math import ceil

from gpusim.domain.account import Account
from gpusim.domain.camera import Camera
from gpusim.domain.errors import DoesNotFit, NotMet, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.tolerance import Tolerance
from gpusim.domain.view import View
from gpusim.optics.lengths import LENGTHS
from gpusim.planner.after import probed
from gpusim.planner.border import BORDER_REACH
from gpusim.planner.draft import TURNED
from gpusim.planner.facts import Facts
from gpusim.planner.models import highlights, spectral
from gpusim.planner.plan import Plan, plan
from gpusim.planner.probes import Probes
from gpusim.planner.question import Question
from gpusim.program.memory import bytes_needed, largest_array
from gpusim.program.reading import Reading

MOST_REACH = LENGTHS[-1] // 4  # [pixel] of surroundings


def checked_reach(reach: int | None) -> int | None:
    """Return the pixels of surroundings that are asked for, or None, as they are. Raises OutOfRange."""
    if reach is not None and (int(reach) != reach or not 1 <= reach <= MOST_REACH):
        raise OutOfRange("reach", reach, f"a whole number of pixels, 1 .. {MOST_REACH}")
    return reach


def planned_by(camera: Camera, asked: Tolerance | None) -> tuple:
    """What plans depend on beside the scene. asked: the tolerance."""
    sensor = camera.sensor
    in_sigma = asked is not None and (asked.p999_sigma is not None or asked.max_sigma is not None)
    noise = (sensor.exposure_time, sensor.saturation, sensor.read_sigma) if in_sigma else ()
    return (camera.optics, sensor.pixel_pitch, sensor.aperture, sensor.displacement, sensor.qe, sensor.cfa,
            sensor.channels, sensor.stacked, sensor.microlens, sensor.vignetting, sensor.binning, noise)


def drafted_by(camera: Camera) -> tuple:
    """What drafts depend on beside the scene: all of that but what is turned at a lens."""
    return planned_by(replace(camera, optics=replace(camera.optics, **TURNED)), None)


def planned(simulator, scene: Scene, facts: Facts | None = None, exposure_time: float | None = None,
            least: int = 0) -> Plan:
    """What a frame of `scene` takes: see `Simulator.plan`."""
    reach, period, device = simulator.reach, simulator.period, simulator.device
    most = LENGTHS[-1] // 2 - 2 * scene.margin if scene.border == "zero" else (
        LENGTHS[-1] - 2 * (ceil((reach or BORDER_REACH) * scene.samples_per_pixel) + scene.margin))
    if max(scene.samples) > most and not period:
        raise OutOfRange("scene size", "x".join(map(str, scene.samples[::-1])), f"up to {most} samples each way")
    simulator.readout.output_shape(scene.shape)
    made = plan(scene, simulator.camera, tolerance=simulator.tolerance, facts=facts, exposure_time=exposure_time,
                single=device.kind != "numpy", on_gpu=device.is_gpu, **_asked(simulator),
                least=least)
    if simulator.strict and made.verdict is not None and not made.verdict.met:
        raise NotMet(f"{scene.name}: tolerance {made.verdict}")
    needed, largest = bytes_needed(made, device), largest_array(made)
    needed *= 4 if device.kind == "numpy" else 1  # float64 and complex temporaries
    what = f"{scene.name} ({scene.shape[1]}x{scene.shape[0]})"
    if needed > device.memory:
        raise DoesNotFit(what, needed, device.memory, device.name)
    if largest > device.largest_array:
        raise DoesNotFit(f"one array of {what}", largest, device.largest_array, device.name)
    return replace(made, bytes_needed=needed, left_out=[*made.left_out, *simulator.left_out])


def probed_by(simulator, made: Plan, scene: Scene, seconds: float | None) -> Account:
    """What a plan errs in another scene: see `gpusim.planner.after.probed`."""
    facts = Facts(scene.content, None, Reading(simulator.device, scene.content))
    return probed(made, Question.of(scene, simulator.camera, facts, simulator.tolerance, **_asked(simulator)), seconds)


def probes_for(simulator, scene: Scene, view: View, seconds: float) -> Probes:
    """Windows of a scene in which errors are computed, of a view of it. seconds: of the exposure [s]."""
    question = Question.of(scene.viewed(view), simulator.camera, Facts.of(scene), None, **_asked(simulator))
    question, picture = highlights.split(question)
    return spectral.probes_of(question, picture, picture.operation(question, seconds))


def _asked(simulator):
    """How a simulator asks for plans, beside the tolerance."""
    return {name: getattr(simulator, name) for name in ("guaranteed", "reach", "period", "kept")}
