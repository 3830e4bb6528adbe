"""MTF50 along rows and columns from edges that are turned against them.

A turned edge shows the blur along its normal. Around one place 1 / MTF50^2 is taken as a cosine of twice the angle,
as the frequencies of half transfer lie near an ellipse (exact for second moments). The edges of a square, at right
angles, give two of the ellipse's three numbers. The third, its lean between rows and columns, is not seen: the places
of the frame say how large it may be, as an ellipse of any direction has both parts alike on average. Edges that are
turned the other way have it with the other sign, so that frames of both turns together do not need it.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.fit.edge_fit import LineSpread, Place

SHARPEST = 0.25  # least 1 / MTF50^2 along an axis over that along the normal
REACH = 2.5  # times the RMS of some places holds the unseen part of 95 % of lenses

Interval = tuple[float, float, float]


def measure_astigmatism(places: Sequence[Place]) -> float:
    """Return the RMS over places of the difference over the sum of 1 / MTF50^2 along rows and columns."""
    found = []
    for place in places:
        if place.across is not None and place.down is not None:
            across, down = _along_axes(place.across, place.down)[0]
            found.append((across - down) / (across + down))
    return float(np.sqrt(np.mean(np.square(found)))) if found else 0.0


def mtf50_along_axes(place: Place, astigmatism: float) -> tuple[Interval | None, Interval | None]:
    """Return MTF50 along rows and along columns at a place.

    Args:
        place: The place.
        astigmatism: RMS over the frame [1], see `measure_astigmatism`.

    Returns:
        Along rows, then along columns: value and ends of its 95 % interval [cycle/pixel]; None: no edge shows it.
        If edges show one direction, its value is along their normal.
    """
    if place.across is None or place.down is None:
        return tuple(line and line.mtf50 for line in (place.across, place.down))  # type: ignore[return-value]
    squares, shares = _along_axes(place.across, place.down)
    seen = np.array([line.mtf50 for line in (place.across, place.down)])
    errors = (seen[:, 2] - seen[:, 0]) * 2 / seen[:, 0] ** 3
    lean = REACH * astigmatism * squares.sum() / 2
    unseen = np.tan(place.across.turn + place.down.turn) * lean
    reach = np.sqrt((shares**2) @ errors**2 + unseen**2)
    values = squares**-0.5
    away = reach / (2 * squares) * values
    one, two = (
        (float(v), max(float(v - d), 0.0), float(v + d)) for v, d in zip(values, away, strict=True)
    )
    return one, two


def _along_axes(across: LineSpread, down: LineSpread):
    """Return 1 / MTF50^2 along rows and columns, and the shares (2, 2) of the normals' in them."""
    seen = np.array([across.mtf50[0], down.mtf50[0]]) ** -2
    first, second = np.sin([across.tilt, down.tilt]) ** 2
    shares = np.linalg.inv([[1 - first, first], [second, 1 - second]])
    return np.maximum(shares @ seen, SHARPEST * seen), shares
