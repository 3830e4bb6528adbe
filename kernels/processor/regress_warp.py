"""One pixel per thread, as in regress.cl."""

# mypy: ignore-errors
from functools import cache

import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.tiles_warp import displacement_at
from gpusim.kernels.processor import regress as regress_host

OPTIONS = {"enable_backward": False, "fuse_fp": False, "max_unroll": 5}
wp.set_module_options(OPTIONS)

NEAR = wp.constant(regress_host.NEAR)
ROUND = wp.constant(regress_host.ROUND)
NARROWEST = wp.constant(regress_host.NARROWEST)
WIDEST = wp.constant(regress_host.WIDEST)
WIDTH = wp.constant(regress_host.WIDTH)
NOISE = wp.constant(regress_host.NOISE)
CUT = wp.constant(regress_host.CUT)
PEDESTAL = wp.constant(regress_host.PEDESTAL)
SLOPE = wp.constant(regress_host.SLOPE)
BEND = wp.constant(regress_host.BEND)
TINT = wp.constant(regress_host.TINT)
ROUNDING = wp.constant(regress_host.ROUNDING)
vec5 = wp.types.vector(length=5, dtype=float)
mat55 = wp.types.matrix(shape=(5, 5), dtype=float)


@wp.func
def squared(x: float):
    return x * x


@wp.func
def place_in(
    displacement: wp.array4d[float],
    i: int,
    reference: int,
    y: float,
    x: float,
    tiles_y: int,
    tiles_x: int,
    period_y: int,
    period_x: int,
):
    """Return where a frame shows a place of the reference [pixel]."""
    place = wp.vec2(y, x)
    if i != reference:
        move = displacement_at(displacement, i, y, x, tiles_y, tiles_x, period_y, period_x)
        place = wp.vec2(wp.clamp(y + move[0], -1.0e6, 1.0e6), wp.clamp(x + move[1], -1.0e6, 1.0e6))
    return place


