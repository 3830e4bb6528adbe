"""How long to expose."""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName

METHODS = ("full", "mean")


def exposure_value(f_number, exposure_time):
    """Exposure value [stop], EV = log2(N^2 / T), of f-number N [1] and exposure time T [s].

    Arrays broadcast. Source: Farrell and Wandell, Image Systems Simulation, section 5.7.
    """
    return np.log2(np.square(f_number) / exposure_time)


def auto_exposure(electron_rate, saturation: float, level: float = 0.95, method: str = "full") -> float:
    """Exposure time [s] at which the mean signal reaches `level` of saturation.

    electron_rate: mean electrons per second of every pixel [e- s-1], any shape.
    saturation: electrons at which a pixel stops counting [e-] (`Sensor.saturation`).
    level: fraction of `saturation` to reach [1].
    method: "full": the brightest pixel reaches it, so nothing clips; "mean": the average pixel does, so a small bright
        lamp does not leave the rest dark, at the price of clipping whatever is brighter.
    Raises BadData when there is no light to expose for, OutOfRange, UnknownName.
    """
    if method not in METHODS:
        raise UnknownName("exposure method", method, METHODS)
    if not 0 < level <= 1:
        raise OutOfRange("level", level, "0 < level <= 1")
    if not 0 < saturation < np.inf:
        raise OutOfRange("saturation", f"{saturation} e-", "0 < saturation < inf")
    rate = float(np.max(electron_rate) if method == "full" else np.mean(electron_rate, dtype=np.float64))
    if not 0 < rate < np.inf:
        raise BadData(f"automatic exposure: the {method} signal is {rate:.4g} e-/s; a dark scene needs "
                      "exposure_time_ms in the camera file")
    return level * saturation / rate
