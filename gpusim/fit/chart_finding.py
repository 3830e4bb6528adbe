"""The 24 patches of a ColorChecker, found in a frame."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData
from gpusim.domain.short_repr import short_repr
from gpusim.fit.planes import channel_blocks, clipped_mask, letter_masks, light_values
from gpusim.io.raw.raw_frame import RawFrame

COLUMNS, ROWS = 6, 4
SEARCHED = 480  # blocks on the longer side of the picture that is searched
LEVELS = 24  # thresholds of a search
SMALLEST, LARGEST = 1e-4, 0.04  # area of a patch over the frame's
FULL = 0.8  # least area of a patch over its rectangle's
LEAST = 12  # patches that must be found; the others follow
CORE = 0.5  # of a patch's sides that is used
MISS = 0.25  # of the patches' distance by which a patch may miss the grid
MOST_CLIPPED = 0.01


@dataclass(frozen=True, eq=False)
class Patches:
    """Means of the patches of a chart, from dark skin to black.

    Args:
        name: Name of the file.
        letters: Channels.
        means: Values above black [DN], shape (24, C).
        errors: Standard errors of the means from the pixels' spread, shape (24, C).
        clipped: Numbers of patches with clipped pixels.
        outline: x and y of the middles of the corner patches [pixel], (4, 2), clockwise from dark skin.
    """

    name: str
    letters: tuple[str, ...]
    means: np.ndarray
    errors: np.ndarray
    clipped: tuple[int, ...]
    outline: np.ndarray

    __repr__ = short_repr


def read_patches(
    frame: RawFrame,
    white_to_black: np.ndarray,
    black: ArrayLike | None = None,
    corners: ArrayLike | None = None,
    falloff: np.ndarray | None = None,
) -> Patches:
    """Find a ColorChecker and return its patches' means.

    Args:
        frame: The frame.
        white_to_black: Luminance of each patch from dark skin to black in any light, shape (24,), which tells how
            the chart is turned.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.
        corners: x and y [pixel] of the middles of dark skin, bluish green, black and white, the four corner patches,
            shape (4, 2); None: they are searched.
        falloff: Response to even light over the frame [1], shape (rows, cols), which is divided out; or None.

    Returns:
        The patches.

    Raises:
        BadData: No chart is found, or the corners have another shape.
    """
    values = light_values(frame, black)
    clipped = clipped_mask(frame, values)
    if falloff is not None:
        values = values / falloff
    if corners is not None:
        outline = np.asarray(corners, np.float64)
        if outline.shape != (4, 2):
            raise BadData(
                f"chart corners: shape {outline.shape}, wanted x and y of the middles of four patches: dark skin, "
                "bluish green, black, white"
            )
        turned = [outline]
    else:
        turned = _turns(_find_outline(frame, values))
    found = [_read(frame, values, outline, clipped) for outline in turned]
    alike = [_likeness(one.means, white_to_black) for one in found]
    best = found[int(np.argmax(alike))]
    if max(alike) < 0.8:
        raise BadData(
            f"{frame.name or 'chart'}: the patches found do not look like a ColorChecker; give corners, x and y of the "
            "middles of dark skin, bluish green, black and white"
        )
    return best


def _likeness(means, luminance):
    """Return the correlation of the patches' logarithms with those wanted."""
    seen = np.log(np.maximum(means.mean(1), 1e-3 * max(means.max(), 1e-9)))
    return float(np.corrcoef(seen, np.log(luminance))[0, 1])


def _turns(outline):
    """Return an outline as it is and turned by a half; of a chart on its side, both ways."""
    return [np.roll(outline, shift, axis=0) for shift in (0, 2)]


def _find_outline(frame, values):
    """Return the middles of four corner patches, clockwise, the longer side first."""
    period = max(len(frame.cfa), len(frame.cfa[0]))
    size = max(1, round(max(values.shape) / SEARCHED / period))
    blocks, block = channel_blocks(frame, values, size)
    middles, sides = _patch_candidates(blocks)
    homography = _grid_of(middles, sides) if len(middles) >= LEAST else None
    if homography is None:
        raise BadData(
            f"{frame.name or 'chart'}: no ColorChecker found ({len(middles)} patches of 24); let it fill a third "
            "of the "
            "frame or more, in even light, or give corners, x and y of the middles of its corner patches"
        )
    corners = np.array([[0, 0], [COLUMNS - 1, 0], [COLUMNS - 1, ROWS - 1], [0, ROWS - 1]], float)
    at = _project(homography, corners)
    return (at + 0.5) * block[::-1] - 0.5


def _patch_candidates(blocks):
    """Return x and y of the middles (N, 2) and side lengths (N,) of even, nearly square regions."""
    soft = np.stack([scipy.ndimage.gaussian_filter(one, 0.7) for one in blocks])
    planes = np.log(np.maximum(soft, 1e-3 * soft.max(axis=(1, 2), keepdims=True)))
    slope = np.sqrt(sum(scipy.ndimage.sobel(one, axis) ** 2 for one in planes for axis in (0, 1)))
    found: list[tuple[float, float, float, float]] = []
    for level in np.geomspace(
        np.percentile(slope, 20) + 1e-9, np.percentile(slope, 97) + 2e-9, LEVELS
    ):
        labels, count = scipy.ndimage.label(slope < level)
        if count > 5000:
            continue
        areas = np.bincount(labels.ravel(), minlength=count + 1)
        for number, part in enumerate(scipy.ndimage.find_objects(labels), 1):
            area = areas[number]
            if part is None or not max(SMALLEST * slope.size, 16) < area < LARGEST * slope.size:
                continue
            rows, cols = np.nonzero(labels[part] == number)
            covariance = np.cov(np.stack([cols, rows]))
            across, down = np.sqrt(12 * np.maximum(np.linalg.eigvalsh(covariance), 1e-12))
            if area < FULL * across * down or area > 1.15 * across * down or down > 1.6 * across:
                continue
            middle = cols.mean() + part[1].start, rows.mean() + part[0].start
            found.append((*middle, np.sqrt(area), level))
    kept: list[tuple[float, float, float, float]] = []
    for one in sorted(found, key=lambda item: -item[2]):  # the largest of those at one place
        if all(np.hypot(one[0] - k[0], one[1] - k[1]) > 0.5 * k[2] for k in kept):
            kept.append(one)
    table = np.array(kept).reshape(-1, 4)
    return table[:, :2], table[:, 2]


