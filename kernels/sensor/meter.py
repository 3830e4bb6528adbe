"""Statistics of a frame's light, reduced on the device to a few numbers.

Ports: rates (rows, cols) float32 [e- s-1] -> (6 + 2 Q,) float32.

Values that are not finite are counted and left out of everything else. With n finite values r, and
s the same values sorted:

    max r,  sum r / n,  sqrt(sum r^2 / n),  sum w_y w_x r,  number of values left out,  min r,
    then for every fraction q of Q   s[floor(h)], s[min(floor(h) + 1, n - 1)],   h = q (n - 1) in float64,

the order statistics between which NumPy's "linear" percentile interpolates. Squares are added in
three units, 2^-100, 1 and 2^100, by the size of the value (Blue 1978, ACM TOMS 4 (1)). They thus
neither overflow nor vanish; sums that exceed float32 are infinite or NaN. Radix selection finds the
quantiles. Its keys are unsigned integers in the order of the values. They are counted by their
upper 11 bits, then those in the bin that holds the rank by the next 11, then by the last 10. Sums
have a fixed order and counts are integers, so the bits are the same from run to run.
"""

from collections.abc import Sequence
from functools import partial
from itertools import cycle

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, stage, warp_only

MOST_FRACTIONS = 4  # histograms that fit in local memory
PASSES = ((21, 11), (10, 11), (0, 10))  # shift and bits of each pass over the keys
FIELDS, BINS = 8, 2048  # as in common/meter.clh
STRIP = 2048  # columns of a row whose sums are one part
GROUPS = "sensor.meter_groups"  # the kernels of GPUs
SHARE = 8192  # pixels that a GPU's group counts
CHUNK = 65536  # pixels that a CPU's work-item counts at least
MOST_CHUNKS = 64


@stage
def meter(
    device: Device,
    rates: Array,
    weights_y: Array,
    weights_x: Array,
    fractions: Sequence[float] = (),
) -> Array:
    """Return statistics of a frame's light.

    Values that are not finite are left out of everything but their number. If no value is finite,
    the other results are 0.

    Args:
        rates: Light [e- s-1], shape (rows, cols); layers of stacked pixels follow one another along
            the rows.
        weights_y: Weights of the rows [1], shape (rows,), finite. The products of both weights
            apply to the fourth number, which is not divided by their sum.
        weights_x: Weights of the columns [1], shape (cols,), finite.
        fractions: Up to 4 numbers 0 .. 1, for quantiles.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Maximum, mean and root mean square [e- s-1], weighted sum [e- s-1], number of values that
        are NaN or infinite (exact up to 2^24), minimum [e- s-1], and for every fraction the two
        values between which NumPy interpolates [e- s-1]; shape (6 + 2 len(fractions),), float32.

    Raises:
        BadData: A shape does not fit, or there are more than 4 fractions.
        OutOfRange: A fraction is not 0 to 1.
    """
    fractions = check_inputs(rates, weights_y, weights_x, fractions)
    rows, cols = (int(size) for size in rates.shape)
    arrays = [device.array(values) for values in (rates, weights_y, weights_x)]
    out = device.empty((6 + 2 * len(fractions),))
    numbers = device.array(limbs(fractions), np.int32) if fractions else None
    (_by_groups if device.is_gpu else _by_chunks)(
        device, arrays, rows, cols, numbers, len(fractions), out
    )
    return out


