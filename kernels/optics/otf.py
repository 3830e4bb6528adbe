"""Optical transfer function of any pupil with any wavefront, by Gauss quadrature over the overlap, float64.

    O(s) = 1 / A  integral of  P(r + s) P(r - s) exp(2 pi i (W(r + s) - W(r - s))) d^2r

over the overlap of two copies of the pupil, s = frequency x lambda N from the centre to the cut-off at |s| = 1.
Source: Hopkins, Proc. R. Soc. A 231 (1955); Goodman, Introduction to Fourier Optics, 6.4. The overlap is cut into
panels along the direction perpendicular to s, at every point where its outline is not smooth, so that Gauss-Legendre
nodes converge exponentially in both directions.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyval2d
from scipy.special import jv

from gpusim.domain.pupil import Pupil, symmetric

CHUNK = 2**15  # points whose phases are in the processor's cache at a time
UNRESOLVED = 5e-7  # last coefficients of an interpolation: three of them, twice, are a fifth of the tables' 1.4e-5


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


def transfer(pupil: Pupil, waves, sx, sy, extra=20, fast=False):
    """Transfer function at the frequencies (sx, sy), in units of the cut-off.

    waves: coefficients [band, i, j] of x^i y^j of the wavefront [waves], shape (bands, n, n). sx, sy: shape (F,).
    extra: Gauss nodes per panel beyond those that the wavefront needs. fast: sines and cosines in float32, of phases
    reduced in float64, which err by 1e-7, and fewer nodes across the panels of an outline with corners.
    Returns complex, shape (bands, F).
    """
    waves = np.asarray(waves, np.float64)
    sx, sy = np.asarray(sx, np.float64), np.asarray(sy, np.float64)
    s, angle = np.hypot(sx, sy), np.arctan2(sy, sx)
    # W(r + s) - W(r - s) runs over twice W's range at most, phase pi x range from the middle, half as many nodes
    nodes = extra + int(np.ceil(3.5 * peak_to_valley(waves)))
    out = np.zeros((len(waves), len(s)), complex)
    inside = np.flatnonzero(s < 1)
    across = 12 + nodes // 4 if fast and (pupil.blades or pupil.obscuration) else nodes  # many small panels
    pieces = max(1, len(inside) * nodes * nodes * (1 if not (pupil.blades or pupil.obscuration) else 8) // CHUNK)
    parts = np.array_split(inside, pieces)
    terms = [(i, j) for i, j in zip(*np.nonzero(waves.any(axis=0)), strict=True) if i + j]
    # the bands' wavefronts are mostly one shape, scaled: few shapes, and factors (bands, shapes)
    u, sizes, shapes = np.linalg.svd(np.array([waves[:, i, j] for i, j in terms]).reshape(len(terms), len(waves)).T,
                                     full_matrices=False)
    rank = np.count_nonzero(sizes > 1e-14 * sizes.max(initial=0))
    factors, shapes = u[:, :rank] * sizes[:rank], shapes[:rank]

    def integrate(part):
        rows = _rows(pupil, s[part], angle[part], across)
        out[:, part] = _integral(rows, s[part], angle[part], terms, shapes, factors, nodes, fast)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(integrate, parts))
    return out / (np.pi * pupil.area)


def interpolated(pupil: Pupil, waves, s, angles):
    """Transfer function of a circular pupil at radii `s` in 0 .. 1 (n,) along `angles` (rays,) [rad].

    Polynomials through the integral at few places: between the radii where O is not smooth (`_kinks`) it is a power
    series in u, s = (a + b - (b - a) cos(pi u)) / 2, as its (s - a)^(3/2) is then one in u^3; around the centre it is a
    Fourier series. Nodes are added until the last coefficients are below UNRESOLVED. As a function of the wavefront's
    scale O is a mean of exp(i p x), whose Chebyshev coefficients are Bessel functions: see `scales`.
    Returns complex, shape (bands, rays, n).
    """
    edges = np.unique(np.clip([0, 1, *_kinks(pupil)], 0, 1))
    range_, scaled, to_bands = scales(waves)
    count = 22 + int(np.ceil(12 * range_ / (len(edges) - 1)))
    rays = 1 if symmetric(pupil, waves) else 18 + int(np.ceil(8 * range_))
    strongest = scaled[np.argmax((scaled**2).sum(axis=(1, 2)))][None]
    while True:
        around, along = _sampled(pupil, strongest, edges, count, rays)
        radial_rest = np.abs(around @ along[-3:].T).max()
        angular_rest = np.abs(around[:, rays - 1 : rays + 2]).max() if rays > 1 else 0
        if max(radial_rest, angular_rest) < UNRESOLVED:
            break
        count += 1 + count // 4 if radial_rest >= UNRESOLVED else 0
        rays += 1 + rays // 4 if angular_rest >= UNRESOLVED else 0
    around, along = _sampled(pupil, scaled, edges, count, rays)
    panel = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, len(edges) - 2)
    a, b = edges[panel], edges[panel + 1]
    place = np.arccos(np.clip(1 - 2 * (s - a) / (b - a), -1, 1)) / np.pi
    radial = np.zeros((len(s), len(edges) - 1, count))
    radial[np.arange(len(s)), panel] = chebvander(2 * place - 1, count - 1) @ along
    orders = np.fft.fftfreq(2 * rays, 1 / (2 * rays))
    turning = np.exp(1j * np.multiply.outer(angles, orders))
    values = np.tensordot(around, radial, axes=([2, 3], [1, 2]))  # (scaled, orders, n)
    values = np.tensordot(turning, values, axes=(1, 1)).swapaxes(0, 1)
    return np.tensordot(to_bands, values, 1)


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


def _sampled(pupil, waves, edges, count, rays):
    """Fourier series around (bands, 2 rays, panels, count) of O at nodes in u, and what makes series in u of these."""
    u = (1 - np.cos((np.arange(count) + 0.5) * np.pi / count)) / 2
    radius = np.concatenate([(a + b - (b - a) * np.cos(np.pi * u)) / 2 for a, b in pairwise(edges)])
    turn = np.arange(rays) * np.pi / rays
    x, y = (np.multiply.outer(part, radius).ravel() for part in (np.cos(turn), np.sin(turn)))
    found = transfer(pupil, waves, x, y, extra=10, fast=True).reshape(len(waves), rays, len(edges) - 1, count)
    # opposite frequencies are conjugates: half a turn makes the whole
    around = np.fft.fft(np.concatenate([found, found.conj()], axis=1), axis=1) / (2 * rays)
    return around, np.linalg.inv(chebvander(2 * u - 1, count - 1))


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


def _integral(rows, s, angle, terms, shapes, factors, nodes, fast):
    """Sum over the rows of each frequency, (bands, F)."""
    index, v, weight, start, end = rows
    out = np.zeros((len(factors), len(s)), complex)
    if not len(index):
        return out
    x, gauss = leggauss(nodes)
    half = (end - start) / 2
    u = ((start + end) / 2)[:, None] + half[:, None] * x
    cos, sin, shift = (value[index, None] for value in (np.cos(angle), np.sin(angle), s))
    phase = np.zeros((len(factors), u.size))
    if terms:
        plus, minus = (_wavefronts(terms, shapes, cos * along - sin * v[:, None], sin * along + cos * v[:, None])
                       for along in (u + shift, u - shift))
        phase = factors @ (plus - minus)
    if fast:
        phase = (phase - np.rint(phase)).astype(np.float32)
    phase *= phase.dtype.type(2 * np.pi)
    first = np.flatnonzero(np.diff(index, prepend=-1))
    for part, wave in ((1, np.cos(phase)), (1j, np.sin(phase))):
        lines = wave.reshape(len(factors), *u.shape) @ gauss.astype(wave.dtype)
        out[:, index[first]] += part * np.add.reduceat(lines * (weight * half), first, axis=1)
    return out


def _wavefronts(terms, shapes, x, y):
    """Polynomials `shapes` (R, terms) of x^i y^j at every point, (R, points)."""
    order = max(i + j for i, j in terms)
    powers_x, powers_y = [np.ones(x.size)], [np.ones(y.size)]
    for _ in range(order):
        powers_x.append(powers_x[-1] * x.ravel())
        powers_y.append(powers_y[-1] * y.ravel())
    out = np.zeros((len(shapes), x.size))
    for k, (i, j) in enumerate(terms):
        product = powers_x[i] * powers_y[j]
        for one, weight in zip(out, shapes[:, k], strict=True):
            one += weight * product
    return out


def _rows(pupil, s, angle, nodes):
    """Lines of the overlap along s: frequency, offset v across s, weight, first and last u; sorted by frequency."""
    x, gauss = leggauss(nodes)
    if pupil.blades:
        normal = pupil.rotation + (2 * np.arange(pupil.blades) + 1) * np.pi / pupil.blades - angle[:, None]
        faces = np.cos(normal), np.sin(normal), np.cos(np.pi / pupil.blades)
    else:
        faces = None
    panels = _panels(pupil, s, angle, faces)
    index, place = np.nonzero(np.diff(panels, axis=1) > 1e-13)
    low, high = panels[index, place], panels[index, place + 1]
    slope = np.ones_like(x)
    if faces or pupil.obscuration:  # (3 x - x^3) / 2 makes roots at a panel's ends smooth
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
