"""Stockham transforms in global memory, one radix per pass; lines along either axis, neighbours in memory together."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def element(data: wp.array4d[float], plane: int, line: int, i: int, axis: int):
    if axis == 0:
        return wp.vec2(data[plane, i, line, 0], data[plane, i, line, 1])
    return wp.vec2(data[plane, line, i, 0], data[plane, line, i, 1])


@wp.kernel
def stockham(
    # in:
    data: wp.array4d[float],
    roots: wp.array2d[float],
    # out:
    out: wp.array4d[float],
    # params:
    radix: int,
    done: int,
    length: int,
    axis: int,
):
    plane, y, x = wp.tid()
    i = x
    line = y
    if axis == 0:
        i = y
        line = x
    apart = length // radix
    k = i % done
    first = (i - k) * radix + k
    stride = apart // done
    for m in range(radix):
        turn = (k + m * done) * stride  # roots per input: below length
        total = element(data, plane, line, i, axis)
        at = int(0)
        for n in range(1, radix):
            at += turn
            if at >= length:
                at -= length
            v = element(data, plane, line, i + n * apart, axis)
            total += wp.vec2(roots[at, 0] * v[0] - roots[at, 1] * v[1], roots[at, 0] * v[1] + roots[at, 1] * v[0])
        target = first + m * done
        if axis == 0:
            out[plane, target, line, 0] = total[0]
            out[plane, target, line, 1] = total[1]
        else:
            out[plane, line, target, 0] = total[0]
            out[plane, line, target, 1] = total[1]


@wp.kernel
def complex_from_real(
    # in:
    data: wp.array3d[float],
    # out:
    out: wp.array4d[float],
    # sizes:
    planes: int,
    rows: int,
    cols: int,
):
    plane, y, x = wp.tid()
    out[plane, y, x, 0] = data[plane, y, x]
    out[plane, y, x, 1] = 0.0


@wp.kernel
def mirror(data: wp.array4d[float], planes: int, rows: int, cols: int):
    # Second half of each row from the first: after the inverse along y every row is the half spectrum of a real row.
    plane, y, x = wp.tid()
    if x > cols // 2:
        data[plane, y, x, 0] = data[plane, y, cols - x, 0]
        data[plane, y, x, 1] = -data[plane, y, cols - x, 1]


@wp.kernel
def real_from_complex(
    # in:
    data: wp.array4d[float],
    # out:
    out: wp.array3d[float],
    # params:
    scale: float,
    # sizes:
    planes: int,
    rows: int,
    cols: int,
):
    plane, y, x = wp.tid()
    out[plane, y, x] = scale * data[plane, y, x, 0]
