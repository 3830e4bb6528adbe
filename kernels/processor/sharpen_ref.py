"""out_p(x) = rgb_p(x) + s d^3 / (d^2 + t(x)), float64; where d is not finite, rgb_p(x).

Y = sum_p w_p rgb_p, B(x) = sum_k h(k) Y(x + k) with repeated edges, d = Y - B, t = a max(B, 0) + b.
"""

import numpy as np


def sharpen(rgb, kernel, luminance, noise, *, strength):
    """Return the stage's result, see `sharpen.py`."""
    rgb, kernel = np.asarray(rgb, np.float64), np.asarray(kernel, np.float64)
    reach, (rows, cols) = len(kernel) // 2, rgb.shape[1:]
    with np.errstate(all="ignore"):
        light = np.einsum("p,pyx->yx", np.asarray(luminance, np.float64), rgb)
        wide, blurred = np.pad(light, reach, mode="edge"), np.zeros_like(light)
        for (y, x), part in np.ndenumerate(kernel):
            blurred += part * wide[y : y + rows, x : x + cols]
        detail = light - blurred
        threshold = noise[0] * np.maximum(blurred, 0) + noise[1]
        part = np.where(threshold > 0, 1 / (1 + threshold / detail**2), 1.0)
        added = strength * detail * part
    return np.where(np.isfinite(detail), rgb + added, rgb)
