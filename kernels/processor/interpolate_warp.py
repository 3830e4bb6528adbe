"""One pixel per thread: as interpolate.cl on a GPU."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def interpolate(
    # in:
    raw: wp.array2d[wp.uint16],
    starts: wp.array[int],
    offsets: wp.array3d[int],
    weights: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # params:
    black_level: float,
    scale: float,
    reach_y: int,
    reach_x: int,
    # sizes:
    period_y: int,
    period_x: int,
    stride: int,
    rows: int,
    cols: int,
    channels: int,
):
    y, x = wp.tid()
    phase = x % period_x
    inside = y >= reach_y and y < rows - reach_y and x >= reach_x and x < cols - reach_x
    for c in range(channels):
        at = (y % period_y) * channels + c
        sum = float(0.0)
        total = float(0.0)
        for k in range(starts[at], starts[at + 1]):
            v = y + offsets[k, phase, 0]
            u = x + offsets[k, phase, 1]
            if inside or (v >= 0 and v < rows and u >= 0 and u < cols):
                sum += weights[k, phase] * float(raw[v, u])
                total += weights[k, phase]
        if not inside:
            sum /= total
        out[c, y, x] = (sum - black_level) * scale
