"""The exit pupil of a lens: the shape of its opening, and the wavefront in it.

Coordinates are the image's: x along the columns, y along the rows (down), in units of the pupil's
radius. The wavefront W(x, y) is in waves, with the sign of Welford (Aberrations of Optical Systems,
1986, eq. 7.16): a ray through (x, y) meets the image at -2 lambda N grad W from the ideal point.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import comb, factorial

import numpy as np
import scipy

from gpusim.domain.errors import FINITE, BadData, Limits, OutOfRange, check_fields
from gpusim.domain.mask import LEAST_LIGHT, Mask
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import is_increasing

# [waves] beyond it geometrical optics gives the kernel, and quadrature is wasted
LONGEST_WAVEFRONT = 40.0
PANEL = 8  # Gauss nodes between two bends of a pupil's outline


@dataclass(frozen=True)
class Pupil:
    """A circle or a regular polygon inscribed in it, with a central circular obstruction, and a mask in it.

    Attributes:
        blades: Corners of the polygon, 3 .. 64, or 0 for a circle.
        obscuration: Radius of the obstruction over the radius of the (circumscribed) circle, to
            which the f-number refers.
        rotation: Angle of the first corner from x towards y [rad].
        mask: Amplitudes inside the opening; None: 1.

    Raises:
        OutOfRange: A number is out of its range, or no light passes.
    """

    blades: int = 0
    obscuration: float = 0.0
    rotation: float = 0.0
    mask: Mask | None = None

    def __post_init__(self):
        if not (self.blades == 0 or 3 <= self.blades <= 64):
            raise OutOfRange(
                "optics.pupil.blades", self.blades, "0 (a circle) or 3 <= blades <= 64"
            )
        if not 0 <= self.obscuration < self.inner_radius:
            raise OutOfRange(
                "optics.pupil.obscuration",
                self.obscuration,
                f"0 <= obscuration < {self.inner_radius:.4g}, the radius of the circle that fits in",
            )
        check_fields("optics.pupil", self, {"rotation": Limits("a finite angle", FINITE)})
        if self.mask is not None and self.area < LEAST_LIGHT:
            raise OutOfRange(
                "optics.mask", "no light passes", "at least one open cell inside the pupil"
            )

    @cached_property
    def area(self) -> float:
        """Share of the light of the circumscribed circle that passes, its open area over the circle's [1]."""
        if self.mask is not None:
            return float(light_moments(self, 1)[0, 0] / np.pi)
        n = self.blades
        return (n / (2 * np.pi) * np.sin(2 * np.pi / n) if n else 1.0) - self.obscuration**2

    @property
    def openness(self) -> float:
        """Share of the light of the opening that the mask lets pass [1]."""
        return self.area / replace(self, mask=None).area

    @property
    def is_clear_circle(self) -> bool:
        """Whether it is a circle without an obstruction or a mask."""
        return not (self.blades or self.obscuration or self.mask)

    @property
    def sides(self) -> np.ndarray:
        """Normal directions of its straight sides [rad], from x towards y; empty for a circle."""
        n = self.blades
        return self.rotation + (2 * np.arange(n) + 1) * np.pi / max(n, 1)

    @property
    def corners(self) -> np.ndarray:
        """Directions of its corners [rad], from x towards y; empty for a circle."""
        n = self.blades
        return self.rotation + 2 * np.pi * np.arange(n) / max(n, 1)

    @property
    def inner_radius(self) -> float:
        """Radius of the largest circle inside its outline, the distance of straight sides [1]."""
        return float(np.cos(np.pi / self.blades)) if self.blades else 1.0

    @property
    def outline(self) -> float:
        """Length of its outer edge over the radius [1]."""
        return 2 * self.blades * np.sin(np.pi / self.blades) if self.blades else 2 * np.pi

    @property
    def cutoff(self) -> tuple[int, float]:
        """Sides and inner radius of the polygon outside which its transfer function is 0.

        0 sides: a circle.
        """
        n = self.blades
        if n % 2 == 0:
            return n, self.inner_radius
        return 2 * n, (1 + self.inner_radius) / 2  # a polygon and its mirror image, halfway


