"""Optical transfer function of any pupil with any wavefront, by Gauss quadrature over the overlap, float64.

    O(s) = 1 / A  integral of  P(r + s) P(r - s) exp(2 pi i (W(r + s) - W(r - s))) d^2r

over the overlap of two copies of the pupil, s = frequency x lambda N from the centre to the cut-off at |s| = 1.
Source: Hopkins, Proc. R. Soc. A 231 (1955); Goodman, Introduction to Fourier Optics, 6.4. The overlap is cut into
panels along the direction perpendicular to s, at every point where its outline is not smooth, so that Gauss-Legendre
nodes converge exponentially in both directions.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyval2d

from gpusim.domain.pupil import Pupil, symmetric

CHUNK = 2**15  # points whose phases are in the processor's cache at a time


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
    across = 6 + nodes // 4 if fast and (pupil.blades or pupil.obscuration) else nodes  # many small panels
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
