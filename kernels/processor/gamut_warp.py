"""The way from a neutral by bisection: as gamut.cl."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.func
def along(back: wp.array2d[float], k: int, roots: wp.vec3, light: float, s: float):
    total = float(0.0)
    for c in range(3):
        root = light + s * (roots[c] - light)
        total += back[k, c] * (root * root * root)
    return total


@wp.kernel
def gamut(
    # in:
    rgb: wp.array3d[float],
    to_lms: wp.array2d[float],
    back: wp.array2d[float],
    lightness: wp.array1d[float],
    # out:
    out: wp.array3d[float],
    # params:
    bright: float,
    # sizes:
    steps: int,
    run: int,
    pixels: int,
):
    item = wp.tid()
    cols = rgb.shape[2]
    for i in range(item * run, wp.min((item + 1) * run, pixels)):
        y = i / cols
        x = i - y * cols
        red = rgb[0, y, x]
        green = rgb[1, y, x]
        blue = rgb[2, y, x]
        most = wp.max(wp.max(red, green), blue)
        least = wp.min(wp.min(red, green), blue)
        total = red + green + blue
        if (most <= 1.0 and least >= 0.0) or not wp.isfinite(total):
            out[0, y, x] = red
            out[1, y, x] = green
            out[2, y, x] = blue
        else:
            roots = wp.vec3(0.0, 0.0, 0.0)
            light = float(0.0)
            for k in range(3):
                lms = to_lms[k, 0] * red + to_lms[k, 1] * green + to_lms[k, 2] * blue
                root = wp.cbrt(lms)
                roots[k] = root
                light += lightness[k] * root
            light = wp.clamp(light, 0.0, bright)
            inside = float(0.0)
            outside = float(1.0)
            for _step in range(steps):
                middle = 0.5 * (inside + outside)
                most = along(back, 0, roots, light, middle)
                least = most
                for k in range(1, 3):
                    found = along(back, k, roots, light, middle)
                    most = wp.max(most, found)
                    least = wp.min(least, found)
                if most <= 1.0 and least >= 0.0:
                    inside = middle
                else:
                    outside = middle
            for k in range(3):
                found = along(back, k, roots, light, inside)
                out[k, y, x] = wp.clamp(found, 0.0, 1.0)