@dataclass(frozen=True)
class Wavefront:
    """Aberrations that are the same optical path for every wavelength.

    Attributes:
        zernike: Noll's coefficients from j = 1 on [waves RMS at `reference`], J of them, or H
            lists of J for the H field heights `heights`, linear between them. Source: Noll, J.
            Opt. Soc. Am. 66, 207 (1976).
        heights: Field heights of `zernike`, increasing, 1 at the corner; none if it is the same
            everywhere.
        seidel: W040, W131, W222, W220, W311 (spherical aberration, coma, astigmatism, field
            curvature, distortion) at field height 1 [waves at `reference`]: W = W040 r^4 + W131
            h r^3 cos t + W222 h^2 r^2 cos^2 t + W220 h^2 r^2 + W311 h^3 r cos t, t from the
            direction of the field point. Source: Welford, chapter 7.
        reference: Wavelength [nm] at which the coefficients are counted in waves.

    Raises:
        BadData: The coefficients have the wrong form.
        OutOfRange: There are too many coefficients or waves.
    """

    zernike: tuple = ()
    heights: tuple[float, ...] = ()
    seidel: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    reference: float = 550.0

    __repr__ = short_repr

    def __post_init__(self):
        try:
            zernike = np.asarray(self.zernike, np.float64)
            heights = np.asarray(self.heights, np.float64)
        except (TypeError, ValueError):
            raise BadData(
                "optics.zernike: wanted a list of numbers, or one of them for each field height, equally "
                "long"
            ) from None
        seidel = tuple(map(float, self.seidel))
        if zernike.ndim != (2 if heights.size else 1) or (
            heights.size and zernike.shape[0] != heights.size
        ):
            raise BadData(
                f"optics.zernike: shape {zernike.shape} for {heights.size} field heights; wanted one list, "
                "or one per height"
            )
        if not is_increasing(heights):
            raise BadData("optics.zernike: field heights must increase")
        if zernike.shape[-1] > 66:
            raise OutOfRange(
                "optics.zernike", f"{zernike.shape[-1]} coefficients", "up to 66 (radial order 10)"
            )
        if len(seidel) != 5:
            raise BadData(
                f"optics.seidel: wanted W040, W131, W222, W220, W311, got {len(seidel)} numbers"
            )
        if not (
            np.abs(zernike).sum(-1).max(initial=0) <= LONGEST_WAVEFRONT
            and np.abs(seidel).sum() <= LONGEST_WAVEFRONT
        ):  # also refuses NaN
            raise OutOfRange(
                "optics.zernike and optics.seidel",
                "more",
                f"up to {LONGEST_WAVEFRONT:g} waves in all",
            )
        if not 100 <= self.reference <= 100000:
            raise OutOfRange("optics.reference_nm", self.reference, "100 <= reference_nm <= 100000")
        rows = map(tuple, zernike.tolist()) if heights.size else zernike.tolist()
        object.__setattr__(self, "zernike", tuple(rows))
        object.__setattr__(self, "heights", tuple(heights.tolist()))
        object.__setattr__(self, "seidel", seidel)

    def polynomial(self, height: float = 0.0, azimuth: float = 0.0) -> np.ndarray:
        """Return the coefficients [i, j] of x^i y^j at one field point.

        The lens is symmetric about its axis: at other azimuths both kinds of coefficients turn.

        Args:
            height: Field height, 1 at the corner.
            azimuth: Direction of the field point from the image centre, from x towards y [rad].

        Returns:
            Coefficients [waves at `reference`], shape (n, n), not to be written to.
        """
        return _polynomial(self, float(height), float(azimuth))

    def _at(self, height, azimuth):
        """Coefficients at one field point, computed."""
        zernike = np.array(self.zernike)
        if self.heights:
            zernike = np.array([np.interp(height, self.heights, column) for column in zernike.T])
        w040, w131, w222, w220, w311 = self.seidel
        h = height
        order = int((np.sqrt(8 * max(len(zernike), 1) - 7) - 1) / 2)
        total = np.zeros((max(order, 4) + 1,) * 2)
        total[:5, :5] += w040 * disc_power(2) + w220 * h**2 * np.pad(disc_power(1), (0, 2))
        total[1, 0] += w311 * h**3
        total[2, 0] += w222 * h**2
        total[3, 0] += w131 * h
        total[1, 2] += w131 * h
        for j, weight in enumerate(zernike, start=1):
            if weight:
                term = noll(j)
                total[: len(term), : len(term)] += weight * term
        return _turn(total, azimuth) if azimuth else total


