"""Pictures of a scene through the cells of a pupil: for refocusing, and for distances."""

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
import scipy

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.light_field import cell_centres
from gpusim.domain.short_repr import shorten_repr

FINE = 32  # points of a cell along an axis, of which a disc's share is counted
ALIGNED = 1e-9  # [1/m] reciprocal distance below which things are at infinity


@dataclass(frozen=True, eq=False)
class ViewImages:
    """Linear pictures of one scene through T x S cells of a pupil.

    Cell (j, i) has its centre at the place (y, x) = extent (-1 + (2 j + 1) / T, -1 + (2 i + 1) / S) in
    radii of the pupil, along the rows and columns of the picture; if the pupil cuts it, the middle of
    its light counts. A thing at the distance D is
    displaced in a view by its slope times this place, slope = slope_per_diopter (1 / object_distance -
    1 / D) [pixel per radius].

    Args:
        values: Linear pictures in any unit, shape (T, S, rows, cols, C).
        slope_per_diopter: Displacement of things by distance [pixel per radius and 1/m]. Of a
            lens -v^2 / (2 N_w p), with the distance v and the pitch p of the pixels, and the
            working f-number N_w: `ViewImages.of` computes it.
        object_distance: Distance of things at one place in all views [m].
        focal_length: Of the lens [m].
        f_number: Of the whole lens [1].
        extent: Half the side of the grid of cells in radii of the pupil.
        light: Share of each cell that is inside a round pupil of radius 1, 0 .. 1, shape (T, S). The
            pictures are divided by it: all show one brightness, and those without light are 0. None:
            whole cells, as of an array of cameras.
        name: Name in messages.

    Raises:
        BadData: The pictures have a wrong shape or type, or numbers that are not finite.
        OutOfRange: A number is out of its range.
    """

    values: np.ndarray
    slope_per_diopter: float
    object_distance: float
    focal_length: float
    f_number: float
    extent: float = 1.0
    light: np.ndarray | None = None
    name: str = "views"

    def __post_init__(self):
        try:
            values = np.asarray(self.values, np.float32)
        except (TypeError, ValueError):
            raise BadData(f"{self.name}: wanted an array of numbers") from None
        if values.ndim != 5 or not values.size:
            raise BadData(f"{self.name}: shape {values.shape}, wanted (T, S, rows, cols, channels)")
        if not np.isfinite([values.min(), values.max()]).all():
            raise BadData(f"{self.name}: NaN or infinite values")
        object.__setattr__(self, "values", values)
        for key in ("slope_per_diopter", "object_distance", "focal_length", "f_number", "extent"):
            value = getattr(self, key)
            is_far = key == "object_distance" and value == np.inf
            if not isinstance(value, Real) or not (np.isfinite(value) or is_far):
                raise BadData(f"{self.name}: {key} {value!r}, wanted a finite number")
            is_allowed = value != 0 if key == "slope_per_diopter" else value > 0
            if not is_allowed:
                wanted = "not 0" if key == "slope_per_diopter" else "more than 0"
                raise OutOfRange(f"views.{key}", value, wanted)
        if self.light is not None:
            light = self._weights(self.light, "light")
            if light.max() > 1:
                raise OutOfRange("views.light", light.max(), "0 .. 1, shares of cells")
            object.__setattr__(self, "light", light)

    @classmethod
    def of(
        cls,
        values: np.ndarray,
        camera: Camera,
        samples_per_pixel: float = 1.0,
        extent: float = 1.0,
        light: np.ndarray | None = None,
        name: str = "views",
    ) -> "ViewImages":
        """Return pictures through the cells of a camera's pupil.

        Args:
            values: Linear pictures, shape (T, S, rows, cols, C).
            camera: The camera.
            samples_per_pixel: Samples of the pictures along the pitch of a pixel.
            extent: Half the side of the grid in radii of the pupil.
            light: Share of each cell inside the pupil, see the class.
            name: Name in messages.

        Returns:
            The pictures.

        Raises:
            BadData: As the class does.
            OutOfRange: As the class does.
        """
        optics = camera.optics
        pitch = camera.sensor.pixel_pitch / samples_per_pixel
        slope = -optics.displacement(1.0) / (2 * optics.working_f_number * pitch)
        fixed = optics.object_distance, optics.focal_length, optics.f_number
        return cls(values, slope, *fixed, extent, light, name)

    def __repr__(self):
        rows, cols, channels = self.values.shape[2:]
        return shorten_repr(
            f"ViewImages({self.name!r}, {self.shape[0]} x {self.shape[1]} views of {cols}x{rows}, {channels} "
            f"channels, {self.slope_per_diopter:.4g} pixels per radius and diopter)"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of views."""
        rows, cols = self.values.shape[:2]
        return rows, cols

    @property
    def places(self) -> np.ndarray:
        """Places (y, x) of the cells' centres, or of their light's, [radius], shape (T, S, 2)."""
        centres = self.extent * cell_centres(self.shape)
        if self.light is None:
            return centres
        points, lit = self._points()
        count = lit.sum(axis=(1, 3))[..., None]
        middles = (points * lit[..., None]).sum(axis=(1, 3)) / np.maximum(count, 1)
        return np.where(count > 0, middles, centres)

    def _points(self):
        """Return points of the cells (T, FINE, S, FINE, 2) [radius], and whether light passes there."""
        shape = self.shape[0], FINE, self.shape[1], FINE
        points = self.extent * cell_centres((shape[0] * FINE, shape[2] * FINE)).reshape(*shape, 2)
        if self.light is None:
            return points, np.ones(shape, bool)
        return points, np.square(points).sum(axis=-1) <= 1

    def slope_at(self, distance: Any) -> Any:
        """Return the slope of things at a distance.

        Args:
            distance: Distance from the lens [m], a number or an array.

        Returns:
            Displacement [pixel per radius].

        Raises:
            OutOfRange: A distance is not positive.
        """
        if not (np.asarray(distance) > 0).all():
            raise OutOfRange("distance", np.min(distance), "more than 0 m")
        return self.slope_per_diopter * (1 / self.object_distance - 1 / np.asarray(distance))

    def distance_at(self, slope: Any) -> np.ndarray:
        """Return the distance of things with a slope.

        Args:
            slope: Displacement [pixel per radius], a number or an array.

        Returns:
            Distance [m]; infinity for slopes at or beyond infinity's.
        """
        near = 1 / self.object_distance - np.asarray(slope, np.float64) / self.slope_per_diopter
        return np.where(near > ALIGNED, 1 / np.maximum(near, ALIGNED), np.inf)

    def weigh(self, aperture: float | np.ndarray | None = None) -> np.ndarray:
        """Return the weight of each view in the picture of a synthetic aperture.

        Args:
            aperture: None: all views. A number: radius of a disc in radii of the pupil; weights are
                the shares of cells in a disc, which is chosen so that the root mean square radius
                of the blur, with the cells' own size, is the disc's. An array: the weights, shape
                (T, S). All are limited by the light of the cells.

        Returns:
            Weights, float64, shape (T, S).

        Raises:
            BadData: The array has a wrong shape, negative or infinite numbers, or no light.
            OutOfRange: The radius is not positive, or smaller than a cell's.
        """
        if isinstance(aperture, Real) and not isinstance(aperture, bool):
            return self._share_disc(float(aperture))
        lit = np.ones(self.shape) if self.light is None else self.light
        weights = lit if aperture is None else self._weights(aperture, "aperture") * lit
        if not weights.any():
            raise BadData("aperture: no light: all weights are 0")
        return weights.copy()

    def _weights(self, values, name):
        """Return an array of weights. Raise BadData."""
        try:
            weights = np.asarray(values, np.float64)
        except (TypeError, ValueError):
            raise BadData(f"{name}: wanted an array of numbers") from None
        if weights.shape != self.shape:
            raise BadData(f"{name}: shape {weights.shape}, wanted one number a view, {self.shape}")
        if not (np.isfinite(weights).all() and weights.min() >= 0):
            raise BadData(f"{name}: numbers that are negative or not finite")
        if not weights.any():
            raise BadData(f"{name}: no light: all numbers are 0")
        return weights

    def _share_disc(self, radius):
        """Return the weights of the disc that blurs as one of this radius does. Raise OutOfRange."""
        if not 0 < radius < np.inf:
            raise OutOfRange("aperture", radius, "a radius, more than 0 pupil radii")
        points, lit = self._points()
        squares = np.square(points).sum(axis=-1)
        count = np.maximum(lit.sum(axis=(1, 3)), 1)
        moments = (squares * lit).sum(axis=(1, 3)) / count

        def share(square):
            return ((squares <= square) & lit).mean(axis=(1, 3))

        def excess(square):
            weights = share(square)
            return (weights * moments).sum() / weights.sum() - radius**2 / 2

        lowest, highest = squares.min(), squares[lit].max()
        if excess(highest) <= 0:
            return share(highest)
        if excess(lowest) > 0:
            least = np.sqrt(2 * (excess(lowest) + radius**2 / 2))
            raise OutOfRange("aperture", radius, f"{least:.3g} pupil radii or more, one cell")
        return share(scipy.optimize.brentq(excess, lowest, highest, xtol=1e-9))
