"""Optical transfer function of any pupil with any wavefront, by Gauss quadrature over the overlap, float64.

    O(s) = 1 / A  integral of  P(r + s) P(r - s) exp(2 pi i (W(r + s) - W(r - s))) d^2r

over the overlap of two copies of the pupil, s = frequency x lambda N from the centre to the cut-off at |s| = 1.
Source: Hopkins, Proc. R. Soc. A 231 (1955); Goodman, Introduction to Fourier Optics, 6.4. The overlap is cut into
panels along the direction perpendicular to s, at every point where its outline is not smooth, so that Gauss-Legendre
nodes converge exponentially in both directions. How many nodes it takes depends on how fast the phase turns, not on
its range: a first number comes from its steepest turn along and across the overlap (`steepest_turns`), and nodes are
added until more of them change nothing. Places in the overlap are u along the frequency s and v across it.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebval, chebvander
from numpy.polynomial.legendre import leggauss
from scipy.special import roots_legendre

from gpusim.domain.errors import OutOfRange
from gpusim.domain.pupil import Pupil, symmetric

CHUNK = 2**15  # points whose phases are in the processor's cache at a time
PART = 128  # frequencies that share numbers of nodes
PROBES = 8  # of these, which have to converge in a fast integration
EXACT, FAST = 1e-10, 1e-7  # errors of the integral; fast: of sines and cosines in float32
# products up to which OpenBLAS starts no threads, which would compete with the pool's
UNTHREADED = 2**18
LEAST = {True: 8, False: 20}  # nodes where nothing turns, fast and exact
# foreseen of all integrals of one table: at 13 (Z45) to 23 (Z28) million a second and core of Zen 4, 55 to 95 s of two
MOST_POINTS = 2.5e9


def hopkins(s, waves, nodes=None):
    """Transfer function of a clear circle with defocus W020 [waves]: Hopkins' integral, real; s and waves broadcast.

    The inner integral of the overlap is elementary: 4 / pi  int (cos t - s) sinc(8 W s (cos t - s)) cos t dt over
    0 <= t <= acos s, sinc(x) = sin(pi x) / (pi x).
    """
    s, waves = np.broadcast_arrays(np.minimum(np.abs(s), 1.0), waves)
    # the phase runs over 4 pi W, up and down: a Gauss rule needs pi nodes a wave and some more
    x, weights = leggauss(nodes or 24 + int(np.ceil(4 * np.abs(waves).max(initial=0))))
    end = np.arccos(s)[..., None]
    t = end * (x + 1) / 2
    half = np.maximum(np.cos(t) - s[..., None], 0)
    values = end * half * np.sinc(8 * (waves * s)[..., None] * half) * np.cos(t)
    return (2 / np.pi) * values @ weights


def defocus_only(pupil: Pupil, waves) -> bool:
    """Whether Hopkins' integral applies."""
    order = waves.shape[-1]
    i, j = np.indices((order, order))
    return symmetric(pupil, waves) and not pupil.obscuration and not waves[:, i + j > 2].any()


