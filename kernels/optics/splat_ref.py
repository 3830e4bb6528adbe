"""out(x) = mosaic(x) + sum_h strength_h K(x - x_h): light by light, float64."""

import numpy as np


def splat(
    mosaic,
    cfa,
    places,
    strength,
    cores,
    profiles,
    step,
    parts,
    spread,
    centres=None,
    streaks=None,
    lines=None,
    corners=None,
    fine=1.0,
    width=1.0,
):
    """Return the stage's result, see `splat.py`."""
    out = np.array(mosaic, np.float64)
    y, x = np.indices(out.shape)
    channel = np.asarray(cfa)[y % len(cfa), x % len(cfa[0])]
    down, across = (s * (np.arange(p) - (p - 1) / 2) for s, p in zip(spread, parts, strict=True))
    half = np.shape(cores)[-1] // 2
    for (row, col, kernel, reach), scale in zip(
        np.asarray(places), np.asarray(strength, np.float64), strict=True
    ):
        dy, dx = y - row, x - col
        near = (abs(dy) <= half) & (abs(dx) <= half)
        far = ~near & (abs(dy) <= reach) & (abs(dx) <= reach)
        near &= (abs(dy) <= reach) & (abs(dx) <= reach)
        core, profile = (np.asarray(table[kernel], np.float64) for table in (cores, profiles))
        out[near] += scale * core[channel[near], dy[near] + half, dx[near] + half]
        cy, cx = (0, 0) if centres is None else np.asarray(centres[kernel], np.float64)
        py, px = dy[far] - cy, dx[far] - cx
        radius = np.hypot(py[:, None, None] + down[:, None], px[:, None, None] + across)
        radii = step * np.arange(profile.shape[1])
        for c, curve in enumerate(profile):
            own = channel[far] == c
            values = np.interp(radius[own], radii, curve).mean(axis=(1, 2))
            if streaks is not None:
                values += _streaks(
                    py[own],
                    px[own],
                    np.asarray(streaks[kernel][c], np.float64),
                    np.asarray(lines, np.float64),
                    float(corners[kernel][c]),
                    fine,
                    width,
                )
                values = np.maximum(values, 0)
            out[tuple(index[own] for index in np.nonzero(far))] += scale * values
    return out


def _streaks(y, x, streaks, lines, corner, fine, width):
    """Light of streaks and between them."""
    square, total, slants = y * y + x * x, 0.0, []
    at = (np.arange(streaks.shape[1]) - (streaks.shape[1] - 1) / 2) / fine
    for streak, (ny, nx) in zip(streaks, lines, strict=True):
        along, across = y * ny + x * nx, y * nx - x * ny
        value = np.interp(across, at, streak)
        value = value * np.where(
            abs(across) > at[-1], (at[-1] / np.where(across, across, 1)) ** 2, 1
        )
        total = total + along**2 / square**2 * value
        slants.append(along * across / (across**2 + width**2))
    if len(slants) > 1:
        both = sum(a * b for a, b in zip(slants, [*slants[1:], slants[0]], strict=True))
        total = total + corner * both / square**2
    return total
