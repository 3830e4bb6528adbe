"""Creases of polygons' transfer functions against the integral over the overlap."""

import numpy as np
import pytest

from gpusim.domain.pupil import Pupil, noll
from gpusim.optics.creases import find_creases
from gpusim.optics.otf import transfer


@pytest.mark.parametrize("outline", [Pupil(6, 0, 0.2), Pupil(5, 0.2, 0.1), Pupil(4, 0.3, 1.0)])
def test_slopes_change_by_the_creases(outline):
    """Second differences over a step h across the line, over h, of the places -h .. h: they tend to the change as h.

    That of h less half of that of 2 h, twice, tends to it as h^2. O turns by at most 20 rad over a radius here: what is
    left is of (20 h)^2 20 = 1e-2 for h = 1e-3. The integral is good to 1e-10 / h = 1e-7.
    """
    waves = 0.1 * noll(8)
    waves[:3, :3] += 0.15 * noll(4) + 0.05 * noll(6)
    found, h = find_creases(outline, waves[None]), 1e-3
    places = np.linspace(-found.reach, found.reach, found.sizes.shape[-1])
    largest = 0.0
    for (ny, nx, offset, sign), sizes in zip(found.lines, found.sizes[0], strict=True):
        for k in np.array([0.2, 0.4, 0.7]) * len(places):
            t = places[int(k)]
            away = offset + np.array([-2, -1, 0, 1, 2]) * h
            x, y = away * nx - t * ny, away * ny + t * nx
            v = transfer(outline, waves[None], x, y)[0]
            near, far = (v[3] + v[1] - 2 * v[2]) / h, (v[4] + v[0] - 2 * v[2]) / (2 * h)
            change = 2 * near - far
            assert abs(change - 2 * sign * sizes[int(k)]) < 0.01
            largest = max(largest, abs(change))
    assert largest > 0.5


def test_crease_of_a_square_in_focus():
    """Sides of length L = sqrt(2): O is (1 - |x| / L') (1 - |y| / L') with L' = L / 2, of the side's half: 1 / L' at 0.

    In units of the cut-off, copies of a side L part at s = L / 2. Along x, at y = 0: a change of slope of
    -2 (1 - |x| / L') / L'; at the cut-off y = L' it is + (1 - |x| / L') / L', twice half of it.
    """
    found = find_creases(Pupil(4, 0, np.pi / 4), np.zeros((1, 1, 1)))
    reach = np.sqrt(0.5)
    assert found.reach == pytest.approx(reach)
    x = np.linspace(-reach, reach, found.sizes.shape[-1])
    shape = (1 - np.abs(x) / reach) / reach
    assert len(found.lines) == 6
    for line, sizes in zip(found.lines, found.sizes[0], strict=True):
        wanted = shape if line[2] == 0 else shape / 2
        np.testing.assert_allclose(sizes, wanted, atol=1e-12)
        assert line[2] == pytest.approx(0 if line[3] < 0 else reach)
