"""Tone curves by name: formulas from linear light to the light that is shown, and their inverses.

All rise, keep black at 0 and display white at 1, and act on red, green and blue alike.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

GAIN = 2.0  # of "reinhard": the slope at black
POWER, HALF = 1.4, 0.55  # of "sigmoid": exponent, and the semi-saturation to this power
BASE = 5.0  # of "logarithmic": light of display white


@dataclass(frozen=True)
class Tone:
    """A tone curve.

    Attributes:
        undo: Function from the light that is shown, 0 .. 1, to linear light, white = 1.
        words: The curve in words, for reports.
    """

    undo: Callable[[np.ndarray], np.ndarray]
    words: str


def _undo_reinhard(shown):
    """Return L of D = (a L + L^2) / (1 + a L), the root of L^2 + a (1 - D) L = D, in the form without a difference."""
    half = GAIN * (1 - shown) / 2
    return shown / (half + np.sqrt(half * half + shown))


def _undo_sigmoid(shown):
    """Return L of D = (1 + h) L^n / (L^n + h)."""
    return (HALF * shown / (1 + HALF - shown)) ** (1 / POWER)


def _undo_logarithmic(shown):
    """Return L of D = log(1 + b L) / log(1 + b)."""
    return np.expm1(np.log1p(BASE) * shown) / BASE


# reinhard: Reinhard, Stark, Shirley & Ferwerda 2002, "Photographic tone reproduction for digital images", ACM Trans.
# Graph. 21, 267, equation 4, of the light GAIN L, with the smallest light that becomes white at GAIN.
# sigmoid: Naka & Rushton 1966, "S-potentials from colour units in the retina of fish", J. Physiol. 185, 536, the
# response L^n / (L^n + s^n), divided by that of white.
# logarithmic: Drago, Myszkowski, Annen & Chiba 2003, "Adaptive logarithmic mapping for displaying high contrast
# scenes", Comput. Graph. Forum 22, 419, equation 1.
TONES = {
    "reinhard": Tone(_undo_reinhard, "Reinhard's extended curve, slope 2 at black"),
    "sigmoid": Tone(_undo_sigmoid, "Naka and Rushton's sigmoid"),
    "logarithmic": Tone(_undo_logarithmic, "logarithmic, to base 6"),
}
NO_TONE = "none"
