"""Demosaicking of any mosaic by linear interpolation, with black level and scale.

Ports: raw (rows, cols) uint16 [DN], cfa (period_y, period_x) int32 -> planes (C, rows, cols)
float32, (DN - black_level) scale: the sensor's C channels, 1 at the white level if scale = 1 /
(white_level - black_level).

A pixel without a sample of a channel takes a weighted mean of the samples around it. Weights t fall
off as a tent, t = (1 - |dy| / h_y)(1 - |dx| / h_x). They are tilted to the value at the pixel of
the plane that fits the samples best,

    w_i = t_i (1, dy_i, dx_i) M^+ (1, 0, 0)',   M = sum over i of  t_i (1, dy_i, dx_i)'(1, dy_i, dx_i),

which reproduces a linear ramp exactly in any mosaic. Samples with a negative weight are left out
and the rest is weighted again, until there is none: nothing is extrapolated and noise is never
amplified. Each channel takes the smallest tent, h = min(k, period) for k = 1, 2, ..., that leaves
enough samples for that, and one in every block of h_y x h_x pixels around a pixel; the part of a
window inside a border then holds one too. Such a tent always exists: with h = period it
interpolates each sample of the period bilinearly in its own lattice and takes the mean.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.common.cases import MOSAICS, RGGB, bench_mosaic, random_mosaic
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage, warp_only

LONGEST_PERIOD = 8  # rows and columns of a mosaic
BLOCK = 32  # neighbouring pixels that CPUs process at once
LEAST = 1e-9  # smaller weights count as 0


@stage
def interpolate(
    device: Device, raw: Array, *, cfa: Array, black_level: float, scale: float
) -> Array:
    """Interpolate every channel at every pixel; measured samples are kept.

    A Bayer mosaic is interpolated bilinearly (`processor.bilinear`), except at borders: weights of
    samples outside the frame are left out, and the rest is scaled to a sum of 1. Constant channels
    stay constant everywhere, and linear ramps are exact if all samples lie inside the frame.
    Nothing is clipped.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        cfa: Channel of each pixel in one period of the mosaic, at most 8 x 8, whole numbers 0 .. C
            - 1 that all occur.
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Channels [1], shape (C, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16 or smaller than `least_frame`, or the mosaic is not
            allowed.
        OutOfRange: `scale` is not above 0.

    Source:
        Knutsson and Westin 1993, "Normalized and differential convolution", CVPR, 515-523, with a
        plane as the local model; as regression: Cleveland 1979, Journal of the American Statistical
        Association 74, 829-836.
    """
    check_mosaic(raw, scale)
    cfa = checked_mosaic(np.asarray(device.numpy(cfa)))
    rows, cols = raw.shape
    key = cfa.astype(np.int32).tobytes(), cfa.shape
    tents = _tents(*key)
    least = _least(tents)
    if rows < least[0] or cols < least[1]:
        raise BadData(
            f"raw: {rows}x{cols} pixels; with a mosaic of {cfa.shape[0]}x{cfa.shape[1]}, at least "
            f"{least[0]}x{least[1]} are wanted: every channel must be near every pixel"
        )
    blocks = is_opencl_cpu(device)
    starts, offsets, weights, reach = _tables(device, blocks, *key)
    channels = len(tents)
    out = device.empty((channels, rows, cols))
    arrays = [device.array(raw, np.uint16), starts, offsets, weights, out]
    numbers = [float(black_level), float(scale)]
    sizes = [*reach, *cfa.shape, weights.shape[1], rows, cols, *warp_only(device, channels)]
    device.launch(
        "processor.interpolate",
        "interpolate",
        (rows, 1) if blocks else (rows, cols),
        *arrays,
        *numbers,
        *sizes,
        defines={"CHANNELS": channels, "BLOCK": BLOCK if blocks else 1},
        group=(1, 1) if blocks else None,
    )
    return out


def least_frame(cfa: Array) -> tuple[int, int]:
    """Return rows and columns of the smallest frame of this mosaic that can be interpolated.

    Args:
        cfa: Channel of each pixel in one period of the mosaic.

    Returns:
        Rows and columns.

    Raises:
        BadData: The mosaic is not allowed.
    """
    cfa = checked_mosaic(np.asarray(cfa))
    return _least(_tents(cfa.astype(np.int32).tobytes(), cfa.shape))


def checked_mosaic(cfa):
    """Return the shortest period of the mosaic. Raise BadData if the mosaic is not allowed."""
    if (
        cfa.ndim != 2
        or not cfa.size
        or max(cfa.shape) > LONGEST_PERIOD
        or cfa.dtype.kind not in "iu"
    ):
        raise BadData(
            f"cfa: shape {cfa.shape} of {cfa.dtype}, wanted (rows, cols) of whole numbers, 1 to "
            f"{LONGEST_PERIOD} each way"
        )
    found = np.unique(cfa)
    if found[0] < 0 or found[-1] != len(found) - 1:
        raise BadData(
            f"cfa: channels {', '.join(map(str, found))}; wanted 0 .. C - 1, each in at least one pixel"
        )
    for axis, size in enumerate(cfa.shape):
        shortest = next(
            n for n in range(1, size + 1) if size % n == 0 and (np.roll(cfa, n, axis) == cfa).all()
        )
        cfa = cfa.take(range(shortest), axis)
    return cfa


@functools.lru_cache(maxsize=64)
def _tents(cfa, shape):
    """Return half-widths and weights of each channel's tent, see `_tent`."""
    cfa = np.frombuffer(cfa, np.int32).reshape(shape)
    return [_tent(cfa == c) for c in range(cfa.max() + 1)]


def _least(tents):
    return tuple(int(n) for n in np.max([half for half, _ in tents], axis=0))


def _tent(sampled):
    """Return half-widths of the smallest good tent for the samples of one period, and its weights.

    sampled: shape (period_y, period_x). Returns (h_y, h_x) and weights of each phase in the window,
    shape (period_y, period_x, 2 h_y - 1, 2 h_x - 1).
    """
    for k in range(1, max(sampled.shape) + 1):
        half = tuple(min(k, period) for period in sampled.shape)
        rows, cols = map(range, sampled.shape)
        weights = np.array([[_weights(sampled, half, y, x) for x in cols] for y in rows])
        blocks = np.lib.stride_tricks.sliding_window_view(weights, half, axis=(2, 3))
        if not np.isnan(weights).any() and (blocks > 0).any(axis=(4, 5)).all():
            return half, weights
    raise AssertionError("a tent as wide as the period always serves")


def _weights(sampled, half, y, x):
    """Return the weights of a window's samples at phase (y, x), NaN if too few are left.

    A pixel with its own sample takes only that.
    """
    dy, dx = np.mgrid[1 - half[0] : half[0], 1 - half[1] : half[1]]
    if sampled[y, x]:
        return ((dy == 0) & (dx == 0)).astype(float)
    tent = (1 - abs(dy) / half[0]) * (1 - abs(dx) / half[1])
    tent *= sampled[(y + dy) % sampled.shape[0], (x + dx) % sampled.shape[1]]
    plane = np.stack([np.ones(dy.shape), dy, dx])
    weights = np.full(tent.shape, -1.0)
    while weights.min() < -LEAST:
        moments = np.einsum("iyx,jyx,yx->ij", plane, plane, tent)
        weights = tent * np.tensordot(
            np.linalg.pinv(moments, rcond=LEAST, hermitian=True)[0], plane, 1
        )
        tent = np.where(weights < -LEAST, 0, tent)
    fits = np.allclose(np.tensordot(plane, weights, 2), (1, 0, 0), atol=LEAST)
    return np.where(weights > LEAST, weights, 0) if fits else np.full(tent.shape, np.nan)


@functools.lru_cache(maxsize=64)
def _tables(device, blocks, cfa, shape):
    """Return the taps of all phases on the device, and their reach (rows, cols).

    starts: first row of the lists of each (phase y, channel), and the end, shape (period_y C + 1,).
    offsets: (dy, dx) of each row of a list at each phase x, shape (N, period_x, 2). weights: shape
    (N, period_x), 0 for a tap that a phase does not have. With `blocks`, all phases of a row share
    its offset and read neighbours together, and the weights continue periodically for a block:
    shape (N, period_x + BLOCK - 1).
    """
    starts, offsets, weights = [0], [], []
    for y in range(shape[0]):
        for half, table in _tents(cfa, shape):
            used = np.argwhere((table[y] > 0).any(axis=0))
            if blocks:
                lists = [used] * shape[1]
            else:
                lists = [np.argwhere(window > 0) for window in table[y]]
            for n in range(max(map(len, lists))):
                taps = [taps[n] if n < len(taps) else None for taps in lists]
                offsets.append([(0, 0) if tap is None else tap - half + 1 for tap in taps])
                weights.append(
                    [0.0 if tap is None else table[y, x, *tap] for x, tap in enumerate(taps)]
                )
            starts.append(len(offsets))
    offsets = np.array(offsets, np.int32)
    if blocks:
        weights = np.pad(weights, ((0, 0), (0, BLOCK - 1)), mode="wrap")
    reach = tuple(int(n) for n in abs(offsets).max(axis=(0, 1)))
    starts = device.array(np.array(starts, np.int32), np.int32)
    return starts, device.array(offsets, np.int32), device.array(weights), reach


def cases():
    """Yield cases.

    Bayer, quad-Bayer, X-Trans, stripes, one channel, random 8 x 8, least frames, black, saturation.
    """
    random = np.random.default_rng(6)
    why = (
        "weights are positive with sum 1, so errors count in 2^-24 of the largest sample: of n <= 40 taps n + 1 "
        "(weight, product, sums), n of the sum of weights at borders, the quotient, black level, scale; 1 for "
        "65535 / 65471"
    )
    names = "Bayer", "quad-Bayer", "X-Trans", "stripes", "grey"
    mosaics = {name: MOSAICS[name] for name in names}
    mosaics["four of 8x8"] = random.permutation(np.arange(64) % 4).reshape(8, 8).astype(np.int32)
    mosaics["rare of 5x7"] = np.arange(35, dtype=np.int32).reshape(5, 7) // 17
    for name, cfa in mosaics.items():
        rows, cols = least_frame(cfa)
        for size in ((rows, cols), (rows + 1, cols + 5), (19, 150)):
            raw = random_mosaic(random, 65535, size)
            inputs = {"raw": raw, "cfa": cfa, "black_level": 64.0, "scale": 1 / 1024}
            yield Case(f"{name} {size[0]}x{size[1]}", inputs, (2 * 40 + 5) * 2.0**-24, why)
    yield exact_case(
        "saturated",
        "Bayer weights are powers of two or, at borders, their sums: the mean of equal 16-bit integers is exact",
        raw=np.full((40, 50), 65535, np.uint16),
        cfa=RGGB,
        black_level=0.0,
        scale=1.0,
    )


def bench(rows, cols):
    """Return inputs: a 10-bit X-Trans mosaic."""
    return {**bench_mosaic(2, rows, cols), "cfa": MOSAICS["X-Trans"]}
