"""Cuts, weights and sums of tiles around the transforms of common/fft.py."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import value_at

wp.set_module_options({"enable_backward": False})


@wp.kernel
def weigh(
    # in:
    planes: wp.array3d[float],
    coefficients: wp.array3d[float],
    edges_y: wp.array[int],
    edges_x: wp.array[int],
    pairs: wp.array2d[int],
    lights: wp.array[int],
    # out:
    weighted: wp.array3d[float],
    # params:
    threshold: float,
    begin: int,
    border: int,
    # sizes:
    rows: int,
    cols: int,
    tiles_x: int,
    count: int,
    size: int,
    period_y: int,
    period_x: int,
):
    k, y, x = wp.tid()
    pair = begin + k % count
    tile = pairs[pair, 0]
    ty = tile / tiles_x
    tx = tile % tiles_x
    v = edges_y[ty] + y
    u = edges_x[tx] + x
    value = float(0.0)
    if v < edges_y[ty + 1] and u < edges_x[tx + 1]:
        value = value_at(planes, lights[k / count], v, u, rows, cols, border)
        if value > threshold:
            value = 0.0
        value *= coefficients[pairs[pair, 1], wp.clamp(v, 0, rows - 1), wp.clamp(u, 0, cols - 1)]
    weighted[k, y, x] = value


@wp.kernel
def combine(
    # in:
    tables: wp.array4d[float],
    weights: wp.array2d[float],
    # out:
    combined: wp.array4d[float],
    # params:
    begin: int,
    # sizes:
    kernels: int,
    own: int,
    size: int,
    period_y: int,
    half_x: int,
):
    k, y, x = wp.tid()
    total = wp.vec2(0.0, 0.0)
    for j in range(kernels):
        at = j * own + k % own
        total += weights[begin + k / own, j] * wp.vec2(tables[at, y, x, 0], tables[at, y, x, 1])
    combined[k, y, x, 0] = total[0]
    combined[k, y, x, 1] = total[1]


@wp.kernel
def accumulate(
    # in:
    spectra: wp.array4d[float],
    tables: wp.array4d[float],
    kernel_of: wp.array[int],
    ends: wp.array[int],
    light_of: wp.array[int],
    mix: wp.array2d[float],
    # out:
    sums: wp.array4d[float],
    # params:
    first: int,
    are_summed: int,
    channels: int,
    # sizes:
    pairs: int,
    planes: int,
    tiles: int,
    period_y: int,
    half_x: int,
    pitch: int,
    own: int,
):
    t, y, x = wp.tid()
    begin = ends[first]
    for p in range(planes):
        re = float(0.0)
        im = float(0.0)
        for k in range(ends[first + t], ends[first + t + 1]):
            at = light_of[p] * pairs + k - begin
            a = spectra[at, y, x, 0]
            b = spectra[at, y, x, 1]
            kernel = k - begin
            if are_summed == 0:
                kernel = kernel_of[k]
            kernel = kernel * own + wp.min(p, own - 1)
            c = tables[kernel, y, x, 0]
            d = tables[kernel, y, x, 1]
            re += c * a - d * b
            im += c * b + d * a
        for c in range(channels):
            to = c * tiles + t
            before = wp.vec2(0.0, 0.0)
            if p > 0:
                before = wp.vec2(sums[to, y, x, 0], sums[to, y, x, 1])
            sums[to, y, x, 0] = before[0] + mix[c, p] * re
            sums[to, y, x, 1] = before[1] + mix[c, p] * im


@wp.kernel
def keep(
    # in:
    blurred: wp.array3d[float],
    # out:
    padded: wp.array4d[float],
    # params:
    first: int,
    # sizes:
    channels: int,
    size: int,
    tiles: int,
    period_y: int,
    period_x: int,
):
    k, y, x = wp.tid()
    padded[k / size, first + k % size, y, x] = blurred[k, y, x]


@wp.kernel
def assemble(
    # in:
    padded: wp.array4d[float],
    edges_y: wp.array[int],
    edges_x: wp.array[int],
    cover_y: wp.array2d[int],
    cover_x: wp.array2d[int],
    slots: wp.array[int],
    base: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    reach_y: int,
    reach_x: int,
    add_base: int,
    # sizes:
    channels: int,
    rows: int,
    cols: int,
    filled: int,
    tiles_x: int,
    period_y: int,
    period_x: int,
):
    c, y, x = wp.tid()
    total = float(0.0)
    for i in range(cover_y[y, 0], cover_y[y, 1] + 1):
        for j in range(cover_x[x, 0], cover_x[x, 1] + 1):
            slot = slots[i * tiles_x + j]
            if slot >= 0:
                total += padded[c, slot, y - edges_y[i] + reach_y, x - edges_x[j] + reach_x]
    if add_base != 0:
        total += base[c, y, x]
    out[c, y, x] = total


@wp.kernel
def spread(
    # in:
    places: wp.array2d[int],
    kernels: wp.array4d[float],
    corners: wp.array2d[int],
    starts: wp.array[int],
    listed: wp.array[int],
    # out:
    out: wp.array3d[float],
    # sizes:
    channels: int,
    rows: int,
    cols: int,
    m: int,
    n: int,
    squares: int,
):
    c, dy, dx = wp.tid()
    at = dy / 32
    y = corners[at, 0] + dy % 32
    x = corners[at, 1] + dx
    total = float(0.0)
    for i in range(starts[at], starts[at + 1]):
        k = listed[i]
        a = y - places[k, 0] + m / 2
        b = x - places[k, 1] + n / 2
        if a >= 0 and a < m and b >= 0 and b < n:
            total += kernels[k, c, a, b]
    if y < rows and x < cols:
        out[c, y, x] = out[c, y, x] + total
