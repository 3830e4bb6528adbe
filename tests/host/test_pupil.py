"""Pupils, wavefronts and given point spreads against closed forms and independent integration."""

import numpy as np
import pytest
from blur_kernels import gaussian_kernel, pillbox_kernel
from scipy.integrate import dblquad
from scipy.optimize import brentq
from scipy.special import j1

from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, Wavefront, disc_power, noll
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera
from gpusim.io.camera.psf import read_psf
from gpusim.kernels.optics.airy_ref import otf as airy_otf
from gpusim.optics.otf import hopkins, transfer
from gpusim.optics.psf import psf_tables

CLEAR, FLAT = Pupil(), np.zeros((1, 5, 5))
COMA = Wavefront(
    seidel=(0, 0.7, 0.5, 0.4, 0)
)  # the corner of the mild lens of the notes on field variation


def defocus(waves):
    return waves * disc_power(1)[None]


# ---- the transfer function


def test_no_wavefront_is_airy():
    """Both integrals give the closed form of the in-focus circle; 1e-13 is some hundred roundings of sums near 1."""
    s = np.linspace(0, 1, 41)
    np.testing.assert_allclose(hopkins(s, 0.0), airy_otf(s), atol=1e-13)
    np.testing.assert_allclose(transfer(CLEAR, FLAT, 0.6 * s, 0.8 * s)[0], airy_otf(s), atol=1e-13)


@pytest.mark.parametrize("waves", [0.0, 0.1, 1.0, 2.7, 5.0])
def test_hopkins_integral_against_adaptive_integration_in_two_dimensions(waves):
    """The issue's 1e-9; the adaptive integration is asked for 1e-10 of pi / 4 in each of two directions."""
    for s in (0.03, 0.2, 0.5, 0.8, 0.97):
        end = np.sqrt(1 - s * s)  # a quarter of the overlap: it is even both ways
        quarter = dblquad(
            lambda x, y, s=s: np.cos(8 * np.pi * waves * s * x),
            0,
            end,
            0,
            lambda y, s=s: max(np.sqrt(max(1 - y * y, 0)) - s, 0),
            epsabs=1e-11,
            epsrel=1e-11,
        )[0]
        assert abs(hopkins(s, waves) - 4 * quarter / np.pi) <= 1e-9
        assert abs(transfer(CLEAR, defocus(waves), [s], [0.0])[0, 0] - 4 * quarter / np.pi) <= 1e-9


@pytest.mark.slow
def test_corner_wavefront_against_adaptive_integration():
    """Coma, astigmatism and field curvature at an angle, in fixed axes: the shift is not along one of them.

    The adaptive integration is asked for 1e-8: its domain has corners.
    """
    from numpy.polynomial.polynomial import polyval2d

    waves = COMA.polynomial(0.8, 0.5)
    for sx, sy in ((0.3, 0.1), (-0.2, 0.5)):

        def integrand(x, y, part, sx=sx, sy=sy):
            inside = (x + sx) ** 2 + (y + sy) ** 2 < 1 and (x - sx) ** 2 + (y - sy) ** 2 < 1
            difference = polyval2d(x + sx, y + sy, waves) - polyval2d(x - sx, y - sy, waves)
            return part(2 * np.pi * difference) if inside else 0.0

        def first(y, sx=sx, sy=sy):
            return max(
                -np.sqrt(max(1 - (y + sy) ** 2, 0)) - sx, -np.sqrt(max(1 - (y - sy) ** 2, 0)) + sx
            )

        def last(y, sx=sx, sy=sy):
            return max(
                min(
                    np.sqrt(max(1 - (y + sy) ** 2, 0)) - sx, np.sqrt(max(1 - (y - sy) ** 2, 0)) + sx
                ),
                first(y),
            )

        top = 1 - abs(sy)
        parts = [
            dblquad(integrand, -top, top, first, last, args=(part,), epsabs=1e-9, epsrel=1e-9)[0]
            / np.pi
            for part in (np.cos, np.sin)
        ]
        assert abs(transfer(CLEAR, waves[None], [sx], [sy])[0, 0] - complex(*parts)) < 2e-8


def test_much_defocus_is_the_pillbox_of_geometrical_optics():
    """O -> 2 J1(x) / x, x = 8 pi W s, for small s (Hopkins 1955); diffraction takes O(s) = 1 - 4 s / pi from it."""
    x = 8 * np.pi * 5.0 * 0.01
    assert abs(hopkins(0.01, 5.0) - 2 * j1(x) / x) < 4 * 0.01 / np.pi


