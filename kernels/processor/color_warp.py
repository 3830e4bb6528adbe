"""A run of pixels per thread, all three sums at once."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def color(
    # in:
    camera: wp.array3d[float],
    matrix: wp.array2d[float],
    ceiling: wp.array1d[float],
    # out:
    rgb: wp.array3d[float],
    # sizes:
    run: int,
    pixels: int,
    channels: int,
):
    item = wp.tid()
    cols = camera.shape[2]
    for i in range(item * run, wp.min(item * run + run, pixels)):
        y = i // cols
        x = i - y * cols
        sums = wp.vec3(0.0, 0.0, 0.0)
        for c in range(channels):
            value = camera[c, y, x]
            if value > ceiling[c]:  # NaN stays
                value = ceiling[c]
            sums += value * wp.vec3(matrix[0, c], matrix[1, c], matrix[2, c])
        rgb[0, y, x] = sums[0]
        rgb[1, y, x] = sums[1]
        rgb[2, y, x] = sums[2]
