"""For CPUs: a pair of rows per thread, vectors of projections. GPUs: survey_groups_warp.py."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})

vec16 = wp.types.vector(length=16, dtype=float)


@wp.func
def store(
    out: wp.array3d[float], i: int, kind: int, count: int, sums: vec16, squares: float, length: int
):
    """Write means from sums."""
    for p in range(count):
        out[i, kind, p] = sums[p] / float(length)
    out[i, kind, count] = squares / float(length)


@wp.func
def weights_of(table: wp.array2d[float], e: int):
    """Return an entry in all projections."""
    row = vec16()
    for p in range(16):
        row[p] = table[e, p]
    return row


@wp.kernel
def mixed(
    # in:
    content: wp.array3d[float],
    table: wp.array2d[float],  # [entries][16]
    first: wp.array1d[int],
    # out:
    out: wp.array3d[float],
    # sizes:
    entries: int,
    rows: int,
    cols: int,
    count: int,
    unit: float,
):
    i = wp.tid()
    y = wp.clamp(first[i], 0, rows - 1)
    below = wp.min(y + 1, rows - 1)
    values = vec16()
    steps = vec16()
    falls = vec16()
    squares = wp.vec3()
    for x in range(cols):
        right = wp.min(x + 1, cols - 1)
        value = vec16()
        across = vec16()
        down = vec16()
        square = wp.vec3()
        for e in range(entries):
            row = weights_of(table, e)
            here = content[e, y, x]
            step = content[e, y, right] - here
            fall = content[e, below, x] - here
            value += here * row
            across += step * row
            down += fall * row
            own = unit * wp.vec3(here, step, fall)
            square += wp.cw_mul(own, own)
        values += wp.cw_mul(value, value)
        falls += wp.cw_mul(down, down)
        if right == x:
            square[1] = 0.0
        else:
            steps += wp.cw_mul(across, across)
        squares += square
    store(out, i, 0, count, values, squares[0], cols)
    store(out, i, 1, count, steps, squares[1], wp.max(cols - 1, 1))
    store(out, i, 2, count, falls, squares[2], cols)


@wp.func
def difference(table: wp.array2d[float], id: int, other: int, shade: float, its: float):
    """Return projections of a difference; samples of one entry cancel exactly."""
    if id == other:
        return (its - shade) * weights_of(table, id)
    return its * weights_of(table, other) - shade * weights_of(table, id)


@wp.func
def difference_square(id: int, other: int, shade: float, its: float):
    """Return the part of a difference in the squares of entries: one entry's square, or two."""
    if id == other:
        return (its - shade) * (its - shade)
    return shade * shade + its * its


@wp.kernel
def labelled(
    # in:
    ids: wp.array2d[wp.uint16],
    content: wp.array2d[float],
    table: wp.array2d[float],  # [entries][16]
    first: wp.array1d[int],
    # out:
    out: wp.array3d[float],
    # sizes:
    entries: int,
    rows: int,
    cols: int,
    count: int,
    unit: float,
):
    i = wp.tid()
    y = wp.clamp(first[i], 0, rows - 1)
    below = wp.min(y + 1, rows - 1)
    values = vec16()
    steps = vec16()
    falls = vec16()
    squares = wp.vec3()
    for x in range(cols):
        id = int(ids[y, x])
        id_below = int(ids[below, x])
        shade = content[y, x]
        shade_below = content[below, x]
        value = shade * weights_of(table, id)
        down = difference(table, id, id_below, shade, shade_below)
        values += wp.cw_mul(value, value)
        falls += wp.cw_mul(down, down)
        square = wp.vec3(
            unit * shade * (unit * shade),
            0.0,
            difference_square(id, id_below, unit * shade, unit * shade_below),
        )
        if x + 1 < cols:
            id_right = int(ids[y, x + 1])
            shade_right = content[y, x + 1]
            across = difference(table, id, id_right, shade, shade_right)
            steps += wp.cw_mul(across, across)
            square[1] = difference_square(id, id_right, unit * shade, unit * shade_right)
        squares += square
    store(out, i, 0, count, values, squares[0], cols)
    store(out, i, 1, count, steps, squares[1], wp.max(cols - 1, 1))
    store(out, i, 2, count, falls, squares[2], cols)
