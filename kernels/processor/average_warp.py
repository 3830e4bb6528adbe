"""As average.cl on a GPU: a block, a block, a pixel per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.keys_warp import keys
from gpusim.kernels.processor import align as align_host
from gpusim.kernels.processor import average as average_host

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TILE = wp.constant(align_host.TILE)
OUTSIDE = wp.constant(average_host.OUTSIDE)


@wp.kernel
def move(
    # in:
    raw: wp.array3d[wp.uint16],
    displacement: wp.array4d[float],
    # out:
    moved: wp.array3d[float],
    misfit: wp.array3d[float],
    # params:
    reference: int,
    black_level: float,
    gain: float,
    read2: float,
    # sizes:
    tiles_y: int,
    tiles_x: int,
    frames: int,
    rows: int,
    cols: int,
    h: int,
    w: int,
    period_y: int,
    period_x: int,
):
    i, by, bx = wp.tid()
    ty = wp.min(by / TILE, tiles_y - 1)
    tx = wp.min(bx / TILE, tiles_x - 1)
    whole_y = float(0.0)
    whole_x = float(0.0)
    wy = wp.vec4(0.0, 1.0, 0.0, 0.0)
    wx = wp.vec4(0.0, 1.0, 0.0, 0.0)
    if i != reference:
        whole_y = wp.floor(displacement[i, ty, tx, 0])
        whole_x = wp.floor(displacement[i, ty, tx, 1])
        wy = keys(displacement[i, ty, tx, 0] - whole_y)
        wx = keys(displacement[i, ty, tx, 1] - whole_x)
    spread = 1.0 + wp.dot(wy, wy) * wp.dot(wx, wx)
    sum = float(0.0)
    pixels = float(0.0)
    for k in range(period_y):
        y = by * period_y + k
        for m in range(period_x):
            x = bx * period_x + m
            if y < rows and x < cols:
                there = bool(True)
                value = float(0.0)
                for a in range(4):
                    v = y + (int(whole_y) + a - 1) * period_y
                    line = float(0.0)
                    for b in range(4):
                        u = x + (int(whole_x) + b - 1) * period_x
                        if v >= 0 and v < rows and u >= 0 and u < cols:
                            line += wx[b] * float(raw[i, v, u])
                        elif wy[a] * wx[b] != 0.0:
                            there = False
                    value += wy[a] * line
                other = float(raw[reference, y, x])
                light = wp.max(0.5 * (value + other) - black_level, 0.0)
                moved[i, y, x] = value
                if there:
                    sum += (value - other) * (value - other) / (spread * (gain * light + read2))
                else:
                    sum += OUTSIDE
                pixels += 1.0
    misfit[i, by, bx] = sum / pixels


@wp.kernel
def weigh(
    # in:
    misfit: wp.array3d[float],
    # out:
    weights: wp.array3d[float],
    # params:
    reference: int,
    low: float,
    high: float,
    # sizes:
    frames: int,
    h: int,
    w: int,
):
    i, y, x = wp.tid()
    left = wp.max(x - 1, 0)
    right = wp.min(x + 1, w - 1)
    sum = float(0.0)
    for k in range(3):
        v = wp.clamp(y + k - 1, 0, h - 1)
        sum += misfit[i, v, left] + misfit[i, v, x] + misfit[i, v, right]
    weights[i, y, x] = wp.clamp((high - sum / 9.0) / (high - low), 0.0, 1.0)
    if i == reference:
        weights[i, y, x] = 1.0


@wp.kernel
def average(
    # in:
    moved: wp.array3d[float],
    weights: wp.array3d[float],
    # out:
    out: wp.array2d[float],
    # sizes:
    rows: int,
    cols: int,
    h: int,
    w: int,
    frames: int,
    period_y: int,
    period_x: int,
):
    y, x = wp.tid()
    total = float(0.0)
    shares = float(0.0)
    for i in range(frames):
        weight = weights[i, y / period_y, x / period_x]
        total += weight * moved[i, y, x]
        shares += weight
    out[y, x] = total / shares
