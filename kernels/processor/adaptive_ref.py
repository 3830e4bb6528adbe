"""Gradient-adaptive demosaicking, float64: Hamilton-Adams with soft weights, on square roots.

c = sgn(x) sqrt|x| (domain "root") or c = x ("linear"), with x = DN - black_level. Green at a red or
blue pixel, along each axis (Hamilton and Adams 1997, US patent 5629734, expired):

    g = (c[-1] + c[1]) / 2 + (2 c[0] - c[-2] - c[2]) / 4    s = |c[-1] - c[1]| + |2 c[0] - c[-2] - c[2]|

and G = sum g / (s^2 + t^2) / sum 1 / (s^2 + t^2); the original takes the g with the smaller s. Red
and blue are G plus the colour difference d = c - G of the neighbours, first across the diagonals,
then along the axes. Each step mixes two pairs (p, q), (r, s) of opposite neighbours with weights 1
/ (|p - q| + t), 1 / (|r - s| + t). `balance` multiplies x of red and blue first, and divides their
results.
"""

import numpy as np

from gpusim.kernels.processor.bilinear_ref import bilinear


def adaptive(
    raw, *, phase, black_level, scale, domain="root", threshold=0.0175, balance=(1.0, 1.0)
):
    """Return the stage's result, see `adaptive.py`."""
    if 1 in raw.shape:
        return bilinear(raw, phase=phase, black_level=black_level, scale=scale)
    encode, decode = CODES[domain]
    t = threshold * encode(1 / scale)
    rows, cols = raw.shape
    signal = np.asarray(raw, np.float64) - black_level
    letters = np.array(list(phase))[
        np.add.outer(2 * (np.arange(-2, rows + 2) % 2), np.arange(-2, cols + 2) % 2)
    ]
    factors = dict(zip("RGB", encode(np.array((balance[0], 1.0, balance[1]))), strict=True))
    c = np.pad(encode(signal), 2, mode="reflect") * np.vectorize(factors.get)(letters)

    here = _views(c, 2)
    guesses, weights = [], []
    for dy, dx in ((0, 1), (1, 0)):
        before, after = here(-dy, -dx), here(dy, dx)
        bend = 2 * here(0, 0) - here(-2 * dy, -2 * dx) - here(2 * dy, 2 * dx)
        guesses.append((before + after) / 2 + bend / 4)
        weights.append(1 / ((np.abs(before - after) + np.abs(bend)) ** 2 + t**2))
    green = np.average(guesses, axis=0, weights=weights)
    green = np.where(letters[2:-2, 2:-2] == "G", here(0, 0), green)

    difference = c - np.pad(green, 2, mode="reflect")
    planes = {"G": green}
    for color in "RB":
        # on the frame and a rim of one pixel, which the second step needs
        near = _views(difference, 1)
        diagonal = _blend(near(-1, -1), near(1, 1), near(-1, 1), near(1, -1), t)
        near = _views(np.where(letters[1:-1, 1:-1] == color, near(0, 0), diagonal), 1)
        axial = _blend(near(0, -1), near(0, 1), near(-1, 0), near(1, 0), t)
        planes[color] = green + np.where(letters[2:-2, 2:-2] == "G", axial, near(0, 0))
    return (
        np.stack(
            [
                np.where(
                    letters[2:-2, 2:-2] == color, signal, decode(planes[color] / factors[color])
                )
                for color in "RGB"
            ]
        )
        * scale
    )


CODES = {
    "root": (lambda x: np.sign(x) * np.sqrt(np.abs(x)), lambda y: y * np.abs(y)),
    "linear": (lambda x: x, lambda y: y),
}


def _views(plane, rim):
    """Return the function (dy, dx) -> the plane without its rim, moved by (dy, dx) pixels."""
    rows, cols = plane.shape
    return lambda dy, dx: plane[rim + dy : rows - rim + dy, rim + dx : cols - rim + dx]


def _blend(p, q, r, s, t):
    """Return the mean of two pairs; the pair that agrees better weighs more."""
    return np.average(
        [(p + q) / 2, (r + s) / 2],
        axis=0,
        weights=[1 / (np.abs(p - q) + t), 1 / (np.abs(r - s) + t)],
    )
