"""The formula of `highlights.py` in float64, block means by padding with pixels of no weight."""

import numpy as np

from gpusim.kernels.common.nodes_ref import interpolate
from gpusim.kernels.processor.highlights import BLOCK, DARK, FIRST, LAST, MOST, TRUST


def highlights(camera, neutral, *, saturation):
    """Return the stage's result, see `highlights.py`."""
    camera = np.asarray(camera, np.float64)
    neutral = np.asarray(neutral, np.float64)
    rows, cols = camera.shape[1:]
    clipped = np.clip((camera / saturation - FIRST) / (LAST - FIRST), 0, 1)
    light = np.maximum(camera, 0)
    total = light.sum(0)
    weight = np.minimum(light.max(0) / saturation, 1) ** 4 * (1 - clipped).prod(0)
    weight = np.where(np.isfinite(total) & (total > 0), weight, 0.0)
    with np.errstate(all="ignore"):
        color = np.where(weight > 0, light / total, 0.0)
    filled = _fill(_sum_blocks(np.concatenate([color * weight, weight[None]]), BLOCK), neutral)
    rho = interpolate(
        filled, (np.arange(rows) + 0.5) / BLOCK - 0.5, (np.arange(cols) + 0.5) / BLOCK - 0.5
    )
    known = 1 - clipped
    most = (light / rho).max(0)
    t = ((known * light).sum(0) + DARK * most) / ((known * rho).sum(0) + DARK)
    rebuilt = np.clip(t * rho, camera, np.maximum(MOST * saturation, camera))
    is_whole = np.isfinite(total) & (clipped.max(0) > 0)
    return np.where(is_whole, camera + clipped * (rebuilt - camera), camera)


def _sum_blocks(values, size):
    """Return sums over blocks of size x size, the last ones of what there is."""
    rows, cols = (-(-n // size) for n in values.shape[1:])
    padded = np.zeros((len(values), rows * size, cols * size))
    padded[:, : values.shape[1], : values.shape[2]] = values
    return padded.reshape(len(values), rows, size, cols, size).sum((2, 4))


def _fill(sums, neutral):
    """Return the colours of blocks, from coarse to fine."""
    if max(sums.shape[1:]) > 1:
        coarse = _fill(_sum_blocks(sums, 2), neutral)
        rows, cols = sums.shape[1:]
        around = interpolate(
            coarse, (np.arange(rows) + 0.5) / 2 - 0.5, (np.arange(cols) + 0.5) / 2 - 0.5
        )
    else:
        around = (neutral / neutral.sum())[:, None, None]
    return (sums[:-1] + TRUST * around) / (sums[-1] + TRUST)
