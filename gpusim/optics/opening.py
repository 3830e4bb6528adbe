"""The part of a pupil that its mask leaves open, as a pupil of its own.

Light of a small cell of the pupil spreads widely and changes slowly along the image, and most of its wavefront only
moves it. So the cell's rectangle is scaled to the square [-1, 1]^2, x = x_0 + b_x u: it is the pupil of a lens with the
f-number N / b_x along x and N / b_y along y. The slope of the wavefront at its middle becomes a displacement.
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.polynomial.polynomial import polyder, polygrid2d

from gpusim.domain.pupil import Pupil

ALONG = 17  # places along the opening at which slopes are taken


@dataclass(frozen=True)
class Opening:
    """A rectangle in the pupil, (y, x).

    Attributes:
        middle: Its middle [radius of the pupil].
        half: Halves of its sides [radius of the pupil].
    """

    middle: tuple[float, float] = (0.0, 0.0)
    half: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of(cls, pupil: Pupil) -> "Opening":
        """Return the least rectangle of cells with all of a pupil's light."""
        if pupil.mask is None:
            return cls()
        ends = [edges[[0, -1]] for edges in pupil.mask.pieces[:2]]
        (y0, y1), (x0, x1) = (end.tolist() for end in ends)
        return cls(((y0 + y1) / 2, (x0 + x1) / 2), ((y1 - y0) / 2, (x1 - x0) / 2))

    def scaled(self, wave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a wavefront as a polynomial of the scaled places, without its slope, and the slope.

        Args:
            wave: Coefficients [i, j] of x^i y^j [waves].

        Returns:
            Coefficients [i, j] of u^i v^j [waves], and the slopes along (v, u) at the middle [waves per half side].
        """
        wave = np.asarray(wave, np.float64)
        down, across = (
            _shifted_powers(len(wave), middle, half)
            for middle, half in zip(self.middle, self.half, strict=True)
        )
        found = across.T @ wave @ down
        slope = np.zeros(2)
        if len(wave) > 1:
            slope[:] = found[0, 1], found[1, 0]
            found[0, 1] = found[1, 0] = 0
        found[0, 0] = 0
        return found, slope

    def steepest(self, wave: np.ndarray, is_scaled: bool = True) -> float:
        """Return the largest slope of a wavefront in the opening.

        Args:
            wave: Coefficients of the scaled places, or of the pupil's [waves].
            is_scaled: Which of the two.

        Returns:
            [waves per half side], or [waves per radius].
        """
        if not wave.any():
            return 0.0
        u = np.linspace(-1, 1, ALONG)
        y, x = (middle + half * u for middle, half in zip(self.middle, self.half, strict=True))
        is_inside = np.hypot(y[:, None], x) <= 1 + 2 * max(self.half) / ALONG
        at = (u, u) if is_scaled else (x, y)
        slopes = [polygrid2d(*at, polyder(wave, axis=axis)).T for axis in (0, 1)]
        return float(np.hypot(*slopes)[is_inside].max())


def _shifted_powers(count, middle, half):
    """Coefficients [i, a] of u^a in (middle + half u)^i."""
    found = np.zeros((count, count))
    for i in range(count):
        for a in range(i + 1):
            found[i, a] = comb(i, a) * middle ** (i - a) * half**a
    return found
