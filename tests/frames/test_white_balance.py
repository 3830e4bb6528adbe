"""Colours are compared after red and blue are brought to green's part of white: what changes, stays, and clips."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.data.charts import chart
from gpusim.domain.errors import OutOfRange
from gpusim.io.camera.cameras import open_camera
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.bayer import RED
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.learned import learned
from gpusim.kernels.processor.malvar import malvar
from gpusim.pipeline.balanced import balance_of
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.simulator import Simulator

METHODS = {"malvar": malvar, "adaptive": adaptive, "best": best, "learned": learned}
LIGHTS = (
    "D65",
    "A",
    *(pytest.param(light, marks=pytest.mark.slow) for light in ("FL11", "daylight-10000K")),
)
OPTIONS = {"black_level": 0.0, "scale": 1 / 4096}


def noise_free(demosaic, **sensor):
    """The phone without noise, fall-off and rounding to speak of (16 bits)."""
    camera = open_camera("phone")
    noise = replace(
        camera.sensor.noise, photon="none", read=0.0, prnu=0.0, dsnu=0.0, dark_current=0.0
    )
    return replace(
        camera,
        sensor=replace(camera.sensor, noise=noise, vignetting=None, bits=16, **sensor),
        optics=replace(camera.optics, relative_illumination="none"),
        processor=replace(camera.processor, demosaic=demosaic),
    )


def grey_structure(rows, cols):
    """Edges, ramps and noise, multiples of 16 below 4096."""
    y, x = np.mgrid[:rows, :cols]
    smooth = (
        900
        + 700 * ((x + y) // 7 % 2)
        + 9 * x
        + np.random.default_rng(2).integers(0, 60, (rows, cols))
    )
    return (smooth // 16 * 16).astype(np.uint16)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_fainter_channel_makes_no_difference(method, device):
    """Red and blue at a quarter and a sixteenth, and balanced by 4 and 16: the same picture, fainter.

    All factors and their roots are powers of two, so nothing else is rounded. Codes of `learned` are whole multiples
    of 2^-12 and a quarter of that: they move by 2^-11 at most, through weights of absolute sum 4 and the slope of the
    square, 2 x 64; pixels at the bounds of classes, one in a hundred at most, may take another filter.
    """
    raw = grey_structure(44, 50)
    for phase, (row, col) in RED.items():
        faint = raw.copy()
        faint[row::2, col::2] //= 4
        faint[1 - row :: 2, 1 - col :: 2] //= 16
        plain = METHODS[method](raw, phase=phase, **OPTIONS, device=device)
        balanced = METHODS[method](
            faint, phase=phase, **OPTIONS, balance=(4.0, 16.0), device=device
        )
        difference = np.abs(balanced * np.array([4, 1, 16])[:, None, None] - plain)
        if method == "learned":
            assert np.quantile(difference, 0.99) <= 2.0**-11 * 4 * 2 * 64 / 4096
        else:
            assert difference.max() <= (1e-12 if device == "numpy" else 0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("light", ["D65", "A"])
def test_balanced_channels_come_nearer_to_a_sensor_without_mosaic(method, light):
    """Against the same camera with stacked pixels: the error of mosaicking alone.

    Detail that is the same in all channels is the same in balanced ones only. Dead leaves have colours at random, and
    so the least of that: photographs gain .4 to 2 dB in D65, 2.5 to 6.5 dB in A.
    """
    scene = chart("deadleaves", size=(160, 120), light=light)
    truth = Simulator(noise_free("bilinear", stacked=True), device="opencl")
    wanted = np.moveaxis(truth(scene).linear, -1, 0)
    simulator = Simulator(noise_free(method), device="opencl")
    exposure = simulator.expose(scene)
    developer, raw = Developer(exposure.camera, simulator.device), exposure.raw()
    errors = []
    for white in (None, exposure.rendering.neutral):
        planes = developer.demosaic(raw, white=white, blur=exposure.blur)
        shown = simulator.device.numpy(developer.apply_color(planes, exposure.rendering))
        errors.append(np.mean((np.clip(shown, 0, 1) - np.clip(wanted, 0, 1))[:, 8:-8, 8:-8] ** 2))
    assert 10 * np.log10(errors[0] / errors[1]) > {"D65": 0.1, "A": 1.0}[light] * (
        0.8 if method == "best" else 1
    )


def test_bilinear_and_other_mosaics_take_no_notice():
    scene = chart("colorchecker", size=(60, 40), light="A")
    for camera in (noise_free("bilinear"), noise_free("bilinear", cfa=("RGB", "GBR", "BRG"))):
        simulator = Simulator(camera, device="numpy")
        exposure = simulator.expose(scene)
        raw = exposure.raw()
        planes = [
            np.array(
                simulator.device.numpy(
                    Developer(exposure.camera, simulator.device).demosaic(raw, white=white)
                )
            )
            for white in (None, exposure.rendering.neutral)
        ]
        np.testing.assert_array_equal(*planes)


@pytest.mark.parametrize("method", ["bilinear", *METHODS])
@pytest.mark.parametrize("light", LIGHTS)
def test_white_that_is_clipped_stays_white(method, light):
    """A grey ramp, 2 and 16 times over-exposed: wherever white saturates all around, its codes are white's.

    Saturated is what has, 8 pixels around (as far as any method looks for values, edges weigh further), a stronger
    channel that is full; the ceiling of `processor.color` then leaves white, if no channel falls below it: overshoot is
    what is tested. All codes are one number then, that of saturation, but for rounding.
    """
    scene = chart("ramp", size=(160, 24), light=light)
    simulator = Simulator(noise_free(method), device="opencl")
    time = simulator.expose(scene).exposure_time
    for over in (2, 16):
        exposure = simulator.expose(scene, over * time)
        raw = exposure.raw()
        full = simulator.device.numpy(exposure.mean) >= exposure.camera.sensor.saturation
        codes = simulator.device.numpy(exposure.develop(raw)[1])
        columns = np.flatnonzero(full.any(axis=0))
        assert len(columns) > 20
        inside = codes[:, columns.min() + 8 : columns.max() - 7].astype(int)
        assert inside.size and np.ptp(inside) <= 1


@pytest.mark.parametrize("method", METHODS)
def test_balances_that_are_none_are_refused(method):
    raw = grey_structure(8, 8)
    for balance in ((0.0, 1.0), (1.0, np.nan), (1.0,), (65.0, 1.0), None):
        with pytest.raises(OutOfRange, match="balance"):
            METHODS[method](raw, phase="RGGB", **OPTIONS, balance=balance, device="opencl")
    with pytest.raises(OutOfRange, match="encoded"):
        learned(raw, phase="RGGB", **OPTIONS, balance=(2.0, 1.0), domain="linear", device="opencl")


def test_a_channel_that_is_blind_to_the_light_is_not_amplified_without_limit():
    """A green line: red and blue have next to nothing of it."""
    places = (0, 1, 2)
    assert balance_of(np.array([0.0, 1.0, 1e-9]), places) == (64.0, 64.0)
    assert balance_of(np.array([0.5, 1.0, 0.25]), places) == (2.0, 4.0)
    assert balance_of(np.array([1.0, 0.0, 0.3]), places) == (1.0, 1.0)
