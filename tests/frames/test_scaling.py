"""What is display white: the metered exposure, or a white surface whatever the exposure."""

from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS
from scipy.interpolate import CubicSpline

from gpusim import measure
from gpusim.data.charts import chart, colorchecker_patches
from gpusim.domain.errors import UnknownName
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.noise import Noise
from gpusim.domain.processor import Processor
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator

DEMOSAICS = ("bilinear", "malvar", "adaptive", "best", "learned", "network")
EVEN = {"model": "none", "relative_illumination": "none"}


def camera(name="phone", noise=None, optics=None, sensor=None, **processor):
    """A built-in camera with changes; noise {}: its own, None: none."""
    made = open_camera(name)
    noise = Noise(photon="none") if noise is None else replace(made.sensor.noise, **noise)
    return replace(
        made,
        optics=replace(made.optics, **(optics or {})),
        processor=replace(made.processor, **processor),
        sensor=replace(made.sensor, noise=noise, **(sensor or {})),
    )


def taken(simulate, scene, time, seed=1):
    """A frame of this exposure time [s]."""
    return simulate.expose(scene, time).frame(seed=seed)


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("name", ["phone", "mono"])
def test_longer_is_brighter_until_all_is_white(name, device):
    """Mean codes of the ColorChecker from dark to clipped; the blackest part reflects 3 %."""
    scene = chart("colorchecker", size=(60, 40))
    simulate = Simulator(camera(name, noise={}), device=device)
    time = simulate.expose(scene).exposure_time
    codes = [
        taken(simulate, scene, 4.0**stops * time).rgb.astype(float).mean(axis=(0, 1))
        for stops in range(-3, 5)
    ]
    assert (np.diff(codes, axis=0)[:-2] > 10).all() and (np.diff(codes, axis=0) >= 0).all()
    assert codes[0].max() < 40 and codes[3].max() < 140 and (codes[-1] == 255).all()


def test_linear_values_are_proportional_to_time_and_gain():
    """In 16 bits: half a number of 64511 in both, through the rows of the matrix, and float32's roundings."""
    scene = chart("colorchecker", size=(60, 40))
    simulate = Simulator(
        camera(sensor={"bits": 16, "black_level": 1024}, demosaic="bilinear"), device="opencl"
    )
    whole = simulate.expose(scene)
    wanted = whole.frame().linear
    step = np.abs(whole.rendering.display_from_camera).sum(axis=1).max() / 64511
    for time, gain in ((0.25, 1.0), (0.25, 4.0), (0.5, 1.5)):
        found = simulate.expose(scene, time * whole.exposure_time, gain).frame().linear
        np.testing.assert_allclose(found, time * gain * wanted, atol=step + 1e-6)


@pytest.mark.parametrize(
    ("changes", "times"),
    [
        *(({"light": name}, 4) for name in ("A", "D65", "FL11")),
        *(({"demosaic": name}, 4) for name in DEMOSAICS),
        ({"white_balance": "gray-world"}, 4),
        ({"white_balance": "none", "light": "D65"}, 4),
        ({"color": "none"}, 4),
        ({"sensor": {"stacked": True}}, 4),
        ({"sensor": {"binning": (2, 2)}}, 4),
        ({"sensor": {"analog_gain": 0.5}}, 4),
        ({"sensor": {"analog_gain": 8.0}}, 4),
        ({"name": "mono"}, 4),
        ({"shading": True}, 4),
        ({"sensor": {"auto_exposure": AutoExposure("mean", 0.18)}}, 24),
    ],
    ids=str,
)
def test_overexposed_grey_is_white_and_not_coloured(changes, times):
    """All codes are 255, with the noise of the camera, where its brightest channel is beyond saturation."""
    changes = dict(changes)
    scene = chart("flat", size=(48, 32), light=changes.pop("light", "A"))
    simulate = Simulator(
        camera(noise={}, optics=EVEN, **{"name": "phone"} | changes), device="opencl"
    )
    frame = taken(simulate, scene, times * simulate.expose(scene).exposure_time)
    np.testing.assert_array_equal(frame.rgb, 255)


