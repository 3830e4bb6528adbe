"""From linear display light to stored codes: the display's curve and the processor's tone curve."""

import numpy as np

from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData

STEPS = 60  # bisection steps: enough for float64


def decoding(display: Display, tone: tuple = ()):
    """Return the function from codes to the linear light before the tone curve.

    Args:
        display: The display.
        tone: Tone curve, see `gpusim.domain.processor.Processor`.

    Returns:
        Function of codes as fractions of the largest.

    Raises:
        BadData: The cubic between the nodes of the tone curve overflows.
    """
    if not tone:
        return display.decode
    # monotone: Fritsch & Carlson 1980, SIAM J. Numer. Anal. 17, 238
    from scipy.interpolate import PchipInterpolator

    scene = DISPLAYS["srgb"]
    x, y = np.array(tone).T
    with np.errstate(all="ignore"):
        shown = PchipInterpolator(x, y) if np.isfinite(np.diff(y) / np.diff(x)).all() else None
        if shown is None or not (np.isfinite(shown.c).all() and np.isfinite(scene.decode(x[-1]))):
            raise BadData(
                f"processor.tone: the cubic between its nodes, x = {x[0]:.6g} .. {x[-1]:.6g} as near as "
                f"{np.diff(x).min():.6g}, overflows; wanted nodes farther apart, and x <= 1000"
            )

    def light(codes):
        wanted = scene.encode(display.decode(np.asarray(codes, np.float64)))
        low, high = np.full(wanted.shape, x[0]), np.full(wanted.shape, x[-1])
        for _ in range(STEPS):
            middle = (low + high) / 2
            above = shown(middle) >= wanted
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return scene.decode(high)

    return light
