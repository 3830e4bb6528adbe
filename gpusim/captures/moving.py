"""Motion in front of a rolling shutter: scenes at a few instants, or a camera on its path."""

import dataclasses
from collections.abc import Iterable
from math import prod
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.account import SAFETY, Bound
from gpusim.domain.animation import Animation
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.kernels.sensor.shutter import shutter
from gpusim.optics.shutter import shutter_weights
from gpusim.pipeline.exposure import Exposure, expose_mean
from gpusim.pipeline.metering import choose_exposure, meter_light, metering_numbers
from gpusim.pipeline.planning import adopt_plan, probes_for
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Goal
from gpusim.planner.plan import Plan

COUNTS = (2, 3, 5, 9, 17, 33, 65, 129)  # instants; each set contains the one before
ENOUGH = 0.5  # part of the tolerance for the error between instants
STEP = 0.25  # [sample] between two instants, without a tolerance


def expose_moving(
    simulator: Simulator,
    scenes: Iterable[Scene],
    times: ArrayLike,
    exposure_time: float | None = None,
    start: float = 0.0,
    gain: float = 1.0,
    flicker: Flicker | None = None,
    plan: Plan | None = None,
) -> Exposure:
    """Return the mean electrons of a moving scene or camera behind a rolling shutter.

    Row y opens y row times of the sensor after the first. Automatic exposure meters the first scene
    in steady light.

    Args:
        simulator: simulator whose camera takes the exposure.
        scenes: the scene at each of the instants `times`, all of one size. The light changes
            linearly between them.
        times: instants of the scenes [s].
        exposure_time: exposure time [s]; None is the camera's or automatic.
        start: time at which the first row opens [s].
        gain: analog gain, see `Simulator.expose`.
        flicker: flicker of all the light, on the clock of `times`; None is steady light.
        plan: plan for all scenes; None plans them. See `Simulator`.

    Returns:
        The exposure.

    Raises:
        BadData: if `scenes` is empty, their sizes differ, or they do not match `times`.
        OutOfRange: if the times do not cover the exposure.
        DoesNotFit: if the scenes do not fit into the device's memory.
        GpusimError: as raised by `Simulator.expose`.
    """
    checked_time(exposure_time)
    checked_gain(gain)
    if not isinstance(scenes, Iterable):
        raise BadData(f"moving scene: {type(scenes).__name__}, wanted a list of scenes")
    scenes, begin = [checked_scene(scene) for scene in scenes], perf_counter()
    device, imaging, sensor = simulator.device, simulator.imaging, simulator.camera.sensor
    if not scenes or len(scenes) != len(np.atleast_1d(times)):
        raise BadData(
            f"moving scene: {len(scenes)} scenes and {len(np.atleast_1d(times))} times; wanted one or more "
            "of each, equally many"
        )
    if len({scene.shape for scene in scenes}) > 1:
        raise BadData("moving scene: the scenes differ in size")
    plans = _plans(simulator, scenes, plan, exposure_time)
    # the pictures, and their stack
    nbytes = 8 * len(scenes) * prod(scenes[0].shape) * len(plans[0].weights)
    if nbytes > device.memory:
        raise DoesNotFit(
            f"a moving scene of {len(scenes)} pictures", nbytes, device.memory, device.name
        )
    with device.timed() as ms:
        rates = [imaging.values(plan)["per second"] for plan in plans]
        shape = rates[0].shape
        exposure_time = sensor.exposure_time if exposure_time is None else exposure_time
        if exposure_time is None:
            numbers = metering_numbers(sensor, simulator.readout)
            light = meter_light(rates[0], automatic=sensor.auto_exposure, device=device)
            exposure_time, gain = choose_exposure(device.numpy(light), prod(shape), **numbers)
        weights = shutter_weights(times, shape[-2], exposure_time, sensor.row_time, start, flicker)
        layers = prod(shape[:-2])  # of stacked pixels, one below the other
        stacked = device.reshape(device.stack(rates), (len(rates), layers * shape[-2], shape[-1]))
        mean = shutter(stacked, np.tile(weights, (layers, 1)), device=device)
        model = f"{len(scenes)} pictures, rows {1e6 * sensor.row_time:g} us apart"
        if flicker:
            model += f", light that flickers at {flicker.frequency:g} Hz"
        models = plans[0].models | {"sensor.shutter": model}
        reported = dataclasses.replace(_worst(plans), models=models)
        mean = device.reshape(mean, shape)
        exposure = expose_mean(simulator, reported, mean, exposure_time, gain)
    return dataclasses.replace(exposure, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begin))


