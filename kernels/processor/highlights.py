"""Highlights rebuilt: clipped channels from those that are not, by the colour of the light around them.

Ports: camera (C, rows, cols) float32, neutral (C,) -> (C, rows, cols) float32, same scale.
"""

from functools import partial

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only

BLOCK = 8  # [pixel] along a side
# shares of saturation between which a value becomes clipped: demosaicking spreads the step
FIRST, LAST = 0.9, 0.98
TRUST = 0.5  # pixels just below saturation that outweigh the next coarser level
DARK = 0.02  # share of the light below which a channel says little about the others
MOST = 8.0  # times saturation: largest rebuilt value


@stage
def highlights(device: Device, camera: Array, neutral: Array, *, saturation: float) -> Array:
    """Return camera values whose clipped channels have the colour of the brightest light around them.

    Each block of BLOCK x BLOCK pixels has a mean colour, of unit sum over the channels: pixels
    weigh by the fourth power of their brightest channel over saturation, and not at all if one is
    clipped. A pyramid fills blocks without such pixels from their surroundings, in the end with the
    colour of white. With the colour rho of a pixel, bilinear between blocks, a clipped channel is

        max(v_c, t rho_c),  t = (sum_k (1 - q_k) v_k + DARK T) / (sum_k (1 - q_k) rho_k + DARK),

    with T = max_k v_k / rho_k, which holds where all are clipped. q goes from 0 to 1 where a value
    rises from FIRST to LAST of saturation, and the result from v_c to this. Negative values count
    as 0 in the sums. Results are at most MOST times the saturation; NaN stays in its pixel.

    Args:
        camera: Camera values, shape (C, rows, cols).
        neutral: Camera values of white in any scale, each above 0, shape (C,).
        saturation: Camera value at which every channel clips, above 0.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Camera values, shape (C, rows, cols), float32.

    Raises:
        BadData: The shapes do not fit.
        OutOfRange: `neutral` or `saturation` is not above 0 and finite.
    """
    neutral = np.asarray(neutral, np.float64)
    if len(camera.shape) != 3 or neutral.shape != (camera.shape[0],):
        raise BadData(
            f"highlights: camera {tuple(camera.shape)}, neutral {neutral.shape}; wanted (C, rows, cols) and (C,)"
        )
    for name, value in (("neutral", neutral), ("saturation", np.float64(saturation))):
        if not (np.isfinite(value) & (value > 0)).all():
            raise OutOfRange(f"highlights: {name}", value.tolist(), "above 0, finite")
    channels, rows, cols = camera.shape
    defines = {"CHANNELS": channels, "BLOCK": BLOCK}
    launch = partial(device.launch, "processor.highlights", defines=defines)
    only = warp_only(device, channels)
    camera, top = device.array(camera), float(saturation)
    sums = device.empty((channels + 1, -(-rows // BLOCK), -(-cols // BLOCK)))
    span = 1 / (LAST - FIRST)
    launch(
        "measure_blocks",
        sums.shape[1:],
        *(camera, sums, 1 / top, FIRST, span, rows, cols, *sums.shape[1:], *only),
        *warp_only(device, BLOCK),
    )
    levels = [sums]
    while max(levels[-1].shape[1:]) > 1:
        fine = levels[-1]
        coarse = device.empty((channels + 1, *(-(-n // 2) for n in fine.shape[1:])))
        launch("add_up", coarse.shape, fine, coarse, *fine.shape[1:], *coarse.shape)
        levels.append(coarse)
    colors = device.array((neutral / neutral.sum()).reshape(-1, 1, 1))
    for fine in reversed(levels):
        filled = device.empty((channels, *fine.shape[1:]))
        sizes = *colors.shape[1:], *filled.shape
        launch("fill", filled.shape, fine, colors, filled, TRUST, *sizes)
        colors = filled
    out = device.empty((channels, rows, cols))
    launch(
        "rebuild",
        (rows, cols),
        *(camera, colors, out, 1 / top, FIRST, span, DARK, MOST * top),
        *(rows, cols, *colors.shape[1:], *only, *warp_only(device, BLOCK)),
    )
    return out


def cases():
    """Yield cases: coloured lamps beyond saturation, all channel counts, sizes below a block, nothing clipped, NaN."""
    random = np.random.default_rng(4)
    why = (
        "see the docstring: a colour is a mean of positive terms, within 40 roundings of 2^-24 per level of seven; "
        "t divides by at least DARK, and a value that is half clipped changes by 1 / (LAST - FIRST) of its "
        "roundings: 40 x 7 x 2^-24 (1 + 1 / 0.08) of the largest value"
    )
    for channels, rows, cols in ((3, 1, 1), (3, 63, 65), (2, 9, 17), (4, 40, 130), (3, 5, 3)):
        y, x = np.mgrid[:rows, :cols]
        light = 0.3 + 3 * np.exp(-((y - rows / 2) ** 2 + (x - cols / 3) ** 2) / (rows / 3 + 1) ** 2)
        color = random.uniform(0.2, 1, (channels, 1, 1))
        camera = light * color * random.uniform(0.95, 1.05, (channels, rows, cols))
        neutral = random.uniform(0.5, 1, channels).astype(np.float32)
        camera = np.minimum(camera, 0.8).astype(np.float32)
        yield Case(
            f"{channels} channels, {rows}x{cols}",
            {"camera": camera, "neutral": neutral, "saturation": 0.8},
            40 * 7 * 2.0**-24 * (1 + 1 / (LAST - FIRST)),
            why,
        )
    neutral = np.array([0.5, 1, 0.7], np.float32)
    dim = random.uniform(-0.1, 0.85, (3, 33, 47)).astype(np.float32)
    yield exact_case(
        "nothing clipped",
        "values below FIRST stay",
        camera=dim,
        neutral=neutral,
        saturation=1.0,
    )
    camera = np.ones((3, 20, 20), np.float32)
    camera[1, 3, 4] = np.nan
    yield Case(
        "all clipped, and NaN",
        {"camera": camera, "neutral": neutral, "saturation": 1.0},
        40 * 7 * 2.0**-24,
        why,
    )


def bench(rows, cols):
    """Return inputs: a picture with some clipped light."""
    random = np.random.default_rng(4)
    return {
        "camera": np.minimum(1.1 * random.random((3, rows, cols), np.float32), 1),
        "neutral": np.array([0.5, 1, 0.7], np.float32),
        "saturation": 1.0,
    }


def operations(camera, neutral, saturation):
    """Count operations: ten for each value's weight and sums, 25 for its colour and the rebuilt value."""
    return 35 * camera.size
