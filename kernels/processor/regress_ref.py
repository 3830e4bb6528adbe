"""Local fits of slopes and bends that all channels share: float64, see the contract."""

import numpy as np

from gpusim.kernels.processor.trust_ref import place_displacements

ROUND, NARROWEST, WIDEST, WIDTH, NOISE = 0.8, 0.45, 2.0, 1.3, 0.5
CUT, PEDESTAL, SLOPE, BEND, ROUNDING, TINT = 9.0, 1e-3, 1.0, 10.0, 1e-5, 0.25


def regress(raw, displacement, trusted, *, cfa, table, balance, reference=0, enlarge=1.0):
    """Return the stage's result, see `regress.py`."""
    frames = Frames(raw, displacement, trusted, cfa, table, balance, reference)
    rows, cols = raw.shape[1:]
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    level = frames.level(y, x)
    round_ = np.broadcast_to(np.array([1, 0, 1]) / ROUND**2, (rows, cols, 3))
    found, count, weight = frames.fit(y, x, round_, level)
    shares = (1 / frames.balance)[:, None, None]
    guide = (found * shares).sum(axis=0) / shares.sum()
    noise = np.where(count > 0, TINT / np.where(count > 0, count, 1), 0)
    means, spreads = tint_statistics(found - guide, noise)
    variance = 9 * np.pi / 5 * ROUND**2 / np.maximum(weight, 1e-20)
    ellipses = shape(guide, variance)
    high, wide = round(rows * enlarge), round(cols * enlarge)
    y, x = (np.mgrid[:high, :wide] + 0.5) / enlarge - 0.5
    at = nearest(y, rows), nearest(x, cols)
    found, count, _ = frames.fit(y, x, ellipses[at], np.maximum(guide[at], 0))
    luminance = (found * shares).sum(axis=0) / shares.sum()
    mean = means[:, *at]
    ratio = spreads[:, *at] * count
    found = luminance + mean + ratio / (ratio + TINT) * (found - luminance - mean)
    return (found - (found * shares).sum(axis=0) / shares.sum() + luminance) * shares


def nearest(place, size):
    """Return the nearest pixels inside."""
    return np.clip(np.floor(place + 0.5).astype(int), 0, size - 1)


def shape(guide, variance):
    """Return the inverse covariances (rows, cols, 3) of the kernels."""
    rows, cols = guide.shape
    edge = np.pad(guide, 1, mode="edge")
    slopes = (edge[2:, 1:-1] - edge[:-2, 1:-1]) / 2, (edge[1:-1, 2:] - edge[1:-1, :-2]) / 2
    tensor, total = 0, 0
    for j in range(-3, 4):
        for k in range(-3, 4):
            share = (1 - (j * j + k * k) / 20) ** 4
            v, u = (
                np.clip(np.arange(rows) + j, 0, rows - 1),
                np.clip(np.arange(cols) + k, 0, cols - 1),
            )
            g = np.stack([slope[np.ix_(v, u)] for slope in slopes], axis=-1)
            tensor = tensor + share * g[..., :, None] * g[..., None, :]
            total += share
    values, vectors = np.linalg.eigh(tensor / total)
    signal = np.maximum(values - NOISE * variance[..., None], 1e-6 * variance[..., None])
    sigma = np.clip(WIDTH * (variance[..., None] / signal) ** 0.25, NARROWEST, WIDEST)
    inverse = np.einsum("yxak,yxk,yxbk->yxab", vectors, sigma**-2, vectors)
    return np.stack([inverse[..., 0, 0], inverse[..., 0, 1], inverse[..., 1, 1]], axis=-1)


def tint_statistics(tints, noise):
    """Return means, and variances less noise, of tints (channels, rows, cols) over 7 x 7 pixels."""
    rows, cols = tints.shape[1:]
    mean, square, total = np.zeros(tints.shape), np.zeros(tints.shape), 0
    for j in range(-3, 4):
        for k in range(-3, 4):
            share = (1 - (j * j + k * k) / 20) ** 4
            v, u = (
                np.clip(np.arange(rows) + j, 0, rows - 1),
                np.clip(np.arange(cols) + k, 0, cols - 1),
            )
            tap = tints[:, v][:, :, u]
            mean += share * tap
            square += share * tap**2
            total += share
    mean /= total
    return mean, np.maximum(square / total - mean**2 - noise, 0)


