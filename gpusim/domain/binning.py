"""Pixel binning: which pixels are combined, and the colour mosaic of the result."""

import numpy as np


def bin_mosaic(
    cfa_indices: np.ndarray, binning: tuple[int, int]
) -> tuple[tuple[int, int], np.ndarray]:
    """Find the distance between pixels that are combined, and the mosaic of the binned frame.

    If the mosaic consists of cells of one colour with the size of `binning` (quad-Bayer with 2 x 2,
    monochrome with any size), adjacent pixels are combined, and each cell becomes one pixel of the
    new mosaic. Otherwise the pixels of one colour are a period apart, and the mosaic stays as it
    is.

    Args:
        cfa_indices: Channel indices of one period, shape (period_y, period_x).
        binning: Rows and columns that become one.

    Returns:
        The stride along rows and columns [pixel], and the shortest period of the new mosaic, int32,
        shape (period_y, period_x).
    """
    cfa = shortest_period(cfa_indices)
    by, bx = binning
    rows, cols = np.lcm(cfa.shape, binning)
    cells = np.tile(cfa, (rows // cfa.shape[0], cols // cfa.shape[1])).reshape(
        rows // by, by, cols // bx, bx
    )
    coarse = cells[:, 0, :, 0]
    if (cells == coarse[:, None, :, None]).all():
        return (1, 1), shortest_period(coarse)
    return cfa.shape, cfa


def shortest_period(mosaic) -> np.ndarray:
    """Return the smallest corner of `mosaic` (rows, cols) that repeats to the whole, int32."""
    mosaic = np.asarray(mosaic, np.int32)
    for axis in (0, 1):
        size = mosaic.shape[axis]
        period = next(
            n
            for n in range(1, size + 1)
            if size % n == 0 and (mosaic == np.roll(mosaic, n, axis=axis)).all()
        )
        mosaic = mosaic.take(range(period), axis=axis)
    return mosaic
