"""One pixel per thread reads only its own channel."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


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
    u = (float(x) - 0.5 * float(cols - 1)) * slope
    v = (float(y) - 0.5 * float(rows - 1)) * slope
    secant2 = 1.0 + (u * u + v * v)  # 1 / cos^2
    channel = cfa[y % period_y, x % period_x]
    rate = rates[channel, y, x]
    if rate < 0.0:  # NaN stays
        rate = float(0.0)
    mean[y, x] = exposure_time * rate / (secant2 * secant2)
