"""Resampling of a picture at other places in every plane: distortion and lateral colour undone.

Ports: planes (planes, rows, cols) float32, nodes (1 or planes, 2, ny, nx) float32 ->
(planes, rows, cols) float32, in the planes' unit.

Unlike `optics.distort`, which places light and conserves its energy, this stage looks values up: a
flat field stays flat.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only


@stage
def rectify(device: Device, planes: Array, nodes: Array) -> Array:
    """Return planes whose pixels are the cubic interpolants of the given ones at the places of `nodes`.

    Nodes divide the frame evenly, the outermost lie on its edges, half a pixel beyond the indices of
    the outermost pixels. Between them offsets are bilinear. Beyond the frame its edges are repeated.

    Args:
        planes: Values, shape (planes, rows, cols).
        nodes: Offsets from a pixel's row and column to the place that it shows [pixel], one map for
            all planes or one for each, shape (1 or planes, 2, ny, nx), ny and nx at least 2.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The resampled planes, shape (planes, rows, cols), float32.

    Raises:
        BadData: An array has the wrong shape.

    Source:
        Keys 1981, IEEE Trans. ASSP 29, 1153-1160, for the cubic (a = -1/2).
    """
    shapes = tuple(planes.shape), tuple(nodes.shape)
    is_right = (
        len(shapes[0]) == 3 and len(shapes[1]) == 4 and nodes.shape[0] in (1, planes.shape[0])
    )
    if not is_right or shapes[1][1] != 2 or min(shapes[1][2:]) < 2:
        raise BadData(
            f"rectify: planes {shapes[0]}, nodes {shapes[1]}; wanted (planes, rows, cols) and "
            "(1 or planes, 2, ny, nx), ny and nx at least 2"
        )
    count, rows, cols = planes.shape
    maps, _, ny, nx = nodes.shape
    out, of_map = device.empty((count, rows, cols)), count // maps
    nodes = device.reshape(device.array(nodes), (2 * maps, ny, nx))
    arrays = device.array(planes), nodes, out
    sizes = rows, cols, ny, nx, *warp_only(device, of_map)
    grid, defines = (maps, rows, cols), {"PLANES": of_map}
    device.launch("processor.rectify", "rectify", grid, *arrays, *sizes, defines=defines)
    return out


def nodes_of(shape: tuple[int, int], step: int, place) -> np.ndarray:
    """Return nodes, (2, ny, nx) float32, of an analytic mapping.

    Args:
        shape: Rows and columns of the frame.
        step: Distance of nodes [pixel], about.
        place: Function of rows and columns to the rows and columns that they show.
    """
    rows, cols = (np.linspace(0, n, max(2, -(-n // step) + 1)) - 0.5 for n in shape)
    y, x = np.meshgrid(rows, cols, indexing="ij")
    return np.subtract(place(y, x), (y, x)).astype(np.float32)


def _barrel(shape, strength):
    """Return a barrel mapping of this relative strength at the corner."""
    middle, corner2 = (np.array(shape) - 1) / 2, (np.hypot(*shape) / 2) ** 2

    def place(rows, cols):
        v, u = rows - middle[0], cols - middle[1]
        factor = 1 + (u * u + v * v) * (strength / corner2)
        return factor * v + middle[0], factor * u + middle[1]

    return place


def cases():
    """Yield cases: barrel and pincushion, one map and one for each plane, one pixel, nothing moved, NaN."""
    random = np.random.default_rng(8)
    for rows, cols, planes, maps, strength in (
        (1, 1, 1, 1, 0.0),
        (63, 65, 3, 3, -0.1),
        (3, 5, 2, 1, 0.1),
        (40, 200, 4, 1, 0.2),
        (33, 129, 4, 4, -0.3),
    ):
        places = [_barrel((rows, cols), strength * (1 + 0.02 * m)) for m in range(maps)]
        nodes = np.stack([nodes_of((rows, cols), 8, place) for place in places])
        far = float(np.abs(nodes).max())
        yield Case(
            f"{planes} planes, {maps} maps, {rows}x{cols}, {strength:+.2f}",
            {"planes": random.random((planes, rows, cols), np.float32), "nodes": nodes},
            2e-6 + 2 * 4 * 2.0**-24 * (far + max(rows, cols)),
            "a place is the sum of its index and of four products, each rounded by 2^-24 of the frame's size or "
            "the farthest offset; a cubic of values 0 .. 1 changes by at most 2 per pixel in each of two "
            "directions; 2e-6 for 16 products and their weights",
            metric="exact",
        )
    planes = random.random((3, 9, 30), np.float32)
    yield exact_case(
        "nothing moved",
        "the weights of a pixel's own place are 1 and 0",
        planes=planes,
        nodes=np.zeros((1, 2, 2, 3), np.float32),
    )
    planes[1, 4, 7] = np.nan
    whole = np.zeros((1, 2, 2, 2), np.float32)
    whole[:, 0] = 2
    yield exact_case(
        "NaN, two rows down",
        "weights of 0 times NaN are NaN, in the reference too; whole pixels have the weights 1 and 0",
        planes=planes,
        nodes=whole,
    )


def bench(rows, cols):
    """Return inputs: three planes with lateral colour, 5 % barrel."""
    random = np.random.default_rng(8)
    places = [_barrel((rows, cols), 0.05 * (1 + 0.01 * m)) for m in range(3)]
    return {
        "planes": random.random((3, rows, cols), np.float32),
        "nodes": np.stack([nodes_of((rows, cols), 8, place) for place in places]),
    }


def operations(planes, nodes):
    """Count operations: 20 products and sums of a cubic, and 30 for each pixel's place and weights."""
    return planes.size * 40 + nodes.shape[0] * planes[0].size * 30
