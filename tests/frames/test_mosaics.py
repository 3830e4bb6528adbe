"""Every mosaic and every demosaicker: equal level, flat fields, what is chosen by default and named."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim.backends.select import open_device
from gpusim.data.charts import chart
from gpusim.domain.errors import OutOfRange
from gpusim.domain.mosaics import MOSAICS, bayer_phase
from gpusim.domain.processor import DEMOSAICS
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.simulator import Simulator

WITH_FILTERS = ("x-trans", "quad-bayer")


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
    """(mosaic, demosaicker) of all named mosaics of R, G, B and W.

    The network is not exact: tests/stages/test_network.py has its bounds.
    """
    for name, rows in MOSAICS.items():
        if not {*"".join(rows)} <= {*"RGBW"} or name == "mono":
            continue
        for method in [method for method in DEMOSAICS if method != "network"]:
            if bayer_phase(rows) or method in ("auto", "bilinear"):
                yield name, method
            elif method == "learned" and name in WITH_FILTERS:
                yield name, method


@pytest.mark.parametrize(("mosaic", "method"), list(every_way()))
def test_a_flat_field_has_its_level_in_every_channel(mosaic, method):
    """Each channel has a level of its own, and every pixel of its plane that level, whatever the method.

    Without noise. Roots are rounded to 2^-15 of white's root or finer, which is 2^-14 of the level of white and 2^-13
    of a quarter of it; sums of 80 weights below 8 in float32 err by 80 x 8 x 2^-24 < 2^-14.
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


@pytest.mark.parametrize("mosaic", WITH_FILTERS)
def test_built_in_filters_are_the_default_and_better(mosaic):
    """Dead leaves through the phone without noise, against its stacked pixels: fewer errors than by weighted means."""
    scene = chart("deadleaves", size=(72, 60), seed=100)  # not trained on
    wanted = Simulator(phone("bayer-rggb", "bilinear", stacked=True), device="numpy")(scene).linear
    errors = {}
    for method in ("auto", "learned", "bilinear"):
        shown = Simulator(phone(mosaic, method), device="numpy")(scene).linear
        errors[method] = np.mean((shown - wanted)[8:-8, 8:-8] ** 2)
    assert errors["auto"] == errors["learned"] < errors["bilinear"]


def test_the_report_names_what_was_chosen():
    for mosaic, stage, words in (
        ("x-trans", "processor.guided", "x-trans"),
        ("nona-bayer", "processor.interpolate", "weighted means"),
    ):
        frame = Simulator(phone(mosaic), device="numpy")(chart("flat", size=(40, 32)))
        models = {stage.stage: stage.model for stage in frame.report.stages}
        assert words in models[stage]


def test_another_mosaic_takes_what_suits_it():
    camera = open_camera("phone")
    assert camera.with_(cfa="x-trans").demosaic_method == "learned"
    assert camera.with_(cfa="rgbw").demosaic_method == "bilinear"
    assert camera.with_(cfa="bayer-grbg").demosaic_method == camera.processor.demosaic
    assert camera.with_(cfa="x-trans", demosaic="bilinear").demosaic_method == "bilinear"
    assert phone("bayer-rggb").demosaic_method == "bilinear"
    assert phone("x-trans", stacked=True).demosaic_method == "bilinear"
    with pytest.raises(OutOfRange, match="x-trans and quad-bayer") as refused:
        camera.with_(cfa="rgbw", demosaic="learned")
    assert "\n" not in str(refused.value)
