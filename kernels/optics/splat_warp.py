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
    # out:
    out: wp.array2d[float],
    # params:
    per_pixel: float,
    spread: float,
    parts: int,
    # sizes:
    rows: int,
    cols: int,
    period_y: int,
    period_x: int,
    lights: int,
    channels: int,
    core: int,
    length: int,
):
    y, x = wp.tid()
    channel = cfa[y % period_y, x % period_x]
    corner = -0.5 * float(parts - 1)
    share = 1.0 / float(parts * parts)
    total = float(0.0)
    for h in range(lights):
        dy = wp.abs(y - places[h, 0])
        dx = wp.abs(x - places[h, 1])
        kernel = places[h, 2]
        if wp.max(dy, dx) <= places[h, 3]:
            if wp.max(dy, dx) < core:
                total += strength[h] * cores[kernel, channel, dy, dx]
            else:
                far = float(0.0)
                for i in range(parts):
                    for j in range(parts):
                        v = float(dy) + spread * (corner + float(i))
                        u = float(dx) + spread * (corner + float(j))
                        radius = wp.sqrt(v * v + u * u) * per_pixel
                        at = wp.min(int(radius), length - 2)
                        left = profiles[kernel, channel, at]
                        far += left + wp.min(radius - float(at), 1.0) * (
                            profiles[kernel, channel, at + 1] - left
                        )
                total += strength[h] * share * far
    out[y, x] = mosaic[y, x] + total
