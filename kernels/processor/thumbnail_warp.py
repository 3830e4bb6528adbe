"""One column of a block per thread, then one block per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def columns(
    # in:
    camera: wp.array3d[float],
    ceiling: wp.array1d[float],
    # out:
    sums: wp.array3d[float],
    # sizes:
    height: int,
    width: int,
    rows: int,
    run: int,
    channels: int,
):
    i, item = wp.tid()
    begin = int(wp.int64(i) * wp.int64(height) / wp.int64(rows))
    end = int(wp.int64(i + 1) * wp.int64(height) / wp.int64(rows))
    for x in range(item * run, wp.min(item * run + run, width)):
        for c in range(channels + 1):
            sums[c, i, x] = 0.0
        for y in range(begin, end):
            below = int(1)  # not for NaN
            for c in range(channels):
                if not camera[c, y, x] < ceiling[c]:
                    below = 0
            if below == 1:
                for c in range(channels):
                    sums[c, i, x] = sums[c, i, x] + camera[c, y, x]
                sums[channels, i, x] = sums[channels, i, x] + 1.0


@wp.kernel
def blocks(
    # in:
    sums: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # sizes:
    width: int,
    rows: int,
    cols: int,
    channels: int,
):
    i, j = wp.tid()
    begin = int(wp.int64(j) * wp.int64(width) / wp.int64(cols))
    end = int(wp.int64(j + 1) * wp.int64(width) / wp.int64(cols))
    count = float(0.0)
    for x in range(begin, end):
        count += sums[channels, i, x]
    for c in range(channels):
        total = float(0.0)
        for x in range(begin, end):
            total += sums[c, i, x]
        out[c, i, j] = wp.where(count > 0.0, total / count, wp.nan)
