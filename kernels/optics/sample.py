"""Pixels from a finer grid: each is a weighted sum of samples along both axes.

Ports: planes (planes, fine_rows, fine_cols) float32, starts int32 (rows,) and (cols,), weights
float32 (rows, taps_y) and (cols, taps_x) [1] -> planes (planes, rows, cols) float32 in the planes'
unit:

    out(y, x) = sum over s, t of  weights_y[y, s] weights_x[x, t] planes(start_y[y] + s, start_x[x] + t).

The planner chooses weights that make a pixel the mean over its aperture (`gpusim.optics.sampling`).
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def sample(
    device: Device,
    planes: Array,
    start_y: Array,
    weights_y: Array,
    start_x: Array,
    weights_x: Array,
) -> Array:
    """Reduce every plane along its columns, then along its rows.

    Args:
        planes: Samples, shape (planes, fine_rows, fine_cols).
        start_y: First sample of every pixel row, shape (rows,). Every start + taps must lie in the
            planes.
        weights_y: Weights along the columns [1], shape (rows, taps_y).
        start_x: First sample of every pixel column, shape (cols,).
        weights_x: Weights along the rows [1], shape (cols, taps_x).
        device: A `Device`, or its name for `open_device`.

    Returns:
        Pixels, shape (planes, rows, cols), float32.
    """
    count, fine_rows, fine_cols = planes.shape
    (rows, taps_y), (cols, taps_x) = weights_y.shape, weights_x.shape
    planes = device.array(planes)
    middle, out = device.empty((count, rows, fine_cols)), device.empty((count, rows, cols))
    # Columns first: neighbours in a row are neighbours in memory, and the gather then has only
    # 1/ratio of the samples.
    # The weights of neighbouring pixels are neighbours in memory for the same reason.
    for name, source, target, start, weights, taps in (
        ("columns", planes, middle, start_y, weights_y, taps_y),
        ("rows", middle, out, start_x, weights_x, taps_x),
    ):
        weights = np.ascontiguousarray(np.transpose(device.numpy(weights)))
        size = (fine_rows, rows, fine_cols) if name == "columns" else (rows, fine_cols, cols)
        arrays = [source, device.array(start, np.int32), device.array(weights), target]
        sizes, defines = [*warp_only(device, taps), count, *size], {"TAPS": taps}
        device.launch("optics.sample", name, target.shape, *arrays, *sizes, defines=defines)
    return out


def cases():
    """Yield cases.

    One pixel of one sample, odd and even whole ratios, 1.25 and pi with a negative weight at one
    end.
    """
    random = np.random.default_rng(12)
    why = (
        "every weight, product and partial sum of taps_y + taps_x terms rounds by half an ulp, 6e-8, of magnitudes "
        "that add up to 1.5 per axis of samples up to 1; the largest pixel is at least 1.25 x 0.375 - 0.25 x 1.125"
    )
    for count, rows, cols, ratio, taps in (
        (1, 1, 1, 1.0, 1),
        (3, 5, 7, 3.0, 3),
        (2, 21, 40, 1.25, 7),
        (4, 20, 65, np.pi, 9),
        (1, 33, 130, 2.0, 2),
    ):
        fine = [int(np.ceil(n * ratio)) + taps for n in (rows, cols)]
        starts = [np.floor(ratio * np.arange(n)).astype(np.int32) for n in (rows, cols)]
        weights = [random.uniform(0.5, 1, (n, taps)) for n in (rows, cols)]
        for one in weights:
            if ratio % 1:
                one[:, -1] = 0
            one /= one.sum(axis=1, keepdims=True)
            if ratio % 1:
                one *= 1.25
                one[:, -1] = -0.25
        inputs = {
            "planes": random.uniform(0.5, 1, (count, *fine)).astype(np.float32),
            "start_y": starts[0],
            "weights_y": weights[0].astype(np.float32),
            "start_x": starts[1],
            "weights_x": weights[1].astype(np.float32),
        }
        name = f"{rows}x{cols} from {fine[0]}x{fine[1]}, {count} planes, {taps} taps"
        yield Case(name, inputs, (2 * taps + 2) * 6e-8 * 1.5**2 / 0.1875, why)


def bench(rows, cols):
    """Return inputs: three channels of a frame from three samples a pixel at full fill."""
    random = np.random.default_rng(12)
    return {
        "planes": random.random((3, 3 * rows, 3 * cols), np.float32),
        "start_y": 3 * np.arange(rows, dtype=np.int32),
        "weights_y": np.full((rows, 3), 1 / 3, np.float32),
        "start_x": 3 * np.arange(cols, dtype=np.int32),
        "weights_x": np.full((cols, 3), 1 / 3, np.float32),
    }
