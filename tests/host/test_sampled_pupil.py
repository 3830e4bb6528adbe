"""Sampled pupils against closed forms, and against quadrature over the overlap of the pupil with itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.special import j1

import gpusim as gs
from gpusim.domain.pupil import Pupil, disc_power, noll
from gpusim.optics.lens import kernels_at
from gpusim.optics.lenses import open_lens
from gpusim.optics.otf import hopkins, transfer
from gpusim.optics.rays import is_too_costly
from gpusim.optics.sampled import (
    STEP,
    difference_kernels,
    difference_tables,
    irradiance,
    sampled_kernel,
    sampled_transfer,
    window,
)

FLAT = np.zeros((1, 1))


def wavefront(waves, seed=None, terms=3, order=9):
    """Defocus [waves], and by a seed some Zernike terms up to order 8 of 0.3 waves."""
    out = np.zeros((order, order))
    out[:3, :3] = waves * disc_power(1)
    if seed is not None:
        random = np.random.default_rng(seed)
        for j in random.choice(np.arange(2, 46), terms, replace=False):
            term = noll(j)
            out[: len(term), : len(term)] += random.normal(0, 0.3) * term
    return out


def test_square_pupil_is_a_product_of_sincs():
    """Four blades, corners at 45 degrees: |A|^2 = (sinc 2 a X sinc 2 a Y)^2 a^4 16, a = sqrt(1/2).

    The samples along rows err by 1e-4 of the peak at the farthest X; at worst where all rows end alike.
    """
    half, a = 60, np.sqrt(0.5)
    at = np.arange(-half, half + 1) * STEP
    line = (2 * a * np.sinc(2 * a * at)) ** 2
    true = np.outer(line, line) * STEP**2 / (2 * a) ** 2
    found = irradiance(Pupil(4, 0.0, np.pi / 4), FLAT, half)
    assert np.abs(found - true).max() < 1e-4 * true.max()


def test_round_pupil_is_an_airy_disc():
    half = 50
    at = np.hypot(*np.meshgrid(*[np.arange(-half, half + 1) * STEP] * 2))
    x = 2 * np.pi * np.maximum(at, 1e-9)
    true = np.pi * (2 * j1(x) / x) ** 2 * STEP**2
    assert np.abs(irradiance(Pupil(), FLAT, half) - true).max() < 1e-4 * true.max()


@pytest.mark.parametrize("outline", [Pupil(), Pupil(6, 0, 0.2), Pupil(5, 0.3), Pupil(0, 0.4)])
@pytest.mark.parametrize("waves", [0.0, 6.0])
def test_energy(outline, waves):
    """All of it is 1. Edges of length E spread E / (2 pi^3 A) / (2 X^3) far away, A the open area: E / (2 pi^2 A X)
    outside a circle of radius X, 0.9 of it outside a square in the mean over directions, and 0.7 to 1 along them. The
    next term is 3 (b / X)^2 = 0.17 of it: rays from the rim of 6 waves land b = 12 away.
    """
    half = 200
    edges = outline.outline + 2 * np.pi * outline.obscuration
    beyond = edges / (2 * np.pi**2 * np.pi * outline.area * half * STEP)
    lost = 1 - irradiance(outline, wavefront(waves), half).sum(dtype=float)
    assert 0.7 * 0.95 * beyond < lost < 1.2 * beyond


@pytest.mark.parametrize("q", [0.4, 0.9])
def test_pixels_integrate_the_irradiance(q):
    """Airy's pattern over pixels of 0.8 x 1, moved; adaptive integration to 1e-7. All pixels' shares sum to 1."""
    size, move = 41, (0.2, -0.35)
    kernel = sampled_kernel(Pupil(), FLAT, q, move, size, (0.8, 1.0), (0.0, 0.0))

    def density(x, y):
        r = np.pi * np.hypot(x, y) / q
        return np.pi / (4 * q * q) * ((2 * j1(r) / r) ** 2 if r > 1e-9 else 1.0)

    true = {}
    for y, x in ((0, 0), (0, 1), (-1, 0), (2, -3)):
        v, u = y - move[0], x - move[1]
        true[y, x] = dblquad(density, v - 0.4, v + 0.4, u - 0.5, u + 0.5, epsabs=1e-8)[0]
    ratios = [kernel[20 + y, 20 + x] / value for (y, x), value in true.items()]
    # apertures with gaps share all light: one factor for all pixels
    np.testing.assert_allclose(ratios, ratios[0], rtol=3e-4)
    assert 0.96 < kernel.sum() < 1


@pytest.mark.parametrize("waves", [2.0, 12.0, 30.0])
def test_defocus_of_a_circle_is_hopkins(waves):
    s = np.concatenate([np.linspace(0.001, 0.05, 20), np.linspace(0.06, 0.99, 30)])
    angle = np.linspace(0, 7, s.size)
    wave = wavefront(waves)
    found = sampled_transfer(Pupil(), wave, s * np.cos(angle), s * np.sin(angle))
    _, error = window(Pupil(), wave[None])
    assert np.abs(found - hopkins(s, waves)).max() < error < 1.5e-3


@pytest.mark.parametrize("seed", range(6))
def test_random_wavefronts_against_quadrature(seed):
    """Rings, hexagons and pentagons with 0 to 30 waves of defocus and other terms, within the predicted error."""
    random = np.random.default_rng(100 + seed)
    outline = [Pupil(6, 0.0, 0.2), Pupil(0, 0.45), Pupil(5, 0.25, 1.0)][seed % 3]
    wave = wavefront(random.uniform(0, 30 if seed % 2 else 6), seed)
    s, angle = np.exp(random.uniform(np.log(1e-3), np.log(0.7), 24)), random.uniform(0, 7, 24)
    if outline.sides.size:  # across the normals, where light that leaves the window counts most
        angle[::2] = outline.sides[0] + np.pi / 2
    x, y = s * np.cos(angle), s * np.sin(angle)
    _, error = window(outline, wave[None])
    true = transfer(outline, wave[None], x, y, error=1e-6)[0]
    assert np.abs(sampled_transfer(outline, wave, x, y) - true).max() < error < 2e-3


@pytest.mark.parametrize("move", [(0.0, 0.0), (0.3, -0.7)])
def test_two_ways_to_tables_agree(move):
    """Few frequencies are folded from samples, many come from pixels: float32 apart."""
    wave, q = wavefront(2.0, 5)[None], np.array([0.45])
    settings = (0.8, 1.0), (0.3, 0.0), 0.2, move
    few = difference_tables(Pupil(5), wave, q, 40, 50, *settings)
    many = difference_tables(Pupil(5), wave, q, 400, 500, *settings)
    np.testing.assert_allclose(few, many[:, ::10, ::10], atol=2e-6)


@pytest.mark.parametrize("outline", [Pupil(), Pupil(0, 0.3), Pupil(5), Pupil(6, 0.2, 0.3)])
def test_differences_from_focus_are_kernels_near_the_point(outline):
    """Where the window counts in full they are the two kernels' difference, but for light beyond, spread evenly."""
    wave, q = wavefront(0.3, 3), 0.8
    (found,) = difference_kernels(outline, wave[None], [q], (1.0, 1.0), (0.2, 0.0), 0.1, (0.1, 0.0))
    near = np.s_[len(found) // 2 - 4 : len(found) // 2 + 5]
    with_wave, focus = (
        sampled_kernel(outline, one, q, (0.1, 0.0), 61, (1.0, 1.0), (0.2, 0.0), 0.1)
        for one in (wave, np.zeros((1, 1)))
    )
    inner = np.s_[26:35]
    wanted = (with_wave - focus)[inner, inner]
    assert abs(found.sum()) < 1e-5
    assert np.abs(found[near, near] - wanted).max() < 5e-3 * np.abs(wanted).max()


def hexagon(waves):
    camera = gs.open_camera("phone")
    defocus = waves * 8 * 550e-9 * camera.optics.working_f_number**2
    return replace(camera, optics=replace(camera.optics, pupil=Pupil(6), defocus=defocus))


def test_much_defocus_is_the_image_of_the_pupil():
    """Geometrical optics: 30 waves put the light evenly into a hexagon whose corners are 2 q 60 from the middle.

    Diffraction makes fringes at its edge, of which the brightest lies within 0.1 of the radius (Fresnel).
    """
    lens = open_lens(hexagon(30).optics, 1.4e-6)
    q = 550e-9 * lens.optics.working_f_number / 1.4e-6
    kernel = lens.kernels([550.0], (0.0, 0.0), 241)[0]
    y, x = np.indices(kernel.shape) - 120
    inside = np.max([x * np.cos(a) + y * np.sin(a) for a in lens.optics.pupil.sides], axis=0)
    radius = 2 * q * 60 * np.cos(np.pi / 6)
    area = 2 * np.sqrt(3) * radius**2
    inner = inside < 0.8 * radius
    assert abs(kernel[inner].sum() - inner.sum() / area) < 0.01
    assert kernel[inside > 1.05 * radius].sum() < 0.02


def test_kernels_of_many_points():
    """The same as one after the other, bit for bit."""
    lens = open_lens(hexagon(1).with_(seidel_waves=(0, 0.3, 0, 0, 0)).optics, 1.4e-6)
    points = [((0.1 * k, -0.2), 0.5 + k) for k in range(4)] + [((0.0, 0.7), None)]
    many = kernels_at(lens, [450.0, 600.0], points, 21)
    for kernels, (place, distance) in zip(many, points, strict=True):
        assert np.array_equal(kernels, lens.kernels([450.0, 600.0], place, 21, distance))


@pytest.mark.parametrize("waves", [5.0, 12.0])
def test_frames_of_many_waves(waves):
    """They were refused after a minute. The error of the tables is in the account."""
    camera = hexagon(waves)
    assert is_too_costly(camera.optics.pupil, camera.optics.waves(np.linspace(400, 700, 31)))
    for tolerance in (None, "video"):
        simulate = gs.Simulator(camera, device="numpy", tolerance=tolerance)
        plan = simulate.plan(gs.chart("slanted-edge", size=(48, 32)))
        assert 0 < plan.account.bounds["transfer tables"].rms < 5e-3
