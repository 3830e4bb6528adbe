"""One pixel per thread writes all its planes; the table stays in cache."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def materials(
    # in:
    ids: wp.array2d[wp.uint16],
    shading: wp.array2d[float],
    table: wp.array2d[float],
    # out:
    planes: wp.array3d[float],
    # sizes:
    pixels: int,
    count: int,
    plane_count: int,
    cols: int,
):
    i = wp.tid()
    y = i // cols
    x = i - y * cols
    material = int(ids[y, x])
    shade = shading[y, x]
    for p in range(plane_count):
        planes[p, y, x] = shade * table[p, material]
