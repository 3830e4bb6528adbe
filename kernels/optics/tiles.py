"""Blur by overlapping tiles, each transformed separately: to the mosaic, or to all channels.

Ports: planes (planes, rows, cols) float32, tables (groups, planes, side // 2 + 1, side // 2 + 1)
float32 [1], mix (channels, planes), cfa (ph, pw) -> mosaic (rows, cols), or channels (channels,
rows, cols), float32:

    e(y, x) = sum over k of  mix[c, k] (tile_k * kernel_ck)(y, x),   c = cfa[y mod ph, x mod pw].

A tile makes (side - 2 overlap)^2 pixels of the result. It begins `overlap` samples before them in
plane k. The convolution is circular. Kernels that end within `overlap` samples are therefore exact,
and longer ones see the wrong side of the tile; the rest of the kernels of `optics.near` rings, so
its error is small. Transforms have one length for frames of all sizes, and stay in a core's cache
or in local memory.
"""

import functools
from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.common import fft
from gpusim.kernels.common.border import BORDERS
from gpusim.kernels.common.cases import RGGB, gaussian_tables
from gpusim.kernels.stage import Array, Case, stage
from gpusim.optics.lengths import LANES, LONGEST, Tiling

# the kernels of CPUs and of GPUs
LANES_STAGE = "optics.tiles_lanes"
GROUPS_STAGE = "optics.tiles_groups"
MOST = 8  # channels, or phases of a mosaic of one pixel, that are made at once
TILES = 64  # that `_by_batches` transforms at a time
GROUP = 256  # work-items to a tile on a GPU
# of each at most, for sums of up to FEW floats and for more: fewer spill (measured on an H200)
REGISTERS = (80, 128)
FEW = 32
PAIRS = 4  # pairs of planes, at most, whose spectra a CPU keeps
RADICES = (8, 4, 3, 2)  # of lanes_fft.clh