@pytest.mark.parametrize("hole", [0.1, 0.3, 0.7])
def test_obscured_circle_closed_form(hole):
    """Area of overlap of two rings: circle-circle lens areas.

    A panel between kinks has a root at its ends, which (3 x - x^3) / 2 doubles: an integrand of x^2 in place of x^(1/2)
    where two roots meet (s near a kink), and Gauss-Legendre of n nodes errs there as n^-5: 20^-5 = 3e-7 of a panel
    whose area is a tenth of the whole. 5e-8 is that; 2e-8 is the most that was measured.
    """

    def lens(r1, r2, d):
        if d >= r1 + r2:
            return 0.0
        if d <= abs(r1 - r2):
            return np.pi * min(r1, r2) ** 2
        kite = (-d + r1 + r2) * (d + r1 - r2) * (d - r1 + r2) * (d + r1 + r2)
        return (
            r1**2 * np.arccos((d * d + r1**2 - r2**2) / (2 * d * r1))
            + r2**2 * np.arccos((d * d + r2**2 - r1**2) / (2 * d * r2))
            - np.sqrt(kite) / 2
        )

    s = np.linspace(0.01, 1, 60)
    truth = [
        (lens(1, 1, 2 * v) - 2 * lens(1, hole, 2 * v) + lens(hole, hole, 2 * v))
        / (np.pi * (1 - hole**2))
        for v in s
    ]
    np.testing.assert_allclose(
        transfer(Pupil(0, hole), FLAT, 0.6 * s, -0.8 * s)[0], truth, atol=5e-8
    )


def test_square_pupil_closed_form():
    """Product of two triangles; the integrand is linear, so only rounding is left."""
    random = np.random.default_rng(1)
    sx, sy = random.uniform(-0.7, 0.7, (2, 50))
    truth = np.prod([np.maximum(1 - 2 * np.abs(v) / np.sqrt(2), 0) for v in (sx, sy)], axis=0)
    np.testing.assert_allclose(transfer(Pupil(4, 0, np.pi / 4), FLAT, sx, sy)[0], truth, atol=1e-13)


@pytest.mark.parametrize("blades", [5, 6, 7])
def test_polygon_symmetry(blades):
    """An n-sided pupil's |O| repeats every 2 pi / n (every pi / n for odd n); out of focus an odd one is complex."""
    outline, waves = Pupil(blades, 0.2, 0.3), defocus(1.0)
    angle = 0.4 + np.pi / blades * (1 if blades % 2 else 2) * np.arange(4)
    values = transfer(outline, waves, 0.35 * np.cos(angle), 0.35 * np.sin(angle))[0]
    # the panels with the obstruction's roots converge to 2e-8
    np.testing.assert_allclose(np.abs(values), np.abs(values[0]), atol=1e-7)
    opposite = transfer(outline, waves, -0.35 * np.cos(angle), -0.35 * np.sin(angle))[0]
    np.testing.assert_allclose(opposite, values.conj(), atol=1e-12)  # the same panels, mirrored
    assert (np.abs(values.imag).max() > 1e-3) == (blades % 2 == 1)


def test_mtf50_of_the_lens_of_figure_8():
    """f/2.4, 3.9 mm at 550 nm, sensor 10 and 40 um out of focus: 165.2 and 42.8 cycles/mm.

    Source of the figures: an independent direct integration, given to a tenth, so within 0.05.
    """
    for shift, expected in ((10e-6, 165.2), (40e-6, 42.8)):
        optics = Optics(2.4, 3.9e-3, defocus=shift)
        waves = optics.waves([550.0])[0, 2, 0]
        s = np.linspace(0, 1, 400)
        first = np.argmax(hopkins(s, waves) < 0.5)
        root = brentq(lambda v, waves=waves: hopkins(v, waves) - 0.5, s[first - 1], s[first])
        assert abs(root / (550e-9 * 2.4) / 1e3 - expected) < 0.05


# ---- the description


def test_zernike_polynomials_are_orthonormal_and_in_noll_order():
    """Mean over the disc by a rule exact for their degree; the first are those of Noll's table I."""
    from numpy.polynomial.polynomial import polyval2d

    nodes, weights = np.polynomial.legendre.leggauss(16)
    r, t = np.meshgrid((nodes + 1) / 2, 2 * np.pi * np.arange(48) / 48, indexing="ij")
    measure = (weights / 2)[:, None] * r * 2 / 48
    x, y = r * np.cos(t), r * np.sin(t)
    values = [polyval2d(x, y, noll(j)) for j in range(1, 67)]
    gram = [[(a * b * measure).sum() for a in values] for b in values]
    np.testing.assert_allclose(gram, np.eye(66), atol=1e-12)
    for j, expected in (
        (4, np.sqrt(3) * (2 * r**2 - 1)),
        (5, np.sqrt(6) * r**2 * np.sin(2 * t)),
        (8, np.sqrt(8) * (3 * r**3 - 2 * r) * np.cos(t)),
        (11, np.sqrt(5) * (6 * r**4 - 6 * r**2 + 1)),
    ):
        np.testing.assert_allclose(values[j - 1], expected, atol=1e-12)


