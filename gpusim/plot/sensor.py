"""What a sensor makes of light: its raw mosaic, and its signal over its noise."""

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.sensor import Sensor
from gpusim.measure.mosaic import colored
from gpusim.measure.snr import snr_curve
from gpusim.plot.canvas import QUIET, axes_of, channel_colors, finish, image
from gpusim.plot.light import picture_size

RAW_GAMMA = 2.2  # of the mosaic's picture
LOWEST = -10.0  # SNR that is drawn [dB]


def raw(frame, ax=None, *, gamma: float = RAW_GAMMA):
    """A frame's raw mosaic, each pixel in its filter's colour: black at the black level, full at the white level.

    gamma: (signal / white)^(1 / gamma) is shown. Returns the axes. Raises BadData, Missing.
    """
    if not hasattr(frame, "raw") or not hasattr(frame, "camera"):
        raise BadData(f"raw: {type(frame).__name__}, wanted a frame")
    if not 0 < gamma < np.inf:
        raise BadData(f"raw: gamma = {gamma}, wanted a number above 0")
    sensor = frame.camera.sensor
    codes = raw_codes(frame.raw, sensor, gamma)
    rows, cols = codes.shape[:2]
    pattern = "stacked " + "".join(sensor.channels) if sensor.stacked else "/".join(sensor.cfa)
    return image(axes_of(ax, picture_size((rows, cols))), codes,
                 f"{frame.camera.name}: raw, {pattern}, {cols} x {rows} pixels, 0 .. {sensor.white_level} DN")


def raw_codes(raw, sensor: Sensor, gamma: float = RAW_GAMMA) -> np.ndarray:
    """uint8 (rows, cols, 3) of raw values (rows, cols), or of stacked pixels (C, rows, cols) [DN]."""
    black, white = sensor.dark_level, sensor.white_level
    values = np.clip((np.asarray(raw, np.float32) - np.float32(black)) / np.float32(white - black), 0, 1)
    return colored(sensor, np.uint8(255 * values ** (1 / gamma) + 0.5))


def snr(camera, ax=None, *, light="D65", seconds: float = 0.0, temporal: bool = False):
    """Signal to noise ratio of each channel against the exposure of the sensor, up to saturation.

    camera: a Camera or a Sensor. light, seconds, temporal: see `gpusim.measure.snr_curve`. The grey line has the
    photons' noise alone, of the channel that sees most light. Returns the axes. Raises BadData, Missing, OutOfRange,
    UnknownName.
    """
    if not isinstance(camera, (Camera, Sensor)):
        raise BadData(f"snr: {type(camera).__name__}, wanted a Camera or a Sensor")
    sensor = camera.sensor if isinstance(camera, Camera) else camera
    found = snr_curve(sensor, light, seconds=seconds, temporal=temporal)
    ax = axes_of(ax)
    most = int(found.electrons[:, -1].argmax())
    seen = ~np.isnan(found.snr[most])
    for (letter, color), values, full in zip(channel_colors(sensor.channels).items(), found.snr, found.saturation,
                                             strict=True):
        best = "" if np.isnan(values).all() else f", at most {np.nanmax(values):.1f} dB"
        ax.plot(found.exposure, values, color=color, label=f"channel {letter}{best}")
        if np.isfinite(full):
            ax.plot([full], values[found.exposure == full], "o", color=color, markersize=4)
    ax.plot(found.exposure[seen], 10 * np.log10(found.electrons[most, seen]), color=QUIET, linestyle="--", zorder=0.5,
            label=f"photons alone, channel {sensor.channels[most]}")
    ax.set_xscale("log")
    lowest = max(LOWEST, float(np.nanmin(found.snr)))
    ax.set_ylim(bottom=lowest)
    ax.set_xlim(left=found.exposure[np.nanmax(found.snr, axis=0) >= lowest][0])
    name = camera.name if isinstance(camera, Camera) else "sensor"
    named = light if isinstance(light, str) else light.name or "the light given"
    patterns = "temporal noise" if temporal else "noise and fixed patterns"
    return finish(ax, f"{name}: SNR up to saturation, {patterns}", f"exposure of the sensor in {named} [lx s]",
                  "signal to noise ratio [dB]")
