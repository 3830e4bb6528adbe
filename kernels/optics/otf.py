"""Optical transfer function of any pupil with any wavefront, by Gauss quadrature over the overlap, float64.

    O(s) = 1 / A  integral of  P(r + s) P(r - s) exp(2 pi i (W(r + s) - W(r - s))) d^2r

over the overlap of two copies of the pupil, s = frequency x lambda N from the centre to the cut-off at |s| = 1.
Source: Hopkins, Proc. R. Soc. A 231 (1955); Goodman, Introduction to Fourier Optics, 6.4. The overlap is cut into
panels along the direction perpendicular to s, at every point where its outline is not smooth, so that Gauss-Legendre
nodes converge exponentially in both directions.

How many nodes that takes depends on how fast the phase turns, not on how far it ranges: a first number comes from the
phase's steepest turn along and across the overlap, and nodes are added until more of them change nothing.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebval, chebvander
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyval2d
from scipy.special import jv, roots_legendre

from gpusim.domain.errors import OutOfRange
from gpusim.domain.pupil import Pupil, symmetric

CHUNK = 2**15  # points whose phases are in the processor's cache at a time
UNTHREADED = 2**18  # products up to which OpenBLAS starts no threads of its own, which would fight with the pool's
PART = 128  # frequencies that share numbers of nodes
ANGLES, RADII = 5, 7  # at which the lengths of series are sought before they are made
PROBES = 8  # of these, which have to converge in a fast integration
EXACT, FAST = 1e-10, 1e-7  # errors of the integral; fast: of sines and cosines in float32
LEAST = {True: 8, False: 20}  # nodes where nothing turns, fast and exact
# foreseen of all integrals of one table: at 13 (Z45) to 23 (Z28) million a second and core of Zen 4, 55 to 95 s of two
MOST_POINTS = 2.5e9
UNRESOLVED = 5e-7  # last coefficients of an interpolation: three of them, twice, are a fifth of the tables' 1e-5


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
    return (2 / np.pi) * (end * half * np.sinc(8 * (waves * s)[..., None] * half) * np.cos(t)) @ weights


def transfer(pupil: Pupil, waves, sx, sy, error=EXACT, fast=False):
    """Transfer function at the frequencies (sx, sy), in units of the cut-off.

    waves: coefficients [band, i, j] of x^i y^j of the wavefront [waves], shape (bands, n, n). sx, sy: shape (F,).
    error: nodes are added along and across the overlap of every frequency until neither changes the integral by more.
    fast: sines and cosines in float32, of phases reduced in float64, which err by 1e-7, and convergence is checked, in
    float64, at some of the frequencies.
    Returns complex, shape (bands, F). Raises OutOfRange where this takes more than MOST_POINTS points in all.
    """
    waves = np.asarray(waves, np.float64)
    sx, sy = np.asarray(sx, np.float64), np.asarray(sy, np.float64)
    s, angle = np.hypot(sx, sy), np.arctan2(sy, sx)
    form = _separated(waves)
    inside = np.flatnonzero(s < 1)
    inside = inside[np.argsort(s[inside], kind="stable")]  # the phase turns alike at frequencies of one length
    parts = np.array_split(inside, -(-len(inside) // PART)) if len(inside) else []
    out, budget = np.zeros((len(waves), len(s)), complex), _Budget(len(waves))

    def probes(part):
        """Those where the phase turns most, along and across, and some of the others; more for rims that touch."""
        if not fast or len(part) <= PROBES:
            return part
        few = [np.argsort(turn)[-PROBES // 2 :] for turn in _turning(s[part], angle[part], form)]
        few += [_spread(len(part), 2 * PROBES if pupil.obscuration else PROBES // 2)]
        return part[np.unique(np.concatenate(few))]

    def integral(part, along, across, fast=False):
        rows = _rows(pupil, s[part], angle[part], across)
        budget.spend(len(rows[0]) * along)
        return _integral(rows, s[part], angle[part], form, along, fast) / (np.pi * pupil.area)

    def guess(part):
        few = probes(part)
        along, across = (LEAST[fast] + int(_degree(turn.max(), form) / 2)
                         for turn in _turning(s[few], angle[few], form))
        if pupil.blades or pupil.obscuration:
            panels = np.diff(_panels(pupil, s[few], angle[few], _faces(pupil, angle[few])), axis=1)
            across = LEAST[fast] + int((across - LEAST[fast]) * panels.max() / panels.sum(axis=1).max())
            budget.need(len(part) * along * across * np.count_nonzero(panels > 1e-13) / len(few))
        else:
            budget.need(len(part) * along * across)
        return few, (along, across)

    def settle(part, known):
        few, nodes = known
        nodes, values = _converged(lambda *nodes: integral(few, *nodes), nodes, error)
        out[:, part] = values if len(few) == len(part) else integral(part, *nodes, fast)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(settle, parts, list(pool.map(guess, parts))))
    return out


def _spread(length, count):
    """At most `count` of 0 .. length - 1, spread so that they follow no period."""
    return np.unique((np.arange(length) * 0.6180339887498949 % 1 * length).astype(int)[:count]) if (
        count < length) else np.arange(length)


class _Budget:
    """Points that an integration takes; raises OutOfRange before they are too many."""

    def __init__(self, bands):
        self.bands, self.needed, self.spent = bands, 0, 0

    def need(self, points):
        self.needed += points
        self._check(self.needed)

    def spend(self, points):
        self.spent += points
        self._check(self.spent / 2)  # nodes that are added, and those against which they are held

    def _check(self, points):
        if points * self.bands > MOST_POINTS:
            raise OutOfRange("optics wavefront", "one that turns so often that its integrals take "
                             f"{points * self.bands:.2g} points or more",
                             f"up to {MOST_POINTS:.2g}: fewer waves, or terms of lower order")


def _converged(integral, nodes, error):
    """Numbers of nodes along and across that `integral(along, across)` needs, and its value."""
    along, across = nodes
    integral = cache(integral)
    while True:
        more = along + along // 4 + 2, across + across // 4 + 2
        value = integral(along, across)
        rest = [np.abs(other - value).max() for other in (integral(more[0], across), integral(along, more[1]))]
        if max(rest) < error:
            return (along, across), value
        along, across = (after if left >= error else now
                         for now, after, left in zip((along, across), more, rest, strict=True))


def _separated(waves):
    """Shapes (R, n, n) without constants, and factors (bands, R): bands mostly have one wavefront, scaled."""
    waves = waves.copy()
    waves[:, 0, 0] = 0
    used = np.flatnonzero(waves.any(axis=(0, 1)) | waves.any(axis=(0, 2)))
    order = 1 + used.max(initial=0)
    u, sizes, shapes = np.linalg.svd(waves[:, :order, :order].reshape(len(waves), -1), full_matrices=False)
    rank = np.count_nonzero(sizes > 1e-14 * sizes.max(initial=0))
    return shapes[:rank].reshape(rank, order, order), u[:, :rank] * sizes[:rank]


def _turning(s, angle, form):
    """Steepest phase [rad], at each frequency, per radian of the angles whose cosines are the places along and across.

    A Gauss rule of n nodes is exact for what turns by 2 n.
    """
    steps = 8 + form[0].shape[-1]  # a polynomial of this order has fewer turns
    phase = _phases(s, angle, form, steps)
    return [_steepest(phase, axis, np.pi / steps).max(axis=(0, -1, -2)) for axis in (-1, -2)]


def _degree(turn, form, width=3):
    """Degree of a polynomial that follows exp(i phase), where the phase [rad] turns by `turn` per radian at most.

    For a phase x T_m, which turns by m x, its terms are J_k(x) of degree m k (Jacobi and Anger), and J_k ends
    a few x^(1/3), `width`, after k = x.
    """
    return turn + width * np.cbrt((form[0].shape[-1] - 1) ** 2 * turn)


def _steepest(phase, axis, step):
    return np.abs(np.diff(phase, axis=axis)) / step


def _phases(s, angle, form, steps):
    """Phases [rad] in the overlap, at even angles whose cosines are the places, (bands, *s.shape, across, along)."""
    shapes, factors = form
    theta = (np.arange(steps) + 0.5) * np.pi / steps
    s, angle = (part[..., None, None] for part in np.broadcast_arrays(s, angle))
    t = np.arccos(s) * np.cos(theta)[:, None]
    u, v = (np.cos(t) - s) * np.cos(theta), np.sin(t) + np.zeros(steps)
    return 2 * np.pi * np.tensordot(factors, _difference(shapes, s, angle, u, v), 1)


def _difference(shapes, s, angle, u, v):
    """W(r + s) - W(r - s) [waves] of every shape at u along s and v across it; shape (R, *u.shape)."""
    cos, sin = np.cos(angle), np.sin(angle)
    plus, minus = (_wavefronts(shapes, cos * along - sin * v, sin * along + cos * v) for along in (u + s, u - s))
    return plus - minus


@dataclass(frozen=True, eq=False)
class Expansion:
    """Transfer functions of wavefronts by a circular pupil, as series in radius and angle.

    Between the radii where O is not smooth (`edges`, see `_kinks`) it is a power series in u, s = (a + b - (b - a)
    cos(pi u)) / 2, as its (s - a)^(3/2) is then one in u^3; around the centre it is a Fourier series.
    around: (bands, orders, panels, coefficients), orders as numpy.fft has them.
    """

    edges: np.ndarray
    around: np.ndarray

    def __call__(self, s, angles, bands=slice(None)):
        """Values at radii `s` in 0 .. 1 (n,) along `angles` (rays,) [rad], complex (bands, rays, n)."""
        around = self.around[bands]
        _, orders, panels, count = around.shape
        panel = np.clip(np.searchsorted(self.edges, s, side="right") - 1, 0, panels - 1)
        a, b = self.edges[panel], self.edges[panel + 1]
        place = np.arccos(np.clip(1 - 2 * (s - a) / (b - a), -1, 1)) / np.pi
        turning = np.exp(1j * np.multiply.outer(angles, np.fft.fftfreq(orders, 1 / orders)))
        out = np.zeros((len(around), len(angles), len(s)), complex)
        for k in range(panels):
            here = panel == k
            radial = np.ascontiguousarray(chebvander(2 * place[here] - 1, count - 1).T)
            re, im = (part.reshape(-1, count) @ radial for part in (around[:, :, k].real, around[:, :, k].imag))
            lines = (re + 1j * im).reshape(len(out), orders, -1)
            out[:, :, here] = [turning @ one for one in lines]
        return out


def expansion(pupil: Pupil, waves, error=UNRESOLVED) -> Expansion:
    """Series through the integral of wavefronts (bands, n, n) at few places; for a circular pupil.

    Terms are added until the last ones are below `error`: first at few angles and few radii, then everywhere, for all
    bands. Raises OutOfRange as `transfer` does.
    """
    edges = np.unique(np.clip([0, 1, *_kinks(pupil)], 0, 1))
    strongest = _strongest(waves)
    count, rays, repeats, nodes = _foreseen(pupil, strongest, edges, error >= UNRESOLVED)
    _Budget(len(waves)).need(count * (len(edges) - 1) * rays / repeats * nodes)

    if rays > 1:  # first along few rays and around few circles
        while _series(pupil, strongest, edges, count, ANGLES, error)[1] >= error:
            count += 1 + count // 4
        while _series(pupil, strongest, edges, RADII, rays, error)[2] >= error:
            rays += 1 + rays // 4
    while True:
        around, radial_rest, angular_rest = _series(pupil, waves, edges, count, rays, error)
        if max(radial_rest, angular_rest) < error:
            return Expansion(edges, around)
        count += 1 + count // 4 if radial_rest >= error else 0
        rays += 1 + rays // 4 if angular_rest >= error else 0


def require_points(pupil: Pupil, waves, frequencies):
    """Raises OutOfRange where fast integrals at so many frequencies, out to the cut-off, take too many points."""
    _Budget(len(waves)).need(frequencies * _foreseen(pupil, _strongest(waves), np.array([0.0, 1.0]), True)[-1])


def _strongest(waves):
    return waves[np.argmax((waves**2).sum(axis=(1, 2)))][None]


def _foreseen(pupil, wave, edges, fast):
    """Terms in radius and angle that the series of one wavefront takes, repeats in half a turn, points per frequency.

    O is a mean of waves whose phases turn, as s goes outwards or around, where the overlap is described by coordinates
    that go with s; its series ends where that of the one that turns fastest does.
    """
    form, fold = _separated(wave), _turns(wave)
    steps = 8 + form[0].shape[-1]
    around = 2 * steps
    theta = (np.arange(steps) + 0.5) * np.pi / steps
    u = (1 - np.cos(theta)) / 2
    s = np.array([(a + b - (b - a) * np.cos(np.pi * u)) / 2 for a, b in pairwise(edges)])
    round_ = symmetric(pupil, wave)
    turn = np.zeros(1) if round_ else np.arange(around + 1) * min(np.pi, 2 * np.pi / fold) / around
    phase = _phases(s[..., None], turn, form, steps)
    outwards = _steepest(phase, 2, np.pi / steps).max(initial=0)
    sideways = 0.0 if round_ else _steepest(phase, 3, turn[1]).max(initial=0)
    count = 22 + int(_degree(outwards, form, 4))
    rays = 1 if round_ else 4 + int(_degree(sideways, form))
    along, across = (LEAST[fast] + _degree(_steepest(phase, axis, np.pi / steps).max(axis=(0, 3, 4, 5)), form) / 2
                     for axis in (-1, -2))
    return count, rays, max(1, fold / 2), (along * across).mean()


def peak_to_valley(waves) -> float:
    """Largest range of the wavefronts over the unit disc [waves], to a percent."""
    r, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 2 * np.pi, 65))
    values = [polyval2d(r * np.cos(t), r * np.sin(t), one) for one in waves]
    return float(np.ptp(values, axis=(1, 2)).max(initial=0)) if len(values) else 0.0


def defocus_only(pupil: Pupil, waves) -> bool:
    """Whether Hopkins' integral applies."""
    order = waves.shape[-1]
    i, j = np.indices((order, order))
    return symmetric(pupil, waves) and not pupil.obscuration and not waves[:, i + j > 2].any()


