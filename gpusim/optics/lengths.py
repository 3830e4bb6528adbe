"""Lengths of transforms: of whole frames, into which a mosaic may fold, and of tiles that overlap."""

from dataclasses import dataclass
from math import prod

LENGTHS = tuple(
    sorted(
        2**a * 3**b * 5**c
        for a in range(16)
        for b in range(10)
        for c in range(7)
        if 2**a * 3**b * 5**c <= 2**15
    )
)
LONGEST = 64  # samples along a side: 33 KB, which local memory holds
LANES = 8  # lines that a CPU transforms at once


def fft_length(minimum: int) -> int:
    """Return the smallest length not below `minimum` that is a product of 2, 3 and 5 (up to 32768)."""
    return next(length for length in LENGTHS if length >= minimum)


def transform_lengths(minimum, cfa_shape):
    """Return transform lengths of at least `minimum` (rows, cols), and whether the mosaic folds into them.

    Folding takes multiples of the mosaic's period. Lengths are products of 2, 3 and 5, so a period of 7 cannot fold.
    A length is None if even the largest one is too short.

    Args:
        minimum: Rows and columns.
        cfa_shape: Rows and columns of the mosaic's period.
    """
    for period, folds in ((cfa_shape, True), ((1, 1), False)):
        found = tuple(
            next((length for length in LENGTHS if length >= size and length % multiple == 0), None)
            for size, multiple in zip(minimum, period, strict=True)
        )
        if None not in found:
            return found, folds
    return found, False


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
