"""A lens's transfer function along rays, float64, at so many places that cubics through them are right.

Radially where pupil and wavefront are the same at every angle, else along rays. The nodes are even in sqrt(1 - s),
s = 1 at the cut-off, where O ends as (1 - s)^(3/2). For a polygon, s is counted along each ray up to its own cut-off,
and no cubic reaches across a ray on which O has an edge: the directions of the polygon's sides, and the corners of the
cut-off.
"""

from functools import lru_cache
from math import ceil

import numpy as np

from gpusim.domain.memory import require_memory
from gpusim.domain.pupil import Pupil, symmetric
from gpusim.domain.stored import stored
from gpusim.optics.otf import FAST, defocus_only, transfer
from gpusim.optics.series import (
    expansion,
    peak_to_valley,
    points_at,
    points_of_series,
    require_points,
    scales,
)

SOME_RAYS, SOME_NODES = 6, 50  # at which one wavefront finds how many it takes, and
MORE = 1.12  # times as many, as they are not all
CUBIC_ERROR = 4e-6  # of the device's cubics along the rays and of those across them
# points of integrals, one second of two cores: beyond it pupils are sampled (gpusim.optics.sampled)
AFFORDABLE = 3e7
# the same of a polygon. Its O has bends if a corner meets a side, (d > 0) d^2, and if the hole meets a side, d^1.5.
# Cubics err there by up to 1/16 and 1/7 of the largest fourth difference, for which `cubic_error` takes 1/43: by 2.7
# times what nodes are sought for, along and across, and by more in few places next to a hole
POLYGON_NODES = 2.4e-5
POLYGON_ERROR = 1.3e-4


def radial_table(outline: Pupil, waves, error=CUBIC_ERROR) -> np.ndarray:
    """Return O at s = 1 - (1 - i / (n - 1))^2, i = 0 ..

    n - 1, shape (bands, n), if `symmetric` holds.

    n is chosen for an error of cubics through the nodes below `error`. Raises OutOfRange as
    `transfer`, DoesNotFit.
    """
    _, scaled, to_bands = scales(waves)
    length = 512 * (1 + ceil(peak_to_valley(waves)))
    table = _radial(outline, scaled.tobytes(), scaled.shape, length, error)
    require_memory("transfer tables", 16 * table.shape[1] * len(waves))
    return to_bands @ table


@lru_cache(maxsize=2)
@stored
def _radial(outline, values, shape, length, error):
    """The same for the wavefronts that are integrated, see `scales`."""
    waves = np.frombuffer(values).reshape(shape)
    series = expansion(outline, waves)
    while True:
        require_memory("transfer tables", 16 * length * len(waves))
        table = series(1 - np.linspace(1, 0, length) ** 2, np.zeros(1))[:, 0].real
        rest = cubic_error(table)
        if rest <= error:
            return table
        length = _finer(length, rest, error)


def is_too_costly(outline: Pupil, waves, affordable: float = AFFORDABLE) -> bool:
    """Return True if the integrals of a table are foreseen to take more than `affordable` points."""
    if defocus_only(outline, waves) or not waves.any():
        return False
    return foresee_points(outline, waves) > affordable


@lru_cache(maxsize=64)
def _foreseen(outline, values, shape):
    waves = np.frombuffer(values).reshape(shape)
    range_, scaled, _ = scales(waves)
    if not outline.cutoff[0]:
        return points_of_series(outline, scaled)
    sectors = 2 * outline.sides.size
    own = 2 if symmetric(Pupil(), scaled) else sectors
    rays = own * max(8, ceil(48 * (1 + range_ / 2) / sectors))
    return points_at(outline, scaled, rays * (192 + ceil(48 * range_)))


def foresee_points(outline: Pupil, waves) -> float:
    """Return the points that the integrals of a table take at least."""
    waves = np.ascontiguousarray(waves, np.float64)
    return _foreseen(outline, waves.tobytes(), waves.shape)


def polar_table(outline: Pupil, waves, error=None):
    """Return O along rays: table (bands, rays, n), first ray's angle [rad], sectors without an edge.

    The rays are even over half a turn, both ends included. The nodes are spaced as in
    `radial_table`, up to the cut-off of each ray. O at the opposite frequency is the conjugate. The
    numbers of rays and nodes are chosen for a `cubic_error` below `error` each, by default CUBIC_ERROR or
    POLYGON_NODES, with which cubics err by up to POLYGON_ERROR. Raises OutOfRange as `transfer`, DoesNotFit.
    """
    range_, scaled, to_bands = scales(waves)
    error = error or (POLYGON_NODES if outline.sides.size else CUBIC_ERROR)
    table, first, sectors = _rays(outline, scaled.tobytes(), scaled.shape, range_, error)
    require_memory("transfer tables", 32 * len(waves) * table[0].size)
    return np.tensordot(to_bands, table, 1), first, sectors


