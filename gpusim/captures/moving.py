"""What moves, before a rolling shutter."""

import dataclasses
from collections.abc import Iterable
from math import prod
from time import perf_counter

import numpy as np

from gpusim.domain.errors import BadData, DoesNotFit
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.scene import checked_scene
from gpusim.frame import Exposure
from gpusim.kernels.sensor.shutter import shutter
from gpusim.planner.shutter import shutter_weights
from gpusim.program.kept import Kept
from gpusim.program.metering import metered
from gpusim.program.program import exposed
from gpusim.simulator import Simulator


def expose_moving(simulator: Simulator, scenes, times, exposure_time: float | None = None, start: float = 0.0,
                  gain: float = 1.0) -> Exposure:
    """Mean electrons of a scene that moves, or of a camera that does: rows are exposed one after the other.

    scenes: pictures of it at the instants `times` [s], all of one size; between them the light changes linearly.
    start: when the first row opens [s]; row y opens y row_time of the sensor later. Automatic exposure meters the
    first scene; gain: as for `Simulator.expose`. Raises as `Simulator.expose` does, and BadData, OutOfRange for times
    that do not cover the exposure.
    """
    checked_time(exposure_time)
    checked_gain(gain)
    if not isinstance(scenes, Iterable):
        raise BadData(f"moving scene: {type(scenes).__name__}, wanted several scenes, such as [scene]")
    scenes, begun = [checked_scene(scene) for scene in scenes], perf_counter()
    device, imaging, sensor = simulator.device, simulator.imaging, simulator.camera.sensor
    if not scenes or len(scenes) != len(np.atleast_1d(times)):
        raise BadData(f"moving scene: {len(scenes)} scenes and {len(np.atleast_1d(times))} times; wanted as many, "
                      "one or more")
    if len({scene.shape for scene in scenes}) > 1:
        raise BadData("moving scene: the scenes differ in size")
    plans = [simulator.plan(scene) for scene in scenes]
    held = 8 * len(scenes) * prod(scenes[0].shape) * len(plans[0].weights)  # the pictures, and once more together
    if held > device.memory:
        raise DoesNotFit(f"a moving scene of {len(scenes)} pictures", held, device.memory, device.name)
    with device.timed() as ms:
        rates = [imaging.exposed(plan, imaging.rates(plan), 1.0) for plan in plans]
        shape = rates[0].shape
        exposure_time = sensor.exposure_time if exposure_time is None else exposure_time
        if exposure_time is None:
            exposure_time, gain = metered(simulator, rates[0])
        weights = shutter_weights(times, shape[-2], exposure_time, sensor.row_time, start)
        layers = prod(shape[:-2])  # of stacked pixels, one below the other
        stacked = device.reshape(device.stack(rates), (len(rates), layers * shape[-2], shape[-1]))
        mean = shutter(stacked, np.tile(weights, (layers, 1)), device=device)
        model = f"{len(scenes)} pictures, rows {1e6 * sensor.row_time:g} us apart"
        plan = dataclasses.replace(plans[0], models=plans[0].models | {"sensor.shutter": model})
        exposure = exposed(simulator, plan, device.reshape(mean, shape), exposure_time, gain, Kept())
    return dataclasses.replace(exposure, ms=dict(ms), wall_ms=1e3 * (perf_counter() - begun))
