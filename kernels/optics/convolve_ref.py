"""out(y, x) = sum_ij K[i, j] I(y + kh // 2 - i, x + kw // 2 - j): tap by tap, float64."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def convolve(planes, kernels, border="edge", precision="single"):
    """See the contract; the precision is float64 whatever is asked."""
    count, rows, cols = planes.shape
    kernels = np.broadcast_to(np.asarray(kernels, np.float64), (count, *np.shape(kernels)[1:]))
    _, kh, kw = kernels.shape
    around = np.pad(
        np.asarray(planes, np.float64), ((0, 0), (kh // 2,) * 2, (kw // 2,) * 2), mode=MODES[border]
    )
    out = np.zeros((count, rows, cols))
    for i in range(kh):
        for j in range(kw):
            out += (
                kernels[:, i, j, None, None]
                * around[:, kh - 1 - i :, kw - 1 - j :][:, :rows, :cols]
            )
    return out
