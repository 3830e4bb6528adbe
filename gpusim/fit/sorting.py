"""Shots by content and by settings."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.progress import announced
from gpusim.fit.patterns import trend
from gpusim.fit.shots import Shot
from gpusim.fit.steps import common_step, used_steps
from gpusim.io.raw.raw_frame import RawFrame

EVEN = 0.1  # relative deviation of a frame's parts from a smooth surface that is still a flat
SAME_LEVEL = 0.03  # relative difference of signals that are the same level
DARK_RATE = 0.01
SAMPLED = 512  # rows and columns of a frame's summary


@dataclass(frozen=True, eq=False)
class Summary:
    """Figures of a shot for sorting.

    Args:
        shot: The shot.
        frame: Its frame, without values.
        shape: Rows and columns.
        means: Mean of each place of the period [DN].
        deviation: Robust standard deviation of pixels [DN].
        unevenness: Standard deviation of parts of the frame from a smooth surface [DN].
        highest: Largest value [DN].
        is_whole: Whether values are whole numbers.
        sketch: Medians of parts of the frame's middle [DN], less a smooth surface.
        step: Power of two that divides all values; 0 if all are 0.
        used: Levels and steps between used values there [DN].
    """

    shot: Shot
    frame: RawFrame
    shape: tuple[int, int]
    means: np.ndarray
    deviation: float
    unevenness: float
    highest: float
    is_whole: bool
    sketch: np.ndarray
    step: int = 1
    used: tuple[tuple[float, float], ...] = ()

    @property
    def mean(self) -> float:
        """Mean of all pixels [DN]."""
        return float(self.means.mean())


def summarise(shots: Sequence[Shot]) -> list[Summary]:
    """Read each shot once and return figures for sorting. Raises as `read_raw`."""
    found = []
    for number, shot in enumerate(shots):
        with announced(f"reading {shot.path.name}, {number} of {len(shots)} frames sorted"):
            found.append(_summary(shot))
    return found


def _summary(shot):
    frame = shot.read()
    values, (rows, cols) = frame.values, frame.period
    planes = [values[i::rows, j::cols] for i in range(rows) for j in range(cols)]
    means = np.array([plane.mean(dtype=np.float64) for plane in planes])
    plane = planes[0]
    top, left = (max(0, (size - SAMPLED) // 2) for size in plane.shape)
    part = plane[top : top + SAMPLED, left : left + SAMPLED].astype(np.float32)
    part = part - trend(part, np.ones(part.shape, bool), min(2, min(part.shape) - 1))
    low, high = np.percentile(part, (15.866, 84.134))
    size = max(1, min(8, min(part.shape) // 3))
    height, width = (side // size * size for side in part.shape)
    blocks = part[:height, :width].reshape(height // size, size, width // size, size)
    sketch = np.median(blocks, axis=(1, 3))
    return Summary(
        shot,
        replace(frame, values=np.empty((0, 0))),
        values.shape,
        means,
        float(high - low) / 2,
        float(np.ptp(np.percentile(sketch, (15.866, 84.134)))) / 2,
        float(values.max()),
        values.dtype.kind in "ui" or bool((values == np.rint(values)).all()),
        sketch,
        common_step(values),
        used_steps(values[top * rows :, left * cols :][: SAMPLED * rows, : SAMPLED * cols]),
    )


def check_same_camera(summaries: Sequence[Summary]) -> None:
    """Raise BadData unless all shots are of one camera with one size and one mosaic."""
    first = summaries[0]
    for key, words in (("camera", "cameras"), ("cfa", "mosaics")):
        named = [one for one in summaries if getattr(one.frame, key) is not None]
        for one in named:
            ours, theirs = getattr(named[0].frame, key), getattr(one.frame, key)
            if ours != theirs:
                raise BadData(
                    f"mixed {words}: {named[0].frame.name} is {ours}, {one.frame.name} is {theirs}; "
                    "fit each camera by itself"
                )
    for one in summaries:
        if one.shape != first.shape:
            raise BadData(
                f"mixed sizes: {first.frame.name} has {first.shape[0]} x {first.shape[1]} pixels, "
                f"{one.frame.name} {one.shape[0]} x {one.shape[1]}; shoot all frames at one size"
            )


def name_kinds(summaries: Sequence[Summary]) -> list[Summary]:
    """Return the shots with a kind where content tells it: "dark", "flat", "pairs" or "other".

    A dark frame is as even as noise and at the black level that its file states; without one, at
    the lowest level of all frames, if brighter frames have more noise. A frame whose level rises by
    less than DARK_RATE of the fastest frame's per second, equally in all channels, is dark, too.
    Frames that show one static scene at one exposure are "pairs".
    """
    open_ = [one for one in summaries if not one.shot.kind]
    darks = [one for one in summaries if one.shot.kind == "dark"]
    lowest = min(darks or open_ or summaries, key=lambda one: one.mean)
    noisiest = max(summaries, key=lambda one: one.deviation)
    rates = [_rate(one, lowest) for one in summaries]
    fastest = max((rate for rate in rates if rate is not None), default=0.0)
    named = []
    for one in summaries:
        kind = one.shot.kind
        if not kind:
            kind = _kind(one, lowest, noisiest, fastest)
        named.append(replace(one, shot=replace(one.shot, kind=kind)))
    others = [one for one in named if one.shot.kind == "other"]
    in_pairs = {id(one) for group in _scenes(others) if len(group) > 1 for one in group}
    return [
        replace(one, shot=replace(one.shot, kind="pairs")) if id(one) in in_pairs else one
        for one in named
    ]


def _rate(one, lowest):
    """Return how fast the level rises above the lowest frame's [DN/s], None if it is not known."""
    seconds = one.frame.exposure_time
    return (one.mean - lowest.mean) / seconds if seconds else None


