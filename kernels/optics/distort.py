"""Geometric resampling that conserves flux: distortion and lateral colour.

Ports: planes (planes, source_rows, source_cols) float32, grids (1 or planes, ny, nx, 3) float32 [,
light (channels, source_rows, source_cols) float32, cover (values, source_rows, source_cols) float32]
-> distorted (planes + values, rows, cols) float32 in the planes' unit (energy per area).

A grid divides the frame evenly. Its outermost nodes lie on the frame's edges, half a pixel beyond
the indices of the outermost pixels. Each node holds the offsets from a pixel's row and column to
its place among the source samples, and the flux factor J, source area over pixel area (physical
areas). Values between nodes are cubic Lagrange interpolants of the four nearest nodes. There are
two methods:

    "cubic"  J(p) times the Keys cubic interpolant of the source at the pixel's place. It is sharp. It
             conserves flux if the source is smooth on the scale of a pixel, and aliases beyond two
             source samples per pixel. The cubic's weights next to a bright sample are negative. With
             `light`, each sample is interpolated only in part, so much that the interpolant stays
             above 0 in every channel. The rest is spread by area, as bright as J says. A star in the
             dark then keeps its energy, and no value is below 0;
    "area"   the integral of the source, constant within each sample, over the quadrilateral that is
             imaged onto the pixel, times `density` (area of a source sample over area of a pixel). It
             is never negative. Neighbours share their corners, so every source sample's energy
             arrives exactly once.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage, warp_only

LANES_STAGE = "optics.distort_lanes"

TILE = 4, 64  # pixels of a work-group, whose samples overlap; as in distort_warp.py


@stage
def distort(
    device: Device,
    planes: Array,
    grids: Array,
    shape: tuple[int, int],
    border: str,
    method: str = "cubic",
    density: float = 1.0,
    light: Array | None = None,
    cover: Array | None = None,
    lit: tuple[slice, slice] | None = None,
    window: tuple[slice, slice] | None = None,
    share: Array | None = None,
) -> Array:
    """Resample every plane through the inverse mapping of `grids`.

    Args:
        planes: Energy per area, shape (planes, source_rows, source_cols).
        grids: Offsets [sample], [sample] and J [1] at the nodes, shape (1 or planes, ny, nx, 3), ny
            and nx at least 4.
        shape: Rows and columns of the result.
        border: "zero", "edge" or "reflect" (the outermost sample is repeated), for places outside
            the source.
        method: "cubic" or "area", see above.
        density: Area of a source sample over area of a pixel [1]; for the method "cubic" J contains
            it.
        light: The source in each channel, any unit, shape (channels, source_rows, source_cols), for
            the method "cubic" with up to two samples per pixel. Without it, results may be
            negative.
        cover: With `light`: coverage of the samples by a layer [1], which multiplies the planes, and
            values that are multiplied by it already, shape (values, source_rows, source_cols). They
            are placed with all planes by the first grid, without J, and go on at the edge of a dark
            world. They follow the planes in the result.
        lit: With `cover`: rows and columns of the source outside of which it is 0.
        window: With `cover`: rows and columns of the result outside of which nothing is covered.
        share: `shares` of the light, in its place: they are the same for all grids.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The resampled planes, shape (planes, rows, cols), float32.

    Raises:
        ValueError: The method is neither "cubic" nor "area".

    Source:
        Keys, IEEE Trans. ASSP 29 (1981), for the cubic. The area method is the drizzle of Fruchter
        and Hook, PASP 114 (2002), at full pixel size, read backwards.
    """
    count, source_rows, source_cols = planes.shape
    span = _span(np.asarray(device.numpy(grids)), shape) if method == "area" else 0
    planes, grids = device.array(planes), device.array(grids)
    maps, ny, nx, _ = grids.shape
    out = device.empty((count, *shape))
    if method not in ("cubic", "area"):
        raise ValueError(f'method {method!r}: "cubic" or "area"')
    per_map = count // maps
    lines = device.empty((maps, 2 * shape[0] + 1, 3 * nx))
    defines = {"PLANES": per_map, "BORDER": BORDERS[border]}
    launch = functools.partial(device.launch, "optics.distort", defines=defines)
    nodes = device.reshape(grids, (maps, ny, 3 * nx))
    launch("along_columns", lines.shape, nodes, lines, maps, ny, 3 * nx, shape[0])
    grid, sizes = (maps, *shape), (source_rows, source_cols, nx, maps, *shape)
    if method == "area":
        numbers = (float(density), *warp_only(device, span, BORDERS[border], per_map))
        own_defines = {**defines, "SPAN": span}
        launch("area", grid, planes, lines, out, *numbers, *sizes, defines=own_defines)
        return out
    numbers = warp_only(device, BORDERS[border], per_map)
    if light is None and share is None:
        launch("cubic", _tiles(device, grid), planes, lines, out, *numbers, *sizes)
        return out
    values = 0
    if cover is not None:
        cover = device.array(cover)
        values = cover.shape[0]
        out = device.empty((count + values, *shape))
        if _corner(window, shape)[1] != tuple(shape):
            launch("clear", out.shape, out, *out.shape)
    share = shares(device, light, border, lit) if share is None else device.array(share)
    (top, left), size = _corner(window, shape)
    if is_opencl_cpu(device) and not values:
        inputs = planes, lines, share, out, top, left
        rows_ = maps, size[0], 1
        device.launch(
            LANES_STAGE,
            "limited",
            rows_,
            *inputs,
            *sizes,
            size[1],
            defines=defines,
            group=(1, 1, 1),
        )
        return out
    launch(
        "limited",
        _tiles(device, (maps, *size)),
        *(planes, lines, share, planes if cover is None else cover, out, top, left),
        *numbers,
        *warp_only(device, values),
        *sizes,
        *size,
        defines={**defines, "COVERS": values} if values else defines,
    )
    return out


def _tiles(device, grid):
    """Return the grid of kernels whose groups take tiles: Warp has groups along one axis only."""
    if device.kind != "warp":
        return grid
    maps, rows, cols = grid
    return maps * -(-rows // TILE[0]), -(-cols // TILE[1]), *TILE


def _corner(window, shape):
    """Return the first place (row, column) of a window, and its size; None: the whole shape."""
    if window is None:
        return (0, 0), tuple(shape)
    spans = [range(n)[part] for part, n in zip(window, shape, strict=True)]
    return tuple(span.start for span in spans), tuple(len(span) for span in spans)


def shares(
    device: Device, light: Array, border: str, lit: tuple[slice, slice] | None = None
) -> Array:
    """Return the part of every sample that cubics may interpolate, (rows, cols); 1 outside of the window `lit`.

    Args:
        device: The device.
        light: As for `distort`.
        border: As for `distort`.
        lit: As for `distort`.
    """
    if device.kind == "numpy":
        from gpusim.kernels.optics.distort_ref import share_samples

        return share_samples(light, border)
    light = device.array(light)
    channels, rows, cols = light.shape
    around = extend(device, light, border, (3, 3), (rows + 6, cols + 6))
    room = device.empty((rows + 3, cols + 3))
    share = device.empty((rows, cols))
    first, (high, wide) = _corner(lit, (rows, cols))
    launch = functools.partial(device.launch, "optics.distort", defines={"PLANES": 1, "BORDER": 0})
    cells = high + 3, wide + 3
    launch("rooms", cells, around, room, *first, channels, *room.shape, *cells)
    launch("shares", share.shape, room, share, *first, rows, cols, high, wide)
    return share


def _span(grids, shape):
    """Return the most source samples that a pixel's quadrilateral touches along an axis."""
    slopes = []
    for axis, n in enumerate(shape, start=1):
        most = np.abs(np.diff(grids[..., :2], axis=axis)).max(axis=(0, 1, 2))
        slopes.append(most * (grids.shape[axis] - 1) / n)
    # a quadrilateral is at most 1 + |d/dy| + |d/dx| long; slopes are a quarter above the mean
    return int(np.ceil(1 + 1.25 * float(max(slopes[0] + slopes[1])))) + 1


