"""One pixel per thread, as flash.cl on a GPU."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.processor import flash as flash_host

wp.set_module_options({"enable_backward": False})

BETTER = wp.constant(flash_host.BETTER)
HIGHLIGHT = wp.constant(flash_host.HIGHLIGHT)


@wp.func
def step(value: float):
    t = wp.clamp(value, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def certainty(noise: wp.array2d[float], value: wp.vec3):
    """Return 1 / (2 variance) / 3 of each value."""
    sure = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        more = noise[c, 0] * wp.max(value[0], 0.0) + noise[c, 1] * wp.max(value[1], 0.0)
        more += noise[c, 2] * wp.max(value[2], 0.0)
        sure[c] = 1.0 / (6.0 * (wp.max(more, 0.0) + noise[c, 3]))
    return sure


@wp.func
def at(planes: wp.array3d[float], y: int, x: int):
    return wp.vec3(planes[0, y, x], planes[1, y, x], planes[2, y, x])


@wp.kernel
def flash(
    # in:
    ambient: wp.array3d[float],
    flash_: wp.array3d[float],
    ambient_noise: wp.array2d[float],
    flash_noise: wp.array2d[float],
    spatial: wp.array2d[float],
    # out:
    out: wp.array3d[float],
    # params:
    full: float,
    per_reach: float,
    # sizes:
    rows: int,
    cols: int,
    radius: int,
):
    y, x = wp.tid()
    a = at(ambient, y, x)
    f = at(flash_, y, x)
    sure_a = certainty(ambient_noise, a)
    sure_f = certainty(flash_noise, f)
    sum_a = wp.vec3(0.0, 0.0, 0.0)
    sum_f = wp.vec3(0.0, 0.0, 0.0)
    own = wp.vec3(0.0, 0.0, 0.0)
    weight = float(0.0)
    own_weight = float(0.0)
    misfit = float(0.0)
    fullness = float(0.0)
    spread = float(0.0)
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            near = spatial[dy + radius, dx + radius]
            v = wp.clamp(y + dy, 0, rows - 1)
            u = wp.clamp(x + dx, 0, cols - 1)
            value_a = at(ambient, v, u)
            value_f = at(flash_, v, u)
            step_a = value_a - a
            step_f = value_f - f
            alike_f = wp.dot(wp.cw_mul(step_f, step_f), sure_f)
            root_a = wp.max(1.0 - wp.dot(wp.cw_mul(step_a, step_a), sure_a) * per_reach, 0.0)
            root_f = wp.max(1.0 - alike_f * per_reach, 0.0)
            w_a = near * root_a * root_a
            w_f = near * root_f * root_f
            sum_a += w_f * value_a
            sum_f += w_f * value_f
            own += w_a * value_a
            weight += w_f
            own_weight += w_a
            misfit += w_f * alike_f
            if wp.max(value_f) >= full:
                fullness += near
            spread += near
    sum_a = sum_a / weight
    sum_f = sum_f / weight
    left = f - sum_f
    variance = misfit / weight - wp.dot(wp.cw_mul(left, left), sure_f)
    share = wp.max(variance - 0.5, 0.0) / wp.max(variance, 0.5)
    known_a = wp.dot(wp.cw_mul(sum_a, sum_a), certainty(ambient_noise, sum_a))
    known_f = wp.dot(wp.cw_mul(sum_f, sum_f), certainty(flash_noise, sum_f))
    shadow = 1.0 - step(known_f / wp.max(BETTER * known_a, 1e-30) - 1.0)
    mask = wp.max(shadow, step(HIGHLIGHT * fullness / spread))
    for c in range(3):
        detail = 1.0 + share * left[c] / wp.max(sum_f[c], wp.sqrt(2.0 / (3.0 * sure_f[c])))
        out[c, y, x] = (1.0 - mask) * sum_a[c] * detail + mask * (own[c] / own_weight)
