"""Energies of blurs in unit pixels by formulas other than diffraction, for comparison."""

import numpy as np
from scipy.special import erf


def gaussian_kernel(sigma, radius) -> np.ndarray:
    """Return the energy of a Gaussian in unit pixels up to `radius` from its own, shape (n, n).

    Exact: differences of the error function. Its sum is the energy within these pixels, not scaled
    to 1. sigma: standard deviation [pixel].
    """
    edges = np.arange(-radius, radius + 2) - 0.5
    line = np.diff(erf(edges / (np.sqrt(2) * sigma))) / 2
    return np.outer(line, line)


def pillbox_kernel(diameter) -> np.ndarray:
    """Return the energy of a uniform disc in unit pixels about its centre, shape (n, n), n odd.

    Its sum is 1. Exact: areas of the disc below corners. Source: integral of the circle, sqrt(R^2 -
    x^2).
    """
    r = diameter / 2
    reach = int(np.ceil(r - 0.5)) if r > 0.5 else 0
    edges = np.clip(np.arange(-reach, reach + 2) - 0.5, -r, r)
    y, x = np.meshgrid(edges, edges, indexing="ij")
    area = _disc_below(x, y, r)
    return np.diff(np.diff(area, axis=0), axis=1) / (np.pi * r * r)


def _disc_below(x, y, r):
    """Area of the part of the disc with coordinates below x and below y, both in -r .. r."""

    def column(a, b):  # integral over a .. b of sqrt(r^2 - t^2)
        def primitive(t):
            return (
                t * np.sqrt(np.maximum(r * r - t * t, 0)) + r * r * np.arcsin(np.clip(t / r, -1, 1))
            ) / 2

        return primitive(b) - primitive(a)

    w = np.sqrt(np.maximum(r * r - y * y, 0))  # the chord at y is -w .. w
    left, right = np.minimum(x, -w), np.clip(x, -w, w)
    # Within the chord the strip goes from the lower arc to y. Outside the chord the strip is the
    # whole disc for y > 0, and empty for y < 0.
    inside = column(-w, right) + y * (right + w)
    beside = 2 * (column(-r, left) + column(w, np.maximum(x, w)))
    return inside + np.where(y > 0, beside, 0)
