"""Views displaced by cubic interpolation and averaged: float64."""

import numpy as np


def refocus(views, places, weights, slopes, *, has_variance=False):
    """Return the stage's result, see `refocus.py`."""
    views, weights = np.asarray(views, np.float64), np.asarray(weights, np.float64)
    found = []
    for slope in np.asarray(slopes, np.float64):
        shifts = slope * np.asarray(places, np.float64)
        moved = np.stack([move(view, shift) for view, shift in zip(views, shifts, strict=True)])
        mean = np.average(moved, axis=0, weights=weights)
        spread = [np.average((moved - mean) ** 2, axis=0, weights=weights)] * has_variance
        found.append(np.concatenate([mean, *spread]))
    return np.stack(found).astype(np.float32)


def move(view, shift):
    """Return planes (planes, rows, cols) at places displaced by (rows, columns)."""
    for axis, length in zip((1, 2), shift, strict=True):
        whole = int(np.floor(length))
        taps = np.arange(whole - 1, whole + 3)
        at = np.clip(np.arange(view.shape[axis])[:, None] + taps, 0, view.shape[axis] - 1)
        view = np.moveaxis(np.take(view, at, axis), axis + 1, -1) @ kernel(taps - length)
    return view


def kernel(t):
    """Return the cubic of Keys with a = -1/2 at distances t."""
    t = np.abs(t)
    inner, outer = 1 - 2.5 * t**2 + 1.5 * t**3, 2 - 4 * t + 2.5 * t**2 - 0.5 * t**3
    return np.where(t <= 1, inner, np.where(t <= 2, outer, 0))