def transfer(pupil: Pupil, waves, sx, sy, error=EXACT, fast=False):
    """Return the transfer function at the frequencies (sx, sy), in units of the cut-off.

    Args:
        pupil: The pupil.
        waves: Coefficients [band, i, j] of x^i y^j of the wavefront [waves], shape (bands, n,
            n).
        sx: Frequencies across, shape (F,).
        sy: Frequencies down, shape (F,).
        error: Nodes are added along and across the overlap of every frequency until neither
            changes the integral by more.
        fast: Take sines and cosines in float32, of phases reduced in float64, with an error of
            1e-7, and check convergence, in float64, at some of the frequencies only.

    Returns:
        Complex, shape (bands, F).

    Raises:
        OutOfRange: It takes more than MOST_POINTS points in all.
    """
    waves = np.asarray(waves, np.float64)
    sx, sy = np.asarray(sx, np.float64), np.asarray(sy, np.float64)
    s, angle = np.hypot(sx, sy), np.arctan2(sy, sx)
    form = separate(waves)
    inside = np.flatnonzero(s < 1)
    # the phase turns equally fast at frequencies of one length
    inside = inside[np.argsort(s[inside], kind="stable")]
    parts = np.array_split(inside, -(-len(inside) // PART)) if len(inside) else []
    out, budget = np.zeros((len(waves), len(s)), complex), Budget(len(waves))

    def probes(part):
        """Frequencies at which the phase turns most, along and across, and some others; more if rims touch."""
        if not fast or len(part) <= PROBES:
            return part
        turns = steepest_turns(s[part], angle[part], form)
        few = np.argsort(turns, axis=1)[:, -PROBES // 2 :].ravel()
        others = _spread(len(part), 2 * PROBES if pupil.obscuration else PROBES // 2)
        return part[np.union1d(few, others)]

    def integral(part, along, across, fast=False):
        rows = _rows(pupil, s[part], angle[part], across)
        budget.spend(len(rows[0]) * along)
        return _integral(rows, s[part], angle[part], form, along, fast) / (np.pi * pupil.area)

    def guess(part):
        few = probes(part)
        along, across = (
            LEAST[fast] + int(degree(turn.max(), form) / 2)
            for turn in steepest_turns(s[few], angle[few], form)
        )
        count: float = 1
        if not pupil.is_clear_circle:
            panels = np.diff(_panels(pupil, s[few], angle[few], _faces(pupil, angle[few])), axis=1)
            more = (across - LEAST[fast]) * panels.max() / panels.sum(axis=1).max()
            across = LEAST[fast] + int(more)
            count = np.count_nonzero(panels > 1e-13) / len(few)
        budget.need(len(part) * along * across * count)
        return few, (along, across)

    def settle(part, known):
        few, nodes = known
        nodes, values = _converge(lambda *nodes: integral(few, *nodes), nodes, error)
        out[:, part] = values if len(few) == len(part) else integral(part, *nodes, fast)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(settle, parts, list(pool.map(guess, parts))))
    return out


def _spread(length, count):
    """At most `count` of 0 .. length - 1, spread without a period."""
    if count >= length:
        return np.arange(length)
    return np.unique((np.arange(length) * 0.6180339887498949 % 1 * length).astype(int)[:count])


def _converge(integral, nodes, error):
    """Numbers of nodes along and across that `integral(along, across)` needs, and its value."""
    along, across = nodes
    integral = cache(integral)
    while True:
        more = along + along // 4 + 2, across + across // 4 + 2
        value = integral(along, across)
        rest_along = np.abs(integral(more[0], across) - value).max()
        rest_across = np.abs(integral(along, more[1]) - value).max()
        if max(rest_along, rest_across) < error:
            return (along, across), value
        along = more[0] if rest_along >= error else along
        across = more[1] if rest_across >= error else across


def _integral(rows, s, angle, form, nodes, fast):
    """Sum over the rows of each frequency, (bands, F)."""
    shapes, factors = form
    index, v, weight, start, end = rows
    out = np.zeros((len(factors), len(s)), complex)
    x, gauss = _gauss(nodes)
    # along a row W is a polynomial: its values at few points make those at all nodes
    few, box = _box(shapes, s, angle)
    between = chebvander(x, len(few) - 1) @ np.linalg.inv(chebvander(few, len(few) - 1))
    middle, half = (start + end) / 2, (end - start) / 2
    width, height = 1 - s, np.sqrt(1 - s * s)
    # a piece has rows of whole frequencies or of parts of them; pieces are summed
    size = max(1, min(CHUNK // nodes, UNTHREADED // (len(few) * nodes)))
    for k in range(0, len(index), size):
        piece = slice(k, k + size)
        i, h = index[piece], half[piece]
        row = np.einsum("rfij,fj->irf", box[:, i], chebvander(v[piece] / height[i], len(few) - 1))
        u = (middle[piece, None] + h[:, None] * few) / width[i, None]
        phase = np.tensordot(factors, chebval(u, row[..., None], tensor=False), 1) @ between.T
        if fast:
            phase = (phase - np.rint(phase)).astype(np.float32)
        phase *= phase.dtype.type(2 * np.pi)
        first = np.flatnonzero(np.diff(i, prepend=-1))
        for part, wave in ((1, np.cos(phase)), (1j, np.sin(phase))):
            lines = np.einsum("brn,n->br", wave, gauss.astype(wave.dtype))
            out[:, i[first]] += part * np.add.reduceat(lines * (weight[piece] * h), first, axis=1)
    return out


def _box(shapes, s, angle):
    """Chebyshev points (n,), and series (R, F, n, n) of the differences in the places u and v of the overlap's box."""
    few = chebpts1(shapes.shape[-1])
    to_series = np.linalg.inv(chebvander(few, len(few) - 1))
    s, angle = s[:, None, None], angle[:, None, None]
    u, v = np.broadcast_arrays((1 - s) * few[:, None], np.sqrt(1 - s * s) * few)
    return few, to_series @ difference(shapes, s, angle, u, v) @ to_series.T


@lru_cache(maxsize=256)
def _gauss(nodes):
    return roots_legendre(nodes)


def _rows(pupil, s, angle, nodes):
    """Lines of the overlap along s: frequency, offset v across s, weight, first and last u; sorted by frequency."""
    x, gauss = _gauss(nodes)
    faces = _faces(pupil, angle)
    panels = _panels(pupil, s, angle, faces)
    index, place = np.nonzero(np.diff(panels, axis=1) > 1e-13)
    low, high = panels[index, place], panels[index, place + 1]
    slope = np.ones_like(x)
    if pupil.obscuration:  # (3 x - x^3) / 2 makes roots at a panel's ends smooth
        x, slope = (3 * x - x**3) / 2, 1.5 * (1 - x * x)
    t = ((low + high) / 2)[:, None] + ((high - low) / 2)[:, None] * x
    v, weight = np.sin(t), ((high - low) / 2)[:, None] * slope * gauss * np.cos(t)
    left, right = _chord(faces, index, v, t)
    shift = s[index, None]
    left, right = left + shift, right - shift
    if pupil.obscuration:
        reach = np.sqrt(np.maximum(pupil.obscuration**2 - v * v, 0))
        starts = left, np.maximum(left, reach - shift), np.maximum(left, shift + reach)
        ends = np.minimum(right, -shift - reach), np.minimum(right, shift - reach), right
        left, right = np.stack(starts), np.stack(ends)
    columns = np.broadcast_arrays(index[:, None], v, weight, left, right)
    keep = columns[4] > columns[3]
    order = np.argsort(columns[0][keep], kind="stable")
    return [column[keep][order] for column in columns]


def _faces(pupil, angle):
    """Sides of the pupil, seen along the frequencies: their normals' two parts and their distance from the middle."""
    if not pupil.sides.size:
        return None
    normal = pupil.sides - angle[:, None]
    return np.cos(normal), np.sin(normal), pupil.inner_radius


def _chord(faces, index, v, t):
    """First and last u of the pupil at v = sin t."""
    if faces is None:
        return -np.cos(t), np.cos(t)
    nu, nv, inner = faces[0][index][:, None, :], faces[1][index][:, None, :], faces[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = (inner - nv * v[..., None]) / nu
    first = np.where(nu < -1e-12, cut, -np.inf).max(axis=-1)
    return first, np.where(nu > 1e-12, cut, np.inf).min(axis=-1)


def _panels(pupil, s, angle, faces):
    """Values of t, v = sin t, between which the outline of the overlap is smooth, ascending, shape (F, panels + 1)."""
    hole = pupil.obscuration
    column = s[:, None]
    if faces is None:
        high = np.sqrt(1 - column**2)
        low, kinks = -high, [-high, high]
        if hole:  # of a hole with the other copy's rim: circles of radii 1 and hole, 2 s apart
            with np.errstate(divide="ignore", invalid="ignore"):
                across = np.sqrt(1 - ((4 * column**2 + 1 - hole**2) / (4 * column)) ** 2)
            kinks += [-across, across]
    else:
        corners = np.sort(np.sin(pupil.corners - angle[:, None]))
        left, right = _chord(faces, np.arange(len(s)), corners, None)
        width = right - left - 2 * column  # linear between the corners
        with np.errstate(divide="ignore", invalid="ignore"):
            share = width[:, :-1] / (width[:, :-1] - width[:, 1:])
            roots = corners[:, :-1] + share * np.diff(corners)
            roots[~((share > 0) & (share < 1))] = np.nan
        kinks = [corners, roots]
        if hole:
            nu, nv, inner = faces
            for sign in (1, -1):
                distance = inner + sign * 2 * column * nu
                with np.errstate(invalid="ignore"):
                    root = np.sqrt(hole**2 - distance**2)
                kinks += [distance * nv - root * nu, distance * nv + root * nu]
        low, high = corners[:, :1], corners[:, -1:]
    if hole:
        with np.errstate(invalid="ignore"):
            both = np.sqrt(hole**2 - column**2)
        kinks += [np.full_like(column, -hole), np.full_like(column, hole), -both, both]
    kinks = np.concatenate(kinks, axis=1)
    return np.sort(np.arcsin(np.clip(np.where(np.isnan(kinks), low, kinks), low, high)), axis=1)


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


def separate(waves):
    """Shapes (R, n, n) without constants, and factors (bands, R): bands mostly have one wavefront, scaled."""
    waves = waves.copy()
    waves[:, 0, 0] = 0
    used = np.flatnonzero(waves.any(axis=(0, 1)) | waves.any(axis=(0, 2)))
    order = 1 + used.max(initial=0)
    flat = waves[:, :order, :order].reshape(len(waves), -1)
    u, sizes, shapes = np.linalg.svd(flat, full_matrices=False)
    rank = np.count_nonzero(sizes > 1e-14 * sizes.max(initial=0))
    return shapes[:rank].reshape(rank, order, order), u[:, :rank] * sizes[:rank]


def steepest_turns(s, angle, form):
    """Return the steepest phase [rad] at each frequency, per radian of the angles with cosines along and across.

    A Gauss rule of n nodes is exact for phases that turn by 2 n.
    """
    steps = 8 + form[0].shape[-1]  # a polynomial of this order has fewer turns
    phase = phases(s, angle, form, steps)
    return [steepest(phase, axis, np.pi / steps).max(axis=(0, -1, -2)) for axis in (-1, -2)]


def degree(turn, form, width=3):
    """Return the degree of a polynomial that follows exp(i phase), the phase [rad] turning by `turn` per radian.

    For a phase x T_m, which turns by m x, its terms are J_k(x) of degree m k (Jacobi and Anger),
    and J_k ends a few x^(1/3), `width`, after k = x.
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
    plus, minus = u + s, u - s
    first = _wavefronts(shapes, cos * plus - sin * v, sin * plus + cos * v)
    return first - _wavefronts(shapes, cos * minus - sin * v, sin * minus + cos * v)


def _wavefronts(shapes, x, y):
    """Polynomials `shapes` (R, n, n) of x^i y^j at every point, (R, *x.shape)."""
    order, shape = shapes.shape[-1], x.shape
    x, y = x.ravel(), y.ravel()
    out = np.empty((len(shapes), len(x)))
    size = UNTHREADED // (max(len(shapes), 1) * order**2)
    for start in range(0, len(x), size):
        piece = slice(start, start + size)
        powers = np.ones((order, len(x[piece])))
        for k in range(1, order):
            np.multiply(powers[k - 1], y[piece], out=powers[k])
        in_x = np.tensordot(shapes, powers, 1)
        total = in_x[:, -1]
        for k in reversed(range(order - 1)):
            total = total * x[piece] + in_x[:, k]
        out[:, piece] = total
    return out.reshape(len(shapes), *shape)
