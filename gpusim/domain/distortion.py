"""Geometric distortion: image positions of a lens relative to an ideal pinhole."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.calibration import (
    BrownConrady,
    Calibration,
    Fisheye,
    Framed,
    Radial,
    check_model,
)
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import is_increasing

# Field heights at which turning points are searched, and from which Newton's method starts.
SAMPLES = 4097
# Quadratic convergence from a start within 1/SAMPLES takes four; only turning points need more.
NEWTON_STEPS = 20


@dataclass(frozen=True)
class RadialPolynomial:
    """Radial distortion as a polynomial in field height: x^ = scale x (1 + k1 r + k2 r^2).

    y^ follows the same formula.

    Args:
        k1, k2: Coefficients [1]. Negative ones make a barrel, positive ones a pincushion.
        radius: Ideal field height of r = 1 [m].
        scale: Magnification relative to the nominal one [1]; it differs between wavelengths for
            lateral colour.

    Raises:
        OutOfRange: A coefficient is not finite, or radius or scale is not positive.

    Source:
        Farrell and Wandell, section 4.2.
    """

    k1: float
    k2: float
    radius: float
    scale: float = 1.0

    __repr__ = short_repr

    def __post_init__(self):
        check_model(self, "k1", "k2")

    def distort(self, x, y):
        """Return the image (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        r = np.hypot(x, y)
        factor = self.scale * (1 + self.k1 * r + self.k2 * r * r)
        return x * factor, y * factor

    def derivative(self, x, y):
        """Return (dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        r = np.hypot(x, y)
        factor = 1 + self.k1 * r + self.k2 * r * r
        # (d factor / dr) / r
        over_r = np.divide(self.k1, r, out=np.zeros_like(r), where=r > 0) + 2 * self.k2
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
class RadialTable(Radial):
    """Radial distortion as a table: r^ = scale f(r) with the cubic spline f through the entries.

    The spline is odd in r.

    Args:
        ideal, real: Measured or ray-traced field heights [m], shape (n,), n >= 4, both increasing
            from 0; `real` is the image height of `ideal`.
        scale: Magnification relative to the nominal one [1].

    Raises:
        BadData: The heights have different lengths, or do not increase from 0.
        OutOfRange: The scale is not positive.
    """

    ideal: np.ndarray
    real: np.ndarray
    scale: float = 1.0

    __repr__ = short_repr

    def __post_init__(self):
        ideal, real = np.asarray(self.ideal, np.float64), np.asarray(self.real, np.float64)
        if ideal.ndim != 1 or ideal.shape != real.shape or len(ideal) < 4:
            raise BadData(
                f"distortion table: wanted two lists of the same length >= 4, got {ideal.shape} and "
                f"{real.shape}"
            )
        for name, heights in (("ideal", ideal), ("real", real)):
            if not is_increasing(heights) or heights[0] != 0:
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
        """Return f(r)/r and f'(r). Beyond the table f continues with its last slope.

        If the frame needs heights beyond the table, `_start` refuses it.
        """
        inside = np.minimum(r, 1.0)
        slope = self._slope(inside)
        height = self._curve(inside) + (r - inside) * slope
        return np.divide(height, r, out=np.array(self._slope(np.zeros_like(r))), where=r > 0), slope


Model = RadialPolynomial | BrownConrady | Fisheye | RadialTable | Framed
Distortion = RadialPolynomial | BrownConrady | Fisheye | RadialTable | Calibration


def fit_to_frame(distortion: Distortion, shape, pitch: float) -> Model:
    """Return the distortion for a frame; a calibration is scaled to its resolution.

    Args:
        distortion: Distortion of a lens.
        shape: Rows and columns of the frame [pixel].
        pitch: Pixel pitch [m].

    Returns:
        The distortion with positions relative to the centre of the frame.

    Raises:
        OutOfRange: A calibration is of another aspect ratio.
    """
    return (
        distortion.fit_to_frame(shape, pitch) if isinstance(distortion, Calibration) else distortion
    )


def ideal(distortion: Model, x, y):
    """Return the ideal positions whose images are at (x, y).

    Newton's method in float64, to 1e-13 of `radius`.

    Args:
        distortion: Distortion of the frame.
        x: Distorted positions along columns, in units of `radius`.
        y: Distorted positions along rows.

    Returns:
        Ideal positions (x, y), same shapes.

    Raises:
        OutOfRange: The mapping folds over before the farthest position; the message names the field
            height.
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    if isinstance(distortion, Framed):
        return distortion.denormalise(*ideal(distortion.lens, *distortion.normalise(x, y)))
    wanted = np.hypot(x, y)
    start_r = _start(distortion, wanted)
    u, v = (
        np.divide(start_r, wanted, out=np.ones_like(wanted), where=wanted > 0) * axis
        for axis in (x, y)
    )
    for _ in range(NEWTON_STEPS):
        at_x, at_y = distortion.distort(u, v)
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
        u = u - (d * error_x - b * error_y) / determinant
        v = v - (a * error_y - c * error_x) / determinant
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
    """Return approximate ideal field heights on a diagonal. Raise OutOfRange if they turn back."""
    farthest = float(wanted.max(initial=0))
    reach = farthest / distortion.scale if farthest else 1.0
    for _ in range(8):  # a barrel needs larger ideal heights: double the range until they fit
        r = np.linspace(0, reach, SAMPLES)
        height = np.hypot(*distortion.distort(r * np.sqrt(0.5), r * np.sqrt(0.5)))
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
                f"turns back at ideal field height {r[turn[0]]:.6g} radii, with the image "
                f"at {peak:.6g}",
                f"monotonic up to the frame's corner, {farthest:.6g} radii",
            )
        reach *= 2
    if isinstance(distortion, RadialTable):
        end = distortion.distort(1.0, 0.0)[0]
        raise OutOfRange(
            "distortion table",
            f"ends at an image height of {end:.6g} radii",
            f"a table as far as the frame's corner, {farthest:.6g} radii",
        )
    raise OutOfRange(
        "distortion",
        f"the image of a plane ends at {peak:.6g} radii",
        "a lens that sees less than 90 "
        f"degrees from its axis up to the frame's corner, {farthest:.6g} radii; or a panorama, see "
        "gs.view_panorama",
    )
