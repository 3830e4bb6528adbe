"""Raw frames behind lenslets: light, noise, grid and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import BadData

CELLS = (3, 3)


@pytest.fixture(scope="module")
def camera():
    """Return a camera with 6 x 6 pixels behind each lenslet, matched to its lens."""
    camera = gs.open_camera("phone").with_(f_number=4.0, focal_length_mm=50.0)
    pitch = 6 * camera.sensor.pixel_pitch
    return camera.with_(sensor=replace(camera.sensor, lenslets=gs.Lenslets(pitch, 4 * pitch)))


@pytest.fixture(scope="module")
def exposure(camera):
    """Return the exposure of a flat scene."""
    simulator = gs.Simulator(camera, device="opencl")
    return gs.expose_lenslets(simulator, gs.chart("flat", size=(21, 17)), CELLS, 0.01)


def test_light_behind_lenslets(camera, exposure):
    """The pixels get all light of the lens: their mean is the ordinary sensor's, away from the border.

    Light that lenslets beyond the array would diffract there is missing: of a spot of 1.6 pixels the share 1.6 / (pi^2
    30) = 0.5 % lies more than 30 pixels away, along each axis.
    """
    assert exposure.mean.shape == (17 * 6, 21 * 6)
    plain = gs.Simulator(
        camera.with_(sensor=replace(camera.sensor, lenslets=None)), device="opencl"
    )
    wanted = np.asarray(plain.expose(gs.chart("flat", size=(24, 24)), 0.01))[6:18, 6:18].mean()
    inner = np.asarray(exposure)[5 * 6 : 12 * 6, 5 * 6 : 16 * 6]
    assert inner.mean() == pytest.approx(wanted, rel=1.2e-2)


def test_noise_of_raw_frames(exposure):
    """Shot noise: the variance of electrons is their mean, and frames are numbered."""
    frames = np.asarray(exposure.raw(seed=3, frames=32)).astype(float)
    again = np.asarray(exposure.raw(seed=3, first=1))
    assert np.array_equal(frames[1], again)
    sensor = exposure.camera.sensor
    variance = frames.var(axis=0, ddof=1).mean() / sensor.gain_dn_per_electron**2
    wanted = (
        np.asarray(exposure).mean() + sensor.read_sigma**2 + 1 / 12 / sensor.gain_dn_per_electron**2
    )
    # of 32 frames and 12852 pixels: sqrt(2 / 31 / 12852) = 0.22 %, dark pixels clip at 0 seldom
    assert variance == pytest.approx(wanted, rel=0.03)


def test_grid_is_found(exposure):
    """The white frame shows the lenslets where they are: 6 pixels apart, one in the middle."""
    grid = gs.calibrate_lenslets(np.asarray(exposure), (2, 2))
    assert grid.pitch == pytest.approx(6 * (1 + 24 * 1.4e-3 / 50), rel=2e-3)
    middle = np.array([(17 * 6 - 1) / 2, (21 * 6 - 1) / 2])
    assert np.abs(np.array(grid.origin) - middle).max() < 0.1


@pytest.mark.parametrize("device", ["opencl", "warp:cpu"])
def test_a_capture_sees_new_light_in_the_same_arrays(camera, device):
    """A second call computes all again, though the scene is the same object: half the light, half the electrons."""
    cube = np.random.default_rng(1).random((9, 12, 4)).astype(np.float32)
    scene = gs.scene_from(cube, (450, 500, 550, 600), light="D65", luminance=100)
    capture = gs.LensletCapture(gs.Simulator(camera, device=device), scene, (1, 2))
    once = np.array(capture(None, 0.01))
    assert np.array_equal(once, np.array(capture(None, 0.01)))
    scene.content.planes[:] /= 2
    assert np.allclose(np.array(capture(None, 0.01)), once / 2, rtol=1e-5, atol=1e-5 * once.max())


@pytest.mark.parametrize(
    "change",
    [
        {"sensor.dual": {"split": "left-right"}},
        {"vignetting": [[1.0, 1.0], [1.0, 0.9]]},
    ],
)
def test_settings_that_would_be_ignored(camera, change):
    """Lenslets beside photodiodes that divide light, or a map of responses, are refused."""
    with pytest.raises(BadData, match="leave one of them out"):
        camera.with_(**change)


def test_refusals(camera):
    """Ordinary frames of such a camera, and lenslet frames of others."""
    scene = gs.chart("flat", size=(24, 16))
    with pytest.raises(BadData, match="expose_lenslets"):
        gs.Simulator(camera, device="numpy")(scene)
    with pytest.raises(BadData, match="no lenslets"):
        gs.expose_lenslets(gs.Simulator(gs.open_camera("phone"), device="numpy"), scene)


@pytest.mark.parametrize(
    "arguments, words",
    [
        ("-o a.png", "views are written as .npz"),
        ("-o a.npy", "without lenslets"),
        ("", "no file is written"),
        ("-o a.npz --frames 2", "--frames"),
        ("-o a.npz --denoise 1", "--denoise"),
        ("-o a.npz --seed 1", "--seed"),
    ],
)
def test_bad_options(arguments, words, tmp_path, monkeypatch, capsys):
    """Options that views have no use for are refused in one line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    command = "simulate flat --camera phone --size 16x16 --device numpy --views 1x2"
    assert main([*command.split(), *arguments.split()]) == 2
    shown = capsys.readouterr().err.strip()
    assert words in shown
    assert "\n" not in shown
    assert not list(tmp_path.iterdir())