def test_three_measures_of_defocus_agree():
    """W020 = a^2 / 2 x dioptres = d / (8 N^2) (Goodman 6.4), a = f / 2N; by hand for f/2, 10 mm, at 1 m."""
    optics = Optics(2.0, 10e-3)
    diopters = -1.0  # 1 m, focused at infinity: 1 / inf - 1 / 1
    assert optics.diopters(1.0) == diopters
    w020 = diopters * (10e-3 / 4) ** 2 / 2 / 550e-9
    assert optics.waves([550.0], distance=1.0)[0, 2, 0] == pytest.approx(w020, rel=1e-12)
    moved = Optics(2.0, 10e-3, defocus=optics.displacement(diopters))
    assert moved.waves([550.0])[0, 0, 2] == pytest.approx(w020, rel=1e-12)


def test_wavefront_scales_with_wavelength_and_turns_with_azimuth():
    from numpy.polynomial.polynomial import polyval2d

    optics = Optics(2.8, 4e-3, wavefront=COMA)
    tables = optics.waves([550.0, 1100.0], height=1.0, azimuth=0.9)
    np.testing.assert_allclose(tables[0], 2 * tables[1])
    x, y = 0.3, -0.5
    u, v = x * np.cos(0.9) + y * np.sin(0.9), -x * np.sin(0.9) + y * np.cos(0.9)
    r2 = x * x + y * y
    expected = 0.7 * r2 * u + 0.5 * u * u + 0.4 * r2
    assert polyval2d(x, y, tables[0]) == pytest.approx(expected, abs=1e-14)
    assert v  # the field's own axis alone matters to these terms


