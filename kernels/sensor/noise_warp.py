"""From mean electrons to digital numbers, one pixel per thread. `noise_ref` has the formulas."""

# mypy: ignore-errors
from functools import cache

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.exact_warp import exact_normal_pair
from gpusim.kernels.common.philox_warp import philox
from gpusim.kernels.common.poisson_warp import poisson, poisson_exact

OPTIONS = {"enable_backward": False, "fuse_fp": False}
wp.set_module_options(OPTIONS)

MOST_EXPECTED = wp.constant(1e30)
TEMPORAL = wp.constant(wp.uint32(0))
TELEGRAPH_STREAM = wp.constant(wp.uint32(4))
ROW_STREAM = wp.constant(wp.uint32(5))
COLUMN_STREAM = wp.constant(wp.uint32(6))


@wp.func
def trap_state(
    pixel: wp.uint32,
    frame: wp.uint32,
    switching: wp.uint32,
    seed_low: wp.uint32,
    seed_high: wp.uint32,
):
    """Return the state of a pixel's trap, 0 or 1, from the last frame in which it was drawn."""
    at = wp.uint32(frame)
    words = philox(pixel, wp.uint32(0), at >> wp.uint32(2), TELEGRAPH_STREAM, seed_low, seed_high)
    word = words[int(at & wp.uint32(3))]
    while at != wp.uint32(0) and (word >> wp.uint32(1)) > switching:
        if (at & wp.uint32(3)) == wp.uint32(0):
            words = philox(
                pixel,
                wp.uint32(0),
                (at >> wp.uint32(2)) - wp.uint32(1),
                TELEGRAPH_STREAM,
                seed_low,
                seed_high,
            )
        at -= wp.uint32(1)
        word = words[int(at & wp.uint32(3))]
    return float(word & wp.uint32(1))


@cache
def specialise(kernel, PHOTON, READ_NOISE, OFFSET, TELEGRAPH, LINES, CONVERTER, WIDTH):
    """Return the kernel of this name with only the necessary code; constants as in OpenCL."""
    if kernel == "lines":
        return lines
    value = wp.uint16 if CONVERTER else wp.float32

    @wp.kernel(module="unique", module_options=OPTIONS)
    def noise(
        # in:
        expected: wp.array2d[float],
        offset: wp.array2d[float],
        amplitude: wp.array2d[float],
        lines: wp.array2d[float],
        # out:
        out: wp.array3d[value],
        # sizes and numbers:
        rows: int,
        cols: int,
        first_pixel: int,
        frame_cols: int,
        switching: int,
        full_well: float,
        white_level: float,
        read: int,
        # numbers by name:
        dark_electrons: float,
        read_noise: float,
        gain: float,
        black_level: float,
        seed_low: int,
        seed_high: int,
        first_frame: int,
    ):
        number, y, x = wp.tid()
        frame = wp.uint32(first_frame) + wp.uint32(number)
        pixel = wp.uint32(first_pixel) + wp.uint32(y) * wp.uint32(frame_cols) + wp.uint32(x)
        low = wp.uint32(seed_low)
        high = wp.uint32(seed_high)
        electrons = expected[y, x]
        electrons = wp.where(electrons > MOST_EXPECTED, MOST_EXPECTED, electrons)
        electrons = wp.where(electrons < 0.0, 0.0, electrons) + dark_electrons
        words = philox(pixel, wp.uint32(read), frame, TEMPORAL, low, high)
        z = exact_normal_pair(words[0], words[1])
        if wp.static(PHOTON == 1):
            electrons = poisson(electrons, words[2], words[3], z[0])
        if wp.static(PHOTON == 2):
            electrons = poisson_exact(electrons, words[2], words[3])
        electrons = wp.where(electrons > full_well, full_well, electrons)
        if wp.static(READ_NOISE):
            electrons = electrons + read_noise * z[1]
        if wp.static(OFFSET):
            electrons = electrons + offset[y, x]
        if wp.static(TELEGRAPH):
            size = amplitude[y, x]
            if size > 0.0:
                electrons = electrons + size * trap_state(
                    pixel, frame, wp.uint32(switching), low, high
                )
        if wp.static(LINES):
            electrons = electrons + lines[number, y]
            electrons = electrons + lines[number, rows + x]
        level = gain * electrons + black_level
        if wp.static(CONVERTER):
            level = wp.where(level > 0.0, level, 0.0)  # NaN too
            level = wp.rint(wp.where(level < white_level, level, white_level))
        out[number, y, x] = value(level)

    return noise


@wp.kernel
def lines(
    # out:
    out: wp.array2d[float],
    # sizes and numbers:
    frames: int,
    rows: int,
    cols: int,
    first_row: int,
    first_col: int,
    row_noise: float,
    column_noise: float,
    read: int,
    # numbers by name:
    seed_low: int,
    seed_high: int,
    first_frame: int,
):
    """Return the noise that every row and every column of a frame have in common: rows first."""
    number, i = wp.tid()
    down = i < rows
    line = wp.where(down, first_row + i, first_col + i - rows)
    words = philox(
        wp.uint32(line),
        wp.uint32(read),
        wp.uint32(first_frame) + wp.uint32(number),
        wp.where(down, ROW_STREAM, COLUMN_STREAM),
        wp.uint32(seed_low),
        wp.uint32(seed_high),
    )
    z = exact_normal_pair(words[0], words[1])
    out[number, i] = wp.where(down, row_noise, column_noise) * z[0]
