"""One value per thread. Lanes are neighbours in memory, and all have the same matrix row."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def product(
    # in:
    given: wp.array3d[float],
    values: wp.array4d[float],
    start: wp.array2d[int],
    count: wp.array2d[int],
    # out:
    out: wp.array3d[float],
    # params:
    is_added: int,
    is_turned: int,
    # sizes:
    lines: int,
    lanes: int,
    size: int,
    rows: int,
    blocks: int,
    most: int,
    matrices: int,
    sums: int,
):
    line, lane = wp.tid()
    row = line % rows
    batch = line / rows
    total = float(0.0)
    for part in range(sums):
        place = batch * sums + part
        matrix = place % matrices
        first = start[matrix, row]
        for entry in range(count[matrix, row]):
            total += values[matrix, row, entry, 0] * given[place, first + entry, lane]
    y = row
    x = lane
    if is_turned != 0:
        y = lane
        x = row
    if is_added != 0:
        total += out[batch, y, x]
    out[batch, y, x] = total


@wp.kernel
def combine(
    # in:
    planes: wp.array3d[float],
    weights: wp.array3d[float],
    # out:
    out: wp.array3d[float],
    # params:
    each: int,
    # sizes:
    places: int,
    size: int,
    count: int,
    sigmas: int,
):
    group, at = wp.tid()
    lanes = planes.shape[2]
    y = at / lanes
    x = at % lanes
    for place in range(group * each, wp.min((group + 1) * each, places)):
        total = float(0.0)
        for plane in range(count):
            total += weights[place / sigmas, plane, place % sigmas] * planes[plane, y, x]
        out[place, y, x] = total


@wp.kernel
def refine(
    # in:
    onto: wp.array3d[float],
    lines: wp.array[float],
    values: wp.array2d[float],
    start: wp.array2d[int],
    # out:
    out: wp.array3d[float],
    # sizes:
    rows: int,
    cols: int,
    splines: int,
    phases: int,
):
    plane, y, x = wp.tid()
    first = (plane * rows + y) * splines + start[y % phases, x]
    total = float(0.0)
    for entry in range(4):
        total += values[entry, x] * lines[first + entry]
    out[plane, y, x] = onto[plane, y, x] + total
