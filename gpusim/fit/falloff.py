"""Smooth surfaces fitted to blocks of a flat, and the choice among them."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import ArrayLike

from gpusim.domain.short_repr import short_repr
from gpusim.fit.planes import field_place

# models that are tried: kind, order of a polynomial in rows and columns, and last even power of the field height. Of a
# sum both stand for themselves, in a product they are multiplied. The round one is the exponential of even powers of
# the height about the fall-off's own middle, and of a tilt: causes of a fall-off multiply.
MODELS = (
    *(
        ("sum", order, power)
        for order, power in (
            *((1, 4), (2, 4), (2, 6), (2, 8), (4, 6), (4, 8), (4, 10)),
            *((6, 8), (6, 10), (8, 10), (10, 10)),
        )
    ),
    *(("product", 1, power) for power in (4, 6, 8)),
    *(("product", 2, power) for power in (4, 6, 8, 10)),
    *(("round", 1, power) for power in (2, 4, 6, 8, 10)),
)
# score of a parameter, between Akaike's 2 and the logarithm of 4,000 blocks, 8.3. Of 2, 3, 4, 6 and 8.3 it had the
# least squared error in 100 lenses of the development; with 6 it is as good
PENALTY = 4.0
WIDE = ("sum", 8, 10)  # the model that finds blocks with dust
NEAR = 7  # blocks on a side of the neighbourhood of which dust differs
TAIL = 4.0  # robust standard deviations of a block that is left out: dust, a hot pixel
FAINT = 0.005  # dust that takes less of the light stays
PART = 3  # blocks on a side of a part of the frame
CLEAR = 5.5  # standard errors of a mean that is no chance: 2e-4 expected in 4,000 parts
MIDDLE = 0.05  # standard deviation of the middle of round fall-offs, of half the frame's diagonal
ROUNDS = 12
STEP = 0.1  # longest step of the middle
PRECISE = 1e-7  # step that changes nothing
DARKEST = 1e-3  # of the median: a block's least light in weights


@dataclass(frozen=True, eq=False)
class Falloff:
    """Response of a channel to even light over the frame.

    Args:
        model: Kind, order and power, one of `MODELS`.
        coefficients: Of a sum or a product: of the model's functions. Of a round fall-off: field point (y, x) of its
            middle, tilt along y and x, coefficients of even powers of the height. Shape (n,).
        error: Relative standard error in the four corners, see `frame_corners`.
        left: Relative residuals of blocks, (rows, cols); NaN: left out.
        miss: Largest mean of them in a part of the frame that is no chance, see `PART`; 0: there is none.
    """

    model: tuple[str, int, int]
    coefficients: np.ndarray
    error: np.ndarray
    left: np.ndarray
    miss: float

    __repr__ = short_repr

    def at(self, rows: ArrayLike, cols: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
        """Return the response at rows and columns [pixel] that broadcast, 1 in the frame's middle."""
        y, x = np.broadcast_arrays(*(np.asarray(at, np.float64) for at in (rows, cols)))
        here = _respond(self.model, self.coefficients, y.ravel(), x.ravel(), shape)
        row, col = (np.array([(n - 1) / 2]) for n in shape)
        return np.asarray(here / _respond(self.model, self.coefficients, row, col, shape)).reshape(
            y.shape
        )


def frame_corners(shape: tuple[int, int]) -> tuple[tuple[int, int, str], ...]:
    """Return row, column and name of the frame's corners."""
    bottom, right = shape[0] - 1, shape[1] - 1
    return (
        (0, 0, "upper left"),
        (0, right, "upper right"),
        (bottom, 0, "lower left"),
        (bottom, right, "lower right"),
    )


def fit_falloff(
    plane: np.ndarray, rows: np.ndarray, cols: np.ndarray, shape: tuple[int, int]
) -> Falloff | None:
    """Fit the smooth surface that explains means of blocks with few parameters.

    Args:
        plane: Means, shape (m, n).
        rows: Row of the middle of a block's pixels [pixel], shape (m,).
        cols: Its column, shape (n,).
        shape: Rows and columns of the frame.

    Returns:
        The fall-off; None: there are too few blocks.

    Source:
        Akaike, IEEE Trans. Automatic Control 19 (1974) 716; Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413.
    """
    y, x = (axis.ravel() for axis in np.meshgrid(rows, cols, indexing="ij"))
    middle = np.median(plane)
    seen = plane.ravel() / middle
    # shot noise's variance grows with the light; the pixels' own unevenness with its square
    light = scipy.ndimage.gaussian_filter(plane / middle, 2).ravel()
    weight = np.maximum(light, DARKEST) ** -0.5
    kept, spread = _smooth_blocks(plane.shape, y, x, seen, weight, shape)
    end_rows, end_cols = (
        np.array([place[k] for place in frame_corners(shape)], float) for k in (0, 1)
    )
    fits = []
    for model in MODELS:
        found, slopes = _solve(model, y[kept], x[kept], seen[kept], weight[kept], shape, spread)
        count, size = int(kept.sum()), len(found)
        if 2 * size > count:
            continue
        left = seen - _respond(model, found, y, x, shape)
        squares = float(((weight * left)[kept] ** 2).sum())
        score = count * np.log(squares / count + 1e-30) + PENALTY * size
        ends = _slope(model, found, end_rows, end_cols, shape)
        covariance = squares / max(count - size, 1) * np.linalg.pinv(slopes.T @ slopes)
        variance = np.einsum("ij,jk,ik->i", ends, covariance, ends)
        fits.append(
            (score, model, found, left, _respond(model, found, end_rows, end_cols, shape), variance)
        )
    if not fits:
        return None
    score, model, found, left, ends, variance = min(fits, key=lambda one: one[0])
    # models that explain the blocks nearly as well differ in the corners
    weights = np.exp([-(one[0] - score) / 2 for one in fits])
    apart = np.array([(one[4] - ends) ** 2 for one in fits])
    error = np.sqrt(variance + (weights @ apart) / weights.sum()) / ends
    left = (np.where(kept, left, np.nan) / (seen - left)).reshape(plane.shape)
    return Falloff(model, found, error, left, _largest_miss(left, weight.reshape(plane.shape)))


