"""Held-out frames in groups of equal settings, and frames that a camera file simulates for them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.mosaics import mosaic, shortest_period
from gpusim.domain.progress import announced
from gpusim.domain.short_repr import short_repr
from gpusim.fit.fitting import find_shots
from gpusim.fit.noise_sums import light_at, smooth_light
from gpusim.fit.sorting import (
    Summary,
    check_same_camera,
    group_darks,
    group_flats,
    name_kinds,
    summarise,
)
from gpusim.io.raw.raw_frame import RawFrame
from gpusim.pipeline.readout import Readout

MOST_FRAMES, MOST_SIDE = 16, 1024  # of a group that are used, and the middle of large frames
SHORT = 1e-6  # [s] of frames whose files do not give an exposure time
UNSATURATED = 0.9  # part of saturation up to which flats are compared


@dataclass(frozen=True, eq=False)
class Given:
    """A frame that is given as values instead of a file.

    Args:
        frame: The frame.
        kind: What it shows, as of `Shot`.
        index: Its number.
    """

    frame: RawFrame
    kind: str = ""
    index: int = 0

    __repr__ = short_repr

    @property
    def path(self) -> Path:
        """Its name in place of a path."""
        return Path(self.frame.name or f"frame {self.index}")

    def read(self) -> RawFrame:
        """Return the frame."""
        return replace(self.frame, name=str(self.path))


@dataclass(frozen=True, eq=False)
class Group:
    """Frames of one setting and level.

    Args:
        kind: "dark" or "flat".
        summaries: Its frames.
        words: Its settings, in words.
    """

    kind: str
    summaries: tuple[Summary, ...]
    words: str

    __repr__ = short_repr

    @property
    def frame(self) -> RawFrame:
        """Settings of the first frame."""
        return self.summaries[0].frame

    def read(self, period: tuple[int, int]) -> np.ndarray:
        """Return the middle of its frames [DN], (n, rows, cols), at most MOST_FRAMES and MOST_SIDE."""
        rows, cols = (
            _middle(size, of) for size, of in zip(self.summaries[0].shape, period, strict=True)
        )
        found = []
        for one in self.summaries[:MOST_FRAMES]:
            with announced(f"reading {one.frame.name}"):
                found.append(one.shot.read().values[rows, cols])
        return np.stack(found)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Groups of held-out frames.

    Args:
        groups: Groups of two frames or more.
        cfa: Their mosaic.
        unknown: Lines: what cannot be compared, and what to shoot instead.
    """

    groups: tuple[Group, ...]
    cfa: tuple[str, ...]
    unknown: tuple[str, ...] = field(default=())

    __repr__ = short_repr


def shots_of(frames: Any, kind: str = "", **settings: Any) -> list[Any]:
    """Return the frames of files, of raw frames, or of one of them.

    Args:
        frames: Paths or RawFrames.
        kind: What they show, or "" if their content tells.
        settings: Fields of `RawFrame` in place of the files'.

    Raises:
        BadData: Neither a path nor a raw frame.
        BadFile: A file cannot be read.
    """
    if isinstance(frames, str | PathLike | RawFrame):
        frames = [frames]
    if not isinstance(frames, Iterable):
        raise BadData(f"held-out frames: {type(frames).__name__}, wanted files or raw frames")
    found: list[Any] = []
    for number, one in enumerate(frames):
        if isinstance(one, RawFrame):
            found.append(Given(replace(one, **_mosaic_of(settings)), kind, number))
        elif isinstance(one, str | PathLike):
            found += find_shots(one, kind, settings)
        else:
            raise BadData(f"held-out frame: {type(one).__name__}, wanted a file or a RawFrame")
    return found


def _mosaic_of(settings):
    """Return settings with a mosaic's name replaced by its rows. Raises UnknownName."""
    cfa = settings.get("cfa")
    return settings | {"cfa": mosaic(cfa)} if isinstance(cfa, str) else settings


