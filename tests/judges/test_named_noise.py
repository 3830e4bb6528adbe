"""Cameras of darktable's noise data base: simulated flats give back their slope a and intercept b.

GPUSIM_DATABASES names the folder of noiseprofiles.json if darktable is not installed.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import gpusim as gs
from gpusim.apps.named.compose import compose
from gpusim.apps.named.wish import Wish
from gpusim.io.databases.catalogue import Catalogue, open_catalogue
from gpusim.io.databases.places import find_places

pytestmark = pytest.mark.slow

CAMERAS = 24  # the issue asks for 20
SIZE = 512, 384
FRAMES = 4
LEVELS = 0.6, 0.2, 0.05  # of white, of the brightest channel
ROUNDING = 1 / 12


@pytest.fixture(scope="module")
def catalogue():
    if "darktable" not in find_places():
        pytest.skip(
            "darktable's noiseprofiles.json is not installed, and GPUSIM_DATABASES names no folder with it"
        )
    return open_catalogue()


def _entries(path):
    """Return maker, model and usable profiles of the file, read apart from gpusim's reader."""
    table = json.loads(Path(path).read_text(encoding="utf-8"))
    for maker in table["noiseprofiles"]:
        for model in maker["models"]:
            own = {}
            for one in model["profiles"]:
                if not one.get("skip"):
                    own.setdefault(one["iso"], one)
            yield maker["maker"], model["model"], own


def _frames(camera, scene, time, frames):
    """Return raw frames at an exposure time [s]."""
    simulate = gs.Simulator(camera.with_(exposure_time_ms=time * 1e3), device="auto")
    exposure = simulate.expose(scene)
    return exposure.device.numpy(exposure.raw(seed=3, frames=frames))


def _points(camera, scene, time, frames=FRAMES):
    """Return mean and variance of raw values for each channel, and the number of values."""
    stack = np.array(_frames(camera, scene, time, frames), np.float64)
    found = []
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        own = stack[:, row::2, column::2]
        found.append((own.mean(), own.var(ddof=1), own.size))
    return found


def _dark(camera, scene, variance, half, points):
    """Return points of dark frames; for little noise of faint ones, whose green is at k / 8 DN.

    A standard deviation of half a DN is rounded to more or less than 1/12 DN^2, by a cosine of the mean's fraction.
    """
    if variance > 16 * ROUNDING:
        return _points(camera, scene, 1e-9)
    green = points[1][0] * 0.5 / LEVELS[0]  # of the frame at `half`
    times = [half * step / 8 / green for step in range(1, 9)]
    return [one for time in times for one in _points(camera, scene, time, 2)[1:3]]


def _fit(points):
    """Return slope, intercept and their standard deviations of variance over mean, weighted."""
    mean, variance, count = np.array(points).T
    weights = np.sqrt(count / 2) / np.maximum(variance, 1e-3)
    rows = np.stack([mean, np.ones_like(mean)], axis=1) * weights[:, None]
    inverse = np.linalg.inv(rows.T @ rows)
    slope, intercept = inverse @ rows.T @ (variance * weights)
    return slope, intercept, *np.sqrt(np.diag(inverse))


@pytest.fixture(scope="module")
def found():
    """Relative errors of slopes and intercepts, and the number of settings of other kinds, of all cameras."""
    return {"slopes": [], "intercepts": [], "within": 0, "none": 0, "cameras": set()}


@pytest.mark.parametrize("number", range(CAMERAS))
def test_flats_give_back_the_data_base(catalogue, found, tmp_path, number):
    every = [one for one in _entries(catalogue.places["darktable"].files[0]) if len(one[2]) >= 6]
    maker, model, profiles = every[number * (len(every) // CAMERAS)]
    entry = next(
        one
        for one in catalogue.cameras
        if one.noise and (one.noise.maker, one.noise.model) == (maker, model)
    )
    small = Catalogue(catalogue.places, (entry,), (), {})
    found["cameras"].add(entry.name)
    for order, (iso, one) in enumerate(sorted(profiles.items())):
        for at, channel in enumerate("RGB"):
            if one["a"][at] <= 0 or (channel != "G" and order % 4):
                continue  # red and blue at every fourth ISO
            composed = compose(small, entry.name, Wish(iso=iso, channel=channel))
            composed.save(tmp_path / "camera.toml")
            _judge(found, tmp_path / "camera.toml", one["a"][at], one["b"][at])


def _judge(found, path, a, b):
    """Compare a and b with raw frames of a camera file."""
    scene = gs.chart("flat", size=SIZE, wavelengths=[450, 550, 650])
    camera = gs.open_camera(path).with_(cfa=["RG", "GB"])
    camera = camera.with_(model="none", relative_illumination="none")
    automatic = camera.with_(auto_exposure={"method": "full", "level": 0.5})
    half = gs.Simulator(automatic, device="auto")(scene).exposure_time
    black = round(np.mean(_frames(camera, scene, 1e-9, 1)))
    full = (
        float(np.median(_frames(camera, scene, 40 * half, 1))) - black
    )  # all clip, and read noise comes on top
    points = [one for level in LEVELS for one in _points(camera, scene, half * level / 0.5)]
    points = [(mean - black, *rest) for mean, *rest in points]
    dark = [
        (mean - black, *rest) for mean, *rest in _dark(camera, scene, b * full**2, half, points)
    ]
    slope, intercept, _, error = _fit(points)
    quantum = ROUNDING / full**2
    if b > 4 * quantum:
        slope, intercept, *_ = _fit(points + dark)
        found["intercepts"].append(intercept / full**2 / b - 1)
        assert abs(found["intercepts"][-1]) <= 0.01
    elif b > quantum:
        found["within"] += 1
        assert abs(intercept / full**2 - b) <= 4 * error / full**2
    else:
        found["none"] += 1
        assert camera.sensor.noise.read == 0
        assert "read noise 0" in path.read_text(encoding="utf-8").replace("\n#  ", "")
    found["slopes"].append(slope / full / a - 1)
    assert abs(found["slopes"][-1]) <= 0.01


def test_all_cameras(catalogue, found):
    cameras, slopes, intercepts = (found[key] for key in ("cameras", "slopes", "intercepts"))
    if len(cameras) < CAMERAS:
        pytest.skip("other processes have tested some of the cameras; `-n 0` tests all in one")
    print(
        f"{len(cameras)} cameras, {len(slopes)} settings: a within {100 * np.abs(slopes).max():.3f} %; b of "
        f"{len(intercepts)} within {100 * np.abs(intercepts).max():.3f} %, {found['within']} within their intervals, "
        f"{found['none']} read noise 0"
    )
    assert len(cameras) >= 20