def _largest_miss(left, weight):
    """Return the largest mean of neighbouring blocks' relative residuals that is no chance, or 0."""
    there = np.isfinite(left)
    own = np.where(there, left, 0.0)
    even = own / weight  # of even noise
    noise = 1.4826 * np.median(np.abs(even[there]))
    count, total, chance = (
        PART**2 * scipy.ndimage.uniform_filter(one, PART, mode="constant")
        for one in (there.astype(float), own, even)
    )
    is_miss = np.abs(chance) > CLEAR * noise * np.sqrt(np.maximum(count, 1))
    return float(np.abs(total / np.maximum(count, 1))[is_miss].max(initial=0.0))


def _smooth_blocks(size, y, x, seen, weight, shape):
    """Return the blocks that are as their neighbours, no dust and no hot pixels, and the weighted blocks' noise."""
    slopes = _slope(WIDE, None, y, x, shape)
    if len(seen) < 2 * slopes.shape[1]:
        return np.ones(len(seen), bool), 0.0
    found = np.linalg.lstsq(slopes * weight[:, None], seen * weight, rcond=None)[0]
    left = (seen - slopes @ found).reshape(size)
    away = np.abs((left - scipy.ndimage.median_filter(left, NEAR)).ravel() * weight)
    spread = 1.4826 * np.median(away)
    return away <= np.maximum(FAINT * seen * weight, TAIL * spread), float(spread)


def _solve(model, y, x, seen, weight, shape, spread):
    """Return a model's coefficients and its weighted slopes (N, n), least squares."""
    if model[0] != "round":
        slopes = _slope(model, None, y, x, shape) * weight[:, None]
        return np.linalg.lstsq(slopes, seen * weight, rcond=None)[0], slopes
    return _solve_round(model, y, x, seen, weight, shape, spread)


def _solve_round(model, y, x, seen, weight, shape, spread):
    """Return the same of a round fall-off: Gauss and Newton's steps, halved until they help."""
    found = np.zeros(5 + model[2] // 2)
    prior = np.zeros((2, len(found)))
    prior[:, :2] = np.eye(2) * spread / MIDDLE

    def miss(values):
        left = (seen - _respond(model, values, y, x, shape)) * weight
        return np.append(left, -prior @ values)

    # the logarithm is linear but for the middle
    columns = _slope(model, found, y, x, shape)[:, 2:]
    found[2:] = np.linalg.lstsq(columns, np.log(np.maximum(seen, DARKEST)), rcond=None)[0]
    left = miss(found)
    for _ in range(ROUNDS):
        slopes = np.vstack([_slope(model, found, y, x, shape) * weight[:, None], prior])
        step = np.linalg.lstsq(slopes, left, rcond=None)[0]
        step *= min(1, STEP / max(np.abs(step[:2]).max(), 1e-12))
        while (
            np.abs(step).max() > PRECISE and not left @ left > (again := miss(found + step)) @ again
        ):
            step /= 2
        if np.abs(step).max() <= PRECISE:
            break
        found, left = found + step, again
    return found, slopes


def _respond(model, found, rows, cols, shape):
    """Return a model's response at pixels, (N,)."""
    if model[0] != "round":
        return _slope(model, found, rows, cols, shape) @ found
    y, x = field_place(rows, cols, shape)
    square = (y - found[0]) ** 2 + (x - found[1]) ** 2
    return np.exp(polynomial.polyval(square, found[4:]) + found[2] * y + found[3] * x)


def _slope(model, found, rows, cols, shape):
    """Return how the response at pixels changes with the coefficients, (N, n)."""
    kind, order, power = model
    if kind == "round":
        y, x = field_place(rows, cols, shape)
        v, u = y - found[0], x - found[1]
        square = v * v + u * u
        steep = -2 * polynomial.polyval(square, polynomial.polyder(found[4:]))
        powers = [square**k for k in range(power // 2 + 1)]
        columns = np.stack([v * steep, u * steep, y, x, *powers], axis=1)
        return columns * _respond(model, found, rows, cols, shape)[:, None]
    y, x = (2 * (at + 0.5) / n - 1 for at, n in zip((rows, cols), shape, strict=True))
    table = chebyshev.chebvander2d(y, x, [order, order]).reshape(len(y), order + 1, order + 1)
    parts = [table[:, i, j] for i in range(order + 1) for j in range(order + 1 - i)]
    square = np.asarray(np.hypot(*field_place(rows, cols, shape))) ** 2
    if kind == "product":
        parts = [part * square**k for part in parts for k in range(power // 2 + 1)]
    else:
        parts += [square**k for k in range(order // 2 + 1, power // 2 + 1)]
    return np.stack(parts, axis=1)
