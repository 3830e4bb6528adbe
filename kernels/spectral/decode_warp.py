"""One pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def decode_bytes(
    # in:
    codes: wp.array3d[wp.uint8],
    curve: wp.array1d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    channels: int,
):
    y, x = wp.tid()
    for c in range(channels):
        out[c, y, x] = curve[int(codes[y, x, c])]


@wp.kernel
def decode_words(
    # in:
    codes: wp.array3d[wp.uint16],
    curve: wp.array1d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    channels: int,
):
    y, x = wp.tid()
    for c in range(channels):
        out[c, y, x] = curve[int(codes[y, x, c])]
