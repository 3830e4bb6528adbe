"""One pixel per thread reads only its own channel."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def electrons(
    rate: float, y: int, x: int, slope: float, rows: int, cols: int, exposure_time: float
):
    """Return the electrons of a rate at a pixel: with the fall-off of the lens, not below 0; NaN stays."""
    u = (float(x) - 0.5 * float(cols - 1)) * slope
    v = (float(y) - 0.5 * float(rows - 1)) * slope
    secant2 = 1.0 + (u * u + v * v)  # 1 / cos^2
    return exposure_time * wp.where(rate < 0.0, 0.0, rate) / (secant2 * secant2)


@wp.kernel
def collect(
    # in:
    rates: wp.array3d[float],
    cfa: wp.array2d[int],
    # out:
    mean: wp.array2d[float],
    # params:
    slope: float,
    # sizes:
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
    # numbers by name:
    exposure_time: float,
):
    y, x = wp.tid()
    rate = rates[cfa[y % period_y, x % period_x], y, x]
    mean[y, x] = electrons(rate, y, x, slope, rows, cols, exposure_time)


@wp.kernel
def collect_all(
    # in:
    rates: wp.array3d[float],
    # out:
    mean: wp.array3d[float],
    # params:
    slope: float,
    # sizes:
    rows: int,
    cols: int,
    # numbers by name:
    exposure_time: float,
):
    channel, y, x = wp.tid()
    mean[channel, y, x] = electrons(rates[channel, y, x], y, x, slope, rows, cols, exposure_time)
