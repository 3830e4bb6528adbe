"""out_c(y, x) = curve(codes_c(y, x)), float64."""

import numpy as np


def decode(codes, curve):
    """Codes (rows, cols, channels) or (rows, cols), curve (256,) or (65536,) -> (channels, rows, cols)."""
    from gpusim.kernels.spectral.decode import checked

    _, (_, _, channels) = checked(codes, curve)
    codes, curve = np.asarray(codes), np.asarray(curve, np.float64)
    if codes.ndim == 2:
        return curve[codes][None]
    return np.stack([curve[codes[:, :, c]] for c in range(channels)])
