"""As meter.cl, a strip or chunk per thread, for Warp's CPU device; GPUs run meter_groups.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MOST_FINITE = wp.constant(3.4028234663852886e38)
EXPONENT = wp.constant(wp.uint32(0x7F800000))
SIGN = wp.constant(wp.uint32(0x80000000))
NONE = wp.constant(wp.uint32(0xFFFFFFFF))
ZERO = wp.constant(wp.uint32(0))
LARGE = wp.constant(4503599627370496.0)
SMALL = wp.constant(2.220446049250313e-16)
UP = wp.constant(1.2676506002282294e30)
DOWN = wp.constant(7.888609052210118e-31)
BINS = wp.constant(2048)
FIRST_SHIFT = wp.constant(21)
BLOCK = wp.constant(45)  # about the root of a strip: sums of as many terms as there are blocks
Sums = wp.types.vector(length=5, dtype=float)
Fields = wp.types.vector(length=6, dtype=float)


@wp.func
def key_of(value: float):
    """Return unsigned numbers in the order of the values."""
    bits = wp.cast(value, wp.uint32)
    key = bits | SIGN
    if (bits & SIGN) != ZERO:
        key = ~bits
    if (bits & EXPONENT) == EXPONENT:
        key = NONE
    return key


@wp.func
def value_of(key: wp.uint32):
    bits = ~key
    if (key & SIGN) != ZERO:
        bits = key & ~SIGN
    return wp.cast(bits, wp.float32)


@wp.func
def rank_of(a: wp.uint32, b: wp.uint32, c: wp.uint32, most: wp.uint32):
    """Return floor(q most) as float64 rounds the product; see meter.clh."""
    sum = (wp.uint64(c) * wp.uint64(most)) >> wp.uint64(32)
    sum += wp.uint64(b) * wp.uint64(most)
    low = sum & wp.uint64(0xFFFFFFFF)
    sum = (sum >> wp.uint64(32)) + wp.uint64(a) * wp.uint64(most)
    whole = int(sum >> wp.uint64(32))
    part = (sum << wp.uint64(32)) | low
    half_unit = wp.uint64(1024)
    left = int(whole)
    while left > 0:
        half_unit = half_unit * wp.uint64(2)
        left = left >> 1
    if part + half_unit < part:
        whole += 1
    return whole


@wp.func
def root_mean_square(large: float, middle: float, small: float, count: float):
    if large > 0.0:
        return wp.sqrt((large + middle * DOWN * DOWN) / count) * UP
    if middle > 0.0:
        return wp.sqrt((middle + small * DOWN * DOWN) / count)
    return wp.sqrt(small / count) * DOWN


@wp.kernel
def parts(
    # in:
    rates: wp.array2d[float],
    weights_y: wp.array[float],
    weights_x: wp.array[float],
    # out:
    sums: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    strips: int,
    width: int,
):
    y, strip = wp.tid()
    end = wp.min((strip + 1) * width, cols)
    high = float(-MOST_FINITE)
    low = float(MOST_FINITE)
    left_out = float(0.0)
    total = Sums()
    block = int(strip * width)
    while block < end:
        sum = Sums()
        for x in range(block, wp.min(block + BLOCK, end)):
            value = rates[y, x]
            if (wp.cast(value, wp.uint32) & EXPONENT) == EXPONENT:
                left_out += 1.0
            else:
                high = wp.max(high, value)
                low = wp.min(low, value)
                sum[0] += value
                sum[1] += value * weights_x[x]
                if wp.abs(value) >= LARGE:
                    sum[2] += (value * DOWN) * (value * DOWN)
                elif wp.abs(value) < SMALL:
                    sum[4] += (value * UP) * (value * UP)
                else:
                    sum[3] += value * value
        total += sum
        block += BLOCK
    sums[0, y, strip] = high
    sums[1, y, strip] = low
    sums[2, y, strip] = total[0]
    sums[3, y, strip] = total[1] * weights_y[y]
    sums[4, y, strip] = total[2]
    sums[5, y, strip] = total[3]
    sums[6, y, strip] = total[4]
    sums[7, y, strip] = left_out


@wp.kernel
def finish(
    # in:
    sums: wp.array2d[float],
    # out:
    out: wp.array[float],
    # sizes:
    count: int,
    size: int,
):
    high = float(-MOST_FINITE)
    low = float(MOST_FINITE)
    total = Fields()
    rest = Fields()
    for i in range(count):
        high = wp.max(high, sums[0, i])
        low = wp.min(low, sums[1, i])
        for k in range(6):
            value = sums[k + 2, i]
            next = total[k] + value
            other = next - total[k]
            rest[k] += (total[k] - (next - other)) + (value - other)
            total[k] = next
    total += rest
    finite = float(size - int(total[5]))
    for k in range(6):
        out[k] = 0.0
    out[3] = total[1]
    out[4] = total[5]
    if finite > 0.0:
        out[0] = high
        out[1] = total[0] / finite
        out[2] = root_mean_square(total[2], total[3], total[4], finite)
        out[5] = low


@wp.kernel
def tally(
    # in:
    rates: wp.array[float],
    state: wp.array2d[int],
    # out:
    counts: wp.array3d[int],
    above: wp.array2d[int],
    # sizes:
    size: int,
    chunk: int,
    shift: int,
    bits: int,
    lists: int,
):
    item = wp.tid()
    for list in range(lists):
        for bin in range(BINS):
            counts[item, list, bin] = 0
        prefix = ZERO
        if shift != FIRST_SHIFT:
            prefix = wp.uint32(state[list, 0])
        best = wp.uint32(0)
        for i in range(item * chunk, wp.min((item + 1) * chunk, size)):
            key = key_of(rates[i])
            high = key >> wp.uint32(shift)
            start = high >> wp.uint32(bits)
            if start == prefix:
                bin = int(high & wp.uint32((1 << bits) - 1))
                counts[item, list, bin] = counts[item, list, bin] + 1
            elif start > prefix:
                best = wp.max(best, ~key)
        above[item, list] = int(best)


@wp.kernel
def choose(
    # in:
    counts: wp.array3d[int],
    above: wp.array2d[int],
    fractions: wp.array2d[int],
    # out:
    state: wp.array2d[int],
    merged: wp.array2d[int],
    out: wp.array[float],
    # sizes:
    chunks: int,
    lists: int,
    shift: int,
    bits: int,
):
    f = wp.tid()
    list = wp.where(lists == 1, 0, f)
    beyond = wp.uint32(0)
    for bin in range(BINS):
        merged[f, bin] = 0
    for chunk in range(chunks):
        for bin in range(BINS):
            merged[f, bin] = merged[f, bin] + counts[chunk, list, bin]
        beyond = wp.max(beyond, wp.uint32(above[chunk, list]))
    prefix = wp.uint32(state[f, 0])
    rank = int(state[f, 1])
    finite = int(state[f, 2])
    if shift == FIRST_SHIFT:
        finite = int(0)
        for bin in range(BINS - 1):  # the last one counts values that are not finite
            finite += merged[f, bin]
        prefix = wp.uint32(0)
        rank = 0
        if finite > 0:
            rank = rank_of(
                wp.uint32(fractions[f, 0]),
                wp.uint32(fractions[f, 1]),
                wp.uint32(fractions[f, 2]),
                wp.uint32(finite - 1),
            )
    found = int(0)
    while found < BINS - 1 and rank >= merged[f, found]:
        rank -= merged[f, found]
        found += 1
    prefix = (prefix << wp.uint32(bits)) | wp.uint32(found)
    state[f, 0] = int(prefix)
    state[f, 1] = rank
    state[f, 2] = finite
    if shift == 0:
        next = prefix
        if rank + 1 >= merged[f, found]:
            other = found + 1
            while other < BINS and merged[f, wp.min(other, BINS - 1)] == 0:
                other += 1
            if other < BINS:
                next = prefix + wp.uint32(other - found)
            elif beyond != ZERO:
                next = ~beyond
        out[6 + 2 * f] = wp.where(finite > 0, value_of(prefix), 0.0)
        out[7 + 2 * f] = wp.where(finite > 0, value_of(next), 0.0)
