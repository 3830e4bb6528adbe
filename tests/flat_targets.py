"""Flats and ramps as random cameras see them, in plain NumPy: shares no code with gpusim's fit."""

import numpy as np


def falloff(rng, shape, is_round=True):
    """Response to even light, 1 in the middle: cos^4 with a lens's own curve, off the middle unless it is round."""
    rows, cols = shape
    y, x = np.indices(shape)
    cy, cx = (rows - 1) / 2, (cols - 1) / 2
    if not is_round:
        cy, cx = cy + rng.normal(0, 0.03) * rows, cx + rng.normal(0, 0.03) * cols
    h = np.hypot(y - cy, x - cx) / (np.hypot(rows, cols) / 2)
    slope, own = rng.uniform(0.2, 0.75), rng.uniform(-0.15, 0.05)
    seen = 1 / (1 + (slope * h) ** 2) ** 2 * (1 + own * h**2 + rng.uniform(-0.1, 0.05) * h**6)
    if not is_round:
        seen = seen * (1 + rng.normal(0, 0.02) * (x / cols - 0.5))
    return seen / seen[rows // 2, cols // 2]


def through_mosaic(pictures, cfa):
    """Pixels behind their filters, each with a share of the light. pictures: of each channel by letter."""
    shares = {"R": 0.6, "B": 0.5, "C": 0.8, "M": 0.7}
    shape = next(iter(pictures.values())).shape
    period = np.array([list(row) for row in cfa])
    letters = np.tile(period, [n // m + 1 for n, m in zip(shape, period.shape, strict=True)])
    letters = letters[: shape[0], : shape[1]]
    return sum(
        np.where(letters == one, shares.get(one, 1.0) * picture, 0)
        for one, picture in pictures.items()
    )


def expose_flat(rng, response, electrons=6000, black=64, gain=0.25, prnu=0.008):
    """Raw values [DN] with shot and read noise and uneven pixels."""
    seen = electrons * response * (1 + rng.normal(0, prnu, response.shape))
    return np.rint((rng.poisson(seen) + rng.normal(0, 3, response.shape)) * gain + black)


def encode(linear):
    """sRGB's curve, IEC 61966-2-1."""
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )


def tone(rng):
    """A rising curve from encoded light to displayed codes, both 0 to 1."""
    power, mix = rng.uniform(1.2, 2.0), rng.uniform(0, 0.8)

    def curve(x):
        s = x**power / (x**power + (1 - x) ** power + 1e-12)
        return (1 - mix) * x + mix * s

    return curve
