"""out(x) = mosaic(x) + sum_h strength_h K(x - x_h): light by light, float64."""

import numpy as np


def splat(mosaic, cfa, places, strength, cores, profiles, step, parts, spread):
    """Return the stage's result, see `splat.py`."""
    out = np.array(mosaic, np.float64)
    y, x = np.indices(out.shape)
    channel = np.asarray(cfa)[y % len(cfa), x % len(cfa[0])]
    points = spread * (np.arange(parts) - (parts - 1) / 2)
    size = np.shape(cores)[-1]
    for (row, col, kernel, reach), scale in zip(
        np.asarray(places), np.asarray(strength, np.float64), strict=True
    ):
        dy, dx = y - row, x - col
        near = (abs(dy) < size) & (abs(dx) < size)
        far = ~near & (abs(dy) <= reach) & (abs(dx) <= reach)
        near &= (abs(dy) <= reach) & (abs(dx) <= reach)
        core, profile = (np.asarray(table[kernel], np.float64) for table in (cores, profiles))
        out[near] += scale * core[channel[near], abs(dy[near]), abs(dx[near])]
        radius = np.hypot(dy[far][:, None, None] + points[:, None], dx[far][:, None, None] + points)
        radii = step * np.arange(profile.shape[1])
        for c, curve in enumerate(profile):
            own = channel[far] == c
            values = np.interp(radius[own], radii, curve).mean(axis=(1, 2))
            out[tuple(index[own] for index in np.nonzero(far))] += scale * values
    return out
