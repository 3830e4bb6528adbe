"""Point spreads of any pupil and wavefront by Gauss's rule over its chords, at many places.

Pupils may be polygons or obscured. A chord of the pupil is a line of constant v. Chords change
smoothly between the levels of the outline's corners and of the obstruction, except for square roots
at the ends, which v = middle + half sin removes. The amplitude is the sum over all chords of the
integral along each; sums for many wavefronts share the exponentials.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil

import numpy as np

CHUNK = 2.5e7  # numbers that a sum over chords may hold at once


@dataclass(frozen=True)
class Chords:
    """Nodes of the rule: v and weights (K,), u and weights (K, J).

    area: of the pupil; a circle's is pi.
    """

    v: np.ndarray
    mass: np.ndarray
    u: np.ndarray
    weights: np.ndarray
    area: float


def corners_of(pupil) -> np.ndarray:
    """Return the corners of a polygon (y, x), shape (blades, 2)."""
    angles = pupil.rotation + 2 * np.pi * np.arange(pupil.blades) / pupil.blades
    return np.stack([np.sin(angles), np.cos(angles)], axis=1)


def outline(pupil, v, low, high):
    """Return the ends of the outer chords at v, all between the levels `low` and `high`."""
    if not pupil.blades:
        half = np.sqrt(1 - v * v)
        return -half, half
    ends, corners = [], corners_of(pupil)
    for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if min(y0, y1) < (low + high) / 2 < max(y0, y1):
            ends.append(x0 + (x1 - x0) * (v - y0) / (y1 - y0))
    return np.minimum(*ends), np.maximum(*ends)


def chords(pupil, cycles: float) -> Chords:
    """Return a rule for phases of up to `cycles` cycles per radius of the pupil."""
    levels = {-1.0, 1.0} if not pupil.blades else set(corners_of(pupil)[:, 0].round(12))
    hole = pupil.obscuration
    levels = np.unique([*levels, *([-hole, hole] if hole else [])])
    found, many = (
        [],
        ceil(np.pi * cycles * 1.1) + 24,
    )  # pi cycles nodes for a chord of length 2, and a few
    t, mass = np.polynomial.legendre.leggauss(many)
    for low, high in pairwise(levels):
        if high - low < 1e-9:
            continue
        count = ceil(np.pi**2 / 4 * cycles * (high - low) * 1.1) + 20
        s, own = np.polynomial.legendre.leggauss(count)
        v = (low + high) / 2 + (high - low) / 2 * np.sin(np.pi / 2 * s)
        own = own * np.pi / 4 * (high - low) * np.cos(np.pi / 2 * s)
        left, right = outline(pupil, v, low, high)
        parts = [(left, right)]
        if hole and abs(low + high) / 2 < hole:
            inner = np.sqrt(np.maximum(hole**2 - v * v, 0))
            parts = [(left, -inner), (inner, right)]
        for first, last in parts:
            half = (last - first) / 2
            found.append(
                (v, own, ((first + last) / 2)[:, None] + half[:, None] * t, half[:, None] * mass)
            )
    v, own, u, weights = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return Chords(v, own, u, weights, float(own @ weights.sum(axis=1)))


def spreads(rule: Chords, q: float, waves, at, tilt=None):
    """Yield energy per square sample at `at` x `at` [sample] for each of several wavefronts.

    q: wavelength times f-number over the samples' distance. waves: functions of (u, v), in waves.
    tilt: axis (0: v, 1: u) of a pupil that lets light through in proportion to the place, of which the
    energy may be negative; to the first order, that of 1 + e u is the energy of 1 and e times this.
    """
    inner, outer = np.pi / q * rule.u, np.exp(1j * np.pi / q * np.outer(at, rule.v)) * rule.mass
    part = max(1, int(CHUNK / (len(rule.v) * len(at))))
    for begin in range(0, len(waves), part):
        own = waves[begin : begin + part]
        pupil = np.stack(
            [rule.weights * np.exp(2j * np.pi * one(rule.u, rule.v[:, None])) for one in own],
            axis=1,
        )
        even = field = _field(pupil, inner, outer, at)
        if tilt is not None:
            place = rule.u[:, None] if tilt else rule.v[:, None, None]
            field = _field(pupil * place, inner, outer, at)
        for number in range(len(own)):
            energy = (even[:, number].conj() * field[:, number]).real
            yield energy / (rule.area * 4 * q * q)


def _field(pupil, inner, outer, at):
    """Return the amplitudes of wavefronts (K, n, J) at the image, (at, n, at)."""
    lines = np.empty((len(pupil), pupil.shape[1], len(at)), complex)
    for line, amplitude, u in zip(lines, pupil, inner, strict=True):
        line[:] = amplitude @ np.exp(1j * np.outer(u, at))
    return (outer @ lines.reshape(len(lines), -1)).reshape(len(at), -1, len(at))


def zernike(j: int, u, v):
    """Return Noll's polynomial j with mean square 1 over the unit disc; even j: cosine.

    Source: Noll, J. Opt. Soc. Am. 66, 207 (1976).
    """
    n = 0
    while (n + 1) * (n + 2) // 2 < j:
        n += 1
    place = j - n * (n + 1) // 2 - 1
    m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
    r, angle = np.hypot(u, v), np.arctan2(v, u)
    radial, term = np.zeros(np.shape(r)), 1.0
    for s in range((n - m) // 2 + 1):
        term = (
            (-1) ** s
            * _factorial(n - s)
            / (_factorial(s) * _factorial((n + m) // 2 - s) * _factorial((n - m) // 2 - s))
        )
        radial = radial + term * r ** (n - 2 * s)
    if m == 0:
        return np.sqrt(n + 1) * radial
    return np.sqrt(2 * (n + 1)) * radial * (np.cos(m * angle) if j % 2 == 0 else np.sin(m * angle))


def _factorial(n):
    return float(np.prod(np.arange(1, n + 1, dtype=float)))
