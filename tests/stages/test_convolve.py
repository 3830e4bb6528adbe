"""Direct convolution against SciPy in float64: accuracy beside highlights, flat fields, energy, and what is refused."""

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES, KINDS
from scipy import ndimage

from gpusim.domain.errors import BadData, UnknownName
from gpusim.kernels.optics.convolve import convolve

MODES = {"zero": "constant", "edge": "nearest", "reflect": "reflect"}
random = np.random.default_rng(20)


def psf(size, width):
    y, x = np.mgrid[:size, :size] - size // 2
    kernel = 1 / (1 + ((y + 0.3 * x) ** 2 + x**2) / width**2) ** 1.5  # lopsided: a flip would show
    return kernel / kernel.sum()


def truth(plane, kernel, border):
    return ndimage.convolve(plane.astype(float), kernel.astype(float), mode=MODES[border])


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("border", MODES)
@pytest.mark.parametrize("height", [1e6, 1e9])
def test_exact_mode_beside_highlights(device, border, height):
    """Every pixel to 1e-6 of its own value: within the kernel's reach of a highlight, at its edge, and far away."""
    plane = random.uniform(0.5, 1.5, (90, 140)).astype(np.float32)
    plane[20, 30] = plane[60, 138] = height
    for size in (15, 31):
        kernel = psf(size, 2.0)
        result = convolve(plane[None], kernel[None], border, "double", device=device)[0]
        expected = truth(plane, kernel, border)
        # the line; rounding to float32 is 6e-8 of it
        assert np.abs(result / expected - 1).max() <= 1e-6


@pytest.mark.parametrize("device", KINDS)
def test_single_precision_errs_only_where_the_highlight_reaches(device):
    plane = random.uniform(0.5, 1.5, (64, 100)).astype(np.float32)
    kernel = psf(15, 2.0).astype(np.float32)
    quiet = convolve(plane[None], kernel[None], "edge", device=device)[0]
    plane[30, 40] = 1e9
    loud = convolve(plane[None], kernel[None], "edge", device=device)[0]
    far = np.ones(plane.shape, bool)
    far[30 - 7 : 30 + 8, 40 - 7 : 40 + 8] = False
    assert np.array_equal(
        quiet[far], loud[far]
    )  # other pixels' sums have the same terms in the same order
    expected = truth(plane, kernel, "edge")
    # 225 positive terms, random roundings of 6e-8 with 4 sigma: 4 sqrt(225) 6e-8
    assert np.abs(loud / expected - 1).max() <= 3.6e-6


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_energy_and_flat_fields(device, precision):
    """A flat field keeps its value under "edge" and "reflect"; a point in the middle keeps its sum."""
    kernel = psf(15, 3.0)
    flat = np.full((1, 40, 70), 0.7, np.float32)
    for border in ("edge", "reflect"):
        result = convolve(flat, kernel[None], border, precision, device=device)
        # kernel values round by 3e-8 each of their own size, the sum of 225 terms by sqrt(225) of 6e-8 at most
        assert np.abs(result / np.float32(0.7) - 1).max() <= 1e-6
    point = np.zeros((1, 40, 70), np.float32)
    point[0, 20, 35] = 1
    result = convolve(point, kernel[None], "zero", precision, device=device)
    assert abs(result.sum(dtype=float) - 1) <= 1e-6  # as above: each pixel has one term
    assert np.allclose(
        result[0, 13:28, 28:43], kernel, rtol=2e-7, atol=0
    )  # two roundings to float32; not mirrored


@pytest.mark.parametrize("device", KINDS)
def test_each_plane_its_own_kernel_of_unequal_sides(device):
    planes = random.random((3, 37, 50), np.float32)
    kernels = random.random((3, 9, 21)) / 189
    for precision, tolerance in (
        ("single", 4 * np.sqrt(189) * 6e-8),
        ("double", 1e-7),
    ):  # as in the stage's cases
        result = convolve(planes, kernels, "reflect", precision, device=device)
        for out, plane, kernel in zip(result, planes, kernels, strict=True):
            expected = truth(plane, kernel, "reflect")
            assert np.abs(out / expected - 1).max() <= tolerance


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize(
    "kernels, words",
    [
        (np.ones((1, 0, 3)), ["(1, 0, 3)", "zero"]),
        (np.ones((1, 4, 3)), ["4 x 3", "odd"]),
        (np.ones((2, 3, 3)), ["2 kernels for 3 planes"]),
        (np.ones((1, 23, 3)), ["23 x 3", "20 x 30"]),
        (np.full((1, 3, 3), np.nan), ["nan", "(0, 0)"]),
        (np.full((1, 3, 3), -np.inf), ["inf"]),
        (np.ones((3, 3)), ["(3, 3)"]),
    ],
)
def test_kernels_that_cannot_be_used_are_refused_with_the_figures(device, kernels, words):
    with pytest.raises(BadData) as caught:
        convolve(np.ones((3, 20, 30), np.float32), kernels, device=device)
    assert all(word in str(caught.value) for word in words)
    assert "\n" not in str(caught.value)


def test_unknown_options_are_refused():
    planes, kernels = np.ones((1, 5, 5), np.float32), np.ones((1, 3, 3))
    with pytest.raises(UnknownName, match="edge"):
        convolve(planes, kernels, "edges", device=DEVICES[0])
    with pytest.raises(UnknownName, match="double"):
        convolve(planes, kernels, "edge", "doubel", device=DEVICES[0])
    with pytest.raises(BadData, match="planes of shape"):
        convolve(np.ones((1, 0, 5), np.float32), kernels, device=DEVICES[0])


@pytest.mark.parametrize("device", KINDS)
def test_negative_kernels_are_allowed(device):
    """Weighted planes have kernels with negative parts; whether a PSF may be negative is asked where it is read."""
    plane = random.random((1, 30, 30), np.float32)
    kernel = random.uniform(-1, 1, (1, 5, 5))
    result = convolve(plane, kernel, "zero", "double", device=device)
    # rounded once to float32: 6e-8 of values below 6
    assert np.abs(result[0] - truth(plane[0], kernel[0], "zero")).max() <= 4e-7
