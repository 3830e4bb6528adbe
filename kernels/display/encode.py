"""Display encoding: linear RGB to 8-bit codes, by any increasing curve.

Ports: rgb (3, rows, cols) float32, linear; thresholds (255,) float32 -> codes (rows, cols, 3)
uint8.

The code of a value is the number of thresholds at or below it; threshold k is the least value with
code k. Devices need no power function and agree bit for bit.

Curves of displays are steep near black and shallow near white, close to a power law, so bins whose
width is proportional to their distance from black suit them. A bin holds the floats that share
their exponent and the first bits of their mantissa, with the fewest bits that leave at most one
threshold in a bin. Seven bits, in 1632 to 3004 bins, are enough for sRGB and exponents of 1.8 to
2.6. With s the number of bits below those, and `place` the value's bits counted from the first
bin's, bin b begins at place b 2^s. The code in a bin whose threshold is at place t, with c
thresholds before, is

    c + (place >= t) = (c 2^s + 2^s - t + place) >> s     as 0 <= place - b 2^s, t - b 2^s <= 2^s,

one entry c 2^s + 2^s - t of a table, modulo 2^32, one sum and one shift. In a bin without a
threshold, t is the bin's end.
"""

import functools
from collections.abc import Callable

import numpy as np

from gpusim.backends import Device
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, exact_case, stage

MANTISSA = 23  # bits
MOST_BINS = 2**15  # 128 KiB; the table should stay in a core's own cache
LEAST = 1e-30  # least threshold: devices may treat denormals as 0


