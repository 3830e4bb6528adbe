"""Lines of frequencies across which a polygon's transfer function changes its slope, float64.

Two copies of the pupil at -s and s overlap in r. n is the normal of a side, t the place along the side:

- next to s = t along the side, both copies end at that side, and the overlap there at the nearer one: O has the part
  -|n s| g(t);
- next to s = inner n + t along the side, opposite sides of an even number are about to part: O has the part
  2 max(0, inner - n s) g(t).

g is the integral of exp(2 pi i (W(r + s) - W(r - s))) over the part of the side on which the copies meet, over the
pupil's area. Lengths are radii of the pupil, as in `gpusim.optics.otf`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval2d
from scipy.special import roots_legendre

from gpusim.domain.pupil import Pupil
from gpusim.optics.otf import separate
from gpusim.optics.series import peak_to_valley

PLACES = 64  # at which g is tabulated, for each wave of the wavefront and one more
NODES = 16  # of its integrals, for the same


@dataclass(frozen=True, eq=False)
class Creases:
    """Lines n s = offset, |t| <= reach, s = offset n + t (n_x, -n_y) in (y, x).

    lines: (lines, 4): normal (y, x), offset, and the sign of |n s - offset| g in O.
    sizes: g at even places t from -reach to reach, complex (bands, lines, places).
    """

    lines: np.ndarray
    reach: float
    sizes: np.ndarray


def find_creases(pupil: Pupil, waves) -> Creases:
    """Return the creases of a polygon's transfer functions with wavefronts (bands, n, n) [waves]."""
    waves = np.asarray(waves, np.float64)
    count, inner = pupil.sides.size, pupil.inner_radius
    reach = np.sin(np.pi / count)  # half of a side
    is_even = count % 2 == 0
    range_ = int(np.ceil(peak_to_valley(waves))) + 1
    shapes, factors = separate(waves)
    t = np.linspace(-reach, reach, 2 * PLACES * range_ + 1)
    x, gauss = roots_legendre(NODES * range_)
    length = (reach - np.abs(t))[:, None]  # half of the part on which the copies meet
    along = length * x

    def size(angle, second):
        """Values g of the side at `inner` of the first copy and at `second` of the other."""
        ny, nx = np.sin(angle), np.cos(angle)

        def path(distance, place):
            at = distance * nx - place * ny, distance * ny + place * nx
            return np.array([polyval2d(*at, shape) for shape in shapes]).reshape(-1, *place.shape)

        phase = np.tensordot(
            factors, path(inner, along + t[:, None]) - path(second, along - t[:, None]), 1
        )
        return (np.exp(2j * np.pi * phase) * length) @ gauss / (np.pi * pupil.area)

    lines, sizes = [], []
    for angle in pupil.sides[: count // 2 if is_even else count]:
        normal = [np.sin(angle), np.cos(angle)]
        lines.append([*normal, 0.0, -1.0])
        own = size(angle, inner)
        if is_even:  # the opposite side
            own = own + size(angle + np.pi, inner)[..., ::-1]
        sizes.append(own)
    if is_even:
        for angle in pupil.sides:
            lines.append([np.sin(angle), np.cos(angle), inner, 1.0])
            sizes.append(size(angle, -inner))
    return Creases(np.array(lines), float(reach), np.stack(sizes, axis=1))
