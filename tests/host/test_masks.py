"""Masks in the pupil: kernels and transfer tables against sums over finely sampled pupils, and cells that add up."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.mask import Mask, pupil_cells
from gpusim.domain.mask_patterns import PRIMES, mask_pattern
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront, light_moments
from gpusim.optics.geometric import ray_kernel
from gpusim.optics.lenses import open_lens
from gpusim.optics.mask_edges import edge_strength
from gpusim.optics.occlusion import light_at, pupil_points
from gpusim.optics.tables import exact_tables

PITCH, SIZE = 1.4e-6, 25
RANDOM = np.random.default_rng(5)
CODE = Mask(RANDOM.random((5, 6)) * np.exp(1j * RANDOM.random((5, 6))))
OPTICS = Optics(2.8, 4e-3, object_distance=1.0)
ABERRATED = replace(OPTICS, wavefront=Wavefront(seidel=(0.5, 0.4, 0.3, 0, 0)))
PUPILS = {
    "circle": Pupil(),
    "hexagon": Pupil(6, 0.0, 0.2),
    "ring": Pupil(0, 0.4),
    "obscured pentagon": Pupil(5, 0.3, 0.1),
}


def sampled_pupil(pupil, wave, count):
    """Amplitudes at the middles of count x count steps over the square around the pupil, and the places."""
    u = (np.arange(count) + 0.5) / count * 2 - 1
    y, x = np.meshgrid(u, u, indexing="ij")
    inside = (np.hypot(y, x) < 1) & (np.hypot(y, x) > pupil.obscuration)
    for side in range(pupil.blades):
        angle = pupil.rotation + (2 * side + 1) * np.pi / pupil.blades
        inside &= x * np.cos(angle) + y * np.sin(angle) < np.cos(np.pi / pupil.blades)
    values = np.ones((1, 1)) if pupil.mask is None else pupil.mask.values
    rows, cols = ((u + 1) / 2 * n for n in values.shape)
    amplitude = inside * values[np.ix_(rows.astype(int), cols.astype(int))]
    return amplitude * np.exp(2j * np.pi * np.polynomial.polynomial.polyval2d(x, y, wave)), u


def brute_kernel(optics, wavelength, place, distance, count=1260):
    """Energies of pixels around a point by the transform of a sampled pupil, in float64.

    Simpson's rule with 8 steps along a pixel errs by (2 pi f / 8)^4 / 180 at f [cycle/pixel]: 1.4e-3 at the cut-off.
    """
    wave = optics.waves(np.array([wavelength]), np.hypot(*place), np.arctan2(*place), distance)[0]
    field, u = sampled_pupil(optics.pupil, wave, count)
    q = wavelength * 1e-9 * optics.working_f_number / PITCH
    fine, half = 8, SIZE // 2 * 8 + 4
    at = np.arange(-half, half + 1) / fine / (2 * q)
    waves = np.exp(2j * np.pi * np.outer(at, u))
    light = np.abs(waves @ field @ waves.T) ** 2
    light *= (2 / count) ** 4 / (np.sum(np.abs(field) ** 2) * (2 / count) ** 2) / (2 * q) ** 2
    ends = np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) / (3 * fine)
    summed = np.stack([ends @ light[k * fine : k * fine + fine + 1] for k in range(SIZE)])
    return np.stack([summed[:, k * fine : k * fine + fine + 1] @ ends for k in range(SIZE)], axis=1)


@pytest.mark.parametrize("distance", [None, 0.5])
@pytest.mark.parametrize(
    "pupil",
    [Pupil(mask=CODE), Pupil(6, 0.3, 0.2, CODE), Pupil(mask=pupil_cells((3, 3))[0][1])],
    ids=["circle", "obscured hexagon", "cell"],
)
def test_kernels_are_those_of_a_sampled_pupil(pupil, distance):
    """1260 steps are whole ones of every cell.

    An outline errs by a part of a step, 1/1260 of the energy, and Simpson's rule by less.
    """
    optics, place = replace(ABERRATED, pupil=pupil), (0.3, 0.5)
    wanted = brute_kernel(optics, 550.0, place, distance)
    lens = open_lens(optics, PITCH, 1.0, (300, 400))
    found = lens.kernels([550.0], place, SIZE, distance)[0]
    assert np.abs(found - wanted).max() < 2e-3 * wanted.max()
    assert found.sum() == pytest.approx(wanted.sum(), abs=1e-3)


@pytest.mark.parametrize("name", PUPILS)
@pytest.mark.parametrize(
    "distance", [0.4, *(pytest.param(one, marks=pytest.mark.slow) for one in (None, 0.7, 5.0))]
)
def test_an_open_mask_changes_nothing(name, distance):
    """Against the quadrature over the overlap of two pupils, which knows no mask.

    A grid of steps errs by `focus_error` next to frequency 0 and on the ridges of straight sides, a window by 1e-3.
    """
    optics = replace(OPTICS, pupil=PUPILS[name])
    masked = replace(optics, pupil=replace(PUPILS[name], mask=Mask(np.ones((3, 2)))))
    one, other = (open_lens(each, PITCH, (0.9, 0.8), (60, 80)) for each in (optics, masked))
    wavelengths, place = [480.0, 620.0], (0.2, -0.4)
    kernels = [lens.kernels(wavelengths, place, SIZE, distance) for lens in (one, other)]
    # both are float32 sums of thousands of waves
    assert np.abs(kernels[1] - kernels[0]).max() < 5e-6 * kernels[0].max()
    f = np.array([1e4, 9e4, 2e5]), np.array([-5e4, 2e4, 1e5])
    transfers = [lens.transfer(wavelengths, *f, place, distance) for lens in (one, other)]
    assert np.abs(transfers[1] - transfers[0]).max() < 1e-3
    assert edge_strength(masked.pupil) == pytest.approx(one.tail.strength, rel=1e-6)
    np.testing.assert_allclose(other.tails(wavelengths)[:, 0], one.tails(wavelengths)[:, 0], 1e-6)
    np.testing.assert_allclose(
        other.centroids(wavelengths, place, distance),
        one.centroids(wavelengths, place, distance),
        atol=1e-4,  # of sums over 128 steps
    )


@pytest.mark.parametrize("distance", [None, 0.4, 0.6, 5.0])
@pytest.mark.parametrize("name", PUPILS)
@pytest.mark.parametrize(
    "lens",
    [
        pytest.param(OPTICS, id="sharp"),
        pytest.param(ABERRATED, id="aberrated", marks=pytest.mark.slow),
    ],
)
def test_light_of_cells_is_the_light_of_the_whole(lens, name, distance):
    """A table's first entry is all light of a point: 1, in float32."""
    pupil = PUPILS[name]
    total = 0.0
    for mask in chain(*pupil_cells((3, 2))):
        cell = replace(lens, pupil=replace(pupil, mask=mask))
        own = open_lens(cell, PITCH)
        first = exact_tables(own, own.q(np.array([550.0])), 16, 12, distance)[0].view(np.complex64)
        total += cell.irradiance_factor * first[0, 0].real
    whole = replace(lens, pupil=pupil).irradiance_factor
    assert total == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize("name", PUPILS)
