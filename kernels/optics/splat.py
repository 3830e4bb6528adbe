"""Point lights added to a mosaic: their kernels, in each pixel's own channel, summed directly.

Ports: mosaic (rows, cols) float32, cfa (ph, pw), places (N, 4) int32 (row, column, kernel, reach),
strength (N,) float32, cores (kernels, channels, n, n), n odd, profiles (kernels, channels, m),
centres (kernels, 2), streaks (kernels, channels, lines, a), lines (lines, 2), corners (kernels,
channels) float32 -> (rows, cols) float32:

    out(x) = mosaic(x) + sum over h of  strength_h K_c(x - x_h),   |x - x_h| <= reach_h along both axes.

K_c is the core at |dy|, |dx| <= n // 2. Beyond it, at d from the kernel's centre, K_c is the mean of
the radial profile over parts x parts points of the pixel, plus the streaks of a pupil's straight
sides, plus what corners between neighbouring lines fill in:

    sum over lines of  (n d)^2 / |d|^4 T(t d)  +  corner / |d|^4 sum of s s',   s = (n d) (t d) / ((t d)^2 + width^2),

n = (y, x) the line's direction, t = (x, -y) across it, T linear between its samples, as across^-2
beyond the last. No transform is involved, so the neighbours of a light of 1e9 and the far side of
the frame stay exact to float32.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.cases import RGGB
from gpusim.kernels.stage import Array, Case, stage


@stage
def splat(
    device: Device,
    mosaic: Array,
    cfa: Array,
    places: Array,
    strength: Array,
    cores: Array,
    profiles: Array,
    step: float,
    parts: tuple[int, int],
    spread: tuple[float, float],
    centres: Array | None = None,
    streaks: Array | None = None,
    lines: Array | None = None,
    corners: Array | None = None,
    fine: float = 1.0,
    width: float = 1.0,
) -> Array:
    """Add point lights to a mosaic.

    Args:
        mosaic: Light before, shape (rows, cols).
        cfa: Channel of each pixel in one period of the mosaic, shape (ph, pw).
        places: Row and column [pixel] (they may lie outside), index of the kernel, and farthest
            pixel reached, shape (N, 4).
        strength: Light of each point, shape (N,).
        cores: Kernels by pixel offset -n // 2 .. n // 2 [1], shape (K, C, n, n).
        profiles: Kernels by radius 0, step, 2 step ... [1], linear in between, shape (K, C, m).
        step: Step of the profiles' radius [pixel].
        parts: Points along the height and width of a pixel, beyond the core.
        spread: Distances of these points [pixel].
        centres: Middles of the kernels beyond the core, from the places (rows, cols) [pixel],
            shape (K, 2); None: 0.
        streaks: Profiles across the streaks, of lines in turn, shape (K, C, D, a); None: no lines.
        lines: Directions (y, x) of the lines, shape (D, 2).
        corners: Factors of the light between neighbouring lines, shape (K, C).
        fine: Samples of `streaks` per pixel.
        width: Width within which the light between lines is a streak's [pixel].
        device: A `Device`, or its name for `open_device`.

    Returns:
        The mosaic with the lights, shape (rows, cols), float32.
    """
    rows, cols = mosaic.shape
    mosaic = device.array(mosaic)
    cfa = device.array(cfa, np.int32)
    places = device.array(places, np.int32)
    strength, cores, profiles = (device.array(values) for values in (strength, cores, profiles))
    kernels, channels = cores.shape[:2]
    count = 0
    if streaks is None:
        streaks, lines = np.zeros((1, 1, 1, 2)), np.zeros((1, 2))
    else:
        count = streaks.shape[2]
    if centres is None:
        centres = np.zeros((kernels, 2))
    if corners is None:
        corners = np.zeros((kernels, channels))
    more = [device.array(values) for values in (centres, streaks, lines, corners)]
    out = device.empty((rows, cols))
    arrays = [mosaic, cfa, places, strength, cores, profiles, *more, out]
    numbers = [1 / step, *map(float, spread), float(fine), float(width), *map(int, parts)]
    sizes = [rows, cols, *cfa.shape, places.shape[0], channels, cores.shape[2], profiles.shape[2]]
    sizes += [count, streaks.shape[3]]
    device.launch("optics.splat", "splat", (rows, cols), *arrays, *numbers, *sizes)
    return out


def cases():
    """Yield cases.

    Lights inside, at the corner and outside, one to many parts, short and whole reach, 1e9 over
    1e-3; kernels of several centres, without and with streaks.
    """
    random = np.random.default_rng(6)
    why = (
        "a kernel value errs by a few ulp, its radius by an ulp of 40 pixels, 4e-6, on a profile whose slope is "
        "below its value over 1 pixel; the sum of ten positive terms by ten half ulps; light between lines has both "
        "signs, and is as large as the rest"
    )
    for rows, cols, parts, reach, count in (
        (1, 1, 1, 5, 0),
        (33, 41, 2, 64, 0),
        (20, 65, 4, 9, 0),
        (21, 34, 2, 60, 3),
        (17, 30, 1, 60, 2),
    ):
        radius = np.hypot(*np.mgrid[-5:6, -5:6])
        distances = 0.05 * np.arange(2200)
        cores, profiles = (
            np.stack([[width / (1 + r**2) ** 1.5 for width in (1, 2, 3)]] * 2).astype(np.float32)
            for r in (radius, distances)
        )
        places = [random.integers(-3, n + 3, 10) for n in (rows, cols)]
        places = np.stack([*places, random.integers(0, 2, 10), np.full(10, reach)], axis=1)
        places[0, :2] = 0
        inputs = {
            "mosaic": np.full((rows, cols), 1e-3, np.float32),
            "cfa": RGGB,
            "places": places.astype(np.int32),
            "strength": (10.0 ** random.uniform(0, 9, 10)).astype(np.float32),
            "cores": cores,
            "profiles": profiles,
            "step": 0.05,
            "parts": (parts, parts + (count > 0)),
            "spread": (1 / parts, 0.8 / (parts + (count > 0))),
        }
        name = f"{rows}x{cols}, {parts} parts, reach {reach}"
        if count:
            across = np.arange(-20, 21) / 2
            angles = 0.3 + np.pi * np.arange(count) / count
            inputs |= {
                "centres": np.array([[0.0, 0.0], [0.4, -1.3]], np.float32),
                "streaks": np.tile(1 / (1 + across**2), (2, 3, count, 1)).astype(np.float32),
                "lines": np.stack([np.sin(angles), np.cos(angles)], axis=1).astype(np.float32),
                "corners": np.full((2, 3), -0.1, np.float32),
                "fine": 2.0,
                "width": 1.0,
            }
            name += f", {count} lines"
        yield Case(name, inputs, 1e-5 if not count else 3e-5, why, metric="local")


def bench(rows, cols):
    """Return inputs: sixteen lights over the whole frame."""
    random = np.random.default_rng(6)
    length = int(64 * 1.5 * max(rows, cols))
    mosaic = random.random((rows, cols), np.float32)
    places = [random.integers(0, n, 16) for n in (rows, cols)]
    places = np.stack([*places, np.arange(16), np.full(16, max(rows, cols))], axis=1)
    return {
        "mosaic": mosaic,
        "cfa": RGGB,
        "places": places.astype(np.int32),
        "strength": np.ones(16, np.float32),
        "cores": random.random((16, 3, 65, 65), np.float32),
        "profiles": random.random((16, 3, length), np.float32),
        "step": 1 / 64,
        "parts": (2, 2),
        "spread": (0.5, 0.5),
    }
