"""What moves, before a rolling shutter: scenes at a few instants, or a camera on its path."""

import dataclasses
from collections.abc import Iterable
from math import prod
from time import perf_counter

import numpy as np

from gpusim.domain.account import SAFETY, Bound
from gpusim.domain.animation import Animation
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import checked_scene
from gpusim.kernels.sensor.shutter import shutter
from gpusim.optics.shutter import shutter_weights
from gpusim.pipeline.cache import Kept
from gpusim.pipeline.frame import Exposure
from gpusim.pipeline.metering import metered
from gpusim.pipeline.planning import given, probes_for
from gpusim.pipeline.program import exposed
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

COUNTS = (2, 3, 5, 9, 17, 33, 65, 129)  # of instants: each has those of the one before
ENOUGH = 0.5  # of a tolerance
STEP = 0.25  # [sample] between two instants, without a tolerance


def expose_moving(
    simulator: Simulator,
    scenes,
    times,
    exposure_time: float | None = None,
    start: float = 0.0,
    gain: float = 1.0,
    flicker: Flicker | None = None,
    plan: Plan | None = None,
) -> Exposure:
    """Mean electrons of a scene that moves, or of a camera that does: rows are exposed one after the other.

    scenes: pictures of it at the instants `times` [s], all of one size; between them the light changes linearly.
    start: when the first row opens [s]; row y opens y row_time of the sensor later. Automatic exposure meters the
    first scene in steady light; gain: as for `Simulator.expose`. flicker: of all its light, on the clock of the times.
    plan: of all scenes, see `Simulator`.
    Raises as `Simulator.expose` does, and BadData, OutOfRange for times that do not cover the exposure.
    """
    checked_time(exposure_time)
    checked_gain(gain)
    if not isinstance(scenes, Iterable):
        raise BadData(
            f"moving scene: {type(scenes).__name__}, wanted several scenes, such as [scene]"
        )
    scenes, begun = [checked_scene(scene) for scene in scenes], perf_counter()
    device, imaging, sensor = simulator.device, simulator.imaging, simulator.camera.sensor
    if not scenes or len(scenes) != len(np.atleast_1d(times)):
        raise BadData(
            f"moving scene: {len(scenes)} scenes and {len(np.atleast_1d(times))} times; wanted as many, "
            "one or more"
        )
    if len({scene.shape for scene in scenes}) > 1:
        raise BadData("moving scene: the scenes differ in size")
    plans = _plans(simulator, scenes, plan, exposure_time)
    held = (
        8 * len(scenes) * prod(scenes[0].shape) * len(plans[0].weights)
    )  # the pictures, and once more together
    if held > device.memory:
        raise DoesNotFit(
            f"a moving scene of {len(scenes)} pictures", held, device.memory, device.name
        )
    with device.timed() as ms:
        rates = [imaging.exposed(plan, imaging.rates(plan), 1.0) for plan in plans]
        shape = rates[0].shape
        exposure_time = sensor.exposure_time if exposure_time is None else exposure_time
        if exposure_time is None:
            exposure_time, gain = metered(simulator, rates[0])
        weights = shutter_weights(times, shape[-2], exposure_time, sensor.row_time, start, flicker)
        layers = prod(shape[:-2])  # of stacked pixels, one below the other
        stacked = device.reshape(device.stack(rates), (len(rates), layers * shape[-2], shape[-1]))
        mean = shutter(stacked, np.tile(weights, (layers, 1)), device=device)
        model = f"{len(scenes)} pictures, rows {1e6 * sensor.row_time:g} us apart" + (
            f", light that flickers at {flicker.frequency:g} Hz" if flicker else ""
        )
        told = dataclasses.replace(
            _worst(plans, simulator.tolerance), models=plans[0].models | {"sensor.shutter": model}
        )
        exposure = exposed(
            simulator, told, device.reshape(mean, shape), exposure_time, gain, Kept()
        )
    return dataclasses.replace(exposure, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begun))


def _plans(simulator, scenes, plan, exposure_time):
    """A plan for every scene: of each content one, or the one that was given."""

    def planned(scene):
        return (
            simulator.plan(scene) if plan is None else given(simulator, plan, scene, exposure_time)
        )

    first = planned(scenes[0])
    return [
        first,
        *(
            dataclasses.replace(first, scene=scene)
            if first.serves(scene) and (scene.content is scenes[0].content)
            else planned(scene)
            for scene in scenes[1:]
        ),
    ]


