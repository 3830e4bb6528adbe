"""Tiles that overlap: their sides, and what they share, for frames of every size."""

from dataclasses import dataclass
from math import prod

LONGEST = 64  # samples along a side: 33 KB, which local memory holds
LANES = 8  # lines that a CPU transforms at once


@dataclass(frozen=True)
class Tiling:
    """side: of a tile [sample]. overlap: of neighbours' parts of the result, on each side [sample]."""

    side: int
    overlap: int

    @property
    def valid(self) -> int:
        """Samples of the result along a side."""
        return self.side - 2 * self.overlap

    def suits(self, period) -> bool:
        """Whether a mosaic of this period, rows and columns, folds into its transforms, and any has such."""
        rest = self.side
        for radix in (2, 3):
            while rest > 0 and rest % radix == 0:
                rest //= radix
        return (
            rest == 1
            and self.side <= LONGEST
            and self.overlap >= 0
            and self.valid > 0
            and all(self.side % (LANES * n) == 0 == self.valid % n for n in period)
        )

    def samples(self, shape) -> int:
        """Samples of all tiles that make a result of `shape`."""
        return self.side**2 * prod(-(-n // self.valid) for n in shape)


def tiling(overlap: int, period) -> tuple[Tiling, bool]:
    """Tiles of at least this overlap, and whether a mosaic of this period, rows and columns, folds into them."""
    for side in (LONGEST, 48):
        for more in range(overlap, min(overlap + max(period), side // 2)):
            if Tiling(side, more).suits(period):
                return Tiling(side, more), True
    return Tiling(LONGEST, overlap), False