def _turns(waves) -> int:
    """How often the wavefronts repeat in a turn; 1 where they do so at every angle."""
    r, t = np.meshgrid(np.linspace(0.3, 1, 9), np.arange(64) * np.pi / 32)
    values = np.fft.rfft([polyval2d(r * np.cos(t), r * np.sin(t), one) for one in waves], axis=1)
    size = np.abs(values).max(axis=(0, 2))
    return int(np.gcd.reduce(np.flatnonzero(size > 1e-12 * size.max(initial=0)))) or 1


def _series(pupil, waves, edges, count, rays, error):
    """Coefficients (bands, 2 rays, panels, count) of `Expansion`, and the largest of the last in radius and angle."""
    u = (1 - np.cos((np.arange(count) + 0.5) * np.pi / count)) / 2
    radius = np.concatenate([(a + b - (b - a) * np.cos(np.pi * u)) / 2 for a, b in pairwise(edges)])
    fold = _turns(waves)
    # what repeats `fold` times a turn does so in half a turn too, and is conjugate from one to the next if that is odd
    repeats = fold if fold % 2 else fold // 2
    own = -(-rays // repeats)
    rays = own * repeats
    turn = np.arange(own) * np.pi / rays
    x, y = (np.multiply.outer(part, radius).ravel() for part in (np.cos(turn), np.sin(turn)))
    fast = error >= UNRESOLVED
    found = transfer(pupil, waves, x, y, error=FAST if fast else EXACT, fast=fast)
    found = found.reshape(len(waves), own, len(edges) - 1, count)
    other = found.conj() if fold % 2 else found
    found = np.concatenate([other if k % 2 else found for k in range(repeats)], axis=1)
    # opposite frequencies are conjugates: half a turn makes the whole
    around = np.fft.fft(np.concatenate([found, found.conj()], axis=1), axis=1) / (2 * rays)
    along = np.linalg.inv(chebvander(2 * u - 1, count - 1)).T
    last = slice(max(rays - fold, 0), rays + fold + 1)  # only every `fold`-th order is there
    angular_rest = np.abs(around[:, last]).max() if rays > 1 else 0.0
    return around @ along, np.abs(found @ along[:, -3:]).max(), angular_rest


def _kinks(pupil):
    """Radii at which rims of the two copies of a ring touch."""
    hole = pupil.obscuration
    return ((1 - hole) / 2, hole, (1 + hole) / 2) if hole else ()


def scales(waves, error=1e-7):
    """Range of the wavefronts [waves], the wavefronts to integrate, and their weights (bands, integrated) in the bands.

    Bands mostly have one wavefront in different units: W_l = k_l W. exp(2 pi i k D), |D| <= the range of W, has as a
    function of k over k0 +- h the Chebyshev coefficients 2 |J_n(2 pi h D)| (Jacobi and Anger); interpolation through m
    nodes errs by twice those from n = m on, and so does O, a mean of such functions.
    """
    range_ = peak_to_valley(waves)
    flat = np.asarray(waves, np.float64).reshape(len(waves), -1)
    largest = np.argmax((flat**2).sum(axis=1))
    k = flat @ flat[largest] / max((flat[largest] ** 2).sum(), np.finfo(float).tiny)
    if np.abs(flat - np.outer(k, flat[largest])).max() < 1e-12:
        middle, half = (k.max() + k.min()) / 2, (k.max() - k.min()) / 2
        rest = 4 * np.cumsum(np.abs(jv(np.arange(300), 2 * np.pi * half * range_))[::-1])[::-1]
        count = max(1, int(np.argmax(rest < error)))
        if count < len(waves):
            x = np.cos((np.arange(count) + 0.5) * np.pi / count)
            at = (k - middle) / half if half else 0 * k
            weights = chebvander(at, count - 1) @ np.linalg.inv(chebvander(x, count - 1))
            return range_, np.multiply.outer(middle + half * x, waves[largest]), weights
    return range_, waves, np.eye(len(waves))


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
    # a piece has whole frequencies' rows or parts of them; what it adds is summed
    size = max(1, min(CHUNK // nodes, UNTHREADED // (len(few) * nodes)))
    for piece in (slice(k, k + size) for k in range(0, len(index), size)):
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
    return few, to_series @ _difference(shapes, s, angle, u, v) @ to_series.T


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
        pieces = ((left, np.minimum(right, -shift - reach)),
                  (np.maximum(left, reach - shift), np.minimum(right, shift - reach)),
                  (np.maximum(left, shift + reach), right))
    else:
        pieces = ((left, right),)
    index = np.broadcast_to(index[:, None], v.shape)
    found = [np.concatenate(column) for column in zip(
        *((index[keep], v[keep], weight[keep], start[keep], end[keep])
          for start, end in pieces for keep in [end > start]), strict=True)]
    order = np.argsort(found[0], kind="stable")
    return [column[order] for column in found]


def _faces(pupil, angle):
    """Sides of the pupil, seen along the frequencies: their normals' two parts and their distance from the middle."""
    if not pupil.blades:
        return None
    normal = pupil.rotation + (2 * np.arange(pupil.blades) + 1) * np.pi / pupil.blades - angle[:, None]
    return np.cos(normal), np.sin(normal), np.cos(np.pi / pupil.blades)


def _chord(faces, index, v, t):
    """First and last u of the pupil at v = sin t."""
    if faces is None:
        return -np.cos(t), np.cos(t)
    nu, nv, inner = faces[0][index][:, None, :], faces[1][index][:, None, :], faces[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = (inner - nv * v[..., None]) / nu
    return (np.where(nu < -1e-12, cut, -np.inf).max(axis=-1), np.where(nu > 1e-12, cut, np.inf).min(axis=-1))


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
        corners = np.sort(np.sin(pupil.rotation + 2 * np.pi * np.arange(pupil.blades) / pupil.blades - angle[:, None]))
        left, right = _chord(faces, np.arange(len(s)), corners, None)
        width = right - left - 2 * column  # linear between the corners
        with np.errstate(divide="ignore", invalid="ignore"):
            share = width[:, :-1] / (width[:, :-1] - width[:, 1:])
            roots = np.where((share > 0) & (share < 1), corners[:, :-1] + share * np.diff(corners), np.nan)
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
