"""The blur against theory: closed forms and direct integration, not the library's own reference."""

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from scipy.integrate import dblquad
from scipy.special import j1

from gpusim.backends import open_device
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.airy_ref import otf
from gpusim.kernels.optics.blur import blur, blur_spectra, transform


def airy_pattern(r, q):
    """Irradiance of a point of energy 1 at distance r [pixel]; q = lambda N / pitch. Born & Wolf 8.5.2."""
    v = np.pi * r / q
    return np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2 if v > 1e-9 else np.pi / (4 * q * q)


def pixel_energy(x, y, q, aperture):
    """Energy that falls into the pixel aperture centred at (x, y), by adaptive quadrature."""
    half = aperture / 2
    return (
        dblquad(
            lambda v, u: airy_pattern(np.hypot(u, v), q),
            x - half,
            x + half,
            y - half,
            y + half,
            epsabs=1e-10,
        )[0]
        / aperture**2
    )


@pytest.mark.parametrize("q", [0.3, 0.71, 1.1, 3.14])
def test_otf_is_the_transform_of_the_airy_pattern(q):
    """Hankel transform of the pattern by quadrature; its slow tail beyond R is added from the asymptotic form."""
    from scipy.integrate import quad
    from scipy.special import j0

    for s in (0.1, 0.35, 0.6, 0.9):
        # int_0^inf J1(x)^2 / x J0(2 s x) dx x 2 = O(s), the normalised pattern in x = pi r / q
        total = (
            2
            * quad(lambda x, s=s: j1(x) ** 2 / x * j0(2 * s * x), 0, 400, limit=2000, epsabs=1e-11)[
                0
            ]
        )
        # |J1^2 / x J0| < (2 / pi x)^1.5 / x beyond 400: the tail is below 2 int x^-2.5 0.51 = 8.5e-5
        assert abs(total - otf(s)) < 1e-4


def test_otf_closed_form_values():
    """O(0) = 1, O(1) = 0, O(1/2) = 2/pi (pi/3 - sqrt(3)/4) from the area of two overlapping circles."""
    np.testing.assert_allclose(
        otf(np.array([0, 0.5, 1, 2])), [1, 2 / 3 - np.sqrt(3) / (2 * np.pi), 0, 0], atol=1e-15
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(("q", "fill"), [(0.71, 1.0), (1.1, 0.75), (3.14, 1.0)])
def test_image_of_a_point_is_the_airy_pattern_integrated_over_pixels(q, fill, device):
    """Peak and neighbours, by adaptive quadrature over the aperture, within 1e-5 of the peak.

    The only difference in theory is the pattern's energy beyond the period of 512 pixels that folds back: about
    0.2 q / 256 of it, spread over 512^2 pixels: 1e-8 per pixel. float32 adds 3e-7 of the peak.
    """
    size, period = 15, (512, 512)
    tables = airy(np.array([q], np.float32), np.sqrt(fill), *period, device=device)
    point = np.zeros((1, size, size), np.float32)
    point[0, 7, 7] = 1
    image = blur(point, tables[None], np.ones((1, 1)), "zero", period, device=device)[0]
    q = float(np.float32(q))
    truth = {
        (dy, dx): pixel_energy(dx, dy, q, np.sqrt(fill))
        for dy, dx in ((0, 0), (0, 1), (1, 1), (2, 0), (3, 2))
    }
    for (dy, dx), energy in truth.items():
        assert abs(image[7 + dy, 7 + dx] - energy) < 1e-5 * truth[0, 0]
    np.testing.assert_allclose(image, image.T, atol=1e-6 * truth[0, 0])


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("border", ["edge", "reflect"])
def test_flat_field_stays_flat(border, device):
    """T(0) = 1 and the surroundings go on: a flat field is unchanged to the rounding of two float32 transforms."""
    period = (80, 90)
    tables = airy(np.array([0.7, 2.0], np.float32), 1.0, *period, device=device)
    image = blur(
        np.full((2, 17, 31), 3.0, np.float32),
        tables[None],
        np.array([[1.0, 2.0]]),
        border,
        period,
        device=device,
    )
    np.testing.assert_allclose(image, 9.0, rtol=1e-6)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_no_ringing_beside_a_highlight(device):
    """A 1e6 highlight leaves nothing below -1e-6 of its peak; cut at Nyquist the OTF rings to -1.6e-2."""
    period = (135, 135)
    tables = airy(np.array([0.99], np.float32), 1.0, *period, device=device)
    point = np.zeros((1, 65, 65), np.float32)
    point[0, 32, 32] = 1e6
    image = blur(point, tables[None], np.ones((1, 1)), "zero", period, device=device)
    assert image.min() > -1e-6 * image.max()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_border_rules(device):
    """Outside is dark, goes on, or is mirrored; a 3-pixel box kernel shows it in closed form."""
    period = (16, 16)
    f = np.arange(9) / 16
    box = ((1 + 2 * np.cos(2 * np.pi * f)) / 3).astype(np.float32)
    tables = np.broadcast_to(box, (1, 1, 9, 9)).copy()  # blurs along x alone
    row = np.tile(np.array([6.0, 3.0, 0.0, 9.0], np.float32), (1, 2, 1))
    for border, ends in {"zero": (3.0, 3.0), "edge": (5.0, 6.0), "reflect": (5.0, 6.0)}.items():
        image = blur(row, tables, np.ones((1, 1)), border, period, device=device)
        np.testing.assert_allclose(image[0], [[ends[0], 3.0, 4.0, ends[1]]] * 2, atol=1e-5)


@pytest.mark.parametrize("name", KINDS)
def test_transformed_planes_are_blurred(name):
    """By the quarter of an even kernel, and the half of another: as by sums in real space, wrapped at the period."""
    random, device, period = np.random.default_rng(4), open_device(name), (24, 30)
    planes, mix = random.random((2, 15, 20), np.float32), random.random((3, 2), np.float32)
    even, odd = np.zeros((2, *period)), np.zeros((2, *period))
    even[:, 0, 0], even[:, 0, [1, -1]], even[:, [2, -2], 0] = 0.5, 0.15, 0.1
    odd[:, 1, 2], odd[:, -2, 1], odd[1, 0, 3] = 0.2, -0.1, 0.05
    quarter = np.fft.rfft2(even).real[:, : period[0] // 2 + 1][None].astype(np.float32)
    half = np.ascontiguousarray(np.fft.rfft2(odd)[None], np.complex64).view(np.float32)
    spectra = transform(planes, "zero", period, device)
    world = np.zeros((2, *period))
    world[:, 4:19, 5:25] = planes
    for kernel, tables in ((even, quarter), (odd, half)):
        wanted = np.zeros((3, *period))
        for k, y, x in np.argwhere(kernel):
            moved = np.roll(world[k], (y, x), (0, 1))
            wanted += kernel[k, y, x] * mix[:, k, None, None] * moved
        found = device.numpy(blur_spectra(spectra, tables, mix, (15, 20), period, 2, device))
        np.testing.assert_allclose(found, wanted[:, 6:17, 7:23], atol=3e-6)
