"""One pixel of all planes with one grid per thread; places are offsets from its index."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import inside

wp.set_module_options({"enable_backward": False})

TILE_ROWS = wp.constant(4)  # as in distort.py
TILE_COLS = wp.constant(64)


@wp.func
def first_node(half_steps: int, n: int, count: int):
    return wp.clamp(int(float(half_steps * (count - 1)) * (0.5 / float(n))) - 1, 0, count - 4)


@wp.func
def lagrange(half_steps: int, n: int, count: int, first: int):
    # Weights of four nodes for half-pixel number `half_steps` of 2 n, 0 the frame's edge. Whole numbers while
    # possible: the fraction is then as exact in the last cell as in the first.
    s = float(half_steps * (count - 1) - first * 2 * n) * (0.5 / float(n))
    s1 = s - 1.0
    s2 = s - 2.0
    s3 = s - 3.0
    return wp.vec4(-s1 * s2 * s3 / 6.0, s * s2 * s3 * 0.5, -s * s1 * s3 * 0.5, s * s1 * s2 / 6.0)


@wp.func
def keys(s: float):  # weights of the samples -1, 0, 1, 2 at s in 0 .. 1
    r = 1.0 - s
    return 0.5 * wp.vec4(
        -s * r * r, 2.0 - s * s * (5.0 - 3.0 * s), 2.0 - r * r * (5.0 - 3.0 * r), -r * s * s
    )


@wp.kernel
def along_columns(
    # in:
    grids: wp.array3d[float],
    # out:
    lines: wp.array3d[float],
    # sizes:
    maps: int,
    ny: int,
    values: int,
    rows: int,
):
    # once for every half-pixel row that the pixels' centres and corners lie on
    m, half_y, j = wp.tid()
    i = first_node(half_y, rows, ny)
    w = lagrange(half_y, rows, ny, i)
    total = float(0.0)  # of differences: nodes that are equal have no rounding
    for a in range(1, 4):
        total += w[a] * (grids[m, i + a, j] - grids[m, i, j])
    lines[m, half_y, j] = grids[m, i, j] + total


@wp.func
def place(lines: wp.array3d[float], m: int, half_y: int, half_x: int, nx: int, cols: int):
    j = first_node(half_x, cols, nx)
    w = lagrange(half_x, cols, nx, j)
    at = 3 * j
    first = wp.vec3(lines[m, half_y, at], lines[m, half_y, at + 1], lines[m, half_y, at + 2])
    total = wp.vec3(0.0, 0.0, 0.0)
    for b in range(1, 4):
        at = 3 * (j + b)
        own = wp.vec3(lines[m, half_y, at], lines[m, half_y, at + 1], lines[m, half_y, at + 2])
        total += w[b] * (own - first)
    return first + total


@wp.func
def tile_place(block: int, across: int, y: int, x: int, rows: int):
    """Return grid, row and column of a work-item: a block of 256 has a tile of the frame, whose samples overlap."""
    per = (rows + TILE_ROWS - 1) // TILE_ROWS
    m = block // per
    return m, (block - m * per) * TILE_ROWS + y, across * TILE_COLS + x


@wp.kernel
def cubic(
    # in:
    planes: wp.array3d[float],
    lines: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    border: int,
    per_map: int,
    # sizes:
    source_rows: int,
    source_cols: int,
    nx: int,
    maps: int,
    rows: int,
    cols: int,
):
    block, across, in_y, in_x = wp.tid()
    m, y, x = tile_place(block, across, in_y, in_x, rows)
    if y >= rows or x >= cols:
        return
    at = place(lines, m, 2 * y + 1, 2 * x + 1, nx, cols)
    floor_y = wp.floor(at[0])
    floor_x = wp.floor(at[1])
    first_y = y + int(floor_y) - 1
    first_x = x + int(floor_x) - 1
    wy = keys(at[0] - floor_y)
    wx = keys(at[1] - floor_x)
    if first_y >= 0 and first_x >= 0 and first_y + 4 <= source_rows and first_x + 4 <= source_cols:
        for p in range(m * per_map, (m + 1) * per_map):  # nearly everywhere
            total = float(0.0)
            for a in range(4):
                row = float(0.0)
                for b in range(4):
                    row += wx[b] * planes[p, first_y + a, first_x + b]
                total += wy[a] * row
            out[p, y, x] = at[2] * total
        return
    for p in range(m * per_map, (m + 1) * per_map):
        total = float(0.0)
        for a in range(4):
            sy = inside(first_y + a, source_rows, border)
            for b in range(4):
                sx = inside(first_x + b, source_cols, border)
                if border != 0 or (sy == first_y + a and sx == first_x + b):
                    total += wy[a] * wx[b] * planes[p, sy, sx]
        out[p, y, x] = at[2] * total


@wp.func
def mean_clamped(t0: float, t1: float):  # mean of clamp(t, 0, 1) over t between t0 and t1
    # (difference of the antiderivatives) / (t1 - t0), without cancellation for t1 close to t0
    low = wp.min(t0, t1)
    high = wp.max(t0, t1)
    a = wp.clamp(low, 0.0, 1.0)
    b = wp.clamp(high, 0.0, 1.0)
    mean = a
    if high > low:
        mean = ((b - a) * (0.5 * (a + b)) + (wp.max(high, 1.0) - wp.max(low, 1.0))) / (high - low)
    return mean


@wp.func
def below(y0: float, x0: float, y1: float, x1: float):
    # signed area within the unit square between its lower side and the edge (x0, y0) -> (x1, y1)
    d = x1 - x0
    a = wp.clamp(x0, 0.0, 1.0)
    b = wp.clamp(x1, 0.0, 1.0)
    total = float(0.0)
    if d != 0.0:
        t0 = wp.clamp((a - x0) / d, 0.0, 1.0)
        t1 = wp.clamp((b - x0) / d, 0.0, 1.0)
        total = (b - a) * mean_clamped(y0 + t0 * (y1 - y0), y0 + t1 * (y1 - y0))
    return total


@wp.kernel
def area(
    # in:
    planes: wp.array3d[float],
    lines: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    density: float,
    span: int,
    border: int,
    per_map: int,
    # sizes:
    source_rows: int,
    source_cols: int,
    nx: int,
    maps: int,
    rows: int,
    cols: int,
):
    m, y, x = wp.tid()
    c00 = place(lines, m, 2 * y, 2 * x, nx, cols)
    c10 = place(lines, m, 2 * y + 2, 2 * x, nx, cols)
    c11 = place(lines, m, 2 * y + 2, 2 * x + 2, nx, cols)
    c01 = place(lines, m, 2 * y, 2 * x + 2, nx, cols)
    # corners from the first sample that the quadrilateral touches
    low_y = wp.floor(wp.min(wp.min(c00[0], c01[0]), 1.0 + wp.min(c10[0], c11[0])))
    low_x = wp.floor(wp.min(wp.min(c00[1], c10[1]), 1.0 + wp.min(c01[1], c11[1])))
    y00 = c00[0] - low_y
    y10 = 1.0 + (c10[0] - low_y)
    y11 = 1.0 + (c11[0] - low_y)
    y01 = c01[0] - low_y
    x00 = c00[1] - low_x
    x10 = c10[1] - low_x
    x11 = 1.0 + (c11[1] - low_x)
    x01 = 1.0 + (c01[1] - low_x)
    first_y = y + int(low_y)
    first_x = x + int(low_x)
    for p in range(m * per_map, (m + 1) * per_map):
        out[p, y, x] = 0.0
    for i in range(span):
        sy = inside(first_y + i, source_rows, border)
        a = float(i)
        for j in range(span):
            sx = inside(first_x + j, source_cols, border)
            b = float(j)
            overlap = (
                below(y00 - a, x00 - b, y10 - a, x10 - b)
                + below(y10 - a, x10 - b, y11 - a, x11 - b)
                + below(y11 - a, x11 - b, y01 - a, x01 - b)
                + below(y01 - a, x01 - b, y00 - a, x00 - b)
            )
            if overlap > 0.0 and (border != 0 or (sy == first_y + i and sx == first_x + j)):
                for p in range(m * per_map, (m + 1) * per_map):
                    out[p, y, x] = out[p, y, x] + density * overlap * planes[p, sy, sx]


@wp.kernel
def rooms(
    # in:
    light: wp.array3d[float],
    # out:
    room: wp.array2d[float],
    # params:
    top: int,
    left: int,
    # sizes:
    channels: int,
    rows: int,
    cols: int,
    high: int,
    wide: int,
):
    # part of the samples next to a cell, outside of it, that its interpolants can take above 0
    dy, dx = wp.tid()
    y = top + dy
    x = left + dx
    least = float(1.0)
    for c in range(channels):
        highest = float(0.0)
        lowest = wp.max(light[c, y, x], 0.0)
        for i in range(4):
            for j in range(4):
                value = wp.max(light[c, y + i, x + j], 0.0)
                highest = wp.max(highest, value)
                lowest = wp.min(lowest, value)
        # else the positive weights, 4.55 times the negative ones or more, prevail
        if not (highest <= 4.5 * lowest):
            for v in range(3):
                wy = keys(0.3 + 0.2 * float(v))
                for u in range(3):
                    wx = keys(0.3 + 0.2 * float(u))
                    with_it = float(0.0)
                    against = float(0.0)
                    for i in range(4):
                        for j in range(4):
                            part = wy[i] * wx[j] * wp.max(light[c, y + i, x + j], 0.0)
                            with_it += wp.max(part, 0.0)
                            against -= wp.min(part, 0.0)
                    if against > with_it:
                        least = wp.min(least, wp.max(2.0 * (with_it / against) - 1.0, 0.0))
    room[y, x] = least


@wp.kernel
def shares(
    # in:
    room: wp.array2d[float],
    # out:
    share: wp.array2d[float],
    # params:
    top: int,
    left: int,
    # sizes:
    rows: int,
    cols: int,
    high: int,
    wide: int,
):
    # as much of each sample as the cells allow where its weight is negative
    y, x = wp.tid()
    down = wp.min(
        wp.min(room[y, x + 1], room[y, x + 2]), wp.min(room[y + 3, x + 1], room[y + 3, x + 2])
    )
    across = wp.min(
        wp.min(room[y + 1, x], room[y + 2, x]), wp.min(room[y + 1, x + 3], room[y + 2, x + 3])
    )
    share[y, x] = 1.0
    if y >= top and y < top + high and x >= left and x < left + wide:
        share[y, x] = wp.min(down, across)


@wp.kernel
def clear(
    # out:
    out: wp.array3d[float],
    # sizes:
    count: int,
    rows: int,
    cols: int,
):
    # no light outside of a window
    p, y, x = wp.tid()
    out[p, y, x] = 0.0


@wp.func
def overlap(c00: wp.vec3, c10: wp.vec3, c11: wp.vec3, c01: wp.vec3, v: float, u: float):
    # area of the pixel's quadrilateral within a sample; v, u: from it to the origin of the corners
    y00 = c00[0] - v
    y10 = c10[0] + 1.0 - v
    y11 = c11[0] + 1.0 - v
    y01 = c01[0] - v
    x00 = c00[1] - u
    x10 = c10[1] - u
    x11 = c11[1] + 1.0 - u
    x01 = c01[1] + 1.0 - u
    total = below(y00, x00, y10, x10) + below(y10, x10, y11, x11)
    total += below(y11, x11, y01, x01) + below(y01, x01, y00, x00)
    return wp.max(total, 0.0)


@wp.kernel
def limited(
    # in:
    planes: wp.array3d[float],
    lines: wp.array3d[float],
    share: wp.array2d[float],
    cover: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    top: int,
    left: int,
    border: int,
    per_map: int,
    covers: int,
    # sizes:
    source_rows: int,
    source_cols: int,
    nx: int,
    maps: int,
    rows: int,
    cols: int,
    high: int,
    wide: int,
):
    # as `cubic`, of each sample's share; the rest by area, over the cubic's 4 x 4 samples
    block, across, in_y, in_x = wp.tid()
    m, dy, dx = tile_place(block, across, in_y, in_x, high)
    if dy >= high or dx >= wide:
        return
    y = top + dy
    x = left + dx
    at = place(lines, m, 2 * y + 1, 2 * x + 1, nx, cols)
    from_y = wp.floor(at[0]) - 1.0
    from_x = wp.floor(at[1]) - 1.0
    first_y = y + int(from_y)
    first_x = x + int(from_x)
    wy = keys(at[0] - from_y - 1.0)
    wx = keys(at[1] - from_x - 1.0)
    least = float(1.0)
    within = first_y >= 0 and first_x >= 0
    within = within and first_y + 4 <= source_rows and first_x + 4 <= source_cols
    if within:
        for i in range(4):
            for j in range(4):
                least = wp.min(least, share[first_y + i, first_x + j])
    else:
        for i in range(4):
            sy = inside(first_y + i, source_rows, border)
            for j in range(4):
                least = wp.min(least, share[sy, inside(first_x + j, source_cols, border)])
    if within and covers == 0 and least >= 1.0:  # nearly everywhere: as `cubic`
        for p in range(m * per_map, (m + 1) * per_map):
            total = float(0.0)
            for i in range(4):
                row = float(0.0)
                for j in range(4):
                    row += wx[j] * planes[p, first_y + i, first_x + j]
                total += wy[i] * row
            out[p, y, x] = at[2] * total
        return
    at_y = wp.vec4i()
    at_x = wp.vec4i()
    for i in range(4):
        at_y[i] = inside(first_y + i, source_rows, border)
        at_x[i] = inside(first_x + i, source_cols, border)
    c00 = at
    c10 = at
    c11 = at
    c01 = at
    whole = float(0.0)
    areas = wp.mat44(0.0)
    low_a = int(0)  # samples that the quadrilateral touches; others have no area
    low_b = int(0)
    end_a = int(0)
    end_b = int(0)
    if least < 1.0:
        c00 = place(lines, m, 2 * y, 2 * x, nx, cols)
        c10 = place(lines, m, 2 * y + 2, 2 * x, nx, cols)
        c11 = place(lines, m, 2 * y + 2, 2 * x + 2, nx, cols)
        c01 = place(lines, m, 2 * y, 2 * x + 2, nx, cols)
        low_a = wp.max(
            int(wp.min(wp.min(c00[0], c01[0]), wp.min(c10[0], c11[0]) + 1.0) - from_y), 0
        )
        low_b = wp.max(
            int(wp.min(wp.min(c00[1], c10[1]), wp.min(c01[1], c11[1]) + 1.0) - from_x), 0
        )
        high_a = wp.max(wp.max(c00[0], c01[0]), wp.max(c10[0], c11[0]) + 1.0)
        high_b = wp.max(wp.max(c00[1], c10[1]), wp.max(c01[1], c11[1]) + 1.0)
        end_a = wp.min(int(wp.ceil(high_a - from_y)), 4)
        end_b = wp.min(int(wp.ceil(high_b - from_x)), 4)
        for i in range(low_a, end_a):
            for j in range(low_b, end_b):
                areas[i, j] = overlap(c00, c10, c11, c01, from_y + float(i), from_x + float(j))
                whole += areas[i, j]
    if whole > 0.0:
        areas = areas / whole
    weights = wp.mat44(0.0)  # without J
    for i in range(4):
        for j in range(4):
            part = share[at_y[i], at_x[j]]
            weights[i, j] = wy[i] * wx[j] * part + areas[i, j] * (1.0 - part)
    own = 0  # values of the layer, by the first grid
    if m == 0:
        own = covers
    for p in range(own):  # coverage goes on beyond a dark border
        total = float(0.0)
        for i in range(4):
            for j in range(4):
                total += weights[i, j] * cover[p, at_y[i], at_x[j]]
        out[maps * per_map + p, y, x] = total
    for i in range(4):
        for j in range(4):
            if covers > 0:
                weights[i, j] = weights[i, j] * cover[0, at_y[i], at_x[j]]
            if border == 0 and (at_y[i] != first_y + i or at_x[j] != first_x + j):
                weights[i, j] = 0.0
    for p in range(m * per_map, (m + 1) * per_map):
        total = float(0.0)
        for i in range(4):
            for j in range(4):
                total += weights[i, j] * planes[p, at_y[i], at_x[j]]
        out[p, y, x] = at[2] * total
