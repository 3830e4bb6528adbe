"""Disparity between the two pictures of dual pixels, its uncertainty, and the defocus and distance that it stands for.

Along each row of a block the cross spectrum of both pictures is L(f) conj R(f). Its phase is 2 pi f d for a right
picture that lies d after the left one. The sum over the rows of a block is turned back by the d that makes the weighted
real part largest. Blurs of dual pixels are half discs, whose phase bends
at high frequencies. With signal power S and noise powers N of the pictures, weights S / (S (N_l + N_r) + N_l N_r) are
those of least variance, and the variance is then the Cramer-Rao bound of unknown Gaussian signals.

Source: Knapp and Carter, IEEE Trans. Acoustics, Speech, Signal Processing 24, 320 (1976).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.signal
from numpy.typing import ArrayLike

from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import short_repr
from gpusim.optics.lenses import lens_of
from gpusim.optics.split_lens import SplitLens
from gpusim.pipeline.diodes import diode_camera, divided, is_sparse

FINER = 4  # places of the first search per pixel
FINEST = 0.35  # cycles per pixel up to which spectra are used: beyond, pixels fold frequencies
COARSE = 0.06  # cycles per pixel of the weights of the first search, 1 / (1 + (f / COARSE)^2)
# the phase of a half disc's transform, atan(H1(v) / J1(v)) with v = pi f x the diameter, is straight up to v = 1.5,
# which is so many cycles per disparity
STRAIGHT = 1.5 * 4 / (3 * np.pi) / np.pi
FEWEST = 3  # frequencies that are used in any case
ROUNDS = 4  # of Newton's method
PASSES = 3  # with blocks displaced by what was found before
LEAST_BLOCK = 8  # pixels along the disparity


@dataclass(frozen=True, eq=False)
class Disparity:
    """Disparity of blocks of two pictures.

    Attributes:
        values: Displacement of the second picture from the first, shape (n, m) [pixel].
        uncertainty: Standard deviation by the noise, shape (n, m) [pixel]; infinite where there is no texture.
        rows: Rows of the blocks' middles, shape (n,) [pixel].
        cols: Columns of the blocks' middles, shape (m,) [pixel].
    """

    values: np.ndarray
    uncertainty: np.ndarray
    rows: np.ndarray
    cols: np.ndarray

    __repr__ = short_repr


def disparity(
    left: ArrayLike,
    right: ArrayLike,
    *,
    noise: float | tuple[float, float] = 0.0,
    block: tuple[int, int] = (32, 64),
    step: tuple[int, int] | None = None,
    split: str = "left-right",
    is_defocus: bool = True,
) -> Disparity:
    """Return the disparity of two pictures in overlapping blocks.

    Half of a block is the largest disparity that is found. Blocks that are wider than the detail of the scene's depth
    mix distances.

    Args:
        left: First picture, linear, without dark level, shape (rows, cols); of a mosaic, sums over its periods.
        right: Second picture, of that shape.
        noise: Mean variance of a pixel's noise in both pictures, or in each, in the pictures' unit squared.
        block: Rows and columns of a block [pixel].
        step: Distance of blocks down and across [pixel]; None is half a block.
        split: Direction of the disparity, "left-right" along columns or "up-down" along rows.
        is_defocus: Whether blurs of half discs displace the pictures, as in dual pixels: their phase is straight at low
            frequencies only. Else the pictures are displaced as a whole.

    Returns:
        The disparities.

    Raises:
        BadData: The pictures have other shapes, or are not finite.
        OutOfRange: The block does not fit the pictures.
    """
    left, right = (np.asarray(one, np.float64) for one in (left, right))
    if left.ndim != 2 or left.shape != right.shape:
        raise BadData(
            f"disparity: pictures of shape {left.shape} and {right.shape}, wanted two of one shape (rows, cols)"
        )
    if not (np.isfinite(left).all() and np.isfinite(right).all()):
        raise BadData("disparity: NaN or infinite values, wanted finite pictures")
    if split == "up-down":
        turned = block[::-1], step and step[::-1]
        found = disparity(
            left.T, right.T, noise=noise, block=turned[0], step=turned[1], is_defocus=is_defocus
        )
        return Disparity(found.values.T, found.uncertainty.T, found.cols, found.rows)
    if not (1 <= block[0] <= left.shape[0] and LEAST_BLOCK <= block[1] <= left.shape[1]):
        raise OutOfRange(
            "block",
            f"{block[0]}x{block[1]}",
            f"{LEAST_BLOCK} .. {left.shape[1]} pixels along the disparity, "
            f"1 .. {left.shape[0]} across it",
        )
    down, across = step or tuple(max(n // 2, 1) for n in block)
    tops = np.arange(0, left.shape[0] - block[0] + 1, down)
    starts = np.arange(0, left.shape[1] - block[1] + 1, across)
    straight = STRAIGHT if is_defocus else np.inf
    search = _Search(left, right, np.broadcast_to(noise, 2), block, straight)
    values = np.zeros((len(tops), len(starts)))
    uncertainty = np.empty_like(values)
    for row, top in enumerate(tops):
        for turn in range(PASSES):
            values[row], uncertainty[row] = search.match(top, starts, values[row], turn == 0)
    rows, cols = tops + (block[0] - 1) / 2, starts + (block[1] - 1) / 2
    return Disparity(values, uncertainty, rows, cols)


class _Search:
    """Matches blocks of two pictures, each time displaced by what was found before.

    noise: Variances of a pixel in both pictures. block: Rows and columns. straight: see `_match`.
    """

    def __init__(self, left, right, noise, block, straight):
        self._block, self._noise, self._pictures = block, noise, (left, right)
        self._straight = straight
        self._splines = [
            scipy.ndimage.spline_filter1d(one, 3, axis=1, mode="mirror") for one in (left, right)
        ]
        self._window = scipy.signal.windows.hann(block[1], sym=False)

    def match(self, top, starts, moved, is_first) -> tuple[np.ndarray, np.ndarray]:
        """Return disparities and their deviations of blocks from `starts` on, displaced by `moved` (m,) already."""
        spectra, powers = [], []
        for number, sign in enumerate((-0.5, 0.5)):
            parts = self._take(number, top, starts, sign * moved)
            level = parts.mean(axis=(0, 2))
            level = np.where(level > 0, level, 1.0)
            lines = (parts - parts.mean(axis=2, keepdims=True)) * self._window
            spectra.append(scipy.fft.rfft(lines, axis=2) / level[:, None])
            powers.append(self._noise[number] * (self._window**2).sum() / level**2)  # of a row
        cross, known = (spectra[0] * spectra[1].conj()).sum(axis=0), None if is_first else moved
        values, found = _match(cross, powers, self._block, known, self._straight)
        # a window correlates the noise of neighbouring frequencies
        window, width = self._window, self._block[1]
        return moved + values, found * np.sqrt(width * (window**4).sum()) / (window**2).sum()

    def _take(self, number, top, starts, moved):
        """Rows of a picture in blocks, (rows, m, cols), displaced by cubics."""
        rows, width = slice(top, top + self._block[0]), self._block[1]
        at = starts[:, None] + np.arange(width)
        if not moved.any():
            return self._pictures[number][rows][:, at]
        lines, whole = self._splines[number][rows], np.floor(moved)
        t = (moved - whole)[:, None]
        weights = ((1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * (t + t**2 - t**3), t**3)
        first = at + whole[:, None].astype(int) - 1
        last = lines.shape[1] - 1
        return sum(
            lines[:, np.clip(first + k, 0, last)] * (weight / 6) for k, weight in enumerate(weights)
        )


def _match(cross, powers, block, moved, straight):
    """Displacements and deviations (m,) from cross spectra (m, F) of all rows, and noise powers of a row (m,).

    moved: Displacements of the blocks already, (m,); None: all are searched. straight: largest cycles per displacement.
    """
    (first, second), (rows, width) = powers, block
    f = np.arange(cross.shape[-1]) / width
    used = (f > 0) & (f <= FINEST)
    f, cross = f[used], cross[..., used]
    noise, both = (first + second)[:, None], rows * (first * second)[:, None]
    least = 1e-12 * np.abs(cross).max(axis=-1, keepdims=True) ** 2 + 1e-300
    values = np.zeros(len(cross))
    if moved is None:
        moved = np.zeros(len(cross))
        places = np.arange(-FINER * width // 2, FINER * width // 2 + 1) / FINER
        waves = np.exp(-2j * np.pi * np.outer(f, places)).astype(np.complex64)
        weighted = (cross / (1 + (f / COARSE) ** 2)).astype(np.complex64)
        values = places[np.argmax((weighted @ waves).real, axis=-1)]
    for _ in range(ROUNDS):
        turned = cross * np.exp(-2j * np.pi * f * values[:, None])
        signal = np.maximum(_smooth(turned.real), 0)
        most = straight / np.maximum(np.abs(moved + values), 1e-9)
        weight = signal / (signal * noise + both + least)
        weight = weight * (f <= np.maximum(most, FEWEST / width)[:, None])
        slope = (weight * 2 * np.pi * f * turned.imag).sum(axis=-1)
        bend = (weight * (2 * np.pi * f) ** 2 * signal).sum(axis=-1)
        values = values + np.clip(slope / np.maximum(bend, 1e-300), -0.5, 0.5)
    variance = (weight**2 * (2 * np.pi * f) ** 2 * (signal * noise + both)).sum(axis=-1) / 2
    found = np.sqrt(variance) / np.maximum(bend, 1e-300)
    return values, np.where(bend > 0, found, np.inf)


def _smooth(power):
    """Powers of neighbouring frequencies, averaged with weights 1, 2, 1."""
    padded = np.concatenate([power[..., :1], power, power[..., -1:]], axis=-1)
    return (padded[..., :-2] + 2 * padded[..., 1:-1] + padded[..., 2:]) / 4


@dataclass(frozen=True)
class _Scale:
    """Disparity in focus [pixel] and its change with the sensor's displacement [pixel/m]."""

    offset: float
    slope: float