def test_rays_through_cells_are_the_rays_of_the_whole(name):
    """In the geometric limit kernels add up but for sums of float32, and areas that are sums of Gauss nodes."""
    pupil, wave = PUPILS[name], ABERRATED.waves(np.array([550.0]), 1.0, 0.3)[0]
    settings = wave, 0.4, (0.0, 0.0), 21, (0.8, 0.8), (0.0, 0.0), 0.0
    total = np.zeros((21, 21))
    for mask in chain(*pupil_cells((4, 3))):
        cell = replace(pupil, mask=mask)
        total += cell.area * ray_kernel(cell, *settings)
    whole = ray_kernel(pupil, *settings)
    assert np.abs(total / pupil.area - whole).max() < 1e-5 * whole.max()


def test_pupil_points_have_the_moments_of_the_light():
    """Points are even, so that means of smooth functions err by less than 1 / sqrt(N)."""
    for pupil in (Pupil(5, 0.2, 0.1, CODE), Pupil(mask=pupil_cells((9, 9))[2][6])):
        points = pupil_points(pupil, 4096)
        wanted = light_moments(pupil, 2) / light_moments(pupil, 1)
        assert points[:, 2].sum() == pytest.approx(1)
        assert (light_at(pupil, *points[:, :2].T) > 0).all()
        assert points[:, 2] @ points[:, 0] == pytest.approx(wanted[0, 1], abs=0.015)
        assert points[:, 2] @ points[:, 1] == pytest.approx(wanted[1, 0], abs=0.015)


