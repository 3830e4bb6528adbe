"""Denoising of a mosaic of any colours before demosaicking: non-local means where the noise is 1 everywhere.

Ports: raw (rows, cols) uint16 [DN] -> (rows, cols) uint16 with black at 4096 and white at 65535 (see levels.py);
demosaick it with black_level = 4096, scale = 1 / 61439.

A digital number d above black has the variance g d + s^2. The generalised Anscombe transform, here with its constant
left out and no difference of large numbers, makes that 1:

    u = 2 d / (sqrt(max(g d + c, 0)) + sqrt(c)),   c = s^2 + 3/8 g^2        (g = 0: u = d / s)

The mean of u over the pixels around that look alike, n = sum of weights, has an expectation of which

    d = g u^2 / 4 + sqrt(c) u + g / 4 (1 - 1 / n)

is unbiased up to terms of 1 / d: the inverse transform itself at n = 1, and g / 4 more, as Anscombe (1948) has it, for
a mean of many. From 5 e- on it is nearer to the mean (.01 e-) than the closed form of Makitalo & Foi (.02 e-), which is
made for small counts without read noise.

Pixels are compared `SEARCH` periods of the mosaic around, so that all colours of the two patches of 3 x 3 pixels meet
their own: with t the mean square of the patches' differences, which is 2 where only noise differs,

    weight = min(1, max(0, 1 - (t / strength^2 - 2) / SOFT))^2

That alone would average the two greens of a Bayer mosaic apart, and what noise is left in their difference is a maze at
the highest frequency. So a pixel whose diagonal neighbours are of its colour in a period of 2 x 2 also meets the 16
of them 1 or 3 pixels down and along. Patches are there the nine pixels next to one another on diagonals, all of that
colour. Their weights are multiplied by what makes them together as heavy as those of the first kind, by MOST_TWIN at
most: where all look alike, both greens have the same part in the mean, and their difference, even of their gains, none.
"""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.interpolate import BAYER, X_TRANS, checked_mosaic
from gpusim.kernels.processor.levels import (
    CORRECTED_BLACK,
    CORRECTED_WHITE,
    check_black,
    check_noise,
)
from gpusim.kernels.processor.shade import shade
from gpusim.kernels.stage import Case, stage

SEARCH = 2  # periods each way
SOFT = 6.0  # beyond the expected 2, where the weight is 0; 5 to 8 differ by less than .1 dB
MOST_TWIN = (
    2.0  # flat fields take 25 / 16, for 24 pixels and the own one against 16; more would blur
)
BAND = 4  # rows that a work-item does (denoise_warp.py too): they share the squares of their differences
CHUNK, SPARE = (
    64,
    8,
)  # columns that a CPU's work-item does, and columns beyond that it reads: four are needed


