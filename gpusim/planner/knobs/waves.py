"""What a lens spreads far from a point, beside its tail: waves of its pupil's rims.

A lens with rims rho in its pupil, where its wavefront is W waves, spreads at the distance r, beside its tail,

    2 q / (pi^3 r^3 (1 - e^2)) | sum of a cos(pi rho r / q - 3 pi / 4) exp(2 pi i W) |^2,

a = 1 of the outer rim and -sqrt(e) of the inner one, e the obscuration (Airy's pattern and an annulus's by the
asymptotic form of J1).
"""

from itertools import combinations
from math import pi, sqrt

import numpy as np
from numpy.polynomial.polynomial import polyval2d

from gpusim.planner.question import Question


def waves(question: Question, r, down, across) -> np.ndarray:
    """Energy per square sample of a point's waves, shape (L, *shape).

    r: distances [sample], of any shape. down, across: the direction's components, of that shape or one for all.
    """
    optics = question.optics
    hole = optics.pupil.obscuration
    rims = [(1.0, 1.0), *([(hole, -sqrt(hole))] if hole else [])]
    found = np.zeros((len(question.q), *np.shape(r)))
    for own, q, wave in zip(
        found, question.q, optics.waves(question.scene.wavelengths), strict=True
    ):
        for rho, a in rims:
            own -= a * a / 2 * np.sin(2 * pi * rho * r / q) * _seen(question, rho / q, down, across)
        for (one, a), (other, b) in combinations(rims, 2):
            path = polyval2d(one, 0.0, wave) - polyval2d(other, 0.0, wave)
            less, more = (one - other) / (2 * q), (one + other) / (2 * q)
            own += (
                a
                * b
                * np.cos(2 * pi * path)
                * (
                    np.cos(2 * pi * less * r) * _seen(question, less, down, across)
                    - np.sin(2 * pi * more * r) * _seen(question, more, down, across)
                )
            )
        own *= 2 * q / (pi**3 * (1 - hole**2)) / r**3
    return found


def _seen(question, frequency, down, across):
    """What pixels leave of a wave of this frequency [1/sample] in this direction."""
    optics, left = question.optics, 1.0
    for along, cell, side, spots in zip(
        (down, across), question.cell, question.aperture, optics.birefringence, strict=True
    ):
        wave = frequency * along
        left = left * np.sinc(cell * wave) * np.cos(pi * spots / question.pitch * wave)
        if question.ratio > 1:  # samples, which show it as a slower one, are integrated over pixels
            left = left * np.sinc(side * question.ratio * (wave - np.rint(wave)))
    return left * np.exp(-2 * (pi * optics.diffuser / question.pitch * frequency) ** 2)
