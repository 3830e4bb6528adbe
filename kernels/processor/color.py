"""Colour transform: camera channels to linear display RGB by one matrix, also of their roots.

Ports: camera (C, rows, cols) float32, matrix (3, F) -> rgb (3, rows, cols) float32, linear, display
white = 1.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, stage, warp_only

ROOT_TERMS = (6, 13)  # terms up to square roots, and up to cube roots


@stage
def color(device: Device, camera: Array, matrix: Array, *, ceiling: Array | None = None) -> Array:
    """Multiply the channels of every pixel, or their terms, by a matrix with white balance.

    The result is not clipped (display.encode does so): colours outside the display's gamut stay
    negative or above 1. NaN stays NaN.

    Args:
        camera: Camera channels [1], shape (C, rows, cols).
        matrix: Colour matrix, shape (3, C), see `gpusim.color.color`. Three channels r, g, b may have
            6 columns, for r, g, b, sqrt(rg), sqrt(gb), sqrt(rb), or 13: also the cube roots of rgg,
            gbb, rbb, rrg, ggb, rrb, rgb. Negative values, which noise makes, count as 0 in roots and
            as they are in the linear terms, so that the result is continuous.
        ceiling: Shape (C,) [1], or None. Camera values above it are clipped first. With the
            camera's response to white, scaled to the saturation level in its largest entry, clipped
            highlights become white instead of the balance's tint.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear display RGB, display white = 1, shape (3, rows, cols), float32.

    Raises:
        BadData: The shapes do not fit.

    Source:
        Farrell and Wandell, section 6.2; Finlayson, Mackiewicz & Hurlbert 2015, IEEE Trans. Image
        Processing 24, 1460-1470 (roots).
    """
    channels, rows, cols = camera.shape
    ceiling = np.full(channels, np.inf) if ceiling is None else np.asarray(ceiling)
    terms = matrix.shape[1] if len(matrix.shape) == 2 else 0
    known = {channels, *ROOT_TERMS} if channels == 3 else {channels}
    if tuple(matrix.shape) != (3, terms) or terms not in known or ceiling.shape != (channels,):
        raise BadData(
            f"color: matrix {tuple(matrix.shape)} and ceiling {ceiling.shape} do not match "
            f"{channels} channels; wanted (3, {' or '.join(map(str, sorted(known)))}) and ({channels},)"
        )
    out = device.empty((3, rows, cols))
    run = 1 if device.is_gpu else 2048  # a GPU wants many small items, LLVM a loop to vectorise
    arrays = [device.array(camera), device.array(matrix), device.array(ceiling), out]
    name, count = ("color", channels) if terms == channels else ("root_color", terms)
    defines = {"CHANNELS": channels, "TERMS": terms}
    sizes = [run, rows * cols, *warp_only(device, count)]
    group = None if device.is_gpu else (1,)
    grid = (-(-rows * cols // run),)
    device.launch("processor.color", name, grid, *arrays, *sizes, defines=defines, group=group)
    return out


def cases():
    """Yield cases.

    One to six channels, negative entries, values above 1, ceilings, infinities and NaN, roots.
    """
    yield from _root_cases()
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


def _root_cases():
    """Yield cases of root-polynomial terms, also of negative values, zeros, NaN and huge values."""
    from gpusim.kernels.processor.color_ref import color

    random = np.random.default_rng(8)
    for terms, rows, cols in ((6, 1, 1), (6, 63, 65), (13, 3, 5), (13, 33, 130)):
        camera = random.normal(0.3, 0.4, (3, rows, cols)).astype(np.float32)
        camera[:, 1::7, ::3] = 0
        camera[0, -1, -1] = 1e-30
        matrix = random.normal(0, 1, (3, terms)).astype(np.float32)
        for ceiling in (None, random.uniform(0.5, 1, 3).astype(np.float32)):
            inputs = {"camera": camera, "matrix": matrix, "ceiling": ceiling}
            clipped = camera if ceiling is None else np.minimum(camera, ceiling[:, None, None])
            peak = np.abs(color(clipped, matrix)).max()
            # an upper bound: roots of negative values are 0, not those of their magnitudes
            largest = color(np.abs(clipped), np.abs(matrix)).max()
            yield Case(
                f"{terms} terms, {rows}x{cols}, ceiling {ceiling is not None}",
                inputs,
                (terms + 14) * 2.0**-24 * 1.001 * largest / peak,
                "a dot product of n terms as above; a term is the product of three roots, each within 2 ulp "
                "(OpenCL C, 7.4), 4 times 2^-24, and of two roundings",
            )
    camera = np.ones((3, 2, 2), np.float32)
    camera[0, 0], camera[:, 1, 1] = (np.nan, np.inf), 1e30
    for terms in ROOT_TERMS:
        yield Case(
            f"{terms} terms, NaN, infinity, huge",
            {"camera": camera, "matrix": np.ones((3, terms), np.float32)},
            (terms + 14) * 2.0**-24,
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
    """Count operations: the multiplications and additions of the three sums of each pixel."""
    return 3 * (2 * matrix.shape[1] - 1) * camera[0].size
