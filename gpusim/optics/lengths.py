"""Lengths of transforms: of whole frames, into which a mosaic may fold, and of tiles that overlap."""

from bisect import bisect_left
from dataclasses import dataclass
from itertools import product
from math import lcm

_PRODUCTS = {2**a * 3**b * 5**c for a, b, c in product(range(16), range(10), range(7))}
LENGTHS = tuple(sorted(length for length in _PRODUCTS if length <= 2**15))
LONGEST = 64  # samples along a side: 33 KB, which local memory holds
LANES = 8  # lines that a CPU transforms at once


def fft_length(minimum: int) -> int:
    """Return the smallest length not below `minimum` that is a product of 2, 3 and 5 (up to 32768)."""
    return LENGTHS[bisect_left(LENGTHS, minimum)]


def transform_lengths(minimum, cfa_shape):
    """Return transform lengths of at least `minimum` (rows, cols), and whether the mosaic folds into them.

    Folding takes multiples of the mosaic's period. Lengths are products of 2, 3 and 5, so a period of 7 cannot fold.
    A length is None if even the largest one is too short.

    Args:
        minimum: Rows and columns.
        cfa_shape: Rows and columns of the mosaic's period.
    """
    for period, folds in ((cfa_shape, True), ((1, 1), False)):
        rows, cols = _fitting_length(minimum[0], period[0]), _fitting_length(minimum[1], period[1])
        if rows and cols:
            return (rows, cols), folds
    return (rows, cols), False


def _fitting_length(minimum, multiple):
    """The smallest of LENGTHS that is a multiple, not below `minimum`; None if even the largest is too short."""
    for length in LENGTHS:
        if length >= minimum and length % multiple == 0:
            return length
    return None


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
        both = lcm(*period)
        return (
            0 < self.valid <= self.side <= LONGEST
            and 6**6 % self.side == 0  # a product of 2 and 3
            and self.side % (LANES * both) == 0
            and self.valid % both == 0
        )

    def samples(self, shape) -> int:
        """Samples of all tiles that make a result of `shape`."""
        rows, cols = shape
        return self.side**2 * -(-rows // self.valid) * -(-cols // self.valid)


def tiling(overlap: int, period) -> tuple[Tiling, bool]:
    """Tiles of at least this overlap, and whether a mosaic of this period, rows and columns, folds into them."""
    for side in (LONGEST, 48):
        for more in range(overlap, min(overlap + max(period), side // 2)):
            if Tiling(side, more).suits(period):
                return Tiling(side, more), True
    return Tiling(LONGEST, overlap), False
