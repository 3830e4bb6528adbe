"""A picture from a Bayer mosaic in one pass: bilinear demosaicking, colour matrix, codes.

Ports: raw (rows, cols) uint16 [DN], or float32 [e-] with a converter; matrix (3, 3); thresholds
(255,) -> codes (rows, cols, 3) uint8.

For previews and videos: the planes between the stages, 3 x 4 bytes per pixel written and read
twice, stay in registers.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.display.encode import code_table, codes_defines, thresholds
from gpusim.kernels.processor.bayer import RED, check_mosaic, red_pixel
from gpusim.kernels.processor.bilinear import items
from gpusim.kernels.stage import Array, dtype_name, exact_case, stage


@stage
def develop(
    device: Device,
    raw: Array,
    matrix: Array,
    thresholds: Array,
    *,
    phase: str,
    black_level: float,
    scale: float,
    ceiling: Array | None = None,
    converter: tuple[float, float, float] | None = None,
) -> Array:
    """Return the result of `bilinear`, `color` and `encode`, bit for bit on the same device.

    Args:
        raw: Digital numbers [DN], uint16, or electrons [e-], float32, with a converter; shape
            (rows, cols).
        matrix: Colour matrix, shape (3, 3), see `color`.
        thresholds: Thresholds of the display codes, shape (255,), see `encode`.
        phase: "RGGB", "GRBG", "GBRG" or "BGGR".
        black_level: Black level [DN].
        scale: Factor of the camera values [1/DN].
        ceiling: Shape (3,) [1] or None, see `color`.
        converter: (gain [DN/e-], offset [DN], most [DN]): numbers are rint(min(max(gain e + offset,
            0), most)), as in `sensor.noise`. None for digital numbers.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Codes, shape (rows, cols, 3), uint8.

    Raises:
        BadData: Shapes or types do not fit, or the thresholds are not allowed.
        OutOfRange: `scale` or `converter` is not allowed.
        UnknownName: There is no such phase.
    """
    if tuple(matrix.shape) != (3, 3):
        raise BadData(f"develop: matrix of shape {tuple(matrix.shape)}, wanted (3, 3)")
    ceiling = np.full(3, np.inf) if ceiling is None else ceiling
    if tuple(ceiling.shape) != (3,):
        raise BadData(f"develop: ceiling of shape {tuple(ceiling.shape)}, wanted (3,)")
    _check(raw, scale, converter)
    red_row, red_col = red_pixel(phase)
    rows, cols = raw.shape
    table = code_table(device, thresholds)
    out = device.empty((rows, cols, 3), np.uint8)
    run, shape = items(device, cols)
    raw = device.array(raw, np.uint16 if converter is None else np.float32)
    arrays = [raw, device.array(matrix), device.array(ceiling), table.entries, out]
    numbers = [*map(float, converter or (1, 0, 1)), float(black_level), float(scale)]
    sizes = [red_row, red_col, *table.numbers, run, rows, cols]
    grid = (-(-rows // shape["ROWS"]), -(-cols // run))
    device.launch(
        "processor.develop",
        "develop",
        grid,
        *arrays,
        *numbers,
        *sizes,
        defines=shape | codes_defines(device, cols) | {"ELECTRONS": int(converter is not None)},
        group=None if device.is_gpu else (1, 1),
    )
    return out


def _check(raw, scale, converter):
    """Raise BadData or OutOfRange for a mosaic of neither digital numbers nor electrons."""
    if converter is None:
        return check_mosaic(raw, scale)
    dtype = dtype_name(raw)
    if len(raw.shape) != 2 or dtype not in ("float32", "float64") or 0 in raw.shape:
        raise BadData(
            f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (rows, cols) of float32 with a converter"
        )
    gain, offset, most = converter
    if not (gain > 0 and np.isfinite([gain, offset]).all() and 0 < most <= 65535):
        raise OutOfRange(
            "converter", tuple(converter), "(gain > 0 [DN/e-], offset [DN], 0 < most <= 65535 [DN])"
        )
    if not scale > 0:
        raise OutOfRange("scale", scale, "scale > 0")


def cases():
    """Yield cases.

    All phases, odd and degenerate sizes, with and without ceiling and converter, several curves.
    """
    random = np.random.default_rng(7)
    matrix = np.float32([[1.9, -0.6, -0.1], [-0.3, 1.5, -0.3], [0.05, -0.5, 1.6]])
    ceiling = np.float32([0.5, 0.9, 0.7])
    powers = iter([1.0, 1.8, 2.2, 2.6] * 7)
    for phase in RED:
        for rows, cols in ((1, 1), (1, 4), (5, 1), (2, 2), (3, 5), (33, 35), (16, 130)):
            raw = random.integers(0, 1100, (rows, cols), np.uint16)
            own = ceiling if rows % 2 else None
            yield _case(f"{phase} {rows}x{cols}", raw, matrix, next(powers), phase, own)
    electrons = random.uniform(-300, 5000, (19, 24)).astype(np.float32)
    electrons[3:6, 7:9] = np.array([[np.nan, np.inf], [-np.inf, 1e30], [-0.0, 1e-30]])
    for phase in RED:
        converter = 0.2371, 63.7, 1023
        yield _case(f"{phase} electrons", electrons, matrix, 2.2, phase, ceiling, converter)


def _case(
    name, raw, matrix, power, phase, ceiling, converter=None, black_level=64.0, scale=1 / 1024
):
    """Return a case with thresholds out of the reach of rounding: its codes must agree exactly."""
    from gpusim.kernels.processor.bilinear_ref import bilinear
    from gpusim.kernels.processor.color_ref import color
    from gpusim.kernels.processor.develop_ref import digitise

    numbers = raw if converter is None else digitise(raw, *converter)
    camera = bilinear(numbers, phase=phase, black_level=black_level, scale=scale)
    values = np.sort(color(camera, matrix, ceiling=ceiling), axis=None)
    band = 6 * 2.0**-24 * (np.abs(matrix) @ np.abs(camera).max((1, 2))).max()
    edges = thresholds(lambda code: code**power).astype(float)
    for k in range(255):  # upwards past every value too near
        edges[k] = max(edges[k], edges[k - 1] + band if k else 0.0)
        for value in values[np.searchsorted(values, edges[k] - 2 * band) :]:
            if value > edges[k] + 2 * band:
                break
            edges[k] = value + 3 * band
    return exact_case(
        name,
        "rounding moves a value by (2 + 3) 2^-24 of the sum of its terms at most (see bilinear and color), "
        "less than its distance from every threshold: the codes are equal",
        raw=raw,
        matrix=matrix,
        thresholds=edges.astype(np.float32),
        phase=phase,
        black_level=black_level,
        scale=scale,
        ceiling=ceiling,
        converter=converter,
    )


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic, sRGB."""
    raw = np.random.default_rng(2).integers(64, 1024, (rows, cols), np.uint16)
    matrix = np.float32([[1.9, -0.6, -0.3], [-0.3, 1.6, -0.3], [0.0, -0.5, 1.5]])
    return {
        "raw": raw,
        "matrix": matrix,
        "thresholds": thresholds(DISPLAYS["srgb"].decode),
        "phase": "RGGB",
        "black_level": 64.0,
        "scale": 1 / 959,
        "ceiling": np.ones(3, np.float32),
    }
