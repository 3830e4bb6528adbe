"""Tables of lenslets in any array, for the stage `sensor.lenslets`: their parts, and light on near and far pixels.

The light of a cell on the pixels is the product of `gpusim.optics.lenslet_tables` in two axes: the autocorrelation of a
turned square or a hexagon is not one of rows times one of columns.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates

from gpusim.optics.lenslets import LensletPlane, index_range

# share of the light, of both axes, that is left to a mean over lenslets
GATHERED_TAIL = 1e-2
STEPS = 16  # samples of a pixel
FAR_STEPS = 4  # the same for light from afar
LINES = 16  # lines of a sample on which its share with a lenslet is measured
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
