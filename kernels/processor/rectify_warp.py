"""A place between nodes, then a cubic in every plane of its map: as rectify.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.keys_warp import keys
from gpusim.kernels.common.nodes_warp import between

wp.set_module_options({"enable_backward": False})


@wp.kernel
def rectify(
    # in:
    planes: wp.array3d[float],
    nodes: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    ny: int,
    nx: int,
    of_map: int,
):
    map, y, x = wp.tid()
    down = (float(y) + 0.5) * float(ny - 1) / float(rows)
    across = (float(x) + 0.5) * float(nx - 1) / float(cols)
    moved_y = between(nodes, 2 * map, ny, nx, down, across)
    moved_x = between(nodes, 2 * map + 1, ny, nx, down, across)
    low_y = wp.floor(moved_y)
    low_x = wp.floor(moved_x)
    weights_y = keys(moved_y - low_y)
    weights_x = keys(moved_x - low_x)
    first_y = y + int(low_y) - 1
    first_x = x + int(low_x) - 1
    for p in range(map * of_map, (map + 1) * of_map):
        total = float(0.0)
        for a in range(4):
            row = wp.clamp(first_y + a, 0, rows - 1)
            along = float(0.0)
            for b in range(4):
                along += weights_x[b] * planes[p, row, wp.clamp(first_x + b, 0, cols - 1)]
            total += weights_y[a] * along
        out[p, y, x] = total
