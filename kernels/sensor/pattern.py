"""Fixed patterns of one chip: values that are equal in every frame, the same bits on every device.

Port: -> values (rows, cols) float32. With z standard normal numbers of the pixel, its row and its
column:

    value = mean + pixel z + row z(row) + column z(column)
    value = 0                     in a part `dead` of the pixels
    value = value + scale x       in a part `share` of them, x exponentially distributed with mean 1

A sensor has up to four such planes: the relative response [1], the offset [e-], the dark current in
excess of the common one [e- s-1], and the amplitude of telegraph noise [e-]. A value depends only
on seed, plane and place in the whole frame.
"""

from gpusim.backends import Device
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.kernels.common.philox_ref import chance_word, seed_words, signed
from gpusim.kernels.stage import Array, exact_case, is_opencl_cpu, stage

# the plane's number separates their random numbers
PLANES = ("response", "offset", "dark", "telegraph")


@stage
def pattern(
    device: Device,
    rows: int,
    cols: int,
    plane: str,
    *,
    mean: float = 0.0,
    pixel: float = 0.0,
    row: float = 0.0,
    column: float = 0.0,
    dead: float = 0.0,
    share: float = 0.0,
    scale: float = 0.0,
    seed: int = 0,
    first: tuple[int, int] = (0, 0),
    frame_cols: int | None = None,
) -> Array:
    """Return one plane of fixed values.

    Args:
        rows: Rows of the plane.
        cols: Columns of the plane.
        plane: "response" [1], "offset" [e-], "dark" [e- s-1] or "telegraph" [e-].
        mean: Mean of all pixels, in the plane's unit.
        pixel: Standard deviation from pixel to pixel, in the plane's unit.
        row: Standard deviation from row to row, in the plane's unit.
        column: Standard deviation from column to column, in the plane's unit.
        dead: Part of the pixels with the value 0 [1].
        share: Part of the pixels with an exponentially distributed addition [1].
        scale: Mean of that distribution, in the plane's unit.
        seed: Number of the chip, 0 to 2^64 - 1.
        first: Row and column in the frame at which the tile begins [pixel].
        frame_cols: Columns of the frame; None if the tile ends at its right edge.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Values, shape (rows, cols), float32.

    Raises:
        OutOfRange: `dead` or `share` is not 0 to 1, or `seed` is not 0 to 2^64 - 1.
        UnknownName: There is no such plane.

    Source:
        Farrell and Wandell, section 5.3; EMVA 1288 release 4 for the split into pixels, rows and
        columns.
    """
    if plane not in PLANES:
        raise UnknownName("plane", plane, PLANES)
    for name, value in (("dead", dead), ("share", share)):
        if not 0 <= value <= 1:
            raise OutOfRange(name, value, f"0 <= {name} <= 1")
    if not 0 <= seed < 2**64:
        raise OutOfRange("seed", seed, "0 <= seed < 2^64")
    width = 8 if is_opencl_cpu(device) else 1  # see lanes.clh
    frame_cols = frame_cols or first[1] + cols
    values = device.empty((rows, cols))
    device.launch(
        "sensor.pattern",
        "pattern",
        (rows, -(-cols // width)),
        values,
        *(rows, cols, *first, frame_cols, PLANES.index(plane)),
        *map(float, (mean, pixel, row, column)),
        *(int(dead > 0), signed(chance_word(dead))),
        *(int(share > 0), signed(chance_word(share))),
        float(scale),
        *map(signed, seed_words(seed)),
        defines={"WIDTH": width},
    )
    return values


def cases():
    """Yield cases: every plane with every part, tiles, odd sizes: bit for bit."""
    why = "both sides do the same correctly rounded float32 operations in the same order"
    parts = {
        "mean": 1.0,
        "pixel": 0.02,
        "row": 0.01,
        "column": 0.005,
        "dead": 0.05,
        "share": 0.1,
        "scale": 3.0,
        "seed": 2**63 + 5,
    }
    sizes = (1, 1, (0, 0), None), (3, 5, (0, 0), None), (63, 65, (7, 900), 70_000)
    for plane in PLANES:
        for rows, cols, first, frame_cols in sizes:
            tile = {"rows": rows, "cols": cols, "first": first, "frame_cols": frame_cols}
            yield exact_case(f"{plane} {rows}x{cols}", why, plane=plane, **parts, **tile)
    for name, own in (
        ("normal", {"pixel": 1.0}),
        ("dead", {"mean": 1.0, "dead": 1.0}),
        ("sparse", {"share": 1e-2, "scale": 10.0}),
        ("all", {"share": 1.0, "scale": 1.0}),
    ):
        yield exact_case(name, why, rows=33, cols=35, plane="dark", seed=3, **own)


def bench(rows, cols):
    """Return inputs: response of pixels, rows and columns with dead pixels."""
    parts = {"mean": 1.0, "pixel": 0.01, "row": 1e-3, "column": 1e-3, "dead": 1e-4}
    return {"rows": rows, "cols": cols, "plane": "response", **parts}
