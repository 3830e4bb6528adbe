"""Fits of real frames against plain NumPy and OpenCV, which share no code with the fit.

Noise: a campaign of Sony's IMX541 in an Allied Vision camera, 8 darks and 8 flats of 1128 x 1128 pixels at each of 21
exposure times. GPUSIM_REAL_FRAMES names its folder with the folders dark and bright.
Boards: OpenCV's own pictures, two cameras, 13 views each. They are 8-bit JPEGs and become linear by a power of 2.2.
GPUSIM_OPENCV_DATA names their folder if Debian's package opencv-doc is not installed.
"""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import gpusim as gs

pytestmark = pytest.mark.slow

EXPOSURES = 25, 49, 144, 522, 1757, 2867, 4156, 5240  # [us] as the names of files have them
FITTED, FRAMES = 4, 8  # frames of each setting that are fitted; the rest is held out
ROUNDING = 1 / 12
CORNERS = 9, 6  # of OpenCV's board


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """The frames by kind, exposure and number, and a folder with them as .npz."""
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed")
    source = Path(os.environ.get("GPUSIM_REAL_FRAMES", "/nowhere"))
    if not (source / "bright").is_dir():
        pytest.skip(
            "GPUSIM_REAL_FRAMES names no folder with darks and flats of the IMX541 (see docs/fit.md)"
        )
    folder, frames = tmp_path_factory.mktemp("imx541"), {}
    for kind, name in (("dark", "darks"), ("bright", "flats")):
        for path in sorted((source / kind).glob("*.tiff")):
            microseconds, number = map(int, re.search(r"exp(\d+)us_n(\d+)", path.name).groups())
            if microseconds not in EXPOSURES:
                continue
            with tifffile.TiffFile(path) as tiff:
                values = tiff.asarray()
                stated = json.loads(tiff.pages[0].description)["selected_settings"]
            frames[kind, microseconds, number] = values
            place = folder / ("fit" if number < FITTED else "held") / name
            place.mkdir(parents=True, exist_ok=True)
            np.savez(
                place / f"{path.stem}.npz",
                dn=values,
                exposure_time_s=stated["ExposureTime"] * 1e-6,
                temperature_deg_c=stated["DeviceTemperature"],
                camera=stated["DeviceModelName"],
            )
    assert len(frames) == 2 * len(EXPOSURES) * FRAMES
    return frames, folder


@pytest.fixture(scope="module")
def fitted(campaign):
    _, folder = campaign
    return gs.fit(folder / "fit")


def stack(frames, kind, microseconds):
    return np.stack([frames[kind, microseconds, n] for n in range(FITTED)]).astype(np.float64)


def temporal_variance(values):
    """Variance of single frames from differences of pairs, without the light's changes."""
    differences = np.diff(values, axis=0)[::2]
    return (differences - differences.mean((1, 2), keepdims=True)).var() / 2


def photon_transfer(frames):
    """Signals and variances above dark of the flats, and the mean and variance of darks."""
    darks = [stack(frames, "dark", one) for one in EXPOSURES]
    black = np.mean([one.mean() for one in darks])
    dark = np.mean([temporal_variance(one) for one in darks])
    flats = [stack(frames, "bright", one) for one in EXPOSURES]
    signal = np.array([one.mean() - black for one in flats])
    return signal, np.array([temporal_variance(one) for one in flats]) - dark, black, dark


def test_noise_of_a_real_sensor(campaign, fitted):
    """Each tolerance is the spread of what NumPy finds, as a real sensor is not exactly the model."""
    frames, _ = campaign
    signal, variance, black, dark = photon_transfer(frames)
    found = fitted.estimates
    # means of darks at one setting scatter by 0.003 to 0.007 DN
    assert abs(found["sensor.black_level_dn"].value - black) < 0.01
    # weights of the variances' own errors, as in the fit; both have the same dark frames as a point
    gain = found["sensor.gain_dn_per_e"]
    slopes = variance / signal
    assert slopes.max() / slopes.min() > 1.04  # the line does not fit: its interval must hold that
    assert slopes.min() < gain.low < gain.high < slopes.max()
    weight = 1 / (variance + dark) ** 2
    assert gain.low < (weight * signal) @ variance / ((weight * signal) @ signal) < gain.high
    # noisy pixels, of which the fit counts the worst apart, add 7 % to the dark variance: 3.6 % to its root
    read = found["noise.read_e"].value * gain.value
    assert 0.95 < read / np.sqrt(dark - ROUNDING) < 1.0


