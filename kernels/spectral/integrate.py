"""Spectral integration of sampled or basis content: one weighted sum over the bands per plane.

Ports: content (bands, rows, cols) float32 or float16, weights (planes, bands) float32 -> planes
(planes, rows, cols) float32. The weights contain quantum efficiency, light and quadrature
(`gpusim.data.weights`); the result has their unit times the content's. Content of float16 takes
half the memory and bus. Each sample is widened to float32 exactly before it is weighted, so the
result equals that for the same values in float32.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.memory import type_of
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only

LINES = "spectral.integrate_lines"  # the kernels of CPUs
SUMS = 2**13  # of one of their work-items: 32 KiB
TOGETHER = 4  # bands read at once: 20 GB/s on two cores of an EPYC, 13 with all 31 at once


@stage
def integrate(device: Device, content: Array, weights: Array) -> Array:
    """Return weighted sums over the bands of `content`, in one pass over it.

    Args:
        content: Samples or coefficients, shape (bands, rows, cols), float32 or float16.
        weights: Weights of the bands in each plane, shape (planes, bands).
        device: A `Device`, or its name for `open_device`.

    Returns:
        Planes, shape (planes, rows, cols), float32.

    Source:
        Farrell and Wandell, section 5.1, the sum over wavelength.
    """
    bands, rows, cols = content.shape
    is_half = type_of(content) == np.float16
    content = device.array(content, np.float16 if is_half else np.float32)
    weights = device.array(weights)
    planes = weights.shape[0]
    out = device.empty((planes, rows, cols))
    name, given = "integrate_half" if is_half else "integrate", (content, weights, out, rows * cols)
    # Bands and planes are compile-time constants: PoCL vectorises only if the inner loop is unrolled.
    defines = {"BANDS": bands, "PLANES": planes}
    if device.kind == "opencl" and device.on_host:
        chunk = max(SUMS // planes // 64, 1) * 64
        defines = {**defines, "WIDTH": 8, "CHUNK": chunk, "TOGETHER": TOGETHER}
        grid = (-(-rows * cols // chunk),)
        device.launch(LINES, name, grid, *given, group=(1,), defines=defines)
    else:
        sizes = warp_only(device, bands, planes)
        device.launch("spectral.integrate", name, (rows * cols,), *given, *sizes, defines=defines)
    return out


def cases():
    """Yield cases: odd sizes, one band, many planes, nine decades of range."""
    random = np.random.default_rng(1)
    sizes = (1, 1, 31, 3), (3, 5, 31, 3), (63, 65, 31, 4), (17, 129, 1, 1), (8, 8, 93, 8)
    for rows, cols, bands, planes in sizes:
        content = random.random((bands, rows, cols))
        content *= 10.0 ** random.integers(-3, 7, (1, rows, cols))
        weights = random.random((planes, bands)).astype(np.float32)
        name = f"{rows}x{cols}, {bands} bands, {planes} planes"
        tolerance = bands * 2.0**-24 * 2
        yield Case(
            name,
            {"content": content.astype(np.float32), "weights": weights},
            tolerance,
            metric="local",
            why="all terms are positive: a running float32 sum of n products errs by at most about n ulp/2 "
            "relative (Higham 2002, 3.1); the inputs are exact in float32",
        )
        # half of them below its smallest normal number
        small = (content * 2.0**-14).clip(0, 65504).astype(np.float16)
        yield Case(
            f"float16, {name}",
            {"content": small, "weights": weights},
            tolerance,
            metric="local",
            why="as for float32: every float16 is a float32, so the inputs are exact",
        )
    dark, ones = np.zeros((31, 4, 4), np.float32), np.ones((3, 31), np.float32)
    yield exact_case("darkness", "sums of zeros are exact", content=dark, weights=ones)
    wild = np.ones((5, 3, 4), np.float16)
    wild[2, 0, :3] = np.nan, np.inf, 2.0**-24
    yield Case(
        "float16, NaN, infinity and the smallest number",
        {"content": wild, "weights": np.full((2, 5), 0.5, np.float32)},
        2.0**-24,
        "products with a power of two are exact; of the sums only that with 2^-25 rounds, to 1",
        metric="local",
    )


def bench(rows, cols):
    """Return inputs: a 31-band cube to three channels."""
    random = np.random.default_rng(1)
    return {
        "content": random.random((31, rows, cols), np.float32),
        "weights": random.random((3, 31), np.float32),
    }


def operations(content, weights):
    """Count operations: a multiplication and an addition for each sample and plane."""
    return 2 * len(weights) * content.size
