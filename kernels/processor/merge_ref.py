"""rate = sum used w n / sum used w t: see the contract."""

import numpy as np


def merge(raw, *, dark, gain, time, floor, ceiling, photon=True, margin=3.2, period=(1, 1)):
    """Return the stage's result, see `merge.py`."""
    dark, gain, time, floor, ceiling = (
        np.asarray(values, np.float64)[:, None, None]
        for values in (dark, gain, time, floor, ceiling)
    )
    raw = np.asarray(raw, np.float64)
    electrons, full = (raw - dark) / gain, (np.ceil(ceiling) - dark) / gain
    ways = [
        [neighbours(size, sign * step) for sign in (-1, 0, 1)]
        for size, step in zip(raw.shape[1:], period, strict=True)
    ]
    around = sum(electrons[:, rows][:, :, cols] for rows in ways[0] for cols in ways[1]) - electrons
    mean = around / 8
    light = np.maximum(mean, 0) if photon else 0
    plausible = mean + margin * np.sqrt(light + floor) <= full
    plausible[0] = True
    rate = (
        np.maximum((plausible * mean).sum(axis=0) / (plausible * time).sum(axis=0), 0)
        if photon
        else 0
    )
    used = plausible & (raw < ceiling)
    used[0] = True
    weights = used * time / (rate * time + floor)
    return (weights * electrons).sum(axis=0) / (weights * time).sum(axis=0)


def neighbours(size, step):
    """Return each pixel's neighbour `step` away; if outside, the opposite one or itself."""
    here = np.arange(size)
    there, opposite = here + step, here - step
    outside, both = (there < 0) | (there >= size), (opposite < 0) | (opposite >= size)
    return np.where(outside, np.where(both, here, opposite), there)
