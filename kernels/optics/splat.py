"""Point lights added to a mosaic: their kernels, in each pixel's own channel, summed directly.

Ports: mosaic (rows, cols) float32, cfa (ph, pw), places (N, 4) int32 (row, column, kernel, reach),
strength (N,) float32, cores (kernels, channels, n, n) and profiles (kernels, channels, m) float32
-> (rows, cols) float32:

    out(x) = mosaic(x) + sum over h of  strength_h K_c(x - x_h),   |x - x_h| <= reach_h along both axes.

K_c is the core at |dy|, |dx| < n. Beyond it, K_c is the mean of the radial profile over parts x
parts points of the pixel. No transform is involved, so the neighbours of a light of 1e9 and the far
side of the frame stay exact to float32.
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
    parts: int,
    spread: float,
) -> Array:
    """Add point lights to a mosaic.

    Args:
        mosaic: Light before, shape (rows, cols).
        cfa: Channel of each pixel in one period of the mosaic, shape (ph, pw).
        places: Row and column [pixel] (they may lie outside), index of the kernel, and farthest
            pixel reached, shape (N, 4).
        strength: Light of each point, shape (N,).
        cores: Kernels by pixel offset [1], shape (K, C, n, n).
        profiles: Kernels by radius 0, step, 2 step ... [1], linear in between, shape (K, C, m).
        step: Step of the profiles' radius [pixel].
        parts: Points per side of a pixel, beyond the core.
        spread: Distance of these points [pixel].
        device: A `Device`, or its name for `open_device`.

    Returns:
        The mosaic with the lights, shape (rows, cols), float32.
    """
    rows, cols = mosaic.shape
    mosaic = device.array(mosaic)
    cfa = device.array(cfa, np.int32)
    places = device.array(places, np.int32)
    strength, cores, profiles = (device.array(values) for values in (strength, cores, profiles))
    out = device.empty((rows, cols))
    arrays = [mosaic, cfa, places, strength, cores, profiles, out]
    numbers = [1 / step, float(spread), int(parts)]
    sizes = [rows, cols, *cfa.shape, places.shape[0], *cores.shape[1:3], profiles.shape[2]]
    device.launch("optics.splat", "splat", (rows, cols), *arrays, *numbers, *sizes)
    return out


def cases():
    """Yield cases.

    Lights inside, at the corner and outside, one to many parts, short and whole reach, 1e9 over
    1e-3.
    """
    random = np.random.default_rng(6)
    why = (
        "a kernel value errs by a few ulp, its radius by an ulp of 40 pixels, 4e-6, on a profile whose slope is "
        "below its value over 1 pixel; the sum of ten positive terms by ten half ulps"
    )
    for rows, cols, parts, reach in ((1, 1, 1, 5), (33, 41, 2, 64), (20, 65, 4, 9)):
        radius = np.hypot(*np.mgrid[:6, :6])
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
            "parts": parts,
            "spread": 1 / parts,
        }
        name = f"{rows}x{cols}, {parts} parts, reach {reach}"
        yield Case(name, inputs, 1e-5, why, metric="local")


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
        "cores": random.random((16, 3, 33, 33), np.float32),
        "profiles": random.random((16, 3, length), np.float32),
        "step": 1 / 64,
        "parts": 2,
        "spread": 0.5,
    }
