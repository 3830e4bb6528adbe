"""The transfer function of a pupil with a mask for the truth, float64, shared with no frame.

The pupil is sampled on a grid of which every cell of the mask has whole steps. A step at the outline counts by how many
of POINTS^2 points are open. The transfer function is the sum of products of samples, shifted against each other.
"""

from functools import lru_cache
from math import ceil

import numpy as np
import scipy

from gpusim.domain.pupil import Pupil

STEPS = 384  # along the pupil, at least
POINTS = 6  # of a step, along a side


def transfer_of_mask(pupil: Pupil, wave):
    """Return the transfer function of a pupil with a mask and a wavefront, of (sx, sy) within the cut-off.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j [waves].
    """
    amplitude = _amplitudes(pupil)
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in amplitude.shape)
    field = amplitude * np.exp(2j * np.pi * np.polynomial.polynomial.polygrid2d(x, y, wave).T)
    shape = [scipy.fft.next_fast_len(2 * n + 2) for n in field.shape]
    sums = scipy.fft.ifft2(np.abs(scipy.fft.fft2(field, shape, workers=-1)) ** 2, workers=-1)
    middle = [n + 1 for n in field.shape]
    sums = np.roll(sums, middle, axis=(0, 1))[: 2 * middle[0], : 2 * middle[1]]
    sums *= 4 / field.size / _open_area(pupil)
    sums[tuple(middle)] = 1

    def transfer(sx, sy):
        at = [m + s * n for m, s, n in zip(middle, (sy, sx), field.shape, strict=True)]
        real, imaginary = (
            scipy.ndimage.map_coordinates(part, at, order=1) for part in (sums.real, sums.imag)
        )
        return real + 1j * imaginary

    return transfer


@lru_cache(maxsize=4)
def _amplitudes(pupil):
    """Amplitudes of the steps."""
    assert pupil.mask is not None
    values = pupil.mask.values
    parts = [ceil(STEPS / n) for n in values.shape]
    values = np.kron(values, np.ones(parts))
    rows, cols = values.shape
    x = (np.arange(cols * POINTS) + 0.5) / cols / POINTS * 2 - 1
    for number in range(rows):
        y = ((number + (np.arange(POINTS) + 0.5) / POINTS) / rows * 2 - 1)[:, None]
        values[number] *= is_inside(pupil, x, y).mean(axis=0).reshape(cols, POINTS).mean(axis=1)
    return values


def is_inside(pupil: Pupil, x, y) -> np.ndarray:
    """Return whether places are inside the outline of a pupil."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    inside = (radius < 1) & (radius > pupil.obscuration)
    if pupil.blades:
        sector = 2 * np.pi / pupil.blades
        turned = (angle - pupil.rotation) % sector - sector / 2
        inside &= radius * np.cos(turned) < np.cos(sector / 2)
    return inside


def light_of_mask(pupil: Pupil, x, y) -> np.ndarray:
    """Return the share of light that passes the mask at places."""
    if pupil.mask is None:
        return np.ones(np.broadcast_shapes(np.shape(x), np.shape(y)))
    values = pupil.mask.values
    row, col = (
        np.clip(((at + 1) / 2 * n).astype(int), 0, n - 1)
        for at, n in zip((y, x), values.shape, strict=True)
    )
    return np.abs(values[row, col]) ** 2


def _open_area(pupil):
    """Integral of the light over the pupil, by the same steps."""
    values = _amplitudes(pupil)
    # a step that is partly open has the light of its open part
    return np.abs(values * np.abs(_full(pupil))).sum() * 4 / values.size


def _full(pupil):
    values = pupil.mask.values
    return np.kron(values, np.ones([ceil(STEPS / n) for n in values.shape]))