@stage
def denoise(device, raw, *, cfa, black_level, scale, noise, strength=1.0):
    """Average every pixel with those of its colour whose surroundings look alike.

    raw: shape (rows, cols) uint16 [DN], at least one period of the mosaic. cfa: channel of each pixel of one period, at
    most 8 x 8, whole numbers 0 .. C - 1 that all occur. black_level [DN]. scale: 1 / (white_level - black_level)
    [1/DN]. noise: (gain [DN/e-], read [DN]), by which a digital number varies by gain (DN - black_level) + read^2.
    (0, 0), like strength 0, only changes the scale. strength: over that of the noise [1].
    Outside the frame the mosaic goes on with its outermost periods.
    Returns shape (rows, cols) uint16. Raises BadData, OutOfRange.
    Source: Buades, Coll & Morel 2005, "A non-local algorithm for image denoising", CVPR, with a compact weight; on
    mosaics: Buades, Coll, Morel & Sbert 2009, IEEE Trans. Image Processing 18, 1192; Anscombe 1948, Biometrika 35, 246;
    Makitalo & Foi 2013, IEEE Trans. Image Processing 22, 91.
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
        return shade(
            raw,
            np.ones((int(cfa.max()) + 1, 2, 2), np.float32),
            cfa=cfa,
            black_level=black_level,
            scale=scale,
            device=device,
        )
    lines = device.kind == "opencl" and not device.is_gpu
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
    group, defines = (1, 1) if lines else None, {"CHUNK": chunk, "SPARE": spare, "BAND": BAND}
    device.launch(
        "processor.denoise",
        "stabilise",
        (code.shape[0], 1) if lines else code.shape,
        device.array(raw, np.uint16),
        code,
        float(black_level),
        float(gain),
        float(constant),
        float(-constant / gain if gain else -3e38),
        *cfa.shape,
        margin_y,
        margin_x,
        rows,
        cols,
        *code.shape,
        group=group,
        defines=defines,
    )
    device.launch(
        "processor.denoise",
        "denoise",
        (bands, chunks),
        code,
        out,
        float(1 + 2 / SOFT),
        float(1 / (9 * SOFT * strength**2)),
        float(gain / 4),
        float(np.sqrt(constant)),
        float(scale * (CORRECTED_WHITE - CORRECTED_BLACK)),
        float(CORRECTED_BLACK),
        *twins,
        *cfa.shape,
        margin_y,
        margin_x,
        rows,
        cols,
        code.shape[1],
        group=group,
        defines=defines,
    )
    return out


def cases():
    """Mosaics, sizes down to one period, noise models, edges, black, saturation."""
    random = np.random.default_rng(11)
    why = (
        "u and its mean have some 2^-24 x 40 of the largest u, 2 sqrt(4095 / g) <= 130, which is < 4e-4 of a "
        "standard deviation of noise; that is at most 61439 / 4031 sqrt(4095 g + s^2) < 1000 steps, so .4: the "
        "rounding to whole numbers differs by one step at most"
    )
    for name, cfa in (
        ("Bayer", BAYER),
        ("GRBG", ((1, 0), (2, 1))),
        ("GBRG", ((1, 2), (0, 1))),
        ("checkers", ((0, 1), (1, 0))),
        ("X-Trans", X_TRANS),
        ("grey", ((0,),)),
        ("8x8", random.permutation(np.arange(64) % 4).reshape(8, 8)),
    ):
        cfa = np.array(cfa, np.int32)
        for rows, cols in (cfa.shape, (9, 11), (45, 131)):
            level = np.where(
                np.add.outer(np.arange(rows), 2 * np.arange(cols)) % 70 < 40, 200.0, 1500.0
            )
            raw = (
                64 + np.round(random.poisson(level) + 3 * random.standard_normal((rows, cols)))
            ).clip(0, 4095)
            raw = raw.astype(np.uint16)
            raw.flat[0], raw.flat[-1] = 0, 4095
            for noise in ((1.0, 3.0), (0.0, 20.0), (1.0, 0.0)) if rows == 45 else ((1.0, 3.0),):
                yield Case(
                    f"{name} {rows}x{cols}, noise {noise}",
                    {
                        "raw": raw,
                        "cfa": cfa,
                        "black_level": 64.0,
                        "scale": 1 / 4031,
                        "noise": noise,
                    },
                    1.0,
                    why,
                    metric="exact",
                )
    raw = random.integers(0, 65536, (40, 70), np.uint16)
    options = {
        "raw": raw,
        "cfa": np.array(BAYER, np.int32),
        "black_level": 4096.0,
        "scale": 1 / 61439,
    }
    for name, more in (
        ("noise-free", {"noise": (0.0, 0.0)}),
        ("strength 0", {"noise": (1.0, 2.0), "strength": 0.0}),
    ):
        yield Case(
            name,
            {**options, **more},
            0.0,
            "nothing changes: see processor.shade with gains of 1",
            metric="exact",
        )


def bench(rows, cols):
    """A 10-bit Bayer mosaic of 100 e- and 5 e- of read noise at 0.2 DN/e-."""
    random = np.random.default_rng(11)
    raw = 64 + 0.2 * random.poisson(100, (rows, cols)) + random.standard_normal((rows, cols))
    return {
        "raw": raw.astype(np.uint16),
        "cfa": np.array(BAYER, np.int32),
        "black_level": 64.0,
        "scale": 1 / 959,
        "noise": (0.2, 1.0),
    }
