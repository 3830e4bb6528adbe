"""Display encoding: linear RGB to 8-bit sRGB codes.

Ports: rgb (3, rows, cols) float32, linear, white = 1 -> codes (rows, cols, 3) uint8.

The code of a value is the number of thresholds at or below it, threshold k being the linear value of code k - 1/2. So
the devices need no power function and agree with the float64 formula bit for bit. The curve is nowhere steeper than
12.92 * 255 = 3295 codes per unit, so none of 4096 equal bins holds two thresholds. An entry of the table holds what is
needed in its bin, in one word: the code below the threshold (8 bits) and where in the bin the threshold is, in 2^-24 of
the bin. That is exact: a float32 at or above 2^-12 is a multiple of 2^-23 bins, and the one threshold below is known.
"""

import functools

import numpy as np

from gpusim.kernels.stage import Case, stage

BINS = 4096


@stage
def srgb(device, rgb):
    """IEC 61966-2-1 codes, rounded to nearest; values outside 0 .. 1 are clipped and NaN is black.

    rgb: shape (3, rows, cols), linear. Returns shape (rows, cols, 3), uint8.
    Source: IEC 61966-2-1:1999, section 5.2.
    """
    _, rows, cols = rgb.shape
    out = device.empty((rows, cols, 3), np.uint8)
    run = 1 if device.is_gpu else 2048  # a GPU wants many small items, LLVM a loop to vectorise
    device.launch("display.srgb", "srgb", (-(-rows * cols // run),), device.array(rgb), _table(device), out,
                  run, rows * cols, group=None if device.is_gpu else (1,))
    return out


def thresholds():
    """The smallest float32 with code 1, 2, ... 255: the inverse curve at k - 1/2, rounded up."""
    encoded = (np.arange(1, 256) - 0.5) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    nearest = linear.astype(np.float32)
    return np.where(nearest < linear, np.nextafter(nearest, np.float32(np.inf)), nearest)


@functools.cache
def _table(device):
    """Per bin: place of the threshold in it [2^-24 bin] times 256, plus the code below that threshold."""
    edges = thresholds()
    start = np.arange(BINS + 1) / BINS
    below = np.searchsorted(edges, start)  # number of thresholds before the bin
    following = np.append(edges.astype(float), 2.0)[below]
    place = np.minimum((following - start) * BINS * 2**24, 2**24 - 1)  # the last place is never reached: no threshold
    return device.array(place.astype(np.uint32) * 256 + below.astype(np.uint32), np.uint32)


def cases():
    """A fine grid, every rounding boundary, HDR, negative, NaN, infinities; odd sizes."""
    why = "the code is a count of exact comparisons: bit for bit"
    random = np.random.default_rng(6)
    for rows, cols in ((1, 1), (2, 2), (3, 5), (63, 65)):
        rgb = random.uniform(-0.2, 1.3, (3, rows, cols)).astype(np.float32)
        yield Case(f"{rows}x{cols}", {"rgb": rgb}, 0.0, why, metric="exact")
    grid = (np.arange(3 * 2**16) / (3 * 2**16 - 1)).astype(np.float32).reshape(3, 256, 256)
    yield Case("grid", {"rgb": grid}, 0.0, why, metric="exact")
    edges = thresholds()
    near = np.stack([np.nextafter(edges, np.float32(0)), edges, np.nextafter(edges, np.float32(2))])
    yield Case("one step around every boundary", {"rgb": near[:, None]}, 0.0, why, metric="exact")
    odd = np.array([np.nan, np.inf, -np.inf, -0.0, 1e30, -1e30, 1e-45, 1.0, np.nextafter(np.float32(1), 0)], np.float32)
    yield Case("NaN, infinities, extremes", {"rgb": odd.reshape(3, 1, 3)}, 0.0, why, metric="exact")


def bench(rows, cols):
    """A full range of values."""
    return {"rgb": np.random.default_rng(6).random((3, rows, cols), np.float32)}