def disparity_slope(
    camera: Camera,
    place: tuple[float, float] = (0.0, 0.0),
    wavelength: float = 550.0,
    shape: tuple[int, int] = (1, 1),
) -> float:
    """Return the disparity per metre by which the sensor is out of focus.

    It is the distance of the centroids of the light that the two diodes see: for a sharp border in the middle of a
    round pupil 4 / (3 pi) of the blur's diameter d / N. Right follows left by a positive disparity for objects nearer
    than the plane in focus.

    Args:
        camera: A camera with dual or phase-detection pixels.
        place: Field point (y, x), 1 the frame's corner.
        wavelength: [nm].
        shape: Rows and columns of the frame; they matter if the border between diodes moves over the field.

    Returns:
        [pixel/m], for the displacement of `Optics.displacement`.

    Raises:
        Conflict: The camera has no such pixels.
    """
    return _scale(camera, place, wavelength, shape).slope


def _scale(camera, place, wavelength, shape=(1, 1)) -> _Scale:
    dual = checked_camera(camera).sensor.dual
    if not is_sparse(camera):
        dual = divided(camera)
    assert dual is not None
    axis = 0 if dual.split == "up-down" else 1
    sides = ("top", "bottom") if axis == 0 else ("left", "right")
    halves = replace(
        dual, split="up-down" if axis == 0 else "left-right", sparse="", cell=(1, 1), places=()
    )
    focused = replace(camera.optics, defocus=0.0)  # aberrations displace too, and are known
    halved = replace(camera, sensor=replace(camera.sensor, dual=halves), optics=focused)
    means, centres = [], []
    for side in sides:
        lens = lens_of(diode_camera(halved, side, shape))
        if not isinstance(lens, SplitLens):
            raise BadData(f'{camera.name}: optics model "none" does not blur, and has no disparity')
        means.append(lens.mean_point(wavelength, place)[axis])
        centres.append(float(lens.centroids([wavelength], place)[0, axis]))
    optics = camera.optics
    slope = -(means[1] - means[0]) / (2 * optics.working_f_number * camera.sensor.pixel_pitch)
    return _Scale(centres[1] - centres[0], slope)


