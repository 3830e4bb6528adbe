"""How far each frame of a burst or bracket agrees with the reference, block by block.

Ports: raw (frames, rows, cols) uint16 [DN], displacement (frames, tiles_y, tiles_x, 2) float32
[period] -> trust (frames, h, w) float32, 0 .. 1, of each period of the mosaic of the reference.

Displacements between the middles of tiles are interpolated linearly. Samples of one colour, a
period apart, are smoothed by cubic B-splines, 4 x 4 taps, which leave hardly anything of the
frequencies that alias. f is the rate of the moved frame, r of the reference, both smoothed, and w
the weights of the taps. f - r is compared with

    (sum w_f^2) v_f + (sum w_r^2) v_r + texture d^2,   v = shot f + floor,

where d^2 is the variance of the reference's samples under the spline, less that of the noise:
where the reference changes from sample to sample, small errors of the displacement and aliasing
make f - r larger than noise does. q is the mean of (f - r)^2 over this sum, over the pixels of 3 x
3 blocks. The trust is 1 up to q = low, falls linearly, and is 0 from high on, see `bounds`.

A frame has no trust at a block if one of its samples there is full, or if f is so close to it that
samples would be left out by chance. A block whose reference is full compares nothing. The frame
`last`, which holds the largest rate, is never left out for being full; without it none is.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.common.cases import moving_picture
from gpusim.kernels.processor.align import TILE
from gpusim.kernels.processor.refine import case_table, check_stack
from gpusim.kernels.stage import Array, Case, stage, warp_only

LEAST = 1.5  # of q: the smallest bound
FREEDOM = (
    5.6  # degrees of freedom of q per pixel of a block: splines make neighbours alike; measured
)
SURE = 3.3  # [standard deviations] of q, which noise exceeds in 5e-4 of all blocks
BAND = 1.7  # bound of no trust over the bound of full trust
TEXTURE = 0.2  # share of the variance among samples that may be a difference
MARGIN = 3.2  # [standard deviations of a pixel] to a full one, as `processor.merge` has it
OUTSIDE = 1e6  # misfit of a frame without trust


@stage
def trust(
    device: Device,
    raw: Array,
    displacement: Array,
    *,
    reference: int = 0,
    last: int | None = None,
    period: tuple[int, int] = (2, 2),
    table: Array,
) -> Array:
    """Return the trust in every frame at every block of the reference.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16.
        displacement: Displacement of every tile [period], shape (frames, tiles_y, tiles_x, 2).
        reference: Number of the frame with which the others are compared.
        last: Number of the frame that holds the largest rate; None leaves no frame out for being
            full.
        period: Rows and columns of the mosaic's period, 1 to 8.
        table: Numbers of each frame, see `processor.refine`.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Trust, shape (frames, h, w), float32: h x w blocks of a period, of which the last may be
        cut.

    Raises:
        BadData: Shapes or types do not fit.
        OutOfRange: `reference`, `last`, `period` or a number of `table` is not allowed.

    Source:
        Wronski et al. 2019, "Handheld multi-frame super-resolution", ACM Transactions on Graphics
        38(4), section 5.2, for a difference over both noise and local variance.
    """
    table = check_stack(raw, displacement, reference, period, table)
    count, rows, cols = raw.shape
    if last is not None and not (0 <= last < count and last == int(last)):
        raise OutOfRange("last", last, f"the number of a frame, 0 .. {count - 1}")
    py, px = map(int, period)
    h, w = -(-rows // py), -(-cols // px)
    raw, displacement = device.array(raw, np.uint16), device.array(displacement)
    defines = {"TILE": TILE, "PERIOD_Y": py, "PERIOD_X": px, "OUTSIDE": f"{OUTSIDE}f"}
    launch = functools.partial(device.launch, "processor.trust", defines=defines)
    misfit, out = device.empty((count, h, w)), device.empty((count, h, w))
    last = -1 if last is None else int(last)
    numbers = [int(reference), last, TEXTURE, MARGIN, *map(int, displacement.shape[1:3])]
    sizes = [count, rows, cols, h, w, *warp_only(device, py, px)]
    launch(
        "compare", misfit.shape, raw, displacement, device.array(table), misfit, *numbers, *sizes
    )
    launch("weigh", out.shape, misfit, out, *bounds(period), count, h, w)
    return out


def bounds(period: tuple[int, int]) -> tuple[float, float]:
    """Return the largest q of full trust, and the least q of none.

    q of noise is chi squared over its degrees of freedom n = FREEDOM times the pixels of a block,
    whose cube root is nearly normal: mean 1 - 2 / 9n, variance 2 / 9n (Wilson and Hilferty 1931).

    Args:
        period: Rows and columns of the mosaic's period.

    Returns:
        (low, high).
    """
    spread = 2 / (9 * FREEDOM * period[0] * period[1])
    low = max(LEAST, (1 - spread + SURE * spread**0.5) ** 3)
    return low, BAND * low


def cases():
    """Yield cases: periods, fractions, places outside, full pixels, something that moved, one frame."""
    random = np.random.default_rng(7)
    why = (
        "in 2^-24: 16 taps, 20 roundings of up to 4095 numbers, squared and cancelled by means of squares 2 20 "
        "4095^2 of at least 4 numbers squared of noise: 0.03 / high of a misfit where texture counts, which "
        "is then 1 / TEXTURE smaller: 3e-3; places that round to another sample do not occur"
    )
    for period, rows, cols, count in (
        ((2, 2), 40, 70, 3),
        ((1, 1), 33, 37, 3),
        ((6, 6), 97, 110, 2),
        ((3, 1), 50, 17, 2),
        ((2, 2), 3, 3, 2),
        ((2, 2), 9, 12, 1),
    ):
        raw = moving_picture(random, np.zeros((count, 2), int), rows, cols, max(period))
        raw = raw // 2 + 100
        table = case_table(count)
        table[1:4] = np.array([[0.5], [0.05], [4.0]])
        raw[-1, rows // 2 :, cols // 2 :] += 30
        raw[-1, :2, :2] = 4000
        tiles = (max(1, -(-(n // p) // TILE)) for n, p in zip((rows, cols), period, strict=True))
        displacement = random.normal(0, 0.5, (count, *tiles, 2)).astype(np.float32)
        inputs = {
            "raw": raw,
            "displacement": displacement,
            "period": period,
            "reference": count // 2,
            "last": 0 if count > 2 else None,
            "table": table,
        }
        yield Case(f"{count} frames {rows}x{cols}, period {period}", inputs, 3e-3, why)


def bench(rows, cols):
    """Return inputs: eight frames of a Bayer mosaic, displaced by fractions."""
    random = np.random.default_rng(7)
    raw = moving_picture(random, random.integers(-20, 21, (8, 2)), rows, cols, 8)
    tiles = (max(1, -(-(n // 2) // TILE)) for n in (rows, cols))
    return {
        "raw": raw,
        "displacement": random.normal(0, 3, (8, *tiles, 2)).astype(np.float32),
        "table": case_table(8),
    }