def test_pattern_of_a_real_sensor(campaign, fitted):
    frames, _ = campaign
    *_, black, _ = photon_transfer(frames)
    y, x = np.mgrid[-1:1:1128j, -1:1:1128j]
    smooth = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], -1).reshape(-1, 10)
    seen = []
    for microseconds in (2867, 4156, 5240):
        halves = []
        for part in np.split(stack(frames, "bright", microseconds) - black, 2):
            mean = part.mean(0)
            fit = np.linalg.lstsq(smooth[::97], mean.ravel()[::97], rcond=None)[0]
            halves.append(mean / (smooth @ fit).reshape(mean.shape) - 1)
        lines = sum((halves[0].mean(axis) * halves[1].mean(axis)).mean() for axis in (0, 1))
        seen.append(np.sqrt((halves[0] * halves[1]).mean() - lines))
    # levels differ by 1.8 %
    assert fitted.estimates["noise.prnu"].value == pytest.approx(np.mean(seen), rel=0.02)


def test_telegraph_pixels_are_no_hot_pixels(campaign, fitted):
    """Between short and long darks as many pixels fall as rise."""
    frames, _ = campaign
    change = stack(frames, "dark", 5240).mean(0) - stack(frames, "dark", 25).mean(0)
    change -= np.median(change)
    deviation = np.subtract(*np.percentile(change, (84.134, 15.866))) / 2
    rise, fall = (change > 6 * deviation).sum(), (change < -6 * deviation).sum()
    assert rise + fall > 100
    assert abs(rise - fall) < 3 * np.sqrt(rise + fall)
    assert "noise.hot_pixels" not in fitted.estimates


def test_misfits_of_a_real_sensor_are_named(fitted):
    lines = "\n".join(fitted.unexplained)
    assert "the variance is no line over the signal" in lines
    assert "banding of rows" in lines  # a period of 56 rows in the spectrum of darks


def test_held_out_frames_of_a_real_sensor(campaign, fitted, tmp_path):
    """The variance of the file is within 6 % of the sensor's at all levels, and the verdict says that it differs."""
    _, folder = campaign
    fitted.write(tmp_path / "mine.toml")
    files = [
        path
        for path in sorted((folder / "held").rglob("*.npz"))
        if re.search("exp0*(25|144|1757|4156)us", path.name)
    ]
    comparison = gs.compare(tmp_path / "mine.toml", files)
    assert comparison.state == "differs"
    found = [one.difference for one in comparison.findings if one.statistic == "variance"]
    assert len(found) == 8
    # the slopes of the photon transfer differ by 3 % from the fitted one; telegraph noise by more
    assert max(map(abs, found)) < 0.06


@pytest.fixture(scope="module", params=["left", "right"])
def boards(request, tmp_path_factory):
    """OpenCV's corners of each view, and a folder with linear frames."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    source = os.environ.get("GPUSIM_OPENCV_DATA", "/usr/share/doc/opencv-doc/examples/data")
    paths = sorted(Path(source).glob(f"{request.param}[01]*.jpg"))
    if not paths:
        pytest.skip(
            "OpenCV's pictures of boards are not installed (Debian: opencv-doc), see GPUSIM_OPENCV_DATA"
        )
    folder, views = tmp_path_factory.mktemp("boards"), []
    for path in paths:
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        is_found, corners = cv2.findChessboardCorners(picture, CORNERS)
        assert is_found
        end = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4
        start = np.float32(corners).reshape(-1, 1, 2)
        views.append(cv2.cornerSubPix(picture, start, (5, 5), (-1, -1), end).reshape(-1, 1, 2))
        light = np.rint((picture / 255) ** 2.2 * 4095).astype(np.uint16)
        np.save(folder / f"{path.stem}.npy", light)
    return views, picture.shape[::-1], folder


def test_boards_of_real_cameras(boards):
    """The interval of each number holds OpenCV's or reaches its own uncertainty, k3 or not."""
    import cv2

    views, size, folder = boards
    found = gs.fit(grid=sorted(folder.glob("*.npy"))).estimates
    grid = np.zeros((np.prod(CORNERS), 3), np.float32)
    grid[:, :2] = np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2)
    answers = []
    for flags in (0, cv2.CALIB_FIX_K3):
        _, matrix, values, *_ = cv2.calibrateCamera(
            [grid] * len(views), views, size, None, None, flags=flags
        )
        answers.append([*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *values.ravel()[:5]])
    low, high = np.min(answers, axis=0), np.max(answers, axis=0)
    for name, least, most in zip("fx fy cx cy k1 k2 p1 p2 k3".split(), low, high, strict=True):
        one = found[f"optics.calibration.{name}"]
        assert one.low < most and least < one.high, (name, one, least, most)
