"""Light of encoded frames: planes of numbers by a table, from pixels with interleaved channels.

Ports: codes (rows, cols, channels) or (rows, cols), uint8 or uint16; curve (256,) or (65536,)
float32, the value of each code -> (channels, rows, cols) float32.

A frame goes to the device as the bytes that a camera or a decoder returned. The curve belongs to
the display, for example sRGB. Devices need no power function and agree bit for bit.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.domain.memory import type_of
from gpusim.kernels.stage import Array, exact_case, stage, warp_only

CODES = {np.dtype(np.uint8): 2**8, np.dtype(np.uint16): 2**16}  # number of codes


@stage
def decode(device: Device, codes: Array, curve: Array) -> Array:
    """Return linear planes of encoded pixels: curve[codes], channel by channel.

    Args:
        codes: Codes, uint8 or uint16, shape (rows, cols, channels), or (rows, cols) for one
            channel.
        curve: Value of each code, shape (256,) for uint8, (65536,) for uint16. NaN and infinities
            stay.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Planes in the curve's unit, shape (channels, rows, cols), float32.

    Raises:
        BadData: A type or a shape does not fit.
    """
    kind, (rows, cols, channels) = check_inputs(codes, curve)
    out, curve = device.empty((channels, rows, cols)), device.array(curve)
    codes = device.array(codes, kind)
    if not rows * cols:
        return out
    if len(codes.shape) == 2:
        codes = device.reshape(codes, (rows, cols, 1))
    # An inner loop that is not unrolled stops PoCL from vectorising.
    device.launch(
        "spectral.decode",
        "decode_bytes" if kind == np.uint8 else "decode_words",
        (rows, cols),
        *(codes, curve, out),
        *(rows, cols, *warp_only(device, channels)),
        defines={"CHANNELS": channels},
    )
    return out


def check_inputs(codes, curve):
    """Return the type of the codes, and (rows, cols, channels). Raise BadData as `decode` does."""
    kind, shape = type_of(codes), tuple(codes.shape)
    if kind is None or kind.type not in (np.uint8, np.uint16):
        raise BadData(f"decode: codes of type {kind or codes.dtype}; wanted uint8 or uint16")
    kind = np.dtype(kind.type)  # in the host's order of bytes
    if len(shape) not in (2, 3):
        raise BadData(
            f"decode: codes of shape {shape}; wanted (rows, cols, channels) or (rows, cols)"
        )
    if tuple(curve.shape) != (CODES[kind],):
        raise BadData(
            f"decode: a curve of shape {tuple(curve.shape)}; wanted ({CODES[kind]},) for {kind}"
        )
    return kind, (*shape, 1)[:3]


def cases():
    """Yield cases.

    Every code of both types, odd sizes, one to five channels, no pixels, curves with NaN and
    infinities.
    """
    random, why = np.random.default_rng(8), "an entry of the table, nothing is computed"
    for kind, count in CODES.items():
        srgb, every = DISPLAYS["srgb"].table(kind), np.arange(count, dtype=kind)
        yield exact_case(f"every {kind}, grey", why, codes=every.reshape(16, -1), curve=srgb)
        mixed = np.stack([every, every[::-1], random.permutation(every)], axis=-1)
        mixed = mixed.reshape(-1, 32, 3)
        yield exact_case(f"every {kind} in three channels", why, codes=mixed, curve=srgb)
        shapes = (
            *((1, 1, 3), (1, 1), (3, 5, 3), (1, 17, 3), (17, 1, 3), (33, 65, 3), (7, 129, 4)),
            *((9, 31, 1), (5, 6, 5), (0, 4, 3), (4, 0, 3)),
        )
        for shape in shapes:
            curve = random.normal(0, 1, count) * 10.0 ** random.integers(-30, 30, count)
            curve = curve.astype(np.float32)
            extremes = np.nan, np.inf, -np.inf, -0.0, 3e38, 1.2e-38, 1, -1
            curve[random.integers(0, count, 8)] = extremes
            codes = random.integers(0, count, shape).astype(kind)
            yield exact_case(f"{kind} {shape}, any curve", why, codes=codes, curve=curve)


def bench(rows, cols):
    """Return inputs: a frame of 8 bits, sRGB."""
    codes = np.random.default_rng(8).integers(0, 256, (rows, cols, 3), np.uint8)
    return {"codes": codes, "curve": DISPLAYS["srgb"].table(np.uint8)}