@stage
def tiles(
    device: Device,
    planes: Array,
    tables: Array,
    mix: Array,
    cfa: Array | None,
    border: str,
    side: int,
    overlap: int,
    margin: int = 0,
) -> Array:
    """Convolve each plane with its kernels by tiles, and sum per channel.

    Args:
        planes: Light of each plane, shape (planes, rows, cols).
        tables: Quarters of the transfer functions [1], shape (1 or channels, planes, side // 2 + 1,
            side // 2 + 1). Entry (i, j) belongs to the frequency (i, j) / side cycles per sample.
        mix: Weight of each plane in each channel, shape (channels, planes).
        cfa: Channel of each pixel in one period of the mosaic, shape (ph, pw); None for every
            channel.
        border: "zero", "edge" or "reflect".
        side: Side of a tile [sample], up to LONGEST: a multiple of 8 times the mosaic's period,
            with no factors but 2 and 3.
        overlap: Samples on each side that neighbouring tiles share. side - 2 overlap is a multiple
            of the mosaic's period.
        margin: Samples on each side of the planes that the result lacks; if negative, that it has
            in addition.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The mosaic, shape (rows - 2 margin, cols - 2 margin), or channels, (channels, ...), float32.

    Raises:
        BadData: The side or the overlap is not allowed.

    Source:
        Overlap-save (Oppenheim and Schafer, Discrete-Time Signal Processing, 8.7). The fold is as
        in `optics.mosaic`.
    """
    _, rows, cols = planes.shape
    planes, tables = device.array(planes), device.array(tables)
    mix = np.ascontiguousarray(device.numpy(mix), np.float32)
    pattern = np.zeros((1, 1), np.int32) if cfa is None else np.asarray(device.numpy(cfa), np.int32)
    made = Tiling(side, overlap)
    if not made.suits(pattern.shape):
        raise BadData(
            f"tiles of {side} samples, {overlap} of them shared on each side, for a mosaic of "
            f"{pattern.shape[1]} x {pattern.shape[0]}; wanted a side up to {LONGEST} that is a multiple of 8 "
            "times the period with factors 2 and 3 only, and whole periods between the shared samples"
        )
    if cfa is None and len(mix) > MOST:
        return _one_by_one(device, planes, tables, mix, border, side, overlap, margin)
    shape = rows - 2 * margin, cols - 2 * margin
    images = len(mix) if cfa is None else 1
    out = device.empty((images, *shape))
    # from a tile's corner
    outputs = np.arange(len(mix)) if cfa is None else np.roll(pattern, overlap, (0, 1)).ravel()
    count = tuple(-(-n // made.valid) for n in shape)
    if device.on_host:
        make = _by_lanes if device.kind == "opencl" else _by_batches
    else:
        fits = _room(side, pattern.shape, len(outputs)) <= device.local_bytes
        make = _by_groups if fits else _by_batches
    make(
        *(device, planes, tables, mix, outputs, pattern.shape),
        *(border, side, overlap, margin, count, out),
    )
    return device.reshape(out, shape) if cfa is not None else out


def _one_by_one(device, planes, tables, mix, border, side, overlap, margin):
    """Blur channel by channel, each with only the planes that it uses."""
    channels = []
    for c, weights in enumerate(mix):
        used = np.flatnonzero(weights)
        own = device.part(tables, c if tables.shape[0] > 1 else 0)
        parts, theirs = (
            device.stack([device.part(array, int(k)) for k in used]) for array in (planes, own)
        )
        theirs, mixed = device.reshape(theirs, (1, *theirs.shape)), weights[None, used]
        channel = tiles(parts, theirs, mixed, None, border, side, overlap, margin, device=device)
        channels.append(device.part(channel, 0))
    return device.stack(channels)


def _shared_defines(side, overlap, period, outputs, channels, border):
    return {
        "SIDE": side,
        "OVERLAP": overlap,
        "PERIOD_Y": period[0],
        "PERIOD_X": period[1],
        "OUTPUTS": len(outputs),
        "OF": ", ".join(map(str, outputs)),
        "CHANNELS": channels,
        "BORDER": BORDERS[border],
    }


def _by_lanes(
    device, planes, tables, mix, outputs, period, border, side, overlap, margin, count, out
):
    """Blur on a CPU: a tile in each work-item, eight lines of it in the lanes of its vectors."""
    (channels, number), (_, rows, cols) = mix.shape, planes.shape
    even = number + number % 2
    defines = _shared_defines(side, overlap, period, outputs, channels, border) | {
        "PAIRS": min(even // 2, PAIRS),
        "COLUMNS": _passes(side, 1, -1, "LOAD", "TO_B"),
        "ROWS": _passes(side, 1, -1, "LOAD", "SAVE"),
        "BACK_X": _passes(side // period[1], period[1], 1, "LOAD", "TO_B"),
        "BACK_Y": _passes(side // period[0], period[0], 1, "LOAD", "TO_B"),
    }
    weights = device.empty((side // 2 + 1, side // LANES, even, channels, LANES))
    arrays = [tables, device.array(mix), weights]
    launch = functools.partial(device.launch, LANES_STAGE, defines=defines)
    launch("weights", (side, side // 2 + 1), *arrays, int(tables.shape[0] > 1), number)
    arrays = [planes, weights, fft.roots(device, side), _turns(device, side, period[0]), out]
    sizes = [margin, number, rows, cols, *out.shape[1:], count[1]]
    launch("tiles", (count[0] * count[1],), *arrays, *sizes, group=(1,))


def _by_batches(
    device, planes, tables, mix, outputs, period, border, side, overlap, margin, count, out
):
    """Blur by transforms of many tiles: on the host by SciPy, or if local memory holds no tile."""
    (channels, number), (_, rows, cols), (images, *shape) = mix.shape, planes.shape, out.shape
    small, valid, all_tiles = tuple(side // n for n in period), side - 2 * overlap, prod(count)
    of, mix = device.array(outputs, np.int32), device.array(mix)
    pitch = fft.pitch_of(device, small[1])
    launch = functools.partial(device.launch, "optics.tiles")
    for first in range(0, all_tiles, TILES):
        some = min(TILES, all_tiles - first)
        parts = device.empty((some * number, side, side))
        numbers = [BORDERS[border], first, valid, overlap - margin]
        sizes = [some * number, number, rows, cols, side, count[1]]
        launch("cut", parts.shape, planes, parts, *numbers, *sizes)
        spectra = fft.forward(device, parts)
        folded = device.empty((some * len(outputs), small[0], pitch, 2))
        arrays = [spectra, tables, mix, fft.roots(device, side), of, folded]
        sizes = [some, number, channels, len(outputs), *period, side, spectra.shape[2], pitch]
        grid = (some, small[0], small[1] // 2 + 1)
        launch("fold", grid, *arrays, int(tables.shape[0] > 1), *sizes)
        pixels = fft.inverse(device, folded, small[1])
        numbers = [first, valid, overlap, 1 / prod(period)]
        sizes = [some * images, images, len(outputs), *shape, *period, side, count[1]]
        launch("place", (some * images, valid, valid), pixels, out, *numbers, *sizes)


def _by_groups(
    device, planes, tables, mix, outputs, period, border, side, overlap, margin, count, out
):
    """Blur on a GPU: a tile in the local memory of each work-group."""
    (channels, number), (_, rows, cols) = mix.shape, planes.shape
    small, images = tuple(side // n for n in period), (len(outputs) + 1) // 2
    together = images if np.prod(period) > 1 else 1
    group = min(GROUP, device.group_limit)
    room = _room(side, period, len(outputs))
    sums = 2 * len(outputs) * -(-(small[0] // 2 + 1) * small[1] // group)
    first, *columns = _in_place(side, side, -1, "COLUMNS", first="FROM_PLANES")
    *back, last = _in_place(small[0], together * small[1], 1, "BACK_COLUMNS", last="TO_PIXELS")
    defines = _shared_defines(side, overlap, period, outputs, channels, border) | {
        "THREADS": group,
        "REGISTERS": REGISTERS[sums > FEW],
        "LOCAL_BYTES": room,
        "OWN_TABLES": int(tables.shape[0] > 1),
        "FIRST": first,
        "COLUMNS": " ".join(columns),
        "ROWS": " ".join(_in_place(side, side, -1, "ROWS")),
        "BACK_X": " ".join(_in_place(small[1], together * small[0], 1, "BACK_ROWS")),
        "BACK_Y": " ".join(back),
        "LAST": last,
        "PLACE_SIDE(f)": _place(side),
        "PLACE_Y(f)": _place(small[0]),
        "PLACE_X(f)": _place(small[1]),
        "TURNS_Y": fft.roots_text(period[0]),
        "TURNS_X": fft.roots_text(period[1]),
    }
    weights = fft.constant(device, mix.tobytes(), mix.shape)
    roots = fft.roots(device, side)
    arrays = [planes, tables, weights, roots, out]
    sizes = [margin, 0, number, rows, cols, *out.shape[1:], count[1]]
    grid = (count[0] * count[1] * group,)
    device.launch(GROUPS_STAGE, "tiles", grid, *arrays, *sizes, group=(group,), defines=defines)


def _room(side, period, outputs):
    """Return the bytes of local memory.

    It holds a complex tile, later its outputs two in one, and the roots of unity.
    """
    small = [side // n for n in period]
    together = (outputs + 1) // 2 if prod(period) > 1 else 1
    return 8 * (max(side * (side + 1), together * small[0] * (small[1] + 1)) + side)


def _radices(length):
    found = []
    for radix in RADICES:
        while length % radix == 0:
            found.append(radix)
            length //= radix
    return found


def _in_place(length, lines, sign, where, first=None, last=None):
    """Return the PASS_IN_PLACE calls of a transform.

    first, last: other places to read from and write to.
    """
    radices = _radices(length)
    passes = [(radix, length // prod(radices[:n])) for n, radix in enumerate(radices)][::-sign]
    reads, writes = [f"IN_{where}"] * len(passes), [f"TO_{where}"] * len(passes)
    reads[0], writes[-1] = first or reads[0], last or writes[-1]
    return [
        f"PASS_IN_PLACE({radix}, {block}, {length}, {lines}, {sign}.0f, {read}, {write})"
        for (radix, block), read, write in zip(passes, reads, writes, strict=True)
    ]


def _place(length):
    """Return the place of frequency f after a transform in place: its digits to the radices."""
    places, radices = [], _radices(length)
    for n, radix in enumerate(radices):
        before, own = prod(radices[:n]), prod(radices[: n + 1])
        places.append(f"(f) / {before} % {radix} * {length // own}")
    return f"({' + '.join(places)})"


def _passes(length, step, sign, source, target):
    """Return the LANES_PASS calls of a transform; its roots are those of length x step."""
    radices = _radices(length)
    between = ["B", "A"] if target == "SAVE" else ["A", "B"]
    places = [between[n % 2] for n in range(len(radices) - 1)][::-1]
    reads = [source, *(f"FROM_{place}" for place in places)]
    writes = [*(f"TO_{place}" for place in places), target]
    return " ".join(
        f"LANES_PASS({radix}, {prod(radices[:n])}, {length}, {step}, {sign}.0f, {reads[n]}, {writes[n]})"
        for n, radix in enumerate(radices)
    )


@functools.cache
def _turns(device, side, period):
    """Return the parts of exp(2 pi i f d / side) for phases d < period, shape (period, 2, side)."""
    angle = 2 * np.pi * (np.outer(np.arange(period), np.arange(side)) % side) / side
    return device.array(np.stack([np.cos(angle), np.sin(angle)], axis=1))


def cases():
    """Yield cases.

    All borders and Bayer phases, channels, periods 1 to 8, frames below a tile, own tables,
    margins, highlights.
    """
    random = np.random.default_rng(15)
    why = (
        "as optics.mosaic: a float32 transform errs by 3e-7 of the tile's root mean square, 1.2e-6 of the peak for "
        "each of two, and the fold errs by one rounding per term"
    )
    bayer, xtrans = np.array([[0, 1], [1, 2]]), np.arange(36).reshape(6, 6) % 3
    for rows, cols, count, cfa, own, border, side, overlap, margin in (
        (1, 1, 1, [[0]], 0, "zero", 64, 8, 0),
        (70, 101, 4, bayer, 1, "edge", 64, 8, 0),
        (63, 65, 31, [[1, 0], [2, 1]], 0, "reflect", 64, 16, 0),
        (50, 90, 2, xtrans, 1, "edge", 48, 9, 0),
        (110, 65, 3, [[1, 2], [0, 1]], 1, "zero", 64, 9, 5),
        (60, 75, 5, None, 1, "reflect", 64, 16, -2),
        (40, 61, 11, None, 1, "zero", 64, 12, 1),
        (90, 130, 2, None, 0, "edge", 48, 12, 0),
        (70, 66, 9, np.arange(32).reshape(8, 4) % 3, 0, "zero", 64, 8, 3),
        (40, 31, 2, [[0, 1, 2]], 1, "edge", 24, 3, 0),
    ):
        channels = (11 if count == 11 else 3) if cfa is None else int(np.max(cfa)) + 1
        widths = random.uniform(0.3, 2, (channels if own else 1, count, 1, 1))
        planes = random.random((count, rows, cols))
        if own:
            planes[0, rows // 2, cols // 2] = 1e6
        tables = gaussian_tables(widths, (side, side)).astype(np.float32)
        inputs = {
            "planes": planes.astype(np.float32),
            "tables": tables,
            "mix": random.random((channels, count)).astype(np.float32),
            "cfa": None if cfa is None else np.array(cfa, np.int32),
            "border": border,
            "side": side,
            "overlap": overlap,
            "margin": margin,
        }
        yield Case(
            f"{rows}x{cols}, {count} planes, {'channels' if cfa is None else f'mosaic of {np.shape(cfa)}'}, "
            f"{border}, tiles of {side} - 2 x {overlap}",
            inputs,
            2.4e-6,
            why,
        )


def bench(rows, cols):
    """Return inputs.

    Four planes to a Bayer mosaic, tiles of 64 samples, 8 of them shared on each side.
    """
    random = np.random.default_rng(15)
    return {
        "planes": random.random((4, rows, cols), np.float32),
        "tables": random.random((3, 4, 33, 33), np.float32),
        "mix": np.ones((3, 4), np.float32),
        "cfa": RGGB,
        "border": "edge",
        "side": 64,
        "overlap": 8,
    }


def operations(planes, tables, mix, cfa, border, side, overlap):
    """Count operations.

    Of each tile: transforms there; per frequency and channel each plane times its table; back one
    for each phase.
    """
    number = Tiling(side, overlap).samples(planes.shape[1:]) // side**2
    back = fft.operations([side // n for n in np.shape(cfa)]) * np.size(cfa)
    forward = len(planes) * fft.operations((side, side))
    return number * (forward + 4 * side * (side // 2 + 1) * np.size(mix) + back)
