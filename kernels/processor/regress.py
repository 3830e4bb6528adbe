"""Merged demosaicking: a picture of all channels from the samples of several frames.

Ports: raw (frames, rows, cols) uint16 [DN], displacement (frames, tiles_y, tiles_x, 2) float32
[period], trusted (frames, h, w) float32 (see `processor.trust`), cfa (period_y, period_x) int32 ->
planes (C, high, wide) float32 [rate], high = round(enlarge rows), wide = round(enlarge cols).

Around each place p of the reference, the samples n of all frames are fitted by least squares. The
displaced frames have samples at many fractions of a pixel, so no mosaic is interpolated: with the
distance d of a sample from p, its channel c, and its rate times balance_c, which makes white 1,

    n ~ a_c + g d + d' H d / 2,

one value a_c per channel, and slopes g and bends H that all channels share, as edges do. The result
is a_c / balance_c. The weight of a sample is K(d) t / v: t is the trust in its frame, v the
variance at the local level, shot rate + floor, and K the kernel

    K(d) = (1 - d' M d / CUT)^4 + PEDESTAL (1 - d^2 / WIDE^2)^2,   brackets below 0 count as 0.

The first term is nearly a Gaussian with the inverse covariance M. The second is as wide as the
mosaic needs for a sample of every channel. Samples that are full are left out. SLOPE and BEND, of
white 1, keep g and H from following the noise where there are few samples.

M comes from a first fit with a round kernel of ROUND pixels: its luminance changes by the structure
tensor, a mean of g g' over 7 x 7 pixels, with the eigenvalues l across and along an edge. Along
each of both, the kernel has the standard deviation

    WIDTH (s^2 / (l - NOISE s^2))^(1/4), from NARROWEST to WIDEST,

where s^2 is the variance of a luminance sample over all frames: kernels are wide where noise hides
what changes, and along edges.

Colours change less than light does. With the luminance Y, the mean of a_c with the weights 1 /
balance_c, the tint a_c - Y is drawn towards its mean over the same 7 x 7 pixels in the first fit,

    tint -> mean + t^2 / (t^2 + TINT / n_c) (tint - mean),

where n_c is the weight of the channel's samples, TINT / n_c the variance of its noise, and t^2 the
variance of the tint in the window less that of the first fit's noise. Y stays.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import MOSAICS, moving_picture
from gpusim.kernels.processor.align import TILE
from gpusim.kernels.processor.interpolate import checked_mosaic
from gpusim.kernels.processor.refine import case_table, check_stack
from gpusim.kernels.stage import Array, Case, stage, warp_only

ROUND = 0.8  # [pixel] kernel of the first fit
NARROWEST, WIDEST = 0.45, 2.0  # [pixel] kernels of the second
WIDTH, NOISE = 1.3, 0.5
TINT = 0.25  # variance of a tint's noise, over that of one sample with the weight of all
CUT = 9.0  # squared distance at which a kernel ends
PEDESTAL = 1e-3
SLOPE, BEND = 1.0, 10.0  # inverse variances of slopes and bends, of white 1
ROUNDING = 1e-5  # share by which the diagonal is made larger, for float32
NEAR = 1  # [pixel] reach of the samples that tell the level
ENLARGES = 1.0, 3.0
MOST_FRAMES = 64


@stage
def regress(
    device: Device,
    raw: Array,
    displacement: Array,
    trusted: Array,
    *,
    cfa: Array,
    table: Array,
    balance: Array,
    reference: int = 0,
    enlarge: float = 1.0,
) -> Array:
    """Return rates of all channels at every pixel of the reference, or at more places.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16; 1 to 64 frames.
        displacement: Displacement of every tile [period], shape (frames, tiles_y, tiles_x, 2).
        trusted: Trust in every frame, shape (frames, h, w), of each period of the mosaic.
        cfa: Channel of each pixel in one period of the mosaic, at most 8 x 8, whole numbers 0 .. C
            - 1 that all occur.
        table: Numbers of each frame, see `processor.refine`.
        balance: 1 / rate of white in each channel, shape (C,).
        reference: Number of the frame that stays in place.
        enlarge: Places per pixel along rows and columns, 1 to 3.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Rates, shape (C, high, wide), float32, in the unit of `table`.

    Raises:
        BadData: Shapes or types do not fit.
        OutOfRange: `reference`, `enlarge`, `balance` or a number of `table` is not allowed.

    Source:
        Takeda, Farsiu and Milanfar 2007, "Kernel regression for image processing and
        reconstruction", IEEE Transactions on Image Processing 16(2); Wronski et al. 2019, "Handheld
        multi-frame super-resolution", ACM Transactions on Graphics 38(4), for samples of a mosaic.
    """
    cfa = np.asarray(device.numpy(cfa)).astype(np.int32)
    checked_mosaic(cfa)
    table = check_stack(raw, displacement, reference, cfa.shape, table)
    count, rows, cols = raw.shape
    h, w = -(-rows // cfa.shape[0]), -(-cols // cfa.shape[1])
    if tuple(trusted.shape) != (count, h, w) or count > MOST_FRAMES:
        raise BadData(
            f"trusted: shape {tuple(trusted.shape)}, wanted {(count, h, w)}, as processor.trust gives it, "
            f"of at most {MOST_FRAMES} frames"
        )
    balance = np.asarray(balance, np.float32)
    channels = int(cfa.max()) + 1
    if balance.shape != (channels,) or not (np.isfinite(balance) & (balance > 0)).all():
        raise OutOfRange("balance", balance.tolist(), f"{channels} numbers above 0")
    if not ENLARGES[0] <= enlarge <= ENLARGES[1]:
        raise OutOfRange("enlarge", enlarge, f"{ENLARGES[0]:g} .. {ENLARGES[1]:g}")
    high, wide = enlarged_shape((rows, cols), enlarge)
    defines = {
        "CHANNELS": channels,
        "TILE": TILE,
        "PERIOD_Y": cfa.shape[0],
        "PERIOD_X": cfa.shape[1],
        "NEAR": NEAR,
        "WIDE": f"{reach_of_mosaic(cfa):.6f}f",
        "ROUND": f"{ROUND}f",
        "NARROWEST": f"{NARROWEST}f",
        "WIDEST": f"{WIDEST}f",
        "WIDTH_": f"{WIDTH}f",
        "NOISE": f"{NOISE}f",
        "TINT": f"{TINT}f",
        "CUT": f"{CUT}f",
        "PEDESTAL": f"{PEDESTAL}f",
        "SLOPE": f"{SLOPE}f",
        "BEND": f"{BEND}f",
        "ROUNDING": f"{ROUNDING}f",
    }
    launch = functools.partial(device.launch, "processor.regress", defines=defines)
    arrays = [
        device.array(raw, np.uint16),
        device.array(displacement),
        device.array(trusted),
        device.array(table),
        device.array(cfa, np.int32),
        device.array(balance),
    ]
    sizes = [*map(int, displacement.shape[1:3]), rows, cols, h, w]
    more = [count, *warp_only(device, *cfa.shape, reach_of_mosaic(cfa))]
    guide, ellipses = device.empty((2 + 2 * channels, rows, cols)), device.empty((3, rows, cols))
    tints = device.empty((2, channels, rows, cols))
    out = device.empty((channels, high, wide))
    # integral of the kernel over its round ellipse
    weight = CUT * np.pi / 5 * ROUND**2
    launch("survey", (rows, cols), *arrays, guide, int(reference), weight, *sizes, *more)
    launch("shape", (rows, cols), guide, ellipses, tints, rows, cols)
    numbers = [int(reference), 1 / enlarge, *sizes, high, wide, *more]
    launch("regress", (high, wide), *arrays, guide, ellipses, tints, out, *numbers)
    return out


def enlarged_shape(shape: tuple[int, int], enlarge: float) -> tuple[int, int]:
    """Return rows and columns of the result for those of the frames."""
    return round(shape[0] * enlarge), round(shape[1] * enlarge)


@functools.cache
def _reach(cfa, shape):
    mosaic = np.frombuffer(cfa, np.int32).reshape(shape)
    tiled = np.tile(mosaic, (5, 5))
    halves = [np.arange(2 * n) / 2 + 2 * n for n in shape]
    farthest = 0.0
    for channel in range(mosaic.max() + 1):
        y, x = np.nonzero(tiled == channel)
        squares = (halves[0][:, None, None] - y) ** 2 + (halves[1][:, None] - x) ** 2
        farthest = max(farthest, float(squares.min(axis=-1).max()))
    return farthest**0.5 + 0.5


def reach_of_mosaic(cfa: np.ndarray) -> float:
    """Return the distance [pixel] within which every place has a sample of each channel.

    Half a pixel is added, because places between half pixels are not looked at.
    """
    return _reach(np.ascontiguousarray(cfa, np.int32).tobytes(), cfa.shape)


def cases():
    """Yield cases: mosaics, fractions, full pixels, frames without trust, enlarges, one frame."""
    random = np.random.default_rng(10)
    why = (
        "in 2^-24: normal equations of up to 64 samples a frame, 2^7 roundings, whose condition ROUNDING bounds by "
        "1e5 for the bends; these count in a value with at most PEDESTAL^(1/2) = 1/32 where they are as badly "
        "determined: 2^7 1e5 / 32 2^-24 < 0.03 of what differs within a kernel, a tenth of the largest value"
    )
    for name, rows, cols, count, enlarge in (
        ("Bayer", 16, 37, 3, 1.0),
        ("Bayer", 9, 10, 2, 1.5),
        ("GBRG", 9, 12, 1, 1.0),
        ("grey", 9, 11, 3, 2.0),
        ("X-Trans", 14, 13, 2, 1.0),
        ("Bayer", 3, 3, 2, 1.0),
    ):
        cfa = MOSAICS[name]
        raw = moving_picture(random, np.zeros((count, 2), int), rows, cols, 3 * max(cfa.shape))
        raw[-1, rows // 2, cols // 2] = 4000
        sizes = [(rows, cols)[k] // cfa.shape[k] for k in (0, 1)]
        tiles = (max(1, -(-size // TILE)) for size in sizes)
        blocks = (-(-(rows, cols)[k] // cfa.shape[k]) for k in (0, 1))
        table = case_table(count)
        table[1:4] /= np.array([[4000.0], [4000.0], [4000.0**2]])
        inputs = {
            "raw": raw,
            "displacement": random.normal(0, 0.3, (count, *tiles, 2)).astype(np.float32),
            "trusted": random.integers(0, 3, (count, *blocks)).astype(np.float32) / 2,
            "cfa": cfa,
            "table": table,
            "balance": np.linspace(1, 1.8, cfa.max() + 1).astype(np.float32),
            "reference": count // 2,
            "enlarge": enlarge,
        }
        inputs["trusted"][count // 2] = 1
        yield Case(f"{name} {count} frames {rows}x{cols}, enlarge {enlarge:g}", inputs, 3e-3, why)


def bench(rows, cols):
    """Return inputs: eight frames of a Bayer mosaic, displaced by fractions."""
    random = np.random.default_rng(10)
    cfa = MOSAICS["Bayer"]
    raw = moving_picture(random, random.integers(-20, 21, (8, 2)), rows, cols, 8)
    tiles = (max(1, -(-(n // 2) // TILE)) for n in (rows, cols))
    table = case_table(8)
    table[1:4] = np.array([[1 / 4000], [1 / 4000], [25 / 4000**2]])
    return {
        "raw": raw,
        "displacement": random.normal(0, 3, (8, *tiles, 2)).astype(np.float32),
        "trusted": np.ones((8, -(-rows // 2), -(-cols // 2)), np.float32),
        "cfa": cfa,
        "table": table,
        "balance": np.array([1.8, 1.0, 1.5], np.float32),
    }