def _worst(plans, tolerance):
    """The first plan with the largest error of every cause in any of the plans."""
    bounds: dict = {}
    for plan in plans:
        for name, bound in plan.account.bounds.items():
            other = bounds.get(name, bound)
            bounds[name] = Bound(*map(max, dataclasses.astuple(bound), dataclasses.astuple(other)))
    first = plans[0]
    doubt = next((plan.account.doubt for plan in plans if plan.account.doubt), "")
    account = dataclasses.replace(first.account, bounds=bounds, doubt=doubt)
    remedy = next(
        (plan.verdict.remedy for plan in plans if plan.verdict and plan.verdict.remedy), ""
    )
    left_out = list(dict.fromkeys(line for plan in plans for line in plan.left_out))
    return dataclasses.replace(
        first,
        account=account,
        left_out=left_out,
        verdict=tolerance and account.verdict(tolerance, remedy),
    )


def expose_motion(
    simulator: Simulator,
    scene,
    motion: Motion,
    exposure_time: float | None = None,
    start: float = 0.0,
    gain: float = 1.0,
    instants: int | None = None,
    flicker: Flicker | None = None,
    plan: Plan | None = None,
) -> Exposure:
    """Mean electrons of a scene by a camera that moves while it exposes, row after row: motion blur and leaning edges.

    scene: a Scene, or an Animation, in which things move on the same clock.
    start: when the first row opens, on the clock of the motion [s]. Automatic exposure meters the first view.
    instants: at which the scene is seen, 2 or more; None: as many as keep what is wrong between them below ENOUGH of
    the tolerance, or, without one, that the camera moves STEP samples between two. What is wrong is told as "shutter".
    flicker: see `expose_moving`. plan: of all views, see `Simulator`.
    Raises as `expose_moving` does, and OutOfRange for instants below 2 and a path that takes more than COUNTS has.
    """
    moving = scene if isinstance(scene, Animation) else None
    scene, sensor = moving.at(start) if moving else checked_scene(scene), simulator.camera.sensor
    checked_time(exposure_time)
    if exposure_time is None and sensor.exposure_time is None:
        metered_by = simulator.expose(scene.viewed(motion.at(start)), None, gain, plan)
        exposure_time, gain = metered_by.exposure_time, metered_by.gain
    seconds = float(sensor.exposure_time if exposure_time is None else exposure_time)
    whole = seconds + sensor.row_time * (scene.shape[0] - 1)
    if instants is not None and not instants >= 2:
        raise OutOfRange("instants", instants, "2 or more")
    probes = probes_for(simulator, scene, motion.at(start), seconds)
    for count in [instants] if instants else COUNTS:
        times = start + whole * np.linspace(0, 1, count)
        step = farthest(scene, motion, times)
        if moving:  # an actor's own way, as large as the camera shows it, and the camera's
            step += moving.farthest(times) * max(motion.at(time).zoom for time in times)
        wrong = probes.between(step, step * (count - 1) * seconds / whole)
        tolerance = simulator.tolerance
        if (
            instants
            or not step
            or (step <= STEP if tolerance is None else SAFETY * wrong.ratio(tolerance) <= ENOUGH)
        ):
            break
    else:
        raise OutOfRange(
            "motion during an exposure",
            f"{step * (count - 1):.4g} samples in {whole:.4g} s",
            "a path "
            f"that takes up to {count} instants: a shorter exposure, a slower camera, a larger tolerance",
        )
    if not step:
        times = times[:1]
    scenes = [(moving.at(time) if moving else scene).viewed(motion.at(time)) for time in times]
    made = expose_moving(simulator, scenes, times, seconds, start, gain, flicker, plan)
    between = next(
        (one.view for one in scenes if not one.view.is_whole(scene.samples_per_pixel)),
        scenes[0].view,
    )
    told = {"view": probes.resampling_error(between, scene.samples_per_pixel), "shutter": wrong}
    seen, bounds = made.plan, made.plan.account.bounds | told
    account = dataclasses.replace(seen.account, bounds=bounds)
    verdict = (
        None
        if tolerance is None
        else account.verdict(tolerance, seen.verdict.remedy if seen.verdict else "")
    )
    return dataclasses.replace(
        made, plan=dataclasses.replace(seen, account=account, verdict=verdict)
    )


def farthest(scene, motion, times):
    """How far the camera moves between two of these times, at most, anywhere in the frame [sample]."""
    y, x = (
        np.array((-0.5, 0.5))[:, None] * scene.samples[0],
        np.array((-0.5, 0.5)) * scene.samples[1],
    )
    places = np.array(
        [
            np.broadcast_arrays(*motion.at(time).place(y, x, scene.samples_per_pixel))
            for time in times
        ]
    )
    zoom = max(
        motion.at(time).zoom for time in times
    )  # a place of the scene is so many samples of the frame
    return float(np.hypot(*np.diff(places, axis=0).swapaxes(0, 1)).max(initial=0)) * zoom
