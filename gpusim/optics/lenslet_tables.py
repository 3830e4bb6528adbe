"""Tables of the stage `sensor.lenslets`: how light that passes a lenslet is shared by the pixels.

Light from one cell of the pupil through one part of a lenslet lands on the image of the cell, widened by the image of
the part, and blurred by the lenslet's diffraction: the squared transform of its clear aperture. A pixel collects what
falls on its aperture. In frequencies nu [1/pixel] this is the product

    sinc(b nu) sinc(d nu) sinc(a nu) A(nu w),

with b the width of the cell's image, d that of the part, a the pixel's aperture, and A the autocorrelation of the clear
aperture in units of its width: it ends at a finite frequency, so the transform is exact.
"""

import warnings
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from gpusim.optics.lenslets import LensletPlane, index_range

# Share of a channel's light, along one axis, that the tables may fold back into their reach. The tail of a slit's
# diffraction beyond the distance r is w / (pi^2 r). An error of a pixel is this times the contrast at that distance.
TAIL = 2e-4
NEAR = 1.25  # pitches within which cells count one by one; beyond, all cells of a sample have their mean weight
FINE = 128  # samples of a pixel in tables of one axis
STEPS = 16  # samples of a pixel in tables of two axes
FAR_STEPS = 4  # the same for light from afar
GATHERED_TAIL = (
    1e-2  # share of the light, of both axes, that tables of two axes leave to a mean over lenslets
)
LINES = 16  # lines of a sample on which its share with a lenslet is measured
BLOCK = 8  # positions of pixels with one window of samples
FAR = 12  # lenslets, in each direction of the lattice, whose light reaches a lenslet by diffraction


def aperture_overlap(shifts, normals):
    """Return the autocorrelation of a lenslet's clear aperture, 1 at 0.

    The aperture is a square or a hexagon of width 1. Its overlap with its own copy lies between pairs of lines that are
    closer by the shift along their normals: a rectangle, without two corners for a hexagon.

    Args:
        shifts: Over the width of the aperture, shape (2, ...).
        normals: Unit vectors (rows, cols) to the sides, two or three.

    Returns:
        Share of the area, shape (...).
    """
    half = [np.maximum(1 - np.abs(y * shifts[0] + x * shifts[1]), 0) / 2 for y, x in normals]
    if len(half) == 2:
        return 4 * half[0] * half[1]
    # in coordinates p, q along the first and the third direction, the second is p + q
    p, limit, q = half
    cut = np.maximum(p + q - limit, 0)
    corner = (cut**2 - np.maximum(cut - 2 * p, 0) ** 2 - np.maximum(cut - 2 * q, 0) ** 2) / 2
    return np.maximum(4 * p * q - 2 * corner, 0) / 0.75


class _Profile:
    """Light of a cell on pixels along one axis, for one channel."""

    def __init__(self, cell, spot, aperture, reach):
        period = 2 ** int(
            np.ceil(np.log2(2 * reach + 64))
        )  # of the transform: more than all places
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
    slack = 1e-6 * plane.step  # boundaries of samples may be those of lenslets
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


@dataclass(frozen=True)
class Sources:
    """Lenslets of any array and the samples whose light they pass.

    Attributes:
        low: Index of the first lenslet along both steps of the lattice.
        shape: Number of lenslets along both steps.
        sample: Index of each sample, row by row, int32, shape (lenslets, parts).
        share: Share of the sample's light [1], float32, of that shape.
        place: Where light through the pupil's middle lands, (rows, cols) [pixel], float32, shape (lenslets, parts, 2).
    """

    low: tuple[int, int]
    shape: tuple[int, int]
    sample: np.ndarray
    share: np.ndarray
    place: np.ndarray


