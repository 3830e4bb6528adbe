"""Fall-off of the light over the frame, from even light through the lens."""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData
from gpusim.fit.estimate import Estimate, Part, Plot
from gpusim.fit.falloff import Falloff, fit_falloff, frame_corners
from gpusim.fit.planes import (
    block_places,
    channel_blocks,
    checked_frames,
    clipped_mask,
    field_place,
    light_values,
    main_channel,
)
from gpusim.io.raw.raw_frame import RawFrame

BLOCKS = 64  # blocks on the longer side of the frame
ROUND = 0.0015  # most by which a round fall-off may miss the map, or twice the map's own error
COLOURED = 0.005  # difference of channels that is worth a line
HEIGHTS = np.linspace(0, 1, 21)
FLOOR = 4e-4  # relative error of the models themselves in the corners
MISSED = 0.002  # by which parts of the frame may miss the surface
NODES = 33  # of a map over the longer side
MOST_CLIPPED = 1e-3


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
        letter: _surface(plane, block_places(every[0], letter, block), shape, name)
        for letter, plane in zip(every[0].channels, total, strict=True)
    }


def _surface(plane, places, shape, name):
    """Return the smooth surface of one channel's blocks."""
    found = fit_falloff(plane, *places, shape)
    if found is None:
        raise BadData(
            f"{name}: {plane.shape[1]} x {plane.shape[0]} blocks, too few; use a larger frame"
        )
    rows, cols, _ = zip(*frame_corners(shape), strict=True)
    if not (found.at(np.array(rows), np.array(cols), shape) > 0.02).all():
        raise BadData(f"{name}: no even light, a corner is dark; shoot a flat that fills the frame")
    if (spread := np.nanstd(found.left)) > 0.05:
        raise BadData(
            f"{name}: no even light, blocks differ by {100 * spread:.2g} % from a smooth surface; shoot a white wall "
            "out of focus or a diffuser"
        )
    return found


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
        for (row, col, words), error in zip(frame_corners(shape), own.error, strict=True):
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
        if own.miss > MISSED:
            lines.append(
                f"shading of {letter}: part of the frame misses the surface by {100 * own.miss:.2g} % on average, "
                "and single places by more (a kink in the fall-off, shadows, texture)"
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
