"""Flux-conserving resampling, float64: J times the cubic interpolant, or clipped quadrilaterals."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def _lagrange(grid, shape, rows, cols):
    """Return grid values at the pixel indices rows x cols of a frame of `shape`."""

    def matrix(indices, length, count):
        t = (indices + 0.5) * (count - 1) / length
        first = np.clip(np.floor(t) - 1, 0, count - 4).astype(int)
        nodes = np.arange(4)
        weights = np.zeros((len(indices), count))
        for a in range(4):
            others = np.delete(nodes, a)
            weights[np.arange(len(indices)), first + a] = np.prod(
                t[:, None] - first[:, None] - others, axis=1
            ) / np.prod(nodes[a] - others)
        return weights

    return np.einsum(
        "yi,xj,ijk->kyx",
        matrix(rows, shape[0], grid.shape[0]),
        matrix(cols, shape[1], grid.shape[1]),
        np.asarray(grid, np.float64),
        optimize=True,
    )


def _keys(t):
    """Return the interpolation kernel of Keys, a = -1/2."""
    t = np.abs(t)
    return np.where(
        t <= 1,
        (1.5 * t - 2.5) * t * t + 1,
        np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0.0),
    )


def _cubic(planes, grid, shape, border):
    rows, cols = np.arange(shape[0]), np.arange(shape[1])
    v, u, flux = _lagrange(grid, shape, rows, cols)
    v, u = v + rows[:, None], u + cols
    first_y, first_x = np.floor(v).astype(int) - 1, np.floor(u).astype(int) - 1
    padded, top, left = _pad(planes, border, first_y, first_x, 4)
    total = np.zeros((len(planes), *shape))
    for a in range(4):
        for b in range(4):
            y, x = first_y + a, first_x + b
            total += _keys(v - y) * _keys(u - x) * padded[:, y + top, x + left]
    return flux * total


def _pad(planes, border, first_y, first_x, size):
    """Return planes with the surroundings that the indices need, and the offsets to them."""
    pads = [
        (max(0, -int(first.min())), max(0, int(first.max()) + size - n))
        for first, n in ((first_y, planes.shape[1]), (first_x, planes.shape[2]))
    ]
    padded = np.pad(np.asarray(planes, np.float64), [(0, 0), *pads], mode=MODES[border])
    return padded, pads[0][0], pads[1][0]


def _clip(polygons, axis, low):
    """Return the part of each polygon (..., vertices, 2) with coordinate `axis` >= low.

    A negative axis means <= -low. Crossings of the line are inserted, and vertices beyond it are
    projected onto it, which encloses no area.
    """
    sign, axis = (-1, ~axis) if axis < 0 else (1, axis)
    p, q = polygons, np.roll(polygons, -1, axis=-2)
    dp, dq = (sign * (side[..., axis] - low[..., None]) for side in (p, q))
    crosses = (dp < 0) != (dq < 0)
    t = np.divide(dp, dp - dq, out=np.zeros_like(dp), where=crosses)[..., None]
    # t = 0 repeats p
    points = np.stack([p, p + t * (q - p)], axis=-2).reshape(*p.shape[:-2], -1, 2)
    limit = sign * low[..., None]
    points[..., axis] = sign * np.maximum(sign * points[..., axis], limit)
    return points


def _quads(grid, shape):
    """Return the corners of every pixel, (rows, cols, 4, 2); sample i covers i to i + 1."""
    rows, cols = np.arange(shape[0] + 1) - 0.5, np.arange(shape[1] + 1) - 0.5
    v, u, _ = _lagrange(grid, shape, rows, cols)
    corners = np.stack([v + rows[:, None], u + cols], axis=-1) + 0.5  # sample i covers i .. i + 1
    return np.stack(
        [corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=-2
    )


def _area(planes, grid, shape, border, density):
    quads = _quads(grid, shape)
    first = np.floor(quads.min(axis=-2)).astype(int)
    size = int((np.ceil(quads.max(axis=-2)) - first).max())
    padded, top, left = _pad(planes, border, first[..., 0], first[..., 1], size)
    total = np.zeros((len(planes), *shape))
    for a in range(size):
        y = first[..., 0] + a
        strip = _clip(_clip(quads, 0, y), ~0, y + 1)
        for b in range(size):
            x = first[..., 1] + b
            part = _clip(_clip(strip, 1, x), ~1, x + 1) - np.stack([y, x], axis=-1)[..., None, :]
            after = np.roll(part, -1, axis=-2)
            overlap = (
                np.abs(np.sum(part[..., 0] * after[..., 1] - part[..., 1] * after[..., 0], axis=-1))
                / 2
            )
            total += overlap * padded[:, y + top, x + left]
    return density * total


def share_samples(light, border):
    """Return the part of every sample that cubics may interpolate in all channels."""
    rows, cols = light.shape[1:]
    room = 1.0
    weights = _keys(np.subtract.outer([0.3, 0.5, 0.7], [-1, 0, 1, 2]))
    for plane in np.pad(
        np.asarray(light, np.float64), [(0, 0), (3, 3), (3, 3)], mode=MODES[border]
    ):
        # of every cell
        near = np.lib.stride_tricks.sliding_window_view(np.maximum(plane, 0), (4, 4))
        parts = np.einsum("vi,uj,yxij->yxvuij", weights, weights, near)
        above, below = (np.clip(sign * parts, 0, None).sum(axis=(4, 5)) for sign in (1, -1))
        ratio = np.divide(above, below, where=below > above, out=np.ones_like(above)).min(
            axis=(2, 3)
        )
        room = np.minimum(room, np.clip(2 * ratio - 1, 0, 1))
    # cells with negative weights
    around = ((0, 1), (0, 2), (3, 1), (3, 2), (1, 0), (2, 0), (1, 3), (2, 3))
    return np.min([room[y : y + rows, x : x + cols] for y, x in around], axis=0)


def _as_bright_as_j(grid, shape):
    """Return J over the area of each pixel's quadrilateral, (rows, cols)."""
    quads, flux = _quads(grid, shape), _lagrange(grid, shape, *map(np.arange, shape))[2]
    after = np.roll(quads, -1, axis=-2)
    doubled = np.sum(quads[..., 0] * after[..., 1] - quads[..., 1] * after[..., 0], axis=-1)
    return 2 * flux / np.abs(doubled)


