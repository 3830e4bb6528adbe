"""Survey of a scene's spectra: mean squares of projections of samples and of differences.

Ports: content (entries, rows, cols) float32 or float16, or shading (rows, cols) float32 with ids
(rows, cols) uint16; table (P, entries) float32 -> (pairs of rows, 3, P + 1) float32, in squares of
the content's unit times the table's, times factors that keep them in float32's range.

Projection p of a sample with the entries c_e is v_p = sum over e of table[p, e] c_e. A sample with
an id has its shading as the entry of that number, and 0 in the others. For each pair of
neighbouring rows the result holds the means over

    0  the upper row:           v_p^2 and |c|^2
    1  its columns but one:     the same for the difference to the right neighbour; 0 for one column
    2  the upper row:           the same for the difference to the row below; 0 for the last row

with |c|^2 = sum over e of c_e^2 as number P, the last, c times the first factor and v times the
second. They are p^T M p and the trace of moments M = E[c c^T], from which `gpusim.optics.fusion`
predicts a plan's error, without the moments themselves. Differences are taken before projections;
otherwise rounding would lose them in a smooth picture.
"""

from functools import partial

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.memory import type_of
from gpusim.kernels.spectral.take import take
from gpusim.kernels.stage import Array, Case, stage

GROUPS = "spectral.survey_groups"
MOST = 16  # projections: three sums of each are a GPU's registers
THREADS = 128  # of a GPU's work-group, a column each: sums and table fill 34 KB of local memory
BLOCK = 4  # projections of a CPU's work-item: three sums of each, as vectors, are its registers


