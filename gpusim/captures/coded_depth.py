"""Distances from pictures through coded apertures, by the kernels of a bank of distances.

A picture of a plane at the distance d is Y = K_d X + noise at every frequency. Pictures of natural scenes have powers
P = c / (f^2 + f_0^2) of Gaussian X, so that Y of one or two pictures has the covariance P k k^H + s^2, k = (K_d) of all
pictures. Of the two parts of Y along k and across it, minus twice the logarithm of the likelihood is

    |Y_along|^2 / (P |k|^2 + s^2) + log (P |k|^2 + s^2) + |Y_across|^2 / s^2.

The first is what Wiener's filter of this distance leaves over. Filters with the roots of these weights make pictures
whose squares, averaged over a window, are the score of each distance there; the least one wins. Sources: Levin, Fergus,
Durand and Freeman, ACM Trans. Graph. 26 (3), 70 (2007), for one picture; Zhou and Nayar, ICCP (2009), for Wiener's
residual; Zhou, Lin and Nayar, Int. J. Comput. Vis. 93, 53 (2011), for pairs. The likelihood is derived here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from scipy.ndimage import gaussian_filter

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import short_repr
from gpusim.optics.lens import wavelength_nodes
from gpusim.optics.lenses import lens_of

LOWEST = 0.01  # f_0 [cycle/pixel]
WINDOW = 8.0  # [pixel] standard deviation of the window, by default
ROOM = 9  # [pixel] of kernels beyond their rays
MOST = 2  # pictures


@dataclass(frozen=True, eq=False)
class CodedDepth:
    """Distances that coded pictures show.

    Attributes:
        distances: Of every pixel [m], shape (rows, cols).
        index: Which of the bank's distances has the least score, int (rows, cols).
        scores: Minus twice the logarithm of the likelihood of each distance, shape (D, rows, cols).
    """

    distances: np.ndarray
    index: np.ndarray
    scores: np.ndarray

    __repr__ = short_repr


def coded_kernels(camera: Camera, distances: Any, wavelengths: Any, weights: Any) -> np.ndarray:
    """Return the kernels of a camera's lens and pixels on its axis for a bank of distances, of sum 1.

    Args:
        camera: The camera, with or without a mask in its pupil.
        distances: [m], shape (D,).
        wavelengths: [nm], shape (L,).
        weights: Light of each wavelength in the picture's channel, shape (L,).

    Returns:
        Kernels, shape (D, size, size).
    """
    lens, wavelengths = lens_of(camera), np.asarray(wavelengths, np.float64)
    nodes, between = wavelength_nodes(wavelengths)
    mix = np.asarray(weights, np.float64) @ between
    widest = max(lens.spread(nodes, 0.0, float(one)) for one in distances)
    size = max(2 * (int(np.ceil(widest)) + ROOM) + 1, lens.least_size | 1)
    made = [np.tensordot(mix, lens.kernels(nodes, (0.0, 0.0), size, one), 1) for one in distances]
    return np.array([kernel / kernel.sum() for kernel in made])


def find_coded_depth(
    pictures: Any, kernels: Any, distances: Any, noise: float, window: float = WINDOW
) -> CodedDepth:
    """Return the distance of every pixel from one picture through a coded aperture, or from a pair.

    Args:
        pictures: One linear picture, shape (rows, cols), or a list of two of the same scene through different masks,
            in the same unit and equally bright.
        kernels: Of the bank of distances, see `coded_kernels`, shape (D, size, size); of a pair a list of two.
        distances: Of the bank, increasing or decreasing [m], shape (D,).
        noise: Standard deviation of the pictures' noise, in their unit.
        window: Standard deviation of the window in which scores are averaged [pixel].

    Returns:
        The distances.

    Raises:
        BadData: Pictures, kernels and distances do not fit together.
        OutOfRange: Noise or window is not positive.
    """
    images = np.atleast_3d(np.asarray(pictures, np.float64).T).T
    bank, places = np.asarray(kernels, np.float64), np.asarray(distances, np.float64)
    bank = bank[None] if bank.ndim == 3 else bank
    if bank.ndim != 4 or images.ndim != 3 or len(images) > MOST or len(bank) != len(images):
        raise BadData(
            f"pictures {images.shape} and kernels {bank.shape}: wanted one or two pictures, and kernels of each"
        )
    if places.shape != bank.shape[1:2] or len(places) < 2:
        raise BadData(f"distances {places.shape}: wanted two or more, one of each kernel")
    for name, value in (("noise", noise), ("window", window)):
        if not value > 0:
            raise OutOfRange(name, value, f"{name} > 0")
    margin = bank.shape[-1] // 2 + int(3 * window)
    wide = np.pad(images, [(0, 0), (margin, margin), (margin, margin)], mode="symmetric")
    inner = slice(margin, -margin)
    spectra = scipy.fft.rfft2(wide - wide.mean(axis=(1, 2), keepdims=True))
    scores = np.array(
        [
            _score(spectra, _transfers(bank[:, k], wide.shape[1:]), wide.shape[1:], noise, window)
            for k in range(len(places))
        ]
    )[:, inner, inner]
    index = scores.argmin(axis=0)
    return CodedDepth(1 / _refine(scores, index, 1 / places), index, scores)


def _transfers(kernels, shape):
    """Transfer functions of kernels (n, size, size), their middles at sample 0, on a period."""
    size = kernels.shape[-1]
    wide = np.zeros((len(kernels), *shape))
    wide[:, :size, :size] = kernels
    return scipy.fft.rfft2(np.roll(wide, (-(size // 2), -(size // 2)), axis=(1, 2)))


def _score(spectra, transfers, shape, noise, window):
    """Score of one distance at every pixel, (rows, cols)."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    prior = 1 / (fy**2 + fx**2 + LOWEST**2)
    square = (np.abs(transfers) ** 2).sum(axis=0)
    # of white noise s in a picture, |Y|^2 is s^2 times the number of pixels
    pixels, white = np.prod(shape), noise**2
    power = (np.abs(spectra) ** 2).sum(axis=0) / pixels - len(spectra) * white
    strength = max(_mean(power, shape), white * 1e-3) / _mean(prior * square, shape)
    total = strength * prior * square + white
    length = np.sqrt(np.maximum(square, 1e-12))
    along = (transfers.conj() * spectra).sum(axis=0) / length
    parts = [along / np.sqrt(total)]
    if len(spectra) > 1:  # what no scene gives to both
        across = (transfers[1] * spectra[0] - transfers[0] * spectra[1]) / length
        parts.append(across / noise)
    found = sum(scipy.fft.irfft2(part, shape) ** 2 for part in parts)
    return gaussian_filter(found, window, mode="reflect") + _mean(np.log(total), shape)


def _mean(values, shape):
    """Mean over all frequencies of a half spectrum's values."""
    counts = np.full(values.shape[1], 2.0)
    counts[0] = 1
    if shape[1] % 2 == 0:
        counts[-1] = 1
    return float((values @ counts).sum() / np.prod(shape))


def _refine(scores, index, places):
    """Places of the minima of parabolas through the least scores and their neighbours."""
    inner = np.clip(index, 1, len(scores) - 2)
    low, middle, high = (
        np.take_along_axis(scores, (inner + step)[None], 0)[0] for step in (-1, 0, 1)
    )
    bend = low - 2 * middle + high
    step = np.where(bend > 0, 0.5 * (low - high) / np.where(bend > 0, bend, 1), 0)
    is_inner = index == inner
    step = np.where(is_inner, np.clip(step, -0.5, 0.5), index - inner)
    return np.interp(inner + step, np.arange(len(places)), places)
