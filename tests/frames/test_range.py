"""Any light there is, from none to the sun, through every lens: a frame that is right, or a reason in one line."""

import time
import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from devices import ALL_KINDS
from lights import (
    BORDERS,
    FORMS,
    LENSES,
    LIGHTS,
    ONE,
    PHONE,
    VARYING,
    camera_with_lens,
    leaves,
    radiance,
    scene_of,
)

import gpusim as gs
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.errors import GpusimError
from gpusim.domain.scene import Scene, unit_light
from gpusim.judge.truth import mean_and_truth
from gpusim.optics.tables import call_always
from gpusim.pipeline.cache import Cache
from gpusim.planner.plan import plan

CPU = "opencl:pocl"
TOLERANCES = (None, "preview", "video", "3e-5", Tolerance(rms=1e-3))
SECONDS = (
    20  # of processor time of a plan, at most; lenses that vary take up to 10 of it for any light
)


def planned(
    lens, light, form="cube", border="edge", tolerance="video", wavelengths=None, cache=call_always
):
    """Seconds of a plan, in which every warning is an error; a reason takes the place of the plan."""
    more = {} if wavelengths is None else {"wavelengths": wavelengths}
    scene, camera, start = (
        scene_of(radiance(light), form, border, **more),
        camera_with_lens(lens),
        time.process_time(),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            plan(
                scene,
                camera,
                tolerance=None if tolerance is None else Tolerance.parse(tolerance),
                cache=cache,
            )
        except GpusimError as error:
            assert "\n" not in str(error) and len(str(error)) < 300
    return time.process_time() - start


@pytest.mark.parametrize("lens", [lens for lens in LENSES if lens not in VARYING])
def test_plans_of_any_light(lens):
    """Each light by another border, form and tolerance."""
    cache = Cache()
    for number, light in enumerate(LIGHTS):
        asked = FORMS[number % 5], BORDERS[number % 4], TOLERANCES[1 + number % 4]
        assert planned(lens, light, *asked, cache=cache) < SECONDS
    assert planned(lens, "plain", wavelengths=ONE) < SECONDS


@pytest.mark.parametrize("light", ["star", pytest.param("sun", marks=pytest.mark.slow)])
def test_plans_of_any_light_by_lenses_that_vary(light):
    assert planned("measured over heights", light) < SECONDS
    assert planned("lateral colour", light, tolerance="preview") < SECONDS


@pytest.mark.slow
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("light", LIGHTS)
def test_plans_of_all_there_is(lens, light):
    forms, borders, tolerances = (
        (FORMS, BORDERS, TOLERANCES)
        if lens not in VARYING
        else (FORMS[:1], BORDERS[:2], TOLERANCES[::2])
    )
    for form, border, tolerance in product(forms, borders, tolerances):
        assert planned(lens, light, form, border, tolerance) < SECONDS, (form, border, tolerance)
    assert planned(lens, light, wavelengths=ONE) < SECONDS


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    "lens, light",
    [
        ("ideal", "filament"),
        ("ideal", "point of 1e12:1"),
        ("none", "sun"),
        ("defocused", "plain"),
        ("defocused", "sun"),
    ],
)
def test_brighter_light_for_a_shorter_time(lens, light, device):
    """Light times 1e6 at the exposure time over 1e6 is the same frame; that of a power of two to the last bit.

    Samples round to float32, 6e-8 of each, and transforms err by 2.5e-7 of the root mean square of the light before the
    blur: of a point 39 times the mean, of which the blur leaves a tenth of the root mean square.
    """
    values, seconds = radiance(light), 1e-1 * 1e15 / radiance(light).max()
    frames = []
    for factor in (1.0, 2.0**20, 1e6):
        camera = camera_with_lens(lens, exposure_time=seconds / factor)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            exposure = gs.Simulator(camera, device=device, tolerance="video").expose(
                scene_of(factor * values)
            )
        frames.append(np.array(exposure.mean, np.float64))
    size = np.sqrt(np.mean(frames[0] ** 2))
    assert np.isfinite(frames).all() and size > 1
    np.testing.assert_array_equal(frames[1], frames[0])
    np.testing.assert_allclose(frames[2], frames[0], rtol=1e-6, atol=5e-6 * size)


def verdict_and_truth(camera, scene, tolerance):
    """The verdict of a frame, and whether its float64 truth is within the tolerance."""
    simulator = gs.Simulator(camera, device="numpy", tolerance=tolerance)
    exposure = simulator.expose(scene)
    mean, true = mean_and_truth(simulator, scene, exposure)
    return exposure.plan, np.sqrt(np.mean((mean - true) ** 2) / np.mean(true**2))


