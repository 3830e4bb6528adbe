"""Nodes widened to lines, lines blended: as shade.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def widen(
    # in:
    gains: wp.array3d[float],
    cfa: wp.array2d[int],
    # out:
    lines: wp.array3d[float],
    # sizes:
    period_y: int,
    period_x: int,
    ny: int,
    nx: int,
    cols: int,
):
    phase, j, x = wp.tid()
    place = (2 * x + 1) * (nx - 1)
    i = place / (2 * cols)
    t = float(place - i * 2 * cols) / float(2 * cols)
    c = cfa[phase, x % period_x]
    lines[phase, j, x] = (1.0 - t) * gains[c, j, i] + t * gains[c, j, i + 1]


@wp.kernel
def shade(
    # in:
    raw: wp.array2d[wp.uint16],
    lines: wp.array3d[float],
    # out:
    out: wp.array2d[wp.uint16],
    # params:
    black_level: float,
    scale: float,
    new_black: float,
    # sizes:
    period_y: int,
    ny: int,
    rows: int,
    cols: int,
):
    y, x = wp.tid()
    place = (2 * y + 1) * (ny - 1)
    j = place / (2 * rows)
    t = float(place - j * 2 * rows) / float(2 * rows)
    phase = y % period_y
    gain = (1.0 - t) * lines[phase, j, x] + t * lines[phase, j + 1, x]
    value = new_black + gain * ((float(raw[y, x]) - black_level) * scale)
    out[y, x] = wp.uint16(int(wp.clamp(value, 0.0, 65535.0) + 0.5))
