"""Windows of a scene's samples as float32, gathered on the device, for the host to read.

Ports: content (entries, rows, cols) float32, float16 or uint16, rows (n, h) int32, cols (n, w)
int32 -> (n, entries, h, w) float32, or uint16 for uint16. One plane (rows, cols), a shading or
numbers of materials, gives (n, h, w). Values are copied exactly: every float16 is a float32,
denormals and infinities included; NaN stays NaN.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.domain.memory import type_of
from gpusim.kernels.stage import Array, exact_case, stage, warp_only

KERNELS = {
    np.dtype(np.float32): "take",
    np.dtype(np.float16): "take_half",
    np.dtype(np.uint16): "take_numbers",
}


@stage
def take(
    device: Device, content: Array, rows: Array | None = None, cols: Array | None = None
) -> Array:
    """Gather samples at crossings: out[k, e, i, j] = content[e, rows[k, i], cols[k, j]].

    Args:
        content: Samples, shape (entries, rows, cols) or (rows, cols), float32, float16 (it is
            widened) or uint16.
        rows: Rows of each window, int32, shape (n, h), in any order, clipped to the frame; None for
            all rows.
        cols: Columns of each window, int32, shape (n, w), in any order, clipped to the frame; None
            for all columns. If both are None, there is one window.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Samples, shape (n, entries, h, w), or (n, h, w), float32 or uint16.

    Raises:
        BadData: A type or a shape does not fit.
    """
    dtype, (*entries, height, width), (count, lines, across) = check_inputs(content, rows, cols)
    planes = entries[0] if entries else 1
    out = device.empty(
        (count, planes, lines, across), np.uint16 if dtype == np.uint16 else np.float32
    )
    if 0 not in out.shape:
        whole = cols is None
        rows = device.array(
            np.tile(np.arange(height), (count, 1)) if rows is None else rows, np.int32
        )
        # not read if columns are in their order
        cols = rows if whole else device.array(cols, np.int32)
        content = device.reshape(device.array(content, dtype), (planes, height, width))
        # Whole rows are a separate build on OpenCL: PoCL does not vectorise a look-up of columns.
        arrays = [content, rows, cols, out]
        defines = {"WHOLE_ROWS": int(whole)}
        numbers = [planes, height, width, count * lines, lines, across]
        sizes = [*warp_only(device, int(whole))]
        grid = (planes, count * lines, across)
        device.launch(
            "spectral.take", KERNELS[dtype], grid, *arrays, *numbers, *sizes, defines=defines
        )
    return out if entries else device.reshape(out, (count, lines, across))


def check_inputs(content, rows, cols):
    """Return the type to read, the content's shape, and (n, h, w). Raise BadData as `take` does."""
    shape = tuple(content.shape)
    if len(shape) not in (2, 3) or 0 in shape:
        raise BadData(
            f"take: content of shape {shape}; wanted (entries, rows, cols) or (rows, cols), none of them 0"
        )
    kind = type_of(content)
    if kind is None or (kind.kind in "iub" and kind.type is not np.uint16):
        raise BadData(
            f"take: content of type {kind or content.dtype}; wanted float32, float16 or uint16"
        )
    of_rows, of_cols = ((*given.shape,) if given is not None else None for given in (rows, cols))
    of_rows = of_rows or ((of_cols or (1,))[0], shape[-2])
    of_cols = of_cols or (of_rows[0], shape[-1])
    if len(of_rows) != 2 or len(of_cols) != 2 or of_rows[0] != of_cols[0]:
        raise BadData(
            f"take: rows of shape {of_rows} and columns of shape {of_cols}; wanted (n, h) and (n, w) with "
            "the same n"
        )
    kept = kind.type in (np.float16, np.uint16)
    return np.dtype(kind.type if kept else np.float32), shape, (*of_rows, of_cols[1])


def cases():
    """Yield cases.

    Every float16 and uint16 there is, NaN and infinities, odd sizes, samples beyond the frame and
    twice, none.
    """
    random, why = np.random.default_rng(5), "values are copied, and every float16 is a float32"
    numbers = np.arange(2**16, dtype=np.uint16)
    every = numbers.view(np.float16)
    wild = np.array([np.nan, np.inf, -np.inf, -0.0, 1e-45, 3.4e38], np.float32)

    def case(name, content, rows=None, cols=None):
        return exact_case(name, why, content=content, rows=rows, cols=cols)

    backwards = np.arange(256, dtype=np.int32)[None, ::-1]
    kinds = {"float16": every.reshape(4, 64, 256), "number": numbers.reshape(256, 256)}
    for name, values in kinds.items():
        yield case(f"every {name}", values)
        yield case(f"every {name} by columns", values, cols=backwards)
    chosen = (np.array([some], np.int32) for some in ([0, 1], [2, 1, 0, 9]))
    yield case("NaN and infinities", wild.reshape(1, 2, 3), *chosen)
    for entries, rows, cols, windows in (
        (1, 1, 1, (1, 1, 1)),
        (3, 5, 9, (2, 4, 3)),
        (31, 33, 65, (3, 7, 129)),
        (2, 7, 129, (1, 1, 300)),
        (2, 3, 4, (0, 5, 6)),
        (2, 3, 4, (3, 0, 6)),
        (70, 9, 8, (12, 5, 1)),
    ):
        values = random.normal(0, 1, (entries, rows, cols))
        count, height, width = windows  # indices beyond the frame on both sides
        chosen = (
            random.integers(-3, rows + 3, (count, height), np.int32),
            random.integers(-3, cols + 3, (count, width), np.int32),
        )
        name = f"of {entries}x{rows}x{cols}, {count} windows {height}x{width}"
        for dtype in (np.float32, np.float16):
            yield case(f"{dtype.__name__} {name}", values.astype(dtype), *chosen)
        yield case(f"whole rows {name}", values.astype(np.float16), chosen[0])
        yield case(f"shading {name}", values[0].astype(np.float32), *chosen)
        numbers = random.integers(0, 2**16, (rows, cols), np.uint16)
        yield case(f"numbers {name}", numbers, *chosen)
        numbers = random.integers(0, 2**16, (rows, cols), np.uint16)
        yield case(f"whole rows of numbers {name}", numbers, chosen[0])


def bench(rows, cols):
    """Return inputs.

    Twelve windows of 64 x 64 from a 31-band cube without other samples: all is read.
    """
    chosen = np.arange(12 * 64, dtype=np.int32).reshape(12, 64)
    content = np.random.default_rng(5).random((31, 64, 12 * 64), np.float32)
    return {"content": content, "rows": chosen % 64, "cols": chosen}
