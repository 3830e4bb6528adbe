"""One frequency of one band per thread; the table of a band stays in cache."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.optics.mosaic_warp import times

wp.set_module_options({"enable_backward": False})


@wp.func
def cubic(t: float):  # weights of the cubic through the nodes -1, 0, 1, 2 at t
    return wp.vec4(
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )


@wp.func
def place(s: float, length: int):  # 1 - sqrt(1 - s) without its cancellation, in nodes
    return s / (1.0 + wp.sqrt(1.0 - s)) * float(length - 1)


@wp.kernel
def radial(
    # in:
    table: wp.array2d[float],
    q: wp.array[float],
    weight_y: wp.array2d[float],
    weight_x: wp.array2d[float],
    fy: wp.array[float],
    fx: wp.array[float],
    # out:
    tables: wp.array3d[float],
    # params:
    low: int,
    high: int,
    length: int,
    # sizes:
    bands: int,
    rows: int,
    cols: int,
):
    band, y, x = wp.tid()
    total = float(0.0)
    for a in range(low, high + 1):
        v = q[band] * (fy[y] + float(a))
        for b in range(low, high + 1):
            u = q[band] * (fx[x] + float(b))
            s = wp.sqrt(u * u + v * v)
            if s < 1.0:
                at = place(s, length)
                i = wp.clamp(int(at), 1, length - 3)
                c = cubic(at - float(i))
                value = (
                    c[0] * table[band, i - 1] + c[1] * table[band, i] + c[2] * table[band, i + 1]
                )
                value += c[3] * table[band, i + 2]
                total += value * weight_y[a - low, y] * weight_x[b - low, x]
    tables[band, y, x] = total


@wp.kernel
def polar(
    # in:
    table: wp.array4d[float],
    q: wp.array[float],
    weight_y: wp.array3d[float],
    weight_x: wp.array3d[float],
    fy: wp.array[float],
    fx: wp.array[float],
    # out:
    tables: wp.array3d[float],
    # params:
    low: int,
    high: int,
    angle: float,
    sides: int,
    inner: float,
    sectors: int,
    per_sector: int,
    length: int,
    # sizes:
    bands: int,
    rows: int,
    cols: int,
):
    band, y, x = wp.tid()
    rays = sectors * per_sector
    total = wp.vec2(0.0, 0.0)
    for a in range(low, high + 1):
        v = q[band] * (fy[y] + float(a))
        for b in range(low, high + 1):
            u = q[band] * (fx[x] + float(b))
            s = wp.sqrt(u * u + v * v)
            inside = s < 1.0
            turn = (wp.atan2(v, u) - angle) / wp.PI  # in half turns, then within [0, 1)
            whole = wp.floor(turn)
            turn -= whole
            sign = float(1.0)
            if int(whole) % 2 != 0:
                sign = -1.0
            if sides > 0:  # s of the cut-off's nearest side
                part = turn * float(sides) / 2.0
                s *= wp.cos((part - wp.rint(part)) * 2.0 * wp.PI / float(sides)) / inner
            if inside and s < 1.0:
                ray = turn * float(rays)
                start = wp.min(int(ray) / per_sector, sectors - 1) * per_sector
                j = start + wp.clamp(int(ray) - start, 1, per_sector - 2)
                across = cubic(ray - float(j))
                at = place(s, length)
                i = wp.clamp(int(at), 1, length - 3)
                along = cubic(at - float(i))
                value = wp.vec2(0.0, 0.0)
                for k in range(4):
                    for m in range(4):
                        weight = across[k] * along[m]
                        value += weight * wp.vec2(
                            table[band, j + k - 1, i + m - 1, 0],
                            table[band, j + k - 1, i + m - 1, 1],
                        )
                weights = times(
                    wp.vec2(weight_y[a - low, y, 0], weight_y[a - low, y, 1]),
                    wp.vec2(weight_x[b - low, x, 0], weight_x[b - low, x, 1]),
                )
                total += times(weights, wp.vec2(value[0], sign * value[1]))
    tables[band, y, 2 * x] = total[0]
    tables[band, y, 2 * x + 1] = total[1]


@wp.kernel
def crease(
    # in:
    lines: wp.array2d[float],
    sizes: wp.array4d[float],
    q: wp.array[float],
    weight_y: wp.array3d[float],
    weight_x: wp.array3d[float],
    fy: wp.array[float],
    fx: wp.array[float],
    # out:
    tables: wp.array3d[float],
    # params:
    low: int,
    high: int,
    reach: float,
    nodes: int,
    period: int,
    # sizes:
    creases: int,
    places: int,
    bands: int,
    rows: int,
    cols: int,
):
    band, y = wp.tid()
    one = q[band]
    step = 1.0 / float(nodes)
    at_y = fy[y] * float(nodes)
    ty = at_y - wp.floor(at_y)
    cy = cubic(ty)
    scale = float(places - 1) / (2.0 * reach)
    for k in range(creases):
        ny = lines[k, 0]
        nx = lines[k, 1]
        offset = lines[k, 2] / one
        sign = lines[k, 3] * one
        wide = 2.0 * (wp.abs(ny) + wp.abs(nx)) * step
        end = reach / one + wide
        for a in range(low, high + 1):
            v = fy[y] + float(a)
            rest = ny * v - offset
            first = float(low) - 1.0  # of u: near the line, and not beyond its ends
            last = float(high) + 1.0
            if wp.abs(nx) > 1.0e-6:
                first = wp.max(first, -rest / nx - wide / wp.abs(nx))
                last = wp.min(last, -rest / nx + wide / wp.abs(nx))
            elif wp.abs(rest) >= wide:
                last = first - 1.0
            if wp.abs(ny) > 1.0e-6:
                first = wp.max(first, nx * v / ny - end / wp.abs(ny))
                last = wp.min(last, nx * v / ny + end / wp.abs(ny))
            elif wp.abs(nx * v) >= end:
                last = first - 1.0
            for b in range(low, high + 1):
                begin = wp.max(int(wp.ceil((first - float(b)) * float(period))), 0)
                stop = wp.min(int(wp.floor((last - float(b)) * float(period))), cols - 1)
                for x in range(begin, stop + 1):
                    u = fx[x] + float(b)
                    place_ = ((nx * v - ny * u) * one + reach) * scale
                    if place_ > 0.0 and place_ < float(places - 1):
                        i = wp.min(int(place_), places - 2)
                        here = wp.vec2(sizes[band, k, i, 0], sizes[band, k, i, 1])
                        slope = wp.vec2(sizes[band, k, i + 1, 0], sizes[band, k, i + 1, 1]) - here
                        here = here + (place_ - float(i)) * slope
                        at_x = fx[x] * float(nodes)
                        tx = at_x - wp.floor(at_x)
                        away = rest + nx * u
                        cx = cubic(tx)
                        # |away|, and that times the place, less cubics through them
                        none = wp.abs(away)
                        once = float(0.0)
                        for m in range(4):
                            dy = (float(m - 1) - ty) * step
                            for n in range(4):
                                dx = (float(n - 1) - tx) * step
                                tap = cy[m] * cx[n] * wp.abs(away + ny * dy + nx * dx)
                                none -= tap
                                once -= tap * (nx * dy - ny * dx)
                        value = sign * (none * here + once * one * scale * slope)
                        weights = times(
                            wp.vec2(weight_y[a - low, y, 0], weight_y[a - low, y, 1]),
                            wp.vec2(weight_x[b - low, x, 0], weight_x[b - low, x, 1]),
                        )
                        value = times(weights, value)
                        tables[band, y, 2 * x] += value[0]
                        tables[band, y, 2 * x + 1] += value[1]
