"""`gpusim fit` on small frames: what it finds, what it refuses in one line, what it writes."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from raw_cameras import RawCamera, draw_maps, expose

import gpusim as gs
from gpusim.cli.main import main
from gpusim.fit.darks import fit_doubling
from gpusim.fit.intervals import MeanSquare, difference_of
from gpusim.fit.rounding import before_rounding, rounded_variance

CAMERA = RawCamera(
    shape=(61, 70),
    cfa=("RG", "GB"),
    bits=12,
    black=128,
    gains={100: 0.4},
    full_well=8000,
    read=4.0,
    adc=0.0,
    row=1.0,
    column=1.0,
    dsnu=2.0,
    row_dsnu=1.0,
    column_dsnu=1.0,
    prnu=0.01,
    row_prnu=0.004,
    column_prnu=0.004,
    dark_current=20.0,
    hot_pixels=0.0,
    hot_current=0.0,
    dead_pixels=0.0,
    efficiency={"R": 0.7, "G": 1.0, "B": 0.6},
    shading=0.02,
    seed=7,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Darks of two times and pairs of flats, the last beyond saturation."""
    place = tmp_path_factory.mktemp("shots")
    write(CAMERA, place)
    return place


def write(
    camera, place, levels=(0.1, 0.3, 0.5, 0.7, 5.0), dark_times=(0.001, 2.0), count=4, iso=100
):
    rng, maps = np.random.default_rng(1), draw_maps(camera)
    for name in ("darks", "flats"):
        (place / name).mkdir(exist_ok=True, parents=True)
    for seconds in dark_times:
        for number in range(count):
            save(camera, place / "darks" / f"d{seconds}_{number}.npz", maps, seconds, 0, rng, iso)
    for level in levels:
        for number in range(2):
            path = place / "flats" / f"f{level}_{number}.npz"
            save(camera, path, maps, level / 10, 8000 * level, rng, iso)


def save(truth, path, maps, seconds, electrons, rng, iso, **more):
    frame = expose(truth, maps, iso, seconds, electrons, rng)
    np.savez(
        path, dn=frame, cfa=np.array(truth.cfa), iso=float(iso), exposure_time_s=seconds, **more
    )


def test_a_camera_file_and_a_page_are_written(folder, tmp_path, capsys):
    out = tmp_path / "mine.toml"
    assert main(["fit", str(folder), "-o", str(out), "--maps"]) == 0
    printed = capsys.readouterr().out
    assert "sensor.gain_dn_per_e" in printed and "not known: doubling" in printed
    camera = gs.open_camera(out)
    # 8 frames of 4,270 pixels: about 2 % for the gain and 1 % for noise; 5 standard errors and more
    assert camera.sensor.gain == pytest.approx(0.4, rel=0.08)
    assert camera.sensor.noise.read == pytest.approx(4, rel=0.1)
    assert camera.sensor.noise.dark_current == pytest.approx(20, rel=0.15)
    assert camera.sensor.full_well == pytest.approx(8000, rel=0.1)
    assert camera.sensor.black_level == 128
    assert camera.sensor.bits == 12
    text = out.read_text()
    assert "95 %" in text and "f0.1_0.npz" in text and str(folder) not in text
    page = (tmp_path / "mine.html").read_text()
    assert page.count("<svg") == page.count("<figure>") >= 4 and "http-equiv" not in page
    assert str(folder) not in page and "currentColor" in page
    maps = np.load(tmp_path / "mine.maps.npz")
    assert maps["dsnu_e"].shape == maps["prnu"].shape == CAMERA.shape
    assert tomllib.loads(text)["base"] == "phone"


def test_content_tells_dark_from_flat(folder):
    files = sorted(folder.glob("*/*.npz"))
    links = [folder.parent / "content" / path.name for path in files]
    links[0].parent.mkdir(exist_ok=True)
    for link, path in zip(links, files, strict=True):
        link.write_bytes(path.read_bytes())
    found = gs.fit(links)
    assert found.lines == ("frames: 8 of dark, 10 of flat",)
    assert found.estimates == gs.fit(darks=links[:8], flats=links[8:]).estimates


def refused(tmp_path, *arguments, capsys):
    status = main(["fit", *map(str, arguments), "-o", str(tmp_path / "out.toml")])
    line = capsys.readouterr().err
    assert status == 2 and line.count("\n") == 1
    assert not list(tmp_path.glob("out.*"))
    return line


