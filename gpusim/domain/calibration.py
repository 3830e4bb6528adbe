"""Camera geometry from calibration: OpenCV's camera matrix and its two distortion models."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from gpusim.domain.errors import (
    FINITE,
    BadData,
    Limits,
    OutOfRange,
    check_fields,
    checked_count,
    within,
)
from gpusim.domain.short_repr import short_repr

PINHOLE = (  # OpenCV's order
    *("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    *("s1", "s2", "s3", "s4", "tau_x", "tau_y"),
)
FISHEYE = ("k1", "k2", "k3", "k4")
COUNTS = (0, 4, 5, 8, 12, 14)  # numbers of coefficients that OpenCV knows for a pinhole
FINITE_NUMBER = Limits("a finite number", FINITE)
POSITIVE = {key: within(f"0 < {key} < inf") for key in ("radius", "scale")}
TILTS = {key: within(f"-1.5 <= {key} <= 1.5", "rad") for key in ("tau_x", "tau_y")}
MOST_SKEW = 0.1  # of fx: rows and columns of a sensor are nearly perpendicular
FOCAL_LENGTHS = {key: within(f"0 < {key} < inf pixels") for key in ("fx", "fy")}
ROUNDING = 1.0  # [pixel]; scaled sizes are rounded to whole pixels


def check_model(distortion, *coefficients):
    """Raise OutOfRange unless the coefficients are finite and radius and scale are positive."""
    check_fields("distortion", distortion, dict.fromkeys(coefficients, FINITE_NUMBER) | POSITIVE)


@dataclass(frozen=True)
class BrownConrady:
    """Radial, decentring and thin-prism distortion on a sensor that may be tilted.

        x^ = x N(r^2) / D(r^2) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4

    y^ is the same with x and y, and p1 and p2, exchanged, and with s3 and s4. N(q) = 1 + k1 q + k2
    q^2 + k3 q^3, D(q) = 1 + k4 q + k5 q^2 + k6 q^3. The result is projected onto a sensor tilted by
    tau_x and tau_y, and multiplied by `scale`. The coefficients equal OpenCV's (calib3d) if
    `radius` is the focal length.

    Args:
        k1, k2, k3, k4, k5, k6: Radial coefficients [1].
        p1, p2: Decentring coefficients [1].
        radius: Unit of the positions [m].
        scale: Magnification relative to the nominal one [1].
        s1, s2, s3, s4: Thin-prism coefficients [1].
        tau_x, tau_y: Tilt of the sensor [rad].

    Raises:
        OutOfRange: A coefficient is not finite, the tilt is too steep, or radius or scale is not
            positive.

    Source:
        Brown, Photogrammetric Engineering 32 (1966) 444; Claus and Fitzgibbon, CVPR 2005
        (rational); Weng, Cohen and Herniou, PAMI 14 (1992) 965 (thin prism); Louhichi et al., Meas.
        Sci. Technol. 18 (2007) 2616 (tilt).
    """

    k1: float
    k2: float
    k3: float
    p1: float
    p2: float
    radius: float
    scale: float = 1.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    tau_x: float = 0.0
    tau_y: float = 0.0

    __repr__ = short_repr

    def __post_init__(self):
        check_model(self, *PINHOLE)
        check_fields("distortion", self, TILTS)

    @cached_property
    def _tilt(self):
        """Projective map onto the tilted sensor along the axis, (3, 3); None without a tilt."""
        if not (self.tau_x or self.tau_y):
            return None
        (cx, cy), (sx, sy) = np.cos([self.tau_x, self.tau_y]), np.sin([self.tau_x, self.tau_y])
        turn = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ [
            [1, 0, 0],
            [0, cx, sx],
            [0, -sx, cx],
        ]
        return (
            np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
        )

    def _distort_without_tilt(self, x, y):
        """Return (x^, y^) without tilt and scale, the radial factor, and its derivative over r."""
        q = x * x + y * y
        above = 1 + q * (self.k1 + q * (self.k2 + q * self.k3))
        below = 1 + q * (self.k4 + q * (self.k5 + q * self.k6))
        factor = above / below
        slope = (
            2
            * (
                self.k1
                + q * (2 * self.k2 + q * 3 * self.k3)
                - factor * (self.k4 + q * (2 * self.k5 + q * 3 * self.k6))
            )
            / below
        )
        return (
            x * factor
            + 2 * self.p1 * x * y
            + self.p2 * (q + 2 * x * x)
            + q * (self.s1 + q * self.s2),
            y * factor
            + 2 * self.p2 * x * y
            + self.p1 * (q + 2 * y * y)
            + q * (self.s3 + q * self.s4),
            factor,
            slope,
        )

    def distort(self, x, y):
        """Return the image (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        u, v, _, _ = self._distort_without_tilt(x, y)
        if self._tilt is not None:
            (a, b, c), (d, e, f), (g, h, i) = self._tilt
            w = g * u + h * v + i
            u, v = (a * u + b * v + c) / w, (d * u + e * v + f) / w
        return self.scale * u, self.scale * v

    def derivative(self, x, y):
        """Return (dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        u, v, factor, slope = self._distort_without_tilt(x, y)
        q = x * x + y * y
        prism_x, prism_y = 2 * (self.s1 + 2 * q * self.s2), 2 * (self.s3 + 2 * q * self.s4)
        cross = x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
        terms = (
            factor + x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x + x * prism_x,
            cross + y * prism_x,
            cross + x * prism_y,
            factor + y * y * slope + 2 * self.p2 * x + 6 * self.p1 * y + y * prism_y,
        )
        if self._tilt is not None:
            (a, b, c), (d, e, f), (g, h, i) = self._tilt
            w = g * u + h * v + i
            s, t = (a * u + b * v + c) / w, (d * u + e * v + f) / w
            along, across = ((a - s * g) / w, (b - s * h) / w), ((d - t * g) / w, (e - t * h) / w)
            terms = tuple(
                m * terms[col] + n * terms[2 + col] for m, n in (along, across) for col in (0, 1)
            )
        return tuple(self.scale * term for term in terms)


class Radial:
    """Displacement along radii, by the `_radial` of a subclass: r^ / r and dr^/dr without scale."""

    scale: float

    def distort(self, x, y):
        """Return the image (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        factor = self.scale * self._radial(np.hypot(x, y))[0]
        return x * factor, y * factor

    def derivative(self, x, y):
        """Return (dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        r = np.hypot(x, y)
        factor, slope = self._radial(r)
        over = np.divide(slope - factor, r * r, out=np.zeros_like(r), where=r > 0)
        return tuple(
            self.scale * term
            for term in (factor + x * x * over, x * y * over, x * y * over, factor + y * y * over)
        )

    def _radial(self, r):
        raise NotImplementedError


@dataclass(frozen=True)
class Fisheye(Radial):
    """Equidistant fisheye projection with polynomial corrections.

        r^ = scale theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta = atan r

    The coefficients equal the ones of OpenCV's fisheye model, and the equidistant model of ROS and
    Kalibr, if `radius` is the focal length.

    Args:
        k1, k2, k3, k4: Coefficients [1].
        radius: Unit of the positions [m].
        scale: Magnification relative to the nominal one [1].

    Raises:
        OutOfRange: A coefficient is not finite, or radius or scale is not positive.

    Source:
        Kannala and Brandt, PAMI 28 (2006) 1335.
    """

    k1: float
    k2: float
    k3: float
    k4: float
    radius: float
    scale: float = 1.0

    __repr__ = short_repr

    def __post_init__(self):
        check_model(self, *FISHEYE)

    def _radial(self, r):
        """Return r^ / r and dr^/dr, both without scale."""
        theta = np.arctan(r)
        q = theta * theta
        height = theta * (1 + q * (self.k1 + q * (self.k2 + q * (self.k3 + q * self.k4))))
        slope = 1 + q * (3 * self.k1 + q * (5 * self.k2 + q * (7 * self.k3 + q * 9 * self.k4)))
        return np.divide(height, r, out=np.ones_like(r), where=r > 0), slope / (1 + r * r)


@dataclass(frozen=True)
class Calibration:
    """Camera matrix and distortion in the convention of OpenCV, ROS and Kalibr.

    The scene is the image of an ideal pinhole with this camera matrix, as `cv2.undistort` returns
    it. A scene point at pixel p is imaged at the pixel that `cv2.projectPoints` gives for it, with
    skew at the product of the camera matrix and the distorted position. A frame of another
    resolution but the same aspect ratio scales the camera matrix; a frame of another aspect ratio
    is refused.

    Args:
        width, height: Size of the calibration images [pixel].
        fx, fy: Focal lengths [pixel].
        cx, cy: Principal point [pixel]; (0, 0) is the centre of the first pixel.
        coefficients: In OpenCV's order, k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]],
            empty for a pinhole; with `fisheye`, k1 k2 k3 k4 of the fisheye (equidistant) model.
        fisheye: Use the fisheye model.
        skew: Element (0, 1) of the camera matrix [pixel].
        notes: What of a file is not used or was converted; reports repeat them.

    Raises:
        BadData: The number of coefficients does not fit the model.
        OutOfRange: A size, focal length, principal point or coefficient is outside its range.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...] = ()
    fisheye: bool = False
    skew: float = 0.0
    notes: tuple[str, ...] = field(
        default=(), compare=False, repr=False, metadata={"digest": False}
    )

    __repr__ = short_repr

    def __post_init__(self):
        for key in ("width", "height"):
            checked_count(f"calibration.{key}", getattr(self, key))
        check_fields("calibration", self, FOCAL_LENGTHS)
        for key, size in (("cx", self.width), ("cy", self.height)):
            if not -0.5 <= getattr(self, key) <= size - 0.5:
                raise OutOfRange(
                    f"calibration.{key}",
                    f"{getattr(self, key):.6g}",
                    f"a principal point in the picture, -0.5 .. {size - 0.5:g} pixels",
                )
        if not abs(self.skew) <= MOST_SKEW * self.fx:
            allowed = f"|skew| <= {MOST_SKEW:g} fx, {MOST_SKEW * self.fx:.6g} pixels"
            raise OutOfRange("calibration.skew", f"{self.skew:.6g}", allowed)
        count = len(self.coefficients)
        if count not in ((0, 4) if self.fisheye else COUNTS):
            raise BadData(
                f"calibration: {count} coefficients; wanted "
                + (
                    "4 of a fisheye"
                    if self.fisheye
                    else "4, 5, 8, 12 or 14 (OpenCV's order), or none"
                )
            )
        object.__setattr__(self, "coefficients", tuple(map(float, self.coefficients)))
        _ = self.lens  # its own checks

    @classmethod
    def of(
        cls,
        camera_matrix: Any,
        coefficients: Any,
        size: tuple[int, int],
        fisheye: bool = False,
    ) -> "Calibration":
        """Build a calibration from results of `cv2.calibrateCamera` or `cv2.fisheye.calibrate`.

        Args:
            camera_matrix: Array or nested lists, shape (3, 3): fx skew cx, 0 fy cy, 0 0 1.
            coefficients: Array or list of any shape, or None.
            size: Width and height of the images [pixel].
            fisheye: The coefficients belong to the fisheye model.

        Returns:
            The calibration.

        Raises:
            BadData: The arguments are not numbers of the right shape.
            OutOfRange: See `Calibration`.
        """
        try:
            matrix, (width, height) = np.array(camera_matrix, np.float64), map(int, size)
            values = np.array([] if coefficients is None else coefficients, np.float64).ravel()
        except (TypeError, ValueError):
            raise BadData(
                "calibration: wanted numbers in a camera matrix and its coefficients, and size = (width, "
                "height)"
            ) from None
        if matrix.shape != (3, 3):
            raise BadData(f"calibration: wanted a camera matrix of 3 x 3, got {matrix.shape}")
        if matrix[1, 0] or not (matrix[2] == (0, 0, 1)).all():
            raise BadData(
                "calibration: wanted the camera matrix fx skew cx, 0 fy cy, 0 0 1; got "
                + ", ".join(" ".join(f"{item:g}" for item in row) for row in matrix)
            )
        fx, fy, cx, cy, skew = matrix[[0, 1, 0, 1, 0], [0, 1, 2, 2, 1]].tolist()
        return cls(width, height, fx, fy, cx, cy, tuple(values.tolist()), fisheye, skew)

    @cached_property
    def lens(self) -> BrownConrady | Fisheye:
        """Distortion of normalised positions X / Z, Y / Z (tangents of field angles), radius 1."""
        if self.fisheye:
            return Fisheye(
                **dict(zip(FISHEYE, self.coefficients or (0.0,) * 4, strict=True)), radius=1.0
            )
        known = dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0) | dict(
            zip(PINHOLE, self.coefficients, strict=False)
        )
        return BrownConrady(**known, radius=1.0)

    @property
    def off_middle(self) -> tuple[float, float]:
        """Position of the principal point relative to the image centre, (x, y) [pixel]."""
        return self.cx + 0.5 - self.width / 2, self.cy + 0.5 - self.height / 2

    def fit_to_frame(self, shape: tuple[int, int], pitch: float) -> "Framed":
        """Return the distortion for a frame of another resolution.

        Args:
            shape: Rows and columns of the frame [pixel].
            pitch: Pixel pitch [m].

        Returns:
            The distortion with positions relative to the centre of the frame.

        Raises:
            OutOfRange: The frame has another aspect ratio than the calibration images.
        """
        rows, cols = shape
        across, down = cols / self.width, rows / self.height
        if abs(rows - self.height * across) > ROUNDING and abs(cols - self.width * down) > ROUNDING:
            raise OutOfRange(
                "frame",
                f"{cols} x {rows} pixels",
                f"{self.width} x {self.height}, at which the camera "
                "was calibrated, or another resolution of the same shape",
            )
        focal = self.fx * across
        middle = (
            ((self.cx + 0.5) * across - cols / 2) / focal,
            ((self.cy + 0.5) * down - rows / 2) / focal,
        )
        skew = self.skew * across / focal
        return Framed(self.lens, focal * pitch, self.fy * down / focal, middle, skew)

    def __str__(self):
        kind = (
            "fisheye"
            if self.fisheye
            else "rational"
            if len(self.coefficients) > 5
            else "Brown-Conrady"
        )
        x, y = self.off_middle
        return (
            f"calibrated at {self.width} x {self.height}: {kind if self.coefficients else 'pinhole'}, principal "
            f"point {x:+.4g}, {y:+.4g} pixels off the middle"
            + (f", skew {self.skew:.3g} pixels" if self.skew else "")
        )