@stage
def encode(device: Device, rgb: Array, thresholds: Array) -> Array:
    """Return codes of linear values; values outside the thresholds get 0 or 255, and NaN is black.

    Args:
        rgb: Linear values, shape (3, rows, cols).
        thresholds: Least values with code 1, 2, ... 255, shape (255,), float32, increasing; see the
            function `thresholds`. A tone curve before the display's makes one curve with it.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Codes, shape (rows, cols, 3), uint8.

    Raises:
        BadData: The thresholds are not 255 increasing values, or too steep.
    """
    _, rows, cols = rgb.shape
    pixels = rows * cols
    table, defines = code_table(device, thresholds), codes_defines(device, pixels)
    out = device.empty((rows, cols, 3), np.uint8)
    step = 4 if device.kind == "opencl" else 1
    run = step if device.is_gpu else 2048  # pixels of an item; a GPU wants many small ones
    arrays = [device.array(rgb), table.entries, out]
    sizes = [*table.numbers, run, pixels]
    group = None if device.is_gpu else (1,)
    grid = (-(-pixels // run),)
    device.launch("display.encode", "encode", grid, *arrays, *sizes, defines=defines, group=group)
    return out


def thresholds(decode: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the least float32 with code 1, 2, ... 255, with codes rounded to the nearest.

    Args:
        decode: Increasing function from codes as fractions of the largest, 0 .. 1, to linear
            values, float64; for example `gpusim.domain.display.Display.decode`.

    Returns:
        decode((k - 1/2) / 255) rounded up to float32, shape (255,).

    Raises:
        BadData: The curve does not increase, or is not finite.
    """
    linear = np.asarray(decode((np.arange(1, 256) - 0.5) / 255), np.float64)
    with np.errstate(over="ignore"):
        nearest = linear.astype(np.float32)
    return check_thresholds(
        np.where(nearest < linear, np.nextafter(nearest, np.float32(np.inf)), nearest)
    )


def check_thresholds(thresholds) -> np.ndarray:
    """Return the thresholds as float32. Raise BadData as `encode` does."""
    edges = np.asarray(thresholds, np.float32)
    if edges.shape != (255,):
        raise BadData(
            f"thresholds: shape {edges.shape}, wanted (255,): the smallest values of codes 1 .. 255"
        )
    if not (np.isfinite(edges).all() and edges[0] >= LEAST):
        raise BadData(
            f"thresholds: {edges.min():g} .. {edges.max():g}, wanted finite values of {LEAST:g} and more"
        )
    if not (np.diff(edges) > 0).all():
        code = int(np.argmin(np.diff(edges) > 0)) + 1
        raise BadData(
            f"thresholds: {edges[code - 1]:g} of code {code} is followed by {edges[code]:g}; wanted a curve "
            "that increases, by more than the spacing of float32 from code to code"
        )
    return edges


class CodeTable:
    """Thresholds in the form that the kernels read (kernels/common/codes.clh).

    Attributes:
        entries: Array of the device, uint32.
        numbers: Value at which the first bin begins, last threshold, and number of bits of a float
            below those that name its bin.
    """

    def __init__(self, device, edges):
        bits = edges.view(np.int32).astype(np.int64)
        for shift in range(MANTISSA, -1, -1):
            named = bits >> shift
            if (np.diff(named) > 0).all():
                break
        # values clamped to the first bin's start are below the first threshold
        first = (bits[0] - 1) >> shift
        if named[-1] - first >= MOST_BINS:
            code = int(np.argmin(np.diff(edges) / edges[1:])) + 1
            raise BadData(
                f"thresholds: too steep a curve, {edges[code - 1]:.7g} of code {code} is followed by "
                f"{edges[code]:.7g} while the first is {edges[0]:.3g}; wanted a smoother curve"
            )
        bins = np.arange(first, named[-1] + 1)
        below = np.searchsorted(named, bins)  # thresholds before the bin
        ends = (bins + 1) << shift
        places = np.minimum(np.append(bits, ends[-1])[below], ends) - (first << shift)
        self.entries = device.array(((below + 1 << shift) - places) % 2**32, np.uint32)
        bottom = np.array(first << shift, np.int32).view(np.float32)
        self.numbers = float(bottom), float(edges[-1]), shift


def code_table(device, thresholds) -> CodeTable:
    """Return the table of these thresholds on a device, cached. Raise BadData as `encode` does."""
    return _code_table(device, np.asarray(device.numpy(thresholds), np.float32).tobytes())


@functools.lru_cache(maxsize=16)
def _code_table(device, content):
    return CodeTable(device, check_thresholds(np.frombuffer(content, np.float32)))


def codes_defines(device, cols) -> dict:
    """Return the defines of codes.clh: alignment of rows of `cols` pixels, access to the table."""
    if device.kind != "opencl":
        return {}
    packed = not device.is_gpu or cols % 4 != 0
    return {
        "VOLATILE": "" if device.is_gpu else "volatile",
        "PACKED": "__attribute__((packed))" if packed else "",
        "LOAD4(from)": "vload4(0, from)" if packed else "*(__global const float4 *)(from)",
    }


def cases():
    """Yield cases.

    A fine grid, every boundary of several curves, HDR, negative, NaN, infinities; odd sizes.
    """
    why = "the code is a count of exact comparisons: bit for bit"
    random = np.random.default_rng(6)
    srgb = thresholds(DISPLAYS["srgb"].decode)
    for rows, cols in ((1, 1), (2, 2), (3, 5), (63, 65)):
        rgb = random.uniform(-0.2, 1.3, (3, rows, cols)).astype(np.float32)
        yield exact_case(f"{rows}x{cols}", why, rgb=rgb, thresholds=srgb)
    grid = (np.arange(3 * 2**16) / (3 * 2**16 - 1)).astype(np.float32).reshape(3, 256, 256)
    yield exact_case("grid", why, rgb=grid, thresholds=srgb)
    curves = {"sRGB": srgb} | {
        f"exponent {power}": thresholds(lambda v, power=power: v**power)
        for power in (1.0, 1.8, 2.2, 2.6, 4.0)
    }
    powers = np.concatenate([2.0 ** np.arange(-90, 0), np.arange(1, 166)])
    curves["powers of two"] = powers.astype(np.float32)
    for name, edges in curves.items():
        near = [np.nextafter(edges, np.float32(end)) for end in (0, np.inf)]
        near = np.stack([near[0], edges, near[1]])
        title = f"one step around every boundary, {name}"
        yield exact_case(title, why, rgb=near[:, None], thresholds=edges)
    below = np.nextafter(np.float32(1), 0)
    odd = np.array([np.nan, np.inf, -np.inf, -0.0, 1e30, -1e30, 1e-45, 1.0, below], np.float32)
    odd = np.tile(odd, 5).reshape(3, 5, 3)
    yield exact_case("NaN, infinities, extremes", why, rgb=odd, thresholds=srgb)


def bench(rows, cols):
    """Return inputs: a full range of values, sRGB."""
    rgb = np.random.default_rng(6).random((3, rows, cols), np.float32)
    return {"rgb": rgb, "thresholds": thresholds(DISPLAYS["srgb"].decode)}
