"""A camera matrix and distortion from the corners of several views: least squares with priors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from gpusim.domain.short_repr import short_repr
from gpusim.fit.board import Board, require_cv2

ENOUGH_VIEWS = 3
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
# standard deviations of lenses: of k1, k2 and k3 the displacement of the frame's corner over its field height, rounded
# up from 5,671 calibrations of rectilinear lenses in lensfun (0.065, 0.054, 0.023)
USUAL = {"k1": 0.1, "k2": 0.06, "p1": 2e-3, "p2": 2e-3, "k3": 0.025}
MIDDLE = 0.05  # standard deviation of the principal point over the frame's diagonal
SQUARE = 3e-3  # standard deviation of fy / fx - 1: pixels are square
ROUNDS = 20
PINNED = 1e12  # weight of a parameter that is not fitted
ROBUST = 2.0  # robust standard deviations from which a corner counts less (Huber)
ODD = 4.0  # times the median residual of the views, from which one is not used
LEAST_ODD = 0.3  # [pixel]
STRAY = 8.0  # robust standard deviations from which a corner is none of the board's
LEAST_STRAY = 0.5  # [pixel]
FEW_STRAYS = 0.05  # share of corners; if more are away, the model is wrong
GRID = 17  # places along a side of the frame at which the error of the whole model is looked up
DRAWS = 400
NOISE_FREEDOM = 1000  # degrees of freedom of the corners' noise: as good as known


@dataclass(frozen=True, eq=False)
class Geometry:
    """A camera matrix and distortion with their uncertainty.

    Args:
        matrix: Camera matrix, (3, 3).
        coefficients: k1, k2, p1, p2, k3.
        errors: Half widths of the 95 % intervals of fx, fy, cx, cy and the coefficients, (9,).
        roots: Tables (n, 9) whose squares, root.T @ root, are covariances of these nine: from the corners' noise, and
            from the views' differences if there are enough.
        own_roots: The same tables of the model in use; they differ from `roots` if that has no k3.
        shift: The nine with k3 less the nine without it, (9,); 0 if k3 is used.
        residuals: Corners less the model [pixel], one (N, 2) for each view.
        has_focal: Whether focal lengths and principal point were fitted.
    """

    matrix: np.ndarray
    coefficients: np.ndarray
    errors: np.ndarray
    roots: tuple[np.ndarray, ...]
    own_roots: tuple[np.ndarray, ...]
    shift: np.ndarray
    residuals: list[np.ndarray]
    has_focal: bool

    __repr__ = short_repr

    @property
    def inner(self) -> np.ndarray:
        """fx, fy, cx, cy and the coefficients, (9,)."""
        return np.append(self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], self.coefficients)


def displacement_error(found: Geometry, size: tuple[int, int]) -> tuple[float, float, float]:
    """Return the largest error of the distortion over the frame: median and 95 % interval [pixel].

    Cameras that the views allow as well are drawn. A turn of the camera is no error. Without k3 in use, median and
    lower end are those of a lens that has none, and the upper end is of one that may have it.

    Args:
        found: The geometry.
        size: Columns and rows of the frame.

    Returns:
        Median, and the ends of the interval.
    """
    cv2 = require_cv2()
    x, y = (np.linspace(0, n - 1, GRID) for n in size)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    end = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12
    rays = cv2.undistortPoints(places, found.matrix, found.coefficients, criteria=end)
    rays = np.column_stack([rays.reshape(-1, 2), np.ones(len(rays))])
    _, slopes = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), found.matrix, found.coefficients)
    turns, slopes = slopes[:, :3], slopes[:, 6:15]
    slopes = slopes - turns @ np.linalg.lstsq(turns, slopes, rcond=None)[0]
    freedoms = NOISE_FREEDOM, len(found.residuals) - 1

    def largest(roots, shift):
        """Return median and 95 % interval, from the roots that give more."""
        random = np.random.default_rng(1)
        best = np.zeros(3)
        for root, freedom in zip(roots, freedoms, strict=False):
            wide = np.sqrt(freedom / random.chisquare(freedom, (DRAWS, 1)))  # Student's t
            drawn = wide * random.normal(size=(DRAWS, len(root))) @ root + shift
            away = np.hypot(*np.moveaxis((drawn @ slopes.T).reshape(DRAWS, -1, 2), -1, 0)).max(1)
            best = np.maximum(best, np.percentile(away, (50, 2.5, 97.5)))
        return best

    value, low, high = largest(found.own_roots, 0.0)
    return float(value), float(low), float(max(high, largest(found.roots, found.shift)[2]))


def calibrate(boards: Sequence[Board], size: tuple[int, int], focal: float) -> Geometry:
    """Fit a pinhole camera with Brown's distortion to views of one board.

    Coefficients of usual lenses are the prior. k3 is 0 unless the Bayesian information criterion pays for it. Intervals
    allow for k3, and are a jackknife's over the views, as errors of the corners of one view are not independent.

    Args:
        boards: The views.
        size: Columns and rows of the frame.
        focal: First guess of the focal length [pixel]; with fewer than three views it is kept.

    Returns:
        The geometry.

    Source:
        Triggs et al., "Bundle adjustment: a modern synthesis", 2000; Efron, "The jackknife", 1982.
    """
    found = _solve(boards, size, focal, True)
    clear = np.sqrt(np.log(sum(2 * len(one.places) for one in boards))) / 1.96
    if abs(found.coefficients[4]) > clear * found.errors[8]:
        return found
    plain = _solve(boards, size, focal, False)
    shift = found.inner - plain.inner
    return replace(plain, errors=found.errors, roots=found.roots, shift=shift)


def _solve(boards, size, focal, has_k3):
    """Return the geometry with or without k3."""
    has_focal = len(boards) >= ENOUGH_VIEWS
    inner, poses = _start(boards, size, focal, has_focal)
    first, weight = _prior(inner, size, has_focal)
    if not has_k3:
        weight[8] = PINNED
    for _ in range(ROUNDS):
        views = [_view(board, inner, pose) for board, pose in zip(boards, poses, strict=True)]
        noise = 1.4826 * np.median(np.abs(np.concatenate([left for left, _ in views]))) + 1e-6
        parts = [_normal_system(left, slopes, noise) for left, slopes in views]
        # square pixels: fy less fx is near 0
        prior, pull = np.diag(weight), weight * (first - inner)
        prior[:2, :2] += np.array([[1, -1], [-1, 1]]) / (SQUARE * inner[0]) ** 2
        pull[:2] += np.array([1, -1]) * (inner[1] - inner[0]) / (SQUARE * inner[0]) ** 2
        total = sum(part[0] for part in parts) + prior
        step = np.linalg.solve(total, sum(part[1] for part in parts) + pull)
        inner = inner + step
        poses = [
            pose + own - slope @ step for pose, (*_, own, slope) in zip(poses, parts, strict=True)
        ]
        if (np.abs(step) * np.sqrt(np.diag(total))).max() < 1e-3:
            break
    matrix = np.array([[inner[0], 0, inner[2]], [0, inner[1], inner[3]], [0, 0, 1]])
    left = [
        _view(board, inner, pose)[0].reshape(-1, 2)
        for board, pose in zip(boards, poses, strict=True)
    ]
    reach, roots = _errors(parts, total, has_focal)
    return Geometry(matrix, inner[4:], reach, roots, roots, np.zeros(9), left, has_focal)


def _start(boards, size, focal, has_focal):
    """Return OpenCV's parameters (9,) with k1 and k2, and poses (6,)."""
    cv2 = require_cv2()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_ASPECT_RATIO
    if not has_focal:
        flags |= cv2.CALIB_FIX_FOCAL_LENGTH | cv2.CALIB_FIX_PRINCIPAL_POINT
    end = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10
    matrix = np.array(
        [[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]], float
    )
    values = np.zeros(5)
    places = [_in_space(one).astype(np.float32) for one in boards]
    corners = [one.corners.astype(np.float32).reshape(-1, 1, 2) for one in boards]
    for more in (cv2.CALIB_FIX_K2, 0):  # few parameters first
        _, matrix, values, turns, shifts = cv2.calibrateCamera(
            places, corners, size, matrix, values, flags=flags | more, criteria=end
        )
    poses = [np.concatenate(pose).ravel() for pose in zip(turns, shifts, strict=True)]
    return np.array([*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *values.ravel()[:5]]), poses