def check_inputs(rates, weights_y, weights_x, fractions):
    """Return the fractions as a list of numbers. Raise BadData or OutOfRange as `meter` does."""
    if len(rates.shape) != 2 or 0 in rates.shape or rates.shape[0] * rates.shape[1] >= 2**31:
        raise BadData(
            f"rates: shape {tuple(rates.shape)}, wanted (rows, cols), fewer than 2^31 pixels"
        )
    for name, weights, size in zip(
        ("weights_y", "weights_x"), (weights_y, weights_x), rates.shape, strict=True
    ):
        if tuple(weights.shape) != (size,):
            raise BadData(f"{name}: shape {tuple(weights.shape)}, wanted ({size},)")
    fractions = [float(fraction) for fraction in fractions]
    if len(fractions) > MOST_FRACTIONS:
        raise BadData(f"fractions: {len(fractions)} of them, wanted up to {MOST_FRACTIONS}")
    for fraction in fractions:
        if not 0 <= fraction <= 1:
            raise OutOfRange("fractions", fraction, "0 <= fraction <= 1")
    return fractions


def limbs(fractions):
    """Return the fractions times 2^96 as three 32-bit integers each, highest first, (Q, 3).

    1 becomes the largest number below it. From these, the kernels find the rank of the float64
    product for any fraction of 53 bits above 2^-43.
    """
    whole = [min(int(fraction * 2.0**96), 2**96 - 1) for fraction in fractions]
    words = [[value >> shift & 0xFFFFFFFF for shift in (64, 32, 0)] for value in whole]
    return np.array(words, np.uint32).view(np.int32)


