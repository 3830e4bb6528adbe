"""Local tone mapping: dark regions are lifted as a whole, so that detail in them keeps its contrast.

Ports: rgb (3, rows, cols) float32, linear, luminance (3,) -> (3, rows, cols) float32, linear.
"""

from functools import partial

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only

BLOCKS = 128  # along a picture's shorter side
REACH = 8  # [block] of the means: a sixteenth of that side
EDGE = 0.5  # variance [stop^2] of the base at which half of it is kept as an edge
DARKEST = 2.0**-10  # light below which stops lose their meaning
LIFT = 2.0  # black becomes 1 + LIFT times as bright at strength 1
SHADOW = 0.1  # light that is lifted by half of this
NOISY = 3.0  # [sigma] of noise at which half of the lift is left


@stage
def local_tone(
    device: Device, rgb: Array, luminance: Array, *, strength: float, noise: float = 0.0
) -> Array:
    """Multiply all channels by a gain that depends on the light of the surroundings, up to edges.

    With g = log2(max(Y, 0) + DARKEST) of the luminance Y = sum_p w_p rgb_p, and the same of its means
    over blocks of about a 128th of the shorter side, a guided filter that is guided by g itself
    makes the base b = a g + c: in windows of 2 REACH + 1 blocks with mean m and variance v, a = v /
    (v + EDGE) and c = (1 - a) m; a and c are averaged over the same windows and bilinear between
    blocks. The base's light is B = max(2^b - DARKEST, 0), and the gain

        1 + strength LIFT / (1 + (B / SHADOW)^2) B^2 / (B^2 + (NOISY noise)^2).

    It does not turn the order of base lights around, leaves white as it is within 2 %, and does not
    lift noise. Ratios of the channels stay. A pixel that is not finite stays as it is; blocks
    leave such pixels out.

    Args:
        rgb: Linear RGB, white = 1, shape (3, rows, cols).
        luminance: Weights of the channels, shape (3,); their sum is 1.
        strength: Strength, 0 .. 1 [1].
        noise: Standard deviation of the luminance in the dark, at least 0.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear RGB, shape (3, rows, cols), float32.

    Raises:
        BadData: An array has the wrong shape.
        OutOfRange: `strength` or `noise` is outside its range.

    Source:
        He, Sun & Tang 2013, IEEE Trans. PAMI 35, 1397-1409 (guided filter); He & Sun 2015, "Fast
        Guided Filter", arXiv:1505.00996 (on a coarse grid); Durand & Dorsey 2002, ACM Trans. Graph.
        21, 257-266 (base and detail).
    """
    luminance = np.asarray(luminance, np.float32)
    if len(rgb.shape) != 3 or rgb.shape[0] != 3 or luminance.shape != (3,):
        raise BadData(
            f"local_tone: rgb {tuple(rgb.shape)}, luminance {luminance.shape}; wanted (3, rows, cols) and (3,)"
        )
    if not 0 <= strength <= 1:
        raise OutOfRange("local_tone: strength", strength, "0 .. 1")
    if not 0 <= noise < np.inf:
        raise OutOfRange("local_tone: noise", noise, "0 or more, finite")
    _, rows, cols = rgb.shape
    launch = partial(device.launch, "processor.local_tone", defines={"REACH": REACH})
    size = block_size(rows, cols)
    rgb, weights = device.array(rgb), device.array(luminance)
    base = device.empty((-(-rows // size), -(-cols // size)))
    launch("measure_blocks", base.shape, rgb, weights, base, DARKEST, size, rows, cols, *base.shape)
    lines, fitted, smooth = (device.empty((2, *base.shape)) for _ in range(3))
    reach = warp_only(device, REACH)
    launch("add_rows", base.shape, base, lines, *base.shape, *reach)
    launch("fit", base.shape, lines, fitted, EDGE, *base.shape, *reach)
    launch("mean_rows", lines.shape, fitted, lines, *lines.shape, *reach)
    launch("mean_columns", lines.shape, lines, smooth, *lines.shape, *reach)
    out = device.empty((3, rows, cols))
    numbers = (float(strength) * LIFT, 1 / SHADOW, float(NOISY * noise) ** 2, DARKEST)
    sizes = (size, rows, cols, *base.shape)
    launch("lift", (rows, cols), rgb, weights, smooth, out, *numbers, *sizes)
    return out


def block_size(rows: int, cols: int) -> int:
    """Return the side of a block [pixel]."""
    return max(1, round(min(rows, cols) / BLOCKS))


LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of sRGB


def cases():
    """Yield cases: one pixel, sizes below a block's and above, noise, black, values that are not finite."""
    random = np.random.default_rng(6)
    why = (
        "logarithms and powers of 2 within 4 ulp of a stop up to 10, float32: 2^-24 x 10 x 4 in the exponent, times "
        "ln 2 and the steepest slope of the gain, 1.5 LIFT; window means of 17 x 17 values of up to 10 stops and "
        "their squares round by 2^-24 x 34 x 100, and a divides them by v + EDGE, at most 10 stops of base by that: "
        "2^-24 x 34 x 100 x 10 / EDGE / 10"
    )
    tolerance = 2.0**-24 * (40 * 1.5 * LIFT + 34 * 100 / EDGE)
    for rows, cols, strength, noise in (
        (1, 1, 1.0, 0.0),
        (63, 65, 1.0, 0.0),
        (300, 33, 0.5, 0.01),
        (3, 200, 0.3, 0.1),
        (330, 450, 1.0, 0.001),
    ):
        steps = 2.0 ** random.uniform(-8, 1, (-(-rows // 20), -(-cols // 20)))
        light = np.kron(steps, np.ones((20, 20)))[:rows, :cols]
        rgb = light * random.uniform(-0.02, 1, (3, rows, cols))
        yield Case(
            f"{rows}x{cols}, strength {strength:g}, noise {noise:g}",
            {
                "rgb": rgb.astype(np.float32),
                "luminance": LUMINANCE,
                "strength": strength,
                "noise": noise,
            },
            tolerance,
            why,
        )
    rgb = random.random((3, 30, 40), np.float32)
    rgb[0, 3, 5], rgb[1, 20, 20], rgb[2, 29, 39] = np.nan, np.inf, -np.inf
    yield Case(
        "NaN and infinities",
        {"rgb": rgb, "luminance": LUMINANCE, "strength": 1.0},
        tolerance,
        why,
        metric="exact",
    )
    yield exact_case(
        "strength 0",
        "the gain is 1",
        rgb=random.random((3, 30, 40), np.float32),
        luminance=LUMINANCE,
        strength=0.0,
    )


def bench(rows, cols):
    """Return inputs: a picture with noise."""
    random = np.random.default_rng(6)
    rgb = random.random((3, rows, cols), np.float32)
    return {"rgb": rgb, "luminance": LUMINANCE, "strength": 0.5, "noise": 1e-3}


def operations(rgb, luminance, strength, noise):
    """Count operations of each pixel: 6 for its luminance twice, 4 of blocks, 24 of the base, the gain and products."""
    return rgb[0].size * 40