def _in_space(board):
    return np.column_stack([board.places, np.zeros(len(board.places))])


def _prior(inner, size, has_focal):
    """Return the middle of the prior and its weight for fx, fy, cx, cy and the coefficients."""
    edge = np.hypot(*size) / 2 / inner[0]
    spread = np.array([USUAL[name] for name in COEFFICIENTS])
    spread[[0, 1, 4]] /= edge ** np.array([2, 4, 6])
    first = np.concatenate([inner[:4], np.zeros(5)])
    center = MIDDLE * np.hypot(*size)
    first[2:4] = (np.array(size) - 1) / 2
    own = np.array([0, 0, center**-2, center**-2]) if has_focal else np.full(4, PINNED)
    return first, np.concatenate([own, spread**-2])


def _view(board, inner, pose):
    """Return corners less the model, (2 N,), and the model's slopes, (2 N, 15): pose, then parameters."""
    matrix = np.array([[inner[0], 0, inner[2]], [0, inner[1], inner[3]], [0, 0, 1]])
    seen, slopes = require_cv2().projectPoints(
        _in_space(board), pose[:3], pose[3:], matrix, np.ascontiguousarray(inner[4:])
    )
    return board.corners.ravel() - seen.ravel(), slopes[:, :15]


def _normal_system(left, slopes, noise):
    """Return the normal matrix and gradient of the parameters without the pose, and the pose's step and slope."""
    away = np.hypot(*left.reshape(-1, 2).T).repeat(2)
    weight = np.minimum(1, ROBUST * noise / np.maximum(away, 1e-12)) / noise**2
    own, rest = slopes[:, :6], slopes[:, 6:]
    inverse = np.linalg.inv((own * weight[:, None]).T @ own)
    step = inverse @ (own.T @ (weight * left))
    slope = inverse @ (own.T @ (weight[:, None] * rest))
    free = rest - own @ slope
    normal = (free * weight[:, None]).T @ free
    return normal, free.T @ (weight * left), step, slope


