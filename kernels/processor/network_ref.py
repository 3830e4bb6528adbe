"""Demosaicking and denoising by a small network, float64.

Samples above black are x = (DN - black_level) scale. In the domain "root" their codes are

    c = sqrt(b) sgn(s) sqrt|s|,   s = x + o,   o = 3/8 g + r^2 / g,

b the balance of their colour, (g, r) gain and read noise on the scale of x; their noise is sqrt(b g) / 2 everywhere
(Anscombe 1948). In "linear" c = x. The first guess of each colour is its own samples' codes, and elsewhere the mean of
the samples up to 3 pixels away with Gaussian weights. Layers of 3 x 3 convolutions act on blocks of 2 x 2 pixels, whose
values are channels:

    v = relu(W1 * (guess, masks, noise)),   v <- relu(v + Wk * v),   guess + Wn * v,

decoded to x. As far as the layers reach, Bayer mosaics are mirrored at borders, and others repeat their outermost
period.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gpusim.io.camera.network import built_in_network


def continue_axis(n, period, margin):
    """Return the pixels in place of -margin .. n + margin; n is rounded up to even."""
    pixels, more = np.arange(n), (margin, margin + n % 2)
    if period <= 2:
        return np.pad(pixels, more, mode="reflect")
    before, after = (
        np.tile(part, -(-margin // period) + 1) for part in (pixels[:period], pixels[-period:])
    )
    return np.concatenate([before[-margin:], pixels, after[: more[1]]])


def network(
    raw,
    *,
    cfa,
    black_level,
    scale,
    domain="root",
    noise=(0.0, 0.0),
    balance=(1.0, 1.0),
    weights=None,
    half=False,  # not here
):
    """Return the stage's result, see `network.py`."""
    trained = built_in_network() if weights is None else weights
    rows, cols = raw.shape
    layers = len(trained.weights)
    margin = 2 * layers  # of the layers [pixel]; 3 more of the guess
    here = np.ix_(
        *(
            continue_axis(n, period, margin + 3)
            for n, period in zip(raw.shape, (len(cfa), len(cfa[0])), strict=True)
        )
    )
    letters = np.array([list(row) for row in cfa])
    color = letters[here[0] % len(cfa), here[1] % len(cfa[0])]
    gain, read = np.array(noise) * scale
    gain = max(gain, read / 20)
    offset = 0.375 * gain + (read**2 / gain if gain else 0.0)
    factors = dict(zip("RGB", (balance[0], 1.0, balance[1]), strict=True))
    factor = np.vectorize(factors.get)(color)
    level = (np.asarray(raw, np.float64)[here] - black_level) * scale
    code, sigma = level, np.zeros_like(level)
    if domain == "root":
        level = level + offset
        code = np.sqrt(factor) * np.sign(level) * np.sqrt(abs(level))
        sigma = np.sqrt(factor * gain) / 2

    window = np.exp(-0.5 * (np.arange(-3, 4) / 0.8) ** 2)

    def spread(plane):
        return np.einsum("yxij,i,j->yx", sliding_window_view(plane, (7, 7)), window, window)

    inner = np.s_[3:-3, 3:-3]
    masks = np.stack([color == letter for letter in "RGB"]).astype(float)
    guess = np.stack(
        [
            np.where(mask[inner] > 0, code[inner], spread(mask * code) / spread(mask))
            for mask in masks
        ]
    )

    def pack(planes):
        blocks = np.stack([planes[:, dy::2, dx::2] for dy in (0, 1) for dx in (0, 1)], 1)
        return blocks.reshape(-1, *blocks.shape[2:])

    values = np.concatenate([pack(guess), pack(masks[:, *inner]), pack(sigma[None][:, *inner])])
    for number, (weight, bias) in enumerate(zip(trained.weights, trained.biases, strict=True)):
        windows = sliding_window_view(values, (3, 3), axis=(1, 2))
        found = np.tensordot(weight.astype(float), windows, ((1, 2, 3), (0, 3, 4)))
        found += bias[:, None, None]
        if number == layers - 1:
            values = found
        elif number == 0:
            values = np.maximum(found, 0)
        else:
            values = np.maximum(values[:, 1:-1, 1:-1] + found, 0)
    blocks = values.reshape(3, 2, 2, *values.shape[1:])
    added = blocks.transpose(0, 3, 1, 4, 2).reshape(3, 2 * blocks.shape[3], -1)
    result = (guess[:, margin : margin + rows, margin : margin + cols]) + added[:, :rows, :cols]
    if domain == "linear":
        return result
    result = result / np.sqrt([factors[letter] for letter in "RGB"])[:, None, None]
    return result * abs(result) - offset
