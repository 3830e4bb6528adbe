"""Thumbnail: the mean of each block of the camera's picture, for estimates of the light.

Ports: camera (C, rows, cols) float32 -> (C, min(rows, R), min(cols, Q)) float32 in the same scale,
R and Q the requested blocks along both axes.

Block i of R has the rows floor(i rows / R) .. floor((i + 1) rows / R) - 1; columns are divided in
the same way. The rows of every column are added first, from the top, then the columns' sums, from
the left: the same float32 additions on every device.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, stage, warp_only

MOST = 2048  # blocks along one axis
CHUNK = 256  # columns that a CPU's work-item adds up: their sums stay in the nearest cache


@stage
def thumbnail(
    device: Device, camera: Array, ceiling: Array | float, *, rows: int = 48, cols: int = 64
) -> Array:
    """Return means over the pixels of each block that are below the ceiling in every channel.

    Clipped pixels would falsify the means. NaN counts as clipped.

    Args:
        camera: Camera channels, shape (C, height, width).
        ceiling: Least clipped value in the camera's scale, scalar or shape (C,).
        rows: Number of blocks along the columns; a smaller picture has one per pixel.
        cols: Number of blocks along the rows; a smaller picture has one per pixel.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Means, shape (C, min(rows, height), min(cols, width)), float32. A block that is clipped
        everywhere is NaN in every channel.

    Raises:
        BadData: Shapes do not fit.
        OutOfRange: `rows` or `cols` is not a whole number, 1 to 2048.
    """
    channels, height, width = (int(size) for size in check_inputs(camera, rows, cols))
    ceiling = np.asarray(ceiling, np.float64)
    if ceiling.shape not in ((), (channels,)):
        raise BadData(
            f"thumbnail: ceiling of shape {ceiling.shape}; wanted one number, or one for each of the "
            f"{channels} channels"
        )
    rows, cols = min(int(rows), height), min(int(cols), width)
    run = 1 if device.is_gpu else CHUNK
    sums = device.empty((channels + 1, rows, width))
    out = device.empty((channels, rows, cols))
    launch = functools.partial(
        device.launch,
        "processor.thumbnail",
        defines={"CHANNELS": channels, "RUN": run},
        group=None if device.is_gpu else (1, 1),
    )
    arrays = [device.array(camera), device.array(np.broadcast_to(ceiling, channels)), sums]
    sizes = [height, width, rows, run, *warp_only(device, channels)]
    launch("columns", (rows, -(-width // run)), *arrays, *sizes)
    launch("blocks", (rows, cols), sums, out, width, rows, cols, *warp_only(device, channels))
    return out


def check_inputs(camera, rows, cols):
    """Return the shape of the camera's picture. Raise BadData or OutOfRange as `thumbnail` does."""
    if len(camera.shape) != 3 or 0 in camera.shape:
        raise BadData(
            f"thumbnail: a picture of shape {tuple(camera.shape)}; wanted (channels, rows, cols)"
        )
    for axis, count in (("rows", rows), ("cols", cols)):
        if not (1 <= count <= MOST and count == int(count)):
            raise OutOfRange(f"thumbnail {axis}", count, f"a whole number, 1 .. {MOST}")
    return camera.shape


def cases():
    """Yield cases.

    One to six channels, blocks of unequal size, pictures smaller than the thumbnail, ceilings,
    clipped blocks.
    """
    random = np.random.default_rng(7)
    for channels, height, width, rows, cols in (
        (3, 1, 1, 48, 64),
        (3, 5, 3, 48, 64),
        (1, 50, 130, 48, 64),
        (3, 97, 515, 7, 9),
        (4, 33, 300, 5, 1),
        (6, 64, 64, 1, 3),
    ):
        camera = random.normal(0.4, 0.3, (channels, height, width)).astype(np.float32)
        for ceiling in (np.inf, 0.9, random.uniform(0.6, 1, channels).astype(np.float32)):
            name = f"{channels}x{height}x{width} to {rows}x{cols}, ceiling {np.ndim(ceiling)}-d"
            yield _case(name, {"camera": camera, "ceiling": ceiling, "rows": rows, "cols": cols})
    camera = np.full((3, 40, 40), 0.5, np.float32)
    camera[1, :10, :10] = 1.0  # a whole block clipped, in one channel
    camera[0, 25, 25], camera[2, 35, 5], camera[0, 5, 35] = np.nan, np.inf, 1e30
    inputs = {"camera": camera, "ceiling": 1.0, "rows": 4, "cols": 4}
    yield _case("a clipped block, NaN, infinity, huge", inputs)


def _case(name, inputs):
    camera, rows, cols = inputs["camera"], inputs["rows"], inputs["cols"]
    below = (camera < np.reshape(inputs["ceiling"], (-1, 1, 1))).all(0)
    values = np.where(below, camera, 0).astype(np.float64)
    additions = -(-camera.shape[1] // rows) + -(-camera.shape[2] // cols)
    # A block's mean of magnitudes is at most the largest; some block's mean is at least their mean.
    peak = max(np.abs(values.sum((1, 2)) / max(np.count_nonzero(below), 1)).max(), 1e-30)
    return Case(
        name,
        inputs,
        (additions + 1) * 2.0**-24 * 1.001 * np.abs(values).max() / peak,
        "a sum of m rows, then n columns, errs by at most (m + n) 2^-24 times the sum of magnitudes (Higham "
        "2002, 4.2), the division by half an ulp",
    )


def bench(rows, cols):
    """Return inputs: three channels, some clipped."""
    return {"camera": np.random.default_rng(7).random((3, rows, cols), np.float32), "ceiling": 0.98}
