"""The edges of a pupil with a mask: they decide how its light falls far from a point.

Across an edge the amplitude jumps by J. A length l of it throws the energy |J|^2 l / (2 pi^3 A) q r^-3 per square
sample into the mean of all directions, A the open area, as a whole edge of J = 1 does (`gpusim.optics.farfield`):
amplitudes of different edges do not add in the mean, as their phases turn against each other.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.special import roots_legendre

from gpusim.domain.pupil import Pupil, chord, hole_chord
from gpusim.optics.farfield import edge_tail

ROUND = 1024  # points of a circle
NODES = 6  # of a straight piece
INSIDE = 1e-9  # of the radius


@dataclass(frozen=True)
class Edges:
    """Points along edges.

    Attributes:
        places: (x, y), shape (2, E) [radius].
        steps: Length and direction of the edge that a point stands for, (x, y), shape (2, E) [radius].
        squares: |J|^2, shape (E,).
        turns: Im(m_1* m_2) of the amplitudes before and behind an edge between cells, along x or y, shape (E,).
        normals: Angle of the normal of a straight edge, modulo pi, -1 of a round one [rad], shape (E,).
    """

    places: np.ndarray
    steps: np.ndarray
    squares: np.ndarray
    turns: np.ndarray
    normals: np.ndarray

    def weights(self, half=(1.0, 1.0)) -> np.ndarray:
        """Return length times |J|^2 of each point, shape (E,).

        half: (y, x) of an opening, in whose scale lengths are measured.
        """
        across, down = self.steps
        return self.squares * np.hypot(across / half[1], down / half[0])

    def shares(self, half=(1.0, 1.0)) -> dict[float, float]:
        """Return the share of each normal of straight edges in all weights."""
        weights = self.weights(half)
        all_, normals = max(weights.sum(), 1e-300), np.unique(self.normals[self.normals >= 0])
        return {
            float(one): float(weights[self.normals == one].sum() / all_)
            for one in normals
            if weights[self.normals == one].any()
        }

    def rays(self, wave) -> np.ndarray:
        """Return where rays through the edges meet the image, (y, x), shape (2, E) [2 q sample]."""
        x, y = self.places
        return -np.array([polyval2d(x, y, polyder(wave, axis=axis)) for axis in (1, 0)])

    def mean_rays(self, waves, q) -> np.ndarray:
        """Return the mean place where rays through the edges meet the image, (L, 2) [sample]."""
        share = self.weights() / self.weights().sum()
        return np.array(
            [2 * one * (self.rays(wave) @ share) for wave, one in zip(waves, q, strict=True)]
        )

    def squares_of_rays(self, waves, q) -> np.ndarray:
        """Return the means of b^2 and b^4, b how far from the image rays through the edges land [sample], (L, 2)."""
        share = self.weights() / self.weights().sum()
        found = []
        for wave, one in zip(waves, q, strict=True):
            square = (2 * one) ** 2 * (self.rays(wave) ** 2).sum(axis=0)
            found.append((square @ share, square**2 @ share))
        return np.array(found)


@lru_cache(maxsize=128)
def mean_turn(pupil: Pupil) -> np.ndarray:
    """Return the slope of a wavefront that moves the light's centroid as steps of a mask's phase do.

    The centroid is the mean of Im(P* grad P) / 2 pi. At a step from m_1 to m_2 along n it is n Im(m_1* m_2) / 2 pi.

    Returns:
        Along y and x [waves per radius].
    """
    edges = edges_of(pupil)
    # an edge that runs along y has its normal along x
    found = np.abs(edges.steps) @ edges.turns / (2 * np.pi) / (np.pi * pupil.area)
    found.flags.writeable = False
    return found


@lru_cache(maxsize=128)
def edges_of(pupil: Pupil) -> Edges:
    """Return the edges of a pupil with a mask."""
    parts = [*_outline(pupil), *_hole(pupil), *_cells(pupil)]
    found = [np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)]
    is_edge = (found[2] > 0) | (found[3] != 0)
    return Edges(*(part[..., is_edge] for part in found))


def edge_strength(pupil: Pupil, half=(1.0, 1.0)) -> float:
    """Return the energy per square sample times r^3 / q that a pupil's edges spread far from a point.

    half: (y, x) of an opening, in whose scale it is.
    """
    if pupil.mask is None and half == (1.0, 1.0):
        return edge_tail(pupil)
    area = np.pi * pupil.area / (half[0] * half[1])
    return float(edges_of(pupil).weights(half).sum() / area / (2 * np.pi**3))


def _light(pupil, x, y):
    """Return the light that passes the mask at places."""
    return np.ones_like(x) if pupil.mask is None else pupil.mask.light_at(y, x)


def _circle(pupil, radius, inside):
    """Edges along a circle."""
    t = (np.arange(ROUND) + 0.5) * (2 * np.pi / ROUND)
    turn = np.stack([np.cos(t), np.sin(t)])
    steps = np.stack([-turn[1], turn[0]]) * (2 * np.pi * radius / ROUND)
    light = _light(pupil, *(inside * radius * turn))
    return radius * turn, steps, light, np.zeros(ROUND), np.full(ROUND, -1.0)


def _outline(pupil):
    if not pupil.sides.size:
        return [_circle(pupil, 1.0, 1 - INSIDE)]
    found, count = [], max(ROUND // pupil.sides.size, 16)
    along = (np.arange(count) + 0.5) / count
    corners = np.stack([np.cos(pupil.corners), np.sin(pupil.corners)])
    for first, last, angle in zip(
        corners.T, np.roll(corners, -1, axis=1).T, pupil.sides, strict=True
    ):
        places = first[:, None] + np.outer(last - first, along)
        steps = np.repeat((last - first)[:, None] / count, count, axis=1)
        normals = np.full(count, np.round(angle % np.pi, 9) % np.pi)
        light = _light(pupil, *(places * (1 - INSIDE)))
        found.append((places, steps, light, np.zeros(count), normals))
    return found


def _hole(pupil):
    return [_circle(pupil, pupil.obscuration, 1 + INSIDE)] if pupil.obscuration else []


def _cells(pupil):
    """Edges between cells of the mask, inside the outline."""
    if pupil.mask is None:
        return []
    edges_y, edges_x, values = pupil.mask.pieces
    turned = _Turned(pupil)
    return [
        _lines(edges_x, edges_y, values.T, turned.ends, turned.hole, is_upright=True),
        _lines(edges_y, edges_x, values, lambda at: chord(pupil, at), turned.hole, False),
    ]


class _Turned:
    """Columns of a pupil."""

    def __init__(self, pupil):
        self.pupil = pupil

    def ends(self, x):
        """First and last y of the columns x."""
        pupil = self.pupil
        if pupil.sides.size:  # rows of the pupil that is mirrored at the diagonal
            pupil = Pupil(pupil.sides.size, 0.0, np.pi / 2 - pupil.rotation)
        return chord(pupil, x)

    def hole(self, at):
        """First and last place of the obstruction along lines at these distances."""
        return hole_chord(self.pupil, at)


def _lines(at, along, values, ends, hole, is_upright):
    """Edges along lines `at`, between cells of `values` (lines - 1, cells along them)."""
    values = np.pad(values, ((1, 1), (0, 0)))
    before, behind = values[:-1], values[1:]
    is_inside = np.abs(at) < 1
    at = at[is_inside]
    jumps = np.square(np.abs(behind - before))[is_inside]
    turns = np.imag(before.conj() * behind)[is_inside]
    low, high = ends(at)
    hole_low, hole_high = hole(at)
    x, share = roots_legendre(NODES)
    parts = []
    for first, last in ((low, np.minimum(hole_low, high)), (np.maximum(hole_high, low), high)):
        last = np.maximum(first, last)
        cut = np.clip(along, first[:, None], last[:, None])
        long = np.diff(cut, axis=1)[..., None] / 2  # (lines, cells, 1)
        place = (cut[:, :-1, None] + long) + long * x
        own = np.broadcast_to(at[:, None, None], place.shape)
        length = long * share
        both = (own, place), (0 * length, length)
        places, steps = (
            np.stack([part.ravel() for part in (one if is_upright else one[::-1])]) for one in both
        )
        squares, turned = (
            np.broadcast_to(one[..., None], place.shape).ravel() for one in (jumps, turns)
        )
        normals = np.full(squares.shape, 0.0 if is_upright else np.pi / 2)
        parts.append((places, steps, squares, turned, normals))
    return tuple(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
