"""Denoising of any mosaic before demosaicking: non-local means at a noise of 1 everywhere.

Ports: raw (rows, cols) uint16 [DN] -> (rows, cols) uint16 with black at 4096 and white at 65535
(see levels.py); demosaick it with black_level = 4096, scale = 1 / 61439.

A digital number d above black has the variance g d + s^2. The generalised Anscombe transform makes
it 1. Here it has no constant and no difference of large numbers:

    u = 2 d / (sqrt(max(g d + c, 0)) + sqrt(c)),   c = s^2 + 3/8 g^2        (g = 0: u = d / s)

From the mean of u over the similar pixels around, with n = sum of weights,

    d = g u^2 / 4 + sqrt(c) u + g / 4 (1 - 1 / n)

is unbiased up to terms of 1 / d: the inverse transform itself at n = 1, and g / 4 more for a mean
of many, as in Anscombe (1948). From 5 e- on it is closer to the mean (.01 e-) than the closed form
of Makitalo and Foi (.02 e-), which is for small counts without read noise.

Pixels are compared up to `SEARCH` periods of the mosaic away, which aligns all colours of the two
patches of 3 x 3 pixels. t is the mean square of the patches' differences, 2 if only noise differs:

    weight = min(1, max(0, 1 - (t / strength^2 - 2) / SOFT))^2

With these weights only, the two greens of a Bayer mosaic would be averaged separately, and the
noise left in their difference would form a maze at the highest frequency. A pixel whose diagonal
neighbours have its colour in a period of 2 x 2 is therefore also compared with the 16 of them 1 or
3 pixels down and along. Their patches are the nine nearest pixels on diagonals, all of that colour.
Their weights have a factor that makes their sum as large as the sum of the first kind, MOST_TWIN at
most. In uniform surroundings both greens then have the same part in the mean, and their difference,
even of their gains, has none.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import MOSAICS, RGGB, mosaic
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.interpolate import checked_mosaic
from gpusim.kernels.processor.levels import (
    CORRECTED_BLACK,
    CORRECTED_WHITE,
    check_black,
    check_noise,
)
from gpusim.kernels.processor.shade import shade
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage

SEARCH = 2  # periods each way
SOFT = 6.0  # from the expected 2 to weight 0; 5 to 8 differ by less than .1 dB
# flat fields take 25 / 16, for 24 pixels and the own one against 16; more would blur
MOST_TWIN = 2.0
BAND = 4  # rows of a work-item (denoise_warp.py too): they share the squares of their differences
# columns of a CPU's work-item, and columns beyond that it reads: four are needed
CHUNK = 64
SPARE = 8


@stage
def denoise(
    device: Device,
    raw: Array,
    *,
    cfa: Array,
    black_level: float,
    scale: float,
    noise: tuple[float, float],
    strength: float = 1.0,
) -> Array:
    """Average every pixel with those of its colour that have similar surroundings.

    Outside the frame the mosaic continues with its outermost periods.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16, at least one period of the mosaic.
        cfa: Channel of each pixel in one period of the mosaic, at most 8 x 8, whole numbers 0 .. C
            - 1 that all occur.
        black_level: Black level [DN].
        scale: 1 / (white_level - black_level) [1/DN].
        noise: (gain [DN/e-], read [DN]): the variance of a digital number is gain (DN -
            black_level) + read^2. (0, 0), like strength 0, only changes the scale.
        strength: Assumed over true standard deviation of the noise [1], 0 to 100.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Numbers with black at 4096 and white at 65535, shape (rows, cols), uint16.

    Raises:
        BadData: `raw` is no mosaic of uint16, is smaller than a period, or the mosaic is not
            allowed.
        OutOfRange: `black_level`, `scale`, `noise` or `strength` is not allowed.

    Source:
        Buades, Coll and Morel 2005, "A non-local algorithm for image denoising", CVPR, with a
        compact weight; for mosaics Buades, Coll, Morel and Sbert 2009, IEEE Trans. Image Processing
        18, 1192; Anscombe 1948, Biometrika 35, 246; Makitalo and Foi 2013, IEEE Trans. Image
        Processing 22, 91.
    """
    check_mosaic(raw, scale)
    check_black(black_level)
    gain, read = check_noise(noise)
    if not 0 <= strength <= 100:
        raise OutOfRange("strength", strength, "0 <= strength <= 100")
    cfa = checked_mosaic(np.asarray(device.numpy(cfa)))
    rows, cols = raw.shape
    if rows < cfa.shape[0] or cols < cfa.shape[1]:
        raise BadData(
            f"raw: {rows}x{cols} pixels; wanted at least one period of the mosaic, "
            f"{cfa.shape[0]}x{cfa.shape[1]}"
        )
    if strength == 0 or gain == read == 0:
        ones = np.ones((int(cfa.max()) + 1, 2, 2), np.float32)
        return shade(raw, ones, cfa=cfa, black_level=black_level, scale=scale, device=device)
    lines = is_opencl_cpu(device)
    chunk, spare = (CHUNK, SPARE) if lines else (1, 4)
    constant = read * read + 0.375 * gain * gain
    margin_y, margin_x = (SEARCH * n + 1 for n in cfa.shape)
    bands, chunks = -(-rows // BAND), -(-cols // chunk)
    code = device.empty((bands * BAND + 2 * margin_y, chunks * chunk + 2 * margin_x + spare))
    out = device.empty((rows, cols), np.uint16)
    twins = [
        MOST_TWIN * float(cfa.shape == (2, 2) and cfa[0, x] == cfa[1, 1 - x])
        for x in (0, cfa.shape[1] - 1)
    ]
    launch = functools.partial(
        device.launch,
        "processor.denoise",
        group=(1, 1) if lines else None,
        defines={"CHUNK": chunk, "SPARE": spare, "BAND": BAND},
    )
    lowest = float(-constant / gain if gain else -3e38)
    numbers = [float(black_level), float(gain), float(constant), lowest]
    sizes = [*cfa.shape, margin_y, margin_x, rows, cols]
    grid = (code.shape[0], 1) if lines else code.shape
    launch("stabilise", grid, device.array(raw, np.uint16), code, *numbers, *sizes, *code.shape)
    numbers = [
        float(1 + 2 / SOFT),
        float(1 / (9 * SOFT * strength**2)),
        float(gain / 4),
        float(np.sqrt(constant)),
        float(scale * (CORRECTED_WHITE - CORRECTED_BLACK)),
        float(CORRECTED_BLACK),
        *twins,
    ]
    launch("denoise", (bands, chunks), code, out, *numbers, *sizes, code.shape[1])
    return out


def cases():
    """Yield cases: mosaics, sizes down to one period, noise models, edges, black, saturation."""
    random = np.random.default_rng(11)
    why = (
        "u and its mean have some 2^-24 x 40 of the largest u, 2 sqrt(4095 / g) <= 130, which is < 4e-4 of a "
        "standard deviation of noise; that is at most 61439 / 4031 sqrt(4095 g + s^2) < 1000 steps, so .4: the "
        "rounding to whole numbers differs by one step at most"
    )
    eight = random.permutation(np.arange(64) % 4).reshape(8, 8).astype(np.int32)
    mosaics = MOSAICS | {"checkers": mosaic("RG", "GR"), "8x8": eight}
    for name in ("Bayer", "GRBG", "GBRG", "checkers", "X-Trans", "grey", "8x8"):
        cfa = mosaics[name]
        for rows, cols in (cfa.shape, (9, 11), (45, 131)):
            ramp = np.add.outer(np.arange(rows), 2 * np.arange(cols))
            light = random.poisson(np.where(ramp % 70 < 40, 200.0, 1500.0))
            raw = 64 + np.round(light + 3 * random.standard_normal((rows, cols)))
            raw = raw.clip(0, 4095).astype(np.uint16)
            raw.flat[0], raw.flat[-1] = 0, 4095
            for noise in ((1.0, 3.0), (0.0, 20.0), (1.0, 0.0)) if rows == 45 else ((1.0, 3.0),):
                inputs = {"cfa": cfa, "black_level": 64.0, "scale": 1 / 4031, "noise": noise}
                title = f"{name} {rows}x{cols}, noise {noise}"
                yield Case(title, {"raw": raw, **inputs}, 1.0, why, metric="exact")
    raw = random.integers(0, 65536, (40, 70), np.uint16)
    options = {"raw": raw, "cfa": RGGB, "black_level": 4096.0, "scale": 1 / 61439}
    why = "nothing changes: see processor.shade with gains of 1"
    yield exact_case("noise-free", why, **options, noise=(0.0, 0.0))
    yield exact_case("strength 0", why, **options, noise=(1.0, 2.0), strength=0.0)


def bench(rows, cols):
    """Return inputs: a 10-bit Bayer mosaic of 100 e- and 5 e- of read noise at 0.2 DN/e-."""
    random = np.random.default_rng(11)
    raw = 64 + 0.2 * random.poisson(100, (rows, cols)) + random.standard_normal((rows, cols))
    return {
        "raw": raw.astype(np.uint16),
        "cfa": RGGB,
        "black_level": 64.0,
        "scale": 1 / 959,
        "noise": (0.2, 1.0),
    }
