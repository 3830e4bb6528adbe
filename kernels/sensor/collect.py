"""Exposure: each pixel collects its own channel for the exposure time, with the lens's fall-off.

Ports: rates (channels, rows, cols) float32 [e- s-1], cfa (period_y, period_x) int32 -> mean (rows,
cols) float32 [e-]:

    mean(y, x) = T cos^4(theta) max(0, rates[cfa[y mod period_y, x mod period_x], y, x]),
    tan(theta) = r slope,

or, without a mosaic, every channel of every pixel, mean (channels, rows, cols);
r the distance from the frame's centre [pixel], slope the tangent of the field angle per pixel (0:
no fall-off). Light is not negative: values below 0 that interpolation and transforms leave next to
strong edges become 0. NaN stays NaN.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.cases import RGGB
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def collect(
    device: Device, rates: Array, cfa: Array | None, exposure_time: float, slope: float
) -> Array:
    """Return the mean electrons of every pixel of the mosaic, or of every channel.

    Args:
        rates: Electrons per second [e- s-1] as if every pixel saw every channel, shape (channels,
            rows, cols).
        cfa: Channel of each pixel in one period of the mosaic, shape (period_y, period_x). None: pixels have all
            channels.
        exposure_time: Exposure time [s].
        slope: Pixel pitch over image distance [1].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Mean electrons [e-], shape (rows, cols), or without a mosaic (channels, rows, cols), float32.

    Source:
        Farrell and Wandell, sections 4.1 (cos^4 law) and 5.1.
    """
    channels, rows, cols = rates.shape
    rates = device.array(rates)
    if cfa is None:
        mean = device.empty((channels, rows, cols))
        sizes = float(slope), rows, cols
        numbers = {"exposure_time": exposure_time}
        device.launch(
            "sensor.collect",
            "collect_all",
            (channels, rows, cols),
            rates,
            mean,
            *sizes,
            numbers=numbers,
        )
        return mean
    cfa, mean = device.array(cfa, np.int32), device.empty((rows, cols))
    # The period is a compile-time constant: a modulo by a variable would double the cost.
    device.launch(
        "sensor.collect",
        "collect",
        (rows, cols),
        rates,
        cfa,
        mean,
        float(slope),
        rows,
        cols,
        *warp_only(device, *cfa.shape),
        numbers={"exposure_time": exposure_time},
        defines={"PERIOD_Y": cfa.shape[0], "PERIOD_X": cfa.shape[1]},
    )
    return mean


def cases():
    """Yield cases: all Bayer phases, monochrome, an odd period, a field of 100 degrees."""
    random = np.random.default_rng(4)
    why = (
        "three roundings of the tangent's square, six of the rest, each at most half an ulp, doubled by the square: "
        "below 10 ulp"
    )
    bayer = [[0, 1], [1, 2]], [[1, 0], [2, 1]], [[1, 2], [0, 1]], [[2, 1], [1, 0]]
    for pattern in (*bayer, [[0]], [[0, 1, 2], [3, 0, 1]]):
        for rows, cols, slope in ((1, 1, 0.0), (3, 5, 1e-3), (63, 65, 0.027)):
            rates = (10.0 ** random.uniform(-6, 6, (4, rows, cols))).astype(np.float32)
            cfa = np.array(pattern, np.int32)
            inputs = {"rates": rates, "cfa": cfa, "exposure_time": 0.013, "slope": slope}
            name = f"{rows}x{cols}, cfa {pattern}"
            yield Case(name, inputs, 10 * 2.0**-23, why, metric="local")
        inputs = {"rates": rates, "cfa": None, "exposure_time": 0.013, "slope": slope}
        yield Case(f"{rows}x{cols}, all channels", inputs, 10 * 2.0**-23, why, metric="local")
    overshot = random.normal(0, 1, (3, 7, 9)).astype(np.float32)
    overshot[:, 2, 3] = np.nan
    inputs = {"rates": overshot, "cfa": RGGB, "exposure_time": 0.013, "slope": 1e-3}
    yield Case("below zero and NaN", inputs, 10 * 2.0**-23, why, metric="local")


def bench(rows, cols):
    """Return inputs: a Bayer mosaic with fall-off."""
    rates = np.random.default_rng(4).random((3, rows, cols), np.float32)
    return {"rates": rates, "cfa": RGGB, "exposure_time": 0.01, "slope": 3e-4}
