"""MTF50 along rows and columns from edges that are turned against them.

A turned edge shows the blur along its normal. Around one place 1 / MTF50^2 is taken as a cosine of twice the angle,
as the frequencies of half transfer lie near an ellipse (exact for second moments). The edges of a square, at right
angles, give two of the ellipse's three numbers. Its corners give the third, the lean between rows and columns, see
`gpusim.fit.edge_corners`. Without corners the places of the frame say how large the lean may be, as an ellipse of any
direction has both parts alike on average. Edges that are turned the other way have the lean with the other sign, so
that frames of both turns together do not need it.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.fit.edge_fit import Place

SHARPEST = 0.25  # least 1 / MTF50^2 along an axis over that along the normal
UNSEEN = 1.3  # standard deviation of leans that no corner shows, over the RMS difference along rows and columns
LEAN_NOISE = 1.1  # standard deviation of a lean over the one that its corners' residuals tell
LEAN_MODEL = (
    0.3  # error of a lean over the frame's, as frequencies of half transfer are no exact ellipses
)

NO_LEAN = 1e-4  # half width of a lean's interval that is taken as 0

Interval = tuple[float, float, float]


def measure_astigmatism(places: Sequence[Place]) -> float:
    """Return the standard deviation of leans between rows and columns that the places of a channel have.

    Args:
        places: The places.

    Returns:
        From the places' corners, less their noise; if there are none, from the differences along rows and columns. In
        units of the mean 1 / MTF50^2.
    """
    whole = [place for place in places if place.across is not None and place.down is not None]
    leans = [place.lean for place in whole if place.lean is not None]
    if leans:
        noise = np.mean([(LEAN_NOISE * one.error) ** 2 for one in leans])
        seen = np.mean([one.value**2 for one in leans])
        return float(np.sqrt(max(seen - noise, noise * np.sqrt(2 / len(leans)))))
    found = [_solve(place, 0.0)[0] for place in whole]
    differences = [(one[0] - one[1]) / (one[0] + one[1]) for one in found]
    return float(UNSEEN * np.sqrt(np.mean(np.square(differences)))) if found else 0.0


def mtf50_along_axes(place: Place, astigmatism: float) -> tuple[Interval | None, Interval | None]:
    """Return MTF50 along rows and along columns at a place.

    Args:
        place: The place.
        astigmatism: Standard deviation of leans over the frame [1], see `measure_astigmatism`.

    Returns:
        Along rows, then along columns: value and ends of its 95 % interval [cycle/pixel]; None: no edge shows it.
        If edges show one direction, its value is along their normal.
    """
    if place.across is None or place.down is None:
        return tuple(line and line.mtf50 for line in (place.across, place.down))  # type: ignore[return-value]
    squares, reaches = _solve(place, astigmatism)
    values = squares**-0.5
    away = reaches / (2 * squares) * values
    one, two = (
        (float(v), max(float(v - d), 0.0), float(v + d)) for v, d in zip(values, away, strict=True)
    )
    return one, two


def _solve(place: Place, astigmatism: float):
    """Return 1 / MTF50^2 along rows and columns and half the widths of their intervals, (2,) each.

    Least squares for the ellipse's numbers along rows, along columns and between them.
    """
    lines = [line for line in (place.across, place.down) if line is not None]
    halves = np.array([line.mtf50 for line in lines])
    seen = halves[:, 0] ** -2
    middle = np.sqrt(seen.prod())
    (first, second), (one, two) = np.transpose(
        [(np.sin(line.tilt) ** 2, np.sin(2 * line.turn)) for line in lines]
    )
    system = [[1 - first, first, one], [second, 1 - second, -two], [0, 0, 1]]
    wanted = [*seen, 0.0]
    reaches = [*((halves[:, 2] - halves[:, 0]) * 2 / halves[:, 0] ** 3)]
    reaches.append(max(1.96 * astigmatism, NO_LEAN) * middle)
    if place.lean is not None:
        turned = np.sin(2 * place.lean.turn) / 2
        system.append([-turned, turned, np.cos(2 * place.lean.turn)])
        wanted.append(place.lean.value * middle)
        error = np.hypot(LEAN_NOISE * place.lean.error, LEAN_MODEL * astigmatism)
        reaches.append(1.96 * float(error) * middle)
    weights = 1 / np.array(reaches)
    parts = np.array(system) * weights[:, None]
    normal = np.linalg.inv(parts.T @ parts)
    squares = (normal @ (parts.T @ (np.array(wanted) * weights)))[:2]
    return np.maximum(squares, SHARPEST * seen), np.sqrt(np.diag(normal)[:2])