@stage
def survey(
    device: Device,
    content: Array,
    table: Array,
    first: Array,
    ids: Array | None = None,
    scale: tuple[float, float] = (1.0, 1.0),
) -> Array:
    """Return mean squares of projections and of their differences over pairs of rows.

    NaN stays NaN. Squares of values beyond 1.8e19 are infinite, squares of values below 1e-23 are
    0, after the scale; light of 1e23 needs a factor.

    Args:
        content: Samples of a cube or coefficients of a basis, shape (entries, rows, cols), float32
            or float16; with ids the shading, shape (rows, cols).
        table: Projections, finite, shape (P, entries), P at most 16.
        first: Upper rows, int32, shape (n,), clipped to the frame.
        ids: Entry of each pixel, uint16, shape (rows, cols), or None.
        scale: Factors of the content and of the projections, powers of two (others are rounded).
        device: A `Device`, or its name for `open_device`.

    Returns:
        Mean squares, shape (n, 3, P + 1), float32.

    Raises:
        BadData: Shapes do not fit.
        OutOfRange: There are no projections, or more than 16.
    """
    entries, rows, cols = check_inputs(content, table, first, ids)
    count, pairs = table.shape[0], first.shape[0]
    if ids is None and pairs and type_of(content) == np.float16:  # only the few rows of the pairs
        content, first, rows = _widen_rows(device, content, first)
    unit, of_table = map(float, scale)
    if of_table != 1:
        table = device.numpy(table) * np.float32(of_table)
    opencl = device.kind == "opencl"
    # Warp's loops are vectors along the projections: these must be adjacent
    if not (device.is_gpu or opencl):
        table = np.pad(np.transpose(device.numpy(table)), ((0, 0), (0, MOST - count)))
    content = device.array(content)
    table = device.array(table)
    first = device.array(first, np.int32)
    ids = None if ids is None else device.array(ids, np.uint16)
    out = device.empty((pairs, 3, count + 1))
    if not pairs:
        return out
    kernel = "mixed" if ids is None else "labelled"
    inputs = [*([] if ids is None else [ids]), content, table, first]
    if device.is_gpu:
        _by_groups(device, kernel, inputs, out, entries, rows, cols, unit)
        return out
    grid, group = ((pairs, -(-count // BLOCK) + 1), (1, 1)) if opencl else ((pairs,), None)
    sizes = [entries, rows, cols, count, unit]
    defines = {"WIDTH": 8, "BLOCK": BLOCK}
    device.launch(
        "spectral.survey", kernel, grid, *inputs, out, *sizes, defines=defines, group=group
    )
    return out


def _widen_rows(device, content, first):
    """Return the rows of the pairs as float32 content, their upper rows, and the number of rows."""
    upper = np.clip(device.numpy(first), 0, content.shape[1] - 1)
    rows = np.stack([upper, upper + 1], axis=1).reshape(1, -1)
    content = take(device.array(content, np.float16), rows, device=device)
    return device.reshape(content, content.shape[1:]), np.arange(0, rows.size, 2), rows.size


def _by_groups(device, kernel, inputs, out, entries, rows, cols, unit):
    """Reduce parts of rows by work-groups, then the parts of every row in their order."""
    pairs, _, sums = out.shape
    chunks = -(-cols // THREADS)
    parts = device.empty((pairs, chunks, 3 * sums))
    defines = {"PROJECTIONS": sums - 1, "THREADS": THREADS}
    launch = partial(device.launch, GROUPS, defines=defines, group=(THREADS,))
    grid, sizes = (pairs * chunks * THREADS,), [entries, rows, cols, chunks, unit]
    launch(f"{kernel}_groups", grid, *inputs, parts, *sizes)
    items = pairs * 3 * sums
    launch("finish", (-(-items // THREADS) * THREADS,), parts, out, items, chunks, cols)


def check_inputs(content, table, first, ids):
    """Return entries, rows and columns. Raise BadData or OutOfRange as `survey` does."""
    shape, wanted = tuple(content.shape), "(entries, rows, cols)" if ids is None else "(rows, cols)"
    if len(shape) != (3 if ids is None else 2) or 0 in shape:
        raise BadData(f"survey: content of shape {shape}; wanted {wanted}")
    if ids is not None and tuple(ids.shape) != shape:
        raise BadData(
            f"survey: ids of shape {tuple(ids.shape)} and shading {shape}; wanted one (rows, cols)"
        )
    if len(table.shape) != 2 or (ids is None and table.shape[1] != shape[0]):
        raise BadData(
            f"survey: a table of shape {tuple(table.shape)}; wanted (projections, "
            f"{shape[0] if ids is None else 'entries'})"
        )
    if not 1 <= table.shape[0] <= MOST:
        raise OutOfRange("projections", table.shape[0], f"1 .. {MOST}")
    if len(first.shape) != 1:
        raise BadData(f"survey: first rows of shape {tuple(first.shape)}; wanted (pairs,)")
    return table.shape[1], *shape[-2:]


def cases():
    """Yield cases.

    Odd sizes, all forms, rows beyond the frame, steep tables, small differences of large values,
    zeros, NaN.
    """
    random = np.random.default_rng(11)
    for rows, cols, entries, count in (
        (1, 1, 31, 3),
        (1, 9, 5, 1),
        (7, 1, 3, 16),
        (5, 2, 1, 5),
        (3, 8, 31, 12),
        (33, 65, 70, 7),
        (20, 300, 6, 4),
        (9, 1025, 130, 12),
    ):
        table = random.normal(0, 10.0 ** random.uniform(-4, 4, (count, 1)), (count, entries))
        first = random.integers(-2, rows + 2, 5)
        shape = f"{rows}x{cols}, {entries} entries, {count} projections"
        light = 10.0 ** random.uniform(-3, 5, (rows, cols))
        yield _case(f"cube {shape}", random.random((entries, rows, cols)) * light, table, first)
        basis = random.normal(0, 1, (entries, rows, cols)) * light
        yield _case(f"basis {shape}", basis, table, first)
        halves = random.normal(0, 1, (entries, rows, cols)).astype(np.float16)
        yield _case(f"float16 {shape}", halves, table, first)
        ids = random.integers(0, entries, (rows, cols)).astype(np.uint16)
        yield _case(f"materials {shape}", light, table, first, ids)
    table = random.normal(0, 1, (6, 31))
    smooth = 1000 + np.add.outer(random.random(31), 1e-3 * random.random((12, 200)))
    yield _case("small differences of large values", smooth, table, np.arange(11))
    ids = np.repeat(np.arange(4), 50)[None].repeat(12, 0).astype(np.uint16)
    yield _case("materials of smooth shading", smooth[0], table, np.arange(11), ids)
    yield _case("darkness", np.zeros((31, 4, 9)), table, np.arange(3))
    yield _case("no pairs", np.ones((31, 4, 9)), table, np.arange(0))
    content = random.random((31, 12, 40))
    content[3, 2, 39], content[30, 7, 0], content[5, 10, 10:12] = np.nan, np.nan, np.inf
    yield _case("NaN and infinity", content, table, np.arange(12))
    shading = content[3]
    shading[8, 20] = np.inf
    ids = random.integers(0, 31, shading.shape).astype(np.uint16)
    yield _case("materials with NaN and infinity", shading, table, np.arange(12), ids)
    light = 1e23 * random.random((31, 12, 40))
    yield _case("the sun", light, table, np.arange(12), scale=(2.0**-77, 2.0**-79))
    steep, scale = table * 2.0**20, (2.0**-77, 2.0**-97)
    yield _case("materials in the sun", light[3], steep, np.arange(12), ids, scale=scale)
    yield _case("faint light", light * 1e-60, table, np.arange(12), scale=(2.0**123, 2.0**121))


def _case(name, content, table, first, ids=None, scale=(1.0, 1.0)):
    """Return a case with its largest relative error by the bound in `why`."""
    content = content.astype(np.float16 if content.dtype == np.float16 else np.float32)
    table, unit = table.astype(np.float32), 2.0**-24
    inputs = {"content": content, "table": table, "first": first.astype(np.int32), "scale": scale}
    terms = content.shape[0] if ids is None else 2
    rows, cols = content.shape[-2:]
    tolerance = 0.0
    for y in np.clip(first, 0, rows - 1):
        upper, lower = (content[..., row, :].astype(float) for row in (y, min(y + 1, rows - 1)))
        if ids is not None:  # one-hot: an entry for each sample's id
            upper, lower = (
                np.where(ids[row] == np.arange(table.shape[1])[:, None], values, 0)
                for row, values in ((y, upper), (min(y + 1, rows - 1), lower))
            )
        with np.errstate(invalid="ignore"):
            for part in (upper, np.diff(upper), lower - upper):
                part = part[:, np.isfinite(part).all(0)]
                exact, rounding = table @ part, (terms + 2) * unit * (np.abs(table) @ np.abs(part))
                total = (exact**2).sum(1)
                worst = (rounding * (2 * np.abs(exact) + rounding)).sum(1)
                worst += (cols + 3) * unit * ((np.abs(exact) + rounding) ** 2).sum(1)
                tolerance = max(tolerance, (worst[total > 0] / total[total > 0]).max(initial=0.0))
    return Case(
        name,
        inputs if ids is None else inputs | {"ids": ids},
        1.01 * max(tolerance, (terms + cols + 5) * unit) if content.any() else 0.0,
        "a projection of n terms, each a weight times a difference, errs by at most (n + 2) 2^-24 times the "
        "sum of their magnitudes (Higham 2002, 3.1), which its square doubles; a mean of m squares adds m + 3 "
        "roundings, one of the squares of n entries n + m + 5; second orders are below 1 %",
        metric="local",
    )


def bench(rows, cols):
    """Return inputs.

    Twelve projections of a 31-band cube: only the 34 rows that a frame of 1080 reads.
    """
    random = np.random.default_rng(11)
    pairs = min(17, max(rows // 2, 1))
    return {
        "content": random.random((31, 2 * pairs, cols), np.float32),
        "table": random.normal(0, 1, (12, 31)).astype(np.float32),
        "first": 2 * np.arange(pairs, dtype=np.int32),
    }
