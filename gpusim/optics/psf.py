"""Point spreads on a grid of pixels: of a pupil, by diffraction, and transfer tables of spreads given as arrays."""

from functools import lru_cache

import numpy as np
from scipy.special import roots_legendre

from gpusim.domain.errors import OutOfRange
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, chord, hole_chord, light_moments

CELLS = 128  # along the pupil, for mean slopes of the wavefront
SUBROWS = 6  # Gauss nodes of a row of cells


def steepest_slope(wave) -> float:
    """Return the largest slope of the wavefront in the pupil [waves per radius]."""
    return _largest(wave, at_rim=False)


def fastest_turn(wave) -> float:
    """Return the largest slope of the wavefront, at the rim also where it turns fast [waves per radius]."""
    return _largest(wave, at_rim=True)


def _largest(wave, at_rim):
    slopes = _slopes(len(wave), at_rim) @ np.asarray(wave, np.float64).ravel()
    return float(np.hypot(*slopes).max())


@lru_cache(maxsize=32)
def _slopes(order, at_rim):
    """Slopes of x^i y^j along x and y at places in the pupil, (2, places, order^2)."""
    u = np.linspace(-1, 1, 17)
    y, x = (part[u[:, None] ** 2 + u**2 <= 1] for part in np.meshgrid(u, u, indexing="ij"))
    if at_rim:
        angle = np.arange(8 * order) * (np.pi / (4 * order))
        radius = np.linspace(0.6, 1, 5)[:, None]
        x, y = (
            np.append(inner, radius * turn(angle)) for inner, turn in ((x, np.cos), (y, np.sin))
        )
    powers = np.arange(order)
    in_x, in_y = (part[:, None] ** powers for part in (x, y))
    by_x, by_y = (powers * part[:, None] ** np.maximum(powers - 1, 0) for part in (x, y))
    pairs = ((by_x, in_y), (in_x, by_y))
    return np.array([np.einsum("pi,pj->pij", *pair).reshape(len(x), -1) for pair in pairs])


def mean_slopes(outline: Pupil, waves) -> np.ndarray:
    """Return the wavefronts' mean slopes over the open pupil along y and x [waves per radius], (L, 2)."""
    count = waves.shape[1]
    means, powers = _mean_powers(outline, count), np.arange(count)
    # of x^i y^j: j x^i y^(j - 1) and i x^(i - 1) y^j
    along_y = powers * np.roll(means, 1, axis=1)
    along_x = powers[:, None] * np.roll(means, 1, axis=0)
    flat = np.asarray(waves, np.float64).reshape(len(waves), -1)
    return flat @ np.stack([along_y.ravel(), along_x.ravel()], axis=1)


@lru_cache(maxsize=32)
def _mean_powers(pupil, count):
    """Means of x^i y^j over the open pupil, shape (count, count)."""
    if pupil.mask is not None:
        return light_moments(pupil, count) / (np.pi * pupil.area)
    u = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1
    powers, open_ = u ** np.arange(count)[:, None], coverage(pupil, CELLS)  # [y, x]
    return powers @ open_.T @ powers.T / open_.sum()


@lru_cache(maxsize=32)
def coverage(pupil, count):
    """Return the light that passes every cell of a grid over the pupil, [y, x]; the light of masks adds up."""
    grid = np.linspace(-1, 1, count + 1)
    if pupil.mask is None:
        return open_parts(pupil, grid, grid)
    # in pieces that no edge of the mask divides
    pieces = [np.union1d(grid, edges) for edges in pupil.mask.pieces[:2]]
    values = np.pad(np.square(np.abs(pupil.mask.pieces[2])), 1)
    own = [
        np.searchsorted(edges, (at[1:] + at[:-1]) / 2)
        for edges, at in zip(pupil.mask.pieces[:2], pieces, strict=True)
    ]
    light = open_parts(pupil, *pieces) * values[np.ix_(*own)]
    light *= np.outer(*map(np.diff, pieces))
    for axis, at in enumerate(pieces):
        light = np.add.reduceat(light, np.searchsorted(at, grid[:-1]), axis=axis)
    return light * (count / 2) ** 2


