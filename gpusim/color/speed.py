"""ISO speed: what light saturates a camera's pixels, as photographers count it."""

from dataclasses import replace
from math import prod
from typing import Any, Literal

import numpy as np

from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.spectrum import photons_from_energy
from gpusim.optics.lens import lens_of
from gpusim.optics.weights import product_weights

LIGHT = "D55"  # daylight of ISO 7589, which ISO 12232 prescribes
SATURATION_SPEED = (
    78.0  # [lx s]: the 10 / S of a mean scene are 12.8 % of saturation, 18 % less half a stop
)
MOST_GAIN = 1e4  # of `Sensor.analog_gain`


def electrons_per_exposure(sensor: Sensor) -> float:
    """Electrons of the most sensitive channel per luminous exposure of D55 at the sensor [e- lx-1 s-1].

    For the irradiance E(lambda) [W m-2 nm-1], with the area A of a pixel's aperture,

        A int qe(lambda) E(lambda) lambda / (h c) dlambda / (683 lm/W int V(lambda) E(lambda) dlambda).

    All light that the sensor sees counts, so also infrared where nothing cuts it. The lens is not part of it.
    """
    light = illuminant(LIGHT)
    low, high = light.wavelengths[[0, -1]]
    if sensor.qe.wavelengths[-1] <= low or sensor.qe.wavelengths[0] >= high:
        return 0.0
    photons = product_weights([low, high], sensor.qe, photons_from_energy(light)).sum(axis=-1).max()
    return float(prod(sensor.aperture) * photons / xyz(light)[1])


def iso_speed(sensor: Sensor) -> float:
    """Saturation-based ISO speed at the sensor's analog gain, S = 78 / H; 0 if it does not see daylight.

    H is the luminous exposure [lx s] of D55 at which the most sensitive channel saturates: its full well, or the
    converter. Of pixels binned by charge, the node's. Nothing is rounded to the standard's steps.
    Source: ISO 12232:2019, saturation-based speed.
    """
    return SATURATION_SPEED * electrons_per_exposure(sensor) / _saturation(sensor)


def gain_for_speed(sensor: Sensor, speed: float) -> float:
    """Analog gain [1] at which the sensor has an ISO speed: the converter's range then ends where that asks.

    The least is the base speed, that at an analog gain of 1. Raises OutOfRange and, for a sensor that does not see
    daylight, BadData.
    """
    unity = replace(sensor, analog_gain=1.0)
    base = iso_speed(unity)
    if not base:
        raise BadData(
            f"iso = {speed:.6g}: the sensor's efficiency leaves nothing of {LIGHT}, so it has no ISO speed"
        )
    if sensor.bits == FLOAT_BITS:
        raise OutOfRange(
            "iso", f"{speed:.6g}", f"none: without a converter it is {base:.4g} at every gain"
        )
    electrons = (
        _saturation(unity) * base / speed if speed >= base else np.inf
    )  # of a pixel, where it shall saturate
    node = electrons * _added(sensor) + sensor.analog_offset
    span = (sensor.white_level - sensor.black_level) / _node(unity).gain_dn_per_electron  # [e-]
    if not span / MOST_GAIN <= node < np.inf:
        raise OutOfRange(
            "iso",
            f"{speed:.6g}",
            f"{_up(base):g}, this sensor's base speed, or more, up to an analog "
            f"gain of {MOST_GAIN:g}",
        )
    return span / node


def _added(sensor):
    """Pixels whose electrons one value has."""
    return prod(sensor.binning) if sensor.binning_mode == "charge" else 1


def _node(sensor):
    """The sensor that the electronics sees: as many full wells as are added."""
    return replace(sensor, full_well=sensor.full_well * _added(sensor), binning=(1, 1))


def _saturation(sensor):
    """Electrons of one pixel at which its value stops rising."""
    return _node(sensor).saturation / _added(sensor)


def _up(speed):
    """Rounded up to four digits: what a message allows must not be refused."""
    step = 10.0 ** (np.floor(np.log10(speed)) - 3)
    return np.ceil(speed / step) * step


def operate_camera(
    camera: Camera,
    *,
    exposure: float | Literal["auto"] | None = None,
    iso: float | None = None,
    f_number: float | None = None,
    focus: float | None = None,
    scaling: str | None = None,
) -> Camera:
    """Return the camera with other settings of its controls; None leaves one as it is.

    exposure: [s], or "auto". iso: speed. focus: distance of what is in focus [m]. scaling: of the processor. Raises
    BadData for a lens of measured point spreads, and OutOfRange.
    """
    optics, sensor, processor = camera.optics, camera.sensor, camera.processor
    if exposure is not None:
        sensor = replace(sensor, exposure_time=None if isinstance(exposure, str) else exposure)
    if (
        iso is not None
    ):  # the speed that was asked for: automatic exposure raises no gain on its own
        sensor = replace(
            sensor,
            analog_gain=gain_for_speed(sensor, iso),
            auto_exposure=replace(sensor.auto_exposure, most_gain=1.0),
        )
    lens: dict[str, Any] = {"f_number": f_number, "object_distance": focus}
    lens = {key: value for key, value in lens.items() if value is not None}
    if lens and not lens_of(camera).is_adjustable:
        raise BadData(
            "--f-number, --focus: the camera's point spreads are measured, at one f-number and focus; wanted "
            "neither, or a camera without [optics] psf"
        )
    if scaling is not None:
        processor = replace(processor, scaling=scaling)
    return replace(camera, optics=replace(optics, **lens), sensor=sensor, processor=processor)
