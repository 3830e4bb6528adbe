"""What one chip is expected to collect: the scene's mean electrons through its response, and its own dark current.

Ports: mean (rows, cols) float32 [e-]; response [1], dark [e- s-1] of the same shape or none -> expected float32 [e-]:

    expected = max(min(scale mean, 1e30) response, 0) + dark_time dark

Two to four roundings, the same bits on every device. NaN stays NaN.
"""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.sensor.noise import MOST
from gpusim.kernels.stage import Case, stage


@stage
def chip(device, mean, response=None, dark=None, *, scale=1.0, dark_time=0.0):
    """Mean electrons of every pixel of this chip.

    mean: of the scene, shape (rows, cols) [e-]. response: relative, dark: dark current [e- s-1], see `sensor.pattern`.
    scale: multiplies the mean, for another exposure time than its own [1]. dark_time: exposure time, times what
    temperature does to the dark current [s]. Returns shape (rows, cols). Raises BadData, OutOfRange.
    """
    for name, plane in (("response", response), ("dark", dark)):
        if plane is not None and tuple(plane.shape) != tuple(mean.shape):
            raise BadData(
                f"{name}: shape {tuple(plane.shape)}, wanted that of the mean, {tuple(mean.shape)}"
            )
    for name, value in (("scale", scale), ("dark_time", dark_time)):
        if not 0 <= value <= MOST:
            raise OutOfRange(name, value, f"0 <= {name} <= {MOST:g}")
    size = mean.shape[0] * mean.shape[1]
    planes = [
        device.array(mean),
        *(None if plane is None else device.array(plane) for plane in (response, dark)),
    ]
    use = [int(plane is not None) for plane in planes[1:]]
    planes = [device.reshape(planes[0] if plane is None else plane, (size,)) for plane in planes]
    expected = device.empty((size,))
    device.launch(
        "sensor.chip",
        "chip",
        (size,),
        *planes,
        expected,
        *(() if device.kind == "opencl" else use),
        size,
        float(scale),
        numbers={"dark_time": dark_time},
        defines={"RESPONSE": use[0], "DARK": use[1]},
    )
    return device.reshape(expected, tuple(mean.shape))


def cases():
    """With and without each plane, extreme means: bit for bit."""
    random = np.random.default_rng(5)
    why = "both sides do the same correctly rounded float32 operations in the same order"
    for rows, cols in ((1, 1), (13, 37)):
        mean = np.resize(
            [0, 1e-8, 0.1, 1e3, 1e7, 1e38, np.inf, -np.inf, -1, np.nan, 7], (rows, cols)
        )
        planes = {
            "response": random.normal(1, 0.4, (rows, cols)).astype(np.float32),
            "dark": random.exponential(1, (rows, cols)).astype(np.float32),
        }
        for chosen in ((), ("response",), ("dark",), ("response", "dark")):
            yield Case(
                f"{rows}x{cols} {' '.join(chosen) or 'alone'}",
                {
                    "mean": mean.astype(np.float32),
                    "scale": 0.3,
                    "dark_time": 0.7,
                    **{name: planes[name] for name in chosen},
                },
                0.0,
                why,
                metric="exact",
            )


def bench(rows, cols):
    """Response and hot pixels."""
    random = np.random.default_rng(5)
    mean, response, dark = random.random((3, rows, cols), np.float32)
    return {"mean": 1e3 * mean, "response": 1 + 0.01 * response, "dark": dark, "dark_time": 0.01}
