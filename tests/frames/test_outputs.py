"""Outputs by name: each is what the light's own formulas give, and what the others are made of."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import camera_with
from devices import ALL_KINDS

import gpusim as gs
from gpusim.domain.errors import BadData, UnknownName
from gpusim.pipeline.loop import OUTPUTS

SIZE = (72, 56)
CAMERA = gs.open_camera("phone")
SECONDS = 0.01


def given(simulator, scene, name):
    loop = simulator.loop(scene, SECONDS)
    return np.array(simulator.device.numpy(loop.output(name, seed=1, first=2)), np.float64)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("distance", [np.inf, 0.05])
def test_irradiance_of_a_flat_scene_is_that_of_the_camera_equation(device, distance):
    """E = pi T L / (1 + 4 N^2 (1 + |m|)^2), cos^4 of the field: by hand, without any of gpusim's own factors."""
    camera = camera_with(optics={"transmission": 0.8, "object_distance": distance})
    scene, optics = gs.chart("flat", size=SIZE), camera.optics
    found = given(gs.Simulator(camera, device=device), scene, "irradiance")
    nodes = scene.wavelengths
    assert found.shape == (len(nodes), SIZE[1], SIZE[0])
    radiance = scene.content.bands_at(slice(None))[:, 0, 0] * np.interp(
        nodes, scene.illuminant.wavelengths, scene.illuminant.values
    )  # D65 is tabled at these nodes
    magnification = (
        0.0 if np.isinf(distance) else optics.focal_length / (distance - optics.focal_length)
    )
    wanted = np.pi * 0.8 * radiance / (1 + 4 * (optics.f_number * (1 + magnification)) ** 2)
    y, x = (np.arange(n) - (n - 1) / 2 for n in found.shape[1:])
    slope = camera.sensor.pixel_pitch / (optics.focal_length * (1 + magnification))
    wanted = wanted[:, None, None] / (1 + slope**2 * (y[:, None] ** 2 + x**2)) ** 2
    # two transforms of 1.2e-6 of the peak each (see optics.blur), which a flat scene has everywhere
    np.testing.assert_allclose(found, wanted, rtol=2.4e-6)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    "optics", [{}, {"model": "none"}, {"distortion": None}], ids=["airy", "none", "plain"]
)
def test_electrons_are_what_the_sensor_makes_of_the_irradiance(device, optics):
    """sum over wavelength of QE E, by the quadrature of the plan's weights, times aperture and time."""
    camera = camera_with(optics=optics)
    scene = gs.chart("deadleaves", size=SIZE)
    simulator = gs.Simulator(camera, device=device)
    irradiance, electrons = (given(simulator, scene, name) for name in ("irradiance", "electrons"))
    plan = simulator.plan(scene)
    light = scene.illuminant.at(scene.wavelengths) * camera.optics.irradiance_factor
    light = light * camera.optics.transmission_at(scene.wavelengths)
    wanted = SECONDS * np.tensordot(plan.weights / light, irradiance, 1)
    # both have two transforms each, 2.4e-6 of the peak
    np.testing.assert_allclose(electrons, wanted, atol=5e-6 * wanted.max(), rtol=0)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("tolerance", [None, 1e-3])
@pytest.mark.parametrize(
    "scene",
    [gs.chart("deadleaves", size=SIZE), gs.chart("points", size=SIZE)],
    ids=["leaves", "highlights"],
)
def test_the_mosaic_takes_each_pixels_own_channel(device, tolerance, scene):
    simulator = gs.Simulator(CAMERA, device=device, tolerance=tolerance)
    electrons, mean = (given(simulator, scene, name) for name in ("electrons", "mean"))
    cfa = CAMERA.sensor.cfa_indices
    own = np.take_along_axis(electrons, np.tile(cfa, (SIZE[1] // 2, SIZE[0] // 2))[None], axis=0)[0]
    np.testing.assert_allclose(
        mean, own, atol=5e-6 * min(mean.max(), 1e3 * np.median(mean)), rtol=1e-5
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_from_raw_on(device):
    simulator, scene = gs.Simulator(CAMERA, device=device), gs.chart("colorchecker", size=SIZE)
    loop = simulator.loop(scene, SECONDS)
    frame = loop.frame(seed=1, first=2)
    planes = np.moveaxis(frame.linear, -1, 0)
    for name, wanted in (
        ("raw", frame.raw),
        ("linear", planes),
        ("codes", frame.rgb),
        ("mean", frame.mean),
    ):
        found = given(simulator, scene, name).reshape(wanted.shape)
        np.testing.assert_allclose(
            found, wanted, rtol=1e-6 if device == "numpy" else 0
        )  # frames are float32
    display = CAMERA.display
    xyz = np.moveaxis(frame.linear.astype(float) @ display.xyz_from_rgb.T, -1, 0)
    np.testing.assert_allclose(given(simulator, scene, "xyz"), xyz, atol=1e-6 * np.abs(xyz).max())
    camera = given(simulator, scene, "camera")
    shown = np.tensordot(
        frame.rendering.display_from_camera,
        np.minimum(camera, frame.rendering.ceiling[:, None, None]),
        1,
    )
    np.testing.assert_allclose(planes, shown, atol=1e-5 * np.abs(shown).max())


def test_an_output_runs_what_it_needs_and_no_more():
    loop = gs.Simulator(CAMERA, device="opencl").loop(gs.chart("deadleaves", size=SIZE), SECONDS)
    loop.output("electrons")
    loop.output("raw")
    with loop.simulator.device.timed() as ms:
        loop.output("electrons")
    assert not ms
    with loop.simulator.device.timed() as ms:
        loop.output("raw", first=1)
    assert set(ms) == {"sensor.noise"}


def test_a_stream_gives_any_of_them():
    simulator = gs.Simulator(CAMERA, device="opencl", tolerance=1e-3)
    scene = gs.chart("deadleaves", size=SIZE)
    brighter = replace(
        scene, content=replace(scene.content, shading=scene.content.shading * np.float32(1.5))
    )
    for name in OUTPUTS:
        found = [
            np.array(simulator.device.numpy(array))
            for array in simulator.stream(
                [scene, brighter, scene, brighter, scene], name, exposure_time=SECONDS
            )
        ]
        for array in found[2:]:
            assert array.shape == found[0].shape
        if name in ("irradiance", "electrons", "mean"):
            np.testing.assert_array_equal(found[0], found[4])
            np.testing.assert_allclose(
                found[3], 1.5 * found[2], rtol=1e-4, atol=1e-5 * found[3].max()
            )


def test_refuses():
    loop = gs.Simulator(CAMERA, device="numpy").loop(gs.chart("deadleaves", size=SIZE), SECONDS)
    with pytest.raises(UnknownName, match="output"):
        loop.output("film")
    varying = camera_with(optics={"lateral_color": 1e-3})
    assert varying.optics.varies
    with pytest.raises(BadData, match="varies over the field"):
        gs.Simulator(varying, device="numpy").loop(
            gs.chart("deadleaves", size=SIZE), SECONDS
        ).output("irradiance")
