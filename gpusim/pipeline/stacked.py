"""Stages on raw values of stacked pixels: each layer by itself."""

from typing import Any

import numpy as np


def correct_layers(raw, *others, correct, layers, device, **constants) -> Any:
    """Return raw values corrected by a stage, each layer of stacked pixels separately.

    others: further inputs of the stage: a map of the shape of `raw`, or gains of the mosaic's positions.
    """
    if layers == 1:
        return correct(raw, *others, **constants, device=device)
    rows, cols = raw.shape
    stack = device.reshape(raw, (layers, rows // layers, cols))
    split = [_split(device, other, raw.shape, layers) for other in others]
    parts = [
        correct(
            device.part(stack, layer), *(part[layer] for part in split), **constants, device=device
        )
        for layer in range(layers)
    ]
    return device.reshape(device.stack(parts), (rows, cols))


def _split(device, other, shape, layers):
    """Return an input of a correction for each layer."""
    if other is None:
        return [None] * layers
    if not isinstance(other, device.array_type) and other.ndim == 2:
        other = device.array(np.asarray(other) != 0, np.uint8)
    if tuple(other.shape) != tuple(shape):
        return [other[layer : layer + 1] for layer in range(layers)]
    maps = device.reshape(other, (layers, shape[0] // layers, shape[1]))
    return [device.part(maps, layer) for layer in range(layers)]


def separate_layers(raw, *, correct, layers, device, **constants) -> Any:
    """Return the layers of stacked pixels as planes (C, rows, cols)."""
    rows, cols = raw.shape
    values = correct_layers(raw, correct=correct, layers=layers, device=device, **constants)
    return device.reshape(values, (layers, rows // layers, cols))
