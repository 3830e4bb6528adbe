"""Terms of kernels that vary with place and circle of confusion: polynomials in each tile.

Ports: cover (2, rows, cols) float32, degrees (terms, 3) int32, spans (tiles, 2) float32 [, even
(channels, tiles, 4) float32] -> terms, then gains (terms + channels, rows, cols) float32 [1].

A layer has at each pixel a coverage a and a (c - low), c its circle of confusion [pixel], `limits` low
and high. In a tile with middle c0 and scale s, with the place v, u from -1 to 1 between its sides,

    c = low + a (c - low) / a,  low where a is 0, within low .. high
    term_k = T_a(v) T_b(u) T_d(s (c - c0)),  degrees a, b, d;  s (c - c0) within -1 .. 1
    gain = 1 / (1 + e0 + e1 v + e2 u + e3 (c - c0)),  c - c0 within -2 .. 2

T are Chebyshev's polynomials. Terms are coefficients of `optics.field`, whose tiles these are. Gains
make the coverage of an even surface as at the kernels' reference.
"""

import functools
from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage

MOST = 12  # degree


@stage
def expand(
    device: Device,
    cover: Array,
    degrees: Array,
    spans: Array,
    edges: Sequence[np.ndarray],
    limits: tuple[float, float],
    even: Array | None = None,
) -> Array:
    """Return polynomials of the place in the tile and of the circle of confusion.

    Args:
        cover: Coverage of each pixel [1], and it times the circle of confusion above the least
            [pixel], shape (2, rows, cols).
        degrees: Degrees along rows and columns, and of the circle, at most 12, shape (terms, 3).
            There may be none.
        spans: Middle of the circles of confusion in each tile [pixel], and 1 over half their range,
            shape (tiles, 2).
        edges: Boundaries of the tiles' rows and columns: see `optics.field`.
        limits: Least and largest circle of confusion [pixel].
        even: Terms of gains, shape (channels, tiles, 4); None: no gains.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Terms and gains, shape (terms + channels, rows, cols), float32.
    """
    _, rows, cols = cover.shape
    terms, gains = degrees.shape[0], 0 if even is None else even.shape[0]
    tiles, along = zip(*map(_along, edges, (rows, cols)), strict=True)
    places = [device.array(one, np.int32) for one in tiles]
    out = device.empty((terms + gains, rows, cols))
    launch = functools.partial(device.launch, "optics.expand")
    cover, spans = device.array(cover), device.array(spans)
    numbers, sizes = [float(limit) for limit in limits], [rows, cols, len(edges[1]) - 1]
    degrees = np.asarray(device.numpy(degrees))
    of_place = [
        device.array(np.cos(degrees[:, [axis]] * np.arccos(at.clip(-1, 1))))
        for axis, at in enumerate(along)
    ]
    of_circle = device.array(degrees[:, 2], np.int32)
    arrays = [cover, *places, *of_place, spans, of_circle, out]
    launch("terms", (terms, rows, cols), *arrays, *numbers, terms, *sizes)
    if even is not None:
        arrays = [cover, *places, *map(device.array, along), spans, device.array(even), out]
        launch(
            "gains", (gains, rows, cols), *arrays, *numbers, terms, gains, *sizes, spans.shape[0]
        )
    return out


def _along(edge, size):
    """Return the tile of each row or column, and its place between the tile's sides, -1 .. 1."""
    edge, at = np.asarray(edge), np.arange(size)
    tile = np.clip(np.searchsorted(edge, at, "right") - 1, 0, len(edge) - 2)
    sides = np.clip(edge, 0, size - 1).astype(np.float64)
    sides[1:-1] -= 0.5  # between pixels
    middle, half = (sides[:-1] + sides[1:]) / 2, np.maximum((sides[1:] - sides[:-1]) / 2, 0.5)
    return tile, (at - middle[tile]) / half[tile]


def cases():
    """Yield cases: one pixel, several tiles, every degree, no gains, nothing covered."""
    random = np.random.default_rng(36)
    for rows, cols, count, most, channels in (
        (1, 1, 1, 0, 0),
        (5, 7, 2, 3, 1),
        (33, 65, 3, 12, 3),
        (70, 41, 4, 2, 0),
        (9, 4, 2, -1, 2),  # only gains
    ):
        edges = [
            np.unique(np.round(np.linspace(-3, n + 3, min(count, n) + 1)).astype(int))
            for n in (rows, cols)
        ]
        tiles = (len(edges[0]) - 1) * (len(edges[1]) - 1)
        low, high = -3.0, 5.0
        circle = random.uniform(low, high, (rows, cols))
        alpha = random.random((rows, cols)) * (random.random((rows, cols)) > 0.2)
        degrees = [(a, b, d) for a in (0, 1) for b in (0, 3) for d in range(most + 1)]
        degrees = np.array(degrees).reshape(-1, 3)
        half = random.uniform(1, 4, tiles)
        half[::3] = np.inf  # one circle
        spans = np.stack([random.uniform(low, high, tiles), 1 / half], axis=1)
        even = random.uniform(-0.05, 0.05, (channels, tiles, 4)) if channels else None
        slope = float(most**2 + 9 + 1)
        yield Case(
            f"{rows}x{cols}, {tiles} tiles, degrees up to {most}, {channels} channels",
            {
                "cover": np.stack([alpha, alpha * (circle - low)]).astype(np.float32),
                "degrees": degrees.astype(np.int32),
                "spans": spans.astype(np.float32),
                "edges": edges,
                "limits": (low, high),
                "even": None if even is None else even.astype(np.float32),
            },
            16 * 2.0**-24 * slope * 8,
            "places and circles of up to 8 round by a few ulps, which slopes of the polynomials, the square of their "
            "degree at most, enlarge; recurrences add about as much",
            metric="exact",
        )


def bench(rows, cols):
    """Return inputs: 8 x 15 tiles, nine terms, three channels."""
    random = np.random.default_rng(36)
    edges = [
        np.unique(np.linspace(-11, n + 11, min(c, n) + 1).astype(int))
        for n, c in ((rows, 8), (cols, 15))
    ]
    tiles = (len(edges[0]) - 1) * (len(edges[1]) - 1)
    return {
        "cover": random.random((2, rows, cols), np.float32),
        "degrees": np.array([(a, 0, d) for a in range(3) for d in range(3)], np.int32),
        "spans": np.ones((tiles, 2), np.float32),
        "edges": edges,
        "limits": (0.0, 2.0),
        "even": 0.01 * random.random((3, tiles, 4), np.float32),
    }


def operations(cover, degrees, spans, edges, limits, even=None) -> float:
    """Return the multiplications and additions: three recurrences for each term."""
    planes = len(degrees) + (0 if even is None else len(even))
    return 3.0 * 2 * MOST * planes * cover.shape[1] * cover.shape[2]
