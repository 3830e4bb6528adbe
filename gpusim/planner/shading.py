"""Gains that undo what a lens and a sensor lose toward the corner."""

import numpy as np
from scipy.interpolate import RectBivariateSpline

from gpusim.domain.errors import OutOfRange
from gpusim.planner.geometry import relative_illumination
from gpusim.planner.plan import Plan

NODES = (2, 3, 5, 9, 17, 33, 65, 129)  # tried one after the other, each way
INTERPOLATION = 2e-4  # relative error of the gains between nodes, at most


def relative_response(made: Plan) -> np.ndarray:
    """What a flat scene gives at every pixel over that on the axis, float64 (rows, cols).

    Relative illumination, microlenses, the sensor's vignetting, and how much a distortion spreads the light.
    """
    response = np.ones(made.scene.shape)
    if made.slope:
        response *= relative_illumination("cos4", made.scene.shape, made.slope, 1.0)
    if made.gain is not None:
        response *= made.gain
    if made.warp is not None:
        flux = made.warp.nodes[..., 2]
        edges = [np.linspace(0, n, m) for n, m in zip(made.scene.shape, flux.shape, strict=True)]
        response *= RectBivariateSpline(*edges, flux)(*(np.arange(n) + 0.5 for n in made.scene.shape))
    return response


def shading_gains(response, channels: int, most: float = 8.0) -> np.ndarray:
    """Gains for `processor.shade` that make a flat scene flat, float64 (channels, ny, nx), the smallest one 1.

    response: of every pixel to a flat scene, shape (rows, cols), or (channels, rows, cols) [any unit]. most: largest
    gain; where more were needed, a flat scene stays darker [1]. The fewest nodes are taken between which gains err by
    at most INTERPOLATION, or as many as there are in NODES. Raises OutOfRange.
    """
    response = np.asarray(response, np.float64)
    if not (np.isfinite(response).all() and response.min() >= 0 and response.max() > 0):
        raise OutOfRange("response to a flat scene", f"{response.min():.6g} .. {response.max():.6g}",
                         "0 <= response < inf, and not 0 everywhere")
    if not 1 <= most <= 1e4:
        raise OutOfRange("largest gain", most, "1 <= gain <= 1e4")
    maps = np.broadcast_to(response, (channels, *response.shape[-2:]))
    with np.errstate(divide="ignore"):
        maps = np.minimum(maps.max(axis=(1, 2), keepdims=True) / maps, most)
    if response.ndim == 2:
        maps = maps[:1]
    for count in NODES:
        along = [(_places(n, min(count, n + 1)), n) for n in maps.shape[1:]]
        nodes = np.stack([_at(_at(map_, *along[0]).T, *along[1]).T for map_ in maps])
        back = [_hats(len(places), n) for places, n in along]
        error = np.abs(np.einsum("yj,cji,xi->cyx", back[0], nodes, back[1], optimize=True) / maps - 1).max()
        if error <= INTERPOLATION:
            break
    return np.broadcast_to(nodes, (channels, *nodes.shape[1:])).copy()


def _places(pixels, count):
    """Where `count` nodes lie among the middles of `pixels`, which are at 0 .. pixels - 1."""
    return np.linspace(0, pixels, max(count, 2)) - 0.5


def _at(values, places, pixels):
    """Values along the first axis at `places`: linear between pixels, and on beyond the outermost."""
    if pixels == 1:
        return np.repeat(values, len(places), axis=0)
    first = np.clip(np.floor(places).astype(int), 0, pixels - 2)
    part = (places - first)[:, None]
    return np.maximum((1 - part) * values[first] + part * values[first + 1], 0)


def _hats(count, pixels):
    """Weight of each of `count` nodes at each pixel, shape (pixels, count)."""
    place = (np.arange(pixels) + 0.5) / pixels * (count - 1)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0)
