"""Weights, sums and crops around the transforms of common/fft.py; all kernels are memory-bound."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def accumulate(
    # in:
    spectra: wp.array4d[float],
    tables: wp.array4d[float],
    mix: wp.array2d[float],
    # out:
    sums: wp.array4d[float],
    # params:
    is_first: int,
    first: int,
    count: int,
    own_tables: int,
    # sizes:
    size: int,
    channels: int,
    period_y: int,
    half_x: int,
    pitch: int,
):
    y, x = wp.tid()
    fold = wp.min(y, period_y - y)
    for c in range(channels):
        total = wp.vec2(0.0, 0.0)
        if is_first == 0:
            total = wp.vec2(sums[c, y, x, 0], sums[c, y, x, 1])
        for k in range(size):
            weight = mix[c, k] * tables[own_tables * c, first + k, fold, x]
            total += weight * wp.vec2(spectra[k, y, x, 0], spectra[k, y, x, 1])
        sums[c, y, x, 0] = total[0]
        sums[c, y, x, 1] = total[1]


@wp.kernel
def accumulate_complex(
    # in:
    spectra: wp.array4d[float],
    tables: wp.array4d[float],
    mix: wp.array2d[float],
    # out:
    sums: wp.array4d[float],
    # params:
    is_first: int,
    first: int,
    count: int,
    own_tables: int,
    # sizes:
    size: int,
    channels: int,
    period_y: int,
    half_x: int,
    pitch: int,
):
    y, x = wp.tid()
    for c in range(channels):
        total = wp.vec2(0.0, 0.0)
        if is_first == 0:
            total = wp.vec2(sums[c, y, x, 0], sums[c, y, x, 1])
        for k in range(size):
            table_re = mix[c, k] * tables[own_tables * c, first + k, y, 2 * x]
            table_im = mix[c, k] * tables[own_tables * c, first + k, y, 2 * x + 1]
            re = spectra[k, y, x, 0]
            im = spectra[k, y, x, 1]
            total += wp.vec2(table_re * re - table_im * im, table_re * im + table_im * re)
        sums[c, y, x, 0] = total[0]
        sums[c, y, x, 1] = total[1]


@wp.kernel
def crop(
    # in:
    blurred: wp.array3d[float],
    base: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    add_base: int,
    before_y: int,
    before_x: int,
    # sizes:
    channels: int,
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
):
    c, y, x = wp.tid()
    value = blurred[c, y + before_y, x + before_x]
    if add_base != 0:
        value += base[c, y, x]
    out[c, y, x] = value
