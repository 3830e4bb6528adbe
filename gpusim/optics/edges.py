"""Where the circle of confusion jumps between pixels: the errors of blur by depth there, and where to cut layers."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gpusim.domain.stored import stored

MOST_LAYERS = 16
JUMP = 1.0  # [pixel] of circle of confusion between neighbours: more is an edge, less one surface that slopes
REMAINS = 0.1  # of a covariance over the pupil, after it was summed
STEP = 0.25  # [pixel] of circle of confusion between possible cuts of the picture
SAMPLES = 2**17  # of a picture: of a larger one some rows stand for all, but at edges
BLOCK = 32  # rows that are looked at together


@dataclass(frozen=True, eq=False)
class Edges:
    """Neighbouring pixels of different circles of confusion; arrays (n,), the nearer pixel's first.

    All edges are among them, and surfaces that slope in some rows of a large picture.

    near, far: signed circles of confusion [pixel]. light_near, light_far: brightness. weight: pairs that each stands
    for. lags, variation: mean square difference of brightness at these distances [pixel] within a surface. is_whole:
    whether all slopes are among them.
    """

    near: np.ndarray
    far: np.ndarray
    light_near: np.ndarray
    light_far: np.ndarray
    weight: np.ndarray
    lags: np.ndarray
    variation: np.ndarray
    is_whole: bool

    @classmethod
    def of(cls, confusion, light):
        """Pairs along rows and columns."""
        (rows, cols), every = confusion.shape, max(light.size // SAMPLES, 1)
        circles, lights = confusion.ravel(), light.ravel()
        even = np.arange(0, rows, every)
        chosen, stands_for = _sample_rows(light, even)
        pairs, weights = [], []

        def take(first, step, weight):
            second = first + step
            in_order = [circles[first], circles[second], lights[first], lights[second]]
            in_order = np.array(in_order, np.float64)
            pairs.append(np.where(in_order[0] > in_order[1], in_order[[1, 0, 3, 2]], in_order))
            weights.append(np.broadcast_to(weight, first.shape))

        for step, some, end in ((cols, chosen < rows - 1, cols), (1, np.s_[:], cols - 1)):
            at = chosen[some, None] * cols + np.arange(end)
            apart = np.abs(circles[at + step] - circles[at])
            y, x = np.nonzero((apart > 0) & (apart <= JUMP) if every > 1 else apart)
            take(at[y, x], step, stands_for[some][y])
        for step, first in _jumps(confusion) if every > 1 else ():
            take(first, step, 1.0)
        lags = [2**k for k in range(12) if 2**k < max(light.shape)]
        variation = np.array([_variation(confusion, light, lag, even) for lag in lags])
        if every > 1:
            # squares of a sum of two
            top = light[even].max()
            more = (
                np.square(np.maximum(light[chosen] - top, 0), dtype=np.float64).sum() / light.size
            )
            variation = (np.sqrt(variation) + np.sqrt(2 * more)) ** 2
        return cls(
            *np.concatenate(pairs, axis=1),
            np.concatenate(weights),
            np.array([0, *lags]),
            np.append(0.0, variation),
            every == 1,
        )

    @property
    def jumps(self):
        """Which of the pairs are edges."""
        return self.far - self.near > JUMP

    def plain_error(self, light, power):
        """Return the relative error of a blur by depth without occlusion, normalized by an even light's blur.

        At an edge between even surfaces f in front of b the picture is E_f I_f + (1 - E_f) I_b, E
        the edge spread of a disc; without occlusion it is (E_f I_f + (1 - E_b) I_b) / (1 + E_f -
        E_b). In addition each point of the pupil sees other parts of b than it should: the
        covariance of this with the variation of b.
        """
        if not self.jumps.any():
            return 0.0
        return float(
            np.sqrt((self._plain() * self.weight[self.jumps]).sum() / (power * light.size))
        )

    def slope_error(self, light, power):
        """Return the relative error on sloping surfaces, from using the visible point's kernel for the pixel.

        A pixel sees the surface at y = x + r(y) u, u even in the pupil. In terms of y its kernel is
        the point's kernel times 1 - u grad r, which moves the picture by r |grad r| / 4 (E[u_x^2] =
        1/4). A disc of radius r leaves about 0.75 / r of the gradients of a 1/f picture, and of any
        picture about the difference at 2 r over that distance.
        """
        some = ~self.jumps
        steep, radius = (self.far - self.near)[some] / 8, np.abs(self.near[some]) / 2
        lag = np.maximum(2 * radius, 1)
        left = np.interp(lag, self.lags, self.variation) * (radius / lag) ** 2
        own = (self.light_near - self.light_far)[some] * np.minimum(radius, 0.75)
        square = steep**2 * np.maximum(own**2, left) * self.weight[some]
        return float(np.sqrt(square.sum() / (power * light.size)))

    def _plain(self):
        some = self.jumps
        near, far = self.near[some] / 2, self.far[some] / 2
        step = (self.light_near - self.light_far)[some] ** 2
        return np.hypot(near, far) * (
            step * _edge("plain", near, far)
            + self._hidden_error(near, far)
            + self._covariance(far) * _edge("differs", near, far)
        )

    def _hidden_error(self, near, far):
        """Squared error of a hidden surface that is guessed from the visible picture next to it.

        It is the difference of pixels a lag apart, half the sum of the radii. The far kernel
        averages it over its chord, in which pieces of a lag's length are independent.
        """
        lag = (np.abs(near) + np.abs(far)) / 2
        pieces = 1 + 2 * np.abs(far) / np.maximum(lag, 1e-9)
        guess = np.interp(lag, self.lags, self.variation) / pieces
        return guess * _edge("hidden", near, far)

    def _layered_error(self, some):
        """Squared error of pairs in different layers: hidden surfaces are guessed.

        The product of transmission and background is exact if one of the two is in focus; otherwise
        their covariance over the pupil is summed, but for REMAINS of it.
        """
        near, far = self.near[some] / 2, self.far[some] / 2
        # a slope hides only its neighbourhood
        hidden = np.where(self.jumps[some], self._hidden_error(near, far), 0)
        covariance = self._covariance(far) * _edge("covariance", near, far)
        return np.hypot(near, far) * (hidden + REMAINS**2 * covariance)

    def _covariance(self, radius):
        """Squared covariance of a background within a disc with half of the disc, over the variance of that half.

        A background varies by half its structure function at 0.9 radii, the mean distance of two points of a disc; for
        gradients of all directions 36 % of that goes with the half, and of 1/f pictures gradients are two thirds.
        """
        return 0.36 * 2 / 3 * np.interp(0.9 * np.abs(radius), self.lags, self.variation) / 2

    def choose_cuts(self, low, high, enough):
        """Return circles of confusion at which to cut into layers, increasing, for a squared error below `enough`.

        Cuts are made one by one, each at the place that removes the most: the error without layers
        of the edges that it cuts, minus the error with layers of these and of the surfaces that it
        cuts.
        """
        some = self.jumps
        if not some.any():
            return np.empty(0)
        count = int(np.ceil((high - low) / STEP))
        bins = ((np.stack([self.near, self.far]) - low) / STEP).astype(int)
        first, last = np.clip(bins, 0, count - 1)
        if self.is_whole:
            smooth = (first != last) & ~some
            cost = _best_cover(first[smooth], last[smooth], self._layered_error(smooth), count)
        else:  # few of the pairs that a cut parts are in the rows that are looked at
            middle = (self.near[~some] + self.far[~some]) / 2
            parts = (self.far - self.near)[~some] / STEP * self.weight[~some]
            at = np.clip(np.rint((middle - low) / STEP).astype(int), 0, count)
            cost = np.bincount(at, self._layered_error(~some) * parts, count + 1)[:count]
        plain, layered = self._plain(), self._layered_error(some)
        first, last = first[some], last[some]
        cut = np.zeros(len(plain), bool)
        found: list[int] = []
        while len(found) < MOST_LAYERS - 1 and plain[~cut].sum() > enough:
            gain = _best_cover(first[~cut], last[~cut], (plain - layered)[~cut], count) - cost
            best = int(np.argmax(gain))
            if not gain[best] > 0:
                break
            # the middle of all that are as good
            same = np.flatnonzero(gain < gain[best] * (1 - 1e-9))
            best = (best + min((i for i in same if i > best), default=count) - 1) // 2
            cut |= (first < best) & (last >= best)
            found.append(best)
        return low + STEP * np.sort(np.array(found, float))

    def layered_error(self, cuts, light, power):
        """Return the relative error of a picture cut at `cuts`: at the cuts, and at the edges that stay whole."""
        apart = np.searchsorted(cuts, self.near) != np.searchsorted(cuts, self.far)
        left = self._plain()[~apart[self.jumps]].sum() if self.jumps.any() else 0.0
        parts = apart * 1.0
        if not self.is_whole:
            some, middle = ~self.jumps, (self.near + self.far) / 2
            near_cuts = (np.abs(middle - cut) <= STEP / 2 for cut in cuts)
            share = sum(near_cuts, np.zeros(len(middle))) * (self.far - self.near) / STEP
            parts[some] = (share * self.weight)[some]
        apart = parts > 0
        cut = (self._layered_error(apart) * parts[apart]).sum()
        return float(np.sqrt((left + cut) / (power * light.size)))


def _sample_rows(light, even):
    """Return rows, int (n,), and how many rows each stands for: even ones, and those with brighter light than these."""
    rows = len(light)
    if len(even) == rows:
        return even, np.ones(rows)
    most = light.max(axis=1)
    bright = np.flatnonzero(most > most[even].max())
    bright = np.union1d(bright, np.maximum(bright - 1, 0)).astype(int)
    others = np.setdiff1d(even, bright)
    chosen = np.union1d(others, bright)
    weight = np.where(np.isin(chosen, bright), 1.0, (rows - len(bright)) / max(len(others), 1))
    return chosen, weight


def find_changes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which rows and which columns have a value that differs from the one before it or beside it, bool each."""
    rows, cols = (np.zeros(n, bool) for n in values.shape)
    down, across = values[1:] != values[:-1], values[:, 1:] != values[:, :-1]
    rows[1:] |= down.any(axis=1)
    rows |= across.any(axis=1)
    cols[1:] |= across.any(axis=0)
    cols |= down.any(axis=0)
    return rows, cols


