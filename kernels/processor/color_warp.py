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


@wp.func
def column(matrix: wp.array2d[float], f: int):
    return wp.vec3(matrix[0, f], matrix[1, f], matrix[2, f])


@wp.kernel
def root_color(
    # in:
    camera: wp.array3d[float],
    matrix: wp.array2d[float],
    ceiling: wp.array1d[float],
    # out:
    rgb: wp.array3d[float],
    # sizes:
    run: int,
    pixels: int,
    terms: int,
):
    item = wp.tid()
    cols = camera.shape[2]
    for i in range(item * run, wp.min(item * run + run, pixels)):
        y = i // cols
        x = i - y * cols
        sums = wp.vec3(0.0, 0.0, 0.0)
        values = wp.vec3(0.0, 0.0, 0.0)
        for c in range(3):
            value = camera[c, y, x]
            if value > ceiling[c]:  # NaN stays
                value = ceiling[c]
            sums += value * column(matrix, c)
            if value < 0.0:
                value = 0.0
            values[c] = value
        r = wp.sqrt(values[0])
        g = wp.sqrt(values[1])
        b = wp.sqrt(values[2])
        sums += r * g * column(matrix, 3)
        sums += g * b * column(matrix, 4)
        sums += r * b * column(matrix, 5)
        if terms > 6:
            r = wp.cbrt(values[0])
            g = wp.cbrt(values[1])
            b = wp.cbrt(values[2])
            sums += r * g * g * column(matrix, 6)
            sums += g * b * b * column(matrix, 7)
            sums += r * b * b * column(matrix, 8)
            sums += r * r * g * column(matrix, 9)
            sums += g * g * b * column(matrix, 10)
            sums += r * r * b * column(matrix, 11)
            sums += r * g * b * column(matrix, 12)
        rgb[0, y, x] = sums[0]
        rgb[1, y, x] = sums[1]
        rgb[2, y, x] = sums[2]
