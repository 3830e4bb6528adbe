"""Blurred layers of different depth, composed: near layers hide far ones.

Ports: lights (entries, channels, rows, cols) float32, alphas (entries, channels or 1, rows, cols)
float32 [1] -> out (channels, rows, cols) float32 in the lights' unit. An entry is the part of one
layer that one kernel has spread: its light and its coverage, both blurred. The entries of a layer
add up to B_k and A_k. Layers are counted from the nearest:

    out = sum over k < last of  B_k T_k  +  (B_last / A_last) T_last,    T_k = product over nearer j of (1 - A_j).

The last layer covers everything. Its blurred coverage differs from 1 only where kernels of
different width meet. Division by it keeps an even surface even, at any slope.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def composite(
    device: Device, lights: Array, alphas: Array, layers: Sequence[int] | np.ndarray
) -> Array:
    """Compose blurred layers, the nearest on top.

    Args:
        lights: Light of each entry, multiplied by its coverage before the blur, shape (entries,
            channels, rows, cols).
        alphas: Blurred coverage [1], shape (entries, channels or 1, rows, cols). Sums of a layer
            are clipped to 0 .. 1.
        layers: Layer of each entry, counted from the nearest, shape (entries,), not decreasing.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Light of the composed layers, shape (channels, rows, cols), float32.

    Raises:
        BadData: `layers` has another length or decreases.

    Source:
        Porter and Duff, SIGGRAPH 1984 (the operator "over").
    """
    count, channels, rows, cols = lights.shape
    layers = checked_layers(layers, count)
    # the last layer is laid down after the loop
    ends = np.append(layers[1:] != layers[:-1], False).astype(np.float32)
    lights, alphas = device.array(lights), device.array(alphas)
    own = int(alphas.shape[1] > 1)
    out = device.empty((channels, rows, cols))
    arrays = [lights, alphas, device.array(ends), out]
    defines = {"ENTRIES": count}
    sizes = [own, *warp_only(device, count, cols), channels, rows * cols]
    device.launch(
        "optics.composite", "composite", (channels, rows * cols), *arrays, *sizes, defines=defines
    )
    return out


def checked_layers(layers, count) -> np.ndarray:
    """Return `layers` as an array of `count` integers. Raise BadData if they decrease."""
    layers = np.asarray(layers)
    if layers.shape != (count,) or not count or (np.diff(layers) < 0).any():
        raise BadData(
            f"layers {layers.tolist()}: wanted {count} that do not decrease, one for each entry"
        )
    return layers


def cases():
    """Yield cases: one layer, several of one and of more entries, shared and own coverage."""
    random = np.random.default_rng(12)
    for layers, channels, own, rows, cols in (
        ((0,), 1, 0, 1, 1),
        ((0, 0, 0), 3, 0, 3, 5),
        ((0, 1), 3, 1, 63, 65),
        ((0, 0, 1, 1, 1, 2), 4, 1, 33, 7),
        ((0, 1, 2, 3, 3, 3, 3, 4), 2, 0, 5, 200),
    ):
        shares = np.bincount(layers)[list(layers)][:, None, None, None]
        alphas = random.random((len(layers), channels if own else 1, rows, cols)) / shares
        last = np.array(layers) == layers[-1]
        # 0.5 .. 1.5 in all: it covers everything
        alphas[last] = (0.5 + alphas[last] * shares[last]) / shares[last]
        lights = 10.0 ** random.uniform(-3, 4, (len(layers), channels, rows, cols))
        bound = 2 * 4 * len(layers) * 2.0**-24 * lights.sum(axis=0).max()
        inputs = {
            "lights": lights.astype(np.float32),
            "alphas": alphas.astype(np.float32),
            "layers": layers,
        }
        yield Case(
            f"{rows}x{cols}, layers {layers}, {channels} channels, {'own' if own else 'shared'} coverage",
            inputs,
            bound,
            "at most 4 roundings of half an ulp an entry, of products below the sum of the lights; the division "
            "by a coverage of at least 0.5 doubles them",
            metric="exact",
        )


def bench(rows, cols):
    """Return inputs: three layers of three kernels each, three channels."""
    random = np.random.default_rng(12)
    return {
        "lights": random.random((9, 3, rows, cols), np.float32),
        "alphas": random.random((9, 3, rows, cols), np.float32) / 3,
        "layers": (0, 0, 0, 1, 1, 1, 2, 2, 2),
    }
