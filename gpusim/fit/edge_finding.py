"""Straight edges of a target, found in a frame."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from gpusim.domain.errors import BadData
from gpusim.domain.short_repr import short_repr

SMOOTH = 1.5  # [pixel] Gaussian before contours
CELL = 8  # pixels on a side of the cells in which the light's range is looked up
STRAIGHT = 1.5  # [pixel] by which a contour may leave a straight line
SHORTEST = 24.0  # [pixel] of an edge
WIDEST = 48.0  # [pixel] used on each side of an edge
NARROWEST = 6.0
CONTRAST = 0.2  # least difference over sum of the two sides
FREE = 0.7  # of the way to the next edge is used
STEEPEST = np.radians(40)  # from the pixels' axis; near 45 degrees the pixels repeat few distances


@dataclass(frozen=True)
class FoundEdge:
    """A straight edge.

    Args:
        row, col: Its middle [pixel].
        angle: Direction of its normal from the columns' axis x towards rows, to the lighter side [rad].
        length: [pixel] that are used.
        width: [pixel] that are used on each side.
        target: Number of the outline that it belongs to.
    """

    row: float
    col: float
    angle: float
    length: float
    width: float
    target: int

    __repr__ = short_repr

    @property
    def tilt(self) -> float:
        """Angle between the edge and the nearer pixel axis [rad]."""
        turned = abs((self.angle + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        return float(turned)

    @property
    def is_upright(self) -> bool:
        """Whether the normal is nearer to the rows' direction, so that the blur across columns is seen."""
        return bool(abs(np.cos(self.angle)) > np.sqrt(0.5))


def find_edges(plane: np.ndarray, name: str = "edges") -> list[FoundEdge]:
    """Find straight edges between a dark and a light surface.

    Args:
        plane: Values of one colour or of a grey target, mean about 1, shape (rows, cols).
        name: Name of the frame, for messages.

    Returns:
        The edges: any angle, also too straight or too steep to be measured.

    Raises:
        BadData: There are none.
    """
    from skimage.measure import approximate_polygon, find_contours

    smooth = scipy.ndimage.gaussian_filter(plane, SMOOTH, mode="nearest")
    contours = [
        contour
        for contour in find_contours(smooth - _middle_level(smooth), 0.0)
        if len(contour) >= SHORTEST
    ]
    segments = []
    for target, contour in enumerate(contours):
        corners = approximate_polygon(contour, STRAIGHT)
        segments += [(target, one, two) for one, two in pairwise(corners)]
    points = np.concatenate(contours) if contours else np.zeros((0, 2))
    found = [
        edge
        for target, one, two in segments
        if (edge := _edge_between(smooth, points, one, two, target)) is not None
    ]
    if not found:
        raise BadData(
            f"{name}: no straight edge found; shoot squares or one edge, dark against light, turned by about 5 "
            "degrees, "
            f"{SHORTEST:g} pixels or longer and sharp"
        )
    return found


def _middle_level(smooth):
    """Return the level between dark and light around each pixel; no contour if both are alike."""
    rows, cols = smooth.shape
    step = min(CELL, *smooth.shape)
    cells = smooth[: rows // step * step, : cols // step * step]
    cells = cells.reshape(rows // step, step, cols // step, step)
    reach = max(3, min(rows, cols) // step // 5 * 2 + 1)
    high = scipy.ndimage.maximum_filter(cells.max((1, 3)), reach, mode="nearest")
    low = scipy.ndimage.minimum_filter(cells.min((1, 3)), reach, mode="nearest")
    level = np.where(high - low > CONTRAST * (high + low), (high + low) / 2, 2 * high)
    level = scipy.ndimage.gaussian_filter(level, reach / 6, mode="nearest")
    place = np.ogrid[:rows, :cols]
    at = [
        np.clip((axis - (step - 1) / 2) / step, 0, n - 1)
        for axis, n in zip(place, level.shape, strict=True)
    ]
    return scipy.ndimage.map_coordinates(
        level, np.broadcast_arrays(*at), order=1, mode="nearest", output=np.float64
    )


def _edge_between(smooth, points, one, two, target):
    """Return the edge between two corners of an outline, or None if it is too short or crowded."""
    along = two - one
    length = float(np.hypot(*along))
    if length < SHORTEST:
        return None
    middle, (down, across) = (one + two) / 2, along / length
    normal = np.array([across, -down])  # (row, col)
    away = points - middle
    t, d = away @ (along / length), away @ normal
    used = length - 2 * min(max(6.0, 0.1 * length), 0.25 * length)
    beside = np.abs(d[(np.abs(t) < used / 2 + 2) & (np.abs(d) > 2 * STRAIGHT + 1)])
    width = min(WIDEST, FREE * beside.min(initial=np.inf), used)
    ends = [
        middle + side * normal * width + end * along / length * used / 2
        for side in (-1, 1)
        for end in (-1, 1)
    ]
    shape = np.array(smooth.shape)
    if any((end < 0).any() or (end > shape - 1).any() for end in ends):
        inside = [_room(middle + end * along / length * used / 2, normal, shape) for end in (-1, 1)]
        width = min(width, *inside)
    if width < NARROWEST:
        return None
    sides = [
        smooth[tuple(np.rint(middle + side * normal * width * 0.8).astype(int))] for side in (-1, 1)
    ]
    if abs(sides[1] - sides[0]) < CONTRAST * (sides[1] + sides[0]):
        return None
    normal = normal if sides[1] > sides[0] else -normal
    return FoundEdge(
        float(middle[0]),
        float(middle[1]),
        float(np.arctan2(normal[0], normal[1])),
        used,
        float(width),
        target,
    )


def _room(point, normal, shape):
    """Return how far a point can move along a direction, either way, inside the frame."""
    rooms = [
        min(at, n - 1 - at) / abs(step)
        for at, step, n in zip(point, normal, shape, strict=True)
        if abs(step) > 1e-9
    ]
    return max(min(rooms), 0.0)
