"""Fall-off of the light over the frame, from even light through the lens."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData
from gpusim.domain.short_repr import short_repr
from gpusim.fit.estimate import Estimate, Part, Plot
from gpusim.fit.planes import (
    channel_blocks,
    checked_frames,
    clipped_mask,
    field_place,
    light_values,
    main_channel,
)
from gpusim.io.raw.raw_frame import RawFrame

BLOCKS = 64  # blocks on the longer side of the frame
# models that are tried: order of a polynomial in rows and columns, and the last even power of the field height. Of the
# first ones the powers stand for themselves, of the second ones all are multiplied by the polynomial: a round fall-off
# off the middle, tilted
SUMS = ((1, 4), (2, 4), (2, 6), (2, 8), (4, 6), (4, 8), (4, 10), (6, 8), (6, 10), (8, 10), (10, 10))
PRODUCTS = ((1, 4), (1, 6), (1, 8), (2, 4), (2, 6), (2, 8), (2, 10))
MODELS = tuple((*one, False) for one in SUMS) + tuple((*one, True) for one in PRODUCTS)
WIDE = (4, 8, False)  # the model that finds blocks with dust
TAIL = 4.0  # robust standard deviations of a block that is left out: dust, a hot pixel
ROUND = 0.0015  # most by which a round fall-off may miss the map, or twice the map's own error
COLOURED = 0.005  # difference of channels that is worth a line
HEIGHTS = np.linspace(0, 1, 21)
FLOOR = 8e-4  # relative error of the models themselves in the corners
NODES = 33  # of a map over the longer side
MOST_CLIPPED = 1e-3


@dataclass(frozen=True, eq=False)
class Falloff:
    """Response of a channel to even light over the frame.

    Args:
        order: Order of the polynomial in rows and columns.
        power: Last even power of the field height.
        is_product: Whether powers are multiplied by the polynomial.
        coefficients: Of the model's functions, shape (n,).
        error: Relative standard error in the four corners, see `_corners`.
        left: Relative residuals of blocks, (rows, cols); NaN: left out.
    """

    order: int
    power: int
    is_product: bool
    coefficients: np.ndarray
    error: np.ndarray
    left: np.ndarray

    __repr__ = short_repr

    def at(self, rows: np.ndarray, cols: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Return the response at rows and columns [pixel] that broadcast, 1 in the frame's middle."""
        y, x = np.broadcast_arrays(*(np.asarray(at, np.float64) for at in (rows, cols)))
        here = (
            _basis(y.ravel(), x.ravel(), shape, self.order, self.power, self.is_product)
            @ self.coefficients
        )
        row, col = _middle(shape)
        middle = (
            _basis(row, col, shape, self.order, self.power, self.is_product) @ self.coefficients
        )
        return np.asarray(here / middle).reshape(y.shape)


def _middle(shape):
    return tuple(np.array([(n - 1) / 2]) for n in shape)


