"""Transfer functions of the codes of videos and photographs, by ITU-T H.273 (2023), table 3."""

import numpy as np

from gpusim.domain.display import DISPLAYS

TRANSFERS = {  # names by code points
    1: "bt709",
    6: "bt709",
    11: "bt709",
    14: "bt709",
    15: "bt709",
    4: "gamma2.2",
    5: "gamma2.8",
    8: "linear",
    13: "srgb",
    16: "pq",
    18: "hlg",
}
PQ_PEAK, HDR_WHITE = 10_000.0, 203.0  # [cd/m2], ST 2084 and ITU-R BT.2408
HLG_WHITE = 0.75  # code of white, BT.2408


def light_of(transfer: str, code: np.ndarray) -> np.ndarray:
    """Return the light of codes, black 0 and white 1. The largest code is 1; codes below 0 mirror positive ones.

    transfer: one of TRANSFERS. White of PQ and HLG is the graphics' white.
    """
    size = np.abs(code)
    if transfer == "bt709":
        light = np.where(size < 0.081, size / 4.5, ((size + 0.099) / 1.099) ** (1 / 0.45))
    elif transfer == "srgb":
        light = DISPLAYS["srgb"].decode(size)
    elif transfer == "pq":
        m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
        root = size ** (1 / m2)
        light = (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) * PQ_PEAK / HDR_WHITE
    elif transfer == "hlg":
        light = _hlg(size) / _hlg(np.array(HLG_WHITE))
    else:
        light = size ** {"linear": 1.0, "gamma2.2": 2.2, "gamma2.8": 2.8}[transfer]
    return np.copysign(light, code)


def _hlg(code):
    a, b = 0.17883277, 0.28466892
    c = 0.5 - a * np.log(4 * a)
    return np.where(code <= 0.5, code**2 / 3, (np.exp((np.maximum(code, 0.5) - c) / a) + b) / 12)
