"""e(y, x) = sum_k mix[c, k] (tile_k * kernel_ck)(y, x), circular, tile by tile, float64."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def tiles(planes, tables, mix, cfa, border, side, overlap, margin=0):
    """Return the stage's result; every channel is made in full, and then sampled."""
    _, rows, cols = planes.shape
    mix, valid = np.asarray(mix, np.float64), side - 2 * overlap
    shape = [n - 2 * margin for n in (rows, cols)]
    more = side + abs(margin)
    world = np.pad(
        np.asarray(planes, np.float64), [(0, 0), (more, more), (more, more)], mode=MODES[border]
    )
    at = np.minimum(np.arange(side), side - np.arange(side))  # the quarter table at |frequency|
    transfer = mix[..., None, None] * np.asarray(tables, np.float64)[:, :, at[:, None], at]
    channels = np.empty((len(mix), *shape))
    for y in range(0, shape[0], valid):
        for x in range(0, shape[1], valid):
            top, left = y + margin - overlap + more, x + margin - overlap + more
            tile = world[:, top : top + side, left : left + side]
            spectrum = (transfer * np.fft.fft2(tile)).sum(axis=1)
            blurred = np.fft.ifft2(spectrum).real[
                :, overlap : overlap + valid, overlap : overlap + valid
            ]
            channels[:, y : y + valid, x : x + valid] = blurred[:, : shape[0] - y, : shape[1] - x]
    if cfa is None:
        return channels
    y, x = np.indices(shape)
    return np.take_along_axis(channels, np.asarray(cfa)[y % len(cfa), x % len(cfa[0])][None], 0)[0]
