"""One pixel of one channel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def composite(
    # in:
    lights: wp.array4d[float],
    alphas: wp.array4d[float],
    ends: wp.array[float],
    # out:
    out: wp.array3d[float],
    # params:
    own: int,
    # sizes:
    count: int,
    cols: int,
    channels: int,
    pixels: int,
):
    c, i = wp.tid()
    y = i // cols
    x = i - y * cols
    total = float(0.0)
    through = float(1.0)
    light = float(0.0)
    alpha = float(0.0)
    for e in range(count):
        light += lights[e, c, y, x]
        alpha += alphas[e, own * c, y, x]
        total += ends[e] * through * light
        through *= 1.0 - ends[e] * wp.clamp(alpha, 0.0, 1.0)
        light *= 1.0 - ends[e]
        alpha *= 1.0 - ends[e]
    if alpha > 0.0:
        total += through * light / alpha
    out[c, y, x] = total
