"""Signal-to-noise ratios: of an even patch, as visible to the eye, and of a sensor."""

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.data.colorimetry import xyz
from gpusim.data.lights import light_of
from gpusim.data.weights import product_weights
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.measure.difference import blur_as_eye, cielab, xyz_and_white

# part of rows and columns used: noise of the mirrored picture is less blurred at borders
MIDDLE = 0.8


POINTS = 200  # points of a curve
DECADES = 5.0  # decades of light below saturation in a curve


@dataclass(frozen=True, eq=False)
class SnrCurve:
    """Signal-to-noise ratio of a sensor in even light, C channels at N exposures.

    Above saturation `electrons` and `snr` keep their value there, the channel's SNR_max of EMVA
    1288, as the curves of the standard and of ISETCam end there: a full pixel collects no more
    light, and clipping of the noise does not improve its value.

    Attributes:
        exposure: exposure of the sensor's surface, rising, shape (N,) [lx s].
        electrons: mean electrons from light only, at most the pixel's capacity, shape (C, N) [e-].
        snr: electrons over the standard deviation of a raw value, shape (C, N) [dB]; -inf for a
            channel without sensitivity to the light.
        saturation: exposure at which each channel saturates, shape (C,) [lx s]; inf for a channel
            without sensitivity to the light.
    """

    exposure: np.ndarray
    electrons: np.ndarray
    snr: np.ndarray
    saturation: np.ndarray


def snr_curve(
    sensor: Sensor, light: str | Spectrum = "D65", *, seconds: float = 0.0, temporal: bool = False
) -> SnrCurve:
    """Return the expected signal-to-noise ratio of each channel against exposure.

    The curve ends at the saturation of the last channel.

    Source: EMVA Standard 1288, SNR = mu / sigma of `gpusim.domain.raw_noise.RawNoise`; electrons
    follow from the sensor's quantum efficiency over its aperture.

    Args:
        sensor: the sensor.
        light: name of an illuminant, or its relative power in energy units.
        seconds: time during which dark current is collected [s].
        temporal: leave out the fixed patterns (PRNU, DSNU), as in the difference of two frames.

    Returns:
        The curve.

    Raises:
        UnknownName: if the illuminant is unknown.
        OutOfRange: if `seconds` is negative or not finite.
        BadData: if the sensor does not respond to the light, or dark current fills the pixel.
    """
    dark, room = _dark_and_room(sensor, seconds, "snr_curve")
    light = light_of(light)
    per_exposure = electrons_per_lux_second(sensor, light)
    if not per_exposure.any():
        raise BadData(f"snr_curve: the sensor does not respond to {light.name or 'the light'}")
    with np.errstate(divide="ignore"):
        saturation = room / per_exposure
    ends = saturation[np.isfinite(saturation)]
    even = np.geomspace(ends.max() * 10**-DECADES, ends.max(), POINTS)
    exposure = np.union1d(even, ends)
    electrons = np.minimum(np.outer(per_exposure, exposure), room)
    noise = RawNoise.of(sensor)
    variance = noise.variance(electrons + dark, temporal=temporal)
    if not temporal:
        variance = variance + (noise.response + noise.line_response) * electrons**2
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(electrons > 0, 20 * np.log10(electrons) - 10 * np.log10(variance), -np.inf)
    return SnrCurve(exposure, electrons, found, saturation)


def dynamic_range(sensor: Sensor, *, seconds: float = 0.0) -> float:
    """Return the expected dynamic range of a sensor: saturation over the least signal.

    The least signal has an SNR of 1: dark noise + 1/2 electron.

    Source: EMVA Standard 1288, DR = mu_p.sat / mu_p.min; dark noise of
    `gpusim.domain.raw_noise.RawNoise`, temporal.

    Args:
        sensor: the sensor.
        seconds: time during which dark current is collected [s].

    Returns:
        Dynamic range [dB].

    Raises:
        OutOfRange: if `seconds` is negative or not finite.
        BadData: if dark current fills the pixel.
    """
    dark, room = _dark_and_room(sensor, seconds, "dynamic_range")
    noise = RawNoise.of(sensor).variance(dark, temporal=True) ** 0.5
    return float(20 * np.log10(room / (noise + 0.5)))


def _dark_and_room(sensor: Sensor, seconds: float, name: str) -> tuple[float, float]:
    """Return the electrons of dark current, and the capacity that they leave. Raises OutOfRange, BadData."""
    if not (isinstance(seconds, Real) and 0 <= seconds < np.inf):
        raise OutOfRange("seconds", f"{seconds} s", "0 <= seconds < inf")
    dark = sensor.noise.operating_dark_current * seconds
    room = sensor.saturation - dark
    if not room > 0:
        raise BadData(
            f"{name}: {dark:.4g} e- of dark current in {seconds:g} s fill the pixel's "
            f"{sensor.saturation:.4g} e-; wanted fewer seconds"
        )
    return dark, room


