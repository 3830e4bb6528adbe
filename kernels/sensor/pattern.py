"""Fixed patterns of one chip: what is the same in every frame, the same bits on every device.

Port: -> values (rows, cols) float32. With z standard normal numbers of the pixel, its row and its column:

    value = mean + pixel z + row z(row) + column z(column)
    value = 0                     in a part `dead` of the pixels
    value = value + scale x       in a part `share` of them, x exponentially distributed with mean 1

A sensor has up to four such planes: the relative response [1], the offset [e-], the dark current beyond the common one
[e- s-1] and the amplitude of telegraph noise [e-]. All of it depends on (seed, plane, place in the whole frame) alone.
"""

from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.kernels.common.philox_ref import chance_word, seed_words, signed
from gpusim.kernels.stage import Case, stage

PLANES = (
    "response",
    "offset",
    "dark",
    "telegraph",
)  # number of the plane: what keeps their random numbers apart


@stage
def pattern(
    device,
    rows,
    cols,
    plane,
    *,
    mean=0.0,
    pixel=0.0,
    row=0.0,
    column=0.0,
    dead=0.0,
    share=0.0,
    scale=0.0,
    seed=0,
    first=(0, 0),
    frame_cols=None,
):
    """One plane of fixed values.

    rows, cols: shape. plane: "response", "offset", "dark" or "telegraph". mean: of all pixels. pixel, row, column:
    standard deviations. dead, share: parts of the pixels [1]. scale: mean of the exponential distribution.
    seed: names the chip, 0 to 2^64 - 1. first: row and column of the tile in a frame that is frame_cols wide.
    Returns shape (rows, cols). Raises OutOfRange, UnknownName. Source: Farrell & Wandell, section 5.3; EMVA 1288
    release 4 for the split into pixels, rows and columns.
    """
    if plane not in PLANES:
        raise UnknownName("plane", plane, PLANES)
    for name, value in (("dead", dead), ("share", share)):
        if not 0 <= value <= 1:
            raise OutOfRange(name, value, f"0 <= {name} <= 1")
    if not 0 <= seed < 2**64:
        raise OutOfRange("seed", seed, "0 <= seed < 2^64")
    width = 8 if device.kind == "opencl" and not device.is_gpu else 1  # see lanes.clh
    frame_cols = frame_cols or first[1] + cols
    values = device.empty((rows, cols))
    device.launch(
        "sensor.pattern",
        "pattern",
        (rows, -(-cols // width)),
        values,
        rows,
        cols,
        *first,
        frame_cols,
        PLANES.index(plane),
        float(mean),
        float(pixel),
        float(row),
        float(column),
        int(dead > 0),
        signed(chance_word(dead)),
        int(share > 0),
        signed(chance_word(share)),
        float(scale),
        *map(signed, seed_words(seed)),
        defines={"WIDTH": width},
    )
    return values


def cases():
    """Every plane with every part, tiles, odd sizes: bit for bit."""
    why = "both sides do the same correctly rounded float32 operations in the same order"
    parts = {
        "mean": 1.0,
        "pixel": 0.02,
        "row": 0.01,
        "column": 0.005,
        "dead": 0.05,
        "share": 0.1,
        "scale": 3.0,
    }
    for plane in PLANES:
        for rows, cols, first, frame_cols in (
            (1, 1, (0, 0), None),
            (3, 5, (0, 0), None),
            (63, 65, (7, 900), 70_000),
        ):
            yield Case(
                f"{plane} {rows}x{cols}",
                {
                    "rows": rows,
                    "cols": cols,
                    "plane": plane,
                    **parts,
                    "seed": 2**63 + 5,
                    "first": first,
                    "frame_cols": frame_cols,
                },
                0.0,
                why,
                metric="exact",
            )
    for name, own in (
        ("normal", {"pixel": 1.0}),
        ("dead", {"mean": 1.0, "dead": 1.0}),
        ("sparse", {"share": 1e-2, "scale": 10.0}),
        ("all", {"share": 1.0, "scale": 1.0}),
    ):
        yield Case(
            name,
            {"rows": 33, "cols": 35, "plane": "dark", "seed": 3, **own},
            0.0,
            why,
            metric="exact",
        )


def bench(rows, cols):
    """Response of pixels, rows and columns with dead pixels."""
    return {
        "rows": rows,
        "cols": cols,
        "plane": "response",
        "mean": 1.0,
        "pixel": 0.01,
        "row": 1e-3,
        "column": 1e-3,
        "dead": 1e-4,
    }
