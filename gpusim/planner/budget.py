"""A tolerance as one relative error, and what is left of it."""

import numpy as np

from gpusim.domain.sensor import Sensor
from gpusim.domain.tolerance import Tolerance
from gpusim.planner.facts import Facts

# Local over relative RMS error where the noise is that of the RMS level: the 99.9 % quantile was at most 27 and the
# maximum at most 48 over dead leaves, charts and edges of ranks 3 to 7; both with room for larger frames.
QUANTILE_SIGMAS, MAXIMUM_SIGMAS = 40.0, 100.0


def limit_of(tolerance: Tolerance, sensor: Sensor, weights, facts: Facts) -> tuple[float, float]:
    """Relative RMS error that keeps every bound of the tolerance, and the electrons of the frame's RMS level.

    The noise's sigma at the RMS level is at most the root of that level, which is below saturation; an exposure
    time that is given tells it better.
    """
    level = sensor.saturation
    if sensor.exposure_time is not None:
        values = facts.spectra.values
        signal = np.einsum("cl,lm,cm->c", weights, values, weights)
        level = sensor.exposure_time * np.sqrt(signal.mean())
    sigmas = np.sqrt(max(level, 1.0))
    bounds = [(tolerance.rms, 1.0), (tolerance.p999_sigma, QUANTILE_SIGMAS * sigmas),
              (tolerance.max_sigma, MAXIMUM_SIGMAS * sigmas)]
    return min(bound / factor for bound, factor in bounds if bound is not None), max(level, 1.0)


def left_of(limit: float | None, error: float) -> float | None:
    """What an error leaves of a limit, at least half its square; None of none."""
    return None if limit is None else np.sqrt(max(limit**2 - error**2, limit**2 / 2))
