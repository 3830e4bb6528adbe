"""Phase over the overlap of two pupils: how fast it turns, and how many nodes an integral of it takes, float64.

How many nodes an integral takes depends on how fast the phase turns, not on how far it ranges: a first number comes
from the phase's steepest turn along and across the overlap. The places are those of `gpusim.optics.otf`: u along the
frequency s, v across it.
"""

import numpy as np

from gpusim.domain.errors import OutOfRange

UNTHREADED = (
    2**18
)  # products up to which OpenBLAS starts no threads of its own, which would fight with the pool's
LEAST = {True: 8, False: 20}  # nodes where nothing turns, fast and exact
# foreseen of all integrals of one table: at 13 (Z45) to 23 (Z28) million a second and core of Zen 4, 55 to 95 s of two
MOST_POINTS = 2.5e9


class Budget:
    """Points that an integration takes; raises OutOfRange before they are too many."""

    def __init__(self, bands):
        self.bands, self.needed, self.spent = bands, 0, 0

    def need(self, points):
        """Counts points that are foreseen."""
        self.needed += points
        self._check(self.needed)

    def spend(self, points):
        """Counts points that are taken."""
        self.spent += points
        self._check(self.spent / 2)  # nodes that are added, and those against which they are held

    def _check(self, points):
        if points * self.bands > MOST_POINTS:
            raise OutOfRange(
                "optics wavefront",
                "one that turns so often that its integrals take "
                f"{points * self.bands:.2g} points or more",
                f"up to {MOST_POINTS:.2g}: fewer waves, or terms of lower order",
            )


def separated(waves):
    """Shapes (R, n, n) without constants, and factors (bands, R): bands mostly have one wavefront, scaled."""
    waves = waves.copy()
    waves[:, 0, 0] = 0
    used = np.flatnonzero(waves.any(axis=(0, 1)) | waves.any(axis=(0, 2)))
    order = 1 + used.max(initial=0)
    u, sizes, shapes = np.linalg.svd(
        waves[:, :order, :order].reshape(len(waves), -1), full_matrices=False
    )
    rank = np.count_nonzero(sizes > 1e-14 * sizes.max(initial=0))
    return shapes[:rank].reshape(rank, order, order), u[:, :rank] * sizes[:rank]


def turning(s, angle, form):
    """Steepest phase [rad], at each frequency, per radian of the angles whose cosines are the places along and across.

    A Gauss rule of n nodes is exact for what turns by 2 n.
    """
    steps = 8 + form[0].shape[-1]  # a polynomial of this order has fewer turns
    phase = phases(s, angle, form, steps)
    return [steepest(phase, axis, np.pi / steps).max(axis=(0, -1, -2)) for axis in (-1, -2)]


def degree(turn, form, width=3):
    """Degree of a polynomial that follows exp(i phase), where the phase [rad] turns by `turn` per radian at most.

    For a phase x T_m, which turns by m x, its terms are J_k(x) of degree m k (Jacobi and Anger), and J_k ends
    a few x^(1/3), `width`, after k = x.
    """
    return turn + width * np.cbrt((form[0].shape[-1] - 1) ** 2 * turn)


def steepest(phase, axis, step):
    """Sizes of the phase's slopes [rad] between neighbours along `axis`, `step` [rad] apart."""
    return np.abs(np.diff(phase, axis=axis)) / step


def phases(s, angle, form, steps):
    """Phases [rad] in the overlap, at even angles whose cosines are the places, (bands, *s.shape, across, along)."""
    shapes, factors = form
    theta = (np.arange(steps) + 0.5) * np.pi / steps
    s, angle = (part[..., None, None] for part in np.broadcast_arrays(s, angle))
    t = np.arccos(s) * np.cos(theta)[:, None]
    u, v = (np.cos(t) - s) * np.cos(theta), np.sin(t) + np.zeros(steps)
    return 2 * np.pi * np.tensordot(factors, difference(shapes, s, angle, u, v), 1)


def difference(shapes, s, angle, u, v):
    """W(r + s) - W(r - s) [waves] of every shape at u along s and v across it; shape (R, *u.shape)."""
    cos, sin = np.cos(angle), np.sin(angle)
    plus, minus = (
        _wavefronts(shapes, cos * along - sin * v, sin * along + cos * v)
        for along in (u + s, u - s)
    )
    return plus - minus


def _wavefronts(shapes, x, y):
    """Polynomials `shapes` (R, n, n) of x^i y^j at every point, (R, *x.shape)."""
    order, shape, x, y = shapes.shape[-1], x.shape, x.ravel(), y.ravel()
    out = np.empty((len(shapes), len(x)))
    size = UNTHREADED // (max(len(shapes), 1) * order**2)
    for piece in (slice(k, k + size) for k in range(0, len(x), size)):
        powers = np.ones((order, len(x[piece])))
        for k in range(1, order):
            np.multiply(powers[k - 1], y[piece], out=powers[k])
        in_x = np.tensordot(shapes, powers, 1)
        total = in_x[:, -1]
        for k in reversed(range(order - 1)):
            total = total * x[piece] + in_x[:, k]
        out[:, piece] = total
    return out.reshape(len(shapes), *shape)