def open_parts(pupil: Pupil, edges_y, edges_x) -> np.ndarray:
    """Return the part of each cell of a grid that is inside the outline of a pupil, (rows, cols)."""
    ends = np.sin(pupil.corners) if pupil.sides.size else np.array([-1.0, 1.0])
    bends = np.concatenate([edges_y, ends, [pupil.obscuration, -pupil.obscuration]])
    bends = np.unique(np.clip(bends, edges_y[0], edges_y[-1]))
    x, share = roots_legendre(SUBROWS)
    low, high = bends[:-1, None], bends[1:, None]
    v, mass = ((low + high + (high - low) * x) / 2).ravel(), ((high - low) * share / 2).ravel()
    row = np.searchsorted(edges_y, (bends[:-1] + bends[1:]) / 2) - 1
    first = np.searchsorted(row, np.arange(len(edges_y) - 1)) * SUBROWS
    found = np.zeros((len(edges_y) - 1, len(edges_x) - 1))
    for sign, of in ((1, chord), (-1, hole_chord)):
        left, right = of(pupil, v)
        cut = np.clip(edges_x, left[:, None], right[:, None])
        found += sign * np.add.reduceat(mass[:, None] * np.diff(cut, axis=1), first, axis=0)
    return found / np.outer(np.diff(edges_y), np.diff(edges_x))


