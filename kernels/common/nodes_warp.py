"""Bilinear values between nodes, edges repeated: as nodes.clh."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it


@wp.func
def between(values: wp.array3d[float], p: int, ny: int, nx: int, y: float, x: float):
    inside_y = wp.clamp(y, 0.0, float(ny - 1))
    inside_x = wp.clamp(x, 0.0, float(nx - 1))
    j = wp.min(int(inside_y), wp.max(ny - 2, 0))
    i = wp.min(int(inside_x), wp.max(nx - 2, 0))
    s = inside_y - float(j)
    t = inside_x - float(i)
    below = wp.min(j + 1, ny - 1)
    right = wp.min(i + 1, nx - 1)
    upper = (1.0 - t) * values[p, j, i] + t * values[p, j, right]
    lower = (1.0 - t) * values[p, below, i] + t * values[p, below, right]
    return (1.0 - s) * upper + s * lower
