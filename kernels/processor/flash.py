"""A picture in dim light, denoised with the help of a picture of the same view by flash.

Ports: ambient, flash (3, rows, cols) float32 linear RGB -> rgb (3, rows, cols) float32, in the
ambient picture's unit.

With V_c(p) the variance of a value, known from the noise model, and over the window of q around p

    d_F^2(p, q) = 1/3 sum_c (F_c(p) - F_c(q))^2 / (2 V^F_c(p)),   1 on average if both show the same,
    w_F = g(p - q) max(1 - d_F^2 / reach, 0)^2,                   g a Gaussian, sigma half the radius,

and w_A the same for the ambient picture A:

    A_F, F_F: means of A and F weighted by w_F;   A_A: mean of A weighted by w_A,
    v      = mean w_F d_F^2 - d_F^2(p, F_F),       s = max(v - 1/2, 0) / v,
    detail = 1 + s (F - F_F) / max(F_F, 2 sqrt(V^F)),
    rgb    = (1 - mask) A_F detail + mask A_A.

v is the variance of F in the window over 2 V, and s the part of it that is not noise: the detail is
the flash picture's texture without its noise. The mask is 1 if the flash picture is no better than
the ambient one, in the shadows of the flash, and if it is saturated, in its highlights. With the
squares of both signals over their noise,

    shadow    = 1 - step(sum F_F^2 / V^F(F_F) / (BETTER sum A_F^2 / V^A(A_F)) - 1),
    highlight = step(HIGHLIGHT part of window that is full),
    mask      = max(shadow, highlight),

step(t) = t^2 (3 - 2 t) of t clipped to 0 .. 1. Pictures continue with their edge values.
"""

from numbers import Real

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage, warp_only

# least gain in squared signal over noise by the flash; it counts in full at twice this
BETTER = 2.0
HIGHLIGHT = 8.0  # inverse of the part of the window whose fullness makes a highlight
MOST_RADIUS = 12


@stage
def flash(
    device: Device,
    ambient: Array,
    flash: Array,
    *,
    ambient_noise: Array,
    flash_noise: Array,
    full: float = np.inf,
    radius: int = 8,
    reach: float = 6.0,
) -> Array:
    """Average the ambient picture's noise over pixels that are similar in the flash picture.

    Args:
        ambient: Linear RGB in dim light, finite, shape (3, rows, cols).
        flash: Linear RGB by flash, finite, shape (3, rows, cols).
        ambient_noise: Shape (3, 4): the variance of value c is the sum over k of noise[c, k]
            max(value k, 0) + noise[c, 3], and at least noise[c, 3] > 0.
        flash_noise: The same for the flash picture, shape (3, 4).
        full: Value from which on the flash picture is saturated.
        radius: Radius of the window [pixel], 1 to 12.
        reach: Squared difference, over that of noise only, from which on pixels are not similar
            [1].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear RGB in the ambient picture's unit, shape (3, rows, cols), float32.

    Raises:
        BadData: Shapes do not fit, or a table has a number that is not finite.
        OutOfRange: `radius`, `reach` or a table is not allowed.

    Source:
        Petschnigg et al. 2004, "Digital photography with flash and no-flash image pairs", and
        Eisemann and Durand 2004, "Flash photography enhancement via intrinsic relighting", both ACM
        Transactions on Graphics 23 (3).
    """
    ambient_noise, flash_noise = check_inputs(
        ambient, flash, ambient_noise, flash_noise, radius, reach
    )
    rows, cols = ambient.shape[1:]
    out = device.empty((3, rows, cols))
    cpu = is_opencl_cpu(device)  # a row per work-item, 8 pixels at once
    tables = [device.array(table) for table in (ambient_noise, flash_noise, spatial(radius))]
    arrays = [device.array(ambient), device.array(flash), *tables, out]
    defines = {
        "RADIUS": int(radius),
        "WIDTH": 8 if cpu else 1,
        "CPU": int(cpu),
        "BETTER": f"{BETTER}f",
        "HIGHLIGHT": f"{HIGHLIGHT}f",
    }
    numbers = [float(min(full, 3e38)), float(1 / reach)]
    sizes = [rows, cols, *warp_only(device, int(radius))]
    group = (1, 1) if cpu else None
    grid = (rows, 1 if cpu else cols)
    device.launch(
        "processor.flash", "flash", grid, *arrays, *numbers, *sizes, defines=defines, group=group
    )
    return out


