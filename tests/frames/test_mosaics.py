"""Every mosaic and every demosaicker: equal level, flat fields, what is chosen by default and named."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim.backends.select import open_device
from gpusim.data.charts import chart
from gpusim.data.lights import illuminant
from gpusim.domain.errors import OutOfRange
from gpusim.domain.mosaics import MOSAICS, bayer_phase, bayer_roles
from gpusim.domain.processor import DEMOSAICS
from gpusim.io.camera.cameras import open_camera
from gpusim.io.scene.arrays import scene_from
from gpusim.pipeline.demosaicked_noise import DemosaickedNoise
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.exposure import output_of
from gpusim.pipeline.simulator import Simulator

# what suits each mosaic that is not Bayer's
LIKE_BAYER = ("rccb", "ryyb", "cyym")
WITH_FILTERS = (
    "x-trans",
    "quad-bayer",
    "rgbw",
    "rgbw-kodak",
    "rgbn",
    "rgbn-4x4",
    "rccc",
    "cygm",
    "rgbe",
)
LARGER_PERIODS = ("x-trans", "quad-bayer", "rgbw-kodak", "rgbn-4x4")


def phone(mosaic, demosaic="auto", **sensor):
    """The phone with another mosaic, without noise and fall-off, 16 bits."""
    camera = open_camera("phone")
    noise = replace(
        camera.sensor.noise, photon="none", read=0.0, prnu=0.0, dsnu=0.0, dark_current=0.0
    )
    camera = replace(
        camera,
        sensor=replace(camera.sensor, noise=noise, vignetting=None, bits=16, **sensor),
        optics=replace(camera.optics, relative_illumination="none"),
    )
    return camera.with_(cfa=mosaic, demosaic=demosaic)


def every_way():
    """(mosaic, demosaicker) of all named mosaics.

    The network is not exact: tests/stages/test_network.py has its bounds.
    """
    for name, rows in MOSAICS.items():
        for method in [method for method in DEMOSAICS if method != "network"]:
            if bayer_phase(rows) or method in ("auto", "bilinear"):
                yield name, method
            elif method == "learned" and name in WITH_FILTERS:
                yield name, method
            elif method != "learned" and name in LIKE_BAYER:
                yield name, method


@pytest.mark.parametrize(("mosaic", "method"), list(every_way()))
def test_a_flat_field_has_its_level_in_every_channel(mosaic, method):
    """Each channel has a level of its own, and every pixel of its plane that level, whatever the method.

    Without noise. Roots are rounded to 2^-15 of white's root or finer, which is 2^-14 of the level of white and 2^-13
    of a quarter of it; sums of 93 weights of absolute sum 20 in float32 err by 93 x 20 x 2^-24 = 2^-13 at most.
    """
    camera = phone(mosaic, method)
    sensor = camera.sensor
    levels = np.linspace(0.25, 0.6, len(sensor.channels))
    span = sensor.white_level - sensor.dark_level
    raw = np.rint(sensor.dark_level + span * levels)[np.tile(sensor.cfa_indices, (20, 20))]
    raw = raw[:33, :38].astype(np.uint16)
    developer = Developer(camera, open_device("opencl"))
    planes = np.asarray(developer.device.numpy(developer.demosaic(raw, white=levels)))
    wanted = (np.rint(sensor.dark_level + span * levels) - sensor.dark_level) / span
    np.testing.assert_allclose(
        planes, np.broadcast_to(wanted[:, None, None], planes.shape), rtol=2.0**-12
    )


def errors_of(mosaic, methods):
    """Mean square errors of camera values, balanced, against stacked pixels of the same channels, without noise."""
    scene = chart("deadleaves", size=(72, 60), seed=100)  # not trained on
    found, values = {}, {}
    for method in ("stacked", *methods):
        is_stacked = method == "stacked"
        camera = phone(mosaic, "auto" if is_stacked else method, stacked=is_stacked)
        exposure = Simulator(camera, device="opencl").expose(scene, 1 / 30)
        planes = output_of(exposure.values(), "camera")
        values[method] = exposure.device.numpy(planes) / exposure.rendering.neutral[:, None, None]
        found[method] = np.mean((values[method] - values["stacked"])[:, 8:-8, 8:-8] ** 2)
    return found


@pytest.mark.parametrize(
    "mosaic",
    [  # optics of the larger periods are built for seconds
        pytest.param(name, marks=pytest.mark.slow if name in LARGER_PERIODS else ())
        for name in WITH_FILTERS
    ],
)
def test_built_in_filters_are_the_default_and_better(mosaic):
    """Dead leaves through the phone without noise: fewer errors than by weighted means."""
    errors = errors_of(mosaic, ("auto", "learned", "bilinear"))
    assert errors["auto"] == errors["learned"] < errors["bilinear"]


@pytest.mark.parametrize("mosaic", ["bayer-rggb", *LIKE_BAYER])
def test_better_methods_have_fewer_errors(mosaic):
    errors = errors_of(mosaic, ("best", "adaptive", "bilinear"))
    assert errors["best"] < errors["adaptive"] < errors["bilinear"]


@pytest.mark.parametrize(
    ("mosaic", "method"), [(mosaic, method) for mosaic, method in every_way() if method != "auto"]
)
def test_results_are_continuous_as_noise_goes_to_0(mosaic, method):
    """A pixel that holds 10^8 times the electrons has nearly the results of one without noise.

    Quantisation's noise is left, 0.04 of the noise at first, and moves filters and weights as little. A fifth leaves
    room for pixels that change their class.
    """
    quiet = phone(mosaic, method)
    sensor = quiet.sensor
    random = np.random.default_rng(7)
    raw = random.integers(sensor.dark_level, sensor.white_level // 2, (24, 28)).astype(np.uint16)
    white = np.linspace(0.5, 1.0, len(sensor.channels))

    def planes(camera):
        developer = Developer(camera, open_device("opencl"))
        return np.asarray(developer.device.numpy(developer.demosaic(raw, white=white)))

    still, moved = planes(quiet), []
    for factor in (1.0, 1e8):
        noise = replace(sensor.noise, photon="fast")
        full = replace(sensor, noise=noise, full_well=factor * sensor.full_well)
        moved.append(abs(planes(replace(quiet, sensor=full)) - still).mean())
    assert moved[1] <= moved[0] / 5


@pytest.mark.parametrize("end", [700.0, 780.0])
def test_near_infrared_pixels_know_white(end):
    """White is what a white surface gives in daylight as far as the scene goes: charts to 700 nm, pictures to 780 nm.

    Surfaces that train colours are measured as far as 700 nm.
    """
    camera = phone("rgbn")
    if end == 700:
        scene = chart("flat", size=(40, 32))
    else:
        scene = scene_from(np.full((32, 40, 3), 128, np.uint8))
    light, qe = illuminant("D65"), camera.sensor.qe
    at = np.arange(360.0, end + 1)
    photons = np.interp(at, light.wavelengths, light.values) * at
    wanted = np.array([np.sum(photons * np.interp(at, qe.wavelengths, row)) for row in qe.values])
    exposure = Simulator(camera, device="opencl").expose(scene, 1 / 30)
    found = exposure.rendering.neutral
    np.testing.assert_allclose(found, wanted / wanted.max(), rtol=0.02)  # the lens, linear tables
    shown = exposure.frame().linear.mean(axis=(0, 1))
    np.testing.assert_allclose(shown, shown[1], rtol=0.02)


@pytest.mark.parametrize("mosaic", ["rgbw", "rccb", "rccc"])
def test_denoising_follows_any_demosaicker(mosaic):
    """A flat field keeps its level, to 4 standard errors of 6,300 pixels and 0.1 %, and loses most of its noise."""
    found = []
    for strength in (0.0, 1.0):
        camera = open_camera("phone").with_(cfa=mosaic, denoise=strength)
        linear = Simulator(camera, device="opencl")(chart("flat", size=(90, 70)), seed=1).linear
        found.append((linear.mean(axis=(0, 1)), linear.std(axis=(0, 1))))
    (level, noise), (kept, left) = found
    assert (abs(kept - level) < 4 * noise / np.sqrt(6300) + 1e-3 * level).all()
    assert (left < 0.6 * noise).all()


def test_noise_after_demosaicking_comes_in_the_sensors_order():
    covariance = np.arange(5.0 * 16 * 9).reshape(5, 4, 4, 3, 3)
    noise = DemosaickedNoise(covariance, np.arange(3.0)).in_order(np.argsort((0, 2, 1)))
    assert noise.share.tolist() == [0, 2, 1]
    assert noise.covariance[1, 2, 3, 2, 0] == covariance[1, 2, 3, 1, 0]
    assert noise.covariance[1, 2, 3, 0, 1] == covariance[1, 2, 3, 0, 2]


def test_the_report_names_what_was_chosen():
    for mosaic, stage, words in (
        ("x-trans", "processor.guided", "x-trans"),
        ("nona-bayer", "processor.interpolate", "weighted means"),
        ("rgbn-4x4", "processor.guided", "rgbn-4x4"),
        ("ryyb", "processor.best", "R, Y, B in the places"),
    ):
        frame = Simulator(phone(mosaic), device="numpy")(chart("flat", size=(40, 32)))
        models = {stage.stage: stage.model for stage in frame.report.stages}
        assert words in models[stage]


def test_another_mosaic_takes_what_suits_it():
    camera = open_camera("phone")
    assert camera.with_(cfa="x-trans").demosaic_method == "learned"
    assert camera.with_(cfa="rgbw").demosaic_method == "learned"
    assert camera.with_(cfa="rccb").demosaic_method == "best"
    assert camera.with_(cfa=("BR", "RG")).demosaic_method == "best"
    assert camera.with_(cfa=("RG", "RB")).demosaic_method == "bilinear"
    assert camera.with_(cfa="bayer-grbg").demosaic_method == camera.processor.demosaic
    assert camera.with_(cfa="x-trans", demosaic="bilinear").demosaic_method == "bilinear"
    assert phone("bayer-rggb").demosaic_method == "bilinear"
    assert phone("x-trans", stacked=True).demosaic_method == "bilinear"
    with pytest.raises(OutOfRange, match="x-trans, quad-bayer") as refused:
        camera.with_(cfa="rccb", demosaic="learned")
    assert "\n" not in str(refused.value)
    with pytest.raises(OutOfRange, match='"auto", "bilinear", "learned"') as refused:
        camera.with_(cfa="rgbw", demosaic="best")
    assert "\n" not in str(refused.value)
    assert [bayer_roles(MOSAICS[name])[1] for name in LIKE_BAYER] == ["RWB", "RYB", "CYM"]
    assert bayer_roles(("BY", "YR")) == ("BGGR", "RYB")
    assert (
        bayer_roles(("RB", "YY")) is bayer_roles(("RGGB",)) is bayer_roles(MOSAICS["rgbw"]) is None
    )
