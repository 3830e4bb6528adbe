"""Samples that show two surfaces at once: those that an edge of depth divides, in pictures of renderers and cameras.

Such a sample has the distance of one surface and light of both. Its light is a F + (1 - a) B, with F
and B of the nearest samples that show only one surface, and a the part that the nearer one covers:
at least half if the sample has its distance. The nearer layer then covers a, and the farther one
continues behind it.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from gpusim.optics.edges import find_changes, span_of

NEXT = 2  # [sample] away at most are samples that show only one surface
JUMP = 0.8  # of the difference of both sides between neighbours: an edge
LEAST = 1e-3  # covered parts closer to 0 or 1 are whole
OFFSETS = sorted(
    ((y, x) for y in range(-NEXT, NEXT + 1) for x in range(-NEXT, NEXT + 1)),
    key=lambda at: at[0] ** 2 + at[1] ** 2,
)


@dataclass(frozen=True, eq=False)
class Mixed:
    """Samples that show both sides of an edge, as indices of all samples in their order.

    Attributes:
        at: The samples, int (n,).
        front: A sample of the nearer surface next to each, int (n,).
        back: One of the farther surface, int (n,).
        share: Part that the nearer surface covers, float32 (n,).
    """

    at: np.ndarray
    front: np.ndarray
    back: np.ndarray
    share: np.ndarray

    def doubt(self, light: np.ndarray) -> np.ndarray:
        """Return the light of each sample that one of the surfaces has if the sample shows only one, (n,).

        Args:
            light: Brightness of samples, shape (rows, cols).
        """
        apart = light.ravel()[self.front] - light.ravel()[self.back]
        return np.minimum(self.share, 1 - self.share) * np.abs(apart)


def find_mixed(layer: np.ndarray, confusion: np.ndarray, light: np.ndarray) -> Mixed:
    """Return the samples at the edges of layers that show both sides.

    Args:
        layer: Layer of each sample, 0 the nearest, int (rows, cols).
        confusion: Circle of confusion of samples [sample], the same shape.
        light: Brightness of samples, the same shape.
    """
    rows, cols = layer.shape
    edge = np.zeros(layer.shape, bool)
    box = tuple(
        slice(max(one.start - 2, 0), one.stop + 1) for one in map(span_of, find_changes(layer))
    )
    most, least = (
        filtered(layer[box], 3, mode="nearest")
        for filtered in (scipy.ndimage.maximum_filter, scipy.ndimage.minimum_filter)
    )
    edge[box] = most != least
    y, x = np.nonzero(edge)
    own, other = np.full((2, len(y)), -1)
    for down, across in OFFSETS:
        v, u = y + down, x + across
        inside = (v >= 0) & (v < rows) & (u >= 0) & (u < cols)
        v, u = np.clip(v, 0, rows - 1), np.clip(u, 0, cols - 1)
        clear, same = inside & ~edge[v, u], layer[v, u] == layer[y, x]
        for found, some in ((own, clear & same), (other, clear & ~same)):
            new = some & (found < 0)
            found[new] = (v * cols + u)[new]
    known = (own >= 0) & (other >= 0)
    at, own, other = (y * cols + x)[known], own[known], other[known]
    layers, values = layer.ravel(), np.ravel(light)
    is_front = layers[at] < layers[other]
    front, back = np.where(is_front, own, other), np.where(is_front, other, own)
    # a surface that is cut into layers has both sides' distances in steps
    depth = confusion.ravel()
    around = np.array(
        [
            depth[np.clip(y[known] + v, 0, rows - 1) * cols + np.clip(x[known] + u, 0, cols - 1)]
            for v in (-1, 0, 1)
            for u in (-1, 0, 1)
        ]
    ).reshape(9, -1)
    low, high = around.min(axis=0), around.max(axis=0)
    jumps = high - low > JUMP * np.abs(depth[front] - depth[back])
    seen, front_light, back_light = (values[one].astype(np.float64) for one in (at, front, back))
    apart = front_light - back_light
    share = np.array(is_front, np.float64)
    np.divide(seen - back_light, apart, where=apart != 0, out=share)
    share = np.clip(share, np.where(is_front, 0.5, 0), np.where(is_front, 1, 0.5))
    some = jumps & (np.abs(share - is_front) > LEAST)
    return Mixed(at[some], front[some], back[some], share[some].astype(np.float32))