def psf_tables(
    spread: PointSpread,
    wavelengths,
    pitch,
    aperture,
    rows,
    cols,
    finest=0.0,
    place=(0.0, 0.0),
    whole=True,
    displacement=(0.0, 0.0),
    distance=np.inf,
):
    """Return transfer tables at `wavelengths` [nm], the point spread integrated over the pixel.

    Samples of the irradiance determine a function without frequencies beyond half their rate
    (sampling theorem, spacing <= lambda N / 2), so any ratio of pitch and spacing is exact: a
    pixel's share of each sample is the transform of the aperture up to that frequency, folded by
    the pixels, which separates into rows and columns. Between its wavelengths the spread is linear;
    beyond them it is refused.

    Args:
        spread: The point spreads.
        wavelengths: [nm], shape (L,).
        pitch: Of the pixels [m].
        aperture: Height and width of the pixel's aperture over the pitch, or one number for a
            square.
        rows: Rows of the transform's period.
        cols: Columns of the transform's period.
        finest: lambda N / 2 of the shortest wavelength [m] if known; samples of the irradiance
            that are further apart are refused.
        place: Field point, see `PointSpread.at`.
        whole: Refuse spreads that do not fit into this period. Without it the tables are the
            transfer function at these frequencies, to be looked at.
        displacement: Of the aperture's middle from the scene's sample, (rows, cols) [pixel].
        distance: Of the object [m], see `PointSpread.at`.

    Returns:
        Half tables as `optics.blur` takes them, shape (L, rows, 2 (cols // 2 + 1)).

    Raises:
        OutOfRange: The samples are too coarse, the spread is larger than the period, or
            energies of pixels are displaced by parts of a pixel.
    """
    low, high, rest = _neighbours(spread, wavelengths)
    ratio = spread.spacing / pitch
    if whole and spread.integrated and abs(ratio - 1) > 1e-9:
        raise OutOfRange(
            "point spread spacing",
            f"{spread.spacing * 1e6:.6g} um",
            f"the pixel pitch, {pitch * 1e6:.6g} um: energies of other pixels cannot be resampled",
        )
    if spread.integrated and any(move % 1 for move in displacement):
        raise OutOfRange(
            "sensor.offset + sensor.centre",
            "{:.6g}, {:.6g} pixels".format(*displacement),
            "whole pixels: the point spread holds energies of pixels, which cannot be resampled; give "
            "samples of the irradiance",
        )
    if not spread.integrated and finest and spread.spacing > finest * (1 + 1e-9):
        raise OutOfRange(
            "point spread spacing",
            f"{spread.spacing * 1e6:.6g} um",
            f"up to {finest * 1e6:.6g} um, half of lambda N: coarser samples do not determine it",
        )
    values = spread.at(place[0], place[1], distance)
    for size, period, axis in zip(values.shape[1:], (rows, cols), ("rows", "columns"), strict=True):
        if whole and size * ratio > period:
            raise OutOfRange(
                f"point spread {axis}",
                f"{size} samples = {size * ratio:.4g} pixels",
                f"up to the {period} pixels of scene and surroundings",
            )
    (count_y, count_x), (height, width) = values.shape[1:], np.broadcast_to(aperture, 2)
    down, across = displacement
    fy, fx = np.fft.fftfreq(rows), np.arange(cols // 2 + 1) / cols
    left = _sample_transform(fy, count_y, ratio, height, spread.integrated, down)
    right = _sample_transform(fx, count_x, ratio, width, spread.integrated, across)
    own = np.stack([left @ one @ right.T for one in values])
    tables = own[low] * (1 - rest) + own[high] * rest
    for i in {0, rows // 2} if rows % 2 == 0 else {0}:  # what is its own opposite is real
        for j in {0, cols // 2} if cols % 2 == 0 else {0}:
            tables[:, i, j] = tables[:, i, j].real
    return np.ascontiguousarray(tables).view(np.float64)


def _sample_transform(frequencies, count, ratio, aperture, integrated, displacement):
    """Transform of the share of each of `count` samples `ratio` pixels apart in the pixels, (frequencies, count)."""
    places = (np.arange(count) - (count - 1) / 2) * ratio - displacement
    if integrated:
        return np.exp(-2j * np.pi * np.outer(frequencies, places))
    reach = int(np.ceil(0.5 / ratio + 0.5))
    total = np.zeros((len(frequencies), count), complex)
    for a in range(-reach, reach + 1):
        f = frequencies + a
        # at exactly half the rate a sample counts half for either sign
        beyond = np.abs(f) * ratio - 0.5
        share = np.where(beyond < -1e-12, 1.0, np.where(beyond < 1e-12, 0.5, 0.0))
        share = share * np.sinc(aperture * f)
        total += share[:, None] * np.exp(-2j * np.pi * np.outer(f, places))
    return total


def spread_at(
    spread: PointSpread, wavelengths, place=(0.0, 0.0), distance: float = np.inf
) -> np.ndarray:
    """Return point spreads at `wavelengths` [nm], a field point and a distance [m], shape (L, rows, cols).

    Between its wavelengths the spread is linear. Raises OutOfRange beyond them.
    """
    low, high, rest = _neighbours(spread, wavelengths)
    values = spread.at(place[0], place[1], distance)
    return values[low] * (1 - rest) + values[high] * rest


def _neighbours(spread, wavelengths):
    """Indices of the known wavelengths on both sides of each one, and the share of the upper. Raises OutOfRange."""
    known, wavelengths = spread.wavelengths, np.asarray(wavelengths, np.float64)
    if wavelengths.min() < known[0] - 1e-9 or wavelengths.max() > known[-1] + 1e-9:
        raise OutOfRange(
            "wavelengths",
            f"{wavelengths.min():g} .. {wavelengths.max():g} nm",
            f"within the point spread's, {known[0]:g} .. {known[-1]:g} nm",
        )
    share = np.interp(wavelengths, known, np.arange(len(known)))
    low = np.minimum(share.astype(int), max(len(known) - 2, 0))
    high = np.minimum(low + 1, len(known) - 1)
    rest = (share - low)[:, None, None]
    return low, high, rest
