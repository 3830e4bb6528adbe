"""ISO speed: the light that saturates a camera's pixels, in the photographic scale."""

from collections.abc import Callable
from dataclasses import replace
from math import prod
from typing import Any, Literal

import numpy as np

from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant
from gpusim.data.weights import product_weights
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.spectrum import photons_from_energy
from gpusim.optics.lenses import lens_of

LIGHT = "D55"  # daylight of ISO 7589, which ISO 12232 prescribes
# [lx s] The exposure 10 / S of a mean scene is 12.8 % of saturation: 18 % minus half a stop.
SATURATION_SPEED = 78.0
MOST_GAIN = 1e4  # largest `Sensor.analog_gain`


def electrons_per_exposure(sensor: Sensor) -> float:
    """Return electrons of the most sensitive channel per luminous exposure [e- lx-1 s-1].

    The light is D55 at the sensor. For the irradiance E(lambda) [W m-2 nm-1] and the area A of a
    pixel's aperture, the value is

        A int qe(lambda) E(lambda) lambda / (h c) dlambda / (683 lm/W int V(lambda) E(lambda)
        dlambda).

    All light that the sensor sees counts, also infrared if nothing blocks it. The lens is not part
    of it.
    """
    light = illuminant(LIGHT)
    low, high = light.wavelengths[[0, -1]]
    if sensor.qe.wavelengths[-1] <= low or sensor.qe.wavelengths[0] >= high:
        return 0.0
    photons = product_weights([low, high], sensor.qe, photons_from_energy(light)).sum(axis=-1).max()
    return float(prod(sensor.aperture) * photons / xyz(light)[1])


def iso_speed(sensor: Sensor) -> float:
    """Return the saturation-based ISO speed at the sensor's analog gain, S = 78 / H.

    H is the luminous exposure [lx s] of D55 at which the most sensitive channel saturates, in its
    full well or the converter; for pixels binned as charge, in their node. The result is not
    rounded to the steps of the standard. It is 0 if the sensor does not see daylight.

    Source: ISO 12232:2019, saturation-based speed.
    """
    return SATURATION_SPEED * electrons_per_exposure(sensor) / _saturation(sensor)


def gain_for_speed(sensor: Sensor, speed: float) -> float:
    """Return the analog gain [1] with which the sensor has an ISO speed.

    The lowest speed is the base speed, with an analog gain of 1.

    Args:
        sensor: The sensor.
        speed: ISO speed [1].

    Returns:
        Analog gain [1].

    Raises:
        BadData: The sensor does not see daylight.
        OutOfRange: The speed is below the base speed, or needs too large a gain.
    """
    return gains_of(sensor)(speed)


def gains_of(sensor: Sensor) -> Callable[[float], float]:
    """Return the function `gain_for_speed` of one sensor, for many speeds."""
    unity = replace(sensor, analog_gain=1.0)
    base, saturation, pixels = iso_speed(unity), _saturation(unity), _pixels_per_node(sensor)
    span = (sensor.white_level - sensor.black_level) / _node(unity).gain_dn_per_electron  # [e-]

    def gain(speed: float) -> float:
        if not base:
            raise BadData(
                f"iso = {speed:.6g}: the sensor does not see {LIGHT}, so it has no ISO speed"
            )
        if sensor.bits == FLOAT_BITS:
            raise OutOfRange(
                "iso", f"{speed:.6g}", f"none: without a converter it is {base:.4g} at every gain"
            )
        # electrons at which a pixel shall saturate
        electrons = saturation * base / speed if speed >= base else np.inf
        node = electrons * pixels + sensor.analog_offset
        if not span / MOST_GAIN <= node < np.inf:
            raise OutOfRange(
                "iso",
                f"{speed:.6g}",
                f"{_round_up(base):g}, this sensor's base speed, or more, up to an analog "
                f"gain of {MOST_GAIN:g}",
            )
        return span / node

    return gain


def _pixels_per_node(sensor):
    """Return the number of pixels whose electrons are added to one value."""
    return prod(sensor.binning) if sensor.binning_mode == "charge" else 1


def _node(sensor):
    """Return the sensor as its electronics sees it, with the full wells of all added pixels."""
    return replace(sensor, full_well=sensor.full_well * _pixels_per_node(sensor), binning=(1, 1))


def _saturation(sensor):
    """Return the electrons of one pixel at which its value stops rising."""
    return _node(sensor).saturation / _pixels_per_node(sensor)


def _round_up(speed):
    """Round up to four digits: a speed that a message allows must not be refused."""
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
    demosaic: str | None = None,
    denoise: float | None = None,
    white_balance: str | None = None,
    look: str | None = None,
) -> Camera:
    """Return the camera with other settings of its controls; None leaves a setting as it is.

    Args:
        camera: The camera.
        exposure: Exposure time [s], or "auto".
        iso: ISO speed [1]. Automatic exposure then does not raise the gain.
        f_number: F-number [1].
        focus: Distance of the plane in focus [m].
        scaling: See `Processor`.
        demosaic: See `Processor`. The camera's table goes, unless it is "learned".
        denoise: See `Processor`.
        white_balance: See `Processor`. The camera's preset white goes, unless it is "preset".
        look: See `Processor`.

    Returns:
        The camera with these settings.

    Raises:
        BadData: f_number or focus for a lens of measured point spreads, or a sensor without ISO
            speed.
        OutOfRange: A setting is outside its range, or does not suit the camera.
        UnknownName: The name of a method is not known.
    """
    optics, sensor, processor = camera.optics, camera.sensor, camera.processor
    if exposure is not None:
        sensor = replace(sensor, exposure_time=None if isinstance(exposure, str) else exposure)
    if iso is not None:  # a fixed speed: automatic exposure must not raise the gain
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
    picture: dict[str, Any] = {"scaling": scaling, "demosaic": demosaic, "denoise": denoise}
    picture |= {"white_balance": white_balance, "look": look}
    picture = {key: value for key, value in picture.items() if value is not None}
    if picture.get("demosaic", "learned") != "learned":
        picture["table"] = None
    if picture.get("white_balance", "preset") != "preset":
        picture["white"] = ()
    processor = replace(processor, **picture)
    return replace(camera, optics=replace(optics, **lens), sensor=sensor, processor=processor)