def _errors(parts, total, has_focal):
    """Return half widths of 95 % intervals, and the roots of the covariances behind them.

    The jackknife over views, or the corners' noise if it is larger.
    """
    covariance = np.linalg.inv(total)
    plain = 1.96 * np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(plain, plain))
    root = (vectors * np.sqrt(np.maximum(values, 0))).T * plain
    if not has_focal:
        return plain, (root,)
    away = np.stack([np.linalg.solve(total - normal, pull) for normal, pull, *_ in parts])
    count = len(away)
    spread = np.sqrt((count - 1) / count) * (away - away.mean(0))
    return np.maximum(jackknife_reach(away), plain), (root, spread)


def jackknife_reach(values: np.ndarray) -> np.ndarray:
    """Return half widths of 95 % intervals from results without one view each.

    Args:
        values: Results, shape (views, n).

    Returns:
        Half widths by Student's t, shape (n,).
    """
    count = len(values)
    error = np.sqrt((count - 1) / count * ((values - values.mean(0)) ** 2).sum(0))
    return np.asarray(scipy.special.stdtrit(count - 1, 0.975) * error)


def choose_views(boards: Sequence[Board], size: tuple[int, int], focal: float) -> list[Board]:
    """Return the views that one camera explains: the worst view is left out until all miss about alike.

    Args:
        boards: Views.
        size: See `calibrate`.
        focal: See `calibrate`.

    Returns:
        More than half of the views; all of them if no such set agrees.
    """
    kept = list(boards)
    while len(kept) > max(len(boards) / 2, ENOUGH_VIEWS):
        inner, poses = _start(kept, size, focal, True)
        miss = np.array(
            [
                np.median(np.abs(_view(board, inner, pose)[0]))
                for board, pose in zip(kept, poses, strict=True)
            ]
        )
        if miss.max() < max(ODD * np.median(miss), LEAST_ODD):
            return kept
        del kept[int(miss.argmax())]
    return kept if len(kept) < len(boards) else list(boards)


def drop_strays(boards: Sequence[Board], found: Geometry) -> list[Board]:
    """Return the views without corners far from the model, as of things next to the board.

    Args:
        boards: Views.
        found: Their geometry.

    Returns:
        The views; all corners if many are away.
    """
    away = [np.hypot(*left.T) for left in found.residuals]
    noise = 1.4826 * np.median(np.abs(np.concatenate(found.residuals)))
    near = [one < max(STRAY * noise, LEAST_STRAY) for one in away]
    if np.mean(np.concatenate(near)) < 1 - FEW_STRAYS:
        return list(boards)
    return [
        replace(
            board,
            places=board.places[own],
            corners=board.corners[own],
            offsets={letter: values[own] for letter, values in board.offsets.items()},
        )
        for board, own in zip(boards, near, strict=True)
    ]
