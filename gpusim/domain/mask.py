"""Masks in the pupil of a lens: coded apertures, cells of a light field, apodisation, phase plates."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, checked_count
from gpusim.domain.short_repr import short_repr

MOST_CELLS = 256  # of a side
LEAST_LIGHT = 1e-6  # of the light of an open pupil


@dataclass(frozen=True, eq=False)
class Mask:
    """Complex amplitude transmission in the pupil, constant in each of its cells.

    `np.asarray` returns the values.

    Attributes:
        values: Amplitudes, at most 1 in size, shape (rows, cols). The cells divide the square around the pupil, in the
            image's directions: the first row is at y = -1, the first column at x = -1. The light that passes is the
            square of the size. The phase is the same for all wavelengths.

    Raises:
        BadData: The values are no array of two axes, have more than 256 cells on a side, or are NaN or infinite.
        OutOfRange: An amplitude is larger than 1, or no light passes.
    """

    values: Any

    __repr__ = short_repr

    def __post_init__(self):
        try:
            values = np.array(self.values, np.complex128)
        except (TypeError, ValueError):
            raise BadData("optics.mask: wanted rows of numbers, equally long") from None
        if values.ndim != 2 or not values.size or max(values.shape) > MOST_CELLS:
            raise BadData(
                f"optics.mask: shape {values.shape}; wanted (rows, cols) of 1 .. {MOST_CELLS} cells"
            )
        if not np.isfinite(values).all():
            raise BadData("optics.mask: values are NaN or infinite")
        largest = np.abs(values).max()
        if largest > 1 + 1e-12:
            raise OutOfRange("optics.mask", f"an amplitude of {largest:.6g}", "0 <= amplitude <= 1")
        if np.square(np.abs(values)).mean() < LEAST_LIGHT:
            raise OutOfRange("optics.mask", "no light passes", "at least one open cell")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype, copy=copy)

    @cached_property
    def _key(self):
        return self.values.shape, self.values.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mask) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same mask on the coarsest grid of rows and columns, without closed ones at its borders.

        Edges along y (m + 1,) and along x (n + 1,), and amplitudes (m, n).
        """
        values, edges = self.values, []
        for axis in (0, 1):
            count = self.values.shape[axis]
            lines = np.moveaxis(values, axis, 0)
            lit = np.flatnonzero(lines.any(axis=1))
            first, last = lit[0], lit[-1] + 1
            changes = (lines[first + 1 : last] != lines[first : last - 1]).any(axis=1)
            starts = np.append(first, first + 1 + np.flatnonzero(changes))
            values = np.moveaxis(lines[starts], 0, axis)
            edges.append(2 * np.append(starts, last) / count - 1)
        return edges[0], edges[1], values

    def light_at(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the share of light that passes at places in the pupil, 0 outside the mask.

        Args:
            y: Rows of the places, any shape [radius of the pupil].
            x: Columns, of that shape.

        Returns:
            Shares 0 .. 1, of that shape.
        """
        edges_y, edges_x, values = self.pieces
        wide = np.pad(np.square(np.abs(values)), 1)
        return wide[np.searchsorted(edges_y, y), np.searchsorted(edges_x, x)]

    @property
    def has_phase(self) -> bool:
        """Whether it turns the phase of the light."""
        return bool(np.any(self.values.imag != 0) or np.any(self.values.real < 0))


def pupil_cells(shape: tuple[int, int]) -> list[list[Mask]]:
    """Return masks that open one cell of a grid over the pupil each.

    Args:
        shape: Number of cells along y and along x, (T, S); (1, 2) are the left and the right half.

    Returns:
        T lists of S masks. The cell (j, i) is at y = -1 + 2 j / T .. -1 + 2 (j + 1) / T, and x likewise.

    Raises:
        OutOfRange: There are fewer than one or more than 256 cells along an axis.
    """
    try:
        rows, cols = (checked_count("pupil cells", count) for count in shape)
    except TypeError:
        raise BadData(f"pupil cells: {type(shape).__name__}, wanted (rows, cols)") from None
    except ValueError:
        raise BadData("pupil cells: wanted two numbers, (rows, cols)") from None
    if max(rows, cols) > MOST_CELLS:
        raise OutOfRange("pupil cells", tuple(shape), f"1 .. {MOST_CELLS} along each axis")
    every = np.eye(rows * cols).reshape(rows, cols, rows, cols)
    return [[Mask(one) for one in row] for row in every]


def combine_masks(first: Mask, second: Mask) -> Mask:
    """Return two masks, one behind the other, on the coarsest common grid.

    Raises:
        BadData: The grid has more than 256 cells on a side.
        OutOfRange: No light passes.
    """
    shapes = [one.values.shape for one in (first, second)]
    shape = np.lcm(*shapes)
    if shape.max() > MOST_CELLS:
        raise BadData(
            f"optics.mask: masks of {shapes[0]} and {shapes[1]} cells together need {tuple(shape.tolist())}; at most "
            f"{MOST_CELLS} on a side"
        )
    fine = [
        np.kron(one.values, np.ones(shape // np.array(one.values.shape))) for one in (first, second)
    ]
    return Mask(fine[0] * fine[1])
