"""Colours outside of the display's gamut, moved to a neutral until they are inside, hue kept.

Ports: rgb (3, rows, cols) float32, linear, lms_from_rgb (3, 3) -> (3, rows, cols) float32, linear,
0 .. 1 where finite.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, exact_case, stage

# Ottosson 2020, "A perceptual color space for image processing": LMS of CIE XYZ, D65, and lightness of cube roots
LMS_FROM_XYZ = np.array(
    [
        [0.8189330101, 0.3618667424, -0.1288597137],
        [0.0329845436, 0.9293118715, 0.0361456387],
        [0.0482003018, 0.2643662691, 0.6338517070],
    ]
)
LIGHTNESS = np.array([0.2104542553, 0.7936177850, -0.0040720468])
BRIGHT = 0.85  # lightness up to which it is kept
STEPS = 16  # of bisection: chroma to 2^-16 of its own


@stage
def gamut(device: Device, rgb: Array, lms_from_rgb: Array) -> Array:
    """Return colours in the display's gamut, 0 .. 1, with the hue and lightness of OKLab.

    With c = cbrt(lms_from_rgb rgb) and the lightness L = sum_k LIGHTNESS_k c_k, limited to 0 ..
    BRIGHT, a colour outside becomes the colour of cube roots L + s (c - L) with the largest s found
    in 0 .. 1 whose channels are in 0 .. 1. That keeps the ratio of OKLab's a and b, and the
    lightness of colours up to BRIGHT: brighter ones become a little darker, or they would have no
    colour left; neutrals beyond white become white. Colours inside stay bit for bit, and NaN stays
    in its pixel.

    Args:
        rgb: Linear display RGB, white = 1, shape (3, rows, cols).
        lms_from_rgb: Matrix to OKLab's LMS, rows of sum 1, shape (3, 3), see `lms_matrix`.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear display RGB, shape (3, rows, cols), float32.

    Raises:
        BadData: An array has the wrong shape, or the matrix no inverse.

    Source:
        Ottosson 2020, "A perceptual color space for image processing", and 2021, "sRGB gamut
        clipping".
    """
    matrix = np.asarray(lms_from_rgb, np.float64)
    if len(rgb.shape) != 3 or rgb.shape[0] != 3 or matrix.shape != (3, 3):
        raise BadData(
            f"gamut: rgb {tuple(rgb.shape)}, lms_from_rgb {matrix.shape}; wanted (3, rows, cols) and (3, 3)"
        )
    try:
        back = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise BadData("gamut: lms_from_rgb has no inverse; wanted one of three primaries") from None
    _, rows, cols = rgb.shape
    out = device.empty((3, rows, cols))
    run = 1 if device.is_gpu else 256  # a CPU leaves whole runs inside the gamut as they are
    arrays = device.array(rgb), device.array(matrix), device.array(back), device.array(LIGHTNESS)
    grid, group = (-(-rows * cols // run),), None if device.is_gpu else (1,)
    device.launch(
        "processor.gamut", "gamut", grid, *arrays, out, BRIGHT, STEPS, run, rows * cols, group=group
    )
    return out


def lms_matrix(xyz_from_rgb: np.ndarray) -> np.ndarray:
    """Return the matrix from linear display RGB to OKLab's LMS, with 1 for the display's white.

    Args:
        xyz_from_rgb: Matrix from linear RGB to CIE XYZ, shape (3, 3).

    Returns:
        The matrix, shape (3, 3). Whites other than D65 are adapted by scaling LMS.
    """
    matrix = LMS_FROM_XYZ @ xyz_from_rgb
    return matrix / matrix.sum(axis=1, keepdims=True)


def _srgb():
    """Return `lms_matrix` of sRGB, IEC 61966-2-1."""
    return lms_matrix(
        np.array(
            [
                [0.4123908, 0.3575843, 0.1804808],
                [0.2126390, 0.7151687, 0.0721923],
                [0.0193308, 0.1191948, 0.9505322],
            ]
        )
    )


def cases():
    """Yield cases: colours inside and far outside, grey beyond black and white, values that are not finite."""
    random = np.random.default_rng(9)
    why = (
        "chroma is found to 2^-16, with slopes of the channels' cubics of at most 9 in s for the matrices of sRGB "
        "and colours of up to 4: 9 x 2^-16; a step that rounds to the other side moves s by as much again"
    )
    for rows, cols, spread in ((1, 1, 0.5), (63, 65, 0.5), (3, 200, 1.0), (40, 17, 0.2)):
        rgb = random.normal(0.5, spread, (3, rows, cols)).clip(-1, 3).astype(np.float32)
        yield Case(
            f"{rows}x{cols}, deviation {spread:g}",
            {"rgb": rgb, "lms_from_rgb": _srgb()},
            2 * 9 * 2.0**-STEPS,
            why,
            metric="exact",
        )
    yield exact_case(
        "inside",
        "colours inside stay",
        rgb=random.random((3, 20, 30), np.float32),
        lms_from_rgb=_srgb(),
    )
    rgb = np.full((3, 4, 9), 0.5, np.float32)
    rgb[:, 0, 0], rgb[:, 0, 1], rgb[:, 0, 2] = 1.5, -0.5, 1.0
    rgb[0, 1, 1], rgb[1, 2, 2], rgb[2, 3, 3] = np.nan, np.inf, -np.inf
    yield Case(
        "beyond black and white, NaN and infinities",
        {"rgb": rgb, "lms_from_rgb": _srgb()},
        2 * 9 * 2.0**-STEPS,
        "as above; lightness is limited, and pixels that are not finite stay",
        metric="exact",
    )


def bench(rows, cols):
    """Return inputs: a picture of which a tenth is out of gamut."""
    random = np.random.default_rng(9)
    rgb = random.random((3, rows, cols), np.float32)
    rgb[:, :, : cols // 10] *= 1.5
    return {"rgb": rgb, "lms_from_rgb": _srgb()}


def operations(rgb, lms_from_rgb):
    """Count operations: of a colour inside the gamut only comparisons; of one in ten 30 for each step."""
    return rgb[0].size * (6 + STEPS * 3)
