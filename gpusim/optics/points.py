"""Energy of pixels around a point of light behind any pupil: exact near the point, by the pupil's rim far from it.

The field at x samples from the image is U(s) = integral of exp(2 pi i (W(u) + s u)) over the pupil, s = x / 2 q; a
pixel of area 1 has the energy |U|^2 / (4 pi A q^2), A the open area over the circle's.

Near the point (`near_energies`) the pupil is cut into chords along x with Gauss-Legendre nodes in each. Corners are
ends of panels, and y = sin t on a circle, so that the rule converges exponentially. Its factors are separable in the
image's rows and columns.

Far from it only the rim counts. By the divergence theorem, with v = grad W + s,

    U = 1 / (2 pi i)  integral of  (n v / v^2) exp(2 pi i (W + s u))  along the rim,

but for a relative error of about laplacian(W) / (2 pi v^2). A circle of radius rho has two places where the phase
stands still, at +-rho s / |s|. Each gives the amplitude (n v / v^2) / 2 pi / sqrt(|phase''|). Their products oscillate,
and pixels see the mean of that (`Round`). A straight side of normal n and tangent t gives

    (n v / v^2) F(s t) / 2 pi,    F(a) = integral of exp(2 pi i (W + a l)) along the side,

that is a streak along n, r^-2 in length and |F|^2 across; corners between two sides fill the gaps between the streaks
with r^-4 (`Streaks`). Sources: Keller, J. Opt. Soc. Am. 52, 116 (1962), for rims; Born and Wolf, 8.5 and 8.8.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyder, polyval2d

from gpusim.domain.pupil import Pupil

PER_RING = 64  # samples of a radial profile to a diffraction ring
DIRECTIONS = 48  # around a circle, for means
LOG_STEPS = 400  # of smooth profiles along the radius
ACROSS = (
    256  # [sample] from a streak's middle up to which it is tabled; beyond, its light falls as a^-2
)
FINE = 8  # samples of a streak's profile per sample of the image


@lru_cache(maxsize=64)
def _gauss(count):
    return leggauss(count)


def _chords(outline: Pupil, count):
    """Rows of the outline without its obstruction: y, left, right and weights of y, each (rows,)."""
    nodes, mass = _gauss(count)
    if not outline.sides.size:
        t = pi / 2 * nodes
        half = np.cos(t)
        return np.sin(t), -half, half, pi / 2 * mass * half
    corners = np.stack([np.sin(outline.corners), np.cos(outline.corners)], axis=1)
    levels = np.unique(np.round(corners[:, 0], 12))
    rows = []
    for low, high in pairwise(levels):
        share = (high - low) / 2
        # slopes of the sides at both ends of its rows, and their places at y = 0
        beside = [
            ((x1 - x0) / (y1 - y0), x0 - y0 * (x1 - x0) / (y1 - y0))
            for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True)
            if min(y0, y1) <= low + 1e-9 and max(y0, y1) >= high - 1e-9 and y0 != y1
        ]
        longest = share * max(np.hypot(1, slope) for slope, _ in beside)
        nodes, mass = _gauss(ceil(count * longest) + 8)
        y = (low + high) / 2 + share * nodes
        ends = [start + slope * y for slope, start in beside]
        left, right = np.min(ends, axis=0), np.max(ends, axis=0)
        rows.append((y, left, right, share * mass))
    return tuple(np.concatenate(part) for part in zip(*rows, strict=True))


def _field(outline: Pupil, wave, rows, cols, turns) -> np.ndarray:
    """Return the field at s = place + offset of both axes, complex (places, offsets, places, offsets), down first.

    rows, cols: places and offsets along an axis, (n,) and (m,). turns: of the phase, per radius, at most.
    """
    total: Any = 0.0
    circles = [(1.0, 1.0, outline)]
    if outline.obscuration:
        circles.append((-1.0, outline.obscuration, Pupil()))
    for sign, radius, shape in circles:
        # nodes of a chord; a circle's angle runs faster by pi / 2
        many = ceil(pi * turns * radius) + 16
        y, left, right, weight = (radius * part for part in _chords(shape, ceil(pi / 2 * many)))
        nodes, mass = _gauss(many)
        middle, half = (left + right) / 2, (right - left) / 2
        x = middle[:, None] + half[:, None] * nodes
        values = weight[:, None] * half[:, None] * mass
        if wave.any():
            across, down = np.broadcast_arrays(x, y[:, None])
            values = values * np.exp(2j * pi * polyval2d(across, down, wave))
        # waves to places times waves to offsets
        offsets = np.exp(2j * pi * np.multiply.outer(cols[1], x)) * values
        places = np.exp(2j * pi * np.multiply.outer(cols[0], x))
        along = np.matmul(places.transpose(1, 0, 2), offsets.transpose(1, 2, 0))
        waves = np.exp(2j * pi * np.outer(np.add.outer(*rows).ravel(), y))
        field = waves @ along.reshape(len(y), -1)
        total = total + sign * field.reshape(len(rows[0]), len(rows[1]), *along.shape[1:])
    return total


def near_energies(outline: Pupil, wave, q: float, rows, cols, aperture, spots) -> np.ndarray:
    """Return the energy of pixels around a point's image, float64 (len(rows), len(cols)).

    Args:
        outline: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the distance of samples.
        rows: Places of the pixels' middles from the image, down, shape (R,) [sample].
        cols: The same across.
        aperture: Height and width over which pixels are integrated [sample].
        spots: Distances of a low-pass filter's spots from their middle, (rows, cols) [sample].
    """
    nodes, mass = (part / 2 for part in _gauss(ceil(4 + 2.5 * max(aperture) / q)))
    axes, shares = [], []
    for at, side, spot in zip((rows, cols), aperture, spots, strict=True):
        several = np.unique([-spot, spot])
        offsets = np.add.outer(several, side * nodes).ravel()
        axes.append((np.asarray(at, np.float64) / (2 * q), offsets / (2 * q)))
        shares.append(np.tile(mass, len(several)) / len(several))
    turns = float(np.hypot(*(np.abs(at).max() for at, _ in axes))) + steepest(wave)
    field = _field(outline, wave, axes[0], axes[1], turns)
    energy = np.einsum("iajb,a,b->ij", field.real**2 + field.imag**2, *shares, optimize=True)
    return energy / (4 * pi * outline.area * q * q)


def work_of(q: float, reach: float, slope: float) -> float:
    """Return about how many waves `near_energies` sums up to `reach` samples. slope: see `steepest`."""
    count = pi * (sqrt(2) * reach / (2 * q) + slope) + 16
    side = 2 * reach + 1
    points = side * (4 + 2.5 / q)
    return count**2 * side + count * points**2


def steepest(wave) -> float:
    """Return the largest slope of a wavefront in the pupil [waves per radius]."""
    u = np.linspace(-1, 1, 33)
    x, y = np.meshgrid(u, u)
    inside = x * x + y * y <= 1
    slopes = [polyval2d(x, y, polyder(wave, axis=axis)) for axis in (0, 1)]
    return float(np.hypot(*slopes)[inside].max())


def _slopes(wave, x, y):
    return polyval2d(x, y, polyder(wave, axis=0)), polyval2d(x, y, polyder(wave, axis=1))


def rim_centre(outline: Pupil, wave, q: float) -> np.ndarray:
    """Return the mean place where rays through the rim meet the image, (rows, cols) [sample]."""
    angle = 2 * pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    x, y = _slopes(wave, np.cos(angle), np.sin(angle))
    return -2 * q * np.array([y.mean(), x.mean()])


def rim_radius(outline: Pupil, wave, q: float) -> float:
    """Return how far from `rim_centre` rays through the rim meet the image at most [sample]."""
    angle = 2 * pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    x, y = _slopes(wave, np.cos(angle), np.sin(angle))
    return float(2 * q * np.hypot(x - x.mean(), y - y.mean()).max())


def round_profile(outline: Pupil, wave, q: float, centre, radii, part, spots) -> np.ndarray:
    """Return the energy per square sample that circular rims spread, in the mean over directions, (len(radii),).

    Args:
        outline: The pupil; of a polygon only the obstruction counts.
        wave: See `near_energies`.
        q: See `near_energies`.
        centre: Middle of the circles over which it is a mean, (rows, cols) from the ideal image [sample].
        radii: Distances from the middle, evenly spaced from 0 on [sample].
        part: Height and width over which it is averaged [sample].
        spots: Distances of a low-pass filter's spots from their middle, (rows, cols) [sample].
    """
    rims = [] if outline.sides.size else [(1.0, 1.0)]
    if outline.obscuration:
        rims.append((outline.obscuration, -1.0))
    if not rims:
        return np.zeros(len(radii))
    angle = 2 * pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    coarse = np.geomspace(max(radii[1], 0.5), max(radii[-1], 1.0) * 1.01, LOG_STEPS)
    y = (centre[0] + coarse[:, None] * np.sin(angle)) / (2 * q)
    x = (centre[1] + coarse[:, None] * np.cos(angle)) / (2 * q)
    s = np.hypot(y, x)
    terms = []  # amplitude (R, D), frequency along the direction [1/sample], path [waves] (D,) at the direction
    for rho, sign in rims:
        for side in (1.0, -1.0):
            px, py = side * rho * np.cos(angle), side * rho * np.sin(angle)
            ux, uy = side * rho * x / s, side * rho * y / s
            wx, wy = _slopes(wave, ux, uy)
            v2 = (wx + x) ** 2 + (wy + y) ** 2
            bent = np.maximum(np.abs(s - side * _bend(wave, ux, uy)), s / 4) / rho
            normal = sign * (ux * (wx + x) + uy * (wy + y)) / rho
            amplitude = normal / np.maximum(v2, (s / 4) ** 2) / (2 * pi) / np.sqrt(bent)
            terms.append((amplitude, side * rho / (2 * q), polyval2d(px, py, wave), side))
    smooth = sum(amplitude**2 for amplitude, *_ in terms).mean(axis=1)
    # averaging over a small area adds a quarter of its variance times the Laplacian, 9 / r^2 of r^-3
    variance = sum(side**2 / 12 for side in part) + sum(spot**2 for spot in spots)
    smooth = smooth * (1 + 9 / 4 * variance / coarse**2)
    total = np.exp(np.interp(np.log(np.maximum(radii, coarse[0])), np.log(coarse), np.log(smooth)))
    for (a, f, path, side), (b, g, other, its) in combinations(terms, 2):
        seen = np.ones(DIRECTIONS)
        for along, cell, spot in zip((np.sin(angle), np.cos(angle)), part, spots, strict=True):
            wave_ = (f - g) * along
            seen = seen * np.sinc(cell * wave_) * np.cos(2 * pi * spot * wave_)
        # stationary phases: + or - pi / 4 on either side
        turned = np.exp(2j * pi * (path - other) - 1j * pi / 4 * (side - its))
        factor = np.mean(seen * turned)
        size = np.interp(radii, coarse, (a * b).mean(axis=1))
        total = total + 2 * size * (factor * np.exp(2j * pi * (f - g) * radii)).real
    return np.maximum(total, 0) / (4 * pi * outline.area * q * q)


def _bend(wave, x, y):
    """Second derivative of the wavefront by the angle, over the radius [waves]."""
    radius = np.hypot(x, y)
    found, step = 0.0, 0.02
    for turn, weight in ((-step, 1.0), (0.0, -2.0), (step, 1.0)):
        c, s = np.cos(turn), np.sin(turn)
        found = found + weight * polyval2d(c * x - s * y, s * x + c * y, wave)
    return found / step**2 / np.maximum(radius, 1e-9)


@dataclass(frozen=True, eq=False)
class Streaks:
    """Light along the normals of a pupil's straight sides.

    The energy per square sample at x from the middle is the sum over all lines of (n x)^2 / |x|^4 T(t x), plus
    `corners` times the sum over neighbouring lines of c c' / |x|^4, c = (n x)(t x) / ((t x)^2 + width^2).

    Attributes:
        angles: Directions n of the lines [rad], from x towards y, shape (D,).
        profiles: T at -ACROSS .. ACROSS, FINE to a sample, (D, n).
        corners: Factor of the light between the streaks.
    """

    angles: np.ndarray
    profiles: np.ndarray
    corners: float


def line_angles(outline: Pupil) -> np.ndarray:
    """Return the directions of a polygon's streaks, in the order of its sides: opposite ones share a line."""
    sides = outline.sides
    return sides[: len(sides) // 2] if len(sides) % 2 == 0 else sides


def streaks(outline: Pupil, wave, q: float, centre, part, spots) -> Streaks:
    """Return the streaks of a polygonal pupil. For the arguments see `round_profile`."""
    angles, sides = line_angles(outline), outline.sides
    n = len(sides)
    half = np.sin(pi / n)
    across = np.arange(-ACROSS * FINE, ACROSS * FINE + 1) / FINE
    norm = 1 / (4 * pi * outline.area * q * q) * (2 * q) ** 2 / (4 * pi**2)
    profiles = np.zeros((len(angles), len(across)))
    nodes, mass = _gauss(ceil(pi * (ACROSS / (2 * q) + steepest(wave)) * half) + 24)
    for number, angle in enumerate(sides):
        normal = np.array([np.sin(angle), np.cos(angle)])  # (y, x)
        tangent = np.array([np.cos(angle), -np.sin(angle)])
        y, x = (outline.inner_radius * normal[i] + half * nodes * tangent[i] for i in (0, 1))
        line = number % len(angles)
        # the line's own tangent: its first side's
        own = np.array([np.cos(angles[line]), -np.sin(angles[line])])
        at = (across + own @ centre) / (2 * q) * (own @ tangent)
        phases = np.exp(2j * pi * np.outer(at, half * nodes))
        field = phases @ (half * mass * np.exp(2j * pi * polyval2d(x, y, wave)))
        profiles[line] += np.abs(field) ** 2 * norm
    for profile, angle in zip(profiles, angles, strict=True):
        along = np.abs([np.cos(angle), np.sin(angle)])  # of the tangent's (y, x)
        weights = _project(along * np.array(part), FINE)
        for spot, one in zip(spots, along, strict=True):
            if spot * one * FINE > 0.5:
                pair = np.zeros(2 * round(spot * one * FINE) + 1)
                pair[[0, -1]] = 0.5
                weights = np.convolve(weights, pair)
        padded = np.pad(profile, len(weights) // 2, mode="edge")
        profile[:] = np.convolve(padded, weights, "valid")[: len(profile)]
    # two corners a pair of lines if opposite sides share one; (2 q / 2 pi)^2 of the tangents' factors
    pairs = 2 if n % 2 == 0 else 1
    return Streaks(angles, profiles, -2 * pairs * norm * (2 * q) ** 2 / (4 * pi**2))


def _project(sides, fine):
    """Weights of a rectangle's points along a line: of two boxes of these widths, `fine` to a sample."""
    weights = np.ones(1)
    for side in sides:
        half = side * fine / 2
        at = np.arange(-ceil(half), ceil(half) + 1)
        box = np.clip(half + 0.5 - np.abs(at), 0, 1)
        weights = np.convolve(weights, box / box.sum())
    return weights


def streak_light(found: Streaks, y, x, width: float) -> np.ndarray:
    """Return the energy per square sample of streaks at (y, x) from their middle [sample]."""
    square = np.maximum(y * y + x * x, 1e-9)
    slants, total = [], 0.0
    for angle, profile in zip(found.angles, found.profiles, strict=True):
        along, across = y * np.sin(angle) + x * np.cos(angle), y * np.cos(angle) - x * np.sin(angle)
        place = (np.clip(across, -ACROSS, ACROSS) + ACROSS) * FINE
        value = np.interp(place, np.arange(len(profile)), profile)
        value = value * np.minimum(ACROSS / np.maximum(np.abs(across), 1e-9), 1) ** 2
        total = total + along**2 / square**2 * value
        slants.append(along * across / (across**2 + width**2))
    if len(slants) > 1:
        both = sum(a * b for a, b in zip(slants, [*slants[1:], slants[0]], strict=True))
        total = total + found.corners * both / square**2
    return np.maximum(total, 0)


def corner_width(part) -> float:
    """Return the distance from a streak's middle within which its profile has the corners' light [sample]."""
    return max(sqrt(part[0] * part[1]), 1.0)
