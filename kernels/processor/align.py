"""How a burst's frames are displaced against one of them, tile by tile, in whole periods of the mosaic and fractions.

Ports: raw (frames, rows, cols) uint16 [DN] -> displacement (frames, tiles_y, tiles_x, 2) float32 [period], rows first:
what is at block b of the reference is at b + displacement in the frame.

The pixels of one period are added to a block, which has no mosaic any more. Blocks are halved by means of 2 x 2,
rounded to whole numbers, as long as a tile of 16 x 16 fits. From the coarsest picture on, every tile starts with twice
what its parent found and tries all whole displacements up to FINE (the coarsest: COARSE) around it. It takes the one of
the least sum of absolute differences. At the end a paraboloid is fitted to the nine sums of squared differences around
it; its minimum, at most half a period away, is the fraction. A displacement back is one forth of the other tile, so
that equal tiles have equal sums on both sides (else the edges of the tile pull by 0.04 period). Pictures go on at their
edges as they end there.

A displacement that is chosen for its noise makes the frame's noise look like the reference's, or moves sharp edges, and
both spoil the average. So each has to be significant. Of n differences inside both pictures:
- A sum of |differences| of normal noise scatters by 0.755 / sqrt(n) of itself, and the difference of two such sums with
  one tile in common by 0.94 / sqrt(n). To be followed further, another whole displacement than the start has to save
  LIKELY / sqrt(n) of the start's sum, 2.1 of these. At the end it is taken only if on some level, the tile's or a
  parent's, it saved SAVED / sqrt(n) of the sum at rest, 4.2 of these, for tens of them are tried.
- With H = 2 sum of g^2, the bend of the sum of squares f for gradients g, and the noise s^2 = f / 2 n of a pixel, the
  slope scatters by up to 4 s^2 H + 2 n s^4. The depth of the minimum, slope^2 / 2 H, has to be SURE times f / n
  (1 + f / 4 H), which is 2.8 of these standard deviations.
Along an axis where the sum rises by less than an eighth of itself per period there is nothing to go by and no fraction.

Sums are whole numbers, so all devices choose the same displacement. Where a frame shows something else, a displacement
is found all the same: `processor.average` tells whether it fits.
"""

from numbers import Real

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Case, stage

TILE = 16  # rows and columns of blocks
COARSE, FINE = 4, 2  # search radius in the coarsest picture and in the others
PAD = (
    2 * TILE + COARSE + 4
)  # blocks that planes are continued by: a window reaches 2 TILE + COARSE + 1 outside
MOST_LEVELS = 8
LIKELY, SAVED = 2, 4  # of a sum over the square root of the number of its differences, see above
SURE = 8.0  # depth of a paraboloid's minimum, over what noise gives it


