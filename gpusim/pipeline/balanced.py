"""Demosaicking on a device with channels balanced to make white equal in them, and back."""

from typing import Any

import numpy as np

from gpusim.kernels.processor.levels import MOST_BALANCE


def demosaic_balanced(raw, white, blur=None, *, demosaic, places, device, **constants) -> Any:
    """Return camera values from a demosaicker that compares channels, balanced to make white equal in them."""
    if blur is not None:
        constants = constants | {"blur": blur}
    balance = balance_of(white, places)
    if places is None or places == (0, 1, 2):
        return demosaic(raw, balance=balance, **constants, device=device)
    on_device = device.array(raw, np.uint16)
    planes = demosaic(on_device, balance=balance, **constants, device=device)
    return device.stack([device.part(planes, places.index(c)) for c in range(3)])


def filter_channels(raw, white, *, demosaic, table, channels, device, **constants) -> Any:
    """Return camera values from filters chosen on a first picture, balanced to make white equal in the channels."""
    balance = {}
    if white is not None:
        guide = float(white[channels.index(table.channels[table.guide])])
        if guide > 0:
            balance = {
                letter: guide / limit_response(float(value), guide)
                for letter, value in zip(channels, white, strict=True)
            }
    options = {"table": table, "channels": channels, "balance": balance}
    return demosaic(raw, **options, **constants, device=device)


def limit_response(value: float, reference: float) -> float:
    """Return a response to white, drawn to within MOST_BALANCE of a reference.

    This limits the gain of a channel that hardly responds to white.
    """
    return min(max(value, reference / MOST_BALANCE), reference * MOST_BALANCE)


def balance_of(white, places) -> tuple[float, float]:
    """Return the factors of red and blue that make white equal in red, green and blue.

    white: camera values of white, shape (C,), or None. places: indices of red, green and blue, or None.
    """
    if white is None or places is None:
        return 1.0, 1.0
    red, green, blue = white[list(places)].tolist()
    if not green > 0:
        return 1.0, 1.0
    return green / limit_response(red, green), green / limit_response(blue, green)
