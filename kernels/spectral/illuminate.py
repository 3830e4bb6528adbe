"""Surfaces in several lights: an entry of a scene for every light and surface.

Ports: maps (lights, rows, cols) float32, coefficients (surfaces, rows, cols) float32 or float16 ->
(lights * surfaces, rows, cols) float32, light by light.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.domain.memory import type_of
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only


@stage
def illuminate(device: Device, maps: Array, coefficients: Array) -> Array:
    """Multiply every map with every plane of coefficients.

    Args:
        maps: Strength of each light, shape (lights, rows, cols).
        coefficients: Coefficients of the surfaces [1], shape (surfaces, rows, cols), float32 or
            float16, which is widened exactly.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Products, shape (lights * surfaces, rows, cols), float32.

    Raises:
        BadData: The shapes do not fit.
    """
    lights, surfaces, shape = check_inputs(maps, coefficients)
    is_half = type_of(coefficients) == np.float16
    maps = device.array(maps)
    coefficients = device.array(coefficients, np.float16 if is_half else np.float32)
    out = device.empty((lights * surfaces, *shape))
    if shape[0] * shape[1]:  # an inner loop that is not unrolled stops PoCL from vectorising
        arrays, sizes = [maps, coefficients, out], [*shape, *warp_only(device, lights, surfaces)]
        kernel = "illuminate_half" if is_half else "illuminate"
        defines = {"LIGHTS": lights, "SURFACES": surfaces}
        device.launch("spectral.illuminate", kernel, shape, *arrays, *sizes, defines=defines)
    return out


def check_inputs(maps, coefficients):
    """Return the numbers of lights and surfaces, and (rows, cols). Raise BadData."""
    if (
        len(maps.shape) != 3
        or len(coefficients.shape) != 3
        or maps.shape[1:] != coefficients.shape[1:]
    ):
        raise BadData(
            f"illuminate: maps {tuple(maps.shape)} and coefficients {tuple(coefficients.shape)}; wanted "
            "(lights, rows, cols) and (surfaces, rows, cols)"
        )
    return maps.shape[0], coefficients.shape[0], tuple(maps.shape[1:])


def cases():
    """Yield cases.

    One light and many, one surface and a cube's, odd sizes, no pixels, dark lights, negative
    coefficients, NaN.
    """
    random = np.random.default_rng(31)
    sizes = (1, 1, 1, 1), (2, 3, 5, 7), (3, 31, 63, 65), (2, 6, 1, 129), (5, 1, 17, 1), (2, 3, 0, 4)
    for lights, surfaces, *shape in sizes:
        maps = 10.0 ** random.uniform(-3, 4, (lights, *shape))
        maps = (maps * (random.random((lights, *shape)) > 0.2)).astype(np.float32)
        coefficients = random.normal(0, 1, (surfaces, *shape))
        for kind in (np.float32, np.float16):
            yield Case(
                f"{lights} lights, {surfaces} surfaces of {np.dtype(kind)}, {shape[0]}x{shape[1]}",
                {"maps": maps, "coefficients": coefficients.astype(kind)},
                2.0**-24,
                "one float32 product of exact inputs rounds once: half an ulp",
                metric="local",
            )
    wild = np.array([[[np.nan, np.inf, -0.0, 1e-20]]], np.float32)
    halves, why = np.full((2, 1, 4), 0.5, np.float32), "a product with a power of two is exact"
    yield exact_case("NaN and infinity", why, maps=halves, coefficients=wild)


def bench(rows, cols):
    """Return inputs: two lights on surfaces of seven coefficients."""
    random = np.random.default_rng(31)
    return {
        "maps": random.random((2, rows, cols), np.float32),
        "coefficients": random.random((7, rows, cols), np.float32),
    }


def operations(maps, coefficients):
    """Count operations: a multiplication for each sample of each product."""
    return len(maps) * coefficients.size
