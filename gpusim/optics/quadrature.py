"""Integrals along a row of a pupil by even samples, up to ends that lie between them."""

from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyint

ORDER = 12  # samples of the polynomial next to the end of a row
STEP = 0.25  # of the samples of the irradiance, in X
FINE = 4.0  # samples of a row in a cycle of the fastest phase: sums err by 1e-6, with 3 by 2e-5


@lru_cache(maxsize=1)
def _cumulative():
    """Integral of the local Lagrange kernel of ORDER points, as polynomials of the place in each unit cell.

    The kernel is that of the interpolant through the nearest ORDER samples: on the cell [m, m + 1) from a sample, the
    Lagrange polynomial of that sample among ORDER / 2 on each side.
    """
    half = ORDER // 2
    cells = np.empty((ORDER, ORDER + 1))
    before = 0.0
    for cell in range(-half, half):  # t = place - cell, 0 .. 1
        # the nodes, seen from the cell's start: -half + 1 .. half; the sample itself is at -cell
        nodes = np.arange(-half + 1, half + 1)
        others = nodes[nodes != -cell]
        polynomial = np.array([1.0])
        for node in others:
            polynomial = np.convolve(polynomial, np.array([-node, 1.0])) / (-cell - node)
        integral = polyint(polynomial)
        integral[0] = before
        cells[cell + half] = integral
        before = integral.sum()
    return cells


def share_of_end(distance):
    """Return the integral of the local kernel up to `distance` from its sample [steps], an array."""
    half, cells = ORDER // 2, _cumulative()
    value = (distance > 0).astype(np.float64)
    near = np.abs(distance) < half
    place = distance[near]
    cell = np.floor(place).astype(int)
    t, terms = place - cell, cells.T[:, cell + half]
    found = terms[ORDER]
    for k in reversed(range(ORDER)):
        found = found * t + terms[k]
    value[near] = found
    return value


def even_places(count):
    """Return the step and the places of the even samples of a row; some lie beyond the pupil."""
    step = 2.0 / (count - ORDER)
    return step, (np.arange(count) - (count - 1) / 2) * step
