"""Motion in front of a rolling shutter: scenes at a few instants, or a camera on its path."""

import dataclasses
from collections.abc import Iterable
from math import prod
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from gpusim.captures.parallax import between_error, guess_error, samples_per_radian, see_from
from gpusim.captures.smear import Path, accumulate, convolve, mixing_form, sum_errors
from gpusim.domain.account import SAFETY, Bound
from gpusim.domain.animation import Animation
from gpusim.domain.camera import Camera
from gpusim.domain.distortion import fit_to_frame
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.kernels.sensor.shutter import shutter
from gpusim.optics.geometry import distortion_grid
from gpusim.optics.shutter import shutter_weights
from gpusim.pipeline.exposure import Exposure, expose_mean
from gpusim.pipeline.metering import choose_exposure, meter_light, metering_numbers
from gpusim.pipeline.planning import adopt_plan, probes_for
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Goal
from gpusim.planner.plan import Plan

# instants; each set contains the one before
COUNTS = tuple(2**n + 1 for n in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10))
MOST_PICTURES = 129  # instants of a scene that may be smeared instead
AT_ONCE = 129  # pictures in memory
FEW = 9  # pictures that cost less than a smear
EXACT = 1e-3  # relative RMS error of a smear without a tolerance, at most
VIEWS = (*COUNTS[1:], 2**11 + 1, 2**12 + 1)  # of a smear
WORK = 12  # planes of a view that cost as much as a picture
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
    nbytes = 8 * min(len(scenes), AT_ONCE) * prod(scenes[0].shape) * len(plans[0].weights)
    if nbytes > device.memory:
        raise DoesNotFit(
            f"a moving scene of {len(scenes)} pictures", nbytes, device.memory, device.name
        )
    with device.timed() as ms:
        rates = [imaging.values(plan)["per second"] for plan in plans[:AT_ONCE]]
        shape = rates[0].shape
        exposure_time = sensor.exposure_time if exposure_time is None else exposure_time
        if exposure_time is None:
            numbers = metering_numbers(sensor, simulator.readout)
            light = meter_light(rates[0], automatic=sensor.auto_exposure, device=device)
            exposure_time, gain = choose_exposure(device.numpy(light), prod(shape), **numbers)
        weights = shutter_weights(times, shape[-2], exposure_time, sensor.row_time, start, flicker)
        layers = prod(shape[:-2])  # of stacked pixels, one below the other
        mean, weights = None, np.tile(weights, (layers, 1))
        for first in range(0, len(plans), AT_ONCE):
            own = weights[:, first : first + AT_ONCE]
            if first:
                later = plans[first : first + AT_ONCE]
                rates = [mean, *(imaging.values(plan)["per second"] for plan in later)]
                own = np.column_stack([np.ones(len(own)), own])
            pictures = len(rates), layers * shape[-2], shape[-1]
            mean = shutter(device.reshape(device.stack(rates), pictures), own, device=device)
            mean = device.reshape(mean, shape)
        model = f"{len(scenes)} pictures, rows {1e6 * sensor.row_time:g} us apart"
        if flicker:
            model += f", light that flickers at {flicker.frequency:g} Hz"
        models = plans[0].models | {"sensor.shutter": model}
        reported = dataclasses.replace(_worst(plans), models=models)
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
    first view. A long path is smeared before the lens, as one picture (`gpusim.captures.smear`);
    pictures at a few instants serve for a short one, for actors and for depth. Of methods whose
    error stays below ENOUGH of the tolerance the cheapest is chosen; without a tolerance instants
    are at most STEP samples apart, and a smear errs by at most EXACT. The error is reported as
    "shutter".

    Args:
        simulator: simulator whose camera takes the exposure.
        scene: a Scene, or an Animation whose actors move on the same clock.
        motion: motion of the camera.
        exposure_time: exposure time [s]; None is the camera's or automatic.
        start: time at which the first row opens, on the clock of the motion [s].
        gain: analog gain, see `Simulator.expose`.
        instants: number of pictures of the scene, 2 or more. None chooses the method, and the
            fewest of COUNTS.
        flicker: flicker of all the light; see `expose_moving`.
        plan: plan for all views; None plans them. See `Simulator`.

    Returns:
        The exposure.

    Raises:
        OutOfRange: if there are fewer than 2 instants.
        GpusimError: as raised by `expose_moving`.
    """
    moving, travels = scene if isinstance(scene, Animation) else None, any(motion.travel)
    scene, sensor = moving.at(start) if moving else checked_scene(scene), simulator.camera.sensor
    checked_time(exposure_time)
    motion = motion.through(scene.view)
    can_smear = instants is None and moving is None and scene.depth is None and not travels
    must_smear = False
    if isinstance(plan, Plan):  # it is for one form of content and one kind of view
        own = plan.scene
        can_smear = (
            can_smear and own.view.is_plain and mixing_form(scene.content).is_like(own.content)
        )
        must_smear = can_smear
    if exposure_time is None and sensor.exposure_time is None:
        metered_by = simulator.expose(
            scene.viewed(motion.at(start)), None, gain, None if must_smear else plan
        )
        exposure_time, gain = metered_by.exposure_time, metered_by.gain
    seconds = float(sensor.exposure_time if exposure_time is None else exposure_time)
    whole = seconds + sensor.row_time * (scene.shape[0] - 1)
    if instants is not None and not instants >= 2:
        raise OutOfRange("instants", instants, "2 or more")
    probes = probes_for(simulator, scene, motion.at(start), seconds)

    def is_enough(bound, step=0.0):
        if simulator.tolerance is None:
            return step <= STEP
        return SAFETY * bound.ratio(simulator.tolerance) <= ENOUGH

    def error_of(count):
        """Return the times of pictures, and the error and the step between them."""
        times = start + whole * np.linspace(0, 1, count)
        step = largest_step(scene, motion, times)
        step += parallax_step(scene, simulator.camera, motion, times)
        if moving:  # the path of an actor at the camera's magnification, and the camera's
            step += moving.farthest(times) * max(motion.at(time).zoom for time in times)
        return times, probes.between(step, step * (count - 1) * seconds / whole), step

    counts = [count for count in COUNTS if count <= MOST_PICTURES or not can_smear]
    for count in [instants] if instants else counts:
        times, wrong, step = error_of(count)
        is_met = bool(instants) or not step or is_enough(wrong, step)
        if is_met:
            break
    ratio, words = scene.samples_per_pixel, ""
    smeared = None
    if must_smear or (can_smear and step and count > FEW):
        path = Path(scene, motion, start, seconds, sensor.row_time, flicker)
        pictures = count if is_met and not must_smear else None
        smeared = _smear(simulator, probes, path, is_enough, pictures)
    if smeared is not None:
        mean, wrong, resampled, words = smeared
        exposure = expose_moving(simulator, [mean], [start], seconds, start, gain, flicker, plan)
    else:
        times = times if step else times[:1]
        scenes = [moving.at(time) if moving else scene for time in times]
        seen = []
        if travels:
            seen = [
                see_from(one, simulator.camera, motion.place(time))
                for one, time in zip(scenes, times, strict=True)
            ]
            scenes = [one.scene for one in seen]
        scenes = [one.viewed(motion.at(time)) for one, time in zip(scenes, times, strict=True)]
        exposure = expose_moving(simulator, scenes, times, seconds, start, gain, flicker, plan)
        views = [one.view for one in scenes]
        between = next((view for view in views if not view.is_whole(ratio)), views[0])
        resampled = probes.resampling_error(between, ratio)
    account = exposure.plan.account
    bounds = account.bounds | {"view": resampled, "shutter": wrong}
    if travels:
        settings = simulator, exposure, ratio
        bounds["surfaces that were hidden"] = _bound(
            guess_error, np.mean([one.guessed for one in seen], 0), *settings
        )
        moved = _bound(between_error, np.mean([one.between for one in seen], 0), *settings)
        bounds["view"] = sum_errors([resampled, moved])
    account, models = dataclasses.replace(account, bounds=bounds), exposure.plan.models
    if words:
        models = models | {"sensor.shutter": f"{words}; {models['sensor.shutter']}"}
    changed = dataclasses.replace(exposure.plan, account=account, models=models)
    return dataclasses.replace(exposure, plan=changed)


def _bound(error_of, values, simulator, exposure, ratio):
    """Return the bound that `error_of` (values, mean, sigma) gives for each pixel. values: of each sample."""
    mean = np.asarray(exposure.mean, np.float64)
    rows, cols = ((np.arange(n) + 0.5) * ratio for n in mean.shape[-2:])
    margin = [(own - ratio * n) / 2 for own, n in zip(values.shape, mean.shape[-2:], strict=True)]
    y, x = (
        np.clip((part + more).astype(int), 0, n - 1)
        for part, more, n in zip((rows, cols), margin, values.shape, strict=True)
    )
    sigma = np.sqrt(np.maximum(mean + simulator.camera.sensor.read_sigma**2, 1))
    return error_of(values[np.ix_(y, x)], mean, sigma)


def parallax_step(scene: Scene, camera: Camera, motion: Motion, times) -> float:
    """Return the largest step that the nearest surface makes between two of these times [sample].

    Args:
        scene: The scene, with depth.
        camera: The camera.
        motion: Its motion.
        times: Times [s].

    Returns:
        The step.
    """
    if scene.depth is None or not any(motion.travel):
        return 0.0  # without depth `see_from` refuses it
    near = min(
        float(np.min(one)) for one in (scene.depth, *(layer.depth for layer in scene.layers))
    )
    moves = np.diff([motion.place(time) for time in times], axis=0)
    near -= max(0.0, max(motion.place(time)[2] for time in times))
    sideways = samples_per_radian(scene, camera) * np.hypot(moves[:, 0], moves[:, 1])
    ahead = np.abs(moves[:, 2]) * np.hypot(*scene.samples) / 2
    return float(((sideways + ahead) / max(near, 1e-9)).max(initial=0))


def _smear(simulator, probes, path, is_enough, pictures):
    """Return a scene of the mean light along a path, its two errors and words for it; None if pictures are better.

    pictures: number of pictures that would do, or None if so many do not.
    """
    device, distortion = simulator.device, simulator.camera.optics.distortion
    displaced = 0.0
    if distortion is not None and path.row_time:
        pitch, ratio = simulator.camera.sensor.pixel_pitch, path.scene.samples_per_pixel
        fitted = fit_to_frame(distortion, path.scene.shape, pitch)
        grid = distortion_grid(fitted, path.scene.samples, pitch / ratio)
        displaced = float(np.abs(grid.nodes[..., 0]).max())
    sheared = path.shear_error(probes, displaced)

    def does(bound, step=0.0):
        if simulator.tolerance is None:
            return bound.rms <= EXACT and step <= STEP
        return is_enough(bound, step)

    shape, length = path.shape_error(probes), f"a path of {path.length:.3g} samples"
    bound = sum_errors([shape, sheared])
    # no smear errs less if the rows err too much
    if does(bound) or (pictures is None and does(shape) and not does(sheared)):
        resampled = path.view_error(probes, True)
        for is_whole in (False, True):
            cut = sum_errors([bound, path.cut_error(probes, is_whole)])
            if simulator.tolerance is not None and is_enough(cut):
                break
        smeared = convolve(device, path, is_whole)
        return smeared, cut, resampled, f"{length}: one transfer function"
    if pictures is not None and not does(sheared):
        return None
    for count in VIEWS:
        step = path.length / (count - 1)
        between = probes.between(step, path.length)
        bound = sum_errors([between, sheared])
        if does(bound, step) or (step <= STEP and not does(sheared)):
            break
    if pictures is not None and count * len(path.scene.content.planes) > WORK * pictures:
        return None
    resampled = path.view_error(probes, False)
    return accumulate(device, path, count), bound, resampled, f"{length}: the sum of {count} views"


def largest_step(scene, motion, times):
    """Return the camera's largest step between two of these times in the frame [sample]."""
    y = np.array((-0.5, 0.5))[:, None] * scene.samples[0]
    x = np.array((-0.5, 0.5)) * scene.samples[1]
    views = [motion.at(time) for time in times]
    places = [np.broadcast_arrays(*view.place(y, x, scene.samples_per_pixel)) for view in views]
    zoom = max(view.zoom for view in views)  # samples of the frame per sample of the scene
    steps = np.diff(np.array(places), axis=0).swapaxes(0, 1)
    return float(np.hypot(*steps).max(initial=0)) * zoom
