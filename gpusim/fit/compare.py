"""A camera file against held-out frames of the real camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, BadFile
from gpusim.domain.progress import announced
from gpusim.domain.short_repr import short_repr
from gpusim.fit.estimate import Plot
from gpusim.fit.fitting import RAW_SUFFIXES
from gpusim.fit.held_out import (
    Group,
    gain_of,
    group_frames,
    letter_indices,
    shots_of,
    simulate_group,
)
from gpusim.fit.noise_statistics import noise_statistics
from gpusim.fit.noise_sums import NoiseSums, sum_noise
from gpusim.fit.verdicts import AGREES, DIFFERS, UNKNOWN, Finding, judge
from gpusim.io.camera.cameras import open_camera

PICTURES = {".png", ".jpg", ".jpeg"}
OTHER_CHIP = 1  # added to the chip's seed: simulated and real patterns are compared as statistics


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences of real and simulated frames, and the verdict.

    Args:
        camera: Name of the camera.
        findings: Every statistic of every group of frames.
        unknown: Lines: what was not compared, and what to shoot instead.
        plots: Figures of the page.
    """

    camera: str
    findings: tuple[Finding, ...]
    unknown: tuple[str, ...] = ()
    plots: tuple[Plot, ...] = field(default=(), repr=False)

    __repr__ = short_repr

    @property
    def state(self) -> str:
        """Verdict on all findings: "agrees", "differs" or "cannot be judged"."""
        states = {one.state for one in self.findings}
        return next((one for one in (DIFFERS, UNKNOWN) if one in states), AGREES)

    def lines(self) -> list[str]:
        """Describe the findings and what was not compared.

        Returns:
            Lines of text, the verdict last.
        """
        found, group = [], None
        width = max((len(one.statistic) for one in self.findings), default=0)
        for one in self.findings:
            if one.group != group:
                group = one.group
                found.append(f"{group}:")
            found.append(f"  {one.statistic:{width}s}  {one.words}")
        found += [f"not compared: {line}" for line in self.unknown]
        count = sum(one.state == self.state for one in self.findings)
        return [*found, f"{self.camera}: {self.state} ({count} of {len(self.findings)} statistics)"]


def compare(
    camera: Camera | str | PathLike,
    held_out: Any = (),
    *,
    darks: Any = (),
    flats: Any = (),
    edges: Any = (),
    charts: Any = (),
    shadings: Any = (),
    light: str = "D65",
    base_iso: float | None = None,
    seed: int = 0,
    device: Device | str = "auto",
    **settings: Any,
) -> Comparison:
    """Compare a camera with held-out raw frames of the real one.

    For each group of darks or flats of equal settings, as many frames of the same light are
    simulated at the same mean level, with all noise. Compared are the variance at this signal,
    the distribution of residuals (KL divergence), noise of rows and columns, spectra along both,
    correlation of neighbours and the fixed pattern; of darks also the level. Chips differ, so
    patterns are compared as statistics. Intervals come from a bootstrap over blocks of pixels and over pairs of frames;
    all together hold with 95 %, and a verdict of agreement is a test of 5 %. Large frames are compared in their
    middle, 1024 x 1024 pixels of at most 16 frames.

    Args:
        camera: The camera, its name or its file.
        held_out: Raw files or RawFrames; their content tells darks from flats.
        darks: Frames that are known to be dark.
        flats: Frames that are known to be evenly lit.
        edges: Frames of one slanted edge: MTF.
        charts: Frames that a ColorChecker fills as the chart "colorchecker" does: colours.
        shadings: Even light through the lens, whole frames: shading.
        light: Light on the charts, a name for `gpusim.illuminant`.
        base_iso: ISO speed at which the camera file's gain applies. None: that of the frames.
        seed: Seed of the simulated noise and of the bootstrap.
        device: Device of the simulation.
        settings: Fields of `RawFrame` in place of the files', such as `cfa`.

    Returns:
        The comparison.

    Raises:
        BadData: Frames of several cameras, sizes or ISO speeds; another mosaic than the camera's;
            no pairs.
        BadFile: A file cannot be read, or holds no raw values.
        UnknownName: There is no such camera, light or setting.

    Source:
        Efron and Tibshirani, "An introduction to the bootstrap" (1993), chapter 6; Kullback and
        Leibler, "On information and sufficiency" (1951).
    """
    if isinstance(camera, str | PathLike):
        if Path(camera).suffix.lower() in RAW_SUFFIXES | PICTURES:
            raise BadFile(
                camera,
                "no camera file: give the camera's name or .toml first, then the held-out files",
            )
        camera = open_camera(camera)
    if not isinstance(camera, Camera):
        raise BadData(f"camera: {type(camera).__name__}, wanted a Camera, a name or a file")
    opened = open_device(device) if isinstance(device, str) else device
    shots = shots_of(held_out, **settings)
    shots += shots_of(darks, "dark", **settings) + shots_of(flats, "flat", **settings)
    scenes = {"edges": edges, "chart": charts, "shading": shadings}
    shown = {kind: shots_of(frames, kind, **settings) for kind, frames in scenes.items()}
    groups, unknown, plots = [], [], []
    if shots or not any(shown.values()):
        found, lines, figures = _compare_noise(shots, camera, base_iso, seed, opened)
        groups += found
        unknown += lines
        plots += figures
    for kind, frames in shown.items():
        if frames:
            from gpusim.fit.compare_scenes import COMPARE

            with announced(f"comparing {kind}"):
                found, figures = COMPARE[kind](frames, camera, light, seed, opened)
            groups += found
            plots += figures
    return Comparison(camera.name, tuple(judge(groups)), tuple(unknown), tuple(plots))


