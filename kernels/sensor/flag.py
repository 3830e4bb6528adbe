"""Which pixels of a chip are dead or hot, as a map for `processor.defects`.

Ports: response [1], dark [e- s-1] float32 of the chip, either may be None -> (out_rows, out_cols)
uint8:

    flag = 255 if response = 0 or dark > least in any of the pixels that become one; else 0.

Pixels are binned as in `sensor.bin`. The result is the same on every device. NaN is no defect.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.stage import Array, exact_case, stage


@stage
def flag(
    device: Device,
    response: Array | None = None,
    dark: Array | None = None,
    *,
    least: float = 0.0,
    binning: tuple[int, int] = (1, 1),
    stride: tuple[int, int] = (1, 1),
) -> Array:
    """Return the map of dead and hot pixels.

    Args:
        response: Relative response [1], shape (rows, cols), see `sensor.pattern`; None for 1.
        dark: Dark current in excess of the common one [e- s-1], shape (rows, cols); None for 0.
        least: Dark current that a hot pixel exceeds [e- s-1].
        binning: Rows and columns that become one, as for `sensor.bin`.
        stride: Distance of neighbours of one colour along both axes [pixel].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Flags, 255 at defects, shape `binned_shape((rows, cols), binning, stride)`, uint8.

    Raises:
        BadData: Both planes are None, they differ in shape, or `least` is NaN.
        OutOfRange: `binning` or `stride` does not fit, as for `sensor.bin`.
    """
    rows, cols = check_planes(response, dark, least)
    out_shape = binned_shape((rows, cols), binning, stride)
    planes = [None if plane is None else device.array(plane) for plane in (response, dark)]
    use = [int(plane is not None) for plane in planes]
    flags = device.empty(out_shape, np.uint8)
    arrays = [*(planes[1 - n] if plane is None else plane for n, plane in enumerate(planes)), flags]
    numbers = [*use, float(least), *map(int, binning), *map(int, stride), cols, *out_shape]
    device.launch("sensor.flag", "flag", out_shape, *arrays, *numbers)
    return flags


def check_planes(response, dark, least):
    """Return rows and columns of the chip. Raise BadData as `flag` does."""
    shapes = {tuple(plane.shape) for plane in (response, dark) if plane is not None}
    if len(shapes) != 1 or len(min(shapes)) != 2 or 0 in min(shapes):
        raise BadData(
            f"defects: planes of shapes {sorted(shapes)}, wanted response, dark or both, (rows, cols)"
        )
    if least != least:
        raise BadData("defects: least is NaN, wanted a dark current")
    return min(shapes)


def cases():
    """Yield cases.

    With and without each plane, binned in mosaics and not, odd sizes, NaN, infinities, denormals,
    -0.
    """
    random = np.random.default_rng(14)
    for rows, cols, binning, stride in (
        (1, 1, (1, 1), (1, 1)),
        (13, 37, (1, 1), (1, 1)),
        (33, 45, (2, 2), (2, 2)),
        (41, 70, (3, 2), (4, 1)),
        (64, 64, (8, 8), (1, 1)),
    ):
        planes = {
            "response": np.where(random.random((rows, cols)) < 0.02, 0, 1).astype(np.float32),
            "dark": np.where(random.random((rows, cols)) < 0.02, 5.0, 0).astype(np.float32),
        }
        above = np.nextafter(np.float32(3), np.float32(9))
        hard = np.array([np.nan, np.inf, -np.inf, 1e-45, -0.0, 3.0, above])
        for plane in planes.values():
            places = np.arange(0, plane.size, max(1, plane.size // 7))[:7]
            plane.flat[places] = hard[: len(places)]
        for chosen in (("response",), ("dark",), ("response", "dark")):
            name = f"{rows}x{cols}, binning {binning}, stride {stride}, {' '.join(chosen)}"
            yield exact_case(
                name,
                "comparisons only",
                **{part: planes[part] for part in chosen},
                least=3.0,
                binning=binning,
                stride=stride,
            )
    dark = np.array([[0, 1e-45, -1, np.nan, np.inf]], np.float32)
    yield exact_case("any dark current", "comparisons only; denormals count", dark=dark)


def bench(rows, cols):
    """Return inputs: a thousandth of the pixels dead, as many hot."""
    random = np.random.default_rng(14)
    response = (random.random((rows, cols)) > 1e-3).astype(np.float32)
    dark = (random.random((rows, cols)) < 1e-3).astype(np.float32)
    return {"response": response, "dark": dark}
