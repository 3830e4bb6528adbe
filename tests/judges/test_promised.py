"""Errors that a plan promises, on tiny frames, magnified views and calibrated lenses, against truths from outside."""

from dataclasses import replace

import numpy as np
import pytest
import test_truth_stars as stars

import gpusim as gs
from gpusim.domain.account import SAFETY
from gpusim.domain.content import Cube
from gpusim.domain.optics import Optics
from gpusim.domain.scene import Scene, View
from gpusim.domain.spectrum import Spectrum
from gpusim.judge.truth import true_mean


def error_and_promise(simulator, scene, truth=None):
    """Relative RMS error of the mean electrons, and the one that the plan predicts, times its safety."""
    exposure = simulator.expose(scene, 1.0)
    mean = np.array(exposure.mean, np.float64)
    truth = (
        true_mean(gs.Simulator, simulator.camera, scene, exposure.plan, 1.0)
        if truth is None
        else truth(exposure)
    )
    return (
        np.sqrt(np.mean((mean - truth) ** 2) / np.mean(truth**2)),
        SAFETY * exposure.plan.account.at(1.0).total.rms,
    )


@pytest.mark.parametrize("waves", [0.86, 2.0])
@pytest.mark.parametrize("side", [9, 17])
def test_a_star_in_a_tiny_frame_out_of_focus(waves, side):
    """What transforms repeat of it is relative to the light that the frame keeps of it, by the pupil's integral."""
    camera, scene, _, _ = stars.star("defocused", "axis", 51)
    camera = replace(
        camera, optics=replace(camera.optics, defocus=waves * 550e-9 * 8 * stars.F_NUMBER**2)
    )
    values = np.zeros((3, side, side), np.float32)
    values[1, side // 2, side // 2] = stars.STAR
    edge = (stars.SIDE - side) // 2
    light = stars.pupil_star(lambda x, y: waves * (x * x + y * y))[
        edge : edge + side, edge : edge + side
    ]
    error, promise = error_and_promise(
        gs.Simulator(camera, device="numpy"),
        replace(scene, content=Cube(stars.BANDS, values)),
        lambda exposure: light * exposure.plan.weights[0, 1] * stars.STAR,
    )
    assert error < promise < 10 * error + 1e-6


def scene_of(values, **more):
    wavelengths = np.array([450.0, 550.0, 650.0])
    return Scene(
        Cube(wavelengths, np.stack([values] * 3).astype(np.float32)),
        Spectrum(wavelengths, np.full(3, 1e15)),
        "edge",
        **more,
    )


@pytest.mark.parametrize(
    "view", [View((0.5, 0.5)), View((0.3, 0.2), 0.0, 1.2), View((0, 0), 0.2, 1.9)]
)
def test_views_next_to_one_bright_sample(view):
    """Cubics would be negative there: the light goes by area, and a magnified picture is blurred less."""
    values = np.random.default_rng(4).random((48, 52)) * 0.2 + 0.4
    values[20, 31] = 600
    camera = replace(gs.open_camera("mono"), optics=Optics(8.0, 4e-3, relative_illumination="none"))
    error, promise = error_and_promise(
        gs.Simulator(camera, device="numpy"), replace(scene_of(values), view=view)
    )
    assert error < promise < 10 * error


def test_a_calibrated_lens_in_a_tiny_frame():
    """Between few nodes a grid errs, in places and in brightness.

    The truth has no answer to what lies around so small a frame: the rule of the border continues the distorted
    picture in both, which the plan says as an error of its own.
    """
    values = np.linspace(1, 3, 6)[:, None] * np.linspace(1.2, 1, 5)
    calibration = gs.Calibration(5, 6, 8.0, 8.0, 2.0, 2.5, (-0.18, 0.05, 0.0, 0.0))
    camera = replace(
        gs.open_camera("mono"),
        optics=Optics(40.0, 16e-3, relative_illumination="none", distortion=calibration),
    )
    simulator = gs.Simulator(camera, device="numpy")
    error, _ = error_and_promise(simulator, scene_of(values))
    bounds = simulator.plan(scene_of(values)).account.bounds
    promise = SAFETY * np.hypot(*(bounds[name].rms for name in ("distortion", "distortion grid")))
    assert error < promise < 1e-2 and bounds["distorted border"].rms > 0.1