@pytest.mark.parametrize("part", [0.02, 0.3, 0.9])
@pytest.mark.parametrize("light", ["A", "D65"])
def test_grey_is_neutral_at_every_exposure(part, light):
    """Half a digital number of 959 in each channel, through the rows of the matrix."""
    scene = chart("flat", size=(24, 16), light=light)
    simulate = Simulator(camera(optics=EVEN), device="opencl")
    frame = taken(simulate, scene, part * simulate.expose(scene).exposure_time)
    half = 0.5 / 959 * np.abs(frame.rendering.display_from_camera).sum(axis=1).max()
    np.testing.assert_allclose(frame.linear, part, atol=1.01 * half)
    assert half < 0.005  # so that a cast would be seen


@pytest.mark.parametrize(
    ("name", "metering", "reflectance", "white", "shown"),
    [
        ("phone", AutoExposure(), 1.0, 0.95, 1.0),
        ("phone", AutoExposure(level=0.5), 0.3, 0.5, 1.0),
        ("phone", AutoExposure("percentile", 0.8), 1.0, 0.8, 1.0),
        # an average is taken for middle grey: 18 % of display white, or of saturation where that is less
        ("mono", AutoExposure("mean", 0.09), 0.7, 0.5, 0.18),
        ("mono", AutoExposure("centre", 0.18), 0.18, 1.0, 0.18),
        ("mono", AutoExposure("centre", 0.36), 0.18, 1.0, 0.36),
    ],
)
def test_what_is_metered_has_its_place(name, metering, reflectance, white, shown):
    """An evenly lit card without noise: half a digital number, through the rows of the matrix."""
    made = camera(name, optics=EVEN, sensor={"auto_exposure": metering})
    frame = Simulator(made, device="opencl")(chart("flat", size=(24, 16), reflectance=reflectance))
    half = (
        0.5
        / (made.sensor.white_level - 64)
        * np.abs(frame.rendering.display_from_camera).sum(axis=1).max()
    )
    np.testing.assert_allclose(frame.linear, shown, atol=1.01 * half)
    assert frame.rendering.white == pytest.approx(white, rel=1e-12)


def test_a_metered_white_patch_is_white():
    """The white of a ColorChecker with the camera's own noise and lens.

    It has 5700 e- at its brightest and a noise of 1.6 % in each pixel's channel, three times that through the matrix:
    0.5 % of 100 independent values or more. cos^4 takes 1 % at most from the middle to a corner of this frame.
    """
    size = (192, 128)
    frame = Simulator(camera(noise={}), device="opencl")(chart("colorchecker", size=size))
    rows, cols = colorchecker_patches(size)[18]
    middle = frame.linear[rows.start + 6 : rows.stop - 6, cols.start + 6 : cols.stop - 6]
    np.testing.assert_allclose(middle.mean(axis=(0, 1)), 1, atol=0.02)
    assert frame.rgb[rows, cols][6:-6, 6:-6].mean() > 250


@pytest.mark.parametrize("metering", [AutoExposure(), AutoExposure("centre", 0.1)])
@pytest.mark.parametrize("part", [1 / 16, 1 / 4, 1.0, 4.0])
def test_normalised_is_raw_over_the_raw_value_of_white(part, metering):
    """A monochrome picture, from its digital numbers and the integral of light and efficiency: as ever.

    The integral over 0.01 nm and the planner's over 0.1 nm differ by 1e-5 of it; float32 rounds by less.
    """
    made = camera(
        "mono", noise={}, optics=EVEN, sensor={"auto_exposure": metering}, scaling="normalised"
    )
    scene = chart("colorchecker", size=(48, 32))
    simulate, sensor = Simulator(made, device="opencl"), made.sensor
    time = (
        part
        * Simulator(camera("mono", noise={}, optics=EVEN), device="opencl")
        .expose(scene)
        .exposure_time
    )
    frame = taken(simulate, scene, time)
    nm = np.arange(scene.wavelengths[0], scene.wavelengths[-1] + 0.005, 0.01)
    electrons = np.trapezoid(sensor.qe.at(nm)[0] * scene.illuminant.at(nm), nm) * time
    electrons *= made.optics.irradiance_factor * sensor.pixel_pitch**2 * sensor.fill_factor
    gain = (sensor.white_level - sensor.black_level) / sensor.full_well
    wanted = (frame.raw.astype(float) - sensor.black_level) / (gain * electrons)
    np.testing.assert_allclose(frame.linear, np.stack([wanted] * 3, axis=-1), rtol=2e-5, atol=1e-7)
    # sRGB, IEC 61966-2-1, by its formula; a value at the edge of a code may round either way
    light = np.clip(wanted, 0, 1)
    codes = 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert np.abs(frame.rgb - codes[..., None]).max() <= 0.5 + 0.02


