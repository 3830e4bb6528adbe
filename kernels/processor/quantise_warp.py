"""One pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.kernel
def quantise(
    # in:
    raw: wp.array2d[float],
    # out:
    numbers: wp.array2d[wp.uint16],
    # params:
    black_level: float,
    scale: float,
    light: float,
    black: float,
    white: float,
    # sizes:
    cols: int,
    count: int,
):
    i = wp.tid()
    y = i // cols
    x = i - y * cols
    wanted = (raw[y, x] - black_level) * scale / light + black
    number = float(0.0)
    if wanted > 0.0:  # not for NaN
        number = wp.rint(wp.min(wanted, white))
    numbers[y, x] = wp.uint16(number)
