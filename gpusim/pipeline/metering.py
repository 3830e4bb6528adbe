"""Automatic exposure: the device computes statistics of the light, the host chooses exposure time and gain."""

from functools import partial
from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.exposure import AutoExposure, LightStatistics
from gpusim.domain.sensor import Sensor
from gpusim.kernels.sensor.meter import meter
from gpusim.kernels.spectral.survey import survey
from gpusim.optics.fusion import Watch
from gpusim.pipeline.readout import Readout
from gpusim.pipeline.step import Rate, Step
from gpusim.planner.plan import Plan


def metering_steps(plan: Plan, sensor: Sensor, readout: Readout) -> list[Step]:
    """Return the steps that measure the light.

    They make "metered" (exposure time [s] and gain for the electrons "per second"), "light" (statistics of the mean
    electrons), "metered light" (with quantiles, for the next exposure) and "survey" (the input of the plan's Watch for
    another scene).
    """
    device = readout.device
    automatic, content = sensor.auto_exposure, plan.content
    layers = len(sensor.channels) if sensor.stacked else 1
    look = partial(
        Step,
        stage="sensor.meter",
        constants={"automatic": automatic, "device": device},
        rate=Rate.EXPOSURE,
        work=float(prod(plan.scene.shape) * layers),
    )
    steps = [
        look("light per second", inputs=("per second",), run=meter_light),
        look("metered light", inputs=("mean",), run=meter_light),
        look("light", inputs=("mean",), run=measure_light),
        Step(
            "metered",
            "",
            ("light per second",),
            {
                **metering_numbers(sensor, readout),
                "pixels": layers * prod(plan.scene.shape),
                "device": device,
            },
            ("brightness",),
            rate=Rate.EXPOSURE,
            host="a single picture waits for a few numbers of its exposure; in a stream they come a frame late",
            run=choose_exposure,
        ),
    ]
    if watch := plan.find(Watch):
        entries = 1 if content.labels is not None else len(content.entry_spectra)
        steps.append(
            Step(
                "survey",
                "spectral.survey",
                ("entries",),
                {
                    "table": watch.table,
                    "first": watch.first,
                    "scale": watch.scale,
                    "device": device,
                },
                work=float(len(watch.first) * content.shape[1] * entries),
                run=survey_entries,
            )
        )
    return steps


def metering_numbers(sensor: Sensor, readout: Readout) -> dict:
    """Return the keyword arguments of `choose_exposure` that come from the sensor."""
    return {
        "automatic": sensor.auto_exposure,
        "dark": sensor.noise.operating_dark_current,  # fills the well like light
        "saturation": readout.output.saturation / readout.pixels,
    }


def meter_light(electrons: Any, *, automatic: AutoExposure, device) -> Any:
    """Return statistics of electrons (rows, cols) or (C, rows, cols), on the device: see `sensor.meter`."""
    return _meter(electrons, automatic, automatic.fractions, device)


def measure_light(electrons: Any, *, automatic: AutoExposure, device) -> Any:
    """Return the same without quantiles, which take most of the time and only automatic exposure needs."""
    return _meter(electrons, automatic, (), device)


def _meter(electrons, automatic, fractions, device):
    shape = tuple(electrons.shape)
    flat = device.reshape(electrons, (prod(shape[:-1]), shape[-1]))
    return meter(flat, *automatic.weights(shape), fractions, device=device)


def choose_exposure(
    light: Any,
    pixels: int,
    seconds: float = 1.0,
    *,
    automatic: AutoExposure,
    dark: float,
    saturation: float,
    brightness: float = 1.0,
    device: Device | None = None,
) -> tuple[float, float]:
    """Return the exposure time [s] and analog gain that automatic exposure chooses.

    Args:
        light: Statistics from `meter_light`.
        pixels: Number of pixels that were metered.
        seconds: Exposure time of the metered electrons [s].
        automatic: Rules of automatic exposure.
        dark: Dark current [e- s-1].
        saturation: Electrons at saturation [e-].
        brightness: Factor on the metered electrons [1].
        device: Device that holds the statistics; None: they are on the host.

    Returns:
        Exposure time [s] and analog gain [1].

    Raises:
        BadData: The scene has no light, or light that is not finite.
    """
    light = light if device is None else device.numpy(light)
    rates = LightStatistics(np.array(light), pixels).over(seconds / brightness).plus(dark)
    return automatic.choose(rates, saturation)


def survey_entries(stored: tuple, *, table, first, scale, device) -> Any:
    """Return the survey of a scene's samples on the device: see `spectral.survey`."""
    entries, labels = stored
    return survey(entries, table, first, labels, scale, device=device)
