"""Gradient-adaptive demosaicking of a Bayer mosaic, with black level and scale.

Ports: raw (rows, cols) uint16 [DN] -> rgb (3, rows, cols) float32, (DN - black_level) scale: linear
camera red, green and blue, 1 at the white level if scale = 1 / (white_level - black_level).
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.kernels.common.cases import FLAT, bench_mosaic, conditioned_case, random_mosaic
from gpusim.kernels.processor.bayer import RED, check_mosaic, red_pixel
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.levels import check_balance
from gpusim.kernels.stage import Array, Case, stage, warp_only

DOMAINS = ("root", "linear")


@stage
def adaptive(
    device: Device,
    raw: Array,
    *,
    phase: str,
    black_level: float,
    scale: float,
    domain: str = "root",
    threshold: float = 0.0175,
    balance: tuple[float, float] = (1.0, 1.0),
) -> Array:
    """Demosaick by Hamilton-Adams interpolation with soft weights for the directions.

    Measured samples are kept, and nothing is clipped. Borders are mirrored without repeating the
    end pixel. A frame of one row or column is interpolated bilinearly.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: "RGGB", "GRBG", "GBRG" or "BGGR".
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        domain: "root" interpolates (signed) square roots: edges and shot noise are then equally
            strong in light and shadow, which suits linear data. "linear" interpolates the values,
            which suits data that are already encoded.
        threshold: Gradients below this fraction of the full scale (1 / scale, in the domain) count
            as equally small [1].
        balance: Factors of (red, blue) while colours are compared [1], with which white is as
            strong in them as in green. The result is divided by them.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear camera RGB [1], shape (3, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16.
        OutOfRange: `scale`, `threshold` or `balance` is not allowed.
        UnknownName: There is no such phase or domain.

    Source:
        Hamilton and Adams 1997, US patent 5629734 (expired), with weights instead of its decisions.
    """
    check_mosaic(raw, scale)
    red_row, red_col = red_pixel(phase)
    if domain not in DOMAINS:
        raise UnknownName("domain", domain, DOMAINS)
    if not threshold > 0:
        raise OutOfRange("threshold", threshold, "threshold > 0")
    factors = check_balance(balance)
    raw = device.array(raw, np.uint16)
    if 1 in raw.shape:
        return bilinear(raw, phase=phase, black_level=black_level, scale=scale, device=device)
    rows, cols = raw.shape
    root = domain == "root"
    limit = threshold * (1 / scale) ** (0.5 if root else 1.0)
    pairs = cols // 2 + 1  # enough for either column phase
    run = 1 if device.is_gpu else pairs  # a GPU wants many small items, LLVM a loop to vectorise
    difference = device.empty((rows, pairs))
    out = device.empty((3, rows, cols))
    grid = (rows, -(-pairs // run))
    red, blue = map(float, np.sqrt(factors) if root else factors)
    mosaic = (
        *(float(black_level), float(limit), red, blue),
        *(red_row, red_col, run, rows, cols, *warp_only(device, int(root))),
    )
    launch = functools.partial(
        device.launch,
        "processor.adaptive",
        defines={"ROOT": int(root)},
        group=None if device.is_gpu else (1, 1),
    )
    launch("green", grid, raw, difference, *mosaic)
    launch("colors", grid, raw, difference, out, float(scale), *mosaic)
    return out


WORST_CONDITION = 20  # of the cases, error out over error in: their tolerances stay below 4e-5


def cases():
    """Yield cases: all phases, both domains, odd and degenerate sizes, hard edges, flat fields."""
    random = np.random.default_rng(3)
    for domain in DOMAINS:
        for phase in RED:
            for rows, cols in ((1, 1), (1, 4), (5, 1), (2, 2), (3, 5), (63, 65), (16, 130)):
                raw = random_mosaic(random, 4095, (rows, cols))
                yield _case(f"{domain} {phase} {rows}x{cols}", raw, phase, domain)
        ramp = np.add.outer(40 * np.arange(48), 11 * np.arange(50)).astype(np.uint16)
        yield _case(f"{domain} ramp", ramp, "GRBG", domain)
        balances = ((2.1, 1.4), (0.7, 3.0), (1.0, 0.6), (2.5, 2.5))
        for phase, balance in zip(RED, balances, strict=True):
            raw = np.random.default_rng(6).integers(0, 4096, (21, 30), np.uint16)
            yield _case(f"{domain} {phase} balanced {balance}", raw, phase, domain, balance=balance)
        edge = np.where(ramp > 1100, np.uint16(65535), np.uint16(0))
        yield _case(f"{domain} black and saturated", edge, "BGGR", domain)
        yield Case(
            f"{domain} flat",
            {**FLAT, "domain": domain},
            4 * 2.0**-24,
            "all samples and so all weights are equal and small powers of two: only the quotients round",
        )


def _case(name, raw, phase, domain, black_level=64.0, scale=1 / 2048, **more):
    """Return a case; its tolerance is 16 roundings times the reference's condition number."""
    from gpusim.kernels.processor.adaptive_ref import CODES
    from gpusim.kernels.processor.adaptive_ref import adaptive as reference

    inputs = {
        "raw": raw,
        "phase": phase,
        "black_level": black_level,
        "scale": scale,
        "domain": domain,
        **more,
    }
    return conditioned_case(
        name,
        inputs,
        reference,
        CODES[domain],
        roundings=16,
        trials=4,
        worst_condition=WORST_CONDITION,
        why="the longest chain (root, bend, square, weight, quotient, difference, two blends) has about 16 "
        "roundings; each acts like a change of the encoded samples by 2^-24 of the largest, whose effect the "
        "reference shows; 2 because four random changes need not hit the worst one",
    )


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic."""
    return {**bench_mosaic(3, rows, cols), "phase": "RGGB"}
