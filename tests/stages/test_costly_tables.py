"""Tables of pupils whose integrals are too costly: against the autocorrelation of a sampled pupil."""

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.backends import open_device
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.optics.lenses import open_lens
from gpusim.optics.rays import is_too_costly
from gpusim.pipeline.tables import _OnDevice, make_tables

PITCH, NM, N = 1.4e-6, np.linspace(400, 700, 6), 64
# coma and more without a mirror axis, behind a ring
ZERNIKE = (0, 0, 0, -0.04, 0.06, 0.15, -0.157, -0.068, -0.28, 0.21, 0.001)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("n", [N, pytest.param(3 * N, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "displacement", [pytest.param((0.0, 0.0), marks=pytest.mark.slow), (0.25, -0.5)]
)
def test_no_part_of_a_costly_table_is_lost(n, device, displacement):
    """Imaginary parts and both quadrants: a sampled pupil of 1000 points across errs by 1e-3, kernels' ends by 1e-2."""
    pupil = Pupil(obscuration=0.43)
    optics = Optics(5.5, 4.44e-3, object_distance=2.0, pupil=pupil, wavefront=Wavefront(ZERNIKE))
    lens = open_lens(optics, PITCH, (1.0, 1.0), displacement=displacement)
    waves, q = lens.waves(NM), lens.q(NM)
    assert is_too_costly(pupil, waves)
    wave = waves[0]
    if n > N and device == "numpy":
        pytest.skip("the reference transforms no kernels of planes")
    opened = open_device(device)
    if n > N:  # each plane is one wavelength, and kernels of planes are wrapped
        made_of = optics, PITCH, (1.0, 1.0), displacement, q
        tables = make_tables(made_of, (n, n), np.eye(len(q))[None], None, opened)
        table = np.asarray(opened.numpy(tables), np.float64)[0]
        assert lens.table_parts(q, n, n, _OnDevice(opened)) is not None
    else:
        table = np.asarray(opened.numpy(lens.tables(q, n, n, _OnDevice(opened))), np.float64)
    found = table[0].reshape(n, n // 2 + 1, 2) @ [1, 1j]
    at = (np.arange(1000) + 0.5) / 500 - 1

    def field(y, x):
        """Field in the pupil at places along rows and columns."""
        y, x = y[:, None], x[None]
        radius = np.hypot(y, x)
        phase = np.polynomial.polynomial.polyval2d(*np.broadcast_arrays(x, y), wave)
        return ((radius <= 1) & (radius >= 0.43)) * np.exp(2j * np.pi * phase)

    area, imaginary = np.abs(field(at, at)).sum(), 0.0
    for row, col in ((0, 3), (5, 0), (2, 2), (-3, 4), (-8, 1), (9, 7)):
        fy, fx = row / N, col / N
        dy, dx = q[0] * fy, q[0] * fx
        seen = np.vdot(field(at - dy, at - dx), field(at + dy, at + dx)) / area
        row, col = row * (n // N), col * (n // N)
        seen *= np.sinc(fy) * np.sinc(fx)
        seen *= np.exp(2j * np.pi * (fy * displacement[0] + fx * displacement[1]))
        assert abs(found[row, col] - seen) < 1.5e-2
        imaginary = max(imaginary, abs(seen.imag))
    assert imaginary > 0.05
