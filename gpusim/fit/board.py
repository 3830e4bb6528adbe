"""Corners of a checkerboard, found in each channel of a frame."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, Missing
from gpusim.domain.short_repr import short_repr
from gpusim.fit.corner_fit import fit_corners
from gpusim.fit.planes import even_plane, letter_masks, light_values, main_channel
from gpusim.io.raw.raw_frame import RawFrame

LEAST = 12  # corners of a board
SADDLE = 2.0  # [pixel] Gaussian of the search for corners
SADDLE_LEAST = 0.35  # of the strongest corners' strength; a single square's corner has 0.25
SAME = 4.5  # [pixel] within which saddles are one
SEEDS = 8  # corners from which boards are grown
SOFT = 0.6  # [pixel] Gaussian against noise before detection
FAINT = 0.15  # of the picture's contrast, at a corner in the dark part of unevenly lit frames
WINDOW = 0.4  # of the distance of corners, around each of them
WIDEST = 14.0  # [pixel]


@dataclass(frozen=True, eq=False)
class Board:
    """Inner corners of a checkerboard in a frame.

    Args:
        name: Name of the file.
        places: Column and row of each corner on the board, in squares, shape (N, 2).
        corners: Their x and y [pixel] in the main channel, shape (N, 2); (0, 0) is the first pixel's centre.
        offsets: x and y [pixel] relative to the main channel by letter, shape (N, 2) each.
    """

    name: str
    places: np.ndarray
    corners: np.ndarray
    offsets: dict[str, np.ndarray]

    __repr__ = short_repr


def require_cv2():
    """Return OpenCV's module.

    Returns:
        The module.

    Raises:
        Missing: It is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise Missing("checkerboards need OpenCV; pip install opencv-python-headless") from None
    return cv2


def find_board(frame: RawFrame, black: ArrayLike | None = None) -> Board:
    """Find a checkerboard.

    Args:
        frame: The frame.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.

    Returns:
        Its corners.

    Raises:
        BadData: There is none.
        Missing: OpenCV is not installed.
    """
    cv2 = require_cv2()
    values = light_values(frame, black)
    even = even_plane(frame, values)
    planes = {
        letter: _fill_gaps(even, mask) if len(frame.channels) > 1 else even
        for letter, mask in letter_masks(frame).items()
    }
    main = main_channel(frame.channels)
    picture = _eight_bits(planes[main])
    places, corners = _detect(cv2, picture, frame.name)
    rows, cols = values.shape
    inside = ((corners >= 2) & (corners <= [cols - 3, rows - 3])).all(axis=1)
    places, corners = places[inside], corners[inside]
    ways = _ways(places, corners)
    half = float(np.clip(WINDOW * np.median(np.hypot(*ways.T)), 3, WIDEST))
    masks = letter_masks(frame)
    found = {letter: fit_corners(even, masks[letter], corners, ways, half) for letter in planes}
    is_found = np.isfinite(np.concatenate(list(found.values()), axis=1)).all(axis=1)
    if is_found.sum() < LEAST:
        raise BadData(f"{frame.name or 'grid'}: corners are not sharp; focus, and give more light")
    fine = {letter: corners[is_found] for letter, corners in found.items()}
    offsets = {letter: own - fine[main] for letter, own in fine.items() if letter != main}
    return Board(frame.name, places[is_found], fine[main], offsets)


def _ways(places, corners):
    """Return the steps to the next corner along the board's two axes, (N, 2, 2): axis, then x and y."""
    known = {tuple(place): corner for place, corner in zip(places, corners, strict=True)}
    ways = np.full((len(places), 2, 2), np.nan)
    for number, (x, y) in enumerate(places):
        for axis, (dx, dy) in enumerate(((1, 0), (0, 1))):
            ends = known.get((x + dx, y + dy)), known.get((x - dx, y - dy))
            before = corners[number] if ends[1] is None else ends[1]
            after = corners[number] if ends[0] is None else ends[0]
            count = sum(end is not None for end in ends)
            if count:
                ways[number, axis] = (after - before) / count
    return np.where(np.isnan(ways), np.nanmedian(ways, axis=0), ways)


def _fill_gaps(even, mask):
    """Return a channel's plane with its gaps filled from neighbours, weights falling with distance."""
    weight = scipy.ndimage.gaussian_filter(mask.astype(float), 0.8)
    return scipy.ndimage.gaussian_filter(np.where(mask, even, 0), 0.8) / np.maximum(weight, 1e-9)


def _eight_bits(plane):
    low, high = np.percentile(plane, (0.5, 99.5))
    soft = scipy.ndimage.gaussian_filter(plane, SOFT)
    return np.clip((soft - low) / max(high - low, 1e-9) * 235 + 10, 0, 255).astype(np.uint8)


