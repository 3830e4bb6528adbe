"""Weighted spectra, folded by the mosaic's sampling, between the transforms of common/fft.py."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def times(a: wp.vec2, b: wp.vec2):
    """Return the product of two complex numbers."""
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.kernel
def fold(
    # in:
    spectra: wp.array4d[float],
    tables: wp.array4d[float],
    mix: wp.array2d[float],
    turns_y: wp.array3d[float],
    turns_x: wp.array3d[float],
    cfa: wp.array2d[int],
    # out:
    folded: wp.array4d[float],
    # params:
    is_first: int,
    first: int,
    count: int,
    own_tables: int,
    is_complex: int,
    # sizes:
    size: int,
    channels: int,
    phases_y: int,
    phases_x: int,
    rows: int,
    cols: int,
    half_x: int,
    pitch: int,
    out_pitch: int,
):
    y, x = wp.tid()
    period_y = rows * phases_y
    period_x = cols * phases_x
    if is_first == 1:
        for p in range(phases_y * phases_x):
            folded[p, y, x, 0] = 0.0
            folded[p, y, x, 1] = 0.0
    for a in range(phases_y):
        fy = y + a * rows
        for b in range(phases_x):
            fx = x + b * cols
            # Columns beyond the half that is stored are the conjugates of the opposite frequency.
            column = fx
            row = fy
            sign = float(1.0)
            if phases_x > 1 and 2 * b >= phases_x:
                column = period_x - fx
                if fy > 0:
                    row = period_y - fy
                sign = float(-1.0)
            entry = wp.min(fy, period_y - fy)
            for c in range(channels):
                total = wp.vec2(0.0, 0.0)
                for k in range(size):
                    value = wp.vec2(spectra[k, row, column, 0], spectra[k, row, column, 1])
                    if is_complex == 1:
                        transfer = wp.vec2(
                            tables[own_tables * c, first + k, row, 2 * column],
                            tables[own_tables * c, first + k, row, 2 * column + 1],
                        )
                        total += mix[c, k] * times(transfer, value)
                    else:
                        total += (
                            mix[c, k] * tables[own_tables * c, first + k, entry, column] * value
                        )
                total = wp.vec2(total[0], sign * total[1])
                for dy in range(phases_y):
                    for dx in range(phases_x):
                        if cfa[dy, dx] == c:
                            turn = times(
                                wp.vec2(turns_y[fy, dy, 0], turns_y[fy, dy, 1]),
                                wp.vec2(turns_x[fx, dx, 0], turns_x[fx, dx, 1]),
                            )
                            turned = times(total, turn)
                            folded[dy * phases_x + dx, y, x, 0] = (
                                folded[dy * phases_x + dx, y, x, 0] + turned[0]
                            )
                            folded[dy * phases_x + dx, y, x, 1] = (
                                folded[dy * phases_x + dx, y, x, 1] + turned[1]
                            )


@wp.kernel
def interleave(
    # in:
    pixels: wp.array3d[float],
    # out:
    out: wp.array2d[float],
    # params:
    start_y: int,
    start_x: int,
    # sizes:
    rows: int,
    cols: int,
    phases_y: int,
    phases_x: int,
    small_y: int,
    small_x: int,
):
    y, x = wp.tid()
    v = y + start_y
    u = x + start_x
    phase = v % phases_y * phases_x + u % phases_x
    out[y, x] = pixels[phase, v // phases_y, u // phases_x]