@lru_cache(maxsize=4)
def lenslet_sources(
    plane: LensletPlane, size: tuple[int, int], samples: tuple[int, int]
) -> Sources:
    """Return the lenslets over a frame, and the parts of samples within their clear apertures.

    A part's light is at its centre of gravity. Shares are areas, measured on LINES lines of a sample.

    Args:
        plane: Numbers of the frame.
        size: Rows and columns of pixels.
        samples: Rows and columns of samples.

    Returns:
        The sources.
    """
    lattice, origin = np.array(plane.lattice), np.array(plane.origin)
    along, down = index_range(lattice, origin, size, plane.radius + plane.pitch)
    shape = (along[1] - along[0], down[1] - down[0])
    a, b = np.meshgrid(np.arange(*along), np.arange(*down), indexing="ij")
    centres = origin + np.stack([a, b], -1).reshape(-1, 2) @ lattice
    reach = (
        plane.pitch * plane.fill / 2 * (np.sqrt(2) if len(plane.normals) == 2 else 2 / np.sqrt(3))
    )
    first = np.ceil((centres - reach - plane.start) / plane.step - 0.5).astype(int)
    side = int(np.ceil(2 * reach / plane.step)) + 1
    window = np.indices((side, side)).reshape(2, -1).T
    sample = first[:, None] + window  # (lenslets, parts, 2)
    at = np.asarray(plane.start) + plane.step * sample - centres[:, None]
    share, gravity = _share_samples(plane, at)
    is_there = ((sample >= 0) & (sample < samples)).all(-1)
    share = np.where(is_there, share, 0)
    index = np.where(is_there, sample[..., 0] * samples[1] + sample[..., 1], 0)
    land = centres[:, None] * (1 + plane.tilt) - plane.tilt * np.array(plane.axis)
    land = land + plane.spread * gravity
    used = share.max(0) > 0  # places of the window that no lenslet needs
    return Sources(
        (along[0], down[0]),
        shape,
        np.ascontiguousarray(index[:, used], np.int32),
        np.ascontiguousarray(share[:, used], np.float32),
        np.ascontiguousarray(land[:, used], np.float32),
    )


def _share_samples(plane, at):
    """Return shares and centres of gravity of samples within the clear aperture.

    Args:
        plane: Numbers of the frame.
        at: Middles of samples relative to the lenslet's centre [pixel], shape (..., 2).

    Returns:
        Shares [1], shape (...), and centres of gravity [pixel], shape (..., 2).
    """
    clear, half = plane.fill * plane.pitch / 2, plane.step / 2
    area = np.zeros(at.shape[:-1])
    gravity = np.zeros(at.shape)
    for line in (np.arange(LINES) + 0.5) / LINES * 2 - 1:
        y = at[..., 0] + line * half
        left, right = at[..., 1] - half, at[..., 1] + half
        for ny, nx in plane.normals:
            if nx == 0:
                right = np.where(np.abs(ny * y) <= clear, right, left)
                continue
            ends = [(sign * clear - ny * y) / nx for sign in (-1, 1)]
            left, right = np.maximum(left, np.minimum(*ends)), np.minimum(right, np.maximum(*ends))
        length = np.maximum(right - left, 0)
        area += length
        gravity += length[..., None] * np.stack([y, (left + right) / 2], -1)
    gravity = gravity / np.maximum(area, 1e-30)[..., None]
    return area / (LINES * plane.step), np.where(area[..., None] > 0, gravity, 0)


@dataclass(frozen=True)
class SpotTables:
    """Light of a cell on pixels near and far, for arrays that are not separable.

    Attributes:
        reach: Pixels whose centres are nearer than this, along rows and columns, use `near` [pixel].
        near: Share of the light of a cell, STEPS samples per pixel, float32, shape (channels, n, n).
        far: Mean share that a pixel gets of the light of a lenslet at distances -FAR .. FAR along both steps, beyond
            `reach`, float32, shape (channels, m, m).
    """

    reach: float
    near: np.ndarray
    far: np.ndarray


