"""Segments of a video: each is computed by itself, so that resumed runs and shards give what one run gives.

What a loop over frames remembers, such as the light of the frame before, begins anew with every segment: from the frame
before its first one, which is computed once more. So a segment's frames depend on the segment alone.
"""

import argparse
from dataclasses import dataclass

from gpusim.domain.errors import OutOfRange

LENGTH = 24  # frames, by default: one more in 24 is 4 % of work that is done twice


@dataclass(frozen=True)
class Shard:
    """The part `number` of `count` of a video, from 0 on: runs of neighbouring segments."""

    number: int = 0
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Of `i/n` on a command line, i from 0 on."""
        number, slash, count = text.partition("/")
        if not (slash and number.isdecimal() and count.isdecimal() and int(number) < int(count)):
            raise argparse.ArgumentTypeError(
                f"{text!r}: wanted I/N, I from 0 to N - 1, such as 0/4 .. 3/4"
            )
        return cls(int(number), int(count))

    def of(self, segments: list[range], option: str = "--segment") -> list[range]:
        """Its segments. option: that sets their length. Raises OutOfRange where there are fewer of them than shards."""
        if self.count > len(segments):
            raise OutOfRange(
                "--shard",
                f"{self.number}/{self.count}",
                f"up to {len(segments)} shards, one for each "
                f"{len(segments[0])}; a smaller {option} makes more",
            )
        first, end = (part * len(segments) // self.count for part in (self.number, self.number + 1))
        return segments[first:end]


def segments_of(frames: int, length: int) -> list[range]:
    """Segments of so many frames, the last one shorter where they do not divide evenly."""
    return [range(first, min(first + length, frames)) for first in range(0, frames, length)]
