"""One frequency of one band per thread; replicas beyond the cutoff are skipped."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def transfer(s: float):
    # O(s) = (1 - s)^(3/2) R(s): R has its nearest singularity at s = -1, so eight powers of s give O to 4e-10 without
    # the cancellation of acos(s) - s sqrt(1 - s^2); interpolated at the Chebyshev nodes of [0, 1].
    r = s * -7.876327168e-5 + 4.773317558e-4
    r = s * r - 1.425687022e-3
    r = s * r + 3.039790117e-3
    r = s * r - 5.856791600e-3
    r = s * r + 1.236298635e-2
    r = s * r - 3.485750074e-2
    r = s * r + 2.267603886e-1
    r = s * r + 1.0
    t = 1.0 - s
    return t * wp.sqrt(t) * r


@wp.kernel
def airy(
    # in:
    q: wp.array[float],
    sinc_y: wp.array2d[float],
    sinc_x: wp.array2d[float],
    # out:
    tables: wp.array3d[float],
    # params:
    step_y: float,
    step_x: float,
    low: int,
    high: int,
    # sizes:
    bands: int,
    rows: int,
    cols: int,
):
    band, y, x = wp.tid()
    fy = float(y) * step_y
    fx = float(x) * step_x
    scale = q[band]
    total = float(0.0)
    for a in range(low, high + 1):
        u = scale * (fy + float(a))
        row = float(0.0)
        for b in range(low, high + 1):
            v = scale * (fx + float(b))
            s = wp.sqrt(u * u + v * v)
            if s < 1.0:
                row += transfer(s) * sinc_x[b - low, x]
        total += row * sinc_y[a - low, y]
    tables[band, y, x] = total
