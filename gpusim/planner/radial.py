"""Kernels of a rotationally symmetric lens anywhere in the field, from a table by field height."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates, spline_filter

from gpusim.domain.errors import BadData, OutOfRange


@dataclass(frozen=True, eq=False)
class RadialLens:
    """Optics-only point spreads along the +x axis of the field; called with places, it gives pixel-integrated kernels.

    The pixel is square, so that a kernel does not rotate with the field: what rotates is the point spread of the optics
    alone, which is stored finer than the pixel and integrated over the pixel after the rotation.

    heights: field heights [pixel], rising from 0, shape (h,), h >= 2. spreads: shape (h, planes, n, n), n odd, energy
    per area on a grid of `oversampling` samples per pixel, centred; rows y, columns x (x outward).
    centre: (row, column) of the axis [pixel]. size: m of the kernels, odd. aperture: width of the pixel's aperture
    [pixel]. quadrature: Gauss-Legendre points per side of a pixel. Kernels sum to one.
    Raises BadData, OutOfRange.
    """

    heights: np.ndarray
    spreads: np.ndarray
    centre: tuple[float, float]
    size: int
    oversampling: int = 4
    aperture: float = 1.0
    quadrature: int = 6
    _at: Callable = field(init=False, repr=False)  # point spreads at a field height

    def __post_init__(self):
        heights, spreads = np.asarray(self.heights, np.float64), np.asarray(self.spreads, np.float64)
        if heights.ndim != 1 or len(heights) < 2 or heights[0] != 0 or not (np.diff(heights) > 0).all():
            raise BadData("radial table: wanted two or more field heights, rising from 0")
        if spreads.ndim != 4 or len(spreads) != len(heights) or spreads.shape[2] != spreads.shape[3] or \
                spreads.shape[3] % 2 == 0:
            raise BadData(f"radial table: wanted point spreads ({len(heights)}, planes, n, n), n odd, got "
                          f"{spreads.shape}")
        if not np.isfinite(spreads).all() or (spreads.sum(axis=(2, 3)) <= 0).any():
            raise BadData("radial table: a point spread is not finite or holds no energy")
        if self.size < 1 or self.size % 2 == 0:
            raise OutOfRange("radial table: kernel size", self.size, "an odd number")
        # heights go on, mirrored, on the other side of the axis, so that the spline has no end at 0
        both = np.concatenate([-heights[:0:-1], heights])
        mirrored = np.concatenate([spreads[:0:-1, :, :, ::-1], spreads])
        spline = CubicSpline(both, mirrored, axis=0) if len(both) > 3 else None
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "_at", spline or (lambda h: mirrored[-2] + (mirrored[-1] - mirrored[-2])
                                                   * (h / heights[-1])))

    def __call__(self, places) -> np.ndarray:
        """Kernels at (row, column) `places`, shape (n, 2): float64 (n, planes, size, size), each summing to one."""
        places = np.asarray(places, np.float64) - self.centre
        radius = np.hypot(places[:, 0], places[:, 1])
        if radius.max(initial=0) > self.heights[-1] * (1 + 1e-9):
            raise OutOfRange("radial table", f"ends at field height {self.heights[-1]:.6g} pixels",
                             f"as far as the frame's corner, {radius.max():.6g} pixels")
        nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(self.quadrature))
        middle = np.arange(self.size) - self.size // 2
        points = (middle[:, None] + self.aperture * nodes).ravel() * self.oversampling
        planes, half = np.shape(self.spreads)[1], np.shape(self.spreads)[2] // 2
        kernels = np.empty((len(places), planes, self.size, self.size))
        for kernel, (y, x), r in zip(kernels, places, radius, strict=True):
            cos, sin = (x / r, y / r) if r > 0 else (1.0, 0.0)
            # back into the table's frame, where the field point lies on +x
            v, u = points[:, None] * cos - points * sin, points[:, None] * sin + points * cos
            for out, spread in zip(kernel, self._at(min(r, self.heights[-1])), strict=True):
                values = map_coordinates(spline_filter(spread, 3, mode="mirror"), [v + half, u + half], order=3,
                                         prefilter=False, mode="constant")
                out[:] = np.einsum("iajb,a,b->ij", values.reshape(self.size, len(nodes), self.size, len(nodes)),
                                   mass, mass)
        return kernels / kernels.sum(axis=(2, 3), keepdims=True)
