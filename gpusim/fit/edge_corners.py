"""The lean of a blur between rows and columns, from the corners of squares.

The edges of a square show the blur along two directions. Near a corner the picture is the blur's double integral, so
that it also shows the third number of an ellipse: the correlation rho between the two directions. For a transfer
H(u^2 + v^2 + 2 rho u v) its slope by rho at rho = 0 is even in both distances from the edges, as no other error of the
model is: T(r) = -1 / (2 pi) * integral of H'(f) J0(2 pi f r) df. Corners that are rounder than the blur have it with
one sign in all four, a lean has opposite signs in neighbouring ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from gpusim.domain.short_repr import short_repr
from gpusim.fit.edge_finding import FoundEdge

if TYPE_CHECKING:
    from gpusim.fit.edge_fit import EdgeLine, LineSpread

LARGEST = 16.0  # [pixel] from the edges that are read
REACH = 2.0, 0.9  # pixels from the edges that are used: the first plus the second over MTF50
SPARE = 4  # pixels more than unknowns at a corner
ROUNDS = 3
FARTHEST = 1.0  # [pixel] of a corner from its edges' lines
TABLE = 512, 8  # samples on a side of a corner's table, and to a pixel
FREQUENCIES = np.arange(601) / 200  # [cycle/pixel]


@dataclass(frozen=True, eq=False)
class Corner:
    """Pixels of one channel around a corner of a square.

    Args:
        across: Distances from the edge that shows the blur along rows, to its lighter side [pixel], shape (N,).
        down: The same from the other edge.
        values: Light values, shape (N,).
        turn: Mean angle of the edges' normals from rows and columns [rad].
        sign: Of the product of the normals' directions along the axes x and y.
        is_dark: The square is darker than its ground.
    """

    across: np.ndarray
    down: np.ndarray
    values: np.ndarray
    turn: float
    sign: float
    is_dark: bool

    __repr__ = short_repr


@dataclass(frozen=True)
class Lean:
    """Correlation of the blur between two directions at right angles.

    Args:
        value: The correlation [1].
        error: Its standard deviation.
        turn: Mean angle of the directions from rows and columns [rad].
    """

    value: float
    error: float
    turn: float

    __repr__ = short_repr


def read_corner(
    values: np.ndarray, mask: np.ndarray, edges: Sequence[FoundEdge], lines: "Sequence[EdgeLine]"
) -> Corner | None:
    """Return the pixels of a channel around the corner of two edges of an outline.

    Args:
        values: Light values, shape (rows, cols).
        mask: Pixels of the channel.
        edges: An edge that shows the blur along rows, and one that shows it along columns.
        lines: Their lines.

    Returns:
        The pixels; None: the edges do not meet, or other edges are near.
    """
    normals = np.array([[np.sin(line.angle), np.cos(line.angle)] for line in lines])  # (row, col)
    middles = np.array([[edge.row, edge.col] for edge in edges])
    corner = np.linalg.solve(normals, np.sum(normals * middles, axis=1))
    ways = corner - middles
    gaps = [
        float(np.hypot(*way)) / edge.length - 0.5 for way, edge in zip(ways, edges, strict=True)
    ]
    if not all(0 < gap < 0.3 for gap in gaps):
        return None
    # the side of each edge on which the other one lies: -1 dark, 1 light
    sides = [np.sign(-(ways[1] @ normals[0])), np.sign(-(ways[0] @ normals[1]))]
    if sides[0] != sides[1]:
        return None
    reach = min(LARGEST, *(edge.width for edge in edges))
    top, left = (max(int(at - 1.5 * reach), 0) for at in corner)
    part = mask[top : int(corner[0] + 1.5 * reach) + 2, left : int(corner[1] + 1.5 * reach) + 2]
    rows, cols = np.nonzero(part)
    rows, cols = rows + top, cols + left
    across, down = (line.place(rows, cols)[0] for line in lines)
    near = (np.abs(across) < reach) & (np.abs(down) < reach)
    turns = [(line.angle + np.pi / 4) % (np.pi / 2) - np.pi / 4 for line in lines]
    return Corner(
        across[near],
        down[near],
        values[rows[near], cols[near]],
        float(np.mean(turns)),
        float(np.sign(normals[0, 1] * normals[1, 0])),
        bool(sides[0] < 0),
    )


def fit_lean(corners: Sequence[Corner], across: "LineSpread", down: "LineSpread") -> Lean | None:
    """Fit the lean of a blur to the corners of squares at one place.

    Args:
        corners: The corners.
        across: Blur along rows.
        down: Blur along columns.

    Returns:
        The lean; None: too few corners, or neighbouring ones are not among them.
    """
    tables = _Tables(across, down)
    seen = [(corner, *found) for corner in corners if (found := tables.fit(corner)) is not None]
    if len({corner.sign for corner, _, _ in seen}) < 2:
        return None
    signs, turns = np.array([(corner.sign, corner.turn) for corner, _, _ in seen]).T
    values, errors = np.array([(value, error) for _, value, error in seen]).T
    # corners are as round as they are: one number for all, beside the lean
    parts = np.stack([signs, np.ones_like(signs)], axis=1) / errors[:, None]
    normal = np.linalg.inv(parts.T @ parts)
    found = normal @ (parts.T @ (values / errors))
    shares = errors**-2 / np.sum(errors**-2)
    return Lean(float(found[0]), float(np.sqrt(normal[0, 0])), float(shares @ turns))


def pool_leans(leans: Sequence[Lean | None]) -> Lean | None:
    """Return one lean of all channels at a place, whose error grows if they differ by more than their noise.

    Args:
        leans: Of each channel; None: not known.

    Returns:
        The lean, or None.
    """
    known = [one for one in leans if one is not None]
    if not known:
        return None
    values, errors, turns = np.array([(one.value, one.error, one.turn) for one in known]).T
    shares = errors**-2 / np.sum(errors**-2)
    value = float(shares @ values)
    excess = np.sum(((values - value) / errors) ** 2) / max(len(known) - 1, 1)
    error = np.sqrt(max(float(excess), 1.0) / np.sum(errors**-2))
    return Lean(value, float(error), float(shares @ turns))


class _Tables:
    """Edge spreads, their slopes and the slope along the lean, for a pair of line spreads."""

    def __init__(self, across: "LineSpread", down: "LineSpread"):
        middles = (FREQUENCIES[1:] + FREQUENCIES[:-1]) / 2
        step = FREQUENCIES[1]
        halves = np.array([across.mtf50[0], down.mtf50[0]])
        self.scales = halves / np.sqrt(halves.prod())
        self.reach = REACH[0] + REACH[1] / np.sqrt(halves.prod())
        self.at = np.arange(0, LARGEST * 1.5 * 16 * self.scales.max()) / 16
        waves = 2 * np.pi * np.outer(self.at, middles)
        transfers = [line.transfer(middles) for line in (across, down)]
        self.spreads = [np.sin(waves) @ (one / middles) * step / np.pi for one in transfers]
        self.slopes = [2 * np.cos(waves) @ one * step for one in transfers]
        mean = np.mean(
            [
                line.transfer(FREQUENCIES * scale)
                for line, scale in zip((across, down), self.scales, strict=True)
            ],
            axis=0,
        )
        self.whole = _nonseparable_part((across, down), self.scales)
        self.lean = scipy.special.j0(waves) @ -np.diff(mean) / (2 * np.pi)

    def fit(self, corner: Corner):
        """Return the correlation that a corner shows, and its standard deviation; or None."""
        near = (np.abs(corner.across) < self.reach) & (np.abs(corner.down) < self.reach)
        places = np.stack([corner.across[near], corner.down[near]])
        values = corner.values[near]
        spare = len(values) - 5
        if spare < SPARE:
            return None
        shifts = np.zeros(2)
        for _ in range(ROUNDS):
            system = self._system(places - shifts[:, None], corner.is_dark)
            normal = np.linalg.pinv(system.T @ system)
            solved = normal @ (system.T @ values)
            shifts = np.clip(shifts + solved[3:] / solved[1], -FARTHEST, FARTHEST)
        variance = np.sum((values - system @ solved) ** 2) / spare
        return solved[0] / solved[1], np.sqrt(variance * normal[0, 0]) / abs(solved[1])

    def _system(self, places, is_dark):
        """Return the slopes of the light along the lean, the step, the level and the shifts of both edges, (N, 5)."""
        away = np.abs(places)
        spreads = [
            0.5 + np.sign(d) * np.interp(a, self.at, one)
            for d, a, one in zip(places, away, self.spreads, strict=True)
        ]
        slopes = [-np.interp(a, self.at, one) for a, one in zip(away, self.slopes, strict=True)]
        if is_dark:
            spreads, slopes = [1 - one for one in spreads], [-one for one in slopes]
        beside = scipy.ndimage.map_coordinates(
            self.whole, places * TABLE[1], order=1, mode="grid-wrap"
        )
        radius = np.hypot(*(places * self.scales[:, None]))
        return np.stack(
            [
                np.interp(radius, self.at, self.lean),
                spreads[0] * spreads[1] + beside,
                np.ones_like(radius),
                slopes[0] * spreads[1],
                spreads[0] * slopes[1],
            ],
            axis=1,
        )


def _nonseparable_part(lines, scales):
    """Return the corner of an elliptical blur less the product of its edges, zero in the middle, (n, n).

    The axes are the distances from the edge across rows and down columns, zero first as in a Fourier transform.
    """
    count, fine = TABLE
    at = np.fft.fftfreq(count, 1 / fine)
    own = [np.interp(np.abs(at), FREQUENCIES, line.transfer(FREQUENCIES)) for line in lines]
    u, v = at[:, None] / scales[0], at[None, :] / scales[1]
    radius = np.hypot(u, v)
    part = np.divide(u * u, radius**2, out=np.ones_like(radius), where=radius > 0)
    first, second = (
        np.interp(radius * scale, FREQUENCIES, line.transfer(FREQUENCIES, has_pixel=False), right=0)
        for line, scale in zip(lines, scales, strict=True)
    )
    pixel = np.outer(*(np.sinc(at * line.aperture) for line in lines))
    whole = (part * first + (1 - part) * second) * pixel - np.outer(*own)
    below = -4 * np.pi**2 * np.outer(at, at)
    whole = np.divide(whole, below, out=np.zeros_like(whole), where=below != 0)
    return np.fft.ifft2(whole).real * fine**2
