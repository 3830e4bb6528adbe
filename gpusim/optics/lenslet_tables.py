"""Tables of the stage `sensor.lenslets`: how light that passes a lenslet is shared by the pixels.

Light from one cell of the pupil through one part of a lenslet lands on the image of the cell, widened by the image of
the part, and blurred by the lenslet's diffraction: the squared transform of its clear aperture. A pixel collects
light on its aperture. In frequencies nu [1/pixel] this is the product

    sinc(b nu) sinc(d nu) sinc(a nu) A(nu w),

with b the width of the cell's image, d the width of the part's image, a the pixel's aperture, and A the autocorrelation
of the clear aperture in units of its width: it ends at a finite frequency, so the transform is exact.
"""

import warnings
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from scipy.interpolate import CubicSpline

from gpusim.optics.lenslets import LensletPlane

# Share of a channel's light, along one axis, that the tables may fold back into their reach. The tail of a slit's
# diffraction beyond the distance r is w / (pi^2 r). An error of a pixel is this times the contrast at that distance.
TAIL = 2e-4
NEAR = 1.25  # pitches within which cells count one by one; beyond, all cells of a sample have their mean weight
FINE = 128  # samples of a pixel in tables of one axis
BLOCK = 8  # positions of pixels with one window of samples


class _Profile:
    """Light of a cell on pixels along one axis, for one channel."""

    def __init__(self, cell, spot, aperture, reach):
        # of the transform: more than all distances
        period = 2 ** ceil(np.log2(2 * reach + 64))
        count = period * FINE
        nu = np.arange(count // 2 + 1) / period
        light = np.maximum(1 - nu * spot, 0) * np.sinc(cell * nu)  # density on the pixel plane
        self.collected = self._spline(light * np.sinc(aperture * nu) * aperture, period)
        self.area = self.collected.antiderivative()
        self.summed = self._spline(light, period).antiderivative()

    @staticmethod
    def _spline(spectrum, period):
        count = 2 * (len(spectrum) - 1)
        values = np.fft.fftshift(np.fft.irfft(spectrum, count)) * FINE
        return CubicSpline((np.arange(count) - count // 2) / FINE, values)

    def at(self, distance, width, reach):
        """Return the share of the light that pixels collect, within `reach`; its sum is the whole light.

        Args:
            distance: From the middle of the light to the pixel [pixel], any shape.
            width: Of the image of the part of the lenslet [pixel], of that shape.
            reach: Distance at which the table ends [pixel].
        """
        distance = np.clip(distance, -reach - 1, reach + 1)
        half = (
            np.maximum(width, 1e-2) / 2
        )  # narrower ones are no different: the square of 1e-2 over 24
        value = (self.area(distance + half) - self.area(distance - half)) / (2 * half)
        # pixels at distances within the reach cover -low .. high
        low = np.floor(reach + distance) - distance + 0.5
        high = np.floor(reach - distance) + distance + 0.5
        kept = self.summed(high) - self.summed(-low)
        return np.where(np.abs(distance) <= reach, value / kept, 0.0)


@dataclass(frozen=True)
class AxisTable:
    """Weights of samples along one axis of a separable array, by phase of the mosaic.

    Positions of one phase are phase + period k. Each `BLOCK` of them has one window of samples.

    Attributes:
        first: First sample of each block's window, shape (phases, blocks).
        weights: Share of the light of sample first + m and cell i, shape (phases, channels, window, cells, positions);
            positions are a whole number of blocks.
        far_first: First sample of each block's window of distant samples, shape (phases, blocks).
        far_weights: Share of the light of all cells of sample far_first + m, 0 within the other window, shape (phases,
            channels, window, positions).
    """

    first: np.ndarray
    weights: np.ndarray
    far_first: np.ndarray
    far_weights: np.ndarray


@lru_cache(maxsize=16)
def axis_table(
    plane: LensletPlane, axis: int, size: int, samples: int, cells: int, period: int
) -> AxisTable:
    """Return the weights along one axis.

    Args:
        plane: Numbers of the frame, separable.
        axis: 0 for rows, 1 for columns.
        size: Pixels.
        samples: Number of samples.
        cells: Cells of the pupil along the axis.
        period: Of the mosaic.

    Returns:
        The table.
    """
    widest = max(plane.spots)
    boxes = plane.aperture[axis] / 2 + plane.radius / cells + abs(plane.spread) * plane.step / 2
    near = boxes + NEAR * plane.pitch
    reach = near + widest / (np.pi**2 * TAIL)
    land, width, share = _land_axis(plane, axis, samples, cells)
    lit = np.where(share[:, :, None] > 0, land, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # samples between lenslets have no light
        span = np.nanmin(lit, (1, 2)), np.nanmax(lit, (1, 2))
    positions = ceil(ceil(size / period) / BLOCK) * BLOCK
    place = np.arange(period)[:, None] + period * np.arange(positions) - (size - 1) / 2
    first, window = _windows(place, span, near)
    far_first, far_window = _windows(place, span, reach)
    image = 2 * plane.radius / cells
    profiles = [_Profile(image, spot, plane.aperture[axis], reach) for spot in plane.spots]
    weights = np.zeros((period, len(profiles), window, cells, positions), np.float32)
    far_weights = np.zeros((period, len(profiles), far_window, positions), np.float32)
    for phase in range(period):

        def weigh(sample, profile, at=place[phase]):
            value = profile.at(at[:, None, None] - land[sample], width[sample][..., None], reach)
            return np.einsum("kpi,kp->ik", value, share[sample])

        begin = np.repeat(first[phase], BLOCK)
        for channel, profile in enumerate(profiles):
            for m in range(window):
                weights[phase, channel, m] = weigh(begin + m, profile)
            for m in range(far_window):
                sample = np.repeat(far_first[phase] + m, BLOCK)
                is_far = (sample < begin) | (sample >= begin + window)
                far_weights[phase, channel, m] = is_far * weigh(sample, profile).mean(0)
    return AxisTable(first, weights, far_first, far_weights)


def _windows(place, span, reach):
    """Return the first sample that reaches each block of positions, and the number of samples for all blocks.

    Args:
        place: Of positions [pixel], shape (phases, positions).
        span: Least and largest place at which each sample's light lands [pixel]; NaN for none.
        reach: Distance at which light counts [pixel].
    """
    blocks = place.reshape(len(place), -1, BLOCK)
    is_near = (span[0] <= blocks.max(-1)[..., None] + reach) & (
        span[1] >= blocks.min(-1)[..., None] - reach
    )
    samples = is_near.shape[-1]
    is_any = is_near.any(-1)
    begin = np.where(is_any, is_near.argmax(-1), 0)
    end = np.where(is_any, samples - is_near[..., ::-1].argmax(-1), 0)
    window = min(samples, max(1, int((end - begin).max())))
    return np.minimum(begin, samples - window).astype(np.int32), window


def _land_axis(plane, axis, samples, cells):
    """Return where the parts of samples land along one axis.

    Returns:
        Places [pixel], (samples, parts, cells); widths of the parts' images [pixel] and their shares of a sample [1],
        (samples, parts).
    """
    origin, start, middle = plane.origin[axis], plane.start[axis], plane.axis[axis]
    edge = start + plane.step * (np.arange(samples) - 0.5)
    slack = 1e-6 * plane.step  # boundaries of samples may be boundaries of lenslets
    low = np.rint((edge + slack - origin) / plane.pitch)
    parts = int((np.rint((edge + plane.step - slack - origin) / plane.pitch) - low).max()) + 1
    centre = origin + plane.pitch * (low[:, None] + np.arange(parts))
    clear = plane.fill * plane.pitch / 2
    begin = np.maximum(edge[:, None], centre - clear)
    end = np.minimum(edge[:, None] + plane.step, centre + clear)
    extent = np.maximum(end - begin, 0)
    at = (begin + end) / 2
    land = at + plane.tilt * (at - middle) - plane.power * (at - centre)
    pupil = (2 * np.arange(cells) + 1) / cells - 1
    return (
        land[..., None] - plane.radius * pupil,
        abs(plane.spread) * extent,
        extent / plane.step,
    )


def mosaic_pairs(cfa: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the phases of one axis with each channel that occurs there.

    Args:
        cfa: Channels of one period, shape (period_y, period_x).
        axis: 0: phases of rows; 1: of columns.

    Returns:
        Phases and channels, int32, shape (pairs, 2); and the pair of each pixel of the period, int32.
    """
    phases = np.indices(cfa.shape)[axis]
    both = np.stack([phases.ravel(), cfa.ravel()], -1)
    pairs, place = np.unique(both, axis=0, return_inverse=True)
    return pairs.astype(np.int32), place.reshape(cfa.shape).astype(np.int32)