def _basis(rows, cols, shape, order, power, is_product):
    """Return the functions of a model at pixels, (N, n)."""
    y, x = (2 * (at + 0.5) / n - 1 for at, n in zip((rows, cols), shape, strict=True))
    table = chebyshev.chebvander2d(y, x, [order, order]).reshape(len(y), order + 1, order + 1)
    parts = [table[:, i, j] for i in range(order + 1) for j in range(order + 1 - i)]
    square = np.asarray(np.hypot(*field_place(rows, cols, shape))) ** 2
    if is_product:
        return np.stack(
            [part * square ** (k // 2) for part in parts for k in range(0, power + 1, 2)], axis=1
        )
    parts += [square ** (k // 2) for k in range(order // 2 * 2 + 2, power + 1, 2)]
    return np.stack(parts, axis=1)


def measure_shading(
    frames: RawFrame | Sequence[RawFrame], *, black: ArrayLike | None = None
) -> dict[str, Falloff]:
    """Fit a smooth surface to each channel of frames of even light.

    Args:
        frames: One or more frames of the same even surface, which are averaged.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.

    Returns:
        The fall-off by channel.

    Raises:
        BadData: Frames are clipped, dark, or show no even light.
    """
    every = checked_frames(frames, "flat")
    period = max(len(every[0].cfa), len(every[0].cfa[0]))
    shape = every[0].values.shape
    size = max(1, max(shape) // (BLOCKS * period))
    total = None
    for frame in every:
        values = light_values(frame, black)
        if clipped_mask(frame, values).mean() > MOST_CLIPPED:
            raise BadData(
                f"{frame.name or 'flat'}: clipped; expose the flat less, to half of the range"
            )
        blocks, block = channel_blocks(frame, values, size)
        total = blocks if total is None else total + blocks
    assert total is not None
    total = total / len(every)
    name = every[0].name or "flat"
    if not total.mean(axis=(1, 2)).min() > 0:
        raise BadData(f"{name}: a channel is dark; give the flat more light")
    return {
        letter: _surface(plane, block, shape, name)
        for letter, plane in zip(every[0].channels, total, strict=True)
    }


def _surface(plane, block, shape, name):
    """Return the smooth surface of one channel's blocks."""
    rows = (np.arange(plane.shape[0]) + 0.5) * block[0] - 0.5
    cols = (np.arange(plane.shape[1]) + 0.5) * block[1] - 0.5
    y, x = (axis.ravel() for axis in np.meshgrid(rows, cols, indexing="ij"))
    seen = plane.ravel() / np.median(plane)
    corners = [
        np.array(at, float) for at in zip(*(place[:2] for place in _corners(shape)), strict=True)
    ]
    fits = []
    kept = _smooth_blocks(y, x, seen, shape)
    for order, power, is_product in MODELS:
        matrix = _basis(y, x, shape, order, power, is_product)
        if 2 * matrix.shape[1] > kept.sum():
            continue
        found = np.linalg.lstsq(matrix[kept], seen[kept], rcond=None)[0]
        left = seen - matrix @ found
        count, size = kept.sum(), matrix.shape[1]
        squares = float((left[kept] ** 2).sum())
        score = count * np.log(squares / count + 1e-30) + 2 * size
        ends = _basis(*corners, shape, order, power, is_product)
        inner = np.linalg.pinv(matrix[kept].T @ matrix[kept])
        variance = squares / max(count - size, 1) * np.einsum("ij,jk,ik->i", ends, inner, ends)
        fits.append(
            (
                score,
                (order, power, is_product),
                found,
                np.where(kept, left, np.nan),
                ends @ found,
                variance,
            )
        )
    if not fits:
        raise BadData(
            f"{name}: {plane.shape[1]} x {plane.shape[0]} blocks, too few; use a larger frame"
        )
    fits.sort(key=lambda one: one[0])
    score, model, found, left, ends, variance = fits[0]
    if not (ends > 0.02).all():
        raise BadData(f"{name}: no even light, a corner is dark; shoot a flat that fills the frame")
    if np.nanstd(left) > 0.05:
        raise BadData(
            f"{name}: no even light, blocks differ by {100 * np.nanstd(left):.2g} % from a smooth surface; shoot "
            "a white "
            "wall out of focus or a diffuser"
        )
    # models that explain the blocks nearly as well differ in the corners
    weights = np.exp([-(one[0] - score) / 2 for one in fits])
    apart = np.array([(one[4] - ends) ** 2 for one in fits])
    error = np.sqrt(variance + (weights @ apart) / weights.sum()) / ends
    return Falloff(*model, found, error, left.reshape(plane.shape))


def _smooth_blocks(y, x, seen, shape):
    """Return the blocks that a smooth surface explains: no dust, no hot pixels."""
    kept = np.ones(len(seen), bool)
    matrix = _basis(y, x, shape, *WIDE)
    for _ in range(4):
        if kept.sum() < 2 * matrix.shape[1]:
            return np.ones(len(seen), bool)
        left = seen - matrix @ np.linalg.lstsq(matrix[kept], seen[kept], rcond=None)[0]
        spread = 1.4826 * np.median(np.abs(left[kept])) + 1e-12
        kept = np.abs(left) < TAIL * spread
    return kept


def fit_shading(frames: RawFrame | Sequence[RawFrame], *, black: ArrayLike | None = None) -> Part:
    """Fit the fall-off of the light to frames of even light through the lens.

    Args:
        frames: See `measure_shading`.
        black: See `measure_shading`.

    Returns:
        The fall-off as optics.relative_illumination if it is round about the frame's middle, else as a map under
        sensor.vignetting, for the channel of most light.

    Raises:
        BadData: See `measure_shading`.
    """
    every = checked_frames(frames, "flat")
    shape, sources = every[0].values.shape, tuple(frame.name for frame in every)
    found = measure_shading(every, black=black)
    main = main_channel(tuple(found))
    settings = _settings(found[main], shape)
    estimates = {}
    for letter, own in found.items():
        for (row, col, words), error in zip(_corners(shape), own.error, strict=True):
            value = float(own.at(row, col, shape))
            reach = 1.96 * value * np.hypot(error, FLOOR)
            key = f"relative illumination of {letter} at the {words} corner"
            estimates[key] = Estimate(
                value, value - reach, value + reach, "", sources, "the frame's middle is 1"
            )
    return Part(
        "shading",
        estimates,
        settings,
        _plots(found, shape, main),
        _describe_misfit(found, shape, main),
        (
            "causes of the fall-off: the lens, the pixels and an uneven surface look alike; turn the camera by "
            "half and "
            "compare, or shoot through a diffuser on the lens",
        ),
    )


def falloff_map(found: Falloff, shape: tuple[int, int]) -> np.ndarray:
    """Return the response at every pixel, 1 in the frame's middle, shape (rows, cols)."""
    # a smooth surface: computed on a grid, cubic in between
    nodes = [np.linspace(0, n - 1, min(n, 65)) for n in shape]
    coarse = found.at(nodes[0][:, None], nodes[1][None, :], shape)
    spline = scipy.interpolate.RectBivariateSpline(*nodes, coarse)
    return np.asarray(spline(np.arange(shape[0]), np.arange(shape[1])))


def _corners(shape):
    bottom, right = shape[0] - 1, shape[1] - 1
    return (
        (0, 0, "upper left"),
        (0, right, "upper right"),
        (bottom, 0, "lower left"),
        (bottom, right, "lower right"),
    )


def _settings(own: Falloff, shape):
    """Return the settings: a curve if the fall-off is round, else a map."""
    rows, cols = (np.linspace(0, n - 1, 41) for n in shape)
    y, x = np.meshgrid(rows, cols, indexing="ij")
    response = own.at(y, x, shape)
    height = np.hypot(*field_place(y, x, shape))
    # a smooth round function: even powers of the height, 1 in the middle
    powers = np.stack([height.ravel() ** (2 * k) for k in range(1, 6)], axis=1)
    solved = np.linalg.lstsq(powers, response.ravel() - 1, rcond=None)[0]
    miss = float(np.abs((powers @ solved + 1) / response.ravel() - 1).max())
    if miss <= max(ROUND, 2 * own.error.mean()):
        curve = 1 + np.stack([HEIGHTS ** (2 * k) for k in range(1, 6)], axis=1) @ solved
        table = {"heights": HEIGHTS.tolist(), "values": np.round(curve, 5).tolist()}
        return {"optics": {"relative_illumination": table}}
    step = max(shape) / (NODES - 1)
    nodes = [np.linspace(-0.5, n - 0.5, max(3, round(n / step) + 1)) for n in shape]
    response = own.at(nodes[0][:, None], nodes[1][None, :], shape)
    response = np.clip(response / response.max(), 0, 1)
    even = {"heights": [0.0, 1.0], "values": [1.0, 1.0]}
    return {
        "optics": {"relative_illumination": even},
        "sensor": {"vignetting": np.round(response, 5).tolist()},
    }


def _describe_misfit(found, shape, main):
    lines = []
    y, x = np.meshgrid(*(np.linspace(0, n - 1, 33) for n in shape), indexing="ij")
    leading = found[main].at(y, x, shape)
    for letter, own in found.items():
        response = own.at(y, x, shape)
        most = float(np.abs(response / leading - 1).max())
        if letter != main and most > COLOURED:
            lines.append(
                f"shading of {letter}: up to {100 * most:.2g} % from that of {main}, whose map all channels have in "
                "the "
                "camera file"
            )
        lost = float(np.mean(np.isnan(own.left)))
        if lost > 0.01:
            lines.append(
                f"shading of {letter}: {100 * lost:.2g} % of the blocks are no smooth surface (dust, texture) and not "
                "used"
            )
    return tuple(lines)


def _plots(found, shape, main):
    def draw_map(figure):
        axes = figure.subplots()
        rows, cols = (np.linspace(0, n - 1, 101) for n in shape)
        y, x = np.meshgrid(rows, cols, indexing="ij")
        drawn = axes.contourf(x, y, found[main].at(y, x, shape), 16)
        figure.colorbar(drawn, ax=axes)
        axes.set(ylim=(shape[0], 0), aspect="equal", xlabel="column [pixel]", ylabel="row [pixel]")

    def draw_diagonal(figure):
        axes = figure.subplots()
        part = np.linspace(0, 1, 101)
        row, col = part * (shape[0] - 1), part * (shape[1] - 1)
        colours = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}
        for letter, own in found.items():
            response = own.at(row, col, shape)
            axes.plot(2 * part - 1, response, color=colours.get(letter, "0.4"), label=letter)
        axes.legend()
        axes.set(xlabel="along the diagonal, corner to corner", ylabel="response, 1 in the middle")

    def draw_left(figure):
        axes = figure.subplots()
        drawn = axes.imshow(100 * found[main].left, cmap="RdBu", interpolation="nearest")
        figure.colorbar(drawn, ax=axes, label="%")
        axes.set(xlabel="block", ylabel="block")

    return (
        Plot(
            "Fall-off of the light", f"Fitted response of channel {main} to even light.", draw_map
        ),
        Plot("Fall-off along the diagonal", "All channels, from corner to corner.", draw_diagonal),
        Plot("Flat: residuals", f"Blocks of channel {main} less the smooth surface.", draw_left),
    )
