"""Pixels much coarser than lambda N: rays with diffraction's tail, against sums over replicas and geometry."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.pupil import Pupil, disc_power
from gpusim.optics.geometric import ray_error, ray_kernel, ray_tables
from gpusim.optics.otf import hopkins, transfer

STILL = (0.0, 0.0), 0.0, (0.0, 0.0)  # neither a low-pass filter nor a diffuser nor a displacement


def folded(otf, q, aperture, size):
    """The sum over replicas of a round transfer function, at the frequencies of a period: (size, size // 2 + 1)."""
    reach = int(np.ceil(1 / q)) + 1
    total, more = np.zeros((size, size // 2 + 1)), np.arange(-reach, reach + 1)
    for i, fy in enumerate(np.fft.fftfreq(size)):
        for j, fx in enumerate(np.arange(size // 2 + 1) / size):
            y, x = fy + more, fx + more
            weights = np.outer(np.sinc(aperture[0] * y), np.sinc(aperture[1] * x))
            s = q * np.hypot(y[:, None], x)
            inside = s < 1
            total[i, j] = (otf(s[inside]) * weights[inside]).sum()
    return total


@pytest.mark.parametrize("aperture", [(1.0, 1.0), (0.7, 0.9)])
def test_focus(aperture):
    """Airy's transfer function, folded by 5,000 replicas; diffraction blurs by 0.02, which is found to 3 %."""
    q = 0.04
    true = folded(lambda s: hopkins(s, 0.0), q, aperture, 6)
    found = ray_tables(Pupil(), np.zeros((1, 3, 3)), np.array([q]), 6, 6, aperture, *STILL)
    error = np.abs(found[0] - true).max()
    assert error < ray_error(Pupil(), np.zeros((1, 3, 3)), q) < 2e-3
    assert error < 0.05 * np.abs(true - true[0, 0]).max()


@pytest.mark.parametrize(("q", "waves"), [(0.05, 40.0), (0.05, 10.0), (0.1, 20.0)])
def test_defocus_of_a_circle(q, waves):
    wave = waves * disc_power(1)[None]
    true = folded(lambda s: hopkins(s, waves), q, (1.0, 1.0), 6)
    found = ray_tables(Pupil(), wave, np.array([q]), 6, 6, (1.0, 1.0), *STILL)
    assert np.abs(found[0] - true).max() < ray_error(Pupil(), wave, q) < 0.1


def test_hexagon():
    """The transfer function by quadrature, at frequencies so low that replicas do not count (below 1e-3)."""
    q = 0.05
    outline, wave = Pupil(6, 0.0, 0.2), 20.0 * disc_power(1)[None]
    found = ray_tables(outline, wave, np.array([q]), 64, 64, (1.0, 1.0), *STILL)[0]
    at = np.arange(1, 6)
    fy, fx = np.repeat(at, 5) / 64, np.tile(at, 5) / 64
    true = transfer(outline, wave, fx * q, fy * q)[0] * np.sinc(fy) * np.sinc(fx)
    wrong = np.abs(found[1:6, 1:6].ravel() - true)
    assert wrong.max() < ray_error(outline, wave, q) + 1e-3


def test_disc_of_rays():
    """A disc of radius 7.5 pixels, moved: pixels inside have 1 / area, and its energy and middle are its own."""
    q = 0.01
    wave = 7.5 / (4 * q) * disc_power(1)
    kernel = ray_kernel(Pupil(), wave, q, (0.3, -0.6), 25, (1.0, 1.0), (0.0, 0.0), 0.0)
    y, x = np.indices(kernel.shape) - 12.0
    assert abs(kernel.sum() - 1) < 1e-6
    assert abs((kernel * y).sum() - 0.3) < 1e-3 and abs((kernel * x).sum() + 0.6) < 1e-3
    inside = np.hypot(y - 0.3, x + 0.6) < 6.5
    # rays are counted in bins of 1/16 pixel, linear between them: 1e-2 of a pixel's light where three rays meet a bin
    assert np.abs(kernel[inside] * np.pi * 7.5**2 - 1).max() < 0.02
    assert kernel[np.hypot(y - 0.3, x + 0.6) > 8.5].sum() == 0


@pytest.mark.parametrize(("blades", "tolerance"), [(0, "video"), (6, None)])
def test_frames(blades, tolerance):
    """A disc of 15 pixels at q = 0.04 was refused. So were f/0.1 and pixels of 100 um."""
    camera = gs.open_camera("mono")
    wide = replace(
        camera.optics,
        f_number=1.4,
        focal_length=0.05,
        defocus=15 * 20e-6 * 1.4,
        pupil=Pupil(blades),
    )
    for optics, pitch in ((wide, 20e-6), (replace(camera.optics, f_number=0.1), 100e-6)):
        one = replace(camera, optics=optics, sensor=replace(camera.sensor, pixel_pitch=pitch))
        simulate = gs.Simulator(one, device="numpy", tolerance=tolerance)
        frame = simulate(gs.chart("slanted-edge", size=(48, 32)), seed=1)
        assert np.isfinite(frame.mean).all() and frame.mean.max() > 0
