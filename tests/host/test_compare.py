"""`gs.compare` and `gpusim compare`: verdicts, exit statuses, pages, and input that cannot be compared."""

import json
import math

import numpy as np
import pytest
from PIL import Image

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import BadData
from gpusim.fit.compare import Comparison
from gpusim.fit.noise_statistics import Statistic
from gpusim.fit.noise_sums import light_at, smooth_light, sum_noise
from gpusim.fit.verdicts import judge
from gpusim.io.raw.raw_frame import RawFrame

BAYER = ("RG", "GB")


def frames(count=2, low=60, high=70, cfa=BAYER, shape=(48, 52), seed=0, **settings):
    random = np.random.default_rng(seed)
    return [
        RawFrame(
            random.integers(low, high, shape).astype(np.uint16), cfa, f"{seed}-{k}", **settings
        )
        for k in range(count)
    ]


@pytest.mark.parametrize(
    ("difference", "error", "state"),
    [
        (0.001, 0.001, "agrees"),
        (0.03, 0.003, "differs"),
        (0.015, 0.003, "agrees"),  # up to 0.015 + 1.645 0.003 = 0.0199
        (0.015, 0.0031, "cannot be judged"),  # up to 0.0201
        (0.0, 0.02, "cannot be judged"),
        (0.03, 0.03, "cannot be judged"),
        (-0.05, 0.001, "differs"),
    ],
)
def test_verdicts_by_hand(difference, error, state):
    """One statistic: 1.96 standard errors on both sides, 1.645 on one side; agreement within 0.02."""
    one = Statistic("a", difference, error, 0.02, "%", freedom=math.inf)
    (found,) = judge([("group", [one])])
    assert found.state == state and state in found.words
    assert (found.low, found.high) == pytest.approx(
        (difference - 1.959964 * error, difference + 1.959964 * error), rel=1e-6
    )
    assert found.reach == pytest.approx(abs(difference) + 1.644854 * error, rel=1e-6)


def test_intervals_are_wider_for_more_statistics_and_fewer_degrees_of_freedom():
    one = Statistic("a", 0.0, 1.0, 1.0, freedom=math.inf)
    many = judge([("group", [one] * 20)])[0]
    assert many.high == pytest.approx(3.0233, abs=1e-3)  # normal quantile of 1 - 0.05 / 40
    few = Statistic("a", 0.0, 1.0, 1.0, freedom=5)
    assert judge([("group", [few])])[0].high == pytest.approx(2.5706, abs=1e-3)  # Student's t
    assert many.reach == pytest.approx(1.644854, abs=1e-6)  # all must agree: no wider for more
    far = Statistic("a", -1.0, 0.1, 2.0, is_distance=True)
    assert judge([("group", [far])])[0].low == 0


def test_the_verdict_of_all():
    sure, unsure = Statistic("a", 0.0, 0.1, 1.0), Statistic("b", 0.0, 1.0, 1.0)
    wrong = Statistic("c", 9.0, 1.0, 1.0)
    for statistics, state in (
        ([sure], "agrees"),
        ([sure, unsure], "cannot be judged"),
        ([sure, unsure, wrong], "differs"),
    ):
        found = Comparison("mine", tuple(judge([("group", statistics)])))
        assert found.state == state and found.lines()[-1].startswith(f"mine: {state}")


def test_sums_against_plain_formulas():
    random = np.random.default_rng(1)
    stack = random.normal(100, 3, (5, 32, 40))
    sums = sum_noise(stack, np.zeros((1, 1), int), np.array([3.0]), False)
    residual = stack - stack.mean(axis=(1, 2), keepdims=True)
    variance = residual.var(axis=0, ddof=1).mean()
    # the 288 means of lines that are removed hold 5.6 % of the squares, within sqrt(2 / 288): three times 0.46 %
    assert sums.squares.sum() / sums.numbers.sum() == pytest.approx(variance, rel=0.014)
    assert sums.bins.sum() == 2 * 32 * 40  # two differences of five frames
    number, squares, reciprocal = sums.rows.sum(axis=0)
    assert (number, reciprocal) == (4 * 32, pytest.approx(4 * 32 / 40))
    assert squares == pytest.approx(reciprocal, rel=6 * np.sqrt(2 / number))
    assert sums.along_rows.mean() == pytest.approx(1, abs=0.05)


def test_defects_are_counted_and_not_part_of_the_pattern():
    random = np.random.default_rng(2)
    pattern = random.normal(0, 2, (64, 64))
    pattern[::16, ::16] = 200  # 16 pixels
    stack = 100 + pattern + random.normal(0, 1, (4, 64, 64))
    sums = sum_noise(stack, np.zeros((1, 1), int), np.array([1.0]), False)
    assert sums.defects.sum(axis=0) == pytest.approx((16, 64 * 64))
    squares, number = sums.pattern.sum(axis=0)[:, 0]
    # 4 + 1 / 4, within four errors of a variance; removed lines and the surface hold 134 of 4096 numbers
    assert squares / number == pytest.approx(4.25 * (1 - 134 / 4096), rel=4 * math.sqrt(2 / 4096))


