"""Shots that a fit starts from: raw files, each of one kind."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.short_repr import short_repr
from gpusim.io.raw.raw_files import read_raw
from gpusim.io.raw.raw_frame import RawFrame

# content of a shot: no light; even light; any static scene, twice; colour patches; slanted edges; a
# checkerboard; even light through the lens; steps of light
KINDS = ("dark", "flat", "pairs", "chart", "edges", "grid", "shading", "ramp")


@dataclass(frozen=True)
class Shot:
    """One frame of a file, which is read when it is needed.

    Args:
        path: The file.
        index: Index of the frame in the file.
        kind: Its content, one of `KINDS`.
        settings: Fields of `RawFrame` in place of the file's.
        step: Number that divides all values, and by which they are divided.
    """

    path: Path
    index: int = 0
    kind: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    step: int = 1

    __repr__ = short_repr

    def read(self) -> RawFrame:
        """Return the frame. Raises as `read_raw`."""
        frame = read_raw(self.path, self.index, **self.settings)
        if self.step == 1:
            return frame
        black, white = frame.black_level, frame.white_level
        return replace(
            frame,
            values=frame.values // self.step,
            black_level=black / self.step if black is not None else None,
            white_level=float(white // self.step) if white is not None else None,
        )


@dataclass(frozen=True, eq=False)
class Known:
    """Numbers that a part of the fit may take as known.

    Args:
        base: Camera whose values stand for unknown ones.
        cfa: Mosaic of the shots.
        black_level: Measured black level, or else the files' [DN], shape (1, 1) or one
            number for each place of a period.
        white_level: Largest value [DN].
        gain: System gain by ISO speed [DN/e-]; empty if it was not measured.
        options: Options of the user by name, such as the light of a chart.
        shared: What other parts of the fit measured, such as the fall-off over the frame.
    """

    base: Camera
    cfa: tuple[str, ...]
    black_level: np.ndarray
    white_level: float
    gain: Mapping[float | None, float] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    shared: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr
