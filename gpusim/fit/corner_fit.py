"""Corners of a checkerboard at sub-pixel places, from the pixels of one channel as they are."""

import numpy as np
import scipy

ROUNDS = 25
FIRST_BLUR = 0.8  # [pixel]
LEAST_PIXELS = 24  # in a window, for the edges' curvature to be fitted
BLURS = 0.25, 4.0  # [pixel] range of the fit


def fit_corners(
    plane: np.ndarray, mask: np.ndarray, corners: np.ndarray, ways: np.ndarray, half: float
) -> np.ndarray:
    """Fit two blurred edges that cross to the pixels around each corner.

    Light and dark are m + c erf(u) erf(v), where u and v are the distances from two slightly bent lines over their
    blur. It is as even about the corner as the blur is, so that the corner does not shift. Missing pixels are not
    filled.

    Args:
        plane: Light, shape (rows, cols).
        mask: Pixels of the channel, same shape.
        corners: First x and y of each corner [pixel], shape (N, 2).
        ways: Directions of the board's two axes at each corner [pixel], shape (N, 2, 2): axis, then x and y.
        half: Radius of the windows [pixel].

    Returns:
        x and y of each corner, shape (N, 2); NaN: the fit failed.
    """
    x, y, light, weight = _windows(plane, mask, corners, half)
    angles = np.arctan2(ways[..., 1], ways[..., 0])
    count = len(corners)
    # level, contrast, x, y, direction of two lines, blur, their curvature
    state = np.zeros((count, 9))
    state[:, 4:6] = angles
    state[:, 6] = FIRST_BLUR
    state[:, :2] = _levels(x, y, light, weight, state)
    free = 9 if np.median((weight > 0).sum(1)) >= LEAST_PIXELS else 7
    damping = np.full(count, 1e-2)
    model, slopes = _model(x, y, state)
    cost = (weight * (light - model) ** 2).sum(1)
    for _ in range(ROUNDS):
        weighted = slopes[..., :free] * weight[..., None]
        normal = np.swapaxes(weighted, 1, 2) @ slopes[..., :free]
        gradient = np.einsum("npk,np->nk", weighted, light - model)
        scale = np.einsum("nkk->nk", normal)
        system = normal + (damping[:, None] * scale + 1e-12 * scale.max(1, keepdims=True))[
            ..., None
        ] * np.eye(free)
        step = np.linalg.solve(system, gradient[..., None])[..., 0]
        trial = state.copy()
        trial[:, :free] += step
        trial[:, 6] = np.clip(trial[:, 6], *BLURS)
        model_, slopes_ = _model(x, y, trial)
        cost_ = (weight * (light - model_) ** 2).sum(1)
        better = cost_ < cost
        moved = np.hypot(step[:, 2], step[:, 3])
        state = np.where(better[:, None], trial, state)
        model = np.where(better[:, None], model_, model)
        slopes = np.where(better[:, None, None], slopes_, slopes)
        damping = np.where(better, damping / 10, damping * 10)
        cost = np.minimum(cost, cost_)
        if (moved < 1e-4).all():
            break
    moved = np.hypot(state[:, 2], state[:, 3])
    is_lost = (moved > half / 2) | (np.abs(state[:, 1]) < 1e-9) | ~np.isfinite(cost)
    return np.where(is_lost[:, None], np.nan, np.rint(corners) + state[:, 2:4])


def _windows(plane, mask, corners, half):
    """Return x and y from the corner's nearest pixel, light over its spread and weights, (N, P) each."""
    reach = int(np.ceil(half))
    away = np.arange(-reach, reach + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(away, away, indexing="ij"))
    near = np.hypot(dx, dy) <= half
    dx, dy = dx[near], dy[near]
    middle = np.rint(corners).astype(int)
    cols, rows = middle[:, :1] + dx, middle[:, 1:] + dy
    is_inside = (rows >= 0) & (rows < plane.shape[0]) & (cols >= 0) & (cols < plane.shape[1])
    rows, cols = rows.clip(0, plane.shape[0] - 1), cols.clip(0, plane.shape[1] - 1)
    light = plane[rows, cols]
    x = np.broadcast_to(dx.astype(float), light.shape)
    y = np.broadcast_to(dy.astype(float), light.shape)
    weight = (mask[rows, cols] & is_inside).astype(float)
    spread = np.std(light, axis=1, keepdims=True) + 1e-12
    return x, y, light / spread, weight


def _levels(x, y, light, weight, state):
    """Return level and contrast of the first lines, least squares, (N, 2)."""
    guess = state.copy()
    guess[:, :2] = 0, 1
    shape, _ = _model(x, y, guess)
    total = weight.sum(1)
    mean, level = (weight * shape).sum(1) / total, (weight * light).sum(1) / total
    aside = shape - mean[:, None]
    contrast = (weight * aside * light).sum(1) / ((weight * aside**2).sum(1) + 1e-12)
    return np.stack([level - contrast * mean, contrast], axis=1)


def _model(x, y, state):
    """Return the light (N, P) and its slopes (N, P, 9)."""
    m, c, x0, y0, first, second, blur, *bends = (state[:, k, None] for k in range(9))
    dx, dy = x - x0, y - y0
    steps, falls, along, across = [], [], [], []
    for angle, bend in zip((first, second), bends, strict=True):
        cos, sin = np.cos(angle), np.sin(angle)
        t, n = dx * cos + dy * sin, dy * cos - dx * sin
        away = (n + bend * t * t) / (np.sqrt(2) * blur)
        steps.append(scipy.special.erf(away))
        falls.append(2 / np.sqrt(np.pi) * np.exp(-(away**2)) / (np.sqrt(2) * blur))
        # slopes of the distance by x0, y0, angle
        across.append((-2 * bend * t * cos + sin, -2 * bend * t * sin - cos, -t + 2 * bend * t * n))
        along.append((t, away * np.sqrt(2) * blur))
    one, two = c * steps[1] * falls[0], c * steps[0] * falls[1]
    ones = np.ones_like(dx)
    slopes = [
        ones,
        steps[0] * steps[1],
        one * across[0][0] + two * across[1][0],
        one * across[0][1] + two * across[1][1],
        one * across[0][2],
        two * across[1][2],
        -(one * along[0][1] + two * along[1][1]) / blur,
        one * along[0][0] ** 2,
        two * along[1][0] ** 2,
    ]
    return m + c * steps[0] * steps[1], np.stack(slopes, axis=-1)
