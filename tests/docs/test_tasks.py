"""What newcomers come for, in at most 15 lines each, runs as the documentation prints it."""

import runpy
from pathlib import Path

import numpy as np
import pytest

TASKS = {
    path.stem: path for path in sorted((Path(__file__).parents[2] / "docs" / "tasks").glob("*.py"))
}
LINES = 15


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    import matplotlib
    from matplotlib import pyplot

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    yield
    pyplot.close("all")


def test_there_are_four_and_they_are_short():
    assert len(TASKS) == 4
    for name, path in TASKS.items():
        lines = [line for line in path.read_text().split("\n") if line.strip()]
        assert len(lines) <= LINES, f"{name}: {len(lines)} lines"
        assert max(map(len, lines)) <= 120  # no line that is two


@pytest.mark.slow
def test_own_camera():
    made = runpy.run_path(str(TASKS["1_own_camera"]))
    assert Path("own_camera.png").is_file()
    # the lens at 550 nm and f/2.4 times the pixel's sinc is what no demosaicking surpasses by much, and bilinear green
    # what an adaptive one surpasses; a tenth for the light's other wavelengths and the matrix
    f = np.linspace(0, 0.5, 501)
    s = f / 2.2 * 0.55 * 2.4
    best = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2)) * np.sinc(f)
    worst = best * (0.75 + 0.25 * np.cos(2 * np.pi * f))
    low, high = (np.interp(-0.5, -curve, f) / 2.2e-3 for curve in (worst, best))
    green = next(line for line in made["left"].lines if "G: MTF50" in str(line.get_label()))
    assert 0.9 * low < np.interp(-0.5, -green.get_ydata(), green.get_xdata()) < 1.1 * high
    # a full well without fixed patterns: sqrt(9000 + 2.5^2); read noise and the converter's 9000 / 4032 steps of
    # 1 / sqrt(12) are less than 0.01 dB, DSNU of 1 e- as well
    best = max(
        np.nanmax(line.get_ydata())
        for line in made["right"].lines
        if "channel" in str(line.get_label())
    )
    assert best == pytest.approx(10 * np.log10(9000), abs=0.05)


def test_pairs(photographs):
    runpy.run_path(str(TASKS["2_pairs"]))
    found = sorted(Path("pairs").glob("*.npz"))
    assert [path.stem for path in found] == [path.stem for path in photographs]
    assert all(path.with_suffix(".png").is_file() for path in found)
    pairs = [np.load(path) for path in found]
    for pair in pairs:
        noisy, clean = (pair[name].astype(float) for name in ("noisy", "clean"))
        assert noisy.shape == clean.shape == (48, 64)
        below = clean < 900  # of a well of 6000 / 4: what is not clipped
        sigma = np.sqrt(clean[below] + 25)
        part = (noisy - clean)[below] / sigma
        # 1500 pixels or more: the mean scatters by 0.026 of sigma, dark current adds 0.05 e-, DSNU and PRNU a
        # thousandth; the standard deviation by 2 %, and rounding of 0.17 DN/e- at gain 4 (1.5 e- a step) adds less
        assert (
            below.sum() > 1500
            and abs(part.mean()) < 0.12
            and part.std() == pytest.approx(1, abs=0.1)
        )


@pytest.fixture
def photographs():
    """Three parts of a photograph: fifty are no other code."""
    from PIL import Image
    from skimage import data

    Path("photos").mkdir()
    paths = [Path("photos") / f"{name}.png" for name in "abc"]
    for number, path in enumerate(paths):
        Image.fromarray(data.astronaut()[60 * number : 60 * number + 48, 200:264]).save(path)
    return paths


def test_mitsubas_render():
    """A striped wall at 0.5 m on the left and one at 3 m on the right: what is in focus has the contrast."""
    bands = range(400, 701, 50)
    _write_as_mitsuba_does("render.exr", bands)
    made = runpy.run_path(str(TASKS["3_mitsuba"]))
    near, far = (axis.images[0].get_array()[20:76].astype(float) for axis in made["axes"])
    contrast = [
        [part.std() for part in (picture[:, 10:54], picture[:, 74:118])] for picture in (near, far)
    ]
    assert contrast[0][0] > 2 * contrast[1][0] and contrast[1][1] > 2 * contrast[0][1], contrast
    assert Path("focus.png").is_file()
    assert {path.name for path in Path().glob("*.dng")} == {"focus-0.5m.dng", "focus-3.0m.dng"}


def _write_as_mitsuba_does(path, bands):
    """Channels named as the film's bands, W m-2 sr-1 nm-1, and the distance along the ray."""
    import OpenEXR

    y, x = np.mgrid[:96, :128]
    stripes = np.where(x // 4 % 2, 0.3, 0.03).astype(np.float32)
    step = 2 * np.tan(np.radians(20)) / 128
    distance = np.where(x < 64, 0.5, 3.0) * np.sqrt(
        1 + ((x - 63.5) * step) ** 2 + ((y - 47.5) * step) ** 2
    )
    channels = {f"band{nm}": stripes for nm in bands} | {"depth.T": distance.astype(np.float32)}
    OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels
    ).write(path)


def test_two_pixel_sizes():
    made = runpy.run_path(str(TASKS["4_pixel_sizes"]))
    shapes = [axis.images[0].get_array().shape for axis in made["axes"]]
    assert shapes == [(160, 240, 3), (80, 120, 3)]
    assert Path("pixel_sizes.png").is_file()
    small, large = (float(axis.get_title().split()[-1]) for axis in made["axes"])
    assert large < small  # of one light four times the electrons on a pixel
