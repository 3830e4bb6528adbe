"""A run of pixels per thread, three look-ups each."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def srgb(
    # in:
    rgb: wp.array3d[float],
    table: wp.array1d[wp.uint32],
    # out:
    codes: wp.array3d[wp.uint8],
    # sizes:
    run: int,
    pixels: int,
):
    item = wp.tid()
    cols = rgb.shape[2]
    for i in range(item * run, wp.min(item * run + run, pixels)):
        y = i // cols
        x = i - y * cols
        for p in range(3):
            linear = rgb[p, y, x]
            value = wp.where(linear > 0.0, wp.min(linear, 1.0), 0.0) * 4096.0  # NaN is black
            bin = int(value)
            entry = table[bin]
            code = entry & wp.uint32(255)
            if wp.uint32((value - float(bin)) * 16777216.0) >= (entry >> wp.uint32(8)):
                code += wp.uint32(1)
            codes[y, x, p] = wp.uint8(code)