@dataclass(frozen=True)
class Framed:
    """Distortion of a calibrated camera for the frame of one resolution.

    Positions are relative to the centre of the frame, in units of `radius`.

    Attributes:
        lens: Distortion of normalised positions.
        radius: Focal length along rows [m].
        aspect: Focal length along columns over `radius` [1].
        middle: (x, y) of the principal point, the same in the ideal image and in the camera's.
        skew: Shift along rows for a normalised position of 1 along columns [1].
    """

    lens: BrownConrady | Fisheye
    radius: float
    aspect: float
    middle: tuple[float, float]
    skew: float = 0.0

    __repr__ = short_repr

    def normalise(self, x, y):
        """Return positions relative to the principal point, divided by the focal lengths."""
        v = (y - self.middle[1]) / self.aspect
        u = x - self.middle[0]
        return (u - self.skew * v if self.skew else u), v

    def denormalise(self, u, v):
        """Return positions in the frame from normalised ones: the inverse of `normalise`."""
        x = u + self.middle[0]
        return (x + self.skew * v if self.skew else x), v * self.aspect + self.middle[1]

    def distort(self, x, y):
        """Return the image (x^, y^) of the ideal position (x, y), both in units of `radius`."""
        return self.denormalise(*self.lens.distort(*self.normalise(x, y)))

    def derivative(self, x, y):
        """Return (dx^/dx, dx^/dy, dy^/dx, dy^/dy) at the ideal position (x, y) [1]."""
        a, b, c, d = self.lens.derivative(*self.normalise(x, y))
        if self.skew:  # M J M^-1 with M = (1, skew; 0, 1)
            a, b = a + self.skew * c, b + self.skew * (d - a - self.skew * c)
            d = d - self.skew * c
        return a, b / self.aspect, c * self.aspect, d
