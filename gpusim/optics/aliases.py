"""What Gaussians on grids of splines err by, at every frequency of the light.

A wave of frequency f comes to a grid of spacing D (`gpusim.optics.splines`) as one of f0 = f - k / D, |f0| <= 1 / 2D,
by sinc^4(D f), is filtered there, and goes back as waves of all f0 + m / D, by sinc^4(D f0 + m). Wanted is the same
wave alone, by the Gaussians' transfer function. The rest is an error; filters of few taps are one, too.
"""

from functools import lru_cache

import numpy as np

from gpusim.optics.splines import axes, response

REPLICAS = 4  # of the grid's frequencies on each side, beyond which sinc^8 is below 1e-10
WIDE = 4.0  # spacings of a Gaussian from which on it has no error beside others'


def misses(shape: tuple[int, int], sigmas, energies, spacings: float, down, across) -> np.ndarray:
    """Mean square errors of waves whose own is 1, shape (channels, frequencies down, frequencies across).

    shape: samples of the frame. sigmas: of the Gaussians, shape (G,) [sample]. energies: of each in a channel, shape
    (channels, G). spacings: of splines in the first of the sigmas. down, across: the frequencies [1/sample].
    """
    found = np.zeros((len(energies), len(down), len(across)))
    for part, y, x in _levels(tuple(shape), tuple(sigmas), spacings, tuple(down), tuple(across)):
        each = energies[:, part, None]
        there = np.multiply.outer(y.there, x.there)  # and back as the same wave
        back = np.multiply.outer(y.back, x.back) - there**2
        wanted, filtered = (
            first.T @ (each * second) for first, second in ((y.wanted, x.wanted), (y.taps, x.taps))
        )
        found += there**2 * filtered**2 * back + (there**2 * filtered - wanted) ** 2
    return found


class _Waves:
    """Waves along an axis, of frequencies (n,) [1/sample], and the Gaussians of a level.

    there: by what they come to the grid, (n,). back: the squares of what goes back of each, all added up, (n,). taps,
    wanted: transfer functions of the filters and of the Gaussians, (G, n).
    """

    def __init__(self, axis, level, sigmas, at):
        step = axis.n / axis.size(level)
        own = step * at
        here = own - np.rint(own)
        self.there = np.sinc(own) ** 4
        self.back = sum(np.sinc(here + m) ** 8 for m in range(-REPLICAS, REPLICAS + 1))
        self.taps = np.array([response(sigma / step, here) for sigma in sigmas])
        self.wanted = np.exp(-2 * (np.pi * np.multiply.outer(sigmas, at)) ** 2)


@lru_cache(maxsize=64)
def _levels(shape, sigmas, spacings, down, across):
    """Which Gaussians are of each level that has any, and the waves of both axes there."""
    both, found = axes(shape, sigmas, "edge", spacings), []
    for level in range(both[0].levels):
        part = np.arange(len(sigmas))[both[0].of_level(level)]
        part = part[np.take(sigmas, part) < WIDE * min(axis.n / axis.size(level) for axis in both)]
        if len(part):
            found.append(
                (
                    part,
                    *(
                        _Waves(axis, level, np.take(sigmas, part), np.array(at))
                        for axis, at in zip(both, (down, across), strict=True)
                    ),
                )
            )
    return found
