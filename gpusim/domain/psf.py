"""Point spreads that are given as arrays, or by a formula other than diffraction."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from gpusim.domain.errors import BadData, OutOfRange


@dataclass(frozen=True, eq=False)
class PointSpread:
    """Measured or traced point spreads, one per wavelength, each of energy 1.

    wavelengths: [nm], increasing, shape (L,). values: shape (L, rows, cols), not negative; scaled to sum 1 here. The
    ideal image point is at ((rows - 1) / 2, (cols - 1) / 2). spacing: distance of the samples [m].
    integrated: whether the samples are the energies in pixels of that pitch; else they are samples of the irradiance
    that the lens alone makes, fine enough to tell all of it: spacing <= lambda N / 2.
    Raises BadData, OutOfRange.
    """

    wavelengths: np.ndarray
    values: np.ndarray
    spacing: float
    integrated: bool = False

    def __post_init__(self):
        wavelengths, values = np.asarray(self.wavelengths, np.float64), np.asarray(self.values, np.float64)
        if values.ndim != 3 or not values.size:
            raise BadData(f"point spread: wanted (wavelengths, rows, cols), none of them 0, got shape {values.shape}")
        if wavelengths.shape != values.shape[:1] or not np.isfinite(wavelengths).all() \
                or not (np.diff(wavelengths) > 0).all():
            raise BadData(f"point spread: wanted {len(values)} increasing wavelengths, got {wavelengths[:4]} ...")
        if not np.isfinite(values).all():
            raise BadData(f"point spread: {np.count_nonzero(~np.isfinite(values))} values are NaN or infinite")
        if values.min() < 0:
            raise BadData(f"point spread: {np.count_nonzero(values < 0)} values are negative, down to {values.min():g}")
        sums = values.sum(axis=(1, 2))
        if not (sums > 0).all():
            raise BadData(f"point spread: no energy at {wavelengths[np.argmin(sums > 0)]:g} nm")
        if not 0 < self.spacing < np.inf:
            raise OutOfRange("point spread spacing", f"{self.spacing:.6g} m", "a positive length")
        object.__setattr__(self, "wavelengths", wavelengths)
        object.__setattr__(self, "values", values / sums[:, None, None])


def gaussian_kernel(sigma, radius) -> np.ndarray:
    """Energy of a Gaussian of standard deviation `sigma` in unit pixels up to `radius` from its own, shape (n, n).

    Exact: differences of the error function. Its sum is what falls into these pixels, not scaled to 1.
    """
    if not (0 < sigma < np.inf and radius >= 0):
        raise OutOfRange("gaussian", f"sigma {sigma:g}, radius {radius}", "sigma > 0, radius >= 0")
    edges = np.arange(-radius, radius + 2) - 0.5
    line = np.diff(erf(edges / (np.sqrt(2) * sigma))) / 2
    return np.outer(line, line)


def pillbox_kernel(diameter) -> np.ndarray:
    """Energy of an even disc in unit pixels about its centre, shape (n, n), n odd; sum 1.

    Exact: areas of the disc below corners. Source: integral of the circle, sqrt(R^2 - x^2).
    """
    if not 0 < diameter < 1e4:
        raise OutOfRange("pillbox diameter", f"{diameter:g} pixels", "0 < diameter < 1e4")
    r = diameter / 2
    reach = int(np.ceil(r - 0.5)) if r > 0.5 else 0
    edges = np.clip(np.arange(-reach, reach + 2) - 0.5, -r, r)
    y, x = np.meshgrid(edges, edges, indexing="ij")
    area = _disc_below(x, y, r)
    return np.diff(np.diff(area, axis=0), axis=1) / (np.pi * r * r)


def _disc_below(x, y, r):
    """Area of the disc where its coordinates are below x and below y, both in -r .. r."""
    def column(a, b):  # integral over a .. b of sqrt(r^2 - t^2)
        def primitive(t):
            return (t * np.sqrt(np.maximum(r * r - t * t, 0)) + r * r * np.arcsin(np.clip(t / r, -1, 1))) / 2
        return primitive(b) - primitive(a)

    w = np.sqrt(np.maximum(r * r - y * y, 0))  # the chord at y is -w .. w
    left, right = np.minimum(x, -w), np.clip(x, -w, w)
    # within the chord the strip goes from the lower arc to y; beside it, the whole disc for y > 0, nothing for y < 0
    inside = column(-w, right) + y * (right + w)
    beside = 2 * (column(-r, left) + column(w, np.maximum(x, w)))
    return inside + np.where(y > 0, beside, 0)
