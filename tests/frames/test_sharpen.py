"""Sharpening: against OpenCV and SciPy, against measured responses of the whole camera, in noise, and merged."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.ndimage
from devices import ALL_KINDS

import gpusim as gs
from gpusim.kernels.processor.sharpen import LUMINANCE, detail_gain, sharpen, system_kernel
from gpusim.measure import sfr

QUIET = {"photon": "none", "read_e": 0, "prnu": 0, "dsnu_e": 0, "dark_current_e_per_s": 0}
NONE = np.zeros(2, np.float32)


def _gaussian(sigma):
    """Response of a Gaussian blur [pixel] below half a cycle per pixel."""
    f = np.fft.fftfreq(16)
    return np.exp(-2 * (np.pi * sigma) ** 2 * (f[:, None] ** 2 + f**2))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_without_noise_it_is_opencv_s_unsharp_mask(device):
    """OpenCV correlates the luminance in float64; ours sums 3 products and 81 at most, of order 1, in float32."""
    random = np.random.default_rng(3)
    rgb, kernel = random.random((3, 37, 53), np.float32), random.random((7, 7), np.float32)
    kernel /= kernel.sum()
    light = np.tensordot(LUMINANCE.astype(float), rgb.astype(float), 1)
    blurred = cv2.filter2D(light, -1, kernel.astype(float), borderType=cv2.BORDER_REPLICATE)
    found = sharpen(rgb, kernel, LUMINANCE, NONE, strength=1.5, device=device)
    np.testing.assert_allclose(found, rgb + 1.5 * (light - blurred), atol=90 * 2.0**-24)


def test_the_kernel_of_a_wide_gaussian_is_a_gaussian():
    """Nothing of it is above half a cycle per pixel, e^-7. Up to 3 % are left out; the rest is divided by its sum."""
    kernel = system_kernel(_gaussian(1.2))
    x = np.arange(len(kernel)) - len(kernel) // 2
    wanted = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 1.2**2)) / (2 * np.pi * 1.2**2)
    np.testing.assert_allclose(kernel, wanted, atol=0.03 * wanted.max() + 1e-3)


def test_noise_gain_is_that_of_white_noise():
    """The variance of 512 x 512 independent values is known to 0.3 % (one sigma)."""
    kernel, noise = system_kernel(_gaussian(0.5)), np.random.default_rng(1).normal(0, 1, (512, 512))
    blurred = cv2.filter2D(noise, -1, kernel.astype(float))
    assert (noise - blurred).var() == pytest.approx(detail_gain(kernel), rel=0.015)


def test_a_kernel_to_one_side_looks_where_the_blur_came_from():
    """A camera that moves light one pixel to the right: what it shows at x comes from x - 1, as SciPy moves it."""
    f = np.fft.fftfreq(16)
    kernel = system_kernel(_gaussian(1.0) * np.exp(-2j * np.pi * f))
    light = np.random.default_rng(2).random((20, 20))
    ours = cv2.filter2D(light, -1, kernel.astype(float), borderType=cv2.BORDER_REPLICATE)
    moved = scipy.ndimage.shift(
        scipy.ndimage.gaussian_filter(light, 1.0), (0, 1), order=0, mode="nearest"
    )
    assert np.corrcoef(ours[5:-5, 5:-5].ravel(), moved[5:-5, 5:-5].ravel())[0, 1] > 0.99


def _edge(**changes):
    camera = gs.open_camera("mono").with_(**QUIET, f_number=4.0, bits=16, **changes)
    frame = gs.Simulator(camera, device="opencl")(gs.chart("slanted-edge", size=(160, 160)))
    return sfr(frame.linear[..., 1])


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_contrast_rises_by_what_the_camera_s_own_response_lacks(strength):
    """The measured response H becomes H (1 + s (1 - H)): ISO 12233's edge measures both.

    The kernel's window leaves out up to 3 % of its light: H errs by up to 0.02, times s H; the measure of a
    diffraction-limited edge errs by 0.01, and the aliases of this camera by as much.
    """
    before, after = _edge(), _edge(sharpen=strength)
    below = (before.frequencies > 0.02) & (before.frequencies < 0.45)
    h = np.ravel(before.response)[below]
    wanted = h * (1 + strength * (1 - h))
    found = np.ravel(after.response)[below]
    assert np.abs(found - wanted).max() < 0.02 + 0.02 * strength
    assert found[-1] > 1.1 * h[-1]  # it is no identity


def test_noise_is_not_sharpened(monkeypatch):
    """A flat field of 200 electrons at most: half of a detail of 3 sigma is left, and less of all smaller ones.

    White noise of 1 sigma has 1 / 10 of its detail left: at strength 2 the deviation may rise by 15 %. Without the
    threshold it rises by more than 50 %.
    """
    camera = gs.open_camera("phone").with_(
        white_balance="none", demosaic="bilinear", exposure_time_ms=1.0
    )
    flat = gs.chart("flat", size=(96, 96))

    def deviation(strength):
        frame = gs.Simulator(camera.with_(sharpen=strength), device="opencl")(flat)
        assert frame.mean.mean() < 200
        return (frame.linear @ frame.camera.display.xyz_from_rgb[1]).std()

    plain, with_threshold = deviation(0.0), deviation(2.0)
    monkeypatch.setattr("gpusim.pipeline.finishing.SHARPENED", 0.0)
    without = deviation(2.0)
    assert with_threshold < 1.15 * plain and without > 1.5 * plain


@pytest.mark.parametrize("name", ["mono", "stacked", "x-trans", "learned"])
def test_other_sensors_are_sharpened_too(name):
    changes = {
        "mono": {},
        "stacked": {"stacked": True},
        "x-trans": {"cfa": "x-trans"},
        "learned": {"demosaic": "learned"},
    }[name]
    camera = gs.open_camera("mono" if name == "mono" else "phone").with_(**QUIET, **changes)
    scene = gs.chart("slanted-edge", size=(48, 48))
    plain, sharp = (
        gs.Simulator(camera.with_(sharpen=strength), device="numpy")(scene)
        for strength in (0.0, 1.0)
    )
    steepest = [np.abs(np.diff(one.linear[..., 1], axis=1)).max() for one in (plain, sharp)]
    assert steepest[1] > 1.05 * steepest[0]
    assert "processor.sharpen" in [stage.stage for stage in sharp.report.stages]


def test_merged_frames_are_sharpened_once():
    camera = gs.open_camera("phone").with_(**QUIET)
    scene = gs.chart("slanted-edge", size=(64, 64))
    pictures = {}
    for strength in (0.0, 1.0):
        simulator = gs.Simulator(camera.with_(sharpen=strength), device="opencl")
        merged = gs.merge_bracket(simulator, gs.bracket(simulator, scene, (-1, 0)))
        pictures[strength] = merged.linear, simulator(scene).linear
        stages = [stage.stage for stage in merged.report.stages]
        assert len({*stages}) == len(stages)
        assert stages[-2:] == [
            "processor.sharpen" if strength else "processor.color",
            "display.encode",
        ]
    added = [one - other for one, other in zip(pictures[1.0], pictures[0.0], strict=True)]
    # scaled alike up to the quantisation of 10 bits, where the edge is
    assert np.abs(added[0]).max() == pytest.approx(np.abs(added[1]).max(), rel=0.1)


def test_binned_pixels_are_sharpened_as_one_pixel_of_their_area():
    """Twice the pitch is half the blur in pixels: the same kernel as of a camera with large pixels."""
    camera = gs.open_camera("mono").with_(sharpen=1.0)
    binned = replace(camera, sensor=replace(camera.sensor, binning=(2, 2)))
    large = replace(
        camera, sensor=replace(camera.sensor, pixel_pitch=2 * camera.sensor.pixel_pitch)
    )
    scene = gs.chart("flat", size=(32, 32))
    single, double, wanted = (
        gs.Simulator(one, device="numpy").expose(scene).kernel for one in (camera, binned, large)
    )
    np.testing.assert_allclose(double, wanted, atol=1e-6)
    assert double.max() > 1.05 * single.max()
