"""One pixel per thread."""

# mypy: ignore-errors
from typing import Any

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def decode_bytes(
    # in:
    codes: wp.array3d[Any],
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


decode_words = wp.overload(decode_bytes, {"codes": wp.array3d[wp.uint16]})
decode_bytes = wp.overload(decode_bytes, {"codes": wp.array3d[wp.uint8]})
