"""u_c = sum_k sum_g weights[c, k, g] (G_g * plane_k), a dense matrix for each axis, float64."""

import numpy as np


def far(onto, planes, weights, sigmas, cfa, border, margin=0, spacings=2.8):
    """Return the stage's result, see `far.py`."""
    onto, planes = np.array(onto, np.float64), np.asarray(planes, np.float64)
    light = 0.0
    for sigma, gains in zip(
        np.asarray(sigmas, np.float64),
        np.moveaxis(np.asarray(weights, np.float64), 2, 0),
        strict=True,
    ):
        down, across = (_spread(n, sigma, border, margin) for n in planes.shape[1:])
        light = light + down @ np.tensordot(gains, planes, 1) @ across.T
    if cfa is None:
        return onto + light
    y, x = np.indices(onto.shape)
    return (
        onto + np.take_along_axis(light, np.asarray(cfa)[y % len(cfa), x % len(cfa[0])][None], 0)[0]
    )


def _spread(n, sigma, border, margin):
    """Return weights of an axis's n samples, with the world beyond, in those inside the margin."""
    at, own = np.arange(margin, n - margin)[:, None], np.arange(n)
    if np.isinf(sigma):
        row = {
            "zero": np.zeros(n),
            "edge": np.bincount([0, n - 1], minlength=n) / 2,
            "reflect": np.full(n, 1 / n),
        }
        return np.tile(row[border], (len(at), 1))
    beyond = int(np.ceil(10 * sigma)) + 2 * n
    gauss = np.exp(-(np.arange(-beyond, beyond + 1) ** 2) / (2 * sigma**2))
    gauss /= gauss.sum()  # value i is at the distance i - beyond
    matrix = gauss[beyond + own - at]
    if border == "edge":
        below = np.cumsum(gauss)  # all up to a distance
        matrix[:, :1] += below[beyond - at - 1]
        matrix[:, -1:] += below[beyond + at - n]
    if border == "reflect":
        for world in range(-beyond // (2 * n) - 1, beyond // (2 * n) + 2):
            matrix += (world != 0) * _at(gauss, own + 2 * n * world - at) + _at(
                gauss, 2 * n * world - 1 - own - at
            )
    return matrix


def _at(gauss, distance):
    """Return values of a Gaussian at distances, 0 beyond its end."""
    middle = len(gauss) // 2
    return np.where(abs(distance) <= middle, gauss[middle + np.clip(distance, -middle, middle)], 0)
