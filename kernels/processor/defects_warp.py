"""One pixel per thread: as defects.cl on a GPU."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_PAIR = wp.constant(wp.uint32(0xFFFFFFFF))


@wp.func
def is_inside(y: int, x: int, rows: int, cols: int):
    return y >= 0 and y < rows and x >= 0 and x < cols


@wp.kernel
def mark(
    # in:
    raw: wp.array2d[wp.uint16],
    near: wp.array3d[int],
    masks: wp.array2d[wp.uint16],
    # out:
    flags: wp.array2d[wp.uint8],
    # params:
    black_level: float,
    per_level: float,
    constant_part: float,
    reach: int,
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
    count: int,
):
    y, x = wp.tid()
    phase = (y % period_y) * period_x + x % period_x
    low = int(65536)
    high = int(-1)
    spread = int(0)
    for n in range(count):
        v = y + near[phase, n, 0]
        u = x + near[phase, n, 1]
        if is_inside(v, u, rows, cols):
            low = wp.min(low, int(raw[v, u]))
            high = wp.max(high, int(raw[v, u]))
    for n in range(count, count + 4):
        v = y + near[phase, n + 4, 0]
        u = x + near[phase, n + 4, 1]
        if is_inside(v, u, rows, cols):
            spread += int(raw[y + near[phase, n, 0], x + near[phase, n, 1]]) - int(raw[v, u])
    here = int(raw[y, x])
    excess = low - here
    end = low
    if here > high:
        excess = here - high
        end = high
    else:
        spread = -spread
    limit = per_level * wp.max(float(end) - black_level, 0.0) + constant_part
    flag = wp.uint8(0)
    if high >= 0 and excess > 0 and excess > high - low and float(excess) * float(excess) > limit:
        if 8 * spread <= excess or float(spread) * float(spread) <= limit:
            flag = wp.uint8(255)
    flags[y, x] = flag


@wp.kernel
def replace(
    # in:
    raw: wp.array2d[wp.uint16],
    flags: wp.array2d[wp.uint8],
    starts: wp.array[int],
    entries: wp.array2d[int],
    # out:
    out: wp.array2d[wp.uint16],
    # sizes:
    period_y: int,
    period_x: int,
    rows: int,
    cols: int,
):
    y, x = wp.tid()
    result = raw[y, x]
    if flags[y, x] != wp.uint8(0):
        at = (y % period_y) * period_x + x % period_x
        nearest = int(-1)
        good = int(0)
        group = int(-1)
        sum = wp.uint32(0)
        best = NO_PAIR
        for n in range(starts[at], starts[at + 1]):
            v = y + entries[n, 0]
            u = x + entries[n, 1]
            if (group < 0 or entries[n, 3] == group) and is_inside(v, u, rows, cols):
                if flags[v, u] == wp.uint8(0):
                    value = wp.uint32(raw[v, u])
                    if nearest < 0 or entries[n, 3] == nearest:
                        nearest = entries[n, 3]
                        sum += value
                        good += 1
                    v2 = y - entries[n, 0]
                    u2 = x - entries[n, 1]
                    if entries[n, 2] != 0 and is_inside(v2, u2, rows, cols):
                        if flags[v2, u2] == wp.uint8(0):
                            other = wp.uint32(raw[v2, u2])
                            difference = wp.max(value, other) - wp.min(value, other)
                            mean = (value + other + wp.uint32(1)) / wp.uint32(2)
                            best = wp.min(best, difference * wp.uint32(65536) + mean)
                            group = entries[n, 3]
        if group >= 0:
            result = wp.uint16(best % wp.uint32(65536))
        elif good > 0:
            result = wp.uint16((wp.uint32(2) * sum + wp.uint32(good)) / wp.uint32(2 * good))
    out[y, x] = result
