"""Expected electrons of one chip, one pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MOST = wp.constant(1e30)


@wp.kernel
def chip(
    # in:
    mean: wp.array[float],
    response: wp.array[float],
    dark: wp.array[float],
    # out:
    out: wp.array[float],
    # sizes and numbers:
    use_response: int,
    use_dark: int,
    pixels: int,
    scale: float,
    dark_time: float,
):
    i = wp.tid()
    expected = scale * mean[i]
    expected = wp.where(expected > MOST, MOST, expected)
    if use_response != 0:
        expected = expected * response[i]
    expected = wp.where(expected < 0.0, 0.0, expected)
    if use_dark != 0:
        expected = expected + dark_time * dark[i]
    out[i] = expected
