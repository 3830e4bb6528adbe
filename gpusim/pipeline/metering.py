"""Automatic exposure: the light is looked at on the device, the exposure time and the gain are chosen on the host."""

from math import prod

import numpy as np

from gpusim.domain.exposure import LightStatistics
from gpusim.kernels.sensor.meter import meter


def metered_by(simulator) -> tuple:
    """What an exposure time depends on beside the plan."""
    sensor, noise = simulator.camera.sensor, simulator.camera.sensor.noise
    return (
        sensor.exposure_time,
        sensor.auto_exposure,
        noise.dark_current * noise.warmth,
        simulator.readout.output.saturation,
        simulator.readout.pixels,
    )


def light_of(simulator, electrons):
    """Statistics of electrons (rows, cols) or (C, rows, cols), on the device: see `sensor.meter`."""
    shape, automatic, device = (
        electrons.shape,
        simulator.camera.sensor.auto_exposure,
        simulator.device,
    )
    weights = simulator.kept("weights of metering", tuple(shape), lambda: automatic.weights(shape))
    flat = device.reshape(electrons, (prod(shape[:-1]), shape[-1]))
    return meter(flat, *weights, automatic.fractions, device=device)


def metered(simulator, rates) -> tuple[float, float]:
    """Exposure time [s] and analog gain that automatic exposure chooses for electrons per second, see `chosen`."""
    return chosen(simulator, simulator.device.numpy(light_of(simulator, rates)), rates.shape)


def chosen(simulator, light, shape, seconds: float = 1.0) -> tuple[float, float]:
    """The same by what `light_of` gave, read by the host, of the electrons of `seconds` [s], shape (..., rows, cols).

    Raises BadData for a scene without light, or with light that is not finite.
    """
    sensor, readout = simulator.camera.sensor, simulator.readout
    dark = sensor.noise.dark_current * sensor.noise.warmth  # fills the well as light does
    rates = LightStatistics(np.array(light), prod(shape)).over(seconds).plus(dark)
    return sensor.auto_exposure.choose(rates, readout.output.saturation / readout.pixels)
