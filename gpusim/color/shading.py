"""Shading correction: gains that compensate the fall-off of lens and sensor toward the corner."""

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.optics.geometry import lagrange_weights, relative_illumination

NODES = (2, 3, 5, 9, 17, 33, 65, 129)  # numbers of nodes to try, per axis
INTERPOLATION = 2e-4  # largest relative error of the gains between nodes


def relative_response(
    shape: tuple[int, int],
    slope: float,
    falloff: np.ndarray | None = None,
    nodes: np.ndarray | None = None,
    margin: float = 0.0,
    field: np.ndarray | None = None,
) -> np.ndarray:
    """Return the response to a uniform scene relative to the axis.

    It combines relative illumination, microlenses, the sensor's vignetting, and the spread of light
    by distortion.

    Args:
        shape: Rows and columns of the pixels.
        slope: Tangent of the field angle per pixel; 0: no cos^4 law.
        falloff: Further fall-off of every pixel, shape (rows, cols), or None.
        nodes: Nodes of a distortion, see `gpusim.optics.geometry.DistortionGrid`, or None.
        margin: Pixels around the frame that the nodes cover as well.
        field: Flat field of a blur that varies, shape (rows, cols), or None.

    Returns:
        Response, float64, shape (rows, cols).
    """
    response = np.ones(shape)
    if slope:
        response *= relative_illumination("cos4", shape, slope, 1.0)
    if falloff is not None:
        response *= falloff
    if field is not None:
        response *= field
    if nodes is not None:
        flux = nodes[..., 2]
        along_y, along_x = (
            lagrange_weights(count, (np.arange(n) + 0.5 + margin) / (n + 2 * margin))
            for count, n in zip(flux.shape, shape, strict=True)
        )
        response *= along_y @ flux @ along_x.T
    return response


def shading_gains(response: ArrayLike, channels: int, most: float = 8.0) -> np.ndarray:
    """Return gains for `processor.shade` that make a uniform scene uniform.

    They have the fewest nodes with an interpolation error of at most INTERPOLATION, or the most
    nodes in NODES.

    Args:
        response: Response to a uniform scene, of every pixel, shape (rows, cols), or of every
            channel at every pixel, shape (channels, rows, cols), in any unit. The largest value of
            each channel is not changed.
        channels: Number of channels.
        most: Largest gain [1]. If more would be necessary, a uniform scene stays darker there.

    Returns:
        Gains, float64, shape (channels, ny, nx), the smallest one 1.

    Raises:
        BadData: The response has the wrong shape.
        OutOfRange: A response or `most` is outside its range.
    """
    response = _check_response(response, most)
    if response.shape[:-2] not in ((), (channels,)):
        raise BadData(
            f"response to a flat scene: shape {response.shape}, wanted (rows, cols) or ({channels}, rows, "
            "cols)"
        )
    maps = response.reshape(-1, *response.shape[-2:])
    with np.errstate(divide="ignore"):
        maps = np.minimum(maps.max(axis=(1, 2), keepdims=True) / maps, most)
    nodes = _nodes([(map_, (0, 0)) for map_ in maps], (1, 1), maps.shape[1:])
    return np.broadcast_to(nodes, (channels, *nodes.shape[1:])).copy()


def phase_gains(
    response: ArrayLike, period: tuple[int, int], most: float = 8.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return shading gains for a mosaic with unevenly spaced pixels, for example binned ones.

    Pixels of one phase of the mosaic are evenly spaced. Each phase therefore counts as a channel,
    and all have one scale.

    Args:
        response: Response to a uniform scene of every output pixel, after binning, shape (rows,
            cols), in any unit.
        period: Rows and columns of the output's mosaic.
        most: See `shading_gains`.

    Returns:
        The gains, float64, shape (period_y period_x, ny, nx), the smallest one 1; and the mosaic of
        phases that `processor.shade` takes in place of the CFA, int32, shape (period_y, period_x).

    Raises:
        BadData: The response has the wrong shape.
        OutOfRange: A response or `most` is outside its range.
    """
    response, (down, right) = _check_response(response, most), period
    if response.ndim != 2 or response.shape[0] < down or response.shape[1] < right:
        raise BadData(
            f"response to a flat scene: shape {response.shape}, wanted (rows, cols) of at least one period "
            f"of the mosaic, {down} x {right}"
        )
    with np.errstate(divide="ignore"):
        gains = np.minimum(response.max() / response, most)
    maps = [(gains[y::down, x::right], (y, x)) for y in range(down) for x in range(right)]
    return _nodes(maps, (down, right), response.shape), np.arange(
        len(maps), dtype=np.int32
    ).reshape(down, right)


def _check_response(response: ArrayLike, most: float) -> np.ndarray:
    """Return the response as float64. Raise OutOfRange if it or `most` is out of range."""
    response = np.asarray(response, np.float64)
    if not (np.isfinite(response).all() and response.min() >= 0 and response.max() > 0):
        raise OutOfRange(
            "response to a flat scene",
            f"{response.min():.6g} .. {response.max():.6g}",
            "0 <= response < inf, and not 0 everywhere",
        )
    if not 1 <= most <= 1e4:
        raise OutOfRange("largest gain", most, "1 <= gain <= 1e4")
    return response


def _nodes(maps, steps, shape):
    """Return gains at nodes over a frame of `shape`, (maps, ny, nx).

    maps: pairs of gains and the pixel of the first one; gains are `steps` pixels apart.
    """
    for count in NODES:
        places = [np.linspace(0, size, max(min(count, size + 1), 2)) - 0.5 for size in shape]
        nodes, error = [], 0.0
        for map_, first in maps:
            values, hats = map_, []
            for place, start, step, size, pixels in zip(
                places, first, steps, map_.shape, shape, strict=True
            ):
                values = _at(values, (place - start) / step, size).T
                hats.append(_hats(len(place), pixels)[start::step])
            error = max(error, np.abs(hats[0] @ values @ hats[1].T / map_ - 1).max())
            nodes.append(values)
        if error <= INTERPOLATION:
            break
    return np.stack(nodes)


def _at(values, places, pixels):
    """Interpolate along the first axis at `places`: linear, also beyond the outermost pixels."""
    if pixels == 1:
        return np.repeat(values, len(places), axis=0)
    first = np.clip(np.floor(places).astype(int), 0, pixels - 2)
    part = (places - first)[:, None]
    return np.maximum((1 - part) * values[first] + part * values[first + 1], 0)


def _hats(count, pixels):
    """Return the linear weight of each of `count` nodes at each pixel, shape (pixels, count)."""
    place = (np.arange(pixels) + 0.5) / pixels * (count - 1)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0)