def _detect(cv2, picture, name):
    """Return places on the board (N, 2) and corners (N, 2): the largest board grown from a few seeds."""
    saddles = _saddles(picture)
    best: dict = {}
    if len(saddles) >= LEAST:
        order = np.argsort(np.hypot(*(saddles - np.median(saddles, axis=0)).T))
        for number in order[:: max(1, len(order) // SEEDS)][: 2 * SEEDS]:
            seed = _seed(cv2, picture, saddles, number)
            found = _grow(cv2, picture, seed) if seed else {}
            best = max(best, found, key=len)
            if len(best) > 0.8 * len(saddles):
                break
    if len(best) < LEAST:
        raise BadData(
            f"{name or 'grid'}: no checkerboard found; shoot the whole board, in focus, without glare, and squares of "
            "20 pixels or more"
        )
    return np.array(list(best), np.float64), np.array(list(best.values()))


def _saddles(picture):
    """Return x and y of places where the picture rises along one diagonal and falls along the other, (N, 2)."""
    plane = picture.astype(np.float64)
    xx, yy, xy = (
        scipy.ndimage.gaussian_filter(plane, SADDLE, order=order)
        for order in ((0, 2), (2, 0), (1, 1))
    )
    strength = xy**2 - xx * yy
    top = strength == scipy.ndimage.maximum_filter(strength, 9)
    found = np.sort(strength[top])
    level = SADDLE_LEAST * found[-LEAST] if len(found) >= LEAST else 0.0
    rows, cols = np.nonzero(top & (strength > max(level, 1.0)))
    return np.stack([cols, rows], axis=1).astype(np.float64)


def _seed(cv2, picture, saddles, number):
    """Return three corners of a square as {place: corner}, or None."""
    own = saddles[number]
    away = saddles - own
    distance = np.hypot(*away.T)
    order = np.argsort(np.where(distance < SAME, np.inf, distance))[:8]
    first = away[order[0]]
    for other in order[1:]:
        turned = first[0] * away[other][1] - first[1] * away[other][0]
        sine = turned / (distance[order[0]] * distance[other])
        if abs(sine) > 0.75 and distance[other] < 1.8 * distance[order[0]]:
            steps = (first, away[other]) if turned > 0 else (away[other], first)
            known = {(0, 0): own, (1, 0): own + steps[0], (0, 1): own + steps[1]}
            contrast = _contrast(picture)
            for place, guess in known.items():
                corner = _corner_near(cv2, picture, guess, steps[place[1]], contrast)
                if corner is None:
                    return None
                known[place] = corner
            return known
    return None


def _contrast(picture):
    return float(np.ptp(np.percentile(picture, (2, 98))))


def _grow(cv2, picture, known):
    """Return more corners of the board: neighbours of known ones, as long as they look like corners."""
    contrast = _contrast(picture)
    known = dict(known)
    fresh = list(known)
    while fresh:
        tried: dict = {}
        for x, y in fresh:
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                place = x + dx, y + dy
                step = _step_to(known, (x, y), (dx, dy))
                if place not in known and step is not None:
                    tried.setdefault(place, (known[x, y] + step, step))
        found = {
            place: corner
            for place, (guess, step) in tried.items()
            if (corner := _corner_near(cv2, picture, guess, step, contrast)) is not None
        }
        known |= found
        fresh = list(found)
    return known


def _step_to(known, place, way):
    """Return the step from a corner to its neighbour as steps nearby are, or None."""
    (x, y), (dx, dy) = place, way
    if (x - dx, y - dy) in known:
        return known[place] - known[x - dx, y - dy]
    for side in (1, -1):
        beside = x + side * dy, y + side * dx
        if beside in known and (beside[0] + dx, beside[1] + dy) in known:
            return known[beside[0] + dx, beside[1] + dy] - known[beside]
    return None


def _corner_near(cv2, picture, guess, step, contrast):
    """Return the corner near a place if four squares meet there, else None."""
    size = float(np.hypot(*step))
    half = int(np.clip(WINDOW * size, 3, 12))
    high = np.array(picture.shape[::-1]) - half - 2
    if size < 6 or (guess < half + 2).any() or (guess >= high).any():
        return None
    corner = _refine(cv2, picture, guess[None], half)[0]
    if np.hypot(*(corner - guess)) > 0.3 * size:
        return None
    # the four squares: light and dark turn twice around the corner
    angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    around = corner[:, None] + 0.3 * size * np.stack([np.cos(angles), np.sin(angles)])
    if (around < 0).any() or (around.T > np.array(picture.shape[::-1]) - 1).any():
        return None
    x, y = np.rint(around).astype(int)
    seen = picture[y, x].astype(float)
    waves = np.abs(np.fft.rfft(seen)) / 16
    is_saddle = waves[2] > FAINT * contrast and waves[1] < 0.25 * waves[2]
    return corner if is_saddle else None


def _refine(cv2, picture, corners, half):
    """Return corners at sub-pixel places, see cv2.cornerSubPix."""
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    start = np.ascontiguousarray(corners, np.float32).reshape(-1, 1, 2)
    return (
        cv2.cornerSubPix(picture, start.copy(), (half, half), (-1, -1), end)
        .reshape(-1, 2)
        .astype(float)
    )
