"""One pixel of the map per thread. A GPU keeps denormals in comparisons, Warp's CPU too."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.kernel
def flag(
    # in:
    response: wp.array2d[float],
    dark: wp.array2d[float],
    # out:
    flags: wp.array2d[wp.uint8],
    # params:
    use_response: int,
    use_dark: int,
    least: float,
    binning_y: int,
    binning_x: int,
    stride_y: int,
    stride_x: int,
    # sizes:
    cols: int,
    out_rows: int,
    out_cols: int,
):
    y, x = wp.tid()
    top = y / stride_y * stride_y * binning_y + y % stride_y
    left = x / stride_x * stride_x * binning_x + x % stride_x
    found = int(0)
    for j in range(binning_y):
        for i in range(binning_x):
            if use_response != 0:
                if response[top + j * stride_y, left + i * stride_x] == 0.0:
                    found = 255
            if use_dark != 0:
                if dark[top + j * stride_y, left + i * stride_x] > least:
                    found = 255
    flags[y, x] = wp.uint8(found)
