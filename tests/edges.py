"""Exact slanted edges: pictures whose transfer function is known in closed form, float64."""

import numpy as np
from scipy.special import ndtr


def edge_distances(rows, cols, angle):
    """Distance of every pixel's middle from a line through the picture's, `angle` [rad] from the columns."""
    y, x = np.mgrid[:rows, :cols] - np.array([rows - 1, cols - 1])[:, None, None] / 2
    return np.cos(angle) * x + np.sin(angle) * y


def gaussian_edge(rows, cols, angle, sigma):
    """Step from 0 to 1, blurred by a Gaussian of `sigma` and square pixels.

    A square seen along its edge is two boxes, cos and sin wide: second differences of the second integral of the
    blurred step's slope, E max(t + sigma Z, 0)^2 / 2.
    """
    a, b = np.cos(angle), np.sin(angle)
    distance = edge_distances(rows, cols, angle)

    def twice(t):
        z = t / sigma
        return (t * t + sigma**2) * ndtr(z) + t * sigma * np.exp(-z * z / 2) / np.sqrt(2 * np.pi)

    return (
        twice(distance + (a + b) / 2)
        - twice(distance + (a - b) / 2)
        - twice(distance - (a - b) / 2)
        + twice(distance - (a + b) / 2)
    ) / (2 * a * b)


def gaussian_mtf(f, angle, sigma):
    """Its transfer function along the edge's normal; f [cycle/pixel]."""
    return (
        np.sinc(f * np.cos(angle))
        * np.sinc(f * np.sin(angle))
        * np.exp(-2 * (np.pi * sigma * f) ** 2)
    )


def airy_mtf(f, angle, q):
    """Of a diffraction-limited lens, q = wavelength f-number / pitch, behind square pixels; f [cycle/pixel]."""
    s = np.minimum(np.abs(q * f), 1)
    return (
        2
        / np.pi
        * (np.arccos(s) - s * np.sqrt(1 - s * s))
        * np.sinc(f * np.cos(angle))
        * np.sinc(f * np.sin(angle))
    )


def edge_of(mtf, cutoff, distance):
    """Step from 0 to 1 of an even transfer function that ends at `cutoff`: 1/2 + int M(f) sin(2 pi f d) / (pi f) df.

    Gauss-Legendre of 600 nodes, exact for waves of up to 1200 / pi periods within the cut-off; linear between 1 / 64
    pixel, which adds a box's square: 1 - sinc^2(f / 64) = 2e-4 at 0.5 cycle/pixel.
    """
    nodes, weights = np.polynomial.legendre.leggauss(600)
    f, weights = cutoff * (nodes + 1) / 2, cutoff * weights / 2
    places = np.arange(np.floor(distance.min() * 64), np.ceil(distance.max() * 64) + 1) / 64
    return np.interp(
        distance,
        places,
        0.5 + np.sin(2 * np.pi * places[:, None] * f) @ (weights * mtf(f) / (np.pi * f)),
    )