def grid_of(shape, step, place):
    """Return the grid (ny, nx, 3) of an analytic mapping, for cases.

    place: function of (rows, cols) to (rows, cols, flux factor).
    """
    rows, cols = (np.linspace(0, n, max(4, n // step + 1)) - 0.5 for n in shape)
    y, x, flux = place(*np.meshgrid(rows, cols, indexing="ij"))
    return np.stack([y - rows[:, None], x - cols, flux * np.ones_like(x)], axis=-1).astype(
        np.float32
    )


def _barrel(shape, strength, turn=0.0):
    """Return a barrel mapping of this relative strength at the corner, turned by `turn` [rad]."""
    middle, corner2 = (np.array(shape) - 1) / 2, (np.hypot(*shape) / 2) ** 2

    def place(rows, cols):
        v, u = rows - middle[0], cols - middle[1]
        q = (u * u + v * v) * (strength / corner2)
        cos, sin = np.cos(turn), np.sin(turn)
        y, x = (1 + q) * (cos * v + sin * u), (1 + q) * (cos * u - sin * v)
        return y + middle[0], x + middle[1], (1 + q) * (1 + 3 * q)

    return place


def _barrels(shape, step, strength, turn, maps):
    """Return grids of maps that differ a little, as colours do."""
    places = [_barrel(shape, strength * (1 + 0.05 * m), turn) for m in range(maps)]
    return np.stack([grid_of(shape, step, place) for place in places])


def cases():
    """Yield cases.

    Both methods and all borders: barrel, pincushion, turned, minified three times, own grids, one
    pixel; stars.
    """
    random = np.random.default_rng(8)
    for rows, cols, maps, strength, turn, border in (
        (1, 1, 1, 0.0, 0.0, "zero"),
        (3, 5, 1, 0.05, 0.0, "edge"),
        (63, 65, 3, 0.1, 0.0, "zero"),
        (40, 200, 1, -0.1, 0.3, "reflect"),
        (63, 65, 1, 0.1, 0.8, "edge"),
        # neighbours show neighbouring samples, but for some that are shown twice or left out
        (24, 203, 1, -0.06, 0.002, "edge"),
        (24, 203, 1, 0.06, 0.002, "zero"),
    ):
        grids = _barrels((rows, cols), 16, strength, turn, maps)
        planes = random.random((3, rows, cols)) ** 8  # 12 : 1 and more between neighbours
        planes[:, rows // 3 :, cols // 2 :] += 1
        planes[:, : rows // 3] *= random.random((rows // 3, cols)) > 0.9
        planes = planes.astype(np.float32)
        sampling = {"grids": grids, "shape": (rows, cols), "border": border}
        far = float(np.abs(grids[..., :2]).max())
        yield Case(
            f"stars, {rows}x{cols}, {maps} maps, {strength:+.2f}, {border}",
            {"planes": planes, "light": planes[:2], **sampling},
            4e-6 + 4e-7 * far * 4,
            "as below; shares are twice quotients that round by 5e-7, areas round as places do: 2e-6 more",
        )
        share = np.clip(random.uniform(0, 2, (rows, cols)), 0, 1).astype(np.float32)
        yield Case(
            f"shares, {rows}x{cols}, {maps} maps, {strength:+.2f}, {border}",
            {"planes": planes, "share": share, **sampling},
            4e-6 + 4e-7 * far * 4,
            "as above",
        )
        part = np.s_[rows // 4 : rows - rows // 4, cols // 5 : cols - cols // 8]
        cover = np.zeros((2, rows, cols), np.float32)
        cover[0][part] = random.random((rows, cols))[part] ** 2
        cover[1] = cover[0] * random.uniform(0, 5, (rows, cols))
        near = [slice(max(s.start - int(far) - 3, 0), s.stop + int(far) + 3) for s in part]
        yield Case(
            f"a layer, {rows}x{cols}, {maps} maps, {strength:+.2f}, {border}",
            {
                **{"planes": planes, "light": planes[:2], "cover": cover, **sampling},
                **{"lit": part, "window": tuple(near)},
            },
            5 * (4e-6 + 4e-7 * far * 4),
            "as above, relative to the light; values of a layer are up to five times as large",
        )
    for rows, cols, planes, maps, strength, turn, step, border, method in (
        (1, 1, 1, 1, 0.0, 0.0, 4, "edge", "cubic"),
        (3, 5, 2, 1, 0.05, 0.0, 4, "zero", "area"),
        (63, 65, 3, 3, 0.1, 0.0, 16, "reflect", "cubic"),
        (63, 65, 3, 3, -0.1, 0.0, 16, "edge", "area"),
        (40, 200, 4, 1, 0.2, 0.3, 8, "zero", "area"),
        (40, 200, 4, 1, 0.2, 0.3, 8, "reflect", "cubic"),
        (33, 47, 1, 1, 0.7, 0.1, 8, "edge", "area"),
    ):
        grids = _barrels((rows, cols), step, strength, turn, maps)
        sampling = {"grids": grids, "shape": (rows, cols), "border": border, "method": method}
        far = float(np.abs(grids[..., :2]).max())
        yield Case(
            f"{method}, {rows}x{cols}, {planes} planes, {strength:+.2f}, {border}",
            {"planes": random.random((planes, rows, cols)).astype(np.float32), **sampling},
            2e-6 + 4e-7 * far * 4,
            f"16 products of differences up to {far:.2g} samples, each rounded by 6e-8, sum to 4e-7 of that at "
            "most; the largest change per sample of a white plane is 2 in each of two directions; 2e-6 for the "
            "weights themselves",
        )


def bench(rows, cols):
    """Return inputs: three planes with lateral colour, 5 % barrel."""
    random = np.random.default_rng(8)
    grids = [
        grid_of((rows, cols), 32, _barrel((rows, cols), 0.05 * (1 + 0.01 * m))) for m in range(3)
    ]
    return {
        "planes": random.random((3, rows, cols), np.float32),
        "grids": np.stack(grids),
        "shape": (rows, cols),
        "border": "edge",
    }
