"""Tables of lenslets in any array, for the stage `sensor.lenslets`: their parts, and light on near and far pixels.

The light of a cell on the pixels is the product of `gpusim.optics.lenslet_tables` in two axes: the autocorrelation of a
turned square or a hexagon is not one of rows times one of columns. A smooth window divides it: light within the window
is gathered cell by cell, and the rest is a convolution on the grid of pixels.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gpusim.optics.lengths import fft_length
from gpusim.optics.lenslets import LensletPlane, index_range

# share of the light, of both axes, that is left to the convolution, with wider windows for spots below half a pixel
CONVOLVED_TAIL = 3e-2
LEAST_REACH = 4.0  # pixels of the window beyond the image of a cell: its slope is smooth for samples of a pixel
WRAPPED_TAIL = (
    2e-4  # of a channel's light that the transform may bring back from the other side of the frame
)
STEPS = 32  # samples of a pixel
LINES = 16  # lines of a sample on which its share with a lenslet is measured
ROWS = 256  # of a transfer function at once


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
    """Light of a cell on near pixels, for arrays that are not separable.

    Attributes:
        reach: Pixels whose centres are nearer than this, along rows and columns, use `near` [pixel].
        near: Share of the light of a cell, STEPS samples per pixel, float32, shape (channels, n, n).
    """

    reach: float
    near: np.ndarray


@lru_cache(maxsize=4)
def spot_tables(plane: LensletPlane, cells: tuple[int, int]) -> SpotTables:
    """Return the light of a cell on near pixels: all of it, times a window that is 1 up to half of `reach`.

    Args:
        plane: Numbers of the frame.
        cells: Cells of the pupil, (rows, cols).

    Returns:
        The tables.
    """
    image, part = _light_boxes(plane, cells)
    far = max(2 * max(plane.spots) / (np.pi**2 * CONVOLVED_TAIL), LEAST_REACH)
    reach = int(np.ceil((max(image) + part) / 2 + far))
    slope = np.clip(
        2 - 2 * np.abs(np.arange(-reach * STEPS, reach * STEPS + 1)) / reach / STEPS, 0, 1
    )
    window = np.outer(*[np.sin(np.pi / 2 * slope) ** 2] * 2)
    near = []
    for spot in plane.spots:
        whole, own = (
            window * _spot_table(plane, image, part, spot, reach, aperture)
            for aperture in ((1.0, 1.0), plane.aperture)
        )
        # pixels at equal distances: a whole number in each direction
        sums = whole[:-1, :-1].reshape(2 * reach, STEPS, 2 * reach, STEPS).sum((0, 2))
        # the sum over pixels is the same wherever between them the light lies
        even = np.tile(sums[0, 0] / sums, (2 * reach, 2 * reach))
        near.append(own * np.pad(even, ((0, 1), (0, 1)), mode="wrap"))
    return SpotTables(float(reach), np.array(near, np.float32))


def far_period(plane: LensletPlane, shape: tuple[int, int]) -> tuple[int, int]:
    """Return lengths of transforms in which little light comes back from the other side.

    A slit's diffraction between the distances r and r + n is w / pi^2 (1 / r - 1 / (r + n)) on one side.

    Args:
        plane: Numbers of the frame.
        shape: Rows and columns of the light [pixel].
    """
    most = max(plane.spots) / (np.pi**2 * WRAPPED_TAIL)
    rows, cols = (fft_length(n + int(np.sqrt(n**2 / 4 + most * n) - n / 2) + 1) for n in shape)
    return rows, cols


def far_transfer(
    plane: LensletPlane, cells: tuple[int, int], tables: SpotTables, period: tuple[int, int]
) -> np.ndarray:
    """Return transfer functions of the light that `tables` leave, for light on `cubic_table` of the pixels' grid.

    Args:
        plane: Numbers of the frame.
        cells: Cells of the pupil, (rows, cols).
        tables: Light on near pixels.
        period: Rows and columns of the transform [pixel].

    Returns:
        Real and zero imaginary parts side by side, float32, shape (channels, period[0], 2 (period[1] // 2 + 1)).
    """
    image, part = _light_boxes(plane, cells)
    rows, cols = np.fft.fftfreq(period[0]), np.arange(period[1] // 2 + 1) / period[1]
    # the spline passes through the light at whole distances
    knots = [(2 + np.cos(2 * np.pi * nu)) / 3 for nu in (rows, cols)]
    at = np.arange(-int(tables.reach), int(tables.reach) + 1)
    waves = [np.exp(-2j * np.pi * np.outer(nu, at)) for nu in (rows, cols)]
    found = np.zeros((len(plane.spots), len(rows), len(cols), 2), np.float32)
    for number, spot in enumerate(plane.spots):
        most = int(np.ceil(2 / np.sqrt(3) / spot + 0.5))
        folds = np.arange(-most, most + 1)
        near = waves[0] @ tables.near[number, ::STEPS, ::STEPS]
        for first in range(0, len(rows), ROWS):
            lines = slice(first, first + ROWS)
            total = -(near[lines] @ waves[1].T).real
            for down in folds:
                for across in folds:
                    total += _spot_spectrum(
                        plane,
                        image,
                        part,
                        spot,
                        plane.aperture,
                        (rows[lines] + down, cols + across),
                    )
            found[number, lines, :, 0] = total / knots[0][lines, None] / knots[1]
    return found.reshape(len(found), len(rows), -1)


def cubic_table() -> SpotTables:
    """Return the cubic B-spline as the light of a cell on the pixels' grid, see `SpotTables`, for one channel."""
    x = np.abs(np.arange(-2 * STEPS, 2 * STEPS + 1)) / STEPS
    line = np.where(x < 1, 2 / 3 - x**2 + x**3 / 2, (2 - np.minimum(x, 2)) ** 3 / 6)
    return SpotTables(2.0, np.outer(line, line)[None].astype(np.float32))


def _light_boxes(plane, cells):
    """Return the (height, width) of a cell's image, and the width of the image of a part of a lenslet [pixel]."""
    image = [2 * plane.radius / count for count in cells]
    own = plane.pitch * plane.fill if plane.is_focused_on_pupil else plane.step
    return image, abs(plane.spread) * own


def _spot_table(plane, image, part, spot, reach, aperture):
    """Return the light that pixels get at distances within `reach`, STEPS per pixel, 0 in the middle."""
    span = max(
        128, 4 * reach
    )  # light comes back after it; what far_transfer leaves makes up for that
    most = int(min(2 / np.sqrt(3) / spot, STEPS / 2) * span)
    nu = np.arange(-most, most + 1) / span
    spectrum = _spot_spectrum(plane, image, part, spot, aperture, (nu, nu))
    at = np.arange(-reach * STEPS, reach * STEPS + 1) / STEPS
    waves = np.exp(2j * np.pi * np.outer(at, nu))
    return (waves @ spectrum @ waves.T).real / span**2


def _spot_spectrum(plane, image, part, spot, aperture, frequencies):
    """Return the transform of the light that pixels get, at frequencies (rows, cols) [1/pixel]."""
    boxes = [
        np.sinc(box * nu) * np.sinc(part * nu) * np.sinc(side * nu) * side
        for box, side, nu in zip(image, aperture, frequencies, strict=True)
    ]
    shifts = np.stack(np.meshgrid(*[spot * nu for nu in frequencies], indexing="ij"))
    return aperture_overlap(shifts, plane.normals) * np.outer(*boxes)