def distort(
    planes,
    grids,
    shape,
    border,
    method="cubic",
    density=1.0,
    light=None,
    cover=None,
    lit=None,
    window=None,
    share=None,
):
    """Return the stage's result, see `distort.py`; `lit` does not change it."""
    if share is None:
        share = (
            1.0 if light is None or method == "area" else share_samples(np.asarray(light), border)
        )
    if cover is not None:
        planes = np.asarray(planes, np.float64) * cover[0]
    planes = np.split(np.asarray(planes), len(grids))
    parts = [(own, grid, border) for own, grid in zip(planes, grids, strict=True)]
    if cover is not None:  # without J, and beyond a dark border
        even = np.concatenate([grids[0][..., :2], np.ones_like(grids[0][..., 2:])], axis=-1)
        parts.append((np.asarray(cover), even, "edge" if border == "zero" else border))
    out = []
    for own, grid, beyond in parts:
        if method == "area":
            out.append(_area(own, grid, shape, beyond, density))
            continue
        out.append(_cubic(own * share, grid, shape, beyond))
        if np.any(share != 1):
            spread = _area(own * (1 - share), grid, shape, beyond, 1.0)
            out[-1] += spread * _as_bright_as_j(grid, shape)
    found = np.concatenate(out)
    if window is not None:
        inside = np.zeros(shape, bool)
        inside[window] = True
        found *= inside
    return found
