"""Segments of a video. Each is computed independently, so resumed runs and shards equal one run.

The state of a loop over frames, for example the metered light, restarts with every segment: the
frame before its first one is computed again. A segment's frames therefore depend only on the
segment.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

from gpusim.domain.errors import OutOfRange

LENGTH = 24  # frames, by default: one extra frame in 24 costs 4 %


@dataclass(frozen=True)
class Shard:
    """Part `number` (from 0) of `count` parts of a video: a run of neighbouring segments."""

    number: int = 0
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Return the shard of the text I/N, I counted from 0. Raises ArgumentTypeError."""
        number, slash, count = text.partition("/")
        if not (slash and number.isdecimal() and count.isdecimal() and int(number) < int(count)):
            raise argparse.ArgumentTypeError(f"{text!r}: wanted I/N, I from 0 to N - 1: 0/4 .. 3/4")
        return cls(int(number), int(count))

    def of(self, segments: list[range], option: str = "--segment") -> list[range]:
        """Return the segments of this shard.

        Args:
            segments: All segments.
            option: Name of the option that sets their length, for the error.

        Raises:
            OutOfRange: If there are fewer segments than shards.
        """
        if self.count > len(segments):
            raise OutOfRange(
                "--shard",
                f"{self.number}/{self.count}",
                f"up to {len(segments)} shards, one for each {len(segments[0])}; a smaller {option} "
                "makes more",
            )
        first, end = (part * len(segments) // self.count for part in (self.number, self.number + 1))
        return segments[first:end]


def segments_of(frames: int, length: int) -> list[range]:
    """Return the segments of `frames` frames; the last one may be shorter than `length`."""
    return [range(first, min(first + length, frames)) for first in range(0, frames, length)]


def numbered_path(path: Path, number: int, count: int) -> Path:
    """Return the path of one of `count` numbered files: `a.png` gives a_0000.png, ..."""
    from gpusim.io.frame.frames import suffix_of

    suffix = suffix_of(path)
    stem = path.name.removesuffix(suffix)
    return path.with_name(f"{stem}_{number:0{max(4, len(str(count - 1)))}d}{suffix}")