def _by_chunks(device, arrays, rows, cols, numbers, count, out):
    """Reduce on CPUs: a strip of a row, or a chunk of the frame, per work-item."""
    opencl, strips, size = device.kind == "opencl", -(-cols // STRIP), rows * cols
    launch = partial(device.launch, "sensor.meter")
    defines = {"WIDTH": 8, "STRIP": STRIP}
    group = (1,) if opencl else None
    sums = device.empty((FIELDS, rows, strips))
    launch(
        "parts",
        (rows, strips),
        *(*arrays, sums),
        *(rows, cols, strips, *warp_only(device, STRIP)),
        defines=defines,
        group=(1, 1) if opencl else None,
    )
    sums = device.reshape(sums, (FIELDS, rows * strips))
    launch("finish", (1,), sums, out, rows * strips, size, defines=defines, group=group)
    if not count:
        return
    chunk = max(CHUNK, -(-size // MOST_CHUNKS // 8) * 8)
    chunks = -(-size // chunk)
    rates = device.reshape(arrays[0], (size,))
    state = device.empty((count, 3), np.int32)
    merged = device.empty((count, BINS), np.int32)
    for shift, bits in PASSES:
        lists = 1 if shift == PASSES[0][0] else count
        counts = device.empty((chunks, lists, (2 if opencl else 1) * BINS), np.int32)
        above = device.empty((chunks, lists), np.int32)
        launch(
            "tally",
            (chunks,),
            *(rates, state, counts, above),
            *(size, chunk, shift, bits, *warp_only(device, lists)),
            defines=defines | {"LISTS": lists},
            group=group,
        )
        launch(
            "choose",
            (count,),
            *(counts, above, numbers, state, merged, out),
            *(chunks, lists, shift, bits),
            defines=defines,
            group=group,
        )


def _by_groups(device, arrays, rows, cols, numbers, count, out):
    """Reduce on GPUs: a strip of a row, or a share of the frame, per work-group."""
    strips = -(-cols // STRIP)
    size = rows * cols
    items = 256
    wide = 512 if device.group_limit >= 512 else 256
    launch = partial(device.launch, GROUPS)
    defines = {"STRIP": STRIP, "SHARE": SHARE, "ITEMS": items}
    parts = rows * strips
    sums = device.empty((FIELDS, parts))
    cleared = (BINS * (1 + 2 * count) + count) * (count > 0)
    counts = device.empty((max(cleared, 1),), np.int32)
    group = (items,)
    launch(
        "parts",
        (parts * items,),
        *(*arrays, sums, counts),
        *(rows, cols, strips, cleared),
        defines=defines,
        group=group,
    )
    launch("finish", (items,), sums, out, parts, size, defines=defines, group=group)
    if not count:
        return
    state = device.empty((count, 3), np.int32)
    rates, start = device.reshape(arrays[0], (size,)), 0
    for shift, bits in PASSES:
        lists = 1 if shift == PASSES[0][0] else count
        launch(
            "tally",
            (-(-size // SHARE) * wide,),
            *(rates, state, counts),
            *(size, start, cleared - count, shift, bits),
            defines=defines | {"ITEMS": wide, "LISTS": lists},
            group=(wide,),
        )
        launch(
            "choose",
            (count * items,),
            *(counts, numbers, state, out),
            *(start, cleared - count, lists, shift, bits),
            defines=defines,
            group=group,
        )
        start += lists * BINS


def cases():
    """Yield cases.

    One pixel to several strips; equal, extreme, negative, not finite values; quantiles' ends.
    """
    random = np.random.default_rng(11)
    quantiles = cycle(((), (0.5,), (0.01, 0.7), (0.0, 0.25, 0.999), (0.0, 0.5, 0.99, 1.0)))
    for rows, cols in ((1, 1), (3, 5), (1, 2049), (67, 131), (130, 2100), (4100, 3)):
        wild = [np.nan, np.inf, -np.inf, 1e-30, -2.0, 5.0, 1e30]
        for name, rates in (
            ("light", random.gamma(2.0, 300.0, (rows, cols))),
            ("equal", np.full((rows, cols), 0.1)),
            ("two values", random.choice([3.0, 7e3], (rows, cols))),
            ("both signs", random.normal(0, 5, (rows, cols))),
            ("zeros", np.zeros((rows, cols))),
            ("denormals", 1e-40 * random.random((rows, cols))),
            ("1e-30 to 1e30", 10.0 ** random.uniform(-30, 30, (rows, cols))),
            ("NaN and infinities", random.choice(wild, (rows, cols))),
            ("NaN", np.full((rows, cols), np.nan)),
        ):
            fractions = next(quantiles)
            name = f"{name} {rows}x{cols}, {len(fractions)} quantiles"
            yield _case(name, rates.astype(np.float32), fractions)


def _weights(size):
    weights = np.exp(-0.5 * (((np.arange(size) + 0.5) / size - 0.5) / 0.2) ** 2)
    return (weights / weights.sum()).astype(np.float32)


def _case(name, rates, fractions):
    weights_y, weights_x = map(_weights, rates.shape)
    weighting = {"weights_y": weights_y, "weights_x": weights_x}
    inputs = {"rates": rates, **weighting, "fractions": fractions}
    finite = np.where(np.isfinite(rates), rates, 0).astype(np.float64)
    weights = np.outer(weights_y, weights_x).astype(np.float64)
    plain, centre = finite / max(np.isfinite(rates).sum(), 1), weights * finite
    floor = max(np.abs(plain).sum(), np.abs(centre).sum())  # of sums that cancel
    lost = max(np.abs(part).sum() / max(abs(part.sum()), floor, 1e-300) for part in (plain, centre))
    tiny = (sum(rates.shape) + 8) * 2.0**-150 / max(floor, 2.0**-149)
    return Case(
        name,
        inputs,
        110 * 2.0**-24 * max(lost, 1.0) + tiny,
        "sums of 45 + 46 terms at most, then of parts, compensated, in trees of 8 levels (Higham 2002, 4.2): "
        "105 roundings of sum |r|, weights, squares, root and quotient included; below 2^-126 products "
        "are whole multiples of 2^-149: rows + cols of them, weighted, err by half of that",
        metric="local",
        floor=floor,
    )


def bench(rows, cols):
    """Return inputs: light with lamps and no quantile, as for exposure by the mean."""
    random = np.random.default_rng(11)
    rates = random.gamma(2.0, 300.0, (rows, cols)).astype(np.float32)
    weights = {"weights_y": _weights(rows), "weights_x": _weights(cols)}
    return {"rates": rates, **weights, "fractions": ()}