def electrons_per_lux_second(sensor: Sensor, light: Spectrum) -> np.ndarray:
    """Return the electrons per pixel of each channel from 1 lx s of a light, shape (C,).

    light: relative power in energy units.
    """
    first = max(light.wavelengths[0], sensor.qe.wavelengths[0])
    last = min(light.wavelengths[-1], sensor.qe.wavelengths[-1])
    if not first < last:
        return np.zeros(len(sensor.channels))
    height, width = sensor.aperture
    photons = product_weights([first, last], photons_from_energy(light), sensor.qe).sum(-1)
    return height * width * photons / xyz(light)[1]


def snr(patch: ArrayLike, second: ArrayLike | None = None) -> Any:
    """Return the signal-to-noise ratio, 20 log10(mean / standard deviation).

    Args:
        patch: values of even light, proportional to it (black level subtracted), shape (rows,
            cols), or (rows, cols, C) for one ratio per channel.
        second: another frame of the same patch. The noise is then taken from their difference over
            sqrt(2): temporal noise only, without the pattern that both share.

    Returns:
        The ratio [dB], infinite without noise: a float, or an array (C,).

    Raises:
        BadData: if shapes or types do not fit, or the mean is not above 0.
    """
    patch = _numbers(patch, "patch")
    mean, noise = patch.mean(axis=(0, 1)), patch.std(axis=(0, 1), ddof=1)
    if second is not None:
        second = _numbers(second, "second")
        if second.shape != patch.shape:
            raise BadData(f"snr: frames of different shapes, {patch.shape} and {second.shape}")
        mean = (mean + second.mean(axis=(0, 1))) / 2
        noise = (patch - second).std(axis=(0, 1), ddof=1) / np.sqrt(2)
    if not np.all(mean > 0):
        raise BadData(
            f"snr: mean {np.min(mean):.4g}: wanted a mean above 0 after subtracting the black level"
        )
    with np.errstate(divide="ignore"):
        found = 20 * np.log10(mean / noise)
    return float(found) if found.ndim == 0 else found


def visible_snr(patch: Any, samples_per_degree: float, white: ArrayLike | None = None) -> float:
    """Return the visible SNR: one over the standard deviation of an even patch in S-CIELAB.

    Source: Farrell, Okincha, Parmar & Wandell 2010, "Using visible SNR (vSNR) to compare the image
    quality of pixel binning and digital resizing", Proc. SPIE 7537: 1 / sqrt(var L* + var a* + var
    b*).

    Args:
        patch: patch of one colour: a frame, its exposure divided out (see
            `gpusim.measure.ciede2000`), or XYZ (rows, cols, 3) with white Y about 1.
        samples_per_degree: pixels per degree of visual angle, see
            `gpusim.measure.samples_per_degree`.
        white: XYZ of the white, shape (3,); None is the display's, sRGB's if there is no frame.

    Returns:
        Visible SNR [1 / Delta E], infinite without noise.

    Raises:
        BadData: if the patch is too small or its values are wrong.
        OutOfRange: if `samples_per_degree` is not positive.
    """
    xyz, white = xyz_and_white(patch, white)
    lab = cielab(blur_as_eye(xyz, samples_per_degree), white)
    rows, cols = (round((1 - MIDDLE) / 2 * count) for count in lab.shape[:2])
    middle = lab[rows : lab.shape[0] - rows, cols : lab.shape[1] - cols]
    if middle[..., 0].size < 2:
        raise BadData(
            f"visible_snr: patch of {lab.shape[0]} x {lab.shape[1]} pixels, wanted 2 or more"
        )
    spread = np.sqrt(middle.var(axis=(0, 1), ddof=1).sum())
    return float(1 / spread) if spread > 0 else np.inf


def _numbers(values, name) -> np.ndarray:
    values = np.asarray(values)
    is_picture = values.ndim in (2, 3) and values.dtype.kind in "uif"
    if not is_picture or values.shape[0] * values.shape[1] < 2:
        raise BadData(
            f"snr: {name} of shape {values.shape} and type {values.dtype}; wanted numbers (rows, cols) or "
            "(rows, cols, channels), 2 pixels or more"
        )
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        raise BadData(f"snr: {name}: NaN or infinite values")
    return values
