"""Denoising after demosaicking: what it knows of the noise, and what it leaves of noise and picture."""

from dataclasses import replace

import colour
import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.interpolate import interpolate
from gpusim.kernels.processor.malvar import malvar
from gpusim.kernels.processor.multiscale import multiscale, opponent_axes
from gpusim.pipeline.demosaicked_noise import LEVELS, measure_noise, white_noise

D65 = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
ELECTRONS, READ, GAIN = 20, 2.0, 16.0  # of a flat field [e-], [DN/e-]


def flat_mosaic(size, seed=0):
    """Digital numbers of a grey field of 20 electrons, and the options of stages that develop them to 0.2."""
    random = np.random.default_rng(seed)
    electrons = random.poisson(ELECTRONS, (size, size)) + READ * random.standard_normal(
        (size, size)
    )
    raw = np.rint(500 + GAIN * electrons).clip(0, 65535).astype(np.uint16)
    return raw, {"black_level": 500.0, "scale": 0.2 / ELECTRONS / GAIN}


def clean(planes, noise, measured, **options):
    axes = opponent_axes(measured.large_scale, np.ones(3))
    known = {"axes": axes, "spread": measured.spread(axes), "share": measured.share}
    return multiscale(planes, noise=noise, **known, **options, device="opencl")


def lab_of_blocks(planes):
    """CIELAB of the means of 8 x 8 pixels of linear sRGB, by colour-science."""
    lab = colour.XYZ_to_Lab(colour.RGB_to_XYZ(np.moveaxis(planes, 0, 2).clip(0, 1), "sRGB"), D65)
    rows, cols = (n // 8 for n in lab.shape[:2])
    return lab.reshape(rows, 8, cols, 8, 3).mean((1, 3))


def test_colour_blotches_of_a_dim_field_are_gone():
    """Standard deviation of a* and b* of 8 x 8 means at 20 e-: at most .6 and .7, what CBM3D leaves.

    Without denoising it is three times as much. The mean stays within 1 %: 20 electrons in 65,536
    pixels err by 0.1 %, the rest is the inverse of the root after a demosaicker that averages itself.
    """
    raw, options = flat_mosaic(256)
    told = 0.4
    noise = (options["scale"] * GAIN, options["scale"] * GAIN * READ)
    made = best(raw, phase="RGGB", noise=(told * GAIN, GAIN * READ), device="opencl", **options)
    result = clean(made, noise, measure_noise(best, {"phase": "RGGB"}, told))
    before, after = (lab_of_blocks(planes)[..., 1:].std((0, 1)) for planes in (made, result))
    assert after[0] <= 0.6 and after[1] <= 0.7
    assert (before > 3 * after).all()
    np.testing.assert_allclose(result.mean((1, 2)), 0.2, rtol=0.01)


@pytest.mark.parametrize(
    ("demosaic", "arguments"),
    [
        (bilinear, {"phase": "RGGB"}),
        (malvar, {"phase": "GBRG"}),
        (adaptive, {"phase": "RGGB"}),
        (interpolate, {"cfa": np.array([[0, 1, 2], [1, 2, 0]], np.int32)}),
    ],
    ids=["bilinear", "malvar", "adaptive", "interpolate"],
)
def test_noise_of_large_areas_is_that_of_the_samples(demosaic, arguments):
    """A mean over n pixels of a channel with the share d of the samples has the variance 1 / (n d), uncorrelated.

    It is measured by waves of 16 pixels, of which bilinear interpolation keeps cos^2(pi / 16) of the
    amplitude each way, 86 % of the variance. With 144 independent blocks and three coefficients each,
    variances err by 7 % and correlations by 5 % (1 sigma): three of these.
    """
    measured = measure_noise(demosaic, arguments)
    found = measured.large_scale
    pattern = arguments.get("cfa", np.array([[0, 1], [1, 2]]))
    wanted = pattern.size / np.bincount(pattern.ravel())
    ratio = np.diag(found) / wanted
    assert (0.86 * 0.79 < ratio).all() and (ratio < 1.21).all()
    across = found / np.sqrt(np.outer(np.diag(found), np.diag(found))) - np.eye(3)
    assert np.abs(across).max() < 0.15


def test_known_spread_is_that_of_another_field():
    """At another light and with read noise the coefficients have the deviations that were measured.

    Roots of 20 electrons have a variance of 1 within 2 %; 64 x 64 blocks of 4 x 4 err by 2 % each way.
    """
    measured = measure_noise(malvar, {"phase": "RGGB"})
    raw, options = flat_mosaic(256, seed=3)
    gain, read = options["scale"] * GAIN, options["scale"] * GAIN * READ
    planes = malvar(raw, phase="RGGB", device="numpy", **options)
    roots = 2 * np.sqrt(np.maximum(planes / gain + 3 / 8 + (read / gain) ** 2, 0))
    axes = opponent_axes(measured.large_scale, np.ones(3))
    values = np.tensordot(axes, roots, 1).reshape(3, 64, 4, 64, 4)
    zigzag = values @ np.array([1, -1, 1, -1]) / 2  # along; down alike
    zigzag = np.einsum("cayb,y->cab", zigzag, np.array([1, -1, 1, -1]) / 2)
    np.testing.assert_allclose(measured.spread(axes)[0, :, 3, 3], zigzag.std((1, 2)), rtol=0.08)


def test_opponent_axes_decorrelate_the_noise_and_grey_has_no_chroma():
    """Bayer: (R + 2 G + B), (R - B) and (2 G - R - B) have no common noise; by algebra for other balances."""
    density = np.array([0.25, 0.5, 0.25])
    axes = opponent_axes(np.diag(1 / density), np.ones(3))
    np.testing.assert_allclose(axes[0] / axes[0, 0], [1, 2, 1], rtol=1e-12)
    balance = np.array([1.9, 1.0, 1.4])
    axes = opponent_axes(np.diag(1 / density), balance)
    np.testing.assert_allclose(axes @ np.diag(1 / density) @ axes.T, np.eye(3), atol=1e-12)
    grey = 1 / np.sqrt(balance)  # roots of channels to which grey is 1 / balance
    np.testing.assert_allclose(axes[1:] @ grey, 0, atol=1e-12)


def test_what_stands_out_of_the_noise_stays():
    """Noise of 1e-4 of a picture's contrasts changes it by no more than thresholds of a few of it, at no pixel."""
    random = np.random.default_rng(2)
    planes = random.uniform(0.2, 0.8, (3, 60, 90)).astype(np.float32)
    noise = (0.0, 1e-5)
    result = clean(planes, noise, white_noise(3))
    assert np.abs(result - planes).max() < 15 * noise[1]


def test_strength_and_noise_go_to_zero_continuously():
    """Ever less strength changes the picture ever less, and none not at all."""
    raw, options = flat_mosaic(64)
    planes = bilinear(raw, phase="RGGB", device="opencl", **options)
    noise = (options["scale"] * GAIN, options["scale"] * GAIN * READ)
    measured = measure_noise(bilinear, {"phase": "RGGB"})
    changes = [
        np.abs(clean(planes, noise, measured, strength=strength) - planes).max()
        for strength in (1.0, 0.1, 0.01, 0.0)
    ]
    assert changes[0] > 3 * changes[1] > 9 * changes[2] > changes[3] == 0


def test_shading_that_was_corrected_is_known():
    """Noise of a corner that was raised by 4 is removed there as in the middle of a picture without shading."""
    random, gain = np.random.default_rng(5), 0.01
    light = np.ones((3, 96, 96)) * 0.3
    seen = gain * random.poisson(light / gain)
    plain = clean(seen, (gain, 0.0), white_noise(3))
    raised = clean(4 * seen, (gain, 0.0), white_noise(3), gains=np.full((2, 2), 4.0))
    np.testing.assert_allclose(raised, 4 * plain, rtol=1e-5)
    assert plain.std() < 0.2 * seen.std()


@pytest.mark.parametrize(
    "changes",
    [
        {"cfa": "x-trans", "demosaic": "bilinear"},
        {"cfa": "rgbw", "color": "none"},
        {"stacked": True},
        {"demosaic": "network"},
        {"binning": [2, 2]},
        {"demosaic": "learned", "shading": True},
    ],
    ids=lambda changes: " ".join(map(str, changes.values())),
)
def test_every_camera_is_quieter_and_as_bright(changes):
    """A dim flat field: its noise falls by a quarter, and its mean stays within 3 standard errors and 1 %.

    The network has left little noise, of which the longest waves stay: of that a tenth must go.
    """
    camera = gs.open_camera("phone").with_(exposure_time_ms=4.0, analog_gain=8.0, **changes)
    scene = gs.chart("flat", size=(96, 96), luminance=30)
    plain, quiet = (
        gs.Simulator(camera.with_(denoise=strength), device="opencl")(scene, seed=1).linear
        for strength in (0.0, 1.0)
    )
    inner = (slice(8, -8), slice(8, -8))
    left = 0.9 if changes.get("demosaic") == "network" else 0.75
    assert (quiet[inner].std((0, 1)) < left * plain[inner].std((0, 1))).all()
    error = 3 * plain[inner].std((0, 1)) / np.sqrt(80 * 80 / 4)
    assert (np.abs(quiet.mean((0, 1)) - plain.mean((0, 1))) < 0.01 * plain.mean() + error).all()


def test_a_merged_burst_is_denoised_by_its_own_noise():
    """The merged frame of four has half the noise of one, before and after denoising less than that."""
    camera = gs.open_camera("phone").with_(exposure_time_ms=2.0, denoise=1.0)
    simulator = gs.Simulator(camera, device="opencl")
    scene = gs.chart("flat", size=(96, 96), luminance=30)
    frames = gs.burst(simulator, scene, 4)
    merged = gs.merge_burst(simulator, frames)
    inner = (slice(8, -8), slice(8, -8), 1)
    assert merged.linear[inner].std() < 0.8 * frames[0].linear[inner].std()
    assert "processor.multiscale" in [stage.stage for stage in merged.report.stages]


def test_multiscale_refuses_wrong_input():
    axes, planes = np.eye(3), np.ones((3, 8, 8), np.float32)
    good = {
        "noise": (0.01, 0.0),
        "axes": axes,
        "spread": white_noise(3).spread(axes),
        "share": np.ones(3),
        "device": "opencl",
    }
    assert good["spread"].shape == (LEVELS, 3, 4, 4)
    for key, value in (
        ("axes", np.zeros((3, 3))),
        ("axes", np.eye(2)),
        ("spread", np.ones((1, 3, 4, 4))),
        ("share", np.ones(2)),
        ("gains", np.ones((1, 4))),
    ):
        with pytest.raises(BadData, match="multiscale"):
            multiscale(planes, **good | {key: value})
    with pytest.raises(BadData, match="multiscale"):
        multiscale(planes[0], **good)
    for key, value in (
        ("noise", (-1.0, 0.0)),
        ("spread", -good["spread"]),
        ("share", np.full(3, np.nan)),
        ("strength", 101.0),
        ("gains", np.zeros((2, 2))),
    ):
        with pytest.raises(OutOfRange):
            multiscale(planes, **good | {key: value})


def test_the_report_says_how_it_was_denoised():
    camera = gs.open_camera("phone").with_(denoise=0.7)
    scene = gs.chart("flat", size=(48, 48))
    for by, stage, words in (
        ("multiscale", "processor.multiscale", "5 scales"),
        ("mosaic", "processor.denoise", "mosaic denoised"),
    ):
        own = replace(camera, processor=replace(camera.processor, denoise_by=by))
        report = gs.Simulator(own, device="opencl")(scene).report
        found = {one.stage: one.model for one in report.stages}
        assert words in found[stage] and "strength 0.7" in found[stage]