def test_wrong_shots_are_refused_in_one_line(folder, tmp_path, capsys):
    rng, maps = np.random.default_rng(2), draw_maps(CAMERA)
    darks, flats = folder / "darks", folder / "flats"
    assert "no flats" in refused(tmp_path, darks, capsys=capsys)
    assert "no dark frames" in refused(tmp_path, flats, capsys=capsys)
    clipped = sorted(flats.glob("f5.0*"))
    line = refused(tmp_path, darks, "--flats", *clipped, capsys=capsys)
    assert "are clipped" in line and "shoot pairs" in line
    save(CAMERA, tmp_path / "other.npz", maps, 0.1, 4000, rng, 100, camera="Other 2")
    save(CAMERA, tmp_path / "one.npz", maps, 0.1, 4000, rng, 100, camera="One 1")
    mixed = [tmp_path / "other.npz", tmp_path / "one.npz"]
    assert "mixed cameras" in refused(tmp_path, darks, "--flats", *mixed, capsys=capsys)
    np.savez(tmp_path / "small.npz", dn=np.ones((20, 20), np.uint16), cfa=np.array(CAMERA.cfa))
    assert "mixed sizes" in refused(tmp_path, folder, tmp_path / "small.npz", capsys=capsys)
    save(CAMERA, tmp_path / "iso.npz", maps, 0.1, 4000, rng, 100)
    with np.load(tmp_path / "iso.npz") as stored:
        np.savez(tmp_path / "iso.npz", **(dict(stored) | {"iso": 800.0}))
    (line,) = gs.fit(folder, flats=tmp_path / "iso.npz").failed
    assert line.startswith("noise at ISO 800: no dark frames at ISO 800")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "a.jpg")
    line = refused(tmp_path, tmp_path / "a.jpg", capsys=capsys)
    assert "JPEG" in line and "shoot raw" in line


def test_a_part_that_fails_does_not_end_the_fit(folder, tmp_path, capsys):
    out = tmp_path / "mine.toml"
    flat, dark = folder / "flats/f0.5_0.npz", folder / "darks/d0.001_0.npz"
    assert main(["fit", str(folder), "--edges", str(flat), "-o", str(out)]) == 1
    printed = capsys.readouterr().out
    assert printed.count("not fitted: edges: f0.5_0.npz: ") == 1
    text, page = out.read_text(), (tmp_path / "mine.html").read_text()
    assert "read_e" in text and "edges: f0.5_0.npz" in text and "Not fitted" in page
    found = gs.fit(darks=dark, flats=sorted(folder.glob("flats/f5.0*")), shading=flat)
    (line,) = found.failed  # one dark frame and clipped flats
    assert line.startswith("noise: ") and found.settings["optics"]


def test_a_moved_tripod_is_refused(tmp_path, capsys):
    camera, rng = replace(CAMERA, shape=(120, 130)), np.random.default_rng(3)
    maps = draw_maps(camera)
    write(camera, tmp_path / "shots", levels=(0.1, 0.5))
    y, x = np.mgrid[:120, :130]
    for number in range(2):
        # the picture moves by half a pixel, the chip does not
        picture = 1 + 0.15 * np.sin((x + number / 2) / 5) * np.sin(y / 6)
        moved = maps | {"light": maps["light"] * picture}
        save(camera, tmp_path / f"m{number}.npz", moved, 0.07, 5600, rng, 100)
    files = sorted(tmp_path.glob("m*.npz"))
    line = refused(tmp_path, tmp_path / "shots", "--flats", *files, capsys=capsys)
    assert "displaced by" in line and "tripod" in line


@pytest.mark.parametrize("first, second", [(30, None), (30, 200), (2000, 2000)])
def test_intervals_of_variances_hold_the_truth(first, second):
    rng, inside = np.random.default_rng(4), 0
    for _ in range(1000):
        squares = [MeanSquare(rng.chisquare(first) / first * 3, first)]
        if second:
            squares.append(MeanSquare(rng.chisquare(second) / second * 1, second))
        found = difference_of(*squares)
        inside += found.low <= 3 - bool(second) <= found.high
    # 950 +- 4 sqrt(1000 0.95 0.05)
    assert abs(inside - 950) < 28


def test_rounding_is_taken_out():
    rng = np.random.default_rng(5)
    for deviation in (0.15, 0.3, 0.6):
        means = rng.uniform(-0.5, 0.5, 20_000)
        values = np.rint(means + deviation * rng.standard_normal((8, 20_000)))
        measured = values.var(axis=0, ddof=1).mean()
        assert rounded_variance(deviation) == pytest.approx(measured, rel=0.03)
        assert before_rounding(measured) == pytest.approx(deviation**2, rel=0.1)


def test_dark_current_doubles():
    rates = {20.0: (3.0, 0.03), 28.0: (6.0, 0.03), 36.0: (12.0, 0.06)}
    doubling, degrees, rate = fit_doubling(rates)
    assert doubling.value == pytest.approx(8, rel=1e-6)
    assert doubling.low < 8 < doubling.high
    assert rate == pytest.approx(3 * 2 ** ((degrees - 20) / 8), rel=1e-6)
    assert fit_doubling({20.0: (3.0, 0.03)}) is None


def test_a_ramp_by_itself_gives_the_tone_curve(tmp_path):
    codes = (255 * np.linspace(0, 1, 256) ** (1 / 2.2)).round().astype(np.uint8)
    Image.fromarray(np.tile(codes[None, :, None], (32, 1, 3))).save(tmp_path / "ramp.png")
    found = gs.fit([], ramp=[tmp_path / "ramp.png"])
    found.write(tmp_path / "mine.toml")
    tone = gs.open_camera(tmp_path / "mine.toml").processor.tone
    assert np.allclose(tone, found.settings["processor"]["tone"]) and len(tone) > 2