@cache
def make_kernels(channels):
    """Return `survey`, `shape` and `regress` for a number of channels."""
    values = wp.types.vector(length=channels, dtype=float)
    more = wp.types.vector(length=2 * channels + 1, dtype=float)
    middles = wp.types.matrix(shape=(channels, 5), dtype=float)

    @wp.func
    def fit(
        raw: wp.array3d[wp.uint16],
        displacement: wp.array4d[float],
        trusted: wp.array3d[float],
        table: wp.array2d[float],
        cfa: wp.array2d[int],
        balance: wp.array[float],
        ellipse: wp.vec3,
        span: wp.vec2,
        level: float,
        y: float,
        x: float,
        reference: int,
        tiles_y: int,
        tiles_x: int,
        rows: int,
        cols: int,
        h: int,
        w: int,
        frames: int,
        period_y: int,
        period_x: int,
        reach: float,
    ):
        """Return one value per channel, the weight of each, and of all samples."""
        count = values()
        sum = values()
        middle = middles()
        matrix = mat55()
        right = vec5()
        terms = vec5()
        weights = values()
        all = float(0.0)
        block_y = wp.clamp(int(wp.floor(y + 0.5)), 0, rows - 1) / period_y
        block_x = wp.clamp(int(wp.floor(x + 0.5)), 0, cols - 1) / period_x
        for i in range(frames):
            share = trusted[i, block_y, block_x]
            if share > 0.0:
                at = place_in(
                    displacement, i, reference, y, x, tiles_y, tiles_x, period_y, period_x
                )
                dark = table[0, i]
                scale = table[1, i]
                full = table[4, i]
                for c in range(channels):
                    b = balance[c]
                    weights[c] = share / (b * (table[2, i] * level + b * table[3, i]))
                top = wp.max(int(wp.ceil(at[0] - span[0])), 0)
                bottom = wp.min(int(wp.floor(at[0] + span[0])), rows - 1)
                left = wp.max(int(wp.ceil(at[1] - span[1])), 0)
                last = wp.min(int(wp.floor(at[1] + span[1])), cols - 1)
                for v in range(top, bottom + 1):
                    for u in range(left, last + 1):
                        dy = float(v) - at[0]
                        dx = float(u) - at[1]
                        e = ellipse[0] * dy * dy + 2.0 * ellipse[1] * dy * dx + ellipse[2] * dx * dx
                        d = (dy * dy + dx * dx) / (reach * reach)
                        kernel = squared(squared(wp.max(1.0 - e / CUT, 0.0)))
                        near = kernel + PEDESTAL * squared(wp.max(1.0 - d, 0.0))
                        number = float(raw[i, v, u])
                        if near > 0.0 and number < full:
                            c = cfa[v % period_y, u % period_x]
                            weight = near * weights[c]
                            value = (number - dark) * scale * balance[c]
                            terms[0] = dy
                            terms[1] = dx
                            terms[2] = 0.5 * dy * dy
                            terms[3] = dy * dx
                            terms[4] = 0.5 * dx * dx
                            all += kernel * weights[c]
                            count[c] += weight
                            sum[c] += weight * value
                            for k in range(5):
                                part = weight * terms[k]
                                middle[c, k] += part
                                right[k] += part * value
                                for m in range(k + 1):
                                    matrix[k, m] += part * terms[m]
        for k in range(5):
            own = matrix[k, k]
            for c in range(channels):
                if count[c] > 0.0:
                    mean = middle[c, k] / count[c]
                    right[k] -= mean * sum[c]
                    for m in range(k + 1):
                        matrix[k, m] -= mean * middle[c, m]
            extra = BEND
            if k < 2:
                extra = SLOPE
            matrix[k, k] += ROUNDING * own + extra
        for k in range(5):
            for m in range(k + 1):
                rest = matrix[k, m]
                for j in range(m):
                    rest -= matrix[k, j] * matrix[m, j]
                if m < k:
                    matrix[k, m] = rest / matrix[m, m]
                else:
                    matrix[k, m] = wp.sqrt(wp.max(rest, SLOPE))
            for j in range(k):
                right[k] -= matrix[k, j] * right[j]
            right[k] /= matrix[k, k]
        for step in range(5):
            k = 4 - step
            for j in range(k + 1, 5):
                right[k] -= matrix[j, k] * right[j]
            right[k] /= matrix[k, k]
        found = more()
        for c in range(channels):
            rest = sum[c]
            for k in range(5):
                rest -= middle[c, k] * right[k]
            found[c] = level
            if count[c] > 0.0:
                found[c] = rest / count[c]
            found[channels + c] = count[c]
        found[2 * channels] = all
        return found

    @wp.func
    def luminance_of(values: more, balance: wp.array[float]):
        """Return the mean of balanced values with the weights of white's light in them."""
        sum = float(0.0)
        total = float(0.0)
        for c in range(channels):
            sum += values[c] / balance[c]
            total += 1.0 / balance[c]
        return sum / total

    @wp.kernel(module="unique", module_options=OPTIONS)
    def survey(
        # in:
        raw: wp.array3d[wp.uint16],
        displacement: wp.array4d[float],
        trusted: wp.array3d[float],
        table: wp.array2d[float],
        cfa: wp.array2d[int],
        balance: wp.array[float],
        # out:
        guide: wp.array3d[float],
        # params:
        reference: int,
        variance: float,
        # sizes:
        tiles_y: int,
        tiles_x: int,
        rows: int,
        cols: int,
        h: int,
        w: int,
        frames: int,
        period_y: int,
        period_x: int,
        reach: float,
    ):
        y, x = wp.tid()
        level = float(0.0)
        weight = float(0.0)
        for i in range(frames):
            share = trusted[i, y / period_y, x / period_x]
            if share > 0.0:
                at = place_in(
                    displacement,
                    i,
                    reference,
                    float(y),
                    float(x),
                    tiles_y,
                    tiles_x,
                    period_y,
                    period_x,
                )
                v = int(wp.floor(at[0] + 0.5))
                u = int(wp.floor(at[1] + 0.5))
                own = share / (table[2, i] + table[3, i])
                for j in range(wp.max(v - NEAR, 0), wp.min(v + NEAR, rows - 1) + 1):
                    for k in range(wp.max(u - NEAR, 0), wp.min(u + NEAR, cols - 1) + 1):
                        b = balance[cfa[j % period_y, k % period_x]]
                        level += own * (float(raw[i, j, k]) - table[0, i]) * table[1, i]
                        weight += own / b
        if weight > 0.0:
            level = wp.max(level / weight, 0.0)
        else:
            level = 0.0
        inverse = 1.0 / (ROUND * ROUND)
        span = wp.max(reach, wp.sqrt(CUT) * ROUND)
        found = fit(
            raw,
            displacement,
            trusted,
            table,
            cfa,
            balance,
            wp.vec3(inverse, 0.0, inverse),
            wp.vec2(span, span),
            level,
            float(y),
            float(x),
            reference,
            tiles_y,
            tiles_x,
            rows,
            cols,
            h,
            w,
            frames,
            period_y,
            period_x,
            reach,
        )
        luminance = luminance_of(found, balance)
        guide[0, y, x] = luminance
        guide[1, y, x] = variance / wp.max(found[2 * channels], 1.0e-20)
        for c in range(channels):
            guide[2 + c, y, x] = found[c] - luminance
            guide[2 + channels + c, y, x] = found[channels + c]

    @wp.kernel(module="unique", module_options=OPTIONS)
    def shape(
        # in:
        guide: wp.array3d[float],
        # out:
        ellipses: wp.array3d[float],
        tints: wp.array4d[float],
        # sizes:
        rows: int,
        cols: int,
    ):
        y, x = wp.tid()
        yy = float(0.0)
        yx = float(0.0)
        xx = float(0.0)
        total = float(0.0)
        mean = values()
        square = values()
        for j in range(-3, 4):
            for k in range(-3, 4):
                v = wp.clamp(y + j, 0, rows - 1)
                u = wp.clamp(x + k, 0, cols - 1)
                share = squared(squared(1.0 - float(j * j + k * k) / 20.0))
                dy = 0.5 * (guide[0, wp.min(v + 1, rows - 1), u] - guide[0, wp.max(v - 1, 0), u])
                dx = 0.5 * (guide[0, v, wp.min(u + 1, cols - 1)] - guide[0, v, wp.max(u - 1, 0)])
                yy += share * dy * dy
                yx += share * dy * dx
                xx += share * dx * dx
                total += share
                for c in range(channels):
                    tint = guide[2 + c, v, u]
                    mean[c] += share * tint
                    square[c] += share * tint * tint
        yy /= total
        yx /= total
        xx /= total
        variance = guide[1, y, x]
        half = 0.5 * (yy + xx)
        apart = 0.5 * (yy - xx)
        length = wp.sqrt(apart * apart + yx * yx)
        least = 1.0e-6 * variance
        across = wp.max(half + length - NOISE * variance, least)
        along = wp.max(half - length - NOISE * variance, least)
        a = 1.0 / squared(wp.clamp(WIDTH * wp.sqrt(wp.sqrt(variance / across)), NARROWEST, WIDEST))
        b = 1.0 / squared(wp.clamp(WIDTH * wp.sqrt(wp.sqrt(variance / along)), NARROWEST, WIDEST))
        cosine = float(0.0)
        sine = float(0.0)
        if length > 0.0:
            cosine = apart / length
            sine = yx / length
        ellipses[0, y, x] = 0.5 * (a + b + (a - b) * cosine)
        ellipses[1, y, x] = 0.5 * (a - b) * sine
        ellipses[2, y, x] = 0.5 * (a + b - (a - b) * cosine)
        for c in range(channels):
            middle = mean[c] / total
            own = guide[2 + channels + c, y, x]
            noise = float(0.0)
            if own > 0.0:
                noise = TINT / own
            tints[0, c, y, x] = middle
            tints[1, c, y, x] = wp.max(square[c] / total - middle * middle - noise, 0.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def regress(
        # in:
        raw: wp.array3d[wp.uint16],
        displacement: wp.array4d[float],
        trusted: wp.array3d[float],
        table: wp.array2d[float],
        cfa: wp.array2d[int],
        balance: wp.array[float],
        guide: wp.array3d[float],
        ellipses: wp.array3d[float],
        tints: wp.array4d[float],
        # out:
        out: wp.array3d[float],
        # params:
        reference: int,
        step: float,
        # sizes:
        tiles_y: int,
        tiles_x: int,
        rows: int,
        cols: int,
        h: int,
        w: int,
        high: int,
        wide: int,
        frames: int,
        period_y: int,
        period_x: int,
        reach: float,
    ):
        y, x = wp.tid()
        v = (float(y) + 0.5) * step - 0.5
        u = (float(x) + 0.5) * step - 0.5
        row = wp.clamp(int(wp.floor(v + 0.5)), 0, rows - 1)
        col = wp.clamp(int(wp.floor(u + 0.5)), 0, cols - 1)
        ellipse = wp.vec3(ellipses[0, row, col], ellipses[1, row, col], ellipses[2, row, col])
        determinant = ellipse[0] * ellipse[2] - ellipse[1] * ellipse[1]
        span = wp.vec2(
            wp.max(wp.sqrt(CUT * ellipse[2] / determinant), reach),
            wp.max(wp.sqrt(CUT * ellipse[0] / determinant), reach),
        )
        found = fit(
            raw,
            displacement,
            trusted,
            table,
            cfa,
            balance,
            ellipse,
            span,
            wp.max(guide[0, row, col], 0.0),
            v,
            u,
            reference,
            tiles_y,
            tiles_x,
            rows,
            cols,
            h,
            w,
            frames,
            period_y,
            period_x,
            reach,
        )
        luminance = luminance_of(found, balance)
        for c in range(channels):
            mean = tints[0, c, row, col]
            spread = tints[1, c, row, col] * found[channels + c]
            tint = found[c] - luminance - mean
            found[c] = luminance + mean + spread / (spread + TINT) * tint
        off = luminance_of(found, balance) - luminance
        for c in range(channels):
            out[c, y, x] = (found[c] - off) / balance[c]

    return {"survey": survey, "shape": shape, "regress": regress}


def specialise(kernel, CHANNELS, **others):
    """Return the kernel of this name for a number of channels."""
    return make_kernels(CHANNELS)[kernel]
