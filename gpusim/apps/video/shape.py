"""The geometry of a video's frames: turned and mirrored by a display matrix, with square pixels."""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from gpusim.domain.errors import BadData

ONE = 1 << 16  # of a display matrix
MOST_ASPECT = 16  # ratio of a pixel's sides
LONGEST = 1 << 15  # samples along an axis


class Turn(NamedTuple):
    """A picture turned by right angles and mirrored.

    Attributes:
        swaps: Whether rows become columns.
        flips_cols: Whether columns are then reversed.
        flips_rows: Whether rows are then reversed.
    """

    swaps: bool = False
    flips_cols: bool = False
    flips_rows: bool = False

    def apply(self, values: np.ndarray) -> np.ndarray:
        """Return a turned copy of values (rows, cols, channels)."""
        values = values.swapaxes(0, 1) if self.swaps else values
        values = values[:, ::-1] if self.flips_cols else values
        return np.ascontiguousarray(values[::-1] if self.flips_rows else values)


def read_matrix(data: bytes) -> tuple[Turn, Fraction]:
    """Return what a display matrix does: a turn, then a stretch of columns relative to rows.

    The point (p, q), right and down, of a stored frame is shown at (a p + c q + x, b p + d q + y).

    Args:
        data: Nine integers a, b, u, c, d, v, x, y, w of 32 bits, as libavutil stores them.

    Raises:
        BadData: If it turns by other than right angles, or has a perspective.
    """
    if len(data) != 36:
        raise BadData(f"its display matrix has {len(data)} bytes; wanted 36")
    a, b, u, c, d, v, _, _, _ = np.frombuffer(data, "=i4").tolist()
    small = max(map(abs, (a, b, c, d))) / 2**10  # a rotation's cosine that was rounded
    is_straight = abs(b) <= small and abs(c) <= small
    is_swapped = abs(a) <= small and abs(d) <= small
    across, down = (c, b) if is_swapped else (a, d)
    if u or v or is_straight == is_swapped or not across or not down:
        raise BadData(
            "its display matrix turns frames by other than 0, 90, 180 or 270 degrees; turn the video "
            "when encoding it"
        )
    return Turn(is_swapped, across < 0, down < 0), Fraction(abs(across), abs(down))


def square_size(cols: int, rows: int, aspect: Fraction) -> tuple[int, int]:
    """Return columns and rows of a frame with square pixels; no axis has fewer samples.

    Args:
        cols: Stored columns.
        rows: Stored rows.
        aspect: Width of a pixel over its height.

    Raises:
        BadData: If the pixels are too far from square.
    """
    if not Fraction(1, MOST_ASPECT) <= aspect <= MOST_ASPECT:
        raise BadData(f"its pixels have a width of {float(aspect):.3g} heights; wanted 1/16 .. 16")
    if aspect < 1:
        return cols, max(round(rows / aspect), 1)
    return max(round(cols * aspect), 1), rows
