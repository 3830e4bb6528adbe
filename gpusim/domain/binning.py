"""Which pixels binning adds, and the mosaic that is left."""

import numpy as np


def binned(cfa_indices, binning) -> tuple[tuple[int, int], np.ndarray]:
    """How far apart the pixels are that become one, and the binned frame's mosaic.

    Where the mosaic consists of cells of one colour that are `binning` large (quad-Bayer by 2 x 2, monochrome by
    anything) neighbours are adjacent, and one pixel of the binned mosaic stands for a cell. Elsewhere pixels of one
    colour are a period apart and the mosaic stays as it is.

    cfa_indices: channels of one period, shape (period_y, period_x). binning: rows and columns that become one.
    Returns the stride along rows and columns [pixel], and the mosaic's shortest period, int32 (period_y, period_x).
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
    """The smallest corner of `mosaic` (rows, cols) that repeats to it, int32."""
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
