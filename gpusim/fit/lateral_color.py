"""Lateral colour over the field from the corners of boards, channel by channel.

A channel's image height over the main channel's is 1 + axis + corner * h^2, where h is the height over the corner's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from gpusim.domain.short_repr import short_repr
from gpusim.fit.board import Board
from gpusim.fit.bundle import ENOUGH_VIEWS
from gpusim.fit.estimate import Estimate

CONSTANT = "optics.lateral_color of "
AXIS = "lateral colour on the axis of "
CORNER = "lateral colour of a corner over the axis of "
NOTICED = 0.05  # [pixel] by which a constant misses the curve that is worth a line
ROUNDS = 6


@dataclass(frozen=True, eq=False)
class LateralCurve:
    """Excess of a channel's image height over the main channel's.

    Args:
        values: On the axis, and what a corner has more [1], shape (2,).
        covariance: Of the values, shape (2, 2).
    """

    values: np.ndarray
    covariance: np.ndarray

    __repr__ = short_repr

    def mean(self, size: tuple[int, int]) -> tuple[float, float]:
        """Return the constant excess that is nearest in the squares over a frame, and half its interval [1]."""
        shares = np.array([1.0, _corner_share(size)])
        return float(shares @ self.values), 1.96 * float(np.sqrt(shares @ self.covariance @ shares))

    def largest_miss(self, size: tuple[int, int]) -> float:
        """Return how far the constant excess misses the curve somewhere in a frame [pixel]."""
        heights = np.linspace(0, 1, 101)
        gaps = self.values[0] + self.values[1] * heights**2 - self.mean(size)[0]
        return float(np.abs(gaps * heights).max() * np.hypot(*size) / 2)


def _corner_share(size):
    """Return the mean of h^4 over the mean of h^2 over a frame."""
    x, y = (np.square(np.linspace(-1, 1, 101) * n / np.hypot(*size)) for n in size)
    squares = x[None, :] + y[:, None]
    return float(np.mean(squares**2) / np.mean(squares))


def measure_lateral_color(
    boards: Sequence[Board], middle: np.ndarray, size: tuple[int, int]
) -> dict[str, LateralCurve]:
    """Measure the lateral colour of each other channel, least squares over all corners.

    Args:
        boards: Views of a board.
        middle: x and y of the principal point [pixel], shape (2,).
        size: Columns and rows of the frame.

    Returns:
        The curve of each channel.
    """
    return {letter: _curve(boards, letter, middle, size) for letter in boards[0].offsets}


def _curve(boards, letter, middle, size):
    """Return a channel's curve. offset = excess * position + a shift of the whole channel."""
    parts = []
    for one in boards:
        ones, zeros = np.ones(len(one.places)), np.zeros(len(one.places))
        x, y = (one.corners - middle).T
        squares = (x**2 + y**2) / (np.hypot(*size) / 2) ** 2
        parts.append(
            np.concatenate(
                [
                    np.stack([x, x * squares, ones, zeros], 1),
                    np.stack([y, y * squares, zeros, ones], 1),
                ]
            )
        )
    seen = [one.offsets[letter].T.ravel() for one in boards]
    solved, scale = np.zeros(4), np.inf
    for _ in range(ROUNDS):  # Huber's weights against corners that failed
        left = [own - part @ solved for own, part in zip(seen, parts, strict=True)]
        weights = [np.minimum(1, 1.5 * scale / np.maximum(np.abs(one), 1e-12)) for one in left]
        normals = [(p * w[:, None]).T @ p for p, w in zip(parts, weights, strict=True)]
        pulls = [p.T @ (w * own) for p, w, own in zip(parts, weights, seen, strict=True)]
        solved = np.linalg.solve(sum(normals), sum(pulls))
        scale = 1.4826 * np.median(np.abs(np.concatenate(left))) + 1e-9
    covariance = scale**2 * np.linalg.inv(sum(normals))[:2, :2]
    if len(boards) >= ENOUGH_VIEWS:
        others = np.array(
            [
                np.linalg.solve(sum(normals) - normal, sum(pulls) - pull)[:2]
                for normal, pull in zip(normals, pulls, strict=True)
            ]
        )
        student = scipy.special.stdtrit(len(others) - 1, 0.975) / 1.96
        blocked = student**2 * (len(others) - 1) * np.cov(others.T, bias=True)
        covariance = blocked if np.trace(blocked) > np.trace(covariance) else covariance
    return LateralCurve(solved[:2], covariance)


def lateral_estimates(
    curves: Mapping[str, LateralCurve], size: tuple[int, int], main: str, sources: tuple[str, ...]
) -> dict[str, Estimate]:
    """Return the estimates of lateral colour: the constant of the camera file, and the curve over the field.

    Args:
        curves: See `measure_lateral_color`.
        size: Columns and rows of the frame.
        main: The main channel.
        sources: Names of the files.

    Returns:
        Estimates by name.
    """
    found = {}
    for letter, curve in curves.items():
        reaches = 1.96 * np.sqrt(np.diag(curve.covariance))
        rows = {
            CONSTANT: (*curve.mean(size), f"image height over {main}'s, minus one, over the frame"),
            AXIS: (curve.values[0], reaches[0], f"image height over {main}'s, minus one"),
            CORNER: (curve.values[1], reaches[1], "grows as the square of the height"),
        }
        for name, (value, reach, note) in rows.items():
            ends = float(value - reach), float(value + reach)
            found[name + letter] = Estimate(float(value), *ends, "", sources, note)
    return found


def lateral_curves(estimates: Mapping[str, Estimate]) -> dict[str, tuple[float, float]]:
    """Return the curve over the field of each channel: on the axis, and what a corner has more [1].

    Args:
        estimates: Of `lateral_estimates`, others are left out.

    Returns:
        Values by channel.
    """
    letters = [key.removeprefix(AXIS) for key in estimates if key.startswith(AXIS)]
    return {
        letter: (estimates[AXIS + letter].value, estimates[CORNER + letter].value)
        for letter in letters
    }


def describe_varying(curves: Mapping[str, LateralCurve], size: tuple[int, int]) -> tuple[str, ...]:
    """Return a line if constants, as optics.lateral_color has them, miss the curves over the field."""
    misses = {letter: curve.largest_miss(size) for letter, curve in curves.items()}
    if not misses or max(misses.values()) < NOTICED:
        return ()
    words = ", ".join(f"{miss:.2g} pixel in {letter}" for letter, miss in misses.items())
    return (
        f"lateral colour over the field: optics.lateral_color is constant and misses up to {words}; point "
        "spreads from frames of edges hold it: add these",
    )