def span_of(some: np.ndarray) -> slice:
    """Return the slice from the first to the last of some entries of a line; empty: there are none."""
    at = np.flatnonzero(some)
    return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, 0)


def _jumps(confusion):
    """Yield the step from a pixel to its neighbour, and the index of each that differs from it by more than JUMP."""
    rows, cols = confusion.shape
    for begin in range(0, rows, BLOCK):
        some = confusion[begin : begin + BLOCK + 1]
        for step, differs in ((cols, some[1:] - some[:-1]), (1, np.diff(some[:BLOCK], axis=1))):
            y, x = np.nonzero(np.abs(differs, out=differs) > JUMP)
            if len(y):
                yield step, (y + begin) * cols + x


def _variation(confusion, light, lag, rows):
    """Mean square difference of brightness of pixels `lag` apart along rows or columns on one surface, by some rows."""
    total, count = 0.0, 0
    for axis in (0, 1):
        if light.shape[axis] > lag:
            first = rows[rows < len(light) - lag] if axis == 0 else rows
            if axis == 0:
                pairs = [(one[first], one[first + lag]) for one in (confusion, light)]
            else:
                pairs = [(one[first, :-lag], one[first, lag:]) for one in (confusion, light)]
            (before, after), (dark, bright) = pairs
            same = np.abs(after - before) <= JUMP
            total += float((((bright.astype(np.float64) - dark) ** 2) * same).sum())
            count += int(same.sum())
    return total / max(count, 1)


