"""Displacements between tiles."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.processor import align as align_host

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TILE = wp.constant(align_host.TILE)


@wp.func
def displacement_at(
    tiles: wp.array4d[float],
    i: int,
    y: float,
    x: float,
    tiles_y: int,
    tiles_x: int,
    period_y: int,
    period_x: int,
):
    """Return the displacement [pixel] at a place [pixel], linear between the middles of tiles."""
    v = (y + 0.5) / float(TILE * period_y) - 0.5
    u = (x + 0.5) / float(TILE * period_x) - 0.5
    top = wp.clamp(int(wp.floor(v)), 0, wp.max(tiles_y - 2, 0))
    left = wp.clamp(int(wp.floor(u)), 0, wp.max(tiles_x - 2, 0))
    down = v - float(top)
    right = u - float(left)
    low = top + 1
    far = left + 1
    if tiles_y == 1:
        down = 0.0
        low = top
    if tiles_x == 1:
        right = 0.0
        far = left
    found = wp.vec2(0.0, 0.0)
    for k in range(2):
        upper = tiles[i, top, left, k] * (1.0 - right) + tiles[i, top, far, k] * right
        lower = tiles[i, low, left, k] * (1.0 - right) + tiles[i, low, far, k] * right
        found[k] = upper * (1.0 - down) + lower * down
    return wp.vec2(found[0] * float(period_y), found[1] * float(period_x))