def test_the_transfer_of_a_charts_samples():
    """A square of half a pixel, seen along the normal of an edge at 5 degrees, by a sum over its area."""
    from gpusim.fit.compare_scenes import _sample_transfer

    angle, frequencies = np.radians(5), np.linspace(0, 0.5, 6)
    y, x = np.meshgrid(*[(np.arange(400) + 0.5) / 800 - 0.25] * 2)
    along = x * np.cos(angle) + y * np.sin(angle)
    wanted = [np.cos(2 * np.pi * f * along).mean() for f in frequencies]
    np.testing.assert_allclose(_sample_transfer(frequencies, 5.0), wanted, rtol=1e-5)


def test_parts_of_cells():
    """Ten pixels in eight cells: each cell has 1.25 of them."""
    from gpusim.fit.compare_scenes import _cell_parts

    found = _cell_parts(10)
    np.testing.assert_allclose(found.sum(axis=1), 1)
    np.testing.assert_allclose(found[1, :4], (0, 0.6, 0.4, 0))


def test_the_iso_speed_of_the_file_is_a_line():
    held = frames(iso=3200.0, shape=(48, 52))
    found = gs.compare("machine-vision", held, device="numpy")
    assert any("ISO 3200" in line for line in found.unknown)
    found = gs.compare("machine-vision", held, base_iso=100.0, device="numpy")
    assert not any("ISO 3200" in line for line in found.unknown)


def test_smooth_light_follows_a_polynomial():
    y, x = ((2 * np.arange(size) + 1) / size - 1 for size in (24, 30))
    planes = [100 + 5 * y[:, None] - 3 * x**2, 50 + 2 * x * y[:, None]]
    letters = np.array([[0, 1]])
    mean = np.where(np.arange(30) % 2, planes[1], planes[0])
    found = smooth_light(mean, letters, 2)
    for coefficients, plane in zip(found, planes, strict=True):
        np.testing.assert_allclose(light_at(coefficients, 24, 30), plane, atol=1e-9)


@pytest.mark.parametrize(
    ("held", "settings", "words"),
    [
        ((), {}, "none; give darks or flats"),
        (frames(1), {}, "no pairs among 1 frames"),
        (frames(cfa=("BG", "GR")), {}, "mosaic BG/GR, the camera file has RG/GB"),
        (frames() + frames(shape=(32, 32), seed=1), {}, "mixed sizes"),
        (frames(camera="A") + frames(camera="B", seed=1), {}, "mixed cameras"),
        (frames(high=9000), {}, "values up to .* ends at 4095 DN"),
        (frames(iso=100.0) + frames(iso=200.0, seed=1), {}, "mixed ISO: 100, 200"),
        (frames(), {"edges": frames()}, "sfr: "),
        ([3], {}, "held-out frame: int, wanted a file or a RawFrame"),
        (3, {}, "held-out frames: int, wanted files or raw frames"),
    ],
)
def test_input_that_cannot_be_compared(held, settings, words):
    with pytest.raises(BadData, match=words) as error:
        gs.compare("machine-vision", held, device="numpy", **settings)
    assert "\n" not in str(error.value)


def test_cameras_that_cannot_be_compared():
    with pytest.raises(BadData, match="camera: int"):
        gs.compare(3, frames())
    stacked = gs.open_camera("phone").with_(stacked=True)
    with pytest.raises(BadData, match="stacked pixels"):
        gs.compare(stacked, frames(), device="numpy")


def test_commands_and_their_statuses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    readout = gs.Readout(gs.open_camera("mono").sensor, "numpy")
    dark = readout.draw_electrons(np.zeros((72, 72), np.float32), 1e-3, frames=4)
    np.savez("dark.npz", dn=dark, exposure_time_s=1e-3, black_level=64.0)
    np.savez("noisy.npz", dn=64 + 3 * (dark - 64.0), exposure_time_s=1e-3, black_level=64.0)
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save("a.jpg")
    on = ["--device", "numpy"]
    assert main(["compare", "mono", "dark.npz", *on]) == 3  # too few
    assert "take more frames" in capsys.readouterr().out
    named = ["--page", "page.html", "--json", "rows.json"]
    assert main(["compare", "mono", "noisy.npz", *on, *named]) == 1
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert rows["verdict"] == "differs" and len(rows["statistics"]) > 5
    page = (tmp_path / "page.html").read_text()
    assert "differs by" in page and page.count("<svg") == 2 and "http" not in page.split("<svg")[0]
    for arguments, words in (
        (["mono", "a.jpg"], "a JPEG"),
        (["mono", "none.npz"], "no such file"),
        (["mono"], "held-out frames: none"),
        (["mono", "dark.npz", "--light", "A"], "--light"),
        (["dark.npz", "dark.npz"], "no camera file"),
        (["a.jpg", "dark.npz"], "no camera file"),
    ):
        assert main(["compare", *arguments, *on]) == 2
        said = capsys.readouterr().err.strip().splitlines()
        assert len(said) == 1 and words in said[0]


def test_an_agreed_camera_has_status_0(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    readout = gs.Readout(gs.open_camera("mono").sensor, "numpy")
    dark = readout.draw_electrons(np.zeros((320, 320), np.float32), 1e-3, frames=12)
    np.savez("dark.npz", dn=dark, exposure_time_s=1e-3, black_level=64.0)
    assert main(["compare", "mono", "dark.npz", "--device", "numpy"]) == 0
