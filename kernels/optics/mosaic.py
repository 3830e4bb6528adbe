"""Blur of weighted planes straight to the mosaic: each pixel gets only its own channel.

Ports: planes (planes, rows, cols) float32, tables (groups, planes, ...) float32 [1], quarters or
halves as for `optics.blur`, mix (channels, planes) float32, cfa (ph, pw) -> mosaic (rows, cols)
float32:

    e(y, x) = sum over k of  mix[c, k] (planes_k * kernel_ck)(y, x),   c = cfa[y mod ph, x mod pw].

The result equals `optics.blur` followed by a choice of one channel per pixel, at less cost. The
pixels of one phase (dy, dx) of the mosaic are every ph-th row and every pw-th column of their
channel. Sampling folds its spectrum F, so they are the inverse transform, 1/(ph pw) of the size, of

    G(k) = 1/(ph pw) sum over aliases f = k + (a M_y, b M_x) of  F(f) exp(2 pi i (f_y dy / P_y + f_x dx / P_x)),

M = P / (ph, pw). All phases together cost one inverse transform of the frame instead of one per
channel.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common import fft
from gpusim.kernels.common.border import BORDERS
from gpusim.kernels.common.cases import RGGB, displaced_tables, gaussian_tables
from gpusim.kernels.stage import Array, Case, stage, warp_only
from gpusim.optics.lengths import transform_lengths

LINES = "optics.mosaic_lines"  # the kernels of GPUs
BATCH = 8  # planes transformed at once: the folded sums are read and written once per batch


@stage
def mosaic(
    device: Device,
    planes: Array,
    tables: Array,
    mix: Array,
    cfa: Array,
    border: str,
    period: tuple[int, int],
    margin: int = 0,
) -> Array:
    """Convolve each plane with its kernels, sum per channel, and keep each pixel's own channel.

    Args:
        planes: Light of each plane, shape (planes, rows, cols).
        tables: Transfer functions [1], shape (1 or channels, planes, period[0] // 2 + 1, period[1]
            // 2 + 1), or (1 or channels, planes, period[0], 2 (period[1] // 2 + 1)), as for
            `optics.blur`.
        mix: Weight of each plane in each channel, shape (channels, planes).
        cfa: Channel of each pixel in one period of the mosaic, shape (ph, pw).
        border: "zero", "edge" or "reflect".
        period: Transform lengths [pixel], at least (rows, cols) and multiples of (ph, pw).
        margin: Pixels on each side of the planes that are surroundings and not in the result.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The mosaic, shape (rows - 2 margin, cols - 2 margin), float32.

    Source:
        The folding of a sampled signal's spectrum (Shannon).
    """
    _, rows, cols = planes.shape
    planes, tables = device.array(planes), device.array(tables)
    mix = np.asarray(device.numpy(mix), np.float32)  # cut into batches on the host
    cfa = np.asarray(device.numpy(cfa), np.int32)
    start = tuple(
        (length - size) // 2 + margin for length, size in zip(period, (rows, cols), strict=True)
    )
    cfa = np.roll(cfa, start, axis=(0, 1))  # the mosaic counted from the corner of the period
    out = device.empty((rows - 2 * margin, cols - 2 * margin))
    lines = None if device.on_host else _lines(device.local_bytes, period, cfa.shape)
    if lines:
        _by_lines(device, planes, tables, mix, cfa, border, period, start, lines, out)
    else:
        _by_planes(device, planes, tables, mix, cfa, border, period, start, out)
    return out


def _by_planes(device, planes, tables, mix, cfa, border, period, start, out):
    """Transform whole planes, with the fold between the transforms."""
    count, channels, own_tables = len(mix[0]), len(mix), int(tables.shape[0] > 1)
    is_complex = _is_complex(tables, period)
    small = tuple(length // n for length, n in zip(period, cfa.shape, strict=True))
    half, pitch = small[1] // 2 + 1, fft.pitch_of(device, small[1])
    turns = [device.array(_turns(length, n)) for length, n in zip(period, cfa.shape, strict=True)]
    channel_of = [] if device.kind == "opencl" else [device.array(cfa, np.int32)]
    channel_list = ",".join(map(str, cfa.ravel()))
    phases = {"PERIOD_Y": cfa.shape[0], "PERIOD_X": cfa.shape[1]}
    launch = functools.partial(device.launch, "optics.mosaic")
    folded = device.empty((cfa.size, small[0], pitch, 2))
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        spectra = fft.forward_extended(device, planes, first, size, border, period)
        some = device.array(mix[:, first : first + size])
        arrays = [spectra, tables, some, *turns, *channel_of, folded]
        numbers = [int(first == 0), first, count, own_tables]
        numbers += warp_only(device, is_complex)
        sizes = [*small, half, spectra.shape[2], pitch]
        launch(
            "fold",
            (small[0], half),
            *arrays,
            *numbers,
            *warp_only(device, size, channels, *cfa.shape),
            *sizes,
            defines=phases
            | {"SIZE": size, "CHANNELS": channels, "CFA": channel_list, "COMPLEX": is_complex},
        )
    pixels = fft.inverse(device, folded, small[1])
    sizes = [*start, *out.shape, *warp_only(device, *cfa.shape), *small]
    defines = phases | {"SIZE": 1, "CHANNELS": 1, "CFA": "0", "COMPLEX": 0}
    launch("interleave", out.shape, pixels, out, *sizes, defines=defines)


def _by_lines(device, planes, tables, mix, cfa, border, period, start, lines, out):
    """Transform columns, then rows forward, fold, rows back, columns: the form of GPUs."""
    count, rows, cols = planes.shape
    columns_forward, rows_forward, rows_inverse, columns_inverse = lines
    phases_y, phases_x = cfa.shape
    small = tuple(length // n for length, n in zip(period, cfa.shape, strict=True))
    stored = period[0] // 2 + 1
    roots_y, roots_x = (fft.roots(device, length) for length in period)
    before = [(length - n) // 2 for length, n in zip(period, (rows, cols), strict=True)]
    shape = {
        "PERIOD_Y": phases_y,
        "PERIOD_X": phases_x,
        "LENGTH_Y": period[0],
        "LENGTH_X": period[1],
        "BORDER": BORDERS[border],
        "REGISTERS": fft.REGISTERS,
    }
    launch = functools.partial(device.launch, LINES)
    pitch, groups = cols + cols % 2, -(-cols // (2 * columns_forward))
    folded = device.empty((cfa.size, small[0] // 2 + 1, small[1], 2))
    halves = device.empty((min(BATCH, count), stored, pitch, 2))
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        group = fft.threads(device, period[0], columns_forward)
        defines = shape | {
            "THREADS": group,
            "COLUMNS_FORWARD": columns_forward,
            "LOCAL_BYTES": fft.room(period[0], columns_forward),
            "FORWARD": fft.passes(period[0], columns_forward, -1),
        }
        arrays, sizes = [planes, roots_y, halves], [first, before[0], rows, cols, pitch, groups]
        grid = (size * groups * group,)
        launch("columns_forward", grid, *arrays, *sizes, group=(group,), defines=defines)
        group = fft.threads(device, period[1], rows_forward)
        some = fft.constant(device, mix[:, first : first + size].tobytes(), (len(mix), size))
        arrays = [halves, tables, some, roots_y, roots_x, folded]
        defines = shape | {
            "THREADS": group,
            "ROWS_FORWARD": rows_forward,
            "ROWS_INVERSE": rows_inverse,
            "FORWARD": fft.passes(period[1], rows_forward, -1),
            "INVERSE": fft.passes(small[1], rows_inverse, 1, phases_x),
            "LOCAL_BYTES": max(fft.room(period[1], rows_forward), fft.room(small[1], rows_inverse)),
            "OWN": -(-small[1] // group),
            "CHANNELS": len(mix),
            "COMPLEX": _is_complex(tables, period),
            "CFA": ", ".join(map(str, cfa.ravel())),
            "TURNS_Y": fft.roots_text(phases_y),
            "TURNS_X": fft.roots_text(phases_x),
        }
        numbers = [int(first == 0), first, count, int(tables.shape[0] > 1)]
        sizes = [before[1], size, cols, pitch]
        grid = ((small[0] // 2 + 1) * group,)
        launch("fold", grid, *arrays, *numbers, *sizes, group=(group,), defines=defines)
    side_by_side = columns_inverse * cfa.size // 2
    group = fft.threads(device, small[0], side_by_side)
    defines = shape | {
        "THREADS": group,
        "COLUMNS_INVERSE": columns_inverse,
        "LOCAL_BYTES": fft.room(small[0], side_by_side),
        "INVERSE": fft.passes(small[0], side_by_side, 1, phases_y),
    }
    arrays, sizes = [folded, roots_y, out], [1 / (period[0] * period[1]), *start, *out.shape]
    grid = (-(-small[1] // columns_inverse) * group,)
    launch("columns_inverse", grid, *arrays, *sizes, group=(group,), defines=defines)


def _is_complex(tables, period):
    """Return 1 if tables are halves of complex values, 0 if they are quarters of real ones."""
    return int(tables.shape[3] != period[1] // 2 + 1)


def _lines(local_bytes, period, cfa_shape):
    """Return how many lines a work-group has in each kernel, or None if local memory holds too few.

    The numbers are: columns forward (two real columns to a line), rows forward and inverse of the
    fold, columns of all phases inverse. Each is as large as local memory and use allow.
    """

    def most(choices, length):
        return next((n for n, lines in choices if fft.room(length, lines) <= local_bytes), None)

    small = tuple(length // n for length, n in zip(period, cfa_shape, strict=True))
    phases = cfa_shape[0] * cfa_shape[1]
    found = (
        most([(n, n) for n in (4, 2, 1)], period[0]),
        most([(n, n) for n in range(cfa_shape[0], 0, -1) if cfa_shape[0] % n == 0], period[1]),
        most([(n, n) for n in range(phases, 0, -1) if phases % n == 0], small[1]),
        most([(n, n * phases // 2) for n in (8, 4, 2, 1) if n * phases % 2 == 0], small[0]),
    )
    return None if None in found else found


def _turns(length, count):
    """Return exp(2 pi i f d / length) / count, d < count, shape (length, count, 2)."""
    angle = 2 * np.pi * (np.outer(np.arange(length), np.arange(count)) % length) / length
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1) / count


def cases():
    """Yield cases.

    All borders and Bayer phases, periods 1 to 8, odd sizes, more than a batch, own tables, kernels
    off their centres, a highlight of 1e6.
    """
    random = np.random.default_rng(5)
    why = (
        "as optics.blur, 1.2e-6 of the peak for each of the two transforms; the folded sum adds one rounding of a "
        "term per alias, which its own size bounds"
    )
    bayer = [[0, 1], [1, 2]]
    for rows, cols, count, cfa, own, border, period, margin in (
        (1, 1, 1, [[0]], 0, "zero", (1, 1), 0),
        (3, 5, 3, bayer, 1, "edge", (10, 16), 0),
        (63, 65, 31, [[1, 0], [2, 1]], 0, "reflect", (80, 90), 0),
        (63, 65, 4, [[1, 2], [0, 1]], 1, "zero", (64, 72), 0),
        (20, 30, 9, [[2, 1], [1, 0]], 1, "edge", (64, 60), 7),
        (40, 31, 2, [[0, 1, 2]], 1, "edge", (45, 45), 0),
        (31, 40, 2, np.arange(32).reshape(8, 4) % 3, 0, "zero", (40, 48), 3),
        (33, 21, 2, np.arange(15).reshape(3, 5) % 4, 1, "edge", (45, 25), 0),
        (33, 30, 9, bayer, 0, "edge", (40, 48), 2),
        (33, 30, 3, [[1, 0], [2, 1]], 1, "reflect", (50, 36), 0),
        (33, 40, 2, np.arange(9).reshape(3, 3) % 4, 1, "zero", (45, 45), 0),
    ):
        channels = int(np.max(cfa)) + 1
        widths = random.uniform(0.3, 2, (channels if own else 1, count, 1, 1))
        tables = gaussian_tables(widths, period)
        if rows == 33 and cols >= 30:
            shifts = random.uniform(-2, 2, (2, *widths.shape))
            tables = displaced_tables(widths, shifts, period)
        planes = random.random((count, rows, cols))
        planes[0, rows // 2, cols // 2] = 1e6
        inputs = {
            "planes": planes.astype(np.float32),
            "tables": tables.astype(np.float32),
            "mix": random.random((channels, count)).astype(np.float32),
            "cfa": np.array(cfa, np.int32),
            "border": border,
            "period": period,
            "margin": margin,
        }
        yield Case(
            f"{rows}x{cols}, {count} planes, mosaic of {np.shape(cfa)}, {border}",
            inputs,
            2.4e-6,
            why,
        )


def bench(rows, cols):
    """Return inputs: four planes to a Bayer mosaic, 64 pixels of border."""
    random = np.random.default_rng(5)
    period, _ = transform_lengths((rows + 128, cols + 128), (2, 2))
    return {
        "planes": random.random((4, rows, cols), np.float32),
        "tables": random.random((3, 4, period[0] // 2 + 1, period[1] // 2 + 1), np.float32),
        "mix": np.ones((3, 4), np.float32),
        "cfa": RGGB,
        "border": "edge",
        "period": period,
    }


def operations(planes, tables, mix, cfa, border, period):
    """Count operations.

    Transforms there; per frequency and channel each plane times its table, added up; back one for
    each phase.
    """
    frequencies, phases = period[0] * (period[1] // 2 + 1), cfa.shape
    small = [length // n for length, n in zip(period, phases, strict=True)]
    back = cfa.size * fft.operations(small)
    return len(planes) * fft.operations(period) + 4 * frequencies * mix.size + back
