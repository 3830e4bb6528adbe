"""Spectral integration of sampled or basis content: planes = W . content, one weighted sum over bands per plane.

Ports: content (bands, rows, cols) float32, weights (planes, bands) float32 -> planes (planes, rows, cols) float32.
The weights carry quantum efficiency, light and quadrature (`gpusim.planner.weights`), so the unit of the result is
theirs times the content's.
"""

import numpy as np

from gpusim.kernels.stage import Case, stage


@stage
def integrate(device, content, weights):
    """Weighted sums over the bands of `content`, computed in one pass over it.

    content: shape (bands, rows, cols). weights: shape (planes, bands).
    Returns shape (planes, rows, cols). Source: Farrell & Wandell, section 5.1, the sum over wavelength.
    """
    bands, rows, cols = content.shape
    content, weights = device.array(content), device.array(weights)
    planes = weights.shape[0]
    out = device.empty((planes, rows, cols))
    # Bands and planes are compile-time constants: an inner loop that is not unrolled stops PoCL from vectorising.
    device.launch("spectral.integrate", "integrate", (rows * cols,), content, weights, out, rows * cols,
                  *(() if device.kind == "opencl" else (bands, planes)),
                  defines={"BANDS": bands, "PLANES": planes})
    return out


def cases():
    """Odd sizes, one band, many planes, nine decades of range."""
    random = np.random.default_rng(1)
    for rows, cols, bands, planes in ((1, 1, 31, 3), (3, 5, 31, 3), (63, 65, 31, 4), (17, 129, 1, 1), (8, 8, 93, 8)):
        content = random.random((bands, rows, cols)) * 10.0 ** random.integers(-3, 7, (1, rows, cols))
        weights = random.random((planes, bands))
        yield Case(f"{rows}x{cols}, {bands} bands, {planes} planes",
                   {"content": content.astype(np.float32), "weights": weights.astype(np.float32)},
                   bands * 2.0**-24 * 2, metric="local",
                   why="all terms are positive: a running float32 sum of n products errs by at most about n ulp/2 "
                       "relative (Higham 2002, 3.1); the inputs are exact in float32")
    yield Case("darkness", {"content": np.zeros((31, 4, 4), np.float32), "weights": np.ones((3, 31), np.float32)}, 0.0,
               "sums of zeros are exact", metric="exact")


def bench(rows, cols):
    """A 31-band cube to three channels."""
    random = np.random.default_rng(1)
    return {"content": random.random((31, rows, cols), np.float32), "weights": random.random((3, 31), np.float32)}