@pytest.mark.parametrize("cfa", ["bayer", "nona-bayer"])
@pytest.mark.parametrize("side", [5, 8])
def test_tiny_frames_keep_their_word(side, cfa):
    """Most of a window lies outside such a frame, and its few pixels have few of a mosaic's channels."""
    camera = PHONE.with_(cfa=cfa, demosaic="bilinear") if cfa != "bayer" else PHONE
    for seed in (1, 2, 3):
        scene = scene_of(1e15 * leaves((60, 60), seed)[:side, :side])
        made, true = verdict_and_truth(camera, scene, 3e-4)
        assert made.verdict.state != "met" or true <= 3e-4
        assert true < 1.5 * made.account.total.rms  # SAFETY


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_strips_keep_their_word(seed):
    """10 samples by 499, at wavelength x f-number of 3.5 samples."""
    camera = replace(PHONE, optics=replace(PHONE.optics, f_number=4 * PHONE.optics.f_number))
    made, true = verdict_and_truth(camera, scene_of(1e15 * leaves((10, 499), seed)), 3e-4)
    assert made.verdict.state != "met" or true <= 3e-4
    assert true < 1.5 * made.account.total.rms


def test_a_hot_line_keeps_its_word():
    """9e7:1; 64 of its 101 pixels are split off, and two of the others stand alone, both in the worst channel."""
    values = np.full((101, 101), 1e14)
    values[50] = 9e21
    made, true = verdict_and_truth(camera_with_lens("ideal"), scene_of(values), 3e-5)
    assert made.verdict.state != "met" or true <= 3e-5
    assert true < 1.5 * made.account.total.rms


@pytest.mark.slow
def test_hot_points_keep_their_word():
    """Of a lens whose highlights are not split off: their rings end at the sides of tiles."""
    values, random = 1e14 * leaves((120, 150), 3), np.random.default_rng(3)
    for _ in range(3):
        values[random.integers(5, 115), random.integers(5, 145)] = 10 ** random.uniform(18, 22)
    made, true = verdict_and_truth(camera_with_lens("obscured"), scene_of(values), 3e-5)
    assert made.verdict.state != "met" or true <= 3e-5


def test_blurs_wider_than_windows_are_not_judged():
    made = plan(
        scene_of(radiance("plain")), camera_with_lens("f/1000"), tolerance=Tolerance(rms=0.5)
    )
    assert made.verdict.state == "not judged" and "too wide a blur" in str(made.verdict)


def test_the_electrons_of_a_laser():
    """Camera equation: pi / (1 + 4 N^2) L of a scene far away, the pixel's area, its efficiency, its time, 1 nm."""
    light, seconds = 3e17, 1e-3
    camera = camera_with_lens("none", exposure_time=seconds)
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    scene = Scene(Cube(ONE, np.full((1, 8, 8), light, np.float32)), unit_light(ONE))
    mean = np.array(gs.Simulator(camera, device="numpy").expose(scene).mean)
    optics, sensor = camera.optics, camera.sensor
    irradiance = np.pi * light / (1 + 4 * optics.f_number**2) * optics.transmission
    # the efficiency is linear between its nodes: its mean over 1 nm is that in the middle, but beside a node
    efficiency = [
        np.interp([531.5, 532, 532.5], sensor.qe.wavelengths, row).mean()
        for row in sensor.qe.values
    ]
    wanted = irradiance * np.prod(sensor.aperture) * seconds * np.array(efficiency)
    cfa = sensor.cfa_indices
    np.testing.assert_allclose(mean[:2, :2], wanted[cfa], rtol=1e-3)


@pytest.mark.parametrize("lens", ["ideal", "measured", "coma"])
def test_frames_of_one_wavelength(lens):
    """A plain frame through all stages; by one wavelength nothing is left to fuse."""
    frame = gs.Simulator(camera_with_lens(lens), device=CPU, tolerance="preview")(
        scene_of(radiance("plain"), wavelengths=ONE)
    )
    assert np.isfinite(frame.linear).all() and frame.raw.max() > frame.raw.min()
    assert "only wavelength, 532 nm" in str(frame.report)


def test_files_of_one_wavelength(tmp_path):
    scene = scene_of(radiance("plain"), wavelengths=ONE)
    gs.save_scene(scene, tmp_path / "laser.npz")
    again = gs.open_scene(tmp_path / "laser.npz")
    np.testing.assert_array_equal(again.content.values, scene.content.values)
    assert again.wavelengths == ONE and not again.light_is_known
    np.save(tmp_path / "laser.npy", scene.content.values)
    assert (
        gs.open_scene(tmp_path / "laser.npy", wavelengths=[532.0], kind="radiance").wavelengths
        == ONE
    )
