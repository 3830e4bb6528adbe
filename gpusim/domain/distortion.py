"""Geometric distortion: where the lens puts a point, against where a pinhole would."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.calibration import BrownConrady, Calibration, Fisheye, Framed, check_model
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import brief

SAMPLES = (
    4097  # of the field height, for the search of a turning point and the start of Newton's method
)
NEWTON_STEPS = 20  # quadratic convergence from a start within 1/SAMPLES takes four; more only near a turning point


@dataclass(frozen=True)
class RadialPolynomial:
    """x^ = scale x (1 + k1 r + k2 r^2), y alike: the seed's polynomial in field height.

    k1, k2: [1]; negative is a barrel, positive a pincushion. radius: the ideal field height where r = 1 [m].
    scale: magnification against the nominal one, each wavelength its own for lateral colour.
    Source: Farrell and Wandell, section 4.2. Raises OutOfRange.
    """

    k1: float
    k2: float
    radius: float
    scale: float = 1.0

    __repr__ = brief

    def __post_init__(self):
        check_model(self, "k1", "k2")

    def distorted(self, x, y):
        """Distorted position (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        r = np.hypot(x, y)
        factor = self.scale * (1 + self.k1 * r + self.k2 * r * r)
        return x * factor, y * factor

    def derivative(self, x, y):
        """(dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        r = np.hypot(x, y)
        factor = 1 + self.k1 * r + self.k2 * r * r
        over_r = (
            np.divide(self.k1, r, out=np.zeros_like(r), where=r > 0) + 2 * self.k2
        )  # (d factor / dr) / r
        return tuple(
            self.scale * term
            for term in (
                factor + x * x * over_r,
                x * y * over_r,
                x * y * over_r,
                factor + y * y * over_r,
            )
        )


@dataclass(frozen=True, eq=False)
class RadialTable:
    """r^ = scale f(r), f the cubic spline through measured or ray-traced pairs, odd in r.

    ideal, real: field heights [m], shape (n,), both rising from (0, 0), n >= 4; real per ideal.
    Raises BadData, OutOfRange.
    """

    ideal: np.ndarray
    real: np.ndarray
    scale: float = 1.0

    __repr__ = brief

    def __post_init__(self):
        ideal, real = np.asarray(self.ideal, np.float64), np.asarray(self.real, np.float64)
        if ideal.ndim != 1 or ideal.shape != real.shape or len(ideal) < 4:
            raise BadData(
                f"distortion table: wanted two lists of the same length >= 4, got {ideal.shape} and "
                f"{real.shape}"
            )
        for name, heights in (("ideal", ideal), ("real", real)):
            if (
                not np.isfinite(heights).all()
                or heights[0] != 0
                or not (np.diff(heights) > 0).all()
            ):
                worst = int(np.argmin(np.diff(heights))) + 1
                raise BadData(
                    f"distortion table: {name} heights must rise from 0; entry {worst} is "
                    f"{heights[worst]:.6g} m after {heights[worst - 1]:.6g} m"
                )
        object.__setattr__(self, "ideal", ideal)
        object.__setattr__(self, "real", real)
        check_model(self)
        from scipy.interpolate import CubicSpline

        mirrored = np.concatenate([-ideal[:0:-1], ideal]), np.concatenate([-real[:0:-1], real])
        curve = CubicSpline(mirrored[0] / self.radius, mirrored[1] / self.radius)
        object.__setattr__(self, "_curve", curve)
        object.__setattr__(self, "_slope", curve.derivative())

    @property
    def radius(self) -> float:
        """Unit of the positions: the last ideal height [m]."""
        return float(self.ideal[-1])

    def _radial(self, r):
        """f(r)/r and f'(r); beyond the table the last slope goes on (it is refused if the frame needs it)."""
        inside = np.minimum(r, 1.0)
        slope = self._slope(inside)
        height = self._curve(inside) + (r - inside) * slope
        return np.divide(height, r, out=np.array(self._slope(np.zeros_like(r))), where=r > 0), slope

    def distorted(self, x, y):
        """Distorted position (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        factor = self.scale * self._radial(np.hypot(x, y))[0]
        return x * factor, y * factor

    def derivative(self, x, y):
        """(dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        r = np.hypot(x, y)
        factor, slope = self._radial(r)
        over = np.divide(slope - factor, r * r, out=np.zeros_like(r), where=r > 0)
        return tuple(
            self.scale * term
            for term in (factor + x * x * over, x * y * over, x * y * over, factor + y * y * over)
        )


Model = RadialPolynomial | BrownConrady | Fisheye | RadialTable | Framed
Distortion = RadialPolynomial | BrownConrady | Fisheye | RadialTable | Calibration


def framed(distortion: Distortion, shape, pitch: float) -> Model:
    """The distortion of a frame of `shape` = (rows, cols) pixels of `pitch` [m]: a calibration's at this resolution.

    Raises OutOfRange for a calibration of another shape.
    """
    return distortion.framed(shape, pitch) if isinstance(distortion, Calibration) else distortion


def ideal(distortion: Model, x, y):
    """Ideal positions whose images are at (x, y), by Newton's method in float64, to 1e-13 of `radius`.

    x, y: distorted positions in units of `radius`. Returns (x, y), the same shapes.
    Raises OutOfRange with the field height where the mapping turns back, if that is before the farthest position.
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    if isinstance(distortion, Framed):
        return distortion.of_normalised(*ideal(distortion.lens, *distortion.normalised(x, y)))
    wanted = np.hypot(x, y)
    start_r = _start(distortion, wanted)
    u, v = (
        np.divide(start_r, wanted, out=np.ones_like(wanted), where=wanted > 0) * axis
        for axis in (x, y)
    )
    for _ in range(NEWTON_STEPS):
        at_x, at_y = distortion.distorted(u, v)
        a, b, c, d = distortion.derivative(u, v)
        determinant = a * d - b * c
        if not (determinant > 0).all():
            worst = np.unravel_index(np.argmin(determinant), determinant.shape)
            raise OutOfRange(
                "distortion",
                f"folds over at field height {np.hypot(u[worst], v[worst]):.6g} radii",
                f"one-to-one up to the frame's corner, {wanted.max():.6g} radii",
            )
        error_x, error_y = at_x - x, at_y - y
        u, v = (
            u - (d * error_x - b * error_y) / determinant,
            v - (a * error_y - c * error_x) / determinant,
        )
        if max(np.abs(error_x).max(initial=0), np.abs(error_y).max(initial=0)) <= 1e-13 * max(
            wanted.max(initial=0), 1
        ):
            return u, v
    raise OutOfRange(
        "distortion",
        "its inverse was not found",
        f"smooth and one-to-one up to the frame's corner, {wanted.max():.6g} radii",
    )


def _start(distortion, wanted):
    """Ideal field heights of distorted ones along the diagonal, by linear interpolation; refuses a turning point."""
    farthest = float(wanted.max(initial=0))
    reach = farthest / distortion.scale if farthest else 1.0
    for _ in range(
        8
    ):  # a barrel needs ideal heights beyond the distorted ones: look twice as far until it is enough
        r = np.linspace(0, reach, SAMPLES)
        height = np.hypot(*distortion.distorted(r * np.sqrt(0.5), r * np.sqrt(0.5)))
        turn = np.flatnonzero(np.diff(height) <= 0)
        peak = height[turn[0]] if len(turn) else height[-1]
        if peak >= farthest:
            if isinstance(distortion, RadialTable) and np.interp(farthest, height, r) > 1 + 1e-9:
                break
            end = turn[0] + 1 if len(turn) else SAMPLES
            return np.interp(wanted, height[:end], r[:end])
        if len(turn):
            raise OutOfRange(
                "distortion",
                f"turns back at ideal field height {r[turn[0]]:.6g} radii, where the image "
                f"is at {peak:.6g}",
                f"monotonic up to the frame's corner, {farthest:.6g} radii",
            )
        reach *= 2
    if isinstance(distortion, RadialTable):
        end = distortion.distorted(1.0, 0.0)[0]
        raise OutOfRange(
            "distortion table",
            f"ends at an image height of {end:.6g} radii",
            f"a table as far as the frame's corner, {farthest:.6g} radii",
        )
    raise OutOfRange(
        "distortion",
        f"the image of a plane ends at {peak:.6g} radii",
        "a lens that sees less than 90 "
        f"degrees from its axis up to the frame's corner, {farthest:.6g} radii",
    )