class Frames:
    """The samples of all frames. Arguments as of `regress`."""

    def __init__(self, raw, displacement, trusted, cfa, table, balance, reference):
        self.table = np.asarray(table, np.float64)
        self.raw, self.balance = raw, np.asarray(balance, np.float64)
        self.trusted, self.cfa = np.asarray(trusted, np.float64), np.asarray(cfa)
        self.reference, (rows, cols) = reference, raw.shape[1:]
        self.channel = self.cfa[
            np.arange(rows)[:, None] % self.cfa.shape[0], np.arange(cols) % self.cfa.shape[1]
        ]
        self.tiles = np.asarray(displacement, np.float64)
        self.wide = reach_of(self.cfa)

    def iterate_frames(self, y, x):
        """Yield number, trust and places of each frame for places of the reference."""
        rows, cols = self.raw.shape[1:]
        block = (nearest(y, rows) // self.cfa.shape[0], nearest(x, cols) // self.cfa.shape[1])
        for i in range(len(self.raw)):
            move = 0
            if i != self.reference:
                move = self.displacements(i, y, x)
            yield i, self.trusted[i][block], np.stack([y, x], axis=-1) + move

    def displacements(self, i, y, x):
        """Return displacements [pixel] at places, from those at pixels: both are linear."""
        rows, cols = (n + 2 for n in self.raw.shape[1:])
        wide = place_displacements(self.tiles[i], 4 * rows, 4 * cols, self.cfa.shape)
        if y.shape == self.raw.shape[1:]:
            return wide[: y.shape[0], : y.shape[1]]
        from scipy.interpolate import RegularGridInterpolator

        axes = np.arange(4 * rows), np.arange(4 * cols)
        # below 0, the first tiles go on
        inner = RegularGridInterpolator(axes, wide, bounds_error=False, fill_value=None)
        return inner(np.stack([y, x], axis=-1))

    def level(self, y, x):
        """Return the mean of the nearest 3 x 3 samples of all frames, balanced."""
        rows, cols = self.raw.shape[1:]
        dark, scale, shot, floor, _ = self.table
        total = weight = np.zeros(y.shape)
        for i, share, at in self.iterate_frames(y, x):
            own = share / (shot[i] + floor[i])
            near = np.floor(at + 0.5).astype(int)
            for j in (-1, 0, 1):
                for k in (-1, 0, 1):
                    v, u = near[..., 0] + j, near[..., 1] + k
                    inside = (v >= 0) & (v < rows) & (u >= 0) & (u < cols)
                    v, u = v.clip(0, rows - 1), u.clip(0, cols - 1)
                    total = total + own * inside * (self.raw[i][v, u] - dark[i]) * scale[i]
                    weight = weight + own * inside / self.balance[self.channel[v, u]]
        return np.maximum(total / np.where(weight > 0, weight, 1), 0)

    def fit(self, y, x, ellipses, level):
        """Return balanced values and weights (channels, ...), and the weights of all samples."""
        rows, cols = self.raw.shape[1:]
        dark, scale, shot, floor, full = self.table
        channels = len(self.balance)
        normal = np.zeros((*y.shape, channels + 5, channels + 5))
        right, all_ = np.zeros((*y.shape, channels + 5)), np.zeros(y.shape)
        reach = int(np.ceil(max(self.wide, 3 * WIDEST))) + 1
        for i, share, at in self.iterate_frames(y, x):
            near = np.floor(at + 0.5).astype(int)
            for j in range(-reach, reach + 1):
                for k in range(-reach, reach + 1):
                    v, u = near[..., 0] + j, near[..., 1] + k
                    usable = (v >= 0) & (v < rows) & (u >= 0) & (u < cols)
                    dy, dx = v - at[..., 0], u - at[..., 1]
                    v, u = v.clip(0, rows - 1), u.clip(0, cols - 1)
                    usable &= self.raw[i][v, u] < full[i]
                    e = (
                        ellipses[..., 0] * dy**2
                        + 2 * ellipses[..., 1] * dy * dx
                        + ellipses[..., 2] * dx**2
                    )
                    kernel = np.maximum(1 - e / CUT, 0) ** 4 * usable
                    near_by = np.maximum(1 - (dy**2 + dx**2) / self.wide**2, 0) ** 2 * usable
                    channel = self.channel[v, u]
                    b = self.balance[channel]
                    inverse = share / (b * (shot[i] * level + b * floor[i]))
                    weight = inverse * (kernel + PEDESTAL * near_by)
                    value = (self.raw[i][v, u] - dark[i]) * scale[i] * b
                    one = (channel[..., None] == np.arange(channels)).astype(np.float64)
                    bends = np.stack([dy, dx, dy**2 / 2, dy * dx, dx**2 / 2], axis=-1)
                    terms = np.concatenate([one, bends], axis=-1)
                    normal += weight[..., None, None] * terms[..., :, None] * terms[..., None, :]
                    right += (weight * value)[..., None] * terms
                    all_ += inverse * kernel
        count = normal[..., range(channels), range(channels)].copy()
        for k in range(5):
            at = channels + k
            normal[..., at, at] += ROUNDING * normal[..., at, at] + (SLOPE if k < 2 else BEND)
        for c in range(channels):  # a channel without samples takes the level
            normal[..., c, c] += count[..., c] == 0
            right[..., c] += np.where(count[..., c] == 0, level, 0)
        found = np.linalg.solve(normal, right[..., None])[..., :channels, 0]
        return np.moveaxis(found, -1, 0), np.moveaxis(count, -1, 0), all_


def reach_of(cfa):
    """Return the distance within which any place has a sample of every channel, and half a pixel."""
    py, px = cfa.shape
    y, x = np.mgrid[-2 * py : 3 * py, -2 * px : 3 * px]
    channel, worst = cfa[y % py, x % px], 0
    for v in np.arange(0, py, 0.5):
        for u in np.arange(0, px, 0.5):
            distance = (y - v) ** 2 + (x - u) ** 2
            for c in np.unique(cfa):
                worst = max(worst, distance[channel == c].min())
    return np.sqrt(worst) + 0.5
