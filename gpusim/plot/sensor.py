"""What a sensor makes of light: its raw mosaic, its noise, and its signal over its noise."""

from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.measure.mosaic import colored
from gpusim.measure.photon_transfer import PhotonTransfer
from gpusim.measure.photon_transfer import photon_transfer as measured
from gpusim.measure.snr import snr_curve
from gpusim.pipeline.readout import Readout
from gpusim.plot.canvas import (
    CHANNELS,
    QUIET,
    axes_of,
    channel_colors,
    curve,
    finish,
    image,
    legend_once,
    picture_size,
)

RAW_GAMMA = 2.2  # of the mosaic's picture
# sigmas of a histogram, and from black or saturation within which noise is cut off
SPREAD, CUT = 5.0, 4.0
FLAT = (96, 96)  # pixels of the frames of which a photon transfer curve is measured
LOWEST = -10.0  # SNR that is drawn [dB]


def raw(frame, ax=None, *, gamma: float = RAW_GAMMA) -> Any:
    """A frame's raw mosaic, each pixel in its filter's colour: black at the black level, full at the white level.

    gamma: (signal / white)^(1 / gamma) is shown. Returns the axes. Raises BadData, Missing, OutOfRange.
    """
    _require_frame(frame, "raw")
    if not (isinstance(gamma, Real) and 0 < gamma < np.inf):
        raise OutOfRange("gamma", gamma, "0 < gamma < inf")
    sensor = frame.camera.sensor
    codes = raw_codes(frame.raw, sensor, gamma)
    rows, cols = codes.shape[:2]
    pattern = "stacked " + "".join(sensor.channels) if sensor.stacked else "/".join(sensor.cfa)
    return image(
        axes_of(ax, picture_size((rows, cols))),
        codes,
        f"{frame.camera.name}: raw, {pattern}, {cols} x {rows} pixels, 0 .. {sensor.white_level} DN",
    )


def raw_codes(raw, sensor: Sensor, gamma: float = RAW_GAMMA) -> np.ndarray:
    """uint8 (rows, cols, 3) of raw values (rows, cols), or of stacked pixels (C, rows, cols) [DN]."""
    black, white = sensor.dark_level, sensor.white_level
    values = np.clip(
        (np.asarray(raw, np.float32) - np.float32(black)) / np.float32(white - black), 0, 1
    )
    return colored(sensor, np.uint8(255 * values ** (1 / gamma) + 0.5))


def snr(
    camera, ax=None, *, light="D65", seconds: float = 0.0, temporal: bool = False, label: str = ""
) -> Any:
    """Signal to noise ratio of each channel against the exposure of the sensor, up to saturation.

    camera: a Camera or a Sensor. light, seconds, temporal: see `gpusim.measure.snr_curve`. The grey line has the
    photons' noise alone, of the channel that sees most light. label: what the legend names it by, where several are
    drawn on one `ax`. Returns the axes. Raises BadData, Missing, OutOfRange, UnknownName.
    """
    if not isinstance(camera, (Camera, Sensor)):
        raise BadData(f"snr: {type(camera).__name__}, wanted a Camera or a Sensor")
    sensor = camera.sensor if isinstance(camera, Camera) else camera
    found = snr_curve(sensor, light, seconds=seconds, temporal=temporal)
    if np.isposinf(found.snr).any():
        raise BadData(
            "snr: the sensor has no noise, so its ratio is infinite; wanted some, if only of photons"
        )
    ax = axes_of(ax)
    left, lowest = (
        ax.get_xlim()[0] if ax.get_lines() else np.inf,
        max(LOWEST, float(found.snr.min())),
    )
    most = int(found.saturation.argmin())
    seen = found.exposure <= found.saturation[most]
    for (letter, color), values, full in zip(
        channel_colors(sensor.channels).items(), found.snr, found.saturation, strict=True
    ):
        best = f", at most {values.max():.1f} dB" if np.isfinite(full) else ""
        below = np.where(found.exposure <= full, values, np.nan)
        curve(ax, found.exposure, below, color, f"{label} channel {letter}{best}".strip())
        if np.isfinite(full):
            ax.plot([full], values[found.exposure == full], "o", color=color, markersize=4)
    alone = f"{label} photons alone, channel {sensor.channels[most]}".strip()
    ax.plot(
        found.exposure[seen],
        10 * np.log10(found.electrons[most, seen]),
        color=QUIET,
        linestyle="--",
        zorder=0.5,
        label=legend_once(ax, alone),
    )
    ax.set_xscale("log")
    ax.set_ylim(bottom=lowest)
    ax.set_xlim(left=min(left, found.exposure[found.snr.max(axis=0) >= lowest][0]))
    named = light if isinstance(light, str) else light.name or "the light given"
    name = camera.name if isinstance(camera, Camera) else ""
    return finish(
        ax,
        name,
        f"{'temporal ' * temporal}SNR up to saturation",
        f"exposure of the sensor in {named} [lx s]",
        "signal to noise ratio [dB]",
    )


def noise(frame, ax=None) -> Any:
    """Histogram of a frame's noise: raw values less those expected without noise, over the sigma that is expected.

    Of all that makes a raw value other than its mean, fixed patterns included, each channel by itself; pixels near
    black or saturation, whose noise is cut off, are left out. The dashed line is the normal distribution.
    Returns the axes. Raises BadData, Missing.
    """
    deviations = noise_of(frame)
    ax, edges = axes_of(ax), np.linspace(-SPREAD, SPREAD, 41)
    middle, step = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    colors = channel_colors(frame.camera.sensor.channels)
    for letter, values in deviations.items():
        if values.size < 2:
            continue
        share = np.histogram(values, edges)[0] / (values.size * step)
        ax.step(
            middle,
            share,
            where="mid",
            color=colors[letter],
            label=f"{letter}: {values.size} pixels, mean {values.mean():+.3f}, sigma {values.std():.3f}",
        )
    ax.plot(
        middle,
        np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi),
        color="0.3",
        linestyle="--",
        label="normal",
    )
    ax.set_ylim(0, 1.55 * ax.get_ylim()[1])
    return finish(
        ax,
        frame.camera.name,
        "noise of one frame",
        "(raw value - expected) / expected sigma",
        "probability density",
    )


