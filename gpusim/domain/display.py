"""The display that the picture is made for."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange


@dataclass(frozen=True)
class Display:
    """A three-colour additive display; sRGB (IEC 61966-2-1) unless told otherwise.

    primaries: CIE 1931 (x, y) of red, green and blue; white: (x, y) of full red + green + blue.
    Raises BadData, OutOfRange.
    """

    name: str = "srgb"
    primaries: tuple = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
    white: tuple = (0.3127, 0.3290)

    def __post_init__(self):
        if np.shape(self.primaries) != (3, 2) or np.shape(self.white) != (2,):
            raise BadData("display: wanted (x, y) of three primaries and of the white")
        for x, y in (*self.primaries, self.white):
            if not (0 <= x <= 1 and 0 < y <= 1 and x + y <= 1):
                raise OutOfRange("display chromaticity", f"({x}, {y})", "x >= 0, y > 0, x + y <= 1")
        if abs(np.linalg.det(_xyz(self.primaries))) < 1e-6:
            raise BadData(f"display.primaries = {self.primaries}: they lie on one line")

    @property
    def xyz_from_rgb(self) -> np.ndarray:
        """Linear RGB to CIE XYZ, (3, 3), with Y = 1 for white.

        Each column is a primary's XYZ, scaled so that the three add up to the white (SMPTE RP 177).
        """
        primaries = _xyz(self.primaries)
        return primaries * np.linalg.solve(primaries, _xyz([self.white])[:, 0])

    @property
    def rgb_from_xyz(self) -> np.ndarray:
        """CIE XYZ to linear RGB, (3, 3)."""
        return np.linalg.inv(self.xyz_from_rgb)


def _xyz(chromaticities):
    """XYZ with Y = 1 of each (x, y), as columns."""
    x, y = np.array(chromaticities, np.float64).T
    return np.stack([x / y, np.ones_like(x), (1 - x - y) / y])


DISPLAYS = {"srgb": Display()}
