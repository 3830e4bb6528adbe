"""Light that straight blades throw along their normals, from beyond what a transform sees."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

import gpusim as gs
from gpusim.domain.pupil import Pupil
from gpusim.optics.lenses import open_lens
from gpusim.optics.outside import at_samples, unseen_light

SIDE, REACH, FARTHEST, Q = 64, 24, 224, 2.0


@pytest.mark.parametrize("blades", [5, 6, 8])
@pytest.mark.parametrize("border", ["edge", "reflect"])
def test_what_is_not_seen_comes_along_the_normals(blades, border):
    """Against sums over the pupil's own kernel. The mean over directions, which was taken for it, is no part of it.

    The kernel ends at FARTHEST, beyond which there is REACH / FARTHEST of the light; cells of REACH / 12 smooth it.
    """
    optics = replace(
        gs.open_camera("mono").optics,
        model="diffraction",
        f_number=4.0,
        pupil=Pupil(blades, 0.0, 0.3),
    )
    pitch = 550e-9 * optics.working_f_number / Q
    lens = open_lens(optics, pitch, (1.0, 1.0), (SIDE, SIDE))
    kernel, tail = lens.kernels([550.0], (0.0, 0.0), 2 * FARTHEST + 1)[0], lens.tail
    image = np.random.default_rng(blades).random((SIDE, SIDE))
    image = gaussian_filter(image, 4, mode="nearest")
    image = (image - image.min()) / np.ptp(image)
    period = SIDE + 2 * REACH
    seen = np.pad(image, REACH, mode={"edge": "edge", "reflect": "symmetric"}[border])
    at = np.arange(-FARTHEST, SIDE + FARTHEST)
    again = seen[np.ix_((at + REACH) % period, (at + REACH) % period)]
    world = np.pad(image, FARTHEST, mode={"edge": "edge", "reflect": "symmetric"}[border])
    true = fftconvolve(world - again, kernel, "valid")
    assert tail.line_share == 1 and len(tail.lines) == blades
    rows = np.arange(SIDE)

    def wrong(**along):
        coarse = unseen_light(
            image, (period, period), border, REACH / 12, tail.strength * Q, **along
        )
        found = at_samples(coarse, image.shape, (period, period), rows, rows)
        return np.sqrt(np.mean((found - true) ** 2) / np.mean(true**2))

    own = wrong(rays=tail.lines, straight=tail.line_share)
    assert own < 0.45 and own < 0.7 * wrong()