def test_a_phase_step_moves_the_light():
    """Half the pupil a quarter wave behind: the centroid is the mean of Im(P* grad P), a step of 2 along x.

    Of a circle: the step is 2 radii long, so that X = -2 sin(pi / 2) / (2 pi pi), x = 2 q X.
    """
    pupil = Pupil(mask=Mask([[1, 1j]]))
    lens = open_lens(replace(OPTICS, pupil=pupil), PITCH)
    q = lens.q([550.0])[0]
    wanted = 2 * q * -2 / (2 * np.pi**2)
    np.testing.assert_allclose(lens.centroids([550.0], (0, 0)), [[0, wanted]], atol=1e-6)
    kernel = lens.kernels([550.0], (0.0, 0.0), 401)[0]
    at = np.arange(-200, 201)
    # light beyond 200 samples is as strong on both sides, but for r^-4
    assert kernel.sum(axis=0) @ at == pytest.approx(wanted, abs=0.02)
    assert kernel.sum(axis=1) @ at == pytest.approx(0, abs=1e-5)


def test_patterns():
    """A MURA's periodic autocorrelation has one peak and is flat elsewhere (Gottesman and Fenimore 1989)."""
    for prime in PRIMES[1:6]:
        values = mask_pattern(f"mura-{prime}").values.real
        signs = 2 * values - 1
        signs[0, 0] = 1  # the decoding array
        found = np.fft.ifft2(np.fft.fft2(values) * np.fft.fft2(signs).conj()).real
        assert found[0, 0] == pytest.approx((prime**2 - 1) / 2)
        found[0, 0] = 0
        np.testing.assert_allclose(found, 0, atol=1e-9)
    assert mask_pattern("gaussian").values.real.max() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([[0, 0], [0, 0]], "no light passes: allowed is at least one open cell"),
        ([[2]], "0 .. 1"),
        ([[1, 2], [1]], "equally long"),
        ("mura-4", "unknown optics.mask"),
        ("none.png", "no such file"),
        (np.pad([[1]], ((0, 8), (0, 8))).tolist(), "open cell inside the pupil"),
    ],
)
def test_masks_that_cannot_be_used_are_refused_in_a_line(values, words):
    with pytest.raises(gs.GpusimError, match=words) as error:
        gs.open_camera("phone").with_(mask=values)
    assert "\n" not in str(error.value)


def test_files_of_masks(tmp_path):
    from PIL import Image

    grey = np.array([[0, 51, 255], [255, 204, 0]], np.uint8)
    Image.fromarray(grey).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", [[1j, 0.5]])
    np.savez(tmp_path / "a.npz", mask=[[0.25, -1]])
    wanted = {"a.png": np.sqrt(grey / 255), "a.npy": [[1j, 0.5]], "a.npz": [[0.25, -1]]}
    for name, values in wanted.items():
        (tmp_path / "own.toml").write_text(f'base = "phone"\n[optics]\nmask = "{name}"\n')
        camera = gs.open_camera(tmp_path / "own.toml")
        np.testing.assert_allclose(np.asarray(camera.optics.pupil.mask), values)
    blades = camera.with_(pupil={"blades": 6})
    assert blades.optics.pupil.mask == camera.optics.pupil.mask
    assert camera.with_(mask=None).optics.pupil == Pupil()
    (tmp_path / "bad.npz").write_bytes(b"PK")
    (tmp_path / "own.toml").write_text('base = "phone"\n[optics]\nmask = "bad.npz"\n')
    with pytest.raises(gs.GpusimError, match="mask"):
        gs.open_camera(tmp_path / "own.toml")


def test_measured_spreads_hold_no_wave_in_the_pupil():
    spread = gs.PointSpread(np.array([400.0, 700.0]), np.ones((2, 5, 5)), 1e-6)
    with pytest.raises(gs.GpusimError, match=r"optics\.mask"):
        Optics(2.8, 4e-3, model="measured", psf=spread, pupil=Pupil(mask=CODE))