def _grid_of(middles, sides):
    """Return the homography (3, 3) from columns and rows of the chart to blocks, or None."""
    best: tuple = (0, None)
    for start in range(len(middles)):
        like = np.abs(np.log(sides / sides[start])) < 0.5
        places = _places(middles, like, start)
        if len(places) <= best[0] or len(places) < LEAST:
            continue
        numbers = np.array(list(places.values()))
        at = np.array([middles[k] for k in places])
        spans = np.ptp(numbers, axis=0) + 1
        if max(spans) > COLUMNS or min(spans) > ROWS:
            continue
        if tuple(sorted(spans)) != (ROWS, COLUMNS):
            continue
        numbers = numbers - numbers.min(axis=0)
        if spans[0] < spans[1]:  # the chart stands on its side
            numbers = np.stack([numbers[:, 1], ROWS - 1 - numbers[:, 0]], axis=1)
        homography = _homography(numbers.astype(float), at)
        best = len(places), homography
    return best[1]


def _places(middles, like, start):
    """Return {candidate: (column, row)} of the lattice that grows from a candidate."""
    away = middles - middles[start]
    distance = np.where(like, np.hypot(*away.T), np.inf)
    order = np.argsort(distance)[1:7]
    if not np.isfinite(distance[order[0]]):
        return {}
    first = away[order[0]]
    others = [
        k
        for k in order[1:]
        if np.isfinite(distance[k])
        and abs(np.cross(np.append(first, 0), np.append(away[k], 0))[2])
        > 0.8 * distance[order[0]] * distance[k]
        and distance[k] < 1.5 * distance[order[0]]
    ]
    if not others:
        return {}
    second = away[others[0]]
    if abs(first[1]) > abs(first[0]):
        first, second = second, first
    first = first if first[0] > 0 else -first
    second = second if second[1] > 0 else -second
    known = {start: (0, 0)}
    steps = {start: (first, second)}
    queue = [start]
    while queue:
        own = queue.pop(0)
        for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            axis = 0 if way[0] else 1
            sign = way[0] or way[1]
            step = steps[own][axis] * sign
            miss = np.where(like, np.hypot(*(middles - middles[own] - step).T), np.inf)
            near = int(np.argmin(miss))
            if miss[near] > MISS * np.hypot(*step) or near in known:
                continue
            known[near] = known[own][0] + way[0], known[own][1] + way[1]
            moved = (middles[near] - middles[own]) * sign
            fresh = list(steps[own])
            fresh[axis] = (fresh[axis] + moved) / 2
            steps[near] = fresh[0], fresh[1]
            queue.append(near)
    return known


def _homography(numbers, at):
    """Return the least squares homography from numbers (N, 2) to places (N, 2)."""
    scale = np.abs(at).max()
    rows = []
    for (u, v), (x, y) in zip(numbers, at / scale, strict=True):
        rows += [
            [u, v, 1, 0, 0, 0, -x * u, -x * v, -x],
            [0, 0, 0, u, v, 1, -y * u, -y * v, -y],
        ]
    found = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    return np.diag([scale, scale, 1]) @ found


def _project(homography, points):
    """Return points (N, 2) through a homography."""
    x, y, w = homography @ np.column_stack([points, np.ones(len(points))]).T
    return np.stack([x / w, y / w], axis=1)


def _read(frame, values, outline, clipped):
    """Return the patches inside an outline."""
    corners = np.array([[0, 0], [COLUMNS - 1, 0], [COLUMNS - 1, ROWS - 1], [0, ROWS - 1]], float)
    back = np.linalg.inv(_homography(corners, outline))
    masks = letter_masks(frame)
    rows, cols = np.indices(values.shape)
    x, y = _project(back, np.stack([cols.ravel(), rows.ravel()], axis=1)).T
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    # patch and gap: 40 and 5 mm
    core = CORE / 2 * 40 / 45
    inside = (np.abs(x - column) < core) & (np.abs(y - row) < core)
    inside &= (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
    number = np.where(inside, row * COLUMNS + column, -1).reshape(values.shape)
    means = np.zeros((24, len(masks)))
    errors = np.zeros((24, len(masks)))
    for k, mask in enumerate(masks.values()):
        for patch in range(24):
            seen = values[mask & (number == patch)]
            if len(seen) < 9:
                raise BadData(
                    f"{frame.name or 'chart'}: {len(seen)} pixels of a channel in a patch, wanted 9 or more; let the "
                    "chart fill more of the frame"
                )
            means[patch, k] = seen.mean()
            errors[patch, k] = seen.std(ddof=1) / np.sqrt(len(seen))
    high = tuple(patch for patch in range(24) if clipped[number == patch].mean() > MOST_CLIPPED)
    return Patches(frame.name, tuple(masks), means, errors, high, outline)
