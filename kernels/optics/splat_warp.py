"""One pixel per thread visits all lights; most are out of reach or need a few loads."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def splat(
    # in:
    mosaic: wp.array2d[float],
    cfa: wp.array2d[int],
    places: wp.array2d[int],
    strength: wp.array[float],
    cores: wp.array4d[float],
    profiles: wp.array3d[float],
    centres: wp.array2d[float],
    streaks: wp.array4d[float],
    lines: wp.array2d[float],
    corners: wp.array2d[float],
    # out:
    out: wp.array2d[float],
    # params:
    per_pixel: float,
    spread_y: float,
    spread_x: float,
    fine: float,
    width: float,
    parts_y: int,
    parts_x: int,
    # sizes:
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
    lights: int,
    channels: int,
    core: int,
    length: int,
    count: int,
    samples: int,
):
    y, x = wp.tid()
    channel = cfa[y % period_y, x % period_x]
    corner_y = -0.5 * float(parts_y - 1)
    corner_x = -0.5 * float(parts_x - 1)
    share = 1.0 / float(parts_y * parts_x)
    last = 0.5 * float(samples - 1)
    half_core = core // 2
    total = float(0.0)
    for h in range(lights):
        dy = y - places[h, 0]
        dx = x - places[h, 1]
        away = wp.max(wp.abs(dy), wp.abs(dx))
        kernel = places[h, 2]
        if away <= places[h, 3]:
            if away <= half_core:
                total += strength[h] * cores[kernel, channel, dy + half_core, dx + half_core]
            else:
                cy = float(dy) - centres[kernel, 0]
                cx = float(dx) - centres[kernel, 1]
                far = float(0.0)
                for i in range(parts_y):
                    for j in range(parts_x):
                        v = wp.abs(cy) + spread_y * (corner_y + float(i))
                        u = wp.abs(cx) + spread_x * (corner_x + float(j))
                        radius = wp.sqrt(v * v + u * u) * per_pixel
                        at = wp.min(int(radius), length - 2)
                        left = profiles[kernel, channel, at]
                        far += left + wp.min(radius - float(at), 1.0) * (
                            profiles[kernel, channel, at + 1] - left
                        )
                if count == 0:
                    total += strength[h] * share * far
                else:
                    square = cy * cy + cx * cx
                    far *= share
                    first = float(0.0)
                    before = float(0.0)
                    both = float(0.0)
                    for k in range(count):
                        along = cy * lines[k, 0] + cx * lines[k, 1]
                        across = cy * lines[k, 1] - cx * lines[k, 0]
                        off = wp.abs(across) * fine
                        ratio = float(1.0)
                        if off > last:
                            ratio = last / off
                        place = wp.clamp(across * fine + last, 0.0, 2.0 * last)
                        n = wp.min(int(place), samples - 2)
                        low = streaks[kernel, channel, k, n]
                        value = low + (place - float(n)) * (
                            streaks[kernel, channel, k, n + 1] - low
                        )
                        far += along * along / (square * square) * value * (ratio * ratio)
                        slant = along * across / (across * across + width * width)
                        if k == 0:
                            first = slant
                        else:
                            both += before * slant
                        before = slant
                    if count > 1:
                        far += (
                            corners[kernel, channel] * (both + before * first) / (square * square)
                        )
                    total += strength[h] * wp.max(far, 0.0)
    out[y, x] = mosaic[y, x] + total