@stage
def align(device, raw, *, reference=0, period=(2, 2), levels=None):
    """Displacement of every tile of every frame, 0 where noise explains what is found.

    raw: shape (frames, rows, cols) uint16 [DN]. reference: the frame that the others are compared with. period: rows
    and columns of the mosaic, 1 to 8. levels: pictures, each half as large as the one before, None: as many as hold a
    tile, up to 8. The largest displacement that can be found is about (2 COARSE - 1) 2^(levels - 1) periods.
    Returns shape (frames, tiles_y, tiles_x, 2) [period], a tile being 16 x 16 periods; 0 for the reference.
    Raises BadData (a frame of less than one tile too), OutOfRange.
    Source: Hasinoff et al. 2016, "Burst photography for high dynamic range and low-light imaging on mobile cameras",
    section 4, for the pyramid of tiles and the paraboloid.
    """
    size = checked(raw, reference, period, levels)
    count, rows, cols = raw.shape
    raw = device.array(raw, np.uint16)
    lanes = 8 if device.kind == "opencl" and not device.is_gpu else 1
    common = {
        "defines": {
            "WIDTH": lanes,
            "TILE": TILE,
            "PAD": PAD,
            "LIKELY": LIKELY,
            "SAVED": SAVED,
            "SURE": f"{SURE}f",
            "PERIOD_Y": int(period[0]),
            "PERIOD_X": int(period[1]),
        }
    }
    extra = () if device.kind == "opencl" else (*map(int, period),)
    sizes, planes = [size], [device.empty((count, size[0] + 2 * PAD, size[1] + 2 * PAD), np.int32)]
    device.launch(
        "processor.align",
        "blocks",
        planes[0].shape,
        raw,
        planes[0],
        count,
        rows,
        cols,
        *size,
        *extra,
        **common,
    )
    while min(sizes[-1]) // 2 >= TILE and len(sizes) < (levels or MOST_LEVELS):
        sizes.append((sizes[-1][0] // 2, sizes[-1][1] // 2))
        planes.append(
            device.empty((count, sizes[-1][0] + 2 * PAD, sizes[-1][1] + 2 * PAD), np.int32)
        )
        device.launch(
            "processor.align",
            "halve",
            planes[-1].shape,
            planes[-2],
            planes[-1],
            count,
            *sizes[-2],
            *sizes[-1],
            **common,
        )
    group = (1, 1, 1) if lanes == 8 else None
    parents, parent_tiles = planes[-1], (0, 0)  # none yet: any array stands for them
    for (h, w), plane in zip(reversed(sizes), reversed(planes), strict=True):
        tiles = -(-h // TILE), -(-w // TILE)
        found = device.empty((count, *tiles, 3), np.int32)
        parents = device.reshape(parents, (int(np.prod(parents.shape)),))
        device.launch(
            "processor.align",
            "search",
            (count, *tiles),
            plane,
            parents,
            found,
            int(reference),
            COARSE if parent_tiles == (0, 0) else FINE,
            *parent_tiles,
            h,
            w,
            *tiles,
            count,
            group=group,
            **common,
        )
        parents, parent_tiles = found, tiles
    out = device.empty((count, *parent_tiles, 2))
    device.launch(
        "processor.align",
        "fraction",
        (count, *parent_tiles),
        planes[0],
        parents,
        out,
        int(reference),
        *size,
        *parent_tiles,
        count,
        group=group,
        **common,
    )
    return out


def checked(raw, reference, period, levels):
    """Rows and columns of blocks. Raises BadData, OutOfRange."""
    checked_stack(raw, reference, period)
    if levels is not None and not (1 <= levels <= MOST_LEVELS and levels == int(levels)):
        raise OutOfRange("levels", levels, f"a whole number, 1 <= levels <= {MOST_LEVELS}")
    size = raw.shape[1] // int(period[0]), raw.shape[2] // int(period[1])
    if min(size) < TILE:
        raise BadData(
            f"raw: {raw.shape[1]}x{raw.shape[2]} pixels; wanted at least {TILE * period[0]}x"
            f"{TILE * period[1]}, one tile of {TILE}x{TILE} periods"
        )
    return size


def checked_stack(raw, reference, period):
    """Refuse what is no stack of frames with a reference among them. Raises BadData, OutOfRange."""
    dtype = getattr(raw.dtype, "name", None) or raw.dtype.__name__  # of NumPy or of a device
    if len(raw.shape) != 3 or dtype != "uint16" or 0 in raw.shape:
        raise BadData(
            f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (frames, rows, cols) of uint16"
        )
    if not (
        isinstance(reference, Real)
        and 0 <= reference < raw.shape[0]
        and reference == int(reference)
    ):
        raise OutOfRange("reference", reference, f"the number of a frame, 0 .. {raw.shape[0] - 1}")
    if len(period) != 2 or not all(1 <= n <= 8 and n == int(n) for n in period):
        raise OutOfRange("period", period, "whole numbers of rows and columns, 1 .. 8")


def _moved(random, shifts, rows, cols, smooth):
    """A random picture seen from `shifts` [pixel], and noise."""
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


def cases():
    """Whole and broken displacements, odd sizes, other mosaics, flat fields, the largest numbers."""
    random = np.random.default_rng(8)
    why = (
        "whole displacements are equal; of 256 squares and their sum at most 24 roundings per lane, 2.4e-6 of sums "
        "up to 5 times the least bend, cancelled twice and over a determinant of at least a quarter: 4 x 3 x 5 x "
        "2.4e-6 < 2e-4"
    )
    for period, rows, cols, shifts in (
        ((2, 2), 64, 97, [(0, 0), (4, -6), (1, 3)]),
        ((1, 1), 50, 49, [(3, -2), (0, 0)]),
        ((6, 6), 130, 101, [(0, 0), (6, 0)]),
        ((2, 2), 150, 140, [(0, 0), (21, -33)]),
        ((4, 1), 64, 16, [(0, 0), (2, 1)]),
    ):
        raw = _moved(random, np.array(shifts), rows, cols, 4 * max(period))
        yield Case(
            f"{len(shifts)} frames {rows}x{cols}, period {period}",
            {"raw": raw, "period": period, "reference": shifts.index((0, 0))},
            2e-4,
            why,
            metric="exact",
        )
    yield Case(
        "one level",
        {"raw": _moved(random, np.array([(0, 0), (6, 6)]), 70, 70, 8), "levels": 1},
        2e-4,
        why,
        metric="exact",
    )
    raw = np.full((2, 40, 40), 65535, np.uint16)
    raw[1, 20:] = 0
    yield Case("nothing to go by", {"raw": raw}, 2e-4, why, metric="exact")


def bench(rows, cols):
    """Eight frames of a Bayer mosaic."""
    random = np.random.default_rng(8)
    return {"raw": _moved(random, random.integers(-20, 21, (8, 2)), rows, cols, 8)}
