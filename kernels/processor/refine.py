"""Sums over tiles that tell how displacements of frames must change, of any exposure times.

Ports: raw (frames, rows, cols) uint16 [DN], displacement (frames, tiles_y, tiles_x, 2) float32
[period] (see `processor.align`) -> sums (frames, tiles_y, tiles_x, 7) float32 [pixel^-2, pixel^-1,
1].

L is the mean of the rates around a pixel, with the weights of a tent two periods of the mosaic
wide: every colour then has the same share at every pixel, and its mean place is the pixel. With L_r
of the reference, L of a frame at the displaced place (by the cubic of Keys), and the variance s^2
of one number in both frames at the rate L_r, the sums over every PERIOD_Y-th row and PERIOD_X-th
column of a tile are

    g_y^2 / s^2, g_y g_x / s^2, g_x^2 / s^2, -g_y e / s^2, -g_x e / s^2, e^2 / s^2, 1,

where g are central differences of L_r, and e = L - L_r. The first five are the normal equations of
the step to the best displacement: (s_0, s_1; s_1, s_2) step = (s_3, s_4). Pixels whose tent has a full
number, or a mean less than MARGIN standard deviations of a number below it, count in no sum, nor do
places outside the frame. Dark pixels of a short
exposure count little, because their variance is large.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import moving_picture
from gpusim.kernels.processor.align import TILE, checked_stack
from gpusim.kernels.stage import Array, Case, stage, warp_only

FULL = 1e30  # L of a pixel whose tent has a full number
MARGIN = 4.0  # [standard deviations of a number] to a full one
PER_FRAME = "dark", "scale", "shot", "floor", "full"
SUMS = 7


@stage
def refine(
    device: Device,
    raw: Array,
    displacement: Array,
    *,
    reference: int = 0,
    period: tuple[int, int] = (2, 2),
    table: Array,
) -> Array:
    """Return the sums over the tiles of all frames; 0 for the reference.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16.
        displacement: Displacement of every tile [period], shape (frames, tiles_y, tiles_x, 2).
        reference: Number of the frame with which the others are compared.
        period: Rows and columns of the mosaic's period, 1 to 8.
        table: Numbers of each frame, shape (5, frames): the digital number without light [DN], the
            rate of one digital number (its unit is free), shot and floor of the variance shot rate
            + floor of a pixel's rate, and the number from which on a pixel is full [DN].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Sums, shape (frames, tiles_y, tiles_x, 7), float32.

    Raises:
        BadData: Shapes or types do not fit.
        OutOfRange: `reference`, `period` or a number of `table` is not allowed.

    Source:
        Lucas and Kanade 1981, "An iterative image registration technique with an application to
        stereo vision"; Baker and Matthews 2004, "Lucas-Kanade 20 years on", for gradients of the
        reference.
    """
    table = check_stack(raw, displacement, reference, period, table)
    count, rows, cols = raw.shape
    tiles = displacement.shape[1:3]
    raw, displacement = device.array(raw, np.uint16), device.array(displacement)
    defines = {
        "TILE": TILE,
        "PERIOD_Y": int(period[0]),
        "PERIOD_X": int(period[1]),
        "FULL": f"{FULL:g}f",
        "MARGIN": f"{MARGIN}f",
    }
    launch = functools.partial(device.launch, "processor.refine", defines=defines)
    sizes = [count, rows, cols, *warp_only(device, *map(int, period))]
    plane, out = device.empty((count, rows, cols)), device.empty((count, *tiles, SUMS))
    table = device.array(table)
    launch("smooth", (count, rows, cols), raw, table, plane, *sizes)
    numbers = [int(reference), *map(int, tiles), *sizes]
    launch("sums", (count, *tiles), plane, displacement, table, out, *numbers)
    return out


def check_stack(raw, displacement, reference, period, table):
    """Return the table as float32. Raise BadData or OutOfRange as `refine` does."""
    checked_stack(raw, reference, period)
    blocks = raw.shape[1] // int(period[0]), raw.shape[2] // int(period[1])
    wanted = (raw.shape[0], *(max(1, -(-n // TILE)) for n in blocks), 2)
    if tuple(displacement.shape) != wanted:
        raise BadData(
            f"displacement: shape {tuple(displacement.shape)}, wanted {wanted}, as processor.align gives it"
        )
    found = np.asarray(table, np.float32)
    if found.shape != (len(PER_FRAME), raw.shape[0]) or not np.isfinite(found).all():
        raise BadData(
            f"table: shape {found.shape}, wanted {(len(PER_FRAME), raw.shape[0])} finite numbers: "
            f"{', '.join(PER_FRAME)} of each frame"
        )
    for name, row, positive in zip(PER_FRAME[1:4], found[1:4], (True, False, True), strict=True):
        if (row <= 0).any() if positive else (row < 0).any():
            raise OutOfRange(name, row.tolist(), f"{name} {'>' if positive else '>='} 0")
    return found


def case_table(count: int) -> np.ndarray:
    """Return a table for frames of 12 bits whose exposure times fall by a factor of 1.5.

    Args:
        count: Number of frames.
    """
    scale = 0.5 * 1.5 ** np.arange(count)
    columns = [64.0 + np.arange(count), scale, scale, 25 * scale**2, np.full(count, 3900.0)]
    return np.array(columns, np.float32)


def cases():
    """Yield cases: periods, fractions, places outside, full pixels, odd sizes."""
    random = np.random.default_rng(6)
    why = (
        "in 2^-24 of the largest: L of at most 121 taps has 22 roundings per row and column, twice for the cubic, "
        "and is up to 20 times a difference e or g: 2 (44 + 16) 20 < 2^12; sums of 16 rows of 16: 32 more"
    )
    for period, rows, cols, count in (
        ((2, 2), 64, 97, 3),
        ((1, 1), 50, 49, 2),
        ((6, 6), 130, 101, 2),
        ((4, 1), 64, 16, 2),
        ((2, 2), 3, 3, 2),
    ):
        raw = moving_picture(random, np.zeros((count, 2), int), rows, cols, 2 * max(period))
        raw[-1, rows // 2, cols // 2] = 4000
        tiles = (max(1, -(-(n // p) // TILE)) for n, p in zip((rows, cols), period, strict=True))
        displacement = random.normal(0, 0.4, (count, *tiles, 2)).astype(np.float32)
        inputs = {
            "raw": raw,
            "displacement": displacement,
            "period": period,
            "reference": count // 2,
            "table": case_table(count),
        }
        yield Case(f"{count} frames {rows}x{cols}, period {period}", inputs, 2.0**-12, why)


def bench(rows, cols):
    """Return inputs: eight frames of a Bayer mosaic, displaced by fractions."""
    random = np.random.default_rng(6)
    raw = moving_picture(random, random.integers(-20, 21, (8, 2)), rows, cols, 8)
    tiles = (max(1, -(-(n // 2) // TILE)) for n in (rows, cols))
    return {
        "raw": raw,
        "displacement": random.normal(0, 3, (8, *tiles, 2)).astype(np.float32),
        "table": case_table(8),
    }
