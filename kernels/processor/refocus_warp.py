"""As refocus.cl on a GPU, with one pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.keys_warp import keys

wp.set_module_options({"enable_backward": False})

FARTHEST = wp.constant(1e6)  # [pixel] of a displacement


@wp.kernel
def refocus(
    # in:
    views: wp.array4d[float],
    places: wp.array2d[float],
    weights: wp.array[float],
    slopes: wp.array[float],
    # out:
    out: wp.array4d[float],
    # sizes:
    pictures: int,
    moments: int,
    count: int,
    planes: int,
    rows: int,
    cols: int,
):
    plane, y, x = wp.tid()
    p = plane % planes
    k = plane / planes
    offset = float(0.0)
    if moments == 2:  # differences to one view keep the digits of a variance that is small
        offset = views[count / 2, p, y, x]
    total = float(0.0)
    sum = float(0.0)
    squares = float(0.0)
    for v in range(count):
        weight = weights[v]
        if weight != 0.0:
            down = wp.clamp(slopes[k] * places[v, 0], -FARTHEST, FARTHEST)
            right = wp.clamp(slopes[k] * places[v, 1], -FARTHEST, FARTHEST)
            wy = keys(down - wp.floor(down))
            wx = keys(right - wp.floor(right))
            top = y + int(wp.floor(down)) - 1
            left = x + int(wp.floor(right)) - 1
            value = float(0.0)
            for a in range(4):
                row = wp.clamp(top + a, 0, rows - 1)
                along = float(0.0)
                for b in range(4):
                    along += wx[b] * views[v, p, row, wp.clamp(left + b, 0, cols - 1)]
                value += wy[a] * along
            value -= offset
            total += weight
            sum += weight * value
            squares += weight * value * value
    mean = sum / total
    out[k, p, y, x] = offset + mean
    if moments == 2:
        out[k, planes + p, y, x] = wp.max(squares / total - mean * mean, 0.0)