def noise_of(frame) -> dict[str, np.ndarray]:
    """Raw values less the expected ones over the expected sigma, of each channel's pixels that are not cut off [1]."""
    _require_frame(frame, "noise")
    if frame.averaged is None:
        raise BadData(
            "noise: a picture of several exposures, whose noise is of no one gain; wanted a frame of one"
        )
    sensor = frame.camera.sensor
    own, gain = sensor.noise, sensor.gain_dn_per_electron
    electrons = frame.mean + own.dark_current * own.warmth * frame.exposure_time
    parts = RawNoise.of(sensor, frame.averaged)
    variance = parts.variance(electrons) + (parts.response + parts.line_response) * np.square(
        frame.mean, dtype=float
    )
    sigma = np.sqrt(variance)
    inside = electrons + CUT * sigma < sensor.saturation
    if sensor.bits != FLOAT_BITS:
        inside &= sensor.dark_level + gain * (electrons - CUT * sigma) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (frame.raw - (sensor.dark_level + gain * electrons)) / (gain * sigma)
    inside &= np.isfinite(found)
    if not inside.any():
        raise BadData(
            "noise: all pixels are near black or saturation, where noise is cut off, or have no noise; "
            "wanted another exposure"
        )
    if found.ndim == 3:
        return {
            letter: one[use]
            for letter, one, use in zip(sensor.channels, found, inside, strict=True)
        }
    (rows, cols), cfa = found.shape, sensor.cfa_indices
    tiled = np.tile(cfa, (-(-rows // cfa.shape[0]), -(-cols // cfa.shape[1])))[:rows, :cols]
    return {
        letter: found[inside & (tiled == number)] for number, letter in enumerate(sensor.channels)
    }


def photon_transfer(what, ax=None, *, seed: int = 0, device="auto") -> Any:
    """Photon transfer curve: temporal noise against signal, both in digital numbers, with what is read from it.

    what: a PhotonTransfer of `gs.photon_transfer`; or a Camera or a Sensor, which is then measured by simulated frames
    of even light, from 1e-4 of saturation to beyond it. seed, device: of these. Returns the axes. Raises BadData,
    Missing.
    """
    name = what.name if isinstance(what, Camera) else ""
    if isinstance(what, (Camera, Sensor)):
        what = measured_transfer(what.sensor if isinstance(what, Camera) else what, seed, device)
    if not isinstance(what, PhotonTransfer):
        raise BadData(
            f"photon_transfer: {type(what).__name__}, wanted a PhotonTransfer, a Camera or a Sensor"
        )
    ax, floor = axes_of(ax), what.dark_noise_dn
    signal, total = what.signal, np.sqrt(np.maximum(what.variance, 0) + floor**2)
    seen = signal > 0
    ax.plot(signal[seen], total[seen], "o", color="0.2", markersize=4, label="frames")
    line = np.geomspace(signal[seen].min(), signal[what.saturation_level], 100)
    ax.plot(
        line,
        np.sqrt(what.gain * line),
        color=CHANNELS["B"],
        linestyle="--",
        label=f"photons: K = {what.gain:.4g} DN/e⁻",
    )
    ax.axhline(
        floor,
        color=CHANNELS["G"],
        linestyle="--",
        label=f"dark: {floor:.3g} DN, {what.dark_noise:.3g} e⁻",
    )
    ax.plot(line, np.sqrt(what.gain * line + floor**2), color=CHANNELS["R"], label="both")
    ax.axvline(
        signal[what.saturation_level],
        color=QUIET,
        label=f"saturation: {what.saturation_capacity:.4g} e⁻, range {what.dynamic_range_db:.1f} dB",
    )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.5 * min(floor, total[seen].min()))
    return finish(
        ax,
        name,
        "photon transfer",
        "signal above dark [DN]",
        "temporal noise, standard deviation [DN]",
    )


def measured_transfer(sensor: Sensor, seed: int = 0, device="auto") -> PhotonTransfer:
    """Photon transfer of a sensor by simulated frames of even light at the wavelength that it sees best, unbinned.

    Raises BadData.
    """
    sensor = replace(sensor, binning=(1, 1), stacked=False)
    readout = Readout(sensor, device)
    efficiency = float(sensor.qe.values.max()) * sensor.fill_factor
    parts = np.unique(np.concatenate([np.geomspace(1e-4, 0.05, 16), np.linspace(0.1, 1.3, 25)]))
    pixels = np.ones(FLAT, np.float32)

    def frames(electrons, number, count=2):
        return readout.draw_electrons(
            electrons * pixels, 1e-9, seed=seed, frame=2 * number, frames=count
        )

    levels = (
        frames(np.float32(part * sensor.saturation), 1 + number)
        for number, part in enumerate(parts)
    )
    return measured(levels, frames(np.float32(0), 0), parts * sensor.saturation / efficiency)


def _require_frame(frame, name):
    if not hasattr(frame, "raw") or not hasattr(frame, "camera"):
        raise BadData(f"{name}: {type(frame).__name__}, wanted a frame")