def group_frames(shots: Sequence[Any], camera: Camera) -> HeldOut:
    """Return held-out darks and flats by settings and level.

    Args:
        shots: The frames.
        camera: The camera that they are compared with.

    Raises:
        BadData: Frames of several cameras, sizes or mosaics; another mosaic or more bits than the
            camera has; no two frames of equal settings.
        BadFile: A file cannot be read.
    """
    if not shots:
        raise BadData("held-out frames: none; give darks or flats, two or more of each setting")
    summaries = name_kinds(summarise(shots))
    check_same_camera(summaries)
    check_mosaic(summaries[0].frame, camera)
    check_levels(summaries, camera)
    unknown = []
    other = [one for one in summaries if one.shot.kind not in ("dark", "flat")]
    if other:
        names = ", ".join(one.frame.name for one in other[:3])
        unknown.append(
            f"{len(other)} frames show neither darkness nor even light ({names}): noise is compared on flats "
            "without texture; or say what they show (chart, edges, shading)"
        )
    darks = [one for one in summaries if one.shot.kind == "dark"]
    black = _black(darks, camera)
    groups = [("dark", one) for one in group_darks(darks)]
    flats = [one for one in summaries if one.shot.kind == "flat"]
    groups += [("flat", one) for one in group_flats(flats, black)]
    found = []
    for kind, members in groups:
        words = _words(kind, members, black)
        if len(members) < 2:
            unknown.append(f"{words}: one frame; temporal noise needs two of equal settings")
        elif kind == "flat" and _is_clipped(members[0], camera):
            unknown.append(f"{words}: clipped; shoot flats below saturation")
        else:
            found.append(Group(kind, tuple(members), words))
    if not found:
        raise BadData(
            f"held-out frames: no pairs among {len(summaries)} frames ({unknown[0] if unknown else 'none'}); shoot "
            "two or more frames of each setting, from a tripod"
        )
    if not darks:
        unknown.append("no dark frames: the camera file's black level is taken for the flats")
    return HeldOut(tuple(found), summaries[0].frame.cfa, tuple(unknown))


def check_mosaic(frame: RawFrame, camera: Camera) -> None:
    """Raise BadData unless a frame has the camera's mosaic."""
    sensor = camera.sensor
    if sensor.stacked:
        raise BadData("compare: the camera has stacked pixels; raw files have one value a pixel")
    own = Readout(sensor, "numpy").output.cfa
    if len(frame.channels) == 1 and len(set("".join(own))) == 1:
        return
    if not same_mosaic(frame.cfa, own):
        raise BadData(
            f"{frame.name}: mosaic {'/'.join(frame.cfa)}, the camera file has {'/'.join(own)}; "
            "compare with the camera that took it, or give its mosaic (cfa)"
        )


def same_mosaic(one: Sequence[str], other: Sequence[str]) -> bool:
    """Return whether two periods repeat to the same mosaic."""
    codes = []
    for rows in (one, other):
        codes.append(shortest_period([[ord(letter) for letter in row] for row in rows]))
    return codes[0].shape == codes[1].shape and bool((codes[0] == codes[1]).all())


def check_levels(summaries: Sequence[Summary], camera: Camera) -> None:
    """Raise BadData if a frame has values above the camera's white level."""
    white = camera.sensor.white_level
    for one in summaries:
        if one.highest > white:
            raise BadData(
                f"{one.frame.name}: values up to {one.highest:g} DN, the camera file ends at {white} DN "
                f"({camera.sensor.bits} bits); compare with a file of this camera and bit depth"
            )


def simulate_group(
    group: Group,
    stack: np.ndarray,
    camera: Camera,
    *,
    black: np.ndarray | None,
    gain: float,
    seed: int,
    device: Device | str,
) -> np.ndarray:
    """Simulate as many frames of the same light at the same mean level, with all noise.

    Args:
        group: The group.
        stack: Its frames [DN], (n, rows, cols).
        camera: The camera.
        black: Mean of dark frames of these settings for each channel [DN], or None.
        gain: Analog gain, next to the camera's [1].
        seed: Seed of the noise and of the chip.
        device: The device.

    Returns:
        Raw values [DN], (n, rows, cols).
    """
    noise = replace(camera.sensor.noise, seed=(camera.sensor.noise.seed + seed) % 2**64)
    readout = Readout(replace(camera.sensor, noise=noise), device)
    time = group.frame.exposure_time or SHORT
    mean = _electrons(group, stack, readout, black, gain, time)
    raw = readout.draw_electrons(mean, time, gain=gain, seed=seed, frames=len(stack))
    return raw[:, : stack.shape[1], : stack.shape[2]]