def _compare_noise(shots, camera, base_iso, seed, device):
    """Return statistics by group, lines about what is unknown, and plots."""
    held = group_frames(shots, camera)
    isos = [one.frame.iso for one in held.groups]
    letters, channels = letter_indices(held.cfa)
    lines = [*held.unknown, *_speed_lines(isos, base_iso)]
    groups, plots, blacks = [], [], {}
    for number, group in enumerate(held.groups):
        stack = group.read(letters.shape)
        gain = gain_of(group.frame, base_iso, isos)
        black = _nearest_black(blacks, group)
        with announced(f"simulating {group.words}"):
            drawn = simulate_group(
                group, stack, camera, black=black, gain=gain,
                seed=seed + OTHER_CHIP + number, device=device,
            )  # fmt: skip
        if group.kind == "dark":
            blacks[group.frame.iso, group.frame.exposure_time] = _means(stack, letters, channels)
        real, simulated = _sums(stack, drawn, letters, len(channels))
        statistics = noise_statistics(
            real, simulated, channels, is_dark=group.kind == "dark", seed=seed + number
        )
        groups.append((group.words, statistics))
        plots.append((group, real, simulated))
    from gpusim.fit.compare_plots import noise_plots

    return groups, lines, noise_plots(plots, channels)


def _speed_lines(isos, base_iso):
    """Return a line if the ISO speed of the camera file's gain is taken as that of the frames."""
    known = {iso for iso in isos if iso is not None}
    if base_iso is None and known:
        yield (
            f"the ISO speed: the camera file's gain is taken as that of ISO {known.pop():g}, the frames'; "
            "if it is another one's, give it (base_iso)"
        )


def _sums(stack, drawn, letters, count) -> tuple[NoiseSums, NoiseSums]:
    """Return the sums of both stacks, in bins of the simulated noise."""
    period = letters.shape
    temporal = drawn.var(axis=0, ddof=1, dtype=np.float64)
    variances = np.zeros((count, 2))
    for row, col in np.ndindex(*period):
        plane = temporal[row :: period[0], col :: period[1]]
        variances[letters[row, col]] += plane.sum(), plane.size
    deviations = np.sqrt(np.maximum(variances[:, 0] / variances[:, 1], 1e-4))
    is_whole = all((one == np.rint(one)).all() for one in (stack[:2], drawn[:2]))
    real, simulated = (sum_noise(one, letters, deviations, is_whole) for one in (stack, drawn))
    return real, simulated


def _means(stack, letters, channels):
    """Return the mean of each channel [DN]."""
    period = letters.shape
    found = np.zeros((len(channels), 2))
    for row, col in np.ndindex(*period):
        plane = stack[:, row :: period[0], col :: period[1]]
        found[letters[row, col]] += plane.sum(dtype=np.float64), plane.size
    return found[:, 0] / found[:, 1]


def _nearest_black(blacks: dict, group: Group) -> np.ndarray | None:
    """Return the dark level of the nearest exposure time at this ISO speed, or None."""
    if group.kind == "dark":
        return None
    time = group.frame.exposure_time or 0.0
    same: Sequence = [key for key in blacks if key[0] == group.frame.iso]
    if not same:
        return None
    return blacks[min(same, key=lambda key: abs((key[1] or 0.0) - time))]
