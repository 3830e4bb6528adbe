"""Average of a burst's frames, moved onto one of them, without the parts that do not fit.

Ports: raw (frames, rows, cols) uint16 [DN], displacement (frames, tiles_y, tiles_x, 2) float32
[period] (see `processor.align`) -> mosaic (rows, cols) float32 [DN], with its black level.

A frame is interpolated among samples of one colour, a period apart, by the cubic of Keys with a =
-1/2, 4 x 4 taps. Displacements in whole periods move samples unchanged. f is the moved frame, r the
reference, and A = sum of the squared tap weights the part of the noise's variance that
interpolation leaves. Each period of the mosaic is a block; q is the mean over a block's pixels and
then over 3 x 3 blocks of

    (f - r)^2 / ((1 + A) (gain max((f + r) / 2 - black_level, 0) + read^2)),

which is 1 on average if both show the same, at any noise. The frame's weight at the block is 1 up
to q = low, falls linearly, and is 0 from high on, see `bounds`. Objects that moved, or that only
one frame shows, are thus left out. If a tap outside the frame is needed, q of that pixel is
OUTSIDE. The reference's weight is 1.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.align import TILE, checked_stack
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage, warp_only

LOW, HIGH = 1.5, 2.5  # of q; of 36 pixels of a Bayer mosaic q scatters by sqrt(2 / 36) = 0.24
SURE = 2.1  # [standard deviations] of q at least from 1 to low, and twice that from low to high
OUTSIDE = 1e6


@stage
def average(
    device: Device,
    raw: Array,
    displacement: Array,
    *,
    reference: int = 0,
    period: tuple[int, int] = (2, 2),
    black_level: float,
    noise: tuple[float, float],
) -> Array:
    """Return the weighted mean of all frames at every pixel of the reference.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16.
        displacement: Displacement of every tile [period], shape (frames, tiles_y, tiles_x, 2). A
            tile is 16 x 16 periods; the last one also has the rest.
        reference: Number of the frame that stays in place.
        period: Rows and columns of the mosaic's period, 1 to 8.
        black_level: Black level [DN].
        noise: (gain [DN/e-] >= 0, read [DN] > 0, rounding included): the variance of a digital
            number is gain (DN - black_level) + read^2.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Mosaic [DN], shape (rows, cols), float32.

    Raises:
        BadData: Shapes or types do not fit.
        OutOfRange: `reference`, `period` or `noise` is not allowed.

    Source:
        Hasinoff et al. 2016, "Burst photography for high dynamic range and low-light imaging on
        mobile cameras", section 5, for a merge that trusts a frame by its difference over the
        noise; Keys 1981, "Cubic convolution interpolation for digital image processing".
    """
    check_inputs(raw, displacement, reference, period, noise)
    count, rows, cols = raw.shape
    py, px = map(int, period)
    h, w = -(-rows // py), -(-cols // px)
    tiles = displacement.shape[1:3]
    raw, displacement = device.array(raw, np.uint16), device.array(displacement)
    gain, read = map(float, noise)
    moved, misfit, weights = (
        device.empty((count, *size)) for size in ((rows, cols), (h, w), (h, w))
    )
    out = device.empty((rows, cols))
    cpu = is_opencl_cpu(device)  # a row per work-item
    defines = {
        "FRAMES": count,
        "TILE": TILE,
        "PERIOD_Y": py,
        "PERIOD_X": px,
        "CPU": int(cpu),
        "WIDTH": 8 if cpu else 1,
        "OUTSIDE": f"{OUTSIDE}f",
    }
    launch = functools.partial(device.launch, "processor.average", defines=defines)
    group, grid = (1, 1, 1) if cpu else None, (count, h, 1 if cpu else w)
    numbers = [int(reference), float(black_level), gain, read * read]
    sizes = [*tiles, count, rows, cols, h, w, *warp_only(device, py, px)]
    launch("move", grid, raw, displacement, moved, misfit, *numbers, *sizes, group=group)
    numbers = [int(reference), *bounds(period)]
    launch("weigh", grid, misfit, weights, *numbers, count, h, w, group=group)
    sizes = [rows, cols, h, w, *warp_only(device, count, py, px)]
    pixels, item = (rows, 1 if cpu else cols), (1, 1) if cpu else None
    launch("average", pixels, moved, weights, out, *sizes, group=item)
    return out


def bounds(period: tuple[int, int]) -> tuple[float, float]:
    """Return the largest q of full weight, and the least q of weight 0.

    q of n pixels scatters by sqrt(2 / n). For the 9 pixels of a monochrome sensor this is so much
    that the bounds for Bayer's 36 would leave out frames by chance, and preferably those that look
    least like the reference; its noise would stay.

    Args:
        period: Rows and columns of the mosaic's period.

    Returns:
        (low, high).
    """
    scatter = float(np.sqrt(2 / (9 * period[0] * period[1])))
    low = max(LOW, 1 + SURE * scatter)
    return low, max(HIGH, low + 2 * SURE * scatter)


def check_inputs(raw, displacement, reference, period, noise):
    """Raise BadData or OutOfRange as `average` does."""
    checked_stack(raw, reference, period)
    blocks = raw.shape[1] // int(period[0]), raw.shape[2] // int(period[1])
    wanted = (raw.shape[0], *(max(1, -(-n // TILE)) for n in blocks), 2)
    if tuple(displacement.shape) != wanted:
        raise BadData(
            f"displacement: shape {tuple(displacement.shape)}, wanted {wanted}, as processor.align gives it"
        )
    if not (noise[0] >= 0 and 0 < noise[1] < np.inf and noise[0] < np.inf):
        raise OutOfRange(
            "noise", tuple(noise), "(gain, read), gain >= 0 and read > 0: rounding only is 0.29"
        )


def cases():
    """Yield cases.

    Whole and broken displacements, out of the frame, other mosaics, odd sizes, a moving thing, one
    frame.
    """
    random = np.random.default_rng(9)
    why = (
        "in 2^-24: 16 taps of up to 4095 DN, absolute weights adding up to 1.27 at most, err by 2 (4 + 4) 1.27 4095 "
        "< 2^17 DN; a difference of D DN errs by that, q <= 2.5 by 2^17 2 sqrt(2.5) / sigma + 48 roundings, the "
        "weight as much, times a difference of at most sqrt(36 9 2.5) sigma: with sigma >= 5 DN of 3000 2^-24 2^17 "
        "(2 + 2 x 2.5 x 12 x 1.6) / 3000 < 3e-4"
    )
    for period, rows, cols, count in (
        ((2, 2), 40, 70, 3),
        ((2, 2), 33, 35, 2),
        ((1, 1), 20, 37, 4),
        ((6, 6), 97, 110, 2),
        ((3, 1), 50, 17, 2),
        ((2, 2), 3, 3, 2),
        ((2, 2), 9, 12, 1),
    ):
        still = 500 + 2000 * random.random((rows, cols))
        still = (still + np.roll(still, period[0], 0) + np.roll(still, period[1], 1)) / 3
        raw = still + random.normal(0, 20, (count, rows, cols))
        raw[-1, rows // 2 :, cols // 2 :] += 30
        tiles = (max(1, -(-(n // p) // TILE)) for n, p in zip((rows, cols), period, strict=True))
        displacement = random.normal(0, 0.2, (count, *tiles, 2)).astype(np.float32)
        displacement[-1] = np.rint(5 * displacement[-1])
        inputs = {
            "raw": np.rint(raw).astype(np.uint16),
            "displacement": displacement,
            "period": period,
            "reference": count // 2,
            "black_level": 100.0,
            "noise": (0.15, 5.0),
        }
        name = f"{count} frames {rows}x{cols}, period {period}"
        yield Case(name, inputs, 3e-4, why)
    yield exact_case(
        "full",
        "equal whole numbers, their sum and its quarter are exact",
        raw=np.full((4, 20, 20), 65535, np.uint16),
        displacement=np.zeros((4, 1, 1, 2), np.float32),
        black_level=0.0,
        noise=(1.0, 1.0),
    )


def bench(rows, cols):
    """Return inputs: eight frames of a Bayer mosaic, displaced by fractions."""
    random = np.random.default_rng(9)
    raw = 300 + 200 * random.random((rows, cols)) + random.normal(0, 8, (8, rows, cols))
    tiles = (max(1, -(-(n // 2) // TILE)) for n in (rows, cols))
    return {
        "raw": np.rint(raw).astype(np.uint16),
        "displacement": random.normal(0, 3, (8, *tiles, 2)).astype(np.float32),
        "black_level": 64.0,
        "noise": (0.16, 100.0),
    }
