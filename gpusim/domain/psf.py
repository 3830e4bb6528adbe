"""Point spreads that are given as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.interpolation import node_weights
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import is_increasing

DIOPTRES = 1e-9  # [1/m] by which a distance may miss those that are given


@dataclass(frozen=True, eq=False)
class PointSpread:
    """Measured or ray-traced point spread functions: one per wavelength, field point and distance.

    Each has energy 1. `np.asarray` returns the values. Between field points and wavelengths the
    spread is linear; between distances it is a cubic of 1 / distance through the nearest four.

    Attributes:
        wavelengths: [nm], increasing, shape (L,).
        values: Not negative, shape (L, rows, cols), scaled to sum 1 here. The ideal image point
            is at ((rows - 1) / 2, (cols - 1) / 2).
        spacing: Distance of the samples [m].
        integrated: Whether the samples are the energies in pixels of that pitch. Else they are
            samples of the irradiance that the lens makes without pixels, fine enough to
            determine it: spacing <= lambda N / 2.
        heights: Field heights, rising from 0 to 1 at the frame's corner, shape (H,): values (H,
            L, rows, cols) are of field points on the side of growing columns, of a lens that is
            the same at every angle.
        grid: Or the field points' rows and columns, in the same unit, two rising lists of Y and
            X: values (Y, X, L, rows, cols).
        distances: Distances of the objects [m], rising, the last one may be infinite, shape (D,):
            D is then the first axis of the values. None: blur at other distances is a model, see
            `gpusim.optics.lens.MeasuredLens`.
        notes: What of its file is not used; reports repeat them.

    Raises:
        BadData: The arrays do not fit one another.
        OutOfRange: The spacing is not positive.
    """

    wavelengths: np.ndarray
    values: np.ndarray
    spacing: float
    integrated: bool = False
    heights: np.ndarray | None = None
    grid: tuple | None = None
    distances: np.ndarray | None = None
    notes: tuple[str, ...] = field(default=(), repr=False, metadata={"digest": False})
    _axes: tuple = field(init=False, repr=False, default=())

    __repr__ = short_repr

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype, copy=copy)

    def __post_init__(self):
        wavelengths = np.asarray(self.wavelengths, np.float64)
        values = np.asarray(self.values, np.float64)
        if self.heights is not None and self.grid is not None:
            raise BadData("point spread: heights and grid are given; wanted one of them")
        axes = [
            np.asarray(axis, np.float64)
            for axis in (self.grid or ([] if self.heights is None else [self.heights]))
        ]
        for axis in axes:
            if not is_increasing(axis) or len(axis) < 2:
                raise BadData(
                    f"point spread: wanted two or more field points, increasing, got {axis}"
                )
        if self.heights is not None and axes[0][0] != 0:
            raise BadData(f"point spread: the first field height is {axes[0][0]:g}, wanted 0")
        if self.heights is not None and self.integrated:
            raise BadData(
                "point spread: energies of pixels do not turn with the field, as square pixels do not; give "
                "samples of the irradiance, or a grid of field points"
            )
        if self.distances is not None:
            distances = np.asarray(self.distances, np.float64)
            object.__setattr__(self, "distances", distances)
            with np.errstate(divide="ignore"):
                dioptres = 1 / distances
            if distances.ndim != 1 or len(distances) < 2 or not is_increasing(-dioptres):
                raise BadData(
                    f"point spread: wanted two or more distances [m], increasing, got {distances}"
                )
            if not distances[0] > 0:
                raise OutOfRange("point spread distance", f"{distances[0]:g} m", "positive")
        if not is_increasing(wavelengths):
            raise BadData(
                f"point spread: wanted increasing wavelengths, got {wavelengths.ravel()[:4]} ..."
            )
        given = axes if self.distances is None else [self.distances, *axes]
        wanted = (*map(len, given), len(wavelengths))
        if (
            values.ndim != len(wanted) + 2
            or not values.size
            or values.shape[: len(wanted)] != wanted
        ):
            raise BadData(
                f"point spread: wanted ({', '.join(map(str, wanted))}, rows, cols) for {len(wavelengths)} "
                f"wavelengths, none of them 0, got shape {values.shape}"
            )
        if not np.isfinite(values).all():
            raise BadData(
                f"point spread: {np.count_nonzero(~np.isfinite(values))} values are NaN or infinite"
            )
        if values.min() < 0:
            raise BadData(
                f"point spread: {np.count_nonzero(values < 0)} values are negative, down to {values.min():g}"
            )
        sums = values.sum(axis=(-2, -1))
        if not (sums > 0).all():
            raise BadData(
                f"point spread: no energy at {wavelengths[np.argwhere(~(sums > 0))[0][-1]]:g} nm"
            )
        if not 0 < self.spacing < np.inf:
            raise OutOfRange("point spread spacing", f"{self.spacing:.6g} m", "a positive length")
        object.__setattr__(self, "wavelengths", wavelengths)
        object.__setattr__(self, "values", values / sums[..., None, None])
        object.__setattr__(self, "_axes", tuple(axes))

    @classmethod
    def by_distance(cls, spreads: Mapping[float, "PointSpread"]) -> "PointSpread":
        """Return the point spreads of several distances as one.

        Args:
            spreads: Point spreads at each distance [m]. They have the same wavelengths, field points and
                spacing; smaller ones are surrounded with 0.

        Returns:
            Point spreads with an axis of distance.

        Raises:
            BadData: They do not fit one another.
        """
        distances = sorted(spreads)
        every = [spreads[distance] for distance in distances]
        if len(every) < 2 or any(one.distances is not None for one in every):
            raise BadData(
                "point spreads by distance: wanted two or more, each of a single distance"
            )
        first = every[0]
        for one, distance in zip(every, distances, strict=True):
            same = [
                np.array_equal(first.wavelengths, one.wavelengths),
                np.isclose(first.spacing, one.spacing, rtol=1e-9, atol=0),
                first.integrated == one.integrated,
                (first.heights is None, first.grid is None)
                == (one.heights is None, one.grid is None),
                len(first._axes) == len(one._axes)
                and all(map(np.array_equal, first._axes, one._axes)),
                all(
                    (a - b) % 2 == 0
                    for a, b in zip(first.values.shape, one.values.shape, strict=True)
                ),
            ]
            if not all(same):
                names = "wavelengths", "spacing", "integrated", "heights or grid", "field points"
                wrong = (*names, "parity of rows and columns")[same.index(False)]
                raise BadData(
                    f"point spreads at {distances[0]:g} and {distance:g} m differ in: {wrong}"
                )
        size = np.max([one.values.shape[-2:] for one in every], axis=0)
        values = []
        for one in every:
            around = [
                ((n - own) // 2,) * 2 for n, own in zip(size, one.values.shape[-2:], strict=True)
            ]
            values.append(np.pad(one.values, [(0, 0)] * (one.values.ndim - 2) + around))
        return replace(first, values=np.stack(values), distances=np.array(distances, np.float64))

    def at(self, y: float, x: float, distance: float = np.inf) -> np.ndarray:
        """Return the point spreads of one field point.

        Args:
            y: Row of the field point, 1 the frame's corner.
            x: Column of the field point.
            distance: Of the object [m]; without effect if no distances are given.

        Returns:
            Values, shape (L, rows, cols).

        Raises:
            OutOfRange: The point is outside the field points given, or the distance outside the distances.
        """
        spreads = self._at_distance(distance)
        if not self._axes:
            return spreads
        point = (y, x) if self.grid else (np.hypot(y, x),)
        for axis, place in zip(self._axes, point, strict=True):
            if not axis[0] - 1e-9 <= place <= axis[-1] + 1e-9:
                raise OutOfRange(
                    "point spread field point",
                    f"{place:.4g}",
                    f"{axis[0]:g} .. {axis[-1]:g}, the points that are given; 1 is the frame's corner",
                )
            share = np.interp(place, axis, np.arange(len(axis)))
            low = min(int(share), len(axis) - 2)
            spreads = spreads[low] * (1 - share + low) + spreads[low + 1] * (share - low)
        if self.grid or (not y and x >= 0):
            return spreads
        (rows, cols), cos, sin = spreads.shape[1:], x / np.hypot(y, x), y / np.hypot(y, x)
        v, u = np.arange(rows)[:, None] - (rows - 1) / 2, np.arange(cols) - (cols - 1) / 2
        # back into the table's frame, in which the field point lies on +x
        from_ = [v * cos - u * sin + (rows - 1) / 2, v * sin + u * cos + (cols - 1) / 2]
        turned = np.stack(
            [scipy.ndimage.map_coordinates(one, from_, order=3, mode="constant") for one in spreads]
        )
        return turned / turned.sum(axis=(1, 2), keepdims=True)

    def _at_distance(self, distance):
        """Return the values at a distance [m], without the axis of distances."""
        if self.distances is None:
            return self.values
        with np.errstate(divide="ignore"):
            nodes, at = -1 / self.distances, -1 / np.float64(distance)
        if not nodes[0] - DIOPTRES <= at <= nodes[-1] + DIOPTRES:
            raise OutOfRange(
                "point spread distance",
                f"{distance:.4g} m",
                f"{self.distances[0]:g} .. {self.distances[-1]:g} m, the distances that are given",
            )
        weights = node_weights(nodes, np.clip(at, nodes[0], nodes[-1])[None])[0]
        used = np.flatnonzero(weights)
        return np.tensordot(weights[used], self.values[used], 1)
