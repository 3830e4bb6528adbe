"""Fixed patterns of one chip, one pixel per thread. `pattern_ref` has the formulas."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.exact_warp import TWO_TO_MINUS_32, exact_log, exact_normal_pair
from gpusim.kernels.common.philox_warp import philox

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

PIXEL = wp.constant(wp.uint32(1))
ROW = wp.constant(wp.uint32(2))
COLUMN = wp.constant(wp.uint32(3))


@wp.kernel
def pattern(
    # out:
    out: wp.array2d[float],
    # sizes and numbers:
    rows: int,
    cols: int,
    first_row: int,
    first_col: int,
    frame_cols: int,
    plane: int,
    mean: float,
    per_pixel: float,
    per_row: float,
    per_column: float,
    some_dead: int,
    dead: int,
    some_chosen: int,
    share: int,
    scale: float,
    seed_low: int,
    seed_high: int,
):
    y, x = wp.tid()
    row = wp.uint32(first_row + y)
    column = wp.uint32(first_col + x)
    place = row * wp.uint32(frame_cols) + column
    draw = wp.uint32(plane)
    low = wp.uint32(seed_low)
    high = wp.uint32(seed_high)
    words = philox(place, draw, wp.uint32(0), PIXEL, low, high)
    of_row = philox(row, draw, wp.uint32(0), ROW, low, high)
    of_column = philox(column, draw, wp.uint32(0), COLUMN, low, high)
    own = exact_normal_pair(words[0], words[1])
    in_row = exact_normal_pair(of_row[0], of_row[1])
    in_column = exact_normal_pair(of_column[0], of_column[1])
    value = mean + per_pixel * own[0]
    value = value + per_row * in_row[0]
    value = value + per_column * in_column[0]
    if some_dead != 0:
        value = wp.where(words[2] <= wp.uint32(dead), 0.0, value)
    if some_chosen != 0:
        more = scale * -exact_log((float(words[3]) + 0.5) * TWO_TO_MINUS_32)
        chosen = philox(place, draw, wp.uint32(1), PIXEL, low, high)
        value = wp.where(chosen[0] <= wp.uint32(share), value + more, value)
    out[y, x] = value