def defocus_from_disparity(
    values: ArrayLike,
    camera: Camera,
    place: tuple[float, float] = (0.0, 0.0),
    wavelength: float = 550.0,
    shape: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Return the defocus that disparities stand for, in dioptres.

    Args:
        values: Disparities, any shape [pixel].
        camera: The camera.
        place: Field point (y, x), 1 the frame's corner.
        wavelength: [nm].
        shape: Rows and columns of the frame; they matter if the border between diodes moves over the field.

    Returns:
        Defocus [1/m], positive beyond the plane in focus, see `Optics.diopters`.

    Raises:
        BadData: The lens does not blur.
        Conflict: The camera has no dual or phase-detection pixels.
    """
    scale = _scale(camera, place, wavelength, shape)
    moved = (np.asarray(values, np.float64) - scale.offset) / scale.slope
    return moved / camera.optics.displacement(1.0)


def distance_from_disparity(
    values: ArrayLike,
    camera: Camera,
    place: tuple[float, float] = (0.0, 0.0),
    wavelength: float = 550.0,
    shape: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Return the distance of objects that disparities stand for [m]; infinite for those beyond infinity.

    Args:
        values: Disparities, any shape [pixel].
        camera: The camera.
        place: Field point (y, x), 1 the frame's corner.
        wavelength: [nm].
        shape: Rows and columns of the frame; they matter if the border between diodes moves over the field.

    Returns:
        Distances [m].

    Raises:
        BadData: The lens does not blur.
        Conflict: The camera has no dual or phase-detection pixels.
    """
    vergence = 1 / camera.optics.object_distance - defocus_from_disparity(
        values, camera, place, wavelength, shape
    )
    with np.errstate(divide="ignore"):
        return np.where(vergence > 0, 1 / np.maximum(vergence, 1e-300), np.inf)