def spatial(radius):
    """Return the weights of the window by distance, shape (2 radius + 1, 2 radius + 1)."""
    line = np.exp(-0.5 * (np.arange(-radius, radius + 1) / (radius / 2)) ** 2)
    return np.outer(line, line)


def check_inputs(ambient, flash, ambient_noise, flash_noise, radius, reach):
    """Return both tables of noise as float64. Raise BadData or OutOfRange as `flash` does."""
    if (
        len(ambient.shape) != 3
        or ambient.shape[0] != 3
        or 0 in ambient.shape
        or ambient.shape != flash.shape
    ):
        raise BadData(
            f"ambient {tuple(ambient.shape)} and flash {tuple(flash.shape)}: wanted (3, rows, cols) for both"
        )
    tables = []
    for name, table in (("ambient_noise", ambient_noise), ("flash_noise", flash_noise)):
        table = np.asarray(table, np.float64)
        if table.shape != (3, 4) or not np.isfinite(table).all():
            raise BadData(f"{name}: shape {table.shape}, wanted (3, 4) of finite numbers")
        if not (table[:, 3] > 0).all():
            raise OutOfRange(f"{name}[:, 3]", table[:, 3].tolist(), "> 0")
        tables.append(table)
    if not (isinstance(radius, Real) and 1 <= radius <= MOST_RADIUS and radius == int(radius)):
        raise OutOfRange("radius", radius, f"a whole number of pixels, 1 .. {MOST_RADIUS}")
    if not (isinstance(reach, Real) and 0 < reach < np.inf):
        raise OutOfRange("reach", reach, "0 < reach < inf")
    return tables


def _pair(rows, cols):
    """Return a noisy picture of patches, and one by flash with a shadow and a highlight."""
    random = np.random.default_rng(12)
    patches = random.uniform(0.05, 0.9, (3, -(-rows // 7), -(-cols // 9)))
    patches = patches.repeat(7, 1).repeat(9, 2)[:, :rows, :cols]
    own = 0.1 * patches * np.linspace(0.5, 1, cols)
    lit = 0.2 * own + patches * (np.arange(cols) % 40 > 9)
    lit[:, : rows // 4, : cols // 4] = 1.2
    noise = np.hstack([np.full((3, 3), 0.002) + 0.004 * np.eye(3), np.full((3, 1), 2e-4)])
    variance = noise[:, :3].sum(1).reshape(3, 1, 1) * own + 2e-4
    ambient = own + random.normal(0, 1, own.shape) * np.sqrt(variance)
    by_flash = lit + random.normal(0, 0.02, lit.shape)
    return {
        "ambient": ambient.astype(np.float32),
        "flash": by_flash.astype(np.float32),
        "ambient_noise": noise.tolist(),
        "flash_noise": (noise / 10).tolist(),
        "full": 1.15,
    }


def cases():
    """Yield cases: window larger than the picture, odd sizes, shadows, highlights, flat fields."""
    why = (
        "n = (2 r + 1)^2 taps: sums err by n 2^-24 at most, a squared difference of values below 1.3 over 2 V > "
        "4e-5 by 2^-24 1.3 sqrt(2 reach / 4e-5) < 5e-5 of reach; F - F_F and v lose as much again: 1e-3"
    )
    for rows, cols, radius in ((1, 1, 2), (5, 3, 5), (33, 70, 3), (24, 49, 5)):
        inputs = {**_pair(rows, cols), "radius": radius}
        yield Case(f"{rows}x{cols}, radius {radius}", inputs, 1e-3, why)
    dark = _pair(9, 9) | {"ambient": np.zeros((3, 9, 9), np.float32)}
    yield exact_case("dark", "sums of zeros", **dark)
    pair = _pair(20, 31)
    same = {**pair, "flash": pair["ambient"], "flash_noise": pair["ambient_noise"]}
    yield Case("no better", same, 1e-3, why)


def bench(rows, cols):
    """Return inputs: the default window."""
    return _pair(rows, cols)
