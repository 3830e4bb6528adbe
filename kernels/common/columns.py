"""Convolution with float64 sums on OpenCL CPUs: transforms along columns, products along rows (columns.cl).

Source: overlap-save, Oppenheim and Schafer, Discrete-Time Signal Processing, 8.7; transforms after Stockham.
"""

import functools

import numpy as np

AHEAD = 64  # columns made at a time


def convolve(device, shape, flipped, surrounded):
    """Planes of `shape` convolved with kernels that are turned around, as an array of the device.

    flipped: shape (1 or planes, kh, kw), float64. surrounded: function of the places of the frame's corner and the
    size, (rows, cols) each, that gives the planes with their surroundings. Returns shape (planes, rows, cols), float32.
    """
    count, rows, cols = shape
    _, kh, kw = flipped.shape
    length = transform_length(kh)
    valid = length - kh + 1
    strips = -(-rows // valid)
    kept = -(-(kw - 1) // 8) * 8
    # each work-item has two parts of a strip; four of them per core are enough to share the work
    parts = max(1, min(cols // 256, -(-4 * device.cl_device.max_compute_units // strips)))
    width = -(-cols // (2 * parts))
    reach = 2 * width * parts - width + -(-width // AHEAD) * AHEAD + kept
    extended = surrounded((kh // 2, kw // 2), (valid * (strips - 1) + length, reach))
    transfer = np.conj(np.fft.fft(flipped, length, axis=1)) / length
    transfer = device.array(np.ascontiguousarray(transfer).view(np.float64), np.float64)
    pitch = (
        AHEAD + kept + 8
    )  # not a power of two: the rows of a column would share the cache's sets
    passes = -(-(length.bit_length() - 1) // 2)
    defines = {"LENGTH": length, "PITCH": pitch, "ODD": passes % 2, "AHEAD": AHEAD}
    scratch = device.empty((strips, parts, 2, length, pitch), np.float64)
    out = device.empty(shape)
    for k in range(count):
        device.launch(
            "common.columns",
            "columns",
            (strips, parts),
            extended,
            transfer,
            _roots(device, length),
            scratch,
            out,
            k,
            int(len(flipped) > 1),
            valid,
            width,
            kept,
            parts,
            kw,
            rows,
            cols,
            *extended.shape[1:],
            group=(1, 1),
            defines=defines,
        )
    return out


def transform_length(taps):
    """Rows of a transform: a power of two of four kernels or more, a quarter of which overlaps."""
    return 1 << (max(64, 4 * taps) - 1).bit_length()


@functools.cache
def _roots(device, length):
    roots = np.exp(-2j * np.pi * np.arange(length) / length)
    return device.array(roots.view(np.float64), np.float64)
