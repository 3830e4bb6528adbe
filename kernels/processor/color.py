"""Colour transform: camera channels to linear display RGB by one matrix.

Ports: camera (C, rows, cols) float32, matrix (3, C) -> rgb (3, rows, cols) float32, linear, display
white = 1.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def color(device: Device, camera: Array, matrix: Array, *, ceiling: Array | None = None) -> Array:
    """Multiply the channels of every pixel by a matrix, which includes white balance.

    The result is not clipped (display.encode does so): colours outside the display's gamut stay
    negative or above 1. NaN stays NaN.

    Args:
        camera: Camera channels [1], shape (C, rows, cols).
        matrix: Colour matrix, shape (3, C), see `gpusim.color.color`.
        ceiling: Shape (C,) [1], or None. Camera values above it are clipped first. With the
            camera's response to white, scaled to the saturation level in its largest entry, clipped
            highlights become white instead of the balance's tint.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear display RGB, display white = 1, shape (3, rows, cols), float32.

    Raises:
        BadData: The shapes do not fit.

    Source:
        Farrell and Wandell, section 6.2.
    """
    channels, rows, cols = camera.shape
    ceiling = np.full(channels, np.inf) if ceiling is None else np.asarray(ceiling)
    if tuple(matrix.shape) != (3, channels) or ceiling.shape != (channels,):
        raise BadData(
            f"color: matrix {tuple(matrix.shape)} and ceiling {ceiling.shape} do not match "
            f"{channels} channels; wanted (3, {channels}) and ({channels},)"
        )
    out = device.empty((3, rows, cols))
    run = 1 if device.is_gpu else 2048  # a GPU wants many small items, LLVM a loop to vectorise
    arrays = [device.array(camera), device.array(matrix), device.array(ceiling), out]
    defines = {"CHANNELS": channels}
    sizes = [run, rows * cols, *warp_only(device, channels)]
    group = None if device.is_gpu else (1,)
    grid = (-(-rows * cols // run),)
    device.launch("processor.color", "color", grid, *arrays, *sizes, defines=defines, group=group)
    return out


def cases():
    """Yield cases.

    One to six channels, negative entries, values above 1, ceilings, infinities and NaN.
    """
    random = np.random.default_rng(5)
    sizes = (3, 1, 1), (3, 3, 5), (3, 63, 65), (1, 2, 2), (4, 17, 9), (6, 8, 31)
    for channels, rows, cols in sizes:
        camera = random.random((channels, rows, cols))
        camera *= 10.0 ** random.uniform(-3, 3, (1, rows, cols))
        camera = camera.astype(np.float32)
        matrix = random.normal(0, 1, (3, channels)).astype(np.float32)
        for ceiling in (None, random.uniform(0.5, 1, channels).astype(np.float32)):
            clipped = camera if ceiling is None else np.minimum(camera, ceiling[:, None, None])
            terms = np.einsum("pc,cyx->pyx", np.abs(matrix).astype(float), np.abs(clipped)).max()
            peak = np.abs(np.einsum("pc,cyx->pyx", matrix.astype(float), clipped)).max()
            yield Case(
                f"{channels} channels, {rows}x{cols}, ceiling {ceiling is not None}",
                {"camera": camera, "matrix": matrix, "ceiling": ceiling},
                channels * 2.0**-24 * 1.001 * terms / peak,
                "a dot product of n terms errs by at most n 2^-24 sum |terms| (Higham 2002, 3.1); the bound is "
                "relative to the peak of the result",
            )
    camera = np.ones((3, 2, 2), np.float32)
    camera[0, 0], camera[1, 1] = (np.nan, np.inf), 1e30
    yield Case(
        "NaN, infinity, huge",
        {"camera": camera, "matrix": np.eye(3, dtype=np.float32) + 1},
        3 * 2.0**-24,
        "as above, all terms positive; NaN and infinity must stay in their pixels",
    )


def bench(rows, cols):
    """Return inputs: three channels."""
    random = np.random.default_rng(5)
    return {
        "camera": random.random((3, rows, cols), np.float32),
        "matrix": random.random((3, 3), np.float32),
    }


def operations(camera, matrix):
    """Count operations: nine multiplications and six additions for each pixel."""
    return 5 * camera.size
