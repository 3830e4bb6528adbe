"""Dead, hot and stuck pixels of any mosaic, replaced from good neighbours of their colour.

Ports: raw (rows, cols) uint16 [DN] -> (rows, cols) uint16 [DN], changed only at defective pixels.
Known defects are replaced first; defects found in the result are replaced after that. The bits are
the same on every device.

A pixel is defective if all of this holds. [low, high] is the range of the nearest complete rings of
its colour that hold eight neighbours or more, and excess the distance from the range to the pixel's
value, up or down:

    excess^2 > t^2 (gain max(end - black_level, 0) + read^2)    end = high or low: it is no noise
    excess > high - low                                         it is no texture
    spread <= excess / 8 or                                     it is no point of light, which a lens
        spread^2 <= t^2 (gain .. + read^2)                      spreads to adjacent pixels, beyond noise

Spread is the sum of q - r, up or down as the pixel, over the four adjacent pixels q of any colour;
r is the nearest pixel of q's colour straight beyond q.

A replaced pixel gets the rounded mean of the two opposite good neighbours that differ least (among
equal differences, the pair with the smallest mean). They are searched in groups: the rings named
above, then ring by ring up to REACH periods of the mosaic. If there is no such pair, it gets the
mean of the nearest group's good neighbours; without any, its value stays. Pixels outside the frame
are unknown and take no part.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.common.cases import MOSAICS, RGGB
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.interpolate import checked_mosaic
from gpusim.kernels.processor.levels import check_black, check_noise
from gpusim.kernels.stage import Array, exact_case, is_opencl_cpu, stage, warp_only

NEAR = 8  # least number of neighbours for the range
REACH, LEAST_REACH = 2, 4  # search distance for good neighbours: periods, and pixels at least
LANES = 16  # neighbouring pixels that CPUs process at once
BESIDE = ((-1, 0), (0, -1), (0, 1), (1, 0))


@stage
def defects(
    device: Device,
    raw: Array,
    known: Array | None = None,
    *,
    cfa: Array,
    black_level: float,
    noise: tuple[float, float] = (0.0, 0.0),
    detect: float | None = None,
) -> Array:
    """Replace defective pixels.

    Of two defects that are neighbours of one colour, neither may be found, because each is within
    the other's range.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        known: Known defects, not 0 or True, shape (rows, cols); None for none.
        cfa: Channel of each pixel in one period of the mosaic, at most 8 x 8, whole numbers 0 .. C
            - 1 that all occur.
        black_level: Black level [DN].
        noise: (gain [DN/e-], read [DN]): the variance of a digital number is gain (DN -
            black_level) + read^2.
        detect: Standard deviations of that noise by which a defect leaves its neighbours' range;
            None to search for none.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Digital numbers [DN], shape (rows, cols), uint16.

    Raises:
        BadData: Shapes, types or the mosaic do not fit.
        OutOfRange: `black_level`, `noise` or `detect` is not allowed.
    """
    check_mosaic(raw, 1.0)
    check_black(black_level)
    gain, read = check_noise(noise)
    cfa = checked_mosaic(np.asarray(device.numpy(cfa)))
    rows, cols = raw.shape
    if known is not None and tuple(known.shape) != (rows, cols):
        raise BadData(
            f"known defects: shape {tuple(known.shape)}, wanted the shape of raw, {(rows, cols)}"
        )
    kind = getattr(known, "dtype", None) if isinstance(known, device.array_type) else np.uint8
    if kind not in (np.uint8, device.empty((1,), np.uint8).dtype):
        raise BadData(f"known defects: {kind}, wanted uint8")
    if detect is not None and not 0 < detect < 1e6:
        raise OutOfRange("detect", detect, "0 < detect < 1e6 standard deviations, or None")
    lines = is_opencl_cpu(device)
    near, count, starts, entries, masks, reach = _tables(
        device, cfa.astype(np.int32).tobytes(), cfa.shape
    )
    grid, group = ((rows, 1), (1, 1)) if lines else ((rows, cols), None)
    defines = {"LINES": int(lines), "COUNT": count, "PERIOD_X": cfa.shape[1]}
    launch = functools.partial(device.launch, "processor.defects", group=group, defines=defines)
    raw = device.array(raw, np.uint16)

    def replace(values, flags):
        out = device.empty((rows, cols), np.uint16)
        arrays = [values, flags, starts, entries, out]
        sizes = [*cfa.shape, rows, cols]
        launch("replace", grid, *arrays, *sizes)
        return out

    if known is not None:
        flags = known if isinstance(known, device.array_type) else np.asarray(known) != 0
        raw = replace(raw, device.array(flags, np.uint8))
    if detect is not None:
        flags = device.empty((rows, cols), np.uint8)
        arrays = [raw, near, masks, flags]
        constant = float(detect * detect * read * read)
        numbers = [float(black_level), float(detect * detect * gain), constant, reach]
        sizes = [*cfa.shape, rows, cols, *warp_only(device, count)]
        launch("mark", grid, *arrays, *numbers, *sizes)
        raw = replace(raw, flags)
    return raw


@functools.lru_cache(maxsize=64)
def _tables(device, cfa, shape):
    """Return tables of the neighbours of each phase of the mosaic, on the device.

    near: for each phase (dy, dx), COUNT neighbours of the range, the four adjacent pixels and those
    beyond them, shape (period_y period_x, COUNT + 8, 2). starts: first of the entries of each
    phase, and the end. entries: dy, dx, whether the opposite has the same colour, group, shape (N,
    4). masks: 65535 if column x has the phase, shape (period_x, period_x + LANES). reach: of `near`
    [pixel].
    """
    cfa = np.frombuffer(cfa, np.int32).reshape(shape)
    phases = [_neighbours(cfa, y, x) for y in range(shape[0]) for x in range(shape[1])]
    count = max(len(near) for near, _, _ in phases)
    near = np.array(
        [[near[n % len(near)] for n in range(count)] + beside for near, beside, _ in phases],
        np.int32,
    )
    starts = np.cumsum([0] + [len(entries) for _, _, entries in phases], dtype=np.int32)
    entries = np.array([entry for _, _, entries in phases for entry in entries], np.int32)
    columns = np.arange(shape[1])
    masks = np.where(np.arange(shape[1] + LANES) % shape[1] == columns[:, None], 65535, 0)
    return (
        device.array(near, np.int32),
        count,
        device.array(starts, np.int32),
        device.array(entries, np.int32),
        device.array(masks, np.uint16),
        int(abs(near).max()),
    )


def _neighbours(cfa, y, x):
    """Return range neighbours, adjacent pixels with those beyond, and all neighbours in reach."""

    def channel(dy, dx):
        return cfa[(y + dy) % len(cfa), (x + dx) % len(cfa[0])]

    far = [max(LEAST_REACH, REACH * n) for n in cfa.shape]
    same = sorted(
        (dy * dy + dx * dx, dy, dx)
        for dy in range(-far[0], far[0] + 1)
        for dx in range(-far[1], far[1] + 1)
        if (dy or dx) and channel(dy, dx) == channel(0, 0)
    )
    radius = same[min(NEAR, len(same)) - 1][0]
    near = [(dy, dx) for square, dy, dx in same if square <= radius]
    rings = sorted({square for square, _, _ in same if square > radius})
    entries = []
    for square, dy, dx in same:
        ring = 0 if square <= radius else 1 + rings.index(square)
        entries.append((dy, dx, int(channel(-dy, -dx) == channel(0, 0)), ring))
    beyond = [
        next((n * dy, n * dx) for n in range(2, 10) if channel(n * dy, n * dx) == channel(dy, dx))
        for dy, dx in BESIDE
    ]
    return near, [*BESIDE, *beyond], entries


def cases():
    """Yield cases.

    Known, found and both; all phases, X-Trans, quad-Bayer, monochrome and random mosaics; clusters;
    tiny frames.
    """
    random = np.random.default_rng(9)
    why = "integers, and three float32 roundings in the same order"
    names = "GRBG", "GBRG", "BGGR", "quad-Bayer", "X-Trans", "grey", "stripes"
    mosaics = {"RGGB": RGGB} | {name: MOSAICS[name] for name in names}
    mosaics["four of 8x8"] = random.permutation(np.arange(64) % 4).reshape(8, 8).astype(np.int32)
    for name, cfa in mosaics.items():
        for rows, cols in ((1, 1), (1, 7), (2, 2), (5, 3), (31, 90)):
            raw = random.poisson(700, (rows, cols)).astype(np.uint16)
            bad = random.random((rows, cols))
            raw[bad < 0.02] = 65535
            raw[bad > 0.98] = 0
            known = (random.random((rows, cols)) < 0.1).astype(np.uint8)
            whole = rows == 31
            for label, options in (
                ("both", {"known": known, "detect": 6.0}),
                *([("known", {"known": known}), ("found", {"detect": 4.0})] if whole else []),
            ):
                inputs = {"raw": raw, "cfa": cfa, "black_level": 64.25, "noise": (1.0, 3.0)}
                yield exact_case(f"{name} {rows}x{cols} {label}", why, **inputs, **options)
    raw = random.integers(0, 65536, (24, 40), np.uint16)
    cluster = np.zeros(raw.shape, np.uint8)
    cluster[5:14, 8:19] = 1
    inputs = {"raw": raw, "cfa": RGGB, "black_level": 0.0}
    yield exact_case("cluster of 9x11", why, **inputs, known=cluster)
    nothing = "nothing is replaced"
    yield exact_case("all defective", nothing, **inputs, known=np.ones_like(cluster))
    yield exact_case("nothing asked", nothing, **inputs)


def bench(rows, cols):
    """Return inputs.

    A 10-bit Bayer mosaic with one known defect in a thousand, and a search for more.
    """
    random = np.random.default_rng(9)
    return {
        "raw": random.poisson(400, (rows, cols)).astype(np.uint16),
        "known": (random.random((rows, cols)) < 1e-3).astype(np.uint8),
        "cfa": RGGB,
        "black_level": 64.0,
        "noise": (1.0, 3.0),
        "detect": 6.0,
    }
