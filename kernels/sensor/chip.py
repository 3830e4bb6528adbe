"""Expected electrons of one chip: the scene's mean times its response, plus dark current.

Ports: mean (rows, cols) float32 [e-]; response [1], dark [e- s-1] of the same shape or None ->
expected float32 [e-]:

    expected = max(min(scale mean, 1e30) response, 0) + dark_time dark

Two to four roundings, the same bits on every device. NaN stays NaN.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.sensor.noise import MOST
from gpusim.kernels.stage import Array, exact_case, stage, warp_only


@stage
def chip(
    device: Device,
    mean: Array,
    response: Array | None = None,
    dark: Array | None = None,
    *,
    scale: float = 1.0,
    dark_time: float = 0.0,
) -> Array:
    """Return the mean electrons of every pixel of this chip.

    Args:
        mean: Mean electrons of the scene [e-], shape (rows, cols).
        response: Relative response [1], shape (rows, cols), see `sensor.pattern`; None for 1.
        dark: Dark current [e- s-1], shape (rows, cols), see `sensor.pattern`; None for 0.
        scale: Factor of the mean [1], for another exposure time than its own.
        dark_time: Exposure time, times the factor by which temperature changes the dark current
            [s].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Expected electrons [e-], shape (rows, cols), float32.

    Raises:
        BadData: A plane has another shape than the mean.
        OutOfRange: `scale` or `dark_time` is negative or above 1e30.
    """
    for name, plane in (("response", response), ("dark", dark)):
        if plane is not None and tuple(plane.shape) != tuple(mean.shape):
            raise BadData(
                f"{name}: shape {tuple(plane.shape)}, wanted the mean's shape, {tuple(mean.shape)}"
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
        *warp_only(device, *use),
        size,
        float(scale),
        numbers={"dark_time": dark_time},
        defines={"RESPONSE": use[0], "DARK": use[1]},
    )
    return device.reshape(expected, tuple(mean.shape))


def cases():
    """Yield cases: with and without each plane, extreme means: bit for bit."""
    random = np.random.default_rng(5)
    why = "both sides do the same correctly rounded float32 operations in the same order"
    for rows, cols in ((1, 1), (13, 37)):
        values = [0, 1e-8, 0.1, 1e3, 1e7, 1e38, np.inf, -np.inf, -1, np.nan, 7]
        mean = np.resize(values, (rows, cols)).astype(np.float32)
        planes = {
            "response": random.normal(1, 0.4, (rows, cols)).astype(np.float32),
            "dark": random.exponential(1, (rows, cols)).astype(np.float32),
        }
        for chosen in ((), ("response",), ("dark",), ("response", "dark")):
            yield exact_case(
                f"{rows}x{cols} {' '.join(chosen) or 'mean only'}",
                why,
                mean=mean,
                scale=0.3,
                dark_time=0.7,
                **{name: planes[name] for name in chosen},
            )


def bench(rows, cols):
    """Return inputs: response and hot pixels."""
    random = np.random.default_rng(5)
    mean, response, dark = random.random((3, rows, cols), np.float32)
    return {"mean": 1e3 * mean, "response": 1 + 0.01 * response, "dark": dark, "dark_time": 0.01}
