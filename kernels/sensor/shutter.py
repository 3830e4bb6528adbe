"""Shutter: the light that every row collects while it is open, from the rates at a few instants.

Ports: rates (instants, rows, cols) float32 [e- s-1], weights (rows, instants) float32 [s] -> mean
(rows, cols) float32 [e-]:

    mean(y, x) = sum over k of  weights[y, k] rates(k, y, x).

A row that is exposed after the one above it has later weights (`gpusim.optics.shutter`). The kernel
reads only the instants between a row's first and last weight that is not zero: (m + 1) 4 bytes a
pixel for m of them.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, exact_case, stage

CHUNK = 512  # pixels that a CPU's work-item sums up: 2 KiB, so the sums stay in the nearest cache


@stage
def shutter(device: Device, rates: Array, weights: Array) -> Array:
    """Return the mean electrons of rows that are exposed one after the other.

    The relative error is below m 2^-24 for m instants if weights and rates are not negative (m
    products and m - 1 sums round, the first to a sum of zero does not: Higham 2002, 3.1), and 2^-24
    more if the weights are rounded to float32 here.

    Args:
        rates: Mean rate of every pixel at the instants [e- s-1], shape (instants, rows, cols).
        weights: Weights of the instants [s], shape (rows, instants): a small table, which the host
            reads. It is zero if an instant does not matter to a row. Rates before a row's first and
            after its last instant have no effect, even NaN.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Mean electrons [e-], shape (rows, cols), float32.
    """
    instants, rows, cols = rates.shape
    weights = np.ascontiguousarray(device.numpy(weights), np.float32)
    chunk = 1 if device.is_gpu else CHUNK
    mean = device.empty((rows, cols))
    arrays = [device.array(rates), device.array(weights), device.array(spans(weights), np.int32)]
    sizes = [instants, rows, cols]
    grid = (rows, -(-cols // chunk) if device.kind == "opencl" else cols)
    device.launch(
        "sensor.shutter",
        "shutter",
        grid,
        *arrays,
        mean,
        *sizes,
        defines={"CHUNK": chunk},
        group=None if device.is_gpu else (1, 1),
    )
    return mean


def spans(weights) -> np.ndarray:
    """Return each row's first instant with a weight and its last plus 1, int32 (rows, 2)."""
    used = np.asarray(weights) != 0
    last = used.shape[1] - used[:, ::-1].argmax(axis=1)
    return np.stack([used.argmax(axis=1), np.where(used.any(axis=1), last, 0)], axis=1).astype(
        np.int32
    )


def cases():
    """Yield cases.

    One instant, all instants, a window that moves down the rows, rows of zeros, NaN where nothing
    is read.
    """
    random = np.random.default_rng(7)
    sizes = (1, 1, 1, 1), (5, 5, 3, 5), (9, 3, 63, 65), (40, 12, 30, 1030), (70, 64, 5, 9)
    for instants, used, rows, cols in sizes:
        rates = (10.0 ** random.uniform(-3, 6, (instants, rows, cols))).astype(np.float32)
        weights = _moving_window(random, instants, used, rows)
        for y, (first, end) in enumerate(spans(weights)):
            rates[:first, y] = rates[end:, y] = np.nan
        yield Case(
            f"{rows}x{cols}, {used} of {instants} instants",
            {"rates": rates, "weights": weights},
            used * 2.0**-24,
            metric="local",
            why=f"{used} products and {used - 1} sums of positive float32 numbers round, each by half an ulp",
        )
    yield exact_case(
        "a row that gathers nothing",
        "7 x 0.5 is exact",
        rates=np.full((3, 2, 4), 7, np.float32),
        weights=np.array([[0, 0, 0], [0, 0.5, 0]], np.float32),
    )


def _moving_window(random, instants, used, rows):
    """Return weights with `used` nonzero values a row, from the first to the last instants."""
    first = np.arange(rows) * (instants - used) // max(rows - 1, 1)
    k = np.arange(instants)
    inside = (k >= first[:, None]) & (k < first[:, None] + used)
    return np.where(inside, random.uniform(1e-4, 1e-3, (rows, instants)), 0).astype(np.float32)


def bench(rows, cols):
    """Return inputs.

    16 instants, 5 for each row: read out in 20 ms, exposed for 6, pictures 2 ms apart.
    """
    random = np.random.default_rng(7)
    return {
        "rates": random.random((16, rows, cols), np.float32),
        "weights": _moving_window(random, 16, 5, rows),
    }
