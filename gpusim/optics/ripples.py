"""Ripples of band-limited light: samples that are seen between their places.

At u samples along an axis, light of a sample that is displaced by d is sin(pi (u - d)) / (pi (u - d)): far from it,
(-1)^u / (pi u) times a factor that depends on d only. A world of many samples has the sum, which changes slowly from
place to place, up to (-1)^u. Light that changes slowly has no ripples.
"""

import numpy as np

PLACES = 17  # along an axis, at which sums are taken
BEYOND = 128  # samples that go on beyond an edge; the last one counts half


def places_among(n: int) -> np.ndarray:
    """Return places between n samples, from the first to the last, shape (PLACES, 1)."""
    return np.floor(np.linspace(0, n - 1, PLACES))[:, None] + 0.5


def ripple(away: np.ndarray, period: float, near: float = 0.0) -> np.ndarray:
    """Return a sample's ripples without their sign at a distance from it, in a world that repeats itself.

    Args:
        away: Distance, no whole number [sample].
        period: Of the world [sample]; inf: it does not repeat itself.
        near: Distance within which ripples are smaller, 1 / (pi u) becomes u / (pi (u^2 + near^2)) [sample].
    """
    away = away + 1j * near
    if period == np.inf:
        return (1 / (np.pi * away)).real
    turn = np.pi * away / period
    return (1 / (period * (np.sin(turn) if period % 2 else np.tan(turn)))).real


def world_ripples(
    at: np.ndarray, n: int, border: str, near: float = 0.0, period: float = np.inf
) -> np.ndarray:
    """Return ripples of n unit samples, and of what the border makes of them, up to (-1)^u: (places, n).

    Args:
        at: Places, shape (places, 1).
        n: Number of samples.
        border: "zero", "edge" or "reflect".
        near: See `ripple`.
        period: Of the world behind another border than "reflect", see `ripple`.
    """
    if border == "reflect":
        own = np.arange(n)
        found = ripple(at - own, 2 * n, near) - ripple(at + 1 + own, 2 * n, near)
        return (1 - 2 * (own % 2)) * found
    more = BEYOND if border == "edge" else 0
    own = np.arange(-more, n + more)
    wide = (1 - 2 * (own % 2)) * ripple(at - own, period, near)
    found = wide[:, more : more + n]
    if more:
        wide[:, [0, -1]] /= 2
        found[:, 0] += wide[:, :more].sum(axis=1)
        found[:, -1] += wide[:, -more:].sum(axis=1)
    return found
