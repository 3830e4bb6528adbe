"""Tables of pupils and wavefronts on devices: against the integral, and images made with them."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS
from scipy.integrate import dblquad
from scipy.special import j1
from test_pupil import CLEAR, COMA, FLAT, defocus

from gpusim.backends import open_device
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront, disc_power, noll
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.pupil import pupil
from gpusim.optics.lenses import open_lens
from gpusim.optics.otf import transfer
from gpusim.pipeline.tables import _OnDevice


def image_of_a_point(outline, waves, q, size, period, device):
    """The middle `size` pixels square of a point's image."""
    tables = pupil(outline, waves, np.array([q], np.float32), 1.0, *period, device=device)
    point = np.zeros((1, size, size), np.float32)
    point[0, size // 2, size // 2] = 1
    return blur(point, tables[None], np.ones((1, 1)), "zero", period, device=device)[0]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_tables_of_the_clear_circle_equal_the_airy_stage(device):
    """Two different interpolations of one function, each to 1e-6 (see their cases)."""
    q = np.array([0.4, 0.99, 3.0], np.float32)
    np.testing.assert_allclose(
        pupil(CLEAR, np.zeros((3, 3, 3)), q, 0.9, 20, 33, device=device),
        airy(q, 0.9, 20, 33, device=device),
        atol=2e-6,
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("outline", [CLEAR, Pupil(0, 0.4), Pupil(6, 0, 0.2), Pupil(5, 0.2, 0.1)])
def test_energy_is_kept(outline, device):
    """T(0) = 1: O(0) = 1 is a node and at integer frequencies sinc is 0 to float32 rounding."""
    for waves in (
        FLAT,
        defocus(1.3),
        *((COMA.polynomial(1.0, 0.3)[None],) if outline == CLEAR else ()),
    ):
        tables = pupil(outline, waves, np.array([0.6], np.float32), 1.0, 4, 5, device=device)
        assert abs(tables[0, 0, 0] - 1) < 2e-6
        assert tables.shape[1] == 3 or abs(tables[0, 0, 1]) < 1e-6


@pytest.mark.parametrize("waves", [defocus(0.3), defocus(3.0), COMA.polynomial(1.0, 0.4)[None]])
def test_tables_of_a_frame_against_the_integral(waves):
    """The interpolated tables at frequencies of a large frame.

    3e-5 is the contract's: 1.4e-5 of cubics between nodes, weighted by replicas that sum to 2 at most.
    """
    q, period = np.array([1.1], np.float32), (540, 480)
    tables = np.float64(pupil(CLEAR, waves, q, 1.0, *period, device="auto")[0])
    complex_ = tables.shape[1] != period[1] // 2 + 1
    tables = tables.view(complex) if complex_ else tables
    random = np.random.default_rng(2)
    for i, j in zip(random.integers(0, 270, 40), random.integers(0, 240, 40), strict=True):
        total = 0
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                y, x = i / period[0] + a, j / period[1] + b
                total += (
                    np.sinc(y)
                    * np.sinc(x)
                    * transfer(CLEAR, waves, [x * float(q[0])], [y * float(q[0])])[0, 0]
                )
        assert abs(tables[i, j] - (total if complex_ else total.real)) < 3e-5


@pytest.mark.parametrize("device", ALL_KINDS)
def test_coma_in_four_quadrants(device):
    """Hard case 14: images of the four corners are mirror images to 1e-5 of the peak; the centroid is the slope's.

    Centroid [pixel]: -2 q <grad W> over the disc, which for W131 r^3 cos t is -2 q W131 (the mean of 3 x^2 + y^2).
    The other terms are even. Only the period's share of the slow tail is missing; 0.02 pixels are asked for.
    """
    azimuth, q, size, period = 0.6, 1.1, 63, (256, 256)
    images = [
        image_of_a_point(CLEAR, COMA.polynomial(1.0, angle)[None], q, size, period, device)
        for angle in (azimuth, np.pi - azimuth, np.pi + azimuth, -azimuth)
    ]
    peak = images[0].max()
    for image, mirrored in zip(
        images[1:], (images[0][:, ::-1], images[0][::-1, ::-1], images[0][::-1]), strict=True
    ):
        assert np.abs(image - mirrored).max() < 1e-5 * peak
    # the centroid of the whole period, from the slope of the transfer function at 0, its phase at one frequency step
    tables = np.float64(
        pupil(
            CLEAR,
            COMA.polynomial(1.0, azimuth)[None],
            np.array([q], np.float32),
            1.0,
            4096,
            64,
            device=device,
        )
    ).view(complex)[0]
    centroid_y = -np.angle(tables[1, 0]) * 4096 / (2 * np.pi)
    assert abs(centroid_y + 2 * q * 0.7 * np.sin(azimuth)) < 0.02


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("move", [(0.3, -0.2), (0.5, 0.5)])
def test_moved_point_on_coarse_pixels(device, move):
    """Hard case 9: f/1.8, 4 um (Q = .25): flux to 1e-4, kernel to 1e-3 of the peak, by integration of Airy's pattern.

    A wavefront's slope moves the image by -2 Q times it, so the point is moved before the pixels integrate it.
    """
    q = 0.25
    slope = np.zeros((1, 2, 2))
    slope[0, 0, 1], slope[0, 1, 0] = (-d / (2 * q) for d in move)
    image = image_of_a_point(CLEAR, slope, q, 65, (144, 144), device)
    truth = {}
    for y, x in ((0, 0), (0, 1), (1, 0), (1, -1), (-1, 0)):

        def energy(v, u):
            r = np.pi * np.hypot(u, v) / q
            return np.pi / (4 * q * q) * ((2 * j1(r) / r) ** 2 if r > 1e-9 else 1.0)

        low_y, low_x = y - 0.5 - move[0], x - 0.5 - move[1]
        truth[y, x] = dblquad(energy, low_x, low_x + 1, low_y, low_y + 1, epsabs=1e-6)[0]
    for (y, x), value in truth.items():
        assert abs(image[32 + y, 32 + x] - value) < 1e-3 * max(truth.values())
    # beyond r pixels lies 2 q / (pi^2 r) of the energy (Rayleigh): 1.6e-3 of it beyond the 32 pixels seen here, to
    # which the corners of the square add; the rest is the period's
    tables = pupil(CLEAR, slope, np.array([q], np.float32), 1.0, 8, 8, device=device)
    assert abs(tables[0, 0, 0] - 1) < 1e-4
    assert abs(image.sum() - 1) < 2e-3


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    ("outline", "waves"),
    [(CLEAR, defocus(1.5)), (CLEAR, COMA.polynomial(1.0, 0.6)[None]), (Pupil(6, 0, 0.3), FLAT)],
)
def test_no_ringing(outline, waves, device):
    """An irradiance is not negative.

    A cubic's errors of 1.4e-5 in T change sign from node to node; over some 16 x 16 patches of the square of
    frequencies their mean is 1.4e-5 / 16 = 9e-7, of peaks that are down to 0.06 (1.5 waves): 1.5e-5; float32 adds 5e-6.
    """
    image = image_of_a_point(outline, waves, 0.99, 65, (180, 180), device)
    assert image.min() > -2e-5 * image.max()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_low_pass_plate_makes_two_images(device):
    """Two half images 2 pixels apart: the image without the plate, added to itself, to the rounding of float32."""
    q, period = np.array([1.1], np.float32), (128, 128)
    tables = [
        pupil(CLEAR, FLAT, q, 1.0, *period, spots=spots, device=device)[0]
        for spots in ((0, 0), (0, 2.0))
    ]
    fold = np.ix_(np.minimum(np.arange(128), 128 - np.arange(128)), np.arange(65))
    single, double = (np.fft.irfft2(np.float64(table)[fold], period) for table in tables)
    expected = (np.roll(single, 1, axis=1) + np.roll(single, -1, axis=1)) / 2
    np.testing.assert_allclose(double, expected, atol=3e-6 * single.max())


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("displacement", [(0.0, 0.0), (0.5, -0.25)])
@pytest.mark.parametrize("outline", [Pupil(6, 0, 0.3), Pupil(5, 0.3)])
def test_tables_of_many_waves(outline, displacement, device):
    """7 waves against the integral at frequencies without replicas, within the error that the lens states.

    Devices add their cubics, 3e-5 each way, and float32.
    """
    q, waves = 1.2, np.pad(7.0 * disc_power(1), (0, 2))
    waves[:4, :4] += 0.2 * noll(7)
    zernike = np.zeros(7)
    zernike[6] = 0.2
    f_number, wavelength = 4.0, 550e-9
    optics = Optics(
        f_number,
        4e-3,
        pupil=outline,
        defocus=7 * 8 * wavelength * f_number**2,
        wavefront=Wavefront(zernike=tuple(zernike)),
    )
    optics = replace(optics, defocus=optics.defocus * (optics.working_f_number / f_number) ** 2)
    pitch = wavelength * optics.working_f_number / q
    lens = open_lens(optics, pitch, (0.9, 1.0), displacement=displacement)
    error = lens.table_error(np.array([550.0]))
    assert error > 0
    stages = _OnDevice(open_device(device))
    tables = lens.tables(np.array([q], np.float32), 48, 40, stages)
    tables = np.ascontiguousarray(stages._device.numpy(tables)[0], np.float64).view(complex)
    y, x = np.array([0, 1, 3, 5, 2]), np.array([1, 2, 0, 4, 3])
    fy, fx = y / 48, x / 40
    true = transfer(outline, waves[None], fx * q, fy * q)[0] * np.sinc(0.9 * fy) * np.sinc(fx)
    for a, b in [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]:
        v, u = fy + a, fx + b
        inside = np.hypot(v, u) * q < 1
        more = np.zeros(len(y), complex)
        more[inside] = transfer(outline, waves[None], u[inside] * q, v[inside] * q)[0]
        turn = np.exp(2j * np.pi * (displacement[0] * a + displacement[1] * b))
        true = true + more * np.sinc(0.9 * v) * np.sinc(u) * turn
    true = true * np.exp(2j * np.pi * (displacement[0] * fy + displacement[1] * fx))
    assert np.abs(tables[y, x] - true).max() < error + 1e-4


@pytest.mark.parametrize("outline", [Pupil(), Pupil(0, 0.35)])
@pytest.mark.parametrize(
    ("q", "rows", "cols"), [(0.9, 1024, 1600), (2.2, 1025, 1501), (0.4, 900, 540)]
)
def test_large_tables_are_the_integral(outline, q, rows, cols):
    """So many frequencies that a CPU interpolates between fewer: at 60, half of them near 0, the folded integral.

    Beside the 8e-6 of cubics along and across the rays, cubics between the tables of a shorter period err by 1.5e-5;
    float32 adds 1e-6.
    """
    moved, random = (0.2, -0.1), np.random.default_rng(5)
    waves = 0.6 * noll(8)
    waves[:3, :3] += 0.4 * noll(4) + 0.3 * noll(5)
    tables = large_tables(outline, waves[None], q, rows, cols, moved).view(np.complex64)[0]
    y = np.concatenate([random.integers(-rows // 2, rows // 2, 30), random.integers(-20, 20, 30)])
    x = np.concatenate([random.integers(0, cols // 2, 30), random.integers(0, 30, 30)])
    true = folded(outline, waves[None], q, y / rows, x / cols, moved)
    assert np.abs(tables[y, x] - true).max() < 2.5e-5


def test_large_tables_of_a_defocused_circle_are_the_integral():
    """The same of real quarters, at their edges too."""
    rows, cols, q, waves, random = 999, 1000, 0.7, defocus(1.2), np.random.default_rng(6)
    tables = large_tables(CLEAR, waves, q, rows, cols, (0.0, 0.0))[0]
    assert tables.shape == (500, 501)
    y = np.concatenate([random.integers(0, 500, 30), [0, 0, 499, 499, 250, 0]])
    x = np.concatenate([random.integers(0, 501, 30), [0, 500, 500, 0, 500, 12]])
    true = folded(CLEAR, waves, q, y / rows, x / cols, (0.0, 0.0))
    assert np.abs(tables[y, x] - true.real).max() < 2.5e-5


@pytest.mark.parametrize("device", ["opencl", "warp:cpu"])
@pytest.mark.parametrize("outline", [Pupil(6), Pupil(5, 0.2, 0.1), Pupil(4, 0, np.pi / 4)])
@pytest.mark.parametrize("is_aberrated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_large_tables_behind_blades_are_the_integral(outline, is_aberrated, device):
    """Near the lines across which O changes its slope, too: sides of the pupil along an axis, and any others.

    Of 80 frequencies, half are within two nodes, 1 / 120 cycle, of the lines through the centre and of the cut-off.
    Beside the 3e-5 of cubics along and across the rays, cubics between the tables of a shorter period err by 1.5e-5.
    Without the slopes they err by 2e-4.
    """
    rows, cols, q, moved, random = 540, 960, 0.9, (0.2, -0.1), np.random.default_rng(7)
    waves = 0.2 * noll(8)
    waves[:3, :3] += 0.3 * noll(4) + 0.1 * noll(5)
    waves = waves[None] * is_aberrated
    tables = large_tables(outline, waves, q, rows, cols, moved, device).view(np.complex64)[0]
    y, x = random.integers(-rows // 2, rows // 2, 80), random.integers(0, cols // 2, 80)
    for k in range(40):
        side = random.choice(outline.sides)
        along, away = random.uniform(0.05, 1) * np.sin(np.pi / outline.blades), 0.0
        if k % 2 and outline.blades % 2 == 0:
            away, along = outline.inner_radius, along * random.choice([-1, 1])
        f = (away + 1j * along) * np.exp(1j * side) / q
        f += (random.uniform(-1, 1) + 1j * random.uniform(-1, 1)) / 120
        f = f if (f.real + 0.5) % 1 >= 0.5 else -f  # to columns that are there
        y[k] = (round(f.imag * rows) + rows // 2) % rows - rows // 2
        x[k] = min(round(f.real * cols) % cols, cols // 2)
    true = folded(outline, waves, q, y / rows, x / cols, moved)
    assert np.abs(tables[y, x] - true).max() < 5e-5


def large_tables(outline, waves, q, rows, cols, moved, device="opencl"):
    """Tables on a CPU that interpolates, apertures 0.9 x 1."""
    device, lengths = open_device(device), np.array([q], np.float32)
    return np.ascontiguousarray(
        device.numpy(
            pupil(outline, waves, lengths, (0.9, 1), rows, cols, displacement=moved, device=device)
        )
    )


def folded(outline, waves, q, fy, fx, moved):
    """The integral at frequencies (n,) that fold, apertures 0.9 x 1, complex (n,)."""
    true = np.zeros(len(fy), complex)
    reach = int(1 / q + 1.5)
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            v, u = fy + a, fx + b
            weight = (
                np.sinc(0.9 * v) * np.sinc(u) * np.exp(2j * np.pi * (moved[0] * v + moved[1] * u))
            )
            inside = np.hypot(v, u) * np.float32(q) < 1
            at = u[inside] * np.float32(q), v[inside] * np.float32(q)
            true[inside] += weight[inside] * transfer(outline, waves, *at)[0]
    return true