def test_normalised_colours_are_reflectances_at_every_exposure():
    """Every patch's digital numbers over those of white, by integrals, make its colour: without exposure in it."""
    size = (192, 128)
    made = camera(
        optics=EVEN, color="none", demosaic="bilinear", scaling="normalised", sensor={"bits": 16}
    )
    scene = chart("colorchecker", size=size)
    simulate = Simulator(made, device="opencl")
    time = simulate.expose(scene).exposure_time
    nm = np.arange(400, 700.001, 0.01)
    light = made.sensor.qe.at(nm) * scene.illuminant.at(nm)
    white = np.trapezoid(light, nm)
    for part in (0.25, 0.5, 1.0):
        frame = taken(simulate, scene, part * time)
        for rows, cols in colorchecker_patches(size):
            cut = np.s_[rows.start + 6 : rows.stop - 6, cols.start + 6 : cols.stop - 6]
            spectrum = scene.content.spectra[scene.content.ids[cut][0, 0]]
            seen = np.trapezoid(light * CubicSpline(scene.wavelengths, spectrum)(nm), nm) / white
            # blue has a third of green's part of the 16-bit range: half a number of 65471 x part / 3, and 1e-4
            np.testing.assert_allclose(
                frame.linear[cut],
                np.broadcast_to(seen, frame.linear[cut].shape),
                atol=3 * 0.5 / 65471 / part + 1e-4,
            )


def test_raw_values_know_no_scaling():
    scene = chart("colorchecker", size=(60, 40))
    frames = [
        Simulator(camera(noise={}, scaling=scaling), device="opencl")(scene, seed=3)
        for scaling in ("exposure", "normalised")
    ]
    np.testing.assert_array_equal(frames[0].raw, frames[1].raw)
    assert (frames[0].rgb != frames[1].rgb).mean() > 0.5


def test_measures_of_a_frame_divide_the_exposure_out():
    """A ColorChecker against its ideal picture: the same from either scaling, and at half the time but for rounding."""
    scene = chart("colorchecker", size=(96, 64))
    one, other = (
        Simulator(
            camera(scaling=scaling, demosaic="bilinear", sensor={"bits": 16}), device="opencl"
        )
        for scaling in ("exposure", "normalised")
    )
    frame = one(scene)
    found = measure.ciede2000(frame, scene)
    # the slope of a* is 500 / 3 x^(-2/3), 1700 at the darkest patch, and CIEDE2000 counts it 1.5 times: 2600. float32
    # of the same numbers by another factor errs by 1e-7
    np.testing.assert_allclose(found, measure.ciede2000(other(scene), scene), atol=2600 * 3e-7)
    dark = taken(one, scene, frame.exposure_time / 2)
    assert dark.rendering.diffuser == pytest.approx(frame.rendering.diffuser / 2, rel=1e-12)
    # half a number of 65471 is 7.6e-6 of one and twice that of the other, through rows of 3
    np.testing.assert_allclose(found, measure.ciede2000(dark, scene), atol=2600 * 3 * 3 * 7.6e-6)
    assert measure.visible_snr(dark, 30.0) == pytest.approx(
        measure.visible_snr(frame, 30.0), rel=1e-3
    )


def test_other_names_are_refused():
    with pytest.raises(
        UnknownName, match=r"processor\.scaling 'automatic'; known: exposure, normalised"
    ):
        Processor(scaling="automatic")
