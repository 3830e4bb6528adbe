"""What demosaickers promise of each other, without noise: slower ones are better."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.noise import Noise
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.learned import learned
from gpusim.kernels.processor.network import network

SCENES = {
    "deadleaves": {},
    "deadleaves of skin": {"surfaces": "skin"},
    "slanted-edge": {},
    "sweep": {},
}


def linear(scene, stacked=False, **processor):
    """Linear display RGB of the phone without noise and with fine numbers."""
    camera = gs.open_camera("phone")
    sensor = replace(camera.sensor, noise=Noise(photon="none"), bits=16, stacked=stacked)
    camera = replace(camera, sensor=sensor, processor=replace(camera.processor, **processor))
    return np.asarray(gs.Simulator(camera, device="opencl")(scene).linear)


@pytest.mark.parametrize("name", SCENES)
def test_better_methods_are_better(name):
    scene = gs.chart(name.split()[0], size=(192, 128), **SCENES[name])
    wanted = linear(scene, stacked=True)
    inner = np.s_[10:-10, 10:-10]
    errors = [
        np.sqrt(np.mean((linear(scene, demosaic=method) - wanted)[inner] ** 2))
        for method in ("best", "adaptive", "bilinear")
    ]
    assert errors[0] <= errors[1] <= errors[2]


@pytest.mark.parametrize("method", [best, learned, network])
def test_methods_are_continuous_as_noise_goes_to_zero(method):
    """They are told less and less noise of the same numbers: the result tends to the one without.

    The mean: single pixels of `learned` take another class.
    """
    raw = np.random.default_rng(2).integers(500, 3000, (40, 50)).astype(np.uint16)
    options = {"black_level": 64.0, "scale": 1 / 4096, "device": "opencl"}
    options["cfa" if method is network else "phase"] = ("RG", "GB") if method is network else "RGGB"
    wanted = method(raw, **options)
    steps = [
        np.abs(method(raw, **options, noise=(gain, 0.0)) - wanted).mean()
        for gain in (1, 1e-2, 1e-4)
    ]
    assert steps[0] > 3 * steps[1] > 9 * steps[2] and steps[2] < 1e-4
