"""Masks for the pupil that are made from a formula, by name."""

import re

import numpy as np

from gpusim.domain.errors import UnknownName
from gpusim.domain.mask import Mask

GAUSSIAN = 64  # cells along a side
WIDTH = 0.5  # standard deviation of its amplitude [radius]
PRIMES = (3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61)
NAMES = ("gaussian", *(f"mura-{prime}" for prime in PRIMES))


def mask_pattern(name: str) -> Mask:
    """Return a mask by its name.

    Args:
        name: "gaussian", an apodisation whose amplitude falls to 0.14 at the rim, or "mura-13" (and other primes up to
            61), a modified uniformly redundant array of 13 x 13 cells: nearly half of them are open, and its periodic
            autocorrelation is flat.

    Returns:
        The mask.

    Raises:
        UnknownName: There is no such mask.

    Source:
        Gottesman and Fenimore, Applied Optics 28, 4344 (1989).
    """
    if name == "gaussian":
        at = (np.arange(GAUSSIAN) + 0.5) / GAUSSIAN * 2 - 1
        return Mask(np.exp(-(at[:, None] ** 2 + at**2) / (2 * WIDTH**2)))
    found = re.fullmatch(r"mura-(\d{1,3})", name)
    if found is None or int(found[1]) not in PRIMES:
        raise UnknownName("optics.mask", name, NAMES)
    count = int(found[1])
    is_square = np.isin(np.arange(count), np.arange(1, count) ** 2 % count)
    is_open = is_square[:, None] == is_square
    is_open[:, 0], is_open[0] = True, False
    return Mask(is_open)
