"""Joint bilateral means with detail and mask of a flash picture: float64, one tap at a time."""

import numpy as np

from gpusim.kernels.processor.flash import BETTER, HIGHLIGHT


def flash(ambient, flash, *, ambient_noise, flash_noise, full=np.inf, radius=8, reach=6.0):
    """Return the stage's result, see `flash.py`."""
    ambient, flash = np.asarray(ambient, np.float64), np.asarray(flash, np.float64)
    half_a = 1 / (2 * variance(ambient, ambient_noise))
    half_f = 1 / (2 * variance(flash, flash_noise))
    joint, own = Means(), Means()
    fullness = spread = 0
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            near = np.exp(-(dy**2 + dx**2) / (2 * (radius / 2) ** 2))
            a, f = shift(ambient, dy, dx), shift(flash, dy, dx)
            alike_f = ((f - flash) ** 2 * half_f).mean(axis=0)
            alike_a = ((a - ambient) ** 2 * half_a).mean(axis=0)
            joint.add(near * np.maximum(1 - alike_f / reach, 0) ** 2, np.stack([*a, *f, alike_f]))
            own.add(near * np.maximum(1 - alike_a / reach, 0) ** 2, a)
            fullness, spread = fullness + near * (f.max(axis=0) >= full), spread + near
    means = joint.total / joint.weight
    a_f, f_f = means[:3], means[3:6]
    v = means[6] - ((flash - f_f) ** 2 * half_f).mean(axis=0)
    share = np.maximum(v - 0.5, 0) / np.maximum(v, 0.5)
    detail = 1 + share * (flash - f_f) / np.maximum(f_f, np.sqrt(2 / half_f))
    known_f, known_a = (
        (mean**2 / variance(mean, noise)).sum(axis=0)
        for mean, noise in ((f_f, flash_noise), (a_f, ambient_noise))
    )
    mask = np.maximum(
        1 - step(known_f / np.maximum(BETTER * known_a, 1e-30) - 1),
        step(HIGHLIGHT * fullness / spread),
    )
    return (1 - mask) * a_f * detail + mask * own.total / own.weight


class Means:
    """Weighted sums."""

    total = weight = 0.0

    def add(self, weight, values):
        """Count `values` with `weight`."""
        self.total, self.weight = self.total + weight * values, self.weight + weight


def variance(values, noise):
    """Return the variance of every value."""
    noise = np.asarray(noise, np.float64)
    floor = noise[:, 3, None, None]
    return np.maximum(np.tensordot(noise[:, :3], np.maximum(values, 0), 1) + floor, floor)


def shift(planes, dy, dx):
    """Return the pixels (dy, dx) away; outside, those at the edge."""
    rows, cols = planes.shape[1:]
    return planes[
        :,
        np.clip(np.arange(rows) + dy, 0, rows - 1)[:, None],
        np.clip(np.arange(cols) + dx, 0, cols - 1),
    ]


def step(t):
    """Return 0 below 0, 1 above 1, smooth between."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)