def test_axial_colour_is_a_defocus_of_each_wavelength():
    optics = Optics(2.0, 5e-3, defocus=Spectrum([400.0, 600.0], [-4e-6, 4e-6]))
    assert not optics.is_ideal
    np.testing.assert_allclose(
        optics.waves([400.0, 500.0, 600.0])[:, 2, 0],
        [-4e-6 / 32 / 400e-9, 0, 4e-6 / 32 / 600e-9],
        atol=1e-12,
    )


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("pupil = {blades = 2}", "blades"),
        ("pupil = {blades = 6, obscuration = 0.9}", "0.866"),
        ("pupil = {sides = 6}", "obscuration"),
        ("defocus_um = 1e5", "defocus"),
        ("zernike_waves = [99]", "40 waves"),
        ("zernike_waves = 3", "numbers"),
        ("seidel_waves = [1, 2]", "5 numbers"),
        ("reference_nm = 1", "reference_nm"),
        ("defocus_um = 1\ndefocus_diopters = 1", "one of them"),
        ("diffuser_um = -1", "diffuser"),
        ("birefringence_um = [1]", "2 numbers"),
        ("seidel_waves = [nan, 0, 0, 0, 0]", "40 waves in all"),
    ],
)
def test_bad_lenses_are_refused(tmp_path, line, says):
    path = tmp_path / "lens.toml"
    path.write_text(
        f"[optics]\nf_number = 2\nfocal_length_mm = 4\n{line}\n[sensor]\npixel_pitch_um = 1.4\n"
        'qe = "mt9v024"\nfull_well_e = 1000\nbits = 10\n'
    )
    with pytest.raises(BadFile, match="lens") as caught:
        open_camera(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_lens_from_a_file(tmp_path):
    path = tmp_path / "lens.toml"
    path.write_text(
        "[optics]\nf_number = 2\nfocal_length_mm = 4\npupil = {blades = 6, rotation_deg = 90}\n"
        "defocus_diopters = 0.5\nzernike_waves = [0, 0, 0, 0, 0, 0, 0, 0.1]\nreference_nm = 600\n"
        "birefringence_um = [1.4, 0]\ndiffuser_um = 0.2\n"
        '[sensor]\npixel_pitch_um = 1.4\nqe = "mt9v024"\nfull_well_e = 1000\nbits = 10\n'
    )
    optics = open_camera(path).optics
    assert optics.pupil == Pupil(6, 0.0, np.pi / 2)
    assert optics.defocus == pytest.approx(0.5 * 4e-3**2)
    assert optics.wavefront.reference == 600
    assert optics.birefringence == (1.4e-6, 0)
    assert not optics.is_symmetric


# ---- given point spreads


def test_pixel_energies_are_used_as_they_are():
    """The tables' transform is the kernel itself, to rounding."""
    kernel = np.random.default_rng(3).random((2, 5, 7))
    spread = PointSpread([500.0, 600.0], kernel, 2e-6, integrated=True)
    tables = psf_tables(spread, [500.0, 600.0], 2e-6, 0.9, 16, 15).view(complex)
    image = np.roll(np.fft.irfft2(tables, (16, 15)), (2, 3), axis=(1, 2))[:, :5, :7]
    np.testing.assert_allclose(image, kernel / kernel.sum(axis=(1, 2), keepdims=True), atol=1e-15)


@pytest.mark.parametrize("ratio", [0.25, 0.3, 0.5])
def test_sampled_irradiance_is_integrated_over_the_pixel(ratio):
    """A Gaussian of 0.6 pixels, sampled: the pixel's energies by the error function.

    Its transform at half the rate of the coarsest samples (1 cycle/pixel) is exp(-2 (pi 0.6)^2) = 8e-4 of its peak,
    a share of 1e-5 of the energy lies beyond 1 / (2 spacing) for ratio 0.5, less for the finer ones.
    """
    n = int(12 / ratio) | 1
    x = (np.arange(n) - n // 2) * ratio
    line = np.exp(-x * x / (2 * 0.6**2))
    spread = PointSpread([550.0], np.outer(line, line)[None], ratio * 2e-6)
    tables = psf_tables(spread, [550.0], 2e-6, 1.0, 32, 32).view(complex)
    image = np.roll(np.fft.irfft2(tables[0], (32, 32)), (6, 6), axis=(0, 1))[:13, :13]
    np.testing.assert_allclose(image, gaussian_kernel(0.6, 6), atol=2e-4 if ratio == 0.5 else 1e-6)


def test_pillbox_is_the_area_of_the_disc_in_each_pixel():
    """Corners by adaptive integration of the chord; sum 1 whatever the diameter."""
    from scipy.integrate import quad

    kernel = pillbox_kernel(5.3)
    r = 2.65
    area = quad(
        lambda x: np.clip(np.sqrt(max(r * r - x * x, 0)), 0.5, 1.5) - 0.5, 1.5, 2.5, limit=200
    )[0]
    assert kernel[4, 5] == pytest.approx(area / (np.pi * r * r), abs=1e-9)
    for diameter in (0.3, 1.0, 1.2, 7.0, 20.4):
        assert abs(pillbox_kernel(diameter).sum() - 1) < 1e-13


def test_point_spreads_from_a_file(tmp_path):
    path = tmp_path / "lens.npz"
    np.savez(path, wavelengths_nm=[500.0, 600.0], psf=np.ones((2, 3, 5)), spacing_um=0.5)
    spread = read_psf(path)
    assert spread.values.shape == (2, 3, 5)
    assert (spread.spacing, spread.integrated) == (0.5e-6, False)
    np.savez(path, wavelengths_nm=[500.0], psf=np.full((1, 3, 3), -1.0), spacing_um=0.5)
    with pytest.raises(BadFile, match="negative"):
        read_psf(path)
    np.savez(path, psf=np.ones((1, 3, 3)))
    with pytest.raises(BadFile, match="lacks wavelengths_nm, spacing_um"):
        read_psf(path)
    path.write_bytes(b"PK" + bytes(30))
    with pytest.raises(BadFile, match=r"not an \.npz archive"):
        read_psf(path)
    with pytest.raises(BadFile, match="no such file"):
        read_psf(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.zeros((1, 0, 3)), "shape"),
        (np.full((1, 3, 3), -1.0), "negative"),
        (np.full((1, 3, 3), np.nan), "NaN"),
        (np.zeros((1, 3, 3)), "no energy"),
        (np.ones((2, 3, 3)), "wavelengths"),
    ],
)
def test_bad_point_spreads_are_refused(values, says):
    with pytest.raises(BadData, match=says):
        PointSpread([550.0], values, 1e-6)


def test_point_spreads_that_do_not_go_with_the_scene_are_refused():
    spread = PointSpread([500.0, 600.0], np.ones((2, 9, 9)), 1e-6)
    for arguments, says in (
        (([400.0], 1e-6, 1.0, 32, 32), "500 .. 600"),
        (([550.0], 1e-6, 1.0, 8, 32), "8 pixels"),
        (([550.0], 1e-6, 1.0, 32, 32, 0.7e-6), "0.7 um"),
    ):
        with pytest.raises(OutOfRange, match=says):
            psf_tables(spread, *arguments)
    with pytest.raises(OutOfRange, match="pixel pitch"):
        psf_tables(
            PointSpread([550.0], np.ones((1, 3, 3)), 1e-6, integrated=True),
            [550.0],
            2e-6,
            1.0,
            32,
            32,
        )
