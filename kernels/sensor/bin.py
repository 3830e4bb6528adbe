"""Binning: neighbours of one colour become one pixel, as charge or as digital numbers.

Ports: pixels (rows, cols) float32 [e-] or uint16 [DN] -> (out_rows, out_cols) of the same type and
unit.

Pixels of one colour are `stride` apart along both axes: the mosaic's period, or 1 if `binning`
pixels of one colour are adjacent (`gpusim.domain.mosaics`). Output row Y sums, with a = Y mod
stride and B = Y div stride, the rows

    B stride binning + a + stride j,   j = 0 .. binning - 1.

Columns do the same. The binned frame thus has the same mosaic, in whole periods. Rows and columns
beyond the last whole block of stride x binning are left out. Blocks of a mosaic interlock, so the
middles of binned pixels do not lie on an even grid: 2 x 2 in a Bayer mosaic puts them 1 and 3
pixels apart, in turn.

Charges: the rows of every column are added first, from the top, then the columns' sums, from the
left. Each addition is rounded to float32, so the bits are the same on every device. (A CCD adds in
this order, too.) Numbers: the sum, limited to 65535; or the mean, rounded to nearest, halves to
even. Black levels add up like everything else: the black level of a sum is binning_y binning_x
times as high, and a mean keeps it.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, dtype_name, exact_case, is_opencl_cpu, stage, warp_only

MOST = 8  # pixels along one axis: 64 numbers of 16 bits add up below 2^24, exactly in float32
# columns that a CPU's work-item holds, about: 4 KiB, so they stay in the nearest cache
CHUNK = 1024


@stage
def bin(
    device: Device,
    pixels: Array,
    *,
    binning: tuple[int, int],
    stride: tuple[int, int] = (1, 1),
    average: bool = False,
) -> Array:
    """Sum, or average, `binning` pixels that are `stride` apart.

    Args:
        pixels: Charges [e-], float32, or digital numbers [DN], uint16, shape (rows, cols).
        binning: Rows and columns that become one, 1 to 8.
        stride: Distance of neighbours of one colour along both axes [pixel].
        average: Return the mean of digital numbers instead of the sum. Charges are always added.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Binned pixels, shape `binned_shape(pixels.shape, binning, stride)`, in the type of `pixels`.

    Raises:
        BadData: `pixels` are neither charges nor digital numbers, or `average` is set for charges.
        OutOfRange: A factor is not 1 to 8, a stride is not positive, or no block fits into the
            frame.

    Source:
        Theuwissen 1995, Solid-State Imaging with Charge-Coupled Devices (charge is added without
        loss).
    """
    digital = check_pixels(pixels, average)
    cols = pixels.shape[1]
    out_shape = binned_shape(pixels.shape, binning, stride)
    pixels = device.array(pixels, np.uint16 if digital else np.float32)
    out = device.empty(out_shape, np.uint16 if digital else np.float32)
    # Along a row the block is known at compile time: its columns are picked without gathers.
    defines = {
        "PIXEL": "ushort" if digital else "float",
        "DIGITAL": int(digital),
        "BINNING_X": binning[1],
        "STRIDE_X": stride[1],
        "BLOCKS": 0 if device.is_gpu else max(1, CHUNK // (stride[1] * binning[1])),
    }
    grid = (out_shape[0], 1) if is_opencl_cpu(device) else out_shape
    arrays = [pixels, out]
    numbers = [int(binning[0]), int(stride[0]), int(average)]
    sizes = [cols, *out_shape, *warp_only(device, binning[1], stride[1], int(digital))]
    group = None if device.is_gpu else (1, 1)
    device.launch(
        "sensor.bin", "bin", grid, *arrays, *numbers, *sizes, defines=defines, group=group
    )
    return out


def check_pixels(pixels, average) -> bool:
    """Return True for digital numbers, False for charges. Raise BadData for anything else."""
    kind = dtype_name(pixels)
    if len(pixels.shape) != 2 or kind not in ("uint16", "float32", "float64"):
        raise BadData(
            f"pixels: {kind}, shape {tuple(pixels.shape)}; wanted (rows, cols) of charges, float32, or of "
            "digital numbers, uint16"
        )
    if average and kind != "uint16":
        raise BadData("average: charges are added; only digital numbers, uint16, can be averaged")
    return kind == "uint16"


def binned_shape(
    shape: Sequence[int], binning: tuple[int, int], stride: tuple[int, int] = (1, 1)
) -> tuple[int, int]:
    """Return rows and columns of the binned frame.

    Args:
        shape: Rows and columns of the frame.
        binning: Rows and columns that become one, 1 to 8.
        stride: Distance of neighbours of one colour along both axes [pixel].

    Returns:
        Rows and columns.

    Raises:
        OutOfRange: A factor is not 1 to 8, a stride is not positive, or no block fits into the
            frame.
    """
    for axis, factor, step in zip(("rows", "columns"), binning, stride, strict=True):
        if factor not in range(1, MOST + 1):
            raise OutOfRange(f"binning ({axis})", factor, f"a whole number, 1 <= binning <= {MOST}")
        if not (step >= 1 and step == int(step)):
            raise OutOfRange(f"stride ({axis})", step, "a whole number, stride >= 1")
    rows, cols = (
        size // (factor * step) * step
        for size, factor, step in zip(shape, binning, stride, strict=True)
    )
    if not (rows and cols):
        raise OutOfRange(
            "frame",
            f"{shape[1]}x{shape[0]} pixels",
            f"at least {binning[1] * stride[1]}x{binning[0] * stride[0]}, one block of binning "
            f"{binning[1]}x{binning[0]} in this mosaic; use a larger frame or less binning",
        )
    return rows, cols


def cases():
    """Yield cases.

    Bayer, X-Trans and cells of one colour, the largest factors, odd sizes, long rows; charges and
    numbers.
    """
    random = np.random.default_rng(11)
    charges = "the same float32 additions in the same order"
    numbers = "sums below 2^24 are exact, and so is the rounding of their mean"
    blocks = (
        *((1, 1, 1, 1), (2, 2, 1, 1), (3, 2, 1, 1), (2, 2, 2, 2), (3, 3, 2, 2), (3, 2, 4, 2)),
        *((2, 2, 6, 6), (8, 8, 8, 1)),
    )
    sizes = [((by, bx), (sy, sx), (4 * by * sy + 1, 5 * bx * sx + 3)) for by, bx, sy, sx in blocks]
    sizes += [((2, 2), (2, 2), (4, 4)), ((2, 2), (2, 2), (7, 4103)), ((1, 2), (2, 1), (5, 5000))]
    for binning, stride, (rows, cols) in sizes:
        inputs = {"binning": binning, "stride": stride}
        name = f"{rows}x{cols}, binning {binning}, stride {stride}"
        values = (10.0 ** random.uniform(-6, 6, (rows, cols))).astype(np.float32)
        yield exact_case(f"charges {name}", charges, pixels=values, **inputs)
        values = random.integers(0, 65536, (rows, cols), np.uint16)
        for label, average in (("sums", False), ("means", True)):
            yield exact_case(f"{label} {name}", numbers, pixels=values, **inputs, average=average)
    values = np.ones((8, 12), np.float32)
    values[2, 3], values[5, 6], values[0, 11] = np.nan, np.inf, 1e-45
    pairs = {"binning": (2, 2), "stride": (2, 2)}
    yield exact_case("NaN and infinity stay in their block", charges, pixels=values, **pairs)


def bench(rows, cols):
    """Return inputs: charges of a Bayer mosaic, 2 x 2."""
    pixels = np.random.default_rng(11).random((rows, cols), np.float32)
    return {"pixels": pixels, "binning": (2, 2), "stride": (2, 2)}
