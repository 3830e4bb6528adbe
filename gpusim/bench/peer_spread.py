"""The point spread of an ideal lens over pixels, at 31 wavelengths, with gpusim and optics libraries."""

from collections.abc import Callable

import numpy as np
import scipy.fft
from scipy.special import j1

from gpusim.backends import Device
from gpusim.bench.peer_task import Task
from gpusim.kernels.stage import public_function

PITCH, F_NUMBER = 1.4e-6, 2.8  # of a pixel [m]; of the lens
BANDS = np.linspace(400e-9, 700e-9, 31)  # [m]
HALF = 32  # pixels around the middle one
PERIOD = 256  # of gpusim's transforms [pixel]; the light of a pattern beyond is 5e-7 of its peak
NODES = 24  # of Gauss's rule along a pixel for the truth: it converges to 1e-12 there
FEW_NODES = 6  # of the same rule in the base
FINE = 4  # samples of prysm's image along a pixel
PUPIL = 512  # samples across prysm's pupil


def make_spread(device: Device, bands: np.ndarray = BANDS) -> Task:
    """Return the task: light of a point in 65 x 65 pixels, integrated over each.

    The truth integrates Airy's pattern over each pixel in float64 by Gauss's rule. Errors are over
    the largest value of each wavelength.

    Args:
        device: The device of gpusim's form.
        bands: Wavelengths [m].
    """
    q = bands * F_NUMBER / PITCH
    truth, task = _integrate(q, NODES), Task("spread", "SciPy, Airy's pattern")

    def judge(run: Callable[[], np.ndarray]):
        found = np.asarray(run(), np.float64)
        most = np.abs(found - truth) / truth.max(axis=(1, 2), keepdims=True)
        return run, f"max {most.max():.1e}"

    task.add(task.base, lambda: judge(lambda: _integrate(q, FEW_NODES)))
    task.add("GalSim", lambda: judge(lambda: _by_galsim(q)), "galsim")
    task.add("prysm", lambda: judge(lambda: _by_prysm(bands)), "prysm")
    task.add("gpusim", lambda: judge(lambda: _by_gpusim(q, device)))
    return task


def _integrate(q, count):
    """Return Airy's pattern (Airy 1835) integrated over pixels by `count` nodes a side, (bands, n, n)."""
    offsets, weights = (array / 2 for array in np.polynomial.legendre.leggauss(count))
    at = np.arange(HALF + 1)[:, None] + offsets
    radius = np.hypot(at.ravel()[:, None], at.ravel())
    quarter = np.empty((len(q), HALF + 1, HALF + 1))
    for own, one in zip(quarter, q, strict=True):
        v = np.maximum(np.pi * radius / one, 1e-9)
        light = np.pi / (4 * one**2) * (2 * j1(v) / v) ** 2
        parts = light.reshape(HALF + 1, len(offsets), HALF + 1, len(offsets))
        own[:] = np.einsum("iajb,a,b->ij", parts, weights, weights)
    at = np.abs(np.arange(-HALF, HALF + 1))
    return quarter[:, at[:, None], at]


def _by_gpusim(q, device):
    tables = public_function("optics.airy")(q, 1.0, PERIOD, PERIOD, device=device)
    quarter = device.numpy(tables)
    whole = np.concatenate([quarter, quarter[:, -2:0:-1]], axis=1)
    light = scipy.fft.irfft2(whole, (PERIOD, PERIOD), workers=-1)
    at = np.arange(-HALF, HALF + 1)
    return light[:, at[:, None], at]


def _by_galsim(q):
    import galsim

    n = 2 * HALF + 1
    found = [galsim.Airy(lam_over_diam=one).drawImage(nx=n, ny=n, scale=1.0).array for one in q]
    return np.stack(found)


def _by_prysm(bands):
    from prysm.coordinates import cart_to_polar, make_xy_grid
    from prysm.geometry import circle
    from prysm.propagation import Wavefront

    width, n = 10.0, FINE * (2 * HALF + 1)  # of the pupil [mm]; samples of the image
    x, y = make_xy_grid(PUPIL, diameter=width)
    r, _ = cart_to_polar(x, y)
    pupil = circle(width / 2, r)
    found = []
    for wavelength in bands:
        wave = Wavefront.from_amp_and_phase(pupil, None, wavelength * 1e6, width / PUPIL)
        # of an even number of samples the middle is between two
        step = PITCH * 1e6 / FINE
        field = wave.focus_fixed_sampling(F_NUMBER * width, step, n, (-step / 2, -step / 2))
        light = np.abs(field.data) ** 2 / pupil.sum()
        found.append(light.reshape(2 * HALF + 1, FINE, 2 * HALF + 1, FINE).sum(axis=(1, 3)))
    return np.stack(found)
