"""When the rows of a frame are exposed, as weights of pictures taken at a few instants."""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.flicker import Flicker


def shutter_weights(
    times, rows, exposure_time, row_time, start=0.0, flicker: Flicker | None = None
) -> np.ndarray:
    """Weights w with  sum_k w[y, k] r(times[k]) = integral of r(t) l(t) dt over the exposure of row y.

    Row y is open from start + y row_time to start + y row_time + exposure_time; r is linear between the instants, so
    the integral of a rate with second derivative r'' errs by at most exposure_time h^2 |r''| / 8, h the longest step
    (Davis and Rabinowitz 1984, Methods of Numerical Integration, 2.1).

    times: instants of the pictures [s], rising, shape (n,); a single one is a scene that stands still. exposure_time,
    row_time: [s]; row_time = 0 exposes all rows at once. start: when the first row opens [s]. flicker: l, the
    brightness of the light, on the clock of the times; None: 1.
    Returns shape (rows, n) [s], nowhere negative; without flicker the weights of a row add up to exposure_time.
    Raises BadData when the instants do not rise, OutOfRange for the other numbers and when the instants do not cover
    the exposure of all rows.
    """
    times = np.asarray(times, np.float64)
    is_series = times.ndim == 1 and times.size and np.isfinite(times).all()
    if not is_series or (np.diff(times) <= 0).any():
        raise BadData(
            f"times: shape {times.shape}; wanted one or more finite instants in seconds, rising"
        )
    if not rows >= 1:
        raise OutOfRange("rows", rows, "a whole number, rows >= 1")
    if not 0 < exposure_time < np.inf:
        raise OutOfRange("exposure_time", f"{exposure_time} s", "0 < exposure_time < inf")
    if not 0 <= row_time < np.inf:
        raise OutOfRange(
            "row_time", f"{row_time} s", "0 <= row_time < inf; 0 exposes all rows at once"
        )
    if not np.isfinite(start):
        raise OutOfRange("start", f"{start} s", "a finite time")
    opens = np.arange(rows) * float(row_time)
    closes = opens + exposure_time
    if len(times) == 1:
        if flicker is None:
            return np.full((rows, 1), float(exposure_time))
        light = flicker.since(start)
        return (light.integrals(closes)[0] - light.integrals(opens)[0])[:, None]
    latest = max(abs(start), *np.abs(times[[0, -1]]))
    rounding = 1e-9 * exposure_time + 4 * np.finfo(float).eps * latest
    times = times - start
    if times[0] > rounding or times[-1] < closes[-1] - rounding:
        raise OutOfRange(
            "times",
            f"{times[0] + start:.9g} .. {times[-1] + start:.9g} s",
            f"instants that cover {start:.9g} .. {start + closes[-1]:.9g} s, from when the first of "
            f"{rows} rows opens to when the last one closes; give pictures of that whole interval",
        )
    before, after = times[:-1], times[1:]
    low, high = np.maximum(before, opens[:, None]), np.minimum(after, closes[:, None])
    weights = np.zeros((rows, len(times)))
    if flicker is not None:
        own = flicker.since(start)
        from_low, moment_low = own.integrals(low)
        from_high, moment_high = own.integrals(np.maximum(high, low))
        light = from_high - from_low  # between two instants, and of the later one: linear in time
        later = ((moment_high - moment_low) - light * before) / (after - before)
        weights[:, :-1] += light - later
        weights[:, 1:] += later
        return np.maximum(weights, 0)  # of rounding
    # of the exposure that falls between two instants, (rows, n - 1)
    length = np.maximum(high - low, 0)
    # of the later one: linear, so its mean is the middle's
    share = ((low + high) / 2 - before) / (after - before)
    weights[:, :-1] += length * (1 - share)
    weights[:, 1:] += length * share
    return weights * (exposure_time / weights.sum(axis=1, keepdims=True))
