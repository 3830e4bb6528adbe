"""The best Bayer interpolation in this library: it uses the noise and the lens's blur.

Ports: raw (rows, cols) uint16 [DN] -> rgb (3, rows, cols) float32, (DN - black_level) scale: linear
camera red, green and blue, 1 at the white level if scale = 1 / (white_level - black_level).
"""

import functools
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.kernels.common.cases import FLAT, bench_mosaic, conditioned_case
from gpusim.kernels.processor.adaptive import DOMAINS
from gpusim.kernels.processor.bayer import RED, check_mosaic, red_pixel
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.levels import check_balance, root_loss
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage

MARGIN = 14  # mirrored pixels around the picture, see best.cl
STRIPS = 4  # per core of a CPU: even loads
LOWEST = 64  # rows of a strip: the 28 around it are computed twice
PLANES = 9  # of a strip's scratch
# A GPU's tile: rows (HIGH, HIGH + 8: multiples of 2 RUN; HIGH + 2: of 2 RUN_DIAGONALS), pairs of
# columns, work-items of its group, rows per work-item.
TILE = {"HIGH": 16, "PAIRS": 64, "GROUP": 256, "RUN": 4, "RUN_DIAGONALS": 3}
ROOM = 128  # of planes around the picture, for whole tiles
MOST_READ = 20.0  # [e-] of read noise that the root makes even; more counts as shot noise