def _plans(simulator: Simulator, scenes, plan, exposure_time):
    """Return a plan for every scene: one per content, or the given one."""
    plans: list[Plan] = []
    for scene in scenes:
        if plans and plans[0].serves(scene) and scene.content is scenes[0].content:
            plans.append(dataclasses.replace(plans[0], scene=scene))
        elif plan is None:
            plans.append(simulator.plan(scene))
        else:
            plans.append(adopt_plan(simulator, plan, scene, exposure_time))
    return plans


def _worst(plans):
    """Return the first plan with the largest bound of each cause over all plans."""
    bounds: dict = {}
    for plan in plans:
        for name, bound in plan.account.bounds.items():
            other = bounds.get(name, bound)
            bounds[name] = Bound(*map(max, dataclasses.astuple(bound), dataclasses.astuple(other)))
    doubt = next((plan.account.doubt for plan in plans if plan.account.doubt), "")
    account = dataclasses.replace(plans[0].account, bounds=bounds, doubt=doubt)
    goals = [plan.find(Goal) for plan in plans if plan.verdict and plan.verdict.remedy]
    left_out = list(dict.fromkeys(line for plan in plans for line in plan.left_out))
    return plans[0].exchange(*goals[:1], account=account, left_out=left_out)


def expose_motion(
    simulator: Simulator,
    scene: Scene | Animation,
    motion: Motion,
    exposure_time: float | None = None,
    start: float = 0.0,
    gain: float = 1.0,
    instants: int | None = None,
    flicker: Flicker | None = None,
    plan: Plan | None = None,
) -> Exposure:
    """Return the mean electrons of a scene if the camera moves during the exposure.

    Shows motion blur and, with a rolling shutter, leaning edges. Automatic exposure meters the
    first view.

    Args:
        simulator: simulator whose camera takes the exposure.
        scene: a Scene, or an Animation whose actors move on the same clock.
        motion: motion of the camera.
        exposure_time: exposure time [s]; None is the camera's or automatic.
        start: time at which the first row opens, on the clock of the motion [s].
        gain: analog gain, see `Simulator.expose`.
        instants: number of views of the scene, 2 or more. None chooses the fewest of COUNTS that
            keep the error between them below ENOUGH of the tolerance or, without a tolerance, the
            camera's step below STEP samples. That error is reported as "shutter".
        flicker: flicker of all the light; see `expose_moving`.
        plan: plan for all views; None plans them. See `Simulator`.

    Returns:
        The exposure.

    Raises:
        OutOfRange: if there are fewer than 2 instants, or the path needs more than COUNTS has.
        GpusimError: as raised by `expose_moving`.
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
        step = largest_step(scene, motion, times)
        if moving:  # the path of an actor at the camera's magnification, and the camera's
            step += moving.farthest(times) * max(motion.at(time).zoom for time in times)
        wrong = probes.between(step, step * (count - 1) * seconds / whole)
        tolerance = simulator.tolerance
        is_enough = step <= STEP
        if tolerance is not None:
            is_enough = SAFETY * wrong.ratio(tolerance) <= ENOUGH
        if instants or not step or is_enough:
            break
    else:
        raise OutOfRange(
            "motion during an exposure",
            f"{step * (count - 1):.4g} samples in {whole:.4g} s",
            f"a path of up to {count} instants: take a shorter exposure, a slower camera or a larger "
            "tolerance",
        )
    if not step:
        times = times[:1]
    scenes = [(moving.at(time) if moving else scene).viewed(motion.at(time)) for time in times]
    exposure = expose_moving(simulator, scenes, times, seconds, start, gain, flicker, plan)
    ratio = scene.samples_per_pixel
    views = [one.view for one in scenes]
    between = next((view for view in views if not view.is_whole(ratio)), views[0])
    bounds = {"view": probes.resampling_error(between, ratio), "shutter": wrong}
    account = exposure.plan.account
    account = dataclasses.replace(account, bounds=account.bounds | bounds)
    return dataclasses.replace(exposure, plan=dataclasses.replace(exposure.plan, account=account))


def largest_step(scene, motion, times):
    """Return the camera's largest step between two of these times in the frame [sample]."""
    y = np.array((-0.5, 0.5))[:, None] * scene.samples[0]
    x = np.array((-0.5, 0.5)) * scene.samples[1]
    views = [motion.at(time) for time in times]
    places = [np.broadcast_arrays(*view.place(y, x, scene.samples_per_pixel)) for view in views]
    zoom = max(view.zoom for view in views)  # samples of the frame per sample of the scene
    steps = np.diff(np.array(places), axis=0).swapaxes(0, 1)
    return float(np.hypot(*steps).max(initial=0)) * zoom
