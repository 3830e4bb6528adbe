"""Signal to noise of an evenly lit patch, as numbers and as the eye sees it, and of a sensor at every exposure."""

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from gpusim.data.colorimetry import xyz
from gpusim.data.lights import light_of
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.measure.difference import cielab, eye_filtered, shown
from gpusim.optics.weights import product_weights

MIDDLE = 0.8  # part of rows and columns that is judged: at the border a mirrored picture's noise is less blurred


POINTS = 200  # of a curve
DECADES = 5.0  # of light below saturation that a curve has


@dataclass(frozen=True, eq=False)
class SnrCurve:
    """What a sensor's noise leaves of even light, C channels at N exposures.

    exposure: of the sensor's surface [lx s], rising, shape (N,). electrons: mean, of the light alone [e-], shape
    (C, N), at most what the pixel holds. snr: electrons over the standard deviation of a raw value around them [dB],
    shape (C, N); -inf for a channel that sees nothing. saturation: exposure at which each channel saturates [lx s],
    shape (C,), inf for such a channel. Above it electrons and snr stay what they are there, the channel's SNR_max of
    EMVA 1288, whose curves end there as ISETCam's do: a pixel that is full has seen no more light, and the noise that
    clipping cuts off does not make its value a better one.
    """

    exposure: np.ndarray
    electrons: np.ndarray
    snr: np.ndarray
    saturation: np.ndarray


def snr_curve(
    sensor: Sensor, light: str | Spectrum = "D65", *, seconds: float = 0.0, temporal: bool = False
) -> SnrCurve:
    """Signal to noise ratio that is expected of each channel against the exposure, up to saturation of the last.

    light: name of an illuminant, or its relative power in energy units. seconds: in which the dark current is
    collected [s]. temporal: without the fixed patterns (PRNU, DSNU), as of the difference of two frames.
    Source: EMVA Standard 1288, SNR = mu / sigma of `gpusim.domain.raw_noise.RawNoise`; electrons are those of the
    sensor's quantum efficiency over its aperture. Raises UnknownName, OutOfRange, BadData.
    """
    if not (isinstance(seconds, Real) and 0 <= seconds < np.inf):
        raise OutOfRange("seconds", f"{seconds} s", "0 <= seconds < inf")
    light = light_of(light)
    per_exposure = electrons_per_lux_second(sensor, light)
    if not per_exposure.any():
        raise BadData(f"snr_curve: the sensor sees nothing of {light.name or 'the light'}")
    dark = sensor.noise.dark_current * sensor.noise.warmth * seconds
    room = sensor.saturation - dark
    if not room > 0:
        raise BadData(
            f"snr_curve: {dark:.4g} e- of dark current in {seconds:g} s fill the {sensor.saturation:.4g} e- "
            "that a pixel holds; wanted fewer seconds"
        )
    with np.errstate(divide="ignore"):
        saturation = room / per_exposure
    most = saturation[np.isfinite(saturation)].max()
    exposure = np.union1d(
        np.geomspace(most * 10**-DECADES, most, POINTS), saturation[np.isfinite(saturation)]
    )
    electrons = np.minimum(np.outer(per_exposure, exposure), room)
    noise = RawNoise.of(sensor)
    variance = noise.variance(electrons + dark, temporal=temporal)
    if not temporal:
        variance = variance + (noise.response + noise.line_response) * electrons**2
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(electrons > 0, 20 * np.log10(electrons) - 10 * np.log10(variance), -np.inf)
    return SnrCurve(exposure, electrons, found, saturation)


def electrons_per_lux_second(sensor: Sensor, light: Spectrum) -> np.ndarray:
    """Electrons that 1 lx s of a light (relative power in energy units) makes in a pixel of each channel, (C,)."""
    nodes = np.array(
        [
            max(light.wavelengths[0], sensor.qe.wavelengths[0]),
            min(light.wavelengths[-1], sensor.qe.wavelengths[-1]),
        ]
    )
    if not nodes[0] < nodes[1]:
        return np.zeros(len(sensor.channels))
    height, width = sensor.aperture
    photons = product_weights(nodes, photons_from_energy(light), sensor.qe).sum(-1)
    return height * width * photons / xyz(light)[1]


def snr(patch, second=None) -> Any:
    """Signal to noise ratio [dB], 20 log10(mean / standard deviation); infinite without noise.

    patch: values of even light, proportional to it (black level taken off), shape (rows, cols) or (rows, cols, C) for
    one ratio to each channel. second: another frame of the same, then the noise is that of their difference over
    sqrt(2): temporal alone, without the pattern that both share. Returns a float or shape (C,). Raises BadData.
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
        raise BadData(f"snr: mean {np.min(mean):.4g}: wanted light, with the black level taken off")
    with np.errstate(divide="ignore"):
        found = 20 * np.log10(mean / noise)
    return float(found) if found.ndim == 0 else found


def visible_snr(patch, samples_per_degree: float, white=None) -> float:
    """Visible SNR [1 / Delta E]: one over the standard deviation of an even patch in S-CIELAB; infinite without noise.

    patch: a frame, its exposure divided out (see `gpusim.measure.ciede2000`), or XYZ (rows, cols, 3) with white Y about
    1, of one colour throughout. samples_per_degree: see `gpusim.measure.samples_per_degree`. white: XYZ that counts as
    white, shape (3,); None: the display's, sRGB's where there is no frame. Raises BadData, OutOfRange.
    Source: Farrell, Okincha, Parmar & Wandell 2010, "Using visible SNR (vSNR) to compare the image quality of pixel
    binning and digital resizing", Proc. SPIE 7537: 1 / sqrt(var L* + var a* + var b*).
    """
    xyz, white = shown(patch, white)
    lab = cielab(eye_filtered(xyz, samples_per_degree), white)
    rows, cols = (round((1 - MIDDLE) / 2 * count) for count in lab.shape[:2])
    middle = lab[rows : lab.shape[0] - rows, cols : lab.shape[1] - cols]
    if middle[..., 0].size < 2:
        raise BadData(
            f"visible_snr: patch of {lab.shape[0]} x {lab.shape[1]} pixels, wanted 2 or more"
        )
    spread = np.sqrt(middle.var(axis=(0, 1), ddof=1).sum())
    return float(1 / spread) if spread > 0 else np.inf


def _numbers(values, name):
    values = np.asarray(values)
    if (
        values.ndim not in (2, 3)
        or values.dtype.kind not in "uif"
        or values.shape[0] * values.shape[1] < 2
    ):
        raise BadData(
            f"snr: {name} of shape {values.shape} and type {values.dtype}; wanted numbers (rows, cols) or "
            "(rows, cols, channels), 2 pixels or more"
        )
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        raise BadData(f"snr: {name}: NaN or infinite values")
    return values