@lru_cache(maxsize=1024)
def _polynomial(wavefront, height, azimuth):
    """Coefficients of a wavefront at one field point, for kernels and their moments."""
    found = wavefront._at(height, azimuth)
    found.flags.writeable = False
    return found


def disc_power(k) -> np.ndarray:
    """Return the coefficients [i, j] of x^i y^j of (x^2 + y^2)^k, shape (2 k + 1, 2 k + 1)."""
    table = np.zeros((2 * k + 1, 2 * k + 1))
    for i in range(k + 1):
        table[2 * i, 2 * (k - i)] = comb(k, i)
    return table


def symmetric(pupil: Pupil, waves) -> bool:
    """Return True if pupil and wavefronts are rotationally symmetric.

    The transfer function is then real and radial.
    """
    order = waves.shape[-1]
    turned = np.zeros_like(waves)
    for k in range((order - 1) // 2 + 1):
        turned[:, : 2 * k + 1, : 2 * k + 1] += waves[:, 2 * k, 0, None, None] * disc_power(k)
    error, size = np.abs(turned - waves).max(initial=0), np.abs(waves).max(initial=0)
    return pupil.blades == 0 and pupil.mask is None and bool(error < 1e-12 * max(1, size))


@lru_cache(maxsize=128)
def noll(j) -> np.ndarray:
    """Return the coefficients [i, k] of x^i y^k of Noll's Zernike polynomial j, not to be written to.

    Its mean square over the unit disc is 1.
    """
    n = int((np.sqrt(8 * j - 7) - 1) / 2)
    rank = j - n * (n + 1) // 2 - 1  # place among the n + 1 polynomials of order n
    m = 2 * ((rank + 1) // 2) if n % 2 == 0 else 2 * (rank // 2) + 1
    table = np.zeros((n + 1, n + 1))
    norm = np.sqrt((n + 1) * (2 if m else 1))
    # R = sum of c r^(n - 2 s); r^m cos m t = Re (x + i y)^m, sine = Im
    for s in range((n - m) // 2 + 1):
        c = (
            (-1) ** s
            * factorial(n - s)
            / (factorial(s) * factorial((n + m) // 2 - s) * factorial((n - m) // 2 - s))
        )
        radial = disc_power((n - m) // 2 - s)
        for k in range(m + 1):
            # even j: cosine (even powers of y), odd j: sine
            if (k % 2 == 1) == (m > 0 and j % 2 == 1):
                sign = (-1) ** (k // 2)
                for a, b in zip(*np.nonzero(radial), strict=True):
                    table[a + m - k, b + k] += norm * c * sign * comb(m, k) * radial[a, b]
    table.flags.writeable = False
    return table


def _turn(table, angle):
    """The polynomial of coordinates turned by -`angle`: what pointed along x points along the angle."""
    cos, sin = np.cos(angle), np.sin(angle)
    out = np.zeros_like(table)
    for i, j in zip(*np.nonzero(table), strict=True):  # (cos x + sin y)^i (-sin x + cos y)^j
        for a in range(i + 1):
            for b in range(j + 1):
                weight = (
                    comb(i, a) * cos ** (i - a) * sin**a * comb(j, b) * (-sin) ** (j - b) * cos**b
                )
                out[i - a + j - b, a + b] += table[i, j] * weight
    return out


def masked_rows(pupil: Pupil, cycles: float = 0.0) -> tuple[np.ndarray, ...]:
    """Return rows of a pupil with a mask, Gauss nodes between all bends of their ends, for integrals over the pupil.

    An integral is the sum over rows of mass times the sum over pieces of amplitude times the integral along the piece.
    An obstruction has rows of its own, of negative mass.

    Args:
        pupil: The pupil; without a mask it has one piece a row.
        cycles: Cycles per radius of the fastest phase that is integrated.

    Returns:
        Places v (R,) and masses (R,) of the rows, ends of their pieces (R, n + 1), and the pieces' amplitudes (R, n).
    """
    if pupil.mask is None:
        edges_y = edges_x = np.array([-1.0, 1.0])
        values: np.ndarray = np.ones((1, 1))
    else:
        edges_y, edges_x, values = pupil.mask.pieces
    outlines = [(_polygon_rows if pupil.blades else _circle_rows)(pupil, edges_y, edges_x, cycles)]
    if pupil.obscuration:
        hole = Pupil(), edges_y / pupil.obscuration, edges_x / pupil.obscuration
        v, mass = _circle_rows(*hole, cycles * pupil.obscuration)
        outlines.append((v * pupil.obscuration, -mass * pupil.obscuration))
    found = []
    for number, (v, mass) in enumerate(outlines):
        left, right = chord(pupil, v) if number == 0 else hole_chord(pupil, v)
        ends = np.clip(edges_x, left[:, None], right[:, None])
        row = np.clip(np.searchsorted(edges_y, v, "right") - 1, 0, len(values) - 1)
        is_lit = ((np.diff(ends, axis=1) > 0) & (values[row] != 0)).any(axis=1)
        found.append((v[is_lit], mass[is_lit], ends[is_lit], values[row[is_lit]]))
    v, mass, ends, amplitudes = (np.concatenate(part) for part in zip(*found, strict=True))
    return v, mass, ends, amplitudes


def chord(pupil: Pupil, v) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last u of a pupil's rows v, both (R,), without its obstruction; outside, the same."""
    if not pupil.sides.size:
        reach = np.sqrt(np.maximum(1 - v * v, 0))
        return -reach, reach
    nx, ny = np.cos(pupil.sides), np.sin(pupil.sides)
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = (pupil.inner_radius - ny * v[:, None]) / nx
    left = np.where(nx < -1e-12, cut, -np.inf).max(axis=1)
    right = np.where(nx > 1e-12, cut, np.inf).min(axis=1)
    corners = np.sin(pupil.corners)
    is_inside = (v > corners.min() - 1e-9) & (v < corners.max() + 1e-9)
    return left, np.where(is_inside, np.maximum(left, right), left)


def hole_chord(pupil: Pupil, v) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last u of rows v of a pupil's obstruction, both (R,)."""
    reach = np.sqrt(np.maximum(pupil.obscuration**2 - v * v, 0))
    return -reach, reach


def _circle_rows(pupil, edges_y, edges_x, cycles):
    """Rows of a circle of radius 1 and their masses: Gauss nodes of the angle t, v = sin t."""
    root = np.sqrt(1 - edges_x[np.abs(edges_x) < 1] ** 2)
    bends = np.arcsin(np.clip([*edges_y, 0, *root, *-root], -1, 1))
    t, mass = _nodes(bends, edges_y[[0, -1]].clip(-1, 1), np.arcsin, 2 * cycles)
    return np.sin(t), mass * np.cos(t)


def _polygon_rows(pupil, edges_y, edges_x, cycles):
    """Rows of a polygon and their masses."""
    nx, ny = np.cos(pupil.sides), np.sin(pupil.sides)
    corners = np.sin(pupil.corners)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = (pupil.inner_radius - np.outer(edges_x, nx)) / ny
    bends = np.concatenate([corners, edges_y, crossed[np.isfinite(crossed)]])
    ends = edges_y[[0, -1]].clip(corners.min(), corners.max())
    return _nodes(bends, ends, np.asarray, 2 * cycles)


def _nodes(bends, ends, map_ends, cycles):
    """Gauss nodes and weights between bends and ends, more of them if a phase has cycles per unit."""
    first, last = map_ends(ends)
    found = [(np.empty(0), np.empty(0))]
    inside = np.append(bends[(bends > first) & (bends < last)], [first, last])
    for low, high in pairwise(np.unique(np.round(inside, 12))):
        x, weight = _gauss(PANEL + 2 * int(np.ceil(1.5 * cycles * (high - low))))
        found.append((low + (high - low) * (x + 1) / 2, weight * (high - low) / 2))
    return (np.concatenate(part) for part in zip(*found, strict=True))


@lru_cache(maxsize=256)
def _gauss(count):
    return scipy.special.roots_legendre(count)


@lru_cache(maxsize=512)
def light_moments(pupil: Pupil, count: int) -> np.ndarray:
    """Return the integrals of x^i y^j times the light that passes over the pupil, (count, count), i first."""
    v, mass, ends, amplitude = masked_rows(pupil)
    light = np.abs(amplitude) ** 2
    along = [(light * np.diff(ends ** (i + 1), axis=1)).sum(axis=1) / (i + 1) for i in range(count)]
    return np.array(along) @ (mass[:, None] * v[:, None] ** np.arange(count))
