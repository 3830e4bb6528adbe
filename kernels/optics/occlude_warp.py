"""One place in EACH channels per thread, all points of the pupil; gathers from a neighbourhood."""

# mypy: ignore-errors
from functools import cache

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.border_warp import inside

# every operation is rounded on its own, so that every device rounds to the same samples
OPTIONS = {"enable_backward": False, "fuse_fp": False}
wp.set_module_options(OPTIONS)


@wp.kernel
def begin(
    # in:
    base: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    change: int,
    # sizes:
    channels: int,
    rows: int,
    cols: int,
):
    c, y, x = wp.tid()
    out[c, y, x] = wp.where(change != 0, 0.0, base[c, y, x])


@cache
def specialise(kernel, BORDER=1, SHEETS=1, BENDS=0, MAPS=0, SLOPES=0, EACH=1, TOGETHER=64):
    """Return the kernel of this name; constants as in OpenCL."""
    if kernel == "begin":
        return begin
    numbers, integers = (wp.types.vector(length=SHEETS, dtype=kind) for kind in (float, int))
    per_channel = wp.types.vector(length=EACH, dtype=float)
    both = wp.types.vector(length=SHEETS * EACH, dtype=float)
    terms = wp.types.vector(length=BENDS + 1, dtype=float)
    nine = wp.types.vector(length=9, dtype=float)
    rates = wp.types.vector(length=BENDS + SHEETS, dtype=float)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def occlude(
        # in:
        base: wp.array3d[float],
        lights: wp.array4d[float],
        alphas: wp.array3d[float],
        places: wp.array2d[int],
        members: wp.array2d[int],
        radii: wp.array2d[float],
        points: wp.array2d[float],
        weights: wp.array2d[float],
        bends: wp.array3d[float],
        maps: wp.array2d[float],
        slopes: wp.array3d[float],
        # out:
        out: wp.array3d[float],
        # params:
        margin: int,
        change: int,
        # sizes:
        points_: int,
        count: int,
        rows: int,
        cols: int,
        channels: int,
        high: int,
        wide: int,
    ):
        first_channel, e = wp.tid()
        first_channel *= wp.static(EACH)
        y = places[e, 0] + margin
        x = places[e, 1] + margin
        mean_light = both()
        mean_alpha = numbers()
        radius = numbers()
        there = numbers()
        layer = integers()
        for s in range(wp.static(SHEETS)):
            k = members[s, e]
            layer[s] = wp.max(k, 0)
            there[s] = wp.where(k < 0, 0.0, 1.0)
            radius[s] = radii[s, e]
        bent = terms()
        for k in range(wp.static(BENDS)):
            bent[k] = weights[k, e]
        at = nine()
        if wp.static(MAPS != 0):
            for k in range(9):
                at[k] = maps[k, e]
        slope_y = rates()
        slope_x = rates()
        if wp.static(SLOPES != 0):
            for k in range(wp.static(BENDS + SHEETS)):
                slope_y[k] = slopes[k, 0, e]
                slope_x[k] = slopes[k, 1, e]
        exact = per_channel()
        whole = float(0.0)
        for start in range(0, points_, wp.static(TOGETHER)):
            some_light = both()
            some_alpha = numbers()
            some = per_channel()
            some_whole = float(0.0)
            for m in range(start, wp.min(start + wp.static(TOGETHER), points_)):
                v = points[m, 0]
                u = points[m, 1]
                share = points[m, 2]
                through = float(1.0)
                down = float(0.0)
                across = float(0.0)
                spread = float(1.0)
                # derivatives of the displacement, of rows along columns: yx
                yy = float(0.0)
                yx = float(0.0)
                xy = float(0.0)
                xx = float(0.0)
                for k in range(wp.static(BENDS)):
                    down += bent[k] * bends[k, m, 0]
                    across += bent[k] * bends[k, m, 1]
                    if wp.static(SLOPES != 0):
                        yy += slope_y[k] * bends[k, m, 0]
                        yx += slope_x[k] * bends[k, m, 0]
                        xy += slope_y[k] * bends[k, m, 1]
                        xx += slope_x[k] * bends[k, m, 1]
                if wp.static(SLOPES != 0):
                    spread = 1.0 / ((1.0 - yy) * (1.0 - xx) - yx * xy)
                some_whole += share * spread
                for s in range(wp.static(SHEETS)):
                    seen_y = radius[s] * v + down
                    seen_x = radius[s] * u + across
                    flux = there[s] * spread
                    if wp.static(SLOPES != 0):
                        # the place x + t that is seen has the displacement: t = d + d' t
                        tilt_y = slope_y[wp.static(BENDS) + s]
                        tilt_x = slope_x[wp.static(BENDS) + s]
                        first = 1.0 - (yy + v * tilt_y)
                        second = yx + v * tilt_x
                        third = xy + u * tilt_y
                        fourth = 1.0 - (xx + u * tilt_x)
                        scale = 1.0 / (first * fourth - second * third)
                        along_y = (fourth * seen_y + second * seen_x) * scale
                        seen_x = (third * seen_y + first * seen_x) * scale
                        seen_y = along_y
                    if wp.static(MAPS != 0):
                        flux *= at[6] + (at[7] * seen_y + at[8] * seen_x)
                        there_y = at[0] + (at[2] * seen_y + at[3] * seen_x)
                        seen_x = at[1] + (at[4] * seen_y + at[5] * seen_x)
                        seen_y = there_y
                    i = y + int(wp.floor(seen_y + 0.5))
                    j = x + int(wp.floor(seen_x + 0.5))
                    to_y = inside(i, high, wp.static(BORDER))
                    to_x = inside(j, wide, wp.static(BORDER))
                    if wp.static(BORDER == 0):
                        if i < 0 or i >= high or j < 0 or j >= wide:
                            flux = 0.0
                    covered = there[s] * alphas[layer[s], to_y, to_x]
                    for n in range(wp.static(EACH)):
                        own = flux * lights[layer[s], first_channel + n, to_y, to_x]
                        some[n] += share * (through * own)
                        some_light[s * wp.static(EACH) + n] += share * own
                    through *= 1.0 - covered
                    some_alpha[s] += share * spread * covered
            exact += some
            whole += some_whole
            mean_light += some_light
            mean_alpha += some_alpha
        at_y = places[e, 0]
        at_x = places[e, 1]
        for n in range(wp.static(EACH)):
            product = float(0.0)
            before = float(1.0)
            for s in range(wp.static(SHEETS)):
                product += before * mean_light[s * wp.static(EACH) + n]
                if wp.static(SLOPES != 0):
                    before *= 1.0 - mean_alpha[s] / whole
                else:
                    before *= 1.0 - mean_alpha[s]
            before_it = base[first_channel + n, at_y, at_x]
            taken = wp.where(change != 0, before_it, 0.0)
            changed = wp.max(before_it + (exact[n] - product), 0.0)
            out[first_channel + n, at_y, at_x] = changed - taken

    return occlude