# a plan takes few wavelengths and a frame all of them, by the same wavefronts
@lru_cache(maxsize=2)
@stored
def _rays(outline, values, shape, range_, error):
    """The same for the wavefronts that are integrated, see `scales`."""
    scaled = np.frombuffer(values).reshape(shape)
    sides, _ = outline.cutoff
    sectors = max(1, 2 * outline.sides.size)
    # of one sector; few if all rays are the same
    per_sector = 8 if symmetric(outline, scaled) else max(8, ceil(48 * (1 + range_ / 2) / sectors))
    length = 192 + ceil(48 * range_)
    first = float(outline.sides[0]) if sides else 0.0
    series = None if sides else expansion(outline, scaled)
    strongest = [np.argmax((scaled**2).sum(axis=(1, 2)))]
    order = 2.5 if sides else 4

    def values(wanted, rays, nodes):
        """O of the wanted wavefronts at some rays and nodes."""
        require_memory("transfer tables", 32 * len(scaled) * sectors * per_sector * length)
        turn = np.linspace(0, np.pi, sectors * per_sector + 1)
        s = (1 - np.linspace(1, 0, length) ** 2)[nodes]
        if series:
            return series(s, turn[:-1][rays], wanted)
        return _polygon_rays(outline, scaled[wanted], s, first, turn, per_sector, rays)

    if sides:  # refused before anything is integrated
        own = _mirror_rays(scaled[strongest], sectors * per_sector, per_sector)
        require_points(outline, scaled[strongest], len(np.unique(own)) * length)
    # one wavefront finds at some rays and at some nodes how many it takes; all are held against the error everywhere
    while True:
        some = np.arange(0, per_sector * min(sectors, 3), -(-3 * per_sector // SOME_RAYS))
        along = cubic_error(values(strongest, some, slice(None)))
        if along <= error:
            break
        length = _finer(length, along, error, order)
    while True:
        few = np.unique(np.linspace(0, length - 1, SOME_NODES).astype(int))
        across = _error_across(values(strongest, slice(None), few), sectors, per_sector)
        if across <= error:
            break
        per_sector = ceil(MORE * _finer(per_sector, across, error, order))
    while True:
        table = values(slice(None), slice(None), slice(None))
        table[:, :, 0] = 1
        along, across = cubic_error(table), _error_across(table, sectors, per_sector)
        if max(along, across) <= error:
            break
        length = _finer(length, along, error, order)
        per_sector = _finer(per_sector, across, error, order)
    table = np.concatenate([table, table[:, :1].conj()], axis=1)
    return table, first, sectors


def _mirror_rays(waves, count, per_sector):
    """Return the number of the ray that has the values of each of `count` rays."""
    rays = np.arange(count)
    if symmetric(
        Pupil(), waves
    ):  # the polygon's mirror lines are two sectors apart: one part makes all
        rays = np.abs((rays + 2 * per_sector) % (4 * per_sector) - 2 * per_sector)
    return rays


def _error_across(table, sectors, per_sector):
    """Largest error of cubics across the rays (bands, rays, n) of each sector, both ends included."""
    turned = np.moveaxis(np.concatenate([table, table[:, :1].conj()], axis=1), 1, -1)
    return max(
        cubic_error(turned[..., k : k + per_sector + 1])
        for k in range(0, sectors * per_sector, per_sector)
    )


def _polygon_rays(outline, waves, s, first, turn, per_sector, wanted):
    """O of a polygon at `s` of each ray's cut-off, (bands, rays, n), of the rays that are wanted."""
    sides, inner = outline.cutoff
    step = 2 * np.pi / sides
    ends = inner / np.cos(turn - step * np.rint(turn / step))
    rays = _mirror_rays(waves, len(turn) - 1, per_sector)
    own, rays = np.unique(rays[wanted], return_inverse=True)
    require_points(outline, waves, len(own) * len(s))
    radius, angle = (ends[:, None] * s)[own], first + turn[own, None]
    sx, sy = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    found = transfer(outline, waves, sx, sy, error=FAST, fast=True)
    return found.reshape(len(waves), *radius.shape)[:, rays]


def cubic_error(table) -> float:
    """Return the largest error of cubics through the nodes along the last axis, from the fourth differences.

    Between the middle two of four nodes h apart it is 9 / 384 h^4 of the fourth derivative, in the
    outer cells 1 / 24. This holds for smooth functions; see POLYGON_ERROR for others.
    """
    fourth = np.abs(np.diff(table, 4, axis=-1))
    return float(max(9 / 384 * fourth.max(initial=0), fourth[..., [0, -1]].max() / 24))


def _finer(count, rest, error, order=4.0):
    """Nodes with which an error of this order falls to `error`."""
    if rest <= error:
        return count
    return ceil(count * min(4, max(1.1, 1.03 * (rest / error) ** (1 / order))))
