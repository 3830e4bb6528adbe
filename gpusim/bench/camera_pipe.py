"""A camera pipeline in Halide: raw numbers to a picture.

It is the example of Halide's authors (Ragan-Kelley et al. 2012, ACM Transactions on Graphics 31 (4),
section 6; after Adams et al. 2010, The Frankencamera), written from its description: hot pixels
suppressed, edge-directed demosaicking on the four half-size planes, colour matrix in fixed point,
curve by table, sharpening. It is scheduled by hand like theirs, fused over strips of rows with line
buffers; table look-ups are scalar, which is faster on CPUs with slow gathers.
"""

from typing import Any

import numpy as np

MARGIN_ROWS, MARGIN_COLS = 12, 16  # of the mosaic around the picture


def camera_pipeline(rows: int, cols: int, matrix: np.ndarray, curve: np.ndarray) -> tuple[Any, Any]:
    """Return the pipeline and its input.

    It reads a margin of pixels instead of mirroring the border, so it has less work at the edges.

    Args:
        rows: Rows of the picture, even.
        cols: Columns, even.
        matrix: Colour matrix, shape (3, 3).
        curve: Code of each camera value, shape (values,), uint8. The pipeline reads it: keep it.

    Returns:
        A Halide function that gives the picture (cols, rows, 3), uint8, and its input, a GRBG mosaic
        with the margin, uint16.

    Raises:
        ImportError: Halide is not installed.
    """
    import halide as hl

    x, y, c, value = (hl.Var(name) for name in ("x", "y", "c", "value"))
    raw = hl.ImageParam(hl.UInt(16), 2)
    raw.dim(0).set_bounds(0, cols + 2 * MARGIN_COLS)
    raw.dim(1).set_bounds(0, rows + 2 * MARGIN_ROWS).set_stride(cols + 2 * MARGIN_COLS)
    mean = hl.rounding_halving_add

    number, calm, plane = hl.Func("number"), hl.Func("calm"), hl.Func("plane")
    number[x, y] = hl.i16(raw[x + MARGIN_COLS, y + MARGIN_ROWS])
    brightest = hl.max(
        hl.max(number[x - 2, y], number[x + 2, y]), hl.max(number[x, y - 2], number[x, y + 2])
    )
    calm[x, y] = hl.clamp(number[x, y], hl.i16(0), brightest)
    plane[x, y, c] = hl.mux(
        c,
        [
            calm[2 * x, 2 * y],
            calm[2 * x + 1, 2 * y],
            calm[2 * x, 2 * y + 1],
            calm[2 * x + 1, 2 * y + 1],
        ],
    )

    def sample(number):
        return lambda dx=0, dy=0: plane[x + dx, y + dy, number]

    green_r, red, blue, green_b = map(
        sample, range(4)
    )  # green of the red rows, ... in the 2 x 2 cell
    at_red, at_blue = hl.Func("green_at_red"), hl.Func("green_at_blue")

    def smoother(one, other):  # the mean of the pair that differs less
        return hl.select(hl.absd(*one) < hl.absd(*other), mean(*one), mean(*other))

    at_red[x, y] = smoother((green_r(1), green_r()), (green_b(0, -1), green_b()))
    at_blue[x, y] = smoother((green_b(-1), green_b()), (green_r(0, 1), green_r()))

    def carried(color, green, here, p, q):  # a colour's mean plus green's deviation from its mean
        return (
            here
            + mean(color(*p), color(*q))
            - mean(green[x + p[0], y + p[1]], green[x + q[0], y + q[1]])
        )

    def diagonal(color, green, here, one, other):
        return hl.select(
            hl.absd(color(*one[0]), color(*one[1])) < hl.absd(color(*other[0]), color(*other[1])),
            carried(color, green, here, *one),
            carried(color, green, here, *other),
        )

    here = (0, 0)
    cells = (
        (
            carried(red, at_red, green_r(), (-1, 0), here),
            red(),
            diagonal(red, at_red, at_blue[x, y], (here, (-1, 1)), ((-1, 0), (0, 1))),
            carried(red, at_red, green_b(), here, (0, 1)),
        ),
        (green_r(), at_red[x, y], at_blue[x, y], green_b()),
        (
            carried(blue, at_blue, green_r(), here, (0, -1)),
            diagonal(blue, at_blue, at_red[x, y], (here, (1, -1)), ((1, 0), (0, -1))),
            blue(),
            carried(blue, at_blue, green_b(), here, (1, 0)),
        ),
    )
    colors = []
    for cell in cells:
        parts = [hl.Func(f"part{number}") for number in range(4)]
        for part, expression in zip(parts, cell, strict=True):
            part[x, y] = expression
        corner = [part[x // 2, y // 2] for part in parts]
        colors.append(
            hl.select(
                y % 2 == 0,
                hl.select(x % 2 == 0, corner[0], corner[1]),
                hl.select(x % 2 == 0, corner[2], corner[3]),
            )
        )
    camera, corrected, curved, table = (
        hl.Func("camera"),
        hl.Func("corrected"),
        hl.Func("curved"),
        hl.Func("table"),
    )
    camera[x, y, c] = hl.mux(c, colors)
    fixed = np.rint(256 * np.asarray(matrix)).astype(int)
    sums = [
        sum((hl.i32(camera[x, y, k]) * int(row[k]) for k in range(3)), hl.i32(0)) // 256
        for row in fixed
    ]
    last = len(curve) - 1
    corrected[x, y, c] = hl.u16(hl.clamp(hl.mux(c, sums), 0, last))
    table[value] = hl.Buffer(curve)[value]
    curved[x, y, c] = table[hl.i32(hl.unsafe_promise_clamped(corrected[x, y, c], 0, last))]
    down, blurred, picture = hl.Func("down"), hl.Func("blurred"), hl.Func("picture")
    down[x, y, c] = mean(mean(curved[x, y - 1, c], curved[x, y + 1, c]), curved[x, y, c])
    blurred[x, y, c] = mean(mean(down[x - 1, y, c], down[x + 1, y, c]), down[x, y, c])
    detail = hl.i16(curved[x, y, c]) - hl.i16(blurred[x, y, c])
    picture[x, y, c] = hl.u8_sat(hl.i16(curved[x, y, c]) + detail // 2)

    lanes, strip = 32, 36
    strips, steps, two, xi, yi = (hl.Var(name) for name in ("strips", "steps", "two", "xi", "yi"))
    picture.bound(c, 0, 3).bound(x, 0, cols).bound(y, 0, rows).compute_root()
    picture.split(y, strips, steps, strip).split(steps, steps, two, 2).split(x, x, xi, 2 * lanes)
    picture.reorder(xi, c, two, x, steps, strips).vectorize(xi, lanes).unroll(c).parallel(strips)
    table.compute_root()
    calm.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 16).vectorize(
        x, lanes
    )
    plane.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 8).vectorize(
        x, lanes
    )
    plane.reorder(c, x, y).unroll(c)
    curved.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 8).align_bounds(
        x, 2
    ).align_bounds(y, 2)
    curved.reorder(c, x, y).tile(x, y, x, y, xi, yi, 2 * lanes, 2).reorder(xi, c, yi, x, y).unroll(
        c
    ).unroll(yi)
    curved.unroll(xi, 8)
    corrected.compute_at(curved, x).reorder(c, x, y).vectorize(x, lanes).unroll(c)
    camera.compute_at(curved, x).vectorize(x, lanes).reorder(c, x, y).unroll(c).unroll(y)
    for green in (at_red, at_blue):
        green.compute_at(curved, x).vectorize(x, lanes)
    return picture, raw
