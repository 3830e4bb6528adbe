"""Inputs that the cases of several stages have in common."""

from collections.abc import Callable

import numpy as np

from gpusim.kernels.stage import Case, exact_case


def mosaic(*rows: str) -> np.ndarray:
    """Return the channels of a mosaic whose rows are given in letters, R, G and B for 0, 1 and 2."""
    return np.array([["RGB".index(letter) for letter in row] for row in rows], np.int32)


RGGB = mosaic("RG", "GB")
MOSAICS = {
    "Bayer": RGGB,
    "GRBG": mosaic("GR", "BG"),
    "GBRG": mosaic("GB", "RG"),
    "BGGR": mosaic("BG", "GR"),
    "quad-Bayer": mosaic("RRGG", "RRGG", "GGBB", "GGBB"),
    "X-Trans": mosaic("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
    "stripes": mosaic("RGB"),
    "grey": mosaic("R"),
}
FLAT = {
    "raw": np.full((9, 9), 4096 + 64, np.uint16),
    "phase": "RGGB",
    "black_level": 64.0,
    "scale": 1 / 4096,
}
SATURATED = exact_case(
    "saturated",
    "a flat field stays flat, and 16-bit integers are exact",
    raw=np.full((6, 6), 65535, np.uint16),
    phase="RGGB",
    black_level=0.0,
    scale=1.0,
)


def random_mosaic(random: np.random.Generator, most: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return random uint16 values: 0 in the first pixel, `most` in the last, others between."""
    raw = random.integers(0, most + 1, shape, np.uint16)
    raw.flat[0], raw.flat[-1] = 0, most
    return raw


def bench_mosaic(seed: int, rows: int, cols: int) -> dict:
    """Return a 10-bit mosaic with its black level and scale, the inputs of a benchmark."""
    raw = np.random.default_rng(seed).integers(0, 1024, (rows, cols), np.uint16)
    return {"raw": raw, "black_level": 64.0, "scale": 1 / 959}


def moving_picture(
    random: np.random.Generator, shifts: np.ndarray, rows: int, cols: int, smooth: int
) -> np.ndarray:
    """Return frames of a random picture with noise, uint16 (frames, rows, cols).

    Args:
        random: Random numbers.
        shifts: Whole shifts of the frames [pixel], shape (frames, 2).
        rows: Rows of a frame.
        cols: Columns of a frame.
        smooth: Number of times that neighbours are averaged.
    """
    margin = 2 * int(np.abs(shifts).max()) + 2
    picture = random.random((rows + 2 * margin, cols + 2 * margin))
    for _ in range(smooth):
        picture = (picture + np.roll(picture, 1, 0)) / 2
        picture = (picture + np.roll(picture, 1, 1)) / 2
    picture = 200 + 3000 * (picture - picture.min()) / np.ptp(picture)
    seen = [
        picture[margin + dy : margin + dy + rows, margin + dx : margin + dx + cols]
        for dy, dx in shifts
    ]
    return np.rint(seen + random.normal(0, 20, (len(shifts), rows, cols))).astype(np.uint16)


def gaussian_tables(widths: np.ndarray, period: tuple[int, int]) -> np.ndarray:
    """Return quarter tables of the transfer functions of Gaussian kernels, float64.

    Args:
        widths: Standard deviations [pixel], shape (..., 1, 1).
        period: Lengths of the transform [pixel].

    Returns:
        Tables [1], shape (..., period[0] // 2 + 1, period[1] // 2 + 1).
    """
    fy = np.arange(period[0] // 2 + 1)[:, None] / period[0]
    fx = np.arange(period[1] // 2 + 1) / period[1]
    return np.exp(-2 * (np.pi * widths) ** 2 * (fy**2 + fx**2))


def displaced_tables(widths: np.ndarray, shifts: np.ndarray, period: tuple[int, int]) -> np.ndarray:
    """Return half tables of the transfer functions of Gaussian kernels off their centres, float64.

    Args:
        widths: Standard deviations [pixel], shape (..., 1, 1).
        shifts: Displacements along rows and columns [pixel], shape (2, ..., 1, 1).
        period: Lengths of the transform [pixel].

    Returns:
        Tables [1], real and imaginary parts side by side, shape (..., period[0], 2 (period[1] // 2 + 1)).
    """
    fy = np.fft.fftfreq(period[0])[:, None]
    fx = np.arange(period[1] // 2 + 1) / period[1]
    turns = np.exp(-2j * np.pi * (shifts[0] * fy + shifts[1] * fx))
    tables = np.exp(-2 * (np.pi * widths) ** 2 * (fy**2 + fx**2)) * turns
    # of a real kernel, a column that is its own opposite has conjugates at opposite rows
    opposite = -np.arange(period[0]) % period[0]
    for j in {0, period[1] // 2} if period[1] % 2 == 0 else {0}:
        tables[..., j] = (tables[..., j] + tables[..., opposite, j].conj()) / 2
    return tables.view(np.float64)


def conditioned_case(
    name: str,
    inputs: dict,
    reference: Callable,
    codes: tuple[Callable, Callable],
    roundings: int,
    trials: int,
    worst_condition: float,
    why: str,
) -> Case:
    """Return a case whose tolerance follows the reference's condition number.

    Args:
        name: Content of the case.
        inputs: Arguments of the stage, with `raw` and `black_level`.
        reference: The stage's reference.
        codes: Functions that encode values above black, and decode them.
        roundings: Roundings of the longest chain.
        trials: Number of random changes of the encoded values.
        worst_condition: Largest condition number of a case that still tests something.
        why: How the tolerance is derived.

    Raises:
        ValueError: The condition number is larger than that.
    """
    encode, decode = codes
    black_level = inputs["black_level"]
    code = encode(inputs["raw"] - black_level)
    exact = reference(**inputs)
    random = np.random.default_rng(4)
    step, worst = 1e-7, 0.0
    for _ in range(trials):
        nudge = step * np.abs(code).max() * random.choice([-1.0, 1.0], code.shape)
        changed = reference(**inputs | {"raw": black_level + decode(code + nudge)})
        worst = max(worst, np.abs(changed - exact).max())
    condition = max(worst / step / np.abs(exact).max(), 1.0)
    if condition > worst_condition:
        raise ValueError(f"case {name}: condition {condition:.3g}; so sharp a case tests nothing")
    return Case(name, inputs, 2 * roundings * 2.0**-24 * condition, why)