def _electrons(group, stack, readout, black, gain, time):
    """Return mean electrons of light, before binning, at which the mean raw values are the group's."""
    sensor, (rows, cols) = readout.sensor_at_gain(gain), stack.shape[1:]
    before = readout.sensor
    rows, cols = rows * before.binning[0], cols * before.binning[1]
    if group.kind == "dark":
        return np.zeros((rows, cols), np.float32)
    letters, channels = letter_indices(group.frame.cfa)
    light = smooth_light(stack.mean(axis=0, dtype=np.float64), letters, len(channels))
    dark = sensor.dark_level + sensor.gain_dn_per_electron * readout.dark_electrons(time)
    levels = np.full(len(channels), dark) if black is None else black
    places, _ = letter_indices(before.cfa)
    own = "".join(dict.fromkeys("".join(before.cfa)))
    order = [channels.index(letter) if letter in channels else 0 for letter in own]
    mean = np.zeros((rows, cols))
    for row, col in np.ndindex(*places.shape):
        number = order[places[row, col]]
        place = slice(row, None, places.shape[0]), slice(col, None, places.shape[1])
        mean[place] = light_at(light[number], rows, cols)[place] - levels[number]
    electrons = np.maximum(mean, 0) / sensor.gain_dn_per_electron
    return (electrons / readout.pixels).astype(np.float32)


def letter_indices(cfa: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the index of each pixel's channel in one period, and the channels' letters."""
    channels = tuple(dict.fromkeys("".join(cfa)))
    return np.array([[channels.index(letter) for letter in row] for row in cfa]), channels


def gain_of(frame: RawFrame, base_iso: float | None, isos: Iterable[float | None]) -> float:
    """Return the analog gain of a frame, next to the camera file's.

    Args:
        frame: The frame.
        base_iso: ISO speed at which the camera file's gain applies; None: that of all frames.
        isos: ISO speeds of all frames.

    Raises:
        BadData: The frames have several ISO speeds, and the base is not given.
        OutOfRange: The base is not above 0.
    """
    if base_iso is None:
        known = sorted({iso for iso in isos if iso is not None})
        if len(known) > 1:
            words = ", ".join(f"{iso:g}" for iso in known)
            raise BadData(
                f"mixed ISO: {words}; compare one at a time, or give the ISO of the camera file's gain (base_iso)"
            )
        return 1.0
    if not 0 < base_iso < 1e9:
        raise OutOfRange("base_iso", base_iso, "0 < base_iso < 1e9")
    return 1.0 if frame.iso is None else frame.iso / base_iso


def _middle(size, period):
    """Return the middle of a side as a slice that starts with the mosaic's period."""
    if size <= MOST_SIDE:
        return slice(0, size)
    start = (size - MOST_SIDE) // 2 // period * period
    return slice(start, start + MOST_SIDE)


def _black(darks, camera):
    return float(np.mean([one.mean for one in darks])) if darks else camera.sensor.dark_level


def _is_clipped(one, camera):
    """Return whether a flat reaches the white level or, in its brightest channel, the full well."""
    sensor = camera.sensor
    full = sensor.dark_level + UNSATURATED * sensor.saturation * sensor.gain_dn_per_electron
    return one.highest >= sensor.white_level or float(one.means.max()) > full


def _words(kind, members, black):
    frame = members[0].frame
    parts = []
    if kind == "flat":
        parts.append(f"{np.mean([one.mean for one in members]) - black:.4g} DN")
    if frame.iso is not None:
        parts.append(f"ISO {frame.iso:g}")
    if frame.exposure_time is not None:
        parts.append(f"{1e3 * frame.exposure_time:.4g} ms")
    if frame.temperature is not None:
        parts.append(f"{frame.temperature:.3g} deg C")
    settings = f" ({', '.join(parts)})" if parts else ""
    return f"{len(members)} {'darks' if kind == 'dark' else 'flats'}{settings}"
