"""x = G (m |m| - offset + share lost(m)), m = inverse (p - R_0), p = axes root(x / G + offset), float64.

R_l = D_l + up(R_{l+1} - down(D_l)), D_l the mean of what 4 x 4 blocks of down^l(p) lose for noise, all but their mean.
"""

import numpy as np

from gpusim.kernels.processor.best import root_gain
from gpusim.kernels.processor.levels import root_loss

WALSH = np.array([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, -1, 1], [1, -1, 1, -1]]) / 2


def multiscale(planes, *, noise, axes, spread, share, gains=None, strength=1.0):
    """Return the stage's result, see `multiscale.py`."""
    planes = np.asarray(planes, np.float64)
    gain, read = root_gain(*noise), noise[1]
    if strength == 0 or gain == 0:
        return planes
    offset = 3 / 8 * gain + read**2 / gain
    shading = (
        1.0 if gains is None else _interpolate(np.asarray(gains, np.float64), planes.shape[1:])
    )
    values = planes / shading + offset
    values = np.tensordot(axes, np.sign(values) * np.sqrt(np.abs(values)), 1)
    limits = (2.2, *[2.6] * (len(planes) - 1))
    t = np.asarray(spread) * np.reshape(limits, (-1, 1, 1)) * strength * np.sqrt(gain) / 2
    noise_in = np.array([_find_noise(p, t[:, a]) for a, p in enumerate(values)])
    m = np.tensordot(np.linalg.inv(axes), values - noise_in, 1)
    near, far, *powers = root_loss(gain, read).astype(np.float64)
    lost = np.polyval(powers, np.minimum(1, far / (near + m**2)))
    share = np.reshape(share, (-1, 1, 1)) * min(1, strength)
    return shading * (m * np.abs(m) - offset + share * lost)


def _interpolate(nodes, shape):
    """Return nodes that are even from edge to edge at the pixels, linear between them."""
    for axis, n in enumerate(shape):
        place = (np.arange(n) + 0.5) / n * (nodes.shape[axis] - 1)
        before = place.astype(int)
        part = (place - before).reshape(-1, *[1] * (1 - axis))
        nodes = (1 - part) * nodes.take(before, axis) + part * nodes.take(before + 1, axis)
    return nodes


def _find_noise(p, t):
    """Return the noise in a plane. t: thresholds of the coefficients, (levels, 4, 4)."""
    noise = _find_block_noise(p, t[0])
    if len(t) == 1:
        return noise
    return noise + _up(_find_noise(_down(p), t[1:]) - _down(noise), p.shape)


def _find_block_noise(p, t):
    rows, cols = p.shape
    blocks = np.lib.stride_tricks.sliding_window_view(_mirror(p), (4, 4))
    c = WALSH @ blocks @ WALSH.T
    with np.errstate(divide="ignore", invalid="ignore"):
        c = np.where(c == 0, 0, c * np.clip(1.5 - c**2 / (2 * t**2), 0, 1))
    c[..., 0, 0] = 0
    c = WALSH.T @ c @ WALSH
    return (
        sum(c[3 - y : 3 - y + rows, 3 - x : 3 - x + cols, y, x] for y in range(4) for x in range(4))
        / 16
    )


def _mirror(p):
    """Return a plane with three more pixels on each side; what is beyond its other side is its last pixel."""
    for axis in (0, 1):
        n, i = p.shape[axis], np.arange(-3, p.shape[axis] + 3)
        i = np.where(i < 0, -1 - i, np.where(i >= n, 2 * n - 1 - i, i)).clip(0, n - 1)
        p = p.take(i, axis)
    return p


def _down(p):
    p = np.pad(p, [(0, n % 2) for n in p.shape], mode="edge")
    return (p[::2, ::2] + p[1::2, ::2] + p[::2, 1::2] + p[1::2, 1::2]) / 4


def _up(p, shape):
    for axis, n in enumerate(shape):
        i = np.arange(n)
        beside = (i // 2 + 2 * (i % 2) - 1).clip(0, p.shape[axis] - 1)
        p = 0.75 * p.take(i // 2, axis) + 0.25 * p.take(beside, axis)
    return p