@lru_cache(maxsize=4)
def spot_tables(plane: LensletPlane, cells: tuple[int, int]) -> SpotTables:
    """Return the light of a cell on pixels.

    Light within `reach` is exact. The rest, a few per cent, comes from a mean over the pixels of one lenslet and the
    cells of the other; it is scaled so that the sum is the whole light.

    Args:
        plane: Numbers of the frame.
        cells: Cells of the pupil, (rows, cols).

    Returns:
        The tables.
    """
    image = [2 * plane.radius / count for count in cells]
    part = abs(plane.spread) * (
        plane.pitch * plane.fill if plane.is_focused_on_pupil else plane.step
    )
    reach = (
        np.ceil((max(image) + part) / 2 + 2 * max(plane.spots) / (np.pi**2 * GATHERED_TAIL)) + 0.5
    )
    span, far_span = (
        2 ** int(np.ceil(np.log2(max(128, most))))
        for most in (4 * reach, 2 * (FAR + 3) * plane.pitch)
    )
    near, far = [], []
    for spot in plane.spots:

        def tabulate(aperture, span, steps, spot=spot):
            return _spot_table(plane, image, part, spot, span, steps, aperture)

        whole, own = (tabulate(one, span, STEPS) for one in ((1.0, 1.0), plane.aperture))
        half, middle = int(reach * STEPS), len(own) // 2
        cut = slice(middle - half, middle + half + 1)
        inner = whole[cut, cut][
            :-1, :-1
        ]  # pixels at equal distances: a whole number in each direction
        count = 2 * half // STEPS
        sums = inner.reshape(count, STEPS, count, STEPS).sum((0, 2))
        kept = sums.mean()
        # the sum over pixels is the same wherever between them the light lies
        even = np.pad(np.tile(kept / sums, (count, count)), ((0, 1), (0, 1)), mode="wrap")
        near.append(own[cut, cut] * even)
        whole, own = (tabulate(one, far_span, FAR_STEPS) for one in ((1.0, 1.0), plane.aperture))
        far.append(_far_table(plane, own, whole, reach, 1 - kept))
    return SpotTables(float(reach), np.array(near, np.float32), np.array(far, np.float32))


def _spot_table(plane, image, part, spot, span, steps, aperture):
    """Return the light that pixels get at all distances within `span`, `steps` per pixel, 0 in the middle."""
    count = span * steps
    nu = np.fft.fftfreq(count, 1 / steps)
    keep = np.abs(nu) * spot <= 2 / np.sqrt(3) + 1e-9
    used = nu[keep]
    boxes = [
        np.sinc(box * used) * np.sinc(part * used) * np.sinc(side * used) * side
        for box, side in zip(image, aperture, strict=True)
    ]
    shifts = np.stack(np.meshgrid(used * spot, used * spot, indexing="ij"))
    spectrum = np.zeros((count, count), np.complex64)
    spectrum[np.ix_(keep, keep)] = aperture_overlap(shifts, plane.normals) * np.outer(*boxes)
    return np.fft.fftshift(np.fft.ifft2(spectrum).real) * steps**2


def _far_table(plane, own, whole, reach, share):
    """Return the mean light that pixels of one lenslet get from cells of another, beyond `reach`."""
    middle, lattice = len(own) // 2, np.array(plane.lattice)
    steps = np.arange(-FAR, FAR + 1)
    grid = (np.arange(6) + 0.5) / 6 - 0.5
    pixels = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2) @ lattice
    pupil = 2 * np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    pupil = plane.radius * pupil[np.hypot(*pupil.T) <= 1]
    between = (pixels[:, None] + pupil[None]).reshape(-1, 2)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1) @ lattice
    distance = between - offsets[..., None, :]  # from light of the lenslet at the offset to a pixel
    is_far = np.abs(distance).max(-1) >= reach
    places = np.moveaxis(distance, -1, 0) * FAR_STEPS + middle
    found = [
        (map_coordinates(table, places, order=1, mode="grid-wrap") * is_far).mean(-1)
        for table in (own, whole)
    ]
    total = found[1].sum() * abs(np.linalg.det(lattice))
    return found[0] * share / total