@stage
def best(
    device: Device,
    raw: Array,
    *,
    phase: str,
    black_level: float,
    scale: float,
    domain: str = "root",
    noise: tuple[float, float] = (0.0, 0.0),
    blur: float = 0.0,
    balance: tuple[float, float] = (1.0, 1.0),
) -> Array:
    """Demosaick by directional interpolation with regressed gains.

    The taps follow the colours, the blur and the noise. Nothing is clipped. Borders are mirrored
    without repeating the end pixel. A frame of one row or column is interpolated bilinearly.
    Without noise, measured samples are kept. With noise every value, measured or not, is drawn
    towards the mean of its neighbours if it differs from it by no more than noise does.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: "RGGB", "GRBG", "GBRG" or "BGGR".
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        domain: "root" works on (signed) square roots, in which shot noise is the same everywhere,
            which suits linear data. "linear" works on the values, which suits data that are already
            encoded.
        noise: (gain [DN/e-], read [DN]): the variance of a digital number is gain (DN -
            black_level) + read^2 [DN^2]; (0, 0) for no noise. In the domain "root", with a read
            noise above MOST_READ electrons or without shot noise, the gain is read / MOST_READ.
        blur: Standard deviation of the lens's blur as a Gaussian [pixel]; more blur makes the taps
            shorter.
        balance: Factors of (red, blue) while colours are compared, noise included [1], with which
            white is as strong in them as in green. The result is divided by them.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear camera RGB [1], shape (3, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16.
        OutOfRange: `scale`, `noise`, `blur` or `balance` is not allowed.
        UnknownName: There is no such phase or domain.

    Source:
        Differences green - other, weighted by their gradients: Pekkucuksen and Altunbasak 2010,
        "Gradient based threshold free color filter array interpolation", ICIP. Gains regressed on
        Laplacians: Kiku et al. 2014, "Minimized-Laplacian residual interpolation", SPIE 9023.
        Weights of red and blue: Hamilton and Adams 1997, US patent 5629734 (expired). Roots with an
        offset: Anscombe 1948, Biometrika 35. Powers without skew: Anscombe 1953, J. Royal
        Statistical Society B 15, 229. New here: taps by colour, shrinkage.
    """
    check_mosaic(raw, scale)
    red_row, red_col = red_pixel(phase)
    if domain not in DOMAINS:
        raise UnknownName("domain", domain, DOMAINS)
    gain, read = noise
    if not (0 <= gain < np.inf and 0 <= read < np.inf):
        raise OutOfRange("noise", noise, "gain >= 0 DN/e- and read >= 0 DN, finite")
    if not 0 <= blur < np.inf:
        raise OutOfRange("blur", blur, "0 <= blur < inf pixels")
    balance = check_balance(balance)
    raw = device.array(raw, np.uint16)
    if 1 in raw.shape:
        return bilinear(raw, phase=phase, black_level=black_level, scale=scale, device=device)
    rows, cols = raw.shape
    root, noisy = int(domain == "root"), int(gain > 0 or read > 0)
    offset, variance, shot = code_noise(root, gain * scale, read * scale)
    red, blue = np.sqrt(balance) if root else balance
    noise = (gain * scale, read * scale)
    loss = root_loss(root_gain(*noise), noise[1]) if root and noisy else np.zeros(7, np.float32)
    longest, shortest = map(float, tap_shares(blur))
    mosaic: dict[str, Any] = {
        "loss": device.array(loss),
        "black_level": float(black_level),
        "scale": float(scale),
        "offset": float(offset),
        "variance": float(variance),
        "shot": float(shot),
        "red": float(red),
        "blue": float(blue),
        "longest": longest,
        "shortest": shortest,
        "prior": float(gain_prior(blur)),
        "red_row": red_row,
        "red_col": red_col,
    }
    columns = (cols + 1) // 2
    out = device.empty((3, rows, cols))
    defines = {"ROOT": root, "NOISY": noisy}
    if is_opencl_cpu(device):  # one pass, WIDTH pixels at a time
        # and room for a vector that starts at the last pixel
        half = -(-(columns + MARGIN + 7) // 8) * 8
        units = device.cl_device.max_compute_units  # type: ignore[attr-defined]  # of an OpenCL device
        height = max(-(-rows // (STRIPS * units)), LOWEST)
        ring = 32 if noisy else 16
        strips = -(-rows // height)
        scratch = device.empty((strips, PLANES, ring, 2 * half))
        arrays = (raw, scratch, out, height, ring * 2 * half)
        steps: list[tuple] = [("strip", (strips,), (1,), arrays)]
        defines["WIDTH"] = 8
    elif device.kind == "opencl":  # three passes over tiles
        half = -(-(columns + ROOM) // 32) * 32
        code, across, down, green = (device.empty((rows + ROOM, 2 * half)) for _ in range(4))
        runs = -(-(rows + 12) // (2 * TILE["RUN"])) * 2
        steps = [
            ("differences", *_tiles(rows + 20, columns + 13), (raw, code, across, down)),
            ("greens", (runs, columns + 11), (2, 32), (code, across, down, green)),
            ("colors", *_tiles(rows, columns), (raw, code, green, out)),
        ]
        defines |= {"WIDTH": 1, **TILE}
    else:
        sizes = {"rows": rows, "cols": cols, "root": root, "noisy": noisy}
        _by_pixels(device, raw, out, mosaic | sizes)
        return out
    launch = functools.partial(device.launch, "processor.best", defines=defines)
    for kernel, grid, group, arrays in steps:
        launch(kernel, grid, *arrays, *mosaic.values(), half, rows, cols, group=group)
    return out


# Warp's kernels: pixels of the margin that they leave out, columns of an item, planes
PASSES = (
    ("encode_all", 0, 1, ("raw", "code")),
    ("differences", 4, 1, ("code", "across", "down")),
    ("greens", 8, 2, ("code", "across", "down", "green")),
    ("slopes", 10, 2, ("code", "green", "square", "product")),
    ("diagonals", 12, 2, ("code", "green", "square", "product", "other")),
    ("colors", 14, 2, ("raw", "code", "green", "square", "product", "other", "out")),
)
NUMBERS = {  # of each kernel, in its order
    "encode_all": (
        "black_level",
        "scale",
        "offset",
        "red",
        "blue",
        "red_row",
        "red_col",
        "rows",
        "cols",
        "root",
    ),
    "differences": ("variance", "shot", "red", "blue", "prior", "red_row", "red_col"),
    "greens": (
        "loss",
        "offset",
        "variance",
        "shot",
        "longest",
        "shortest",
        "red_row",
        "red_col",
        "root",
        "noisy",
    ),
    "slopes": ("red_row", "red_col"),
    "diagonals": ("variance", "shot", "red", "blue", "prior", "red_row", "red_col"),
    "colors": (
        "loss",
        "black_level",
        "scale",
        "offset",
        "variance",
        "shot",
        "red",
        "blue",
        "prior",
        "red_row",
        "red_col",
        "cols",
        "root",
        "noisy",
    ),
}


def _by_pixels(device, raw, out, numbers):
    """Write the picture by six passes over whole planes, a pixel or two a thread."""
    rows, width = raw.shape[0] + 2 * MARGIN, 2 * ((raw.shape[1] + 1) // 2 + MARGIN)
    planes = {"raw": raw, "out": out} | {
        name: device.empty((rows * width,))
        for name in ("code", "across", "down", "green", "square", "product", "other")
    }
    for kernel, low, sites, names in PASSES:
        device.launch(
            "processor.best",
            kernel,
            (rows - 2 * low, (width - 2 * low) // sites),
            *(planes[name] for name in names),
            low,
            width,
            *(numbers[name] for name in NUMBERS[kernel]),
        )


def _tiles(rows, pairs):
    """Return grid and group of work-items over whole tiles."""
    group = (1, TILE["GROUP"])
    return (-(-rows // TILE["HIGH"]), -(-pairs // TILE["PAIRS"]) * TILE["GROUP"]), group


def code_noise(root, gain, read):
    """Return the offset under the root, and the variance as (constant, slope) of the code.

    gain, read: noise of variance gain x + read^2.
    """
    if not root:
        return 0.0, read**2, gain
    if gain == read == 0:
        return 0.0, 0.0, 0.0
    gain = root_gain(gain, read)
    return 0.375 * gain + read**2 / gain, gain / 4, 0.0


def root_gain(gain, read):
    """Return the gain of shot noise for which the root is made, in the unit of the arguments.

    The root's offset is read^2 / gain. Read noise with little or no shot noise would move it beyond
    the full scale, and the root would become a straight line. It is limited to MOST_READ times the
    read noise, which vanishes with it.
    """
    return max(gain, read / MOST_READ)


def tap_shares(blur):
    """Return the long taps' shares for similar and different colours; blur leaves no detail."""
    return 0.945 - 1.7 * min(blur, 0.9) ** 2, -0.7 + 0.5 * min(blur, 0.9) ** 2


def gain_prior(blur):
    """Return the mean square second difference below which gains stay 1; blur reduces it."""
    return 20 / 255**2 / (1 + (2.5 * blur) ** 4)


# of the cases, error out over error in; high if pairs of neighbours agree by chance
WORST_CONDITION = 150


def cases():
    """Yield cases.

    All phases, both domains, with and without noise, odd and degenerate sizes, hard edges, flat
    fields.
    """
    random = np.random.default_rng(5)
    noise = (0.5, 3.0)
    for domain in DOMAINS:
        for phase in RED:
            for rows, cols in ((1, 4), (2, 2), (3, 5), (33, 70)):
                ramp = np.add.outer(17 * np.arange(rows), 9 * np.arange(cols)) % 1900
                raw = (ramp + random.integers(300, 600, (rows, cols))).astype(np.uint16)
                raw.flat[0], raw.flat[-1] = 50, 2500
                yield _case(f"{domain} {phase} {rows}x{cols}", raw, phase, domain)
            yield _case(f"{domain} {phase} noise", raw, phase, domain, noise=noise)
        ramp = np.add.outer(40 * np.arange(48), 11 * np.arange(50)).astype(np.uint16)
        yield _case(f"{domain} ramp", ramp, "GRBG", domain, blur=0.7)
        raw = random.poisson(ramp).astype(np.uint16)
        yield _case(f"{domain} noisy ramp", raw, "GBRG", domain, noise=noise)
        raw = random.poisson(ramp).astype(np.uint16)
        yield _case(f"{domain} only read noise", raw, "BGGR", domain, noise=(0.0, 3.0))
        raw = np.random.default_rng(7).poisson(ramp).astype(np.uint16)
        balance = (1.7, 2.9)
        name = f"{domain} balanced {balance}"
        yield _case(name, raw, "GRBG", domain, noise=(0.0, 0.0), balance=balance)
        balance = (0.6, 1.0)
        name = f"{domain} balanced {balance}"
        yield _case(name, raw, "BGGR", domain, noise=noise, balance=balance)
        edge = np.where(ramp > 1100, np.uint16(65535), np.uint16(0))
        yield _case(f"{domain} black and saturated", edge, "BGGR", domain)
        yield Case(
            f"{domain} flat",
            {**FLAT, "domain": domain},
            8 * 2.0**-24,
            "all differences are 0 and the gains 1: what rounds are the means of equal numbers",
        )


def _case(name, raw, phase, domain, black_level=64.0, scale=1 / 2048, **knowledge):
    """Return a case; its tolerance is 48 roundings times the reference's condition number."""
    from gpusim.kernels.processor.adaptive_ref import CODES
    from gpusim.kernels.processor.best_ref import best as reference

    inputs = {
        "raw": raw,
        "phase": phase,
        "black_level": black_level,
        "scale": scale,
        "domain": domain,
        **knowledge,
    }
    return conditioned_case(
        name,
        inputs,
        reference,
        CODES[domain],
        roundings=48,
        trials=3,
        worst_condition=WORST_CONDITION,
        why="the longest chain (code 3, bends and gain 10, difference 3, weights 9, taps and their blend 8, slopes "
        "and gain 10, two blends, decoding) has about 48 roundings; each acts like a change of the encoded "
        "samples by 2^-24 of the largest, whose effect the reference shows; 2 because three random changes "
        "need not hit the worst one",
    )


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic."""
    return {**bench_mosaic(5, rows, cols), "phase": "RGGB"}