def _best_cover(first, last, values, count):
    """Sum of the values of all pairs that a cut before bin i parts, i = 0 .. count - 1: first < i <= last."""
    begins = np.bincount(first + 1, values, count + 1)
    return np.cumsum((begins - np.bincount(last + 1, values, count + 1))[:count])


def _edge(what, near, far):
    """Integral across a straight edge, over the root of the sum of the squared radii, which are signed."""
    angles, tables = _edge_tables()
    along = np.abs(near) * np.where(near * far < 0, -1, 1)
    return np.interp(np.arctan2(np.abs(far), along), angles, tables[what])


@lru_cache(maxsize=1)
def _edge_tables():
    """Return angles, and the tables of `_integrate_edges` by name."""
    angles, *tables = _integrate_edges()
    return angles, dict(zip(("plain", "hidden", "covariance", "differs"), tables, strict=True))


@stored
def _integrate_edges():
    """Integrals over t of squared errors for radii (cos, sin) of an angle: see `Edges`.

    The angles; then plain: between even surfaces. hidden: share of a pixel's light that is guessed. covariance:
    variance over the pupil of the occluder; differs: over the part of the pupil in which using b's
    kernel for f's is wrong.
    """
    angles = np.linspace(0, np.pi, 257)
    t = (np.arange(4000) + 0.5) / 2000 - 1
    tables = np.empty((4, 257))
    for k, angle in enumerate(angles):
        near, far = _edge_spread(t, abs(np.cos(angle))), _edge_spread(t, abs(np.sin(angle)))
        more = near - far
        wrong = np.abs(more) if angle <= np.pi / 2 else np.where(t > 0, 2 - near - far, near + far)
        tables[0, k] = 2 * np.mean((more * near / (1 + more)) ** 2)
        tables[1, k] = 2 * np.mean(((1 - near) * far) ** 2)
        tables[2, k] = 2 * np.mean(near * (1 - near))
        tables[3, k] = 2 * np.mean(wrong - more**2)
    return angles, *tables


def _edge_spread(t, radius):
    """Image of an edge, bright at t > 0, blurred by an even disc."""
    x = np.clip(t / max(radius, 1e-9), -1, 1)
    return 0.5 + (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi
