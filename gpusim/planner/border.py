"""How much of the world around the frame takes part in the blur, and what the rest costs.

Beyond the surroundings a transform repeats itself: what falls into the frame from there is not what the border rule
says but what is on the other side. Of a line of light at distance d an Airy pattern brings 2 q / (pi^3 d) across it,
q the wavelength times the f-number over the pixel: the integral of its envelope q / (pi^3 r^3) over a half-plane.
"""

from math import hypot, pi, sqrt

CONTRAST = 0.5  # difference of far parts of a picture over its root mean square level; 0.3 .. 0.6 in photographs
SHARE = 0.6  # of a tolerance that the border may take


def border_error(reach, shape, q) -> tuple[float, float]:
    """Relative RMS error of the frame, and relative error at its corner.

    reach: pixels of surroundings. shape: (rows, cols). q: wavelength times f-number over pixel pitch.
    """
    spread = CONTRAST * 2 * q / pi**3
    # the mean over the n pixels of an axis of (spread / distance to either end of the surroundings)^2
    sides = [spread * sqrt(2 * (1 / reach - 1 / (reach + n)) / n) for n in shape]
    return hypot(*sides), 2 * spread / reach


def enough_reach(reach, shape, q, tolerance, level) -> int:
    """Pixels of surroundings, `reach` or as many more as keep SHARE of the tolerance, at most the frame's longer side.

    level: electrons of the frame's root mean square.
    """
    def keeps(reach):
        rms, corner = border_error(reach, shape, q)
        bounds = ((rms, tolerance.rms), (corner * sqrt(level), tolerance.p999_sigma),
                  (corner * sqrt(level), tolerance.max_sigma))
        return all(error <= SHARE * bound for error, bound in bounds if bound is not None)

    most = max(max(shape), reach)
    while reach < most and not keeps(reach):
        reach = min(2 * reach, most)
    return reach