def _kind(one, lowest, noisiest, fastest):
    black = one.frame.black_level
    noise = max(one.deviation, 0.5)
    is_noise = one.unevenness < 1.5 * noise and np.ptp(one.means) < 3 * noise
    rate = _rate(one, lowest)
    is_slow = rate is not None and rate < DARK_RATE * fastest
    if black is not None:
        is_low = abs(one.mean - float(np.mean(black))) < 3 * noise
    else:
        is_lowest = one.mean - lowest.mean < 3 * max(lowest.deviation, 0.5)
        is_low = is_lowest and noisiest.deviation > 1.3 * one.deviation
    if is_noise and (is_low or is_slow):
        return "dark"
    level = float(np.mean(black)) if black is not None else lowest.mean
    signal = max(one.mean - level, 1.0)
    return "flat" if one.unevenness < max(EVEN * signal, 0.7 * noise) else "other"


def group_darks(darks: Iterable[Summary]) -> list[list[Summary]]:
    """Return dark frames grouped by ISO speed, exposure time and temperature [deg C]."""
    groups: dict = {}
    for one in darks:
        frame = one.frame
        degrees = None if frame.temperature is None else round(frame.temperature)
        key = frame.iso, frame.exposure_time, degrees
        groups.setdefault(key, []).append(one)
    split = [part for group in groups.values() for part in _split_darks(group)]
    return sorted(split, key=lambda group: group[0].frame.exposure_time or 0.0)


def _split_darks(group):
    """Return dark frames of an unknown exposure time by level, others together."""
    if group[0].frame.exposure_time is not None:
        return [group]
    parts: list[list[Summary]] = []
    for one in sorted(group, key=lambda one: one.mean):
        if parts and one.mean - parts[-1][-1].mean < max(one.deviation, 0.5) / 2:
            parts[-1].append(one)
        else:
            parts.append([one])
    order = {id(one): number for number, one in enumerate(group)}
    return [sorted(part, key=lambda one: order[id(one)]) for part in parts]


def group_flats(flats: Iterable[Summary], black: float) -> list[list[Summary]]:
    """Return flats grouped by ISO speed, exposure time and level.

    Args:
        flats: The shots.
        black: Black level [DN].
    """
    groups: dict = {}
    for one in flats:
        groups.setdefault((one.frame.iso, one.frame.exposure_time), []).append(one)
    levels = []
    for group in groups.values():
        group = sorted(group, key=lambda one: one.mean)
        start = group[:1]
        for one in group[1:]:
            last = start[-1]
            step = one.mean - last.mean
            noise = 8 * one.deviation / math.sqrt(math.prod(one.shape))
            if step <= max(SAME_LEVEL * max(last.mean - black, 0.0), noise):
                start.append(one)
            else:
                levels.append(start)
                start = [one]
        levels.append(start)
    return sorted(levels, key=lambda group: np.mean([one.mean for one in group]))


def group_scenes(pairs: Iterable[Summary]) -> list[list[Summary]]:
    """Return frames of static scenes grouped by scene and exposure, two frames or more each.

    Args:
        pairs: The shots.

    Raises:
        BadData: There are no two frames of one scene.
    """
    found = _scenes(pairs)
    if not any(len(group) > 1 for group in found):
        names = f"{found[0][0].frame.name} is a single frame"
        if len(found) > 1:
            names = f"{found[0][0].frame.name} and {found[1][0].frame.name} are single frames"
        raise BadData(
            f"{names}: pairs are two frames or more of one static scene at one exposure time and ISO speed; "
            "shoot each twice from a firm tripod"
        )
    return [group for group in found if len(group) > 1]


def _scenes(frames):
    """Return frames grouped by ISO speed, exposure time and scene."""
    groups: list[list[Summary]] = []
    for one in frames:
        group = next((group for group in groups if _is_same_scene(group[0], one)), None)
        if group is None:
            groups.append([one])
        else:
            group.append(one)
    return groups


def _is_same_scene(first, second):
    """Return whether two frames have the same settings and show the same, roughly."""
    ours, theirs = first.frame, second.frame
    if first.sketch.shape != second.sketch.shape:
        return False
    if (ours.iso, ours.exposure_time, ours.f_number) != (
        theirs.iso,
        theirs.exposure_time,
        theirs.f_number,
    ):
        return False
    if ours.exposure_time is None and abs(second.mean - first.mean) > SAME_LEVEL * first.mean:
        return False
    spread = max(float(np.std(first.sketch)), EVEN / 2 * abs(first.mean), first.deviation / 4)
    return float(np.std(second.sketch - first.sketch)) < spread / 2
