"""`gpusim study` and `gs.study`: each row depends on the design and its number only; a run goes on where it was."""

import csv
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import gpusim as gs
from gpusim.apps.study.ray import StudyRows
from gpusim.apps.study.shot import Shot
from gpusim.cli.main import main
from gpusim.measure import ciede2000, cpsnr, ideal, photon_transfer
from gpusim.measure.snr import dynamic_range

FILE = """camera = "figure8"
sampling = {{method = "latin", count = {count}, seed = 1}}
[vary]
"optics.defocus_um" = {{normal = [0, 6]}}
"noise.read_e" = {{uniform = [2, 12]}}
"sensor.bits" = {{choice = [10, 12]}}
[scenes]
edge = {{scene = "slanted-edge", size = [64, 48]}}
chart = {{scene = "colorchecker", size = [72, 48]}}
[measures]
mtf50 = true
snr = true
de = true
cpsnr = "chart"
dynamic_range = "edge"
[requirements]
sharp = "mtf50 >= 0.2"
clean = "snr@chart >= 30"
"""
SMALL = {
    "camera": {"base": "machine-vision", "sensor.exposure_time_ms": 10},
    "sampling": {"method": "grid"},
    "vary": {"noise.read_e": {"grid": [1, 3]}, "optics.f_number": {"grid": [2.8, 8]}},
    "scenes": {"flat": {"scene": "flat", "size": [48, 32]}},
    "measures": ["snr"],
}


@pytest.fixture
def design(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(FILE.format(count=3))
    return path


def as_text(value):
    """The cell of a value."""
    if value is None or isinstance(value, bool):
        return {None: "", True: "true", False: "false"}[value]
    return str(value)


def table(folder):
    return (folder / "table.csv").read_bytes()


def test_rows_are_functions_of_their_numbers(design, tmp_path, capsys):
    """The command's table, the rows that Ray asks for in another order, and those of Python are equal."""
    asked = ["study", str(design), "-o", str(tmp_path / "out"), "--device", "opencl"]
    assert main(asked) == 0
    said = capsys.readouterr()
    assert "3 cameras, 6 rows" in said.out and "all requirements:" in said.out
    rows = [*csv.DictReader((tmp_path / "out" / "table.csv").open())]
    made = gs.study(design, device="opencl")
    for row, other in zip(rows, made.rows, strict=True):
        for name, value in other.items():
            assert row[name] == as_text(value)
    numbers = np.array([5, 0, 3])
    batch = StudyRows(design, device="opencl")({"id": numbers})
    for name in ("mtf50", "snr", "de", "cpsnr", "optics.defocus_um"):
        np.testing.assert_array_equal(batch[name], made.column(name)[numbers])
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count("<svg") > 10 and "Clopper-Pearson" in page and "src=" not in page
    assert (tmp_path / "out" / "study.toml").read_text() == design.read_text()
    before = (tmp_path / "out" / "rows" / "000000000.jsonl").stat().st_mtime_ns
    assert main(asked) == 0  # nothing is computed again
    assert (tmp_path / "out" / "rows" / "000000000.jsonl").stat().st_mtime_ns == before
    design.write_text(FILE.format(count=4))
    assert main(asked) == 2
    assert "a run with other study" in capsys.readouterr().err


def test_measures_are_those_of_the_package(tmp_path):
    """SNR, CIEDE2000 and CPSNR by other means: the raw values' own statistics, and pictures of a Frame."""
    shots = {}
    one = {
        "camera": {"base": "machine-vision", "sensor.exposure_time_ms": 10},
        "sampling": {"method": "grid"},
        "vary": {"noise.read_e": {"grid": [2]}},
        "scenes": {
            "flat": {"scene": "flat", "size": [48, 32]},
            "leaves": {"scene": "deadleaves", "size": [48, 32]},
        },
        "measures": {"snr": "flat", "de": "leaves", "cpsnr": "leaves"},
    }

    def keep(shot: Shot) -> float:
        shots[shot.place.name] = shot.raw, shot.planes, shot.rendering, shot.camera
        return 1.0

    found = gs.study(one | {"measures": one["measures"] | {"keep": {"function": keep}}})
    flat, leaves = found.rows
    raw, _, _, camera = shots["flat"]
    patch = raw[8:24, 12:36].astype(float) - camera.sensor.black_level
    # 96 pixels a channel, with a lens that darkens them by less than the noise: within 1 dB
    ratios = {}
    for row, col in np.ndindex(2, 2):
        own = patch[row::2, col::2]
        ratios[own.mean()] = 20 * np.log10(own.mean() / own.std())
    assert flat["snr"] == pytest.approx(ratios[max(ratios)], abs=1)
    _, planes, rendering, camera = shots["leaves"]
    scene = gs.chart("deadleaves", size=(48, 32))
    true, matrix = ideal(scene, camera.display), camera.display.xyz_from_rgb
    shown = np.clip(np.moveaxis(planes, 0, -1).astype(float) / rendering.diffuser, 0, 1)

    def means(picture):
        return np.array(
            [
                [picture[r : r + 8, c : c + 8].mean(axis=(0, 1)) for c in range(0, 48, 8)]
                for r in range(0, 32, 8)
            ]
        )

    de = ciede2000(means(shown @ matrix.T), means(true), matrix.sum(1)).mean()
    assert leaves["de"] == pytest.approx(de, rel=1e-5)
    linear = np.clip(true @ np.linalg.inv(matrix).T, 0, 1)
    codes = (camera.display.encode(one) for one in (shown, linear))
    assert leaves["cpsnr"] == pytest.approx(cpsnr(*codes, border=10), abs=0.01)


def test_the_dynamic_range_is_what_photon_transfer_measures():
    """EMVA 1288 from raw frames of 50 levels against the formula: within 0.3 dB, as 40 x 40 pixels allow.

    The standard deviation of a variance of 2 x 1600 values is 2.5 %, 0.1 dB of dark noise, and saturation is a level of
    a grid of 2 %, 0.17 dB.
    """
    random, sensor = np.random.default_rng(1), gs.open_camera("mono").sensor
    gain, read = sensor.gain_dn_per_electron, sensor.read_sigma
    full, top = sensor.saturation, sensor.white_level

    def frames(electrons):
        light = random.poisson(electrons, (2, 40, 40)) + random.normal(0, read, (2, 40, 40))
        return np.clip(np.rint(np.minimum(light, full) * gain + sensor.black_level), 0, top)

    photons = np.linspace(0.02, 1.1, 55) * full
    measured = photon_transfer([frames(one) for one in photons], frames(0.0), photons)
    assert dynamic_range(sensor) == pytest.approx(measured.dynamic_range_db, abs=0.3)


def test_a_refused_camera_is_a_row_with_its_error(tmp_path):
    """The tail of a normal f-number is below 0.1; a measure that fails leaves the others."""

    def own(shot):
        return 1 / shot.seed

    made = gs.study(
        {
            "camera": "machine-vision",
            "sampling": {"method": "montecarlo", "count": 6, "seed": 4},
            "vary": {"optics.f_number": {"normal": [1, 1]}},
            "scenes": {"flat": {"scene": "flat", "size": [16, 16]}},
            "measures": {"dynamic_range": True, "own": {"function": own}},
            "requirements": {"wide": "dynamic_range > 10"},
        }
    )
    failed = made.column("optics.f_number") < 0.1
    assert 0 < failed.sum() < 6
    for row, is_refused in zip(made.rows, failed, strict=True):
        words = "optics.f_number = " if is_refused else "own: ZeroDivisionError: "
        assert row["error"].startswith(words) and "\n" not in row["error"]
        assert (row["dynamic_range"] is None) == is_refused and row["own"] is None
        assert row["wide"] == (not is_refused)
    whole = made.yields[-1]
    assert (whole.passed, whole.count) == (6 - failed.sum(), 6)


def test_plans_are_shared_by_cameras_of_one_lens(monkeypatch):
    from gpusim.pipeline.simulator import Simulator

    planned, plan = [], Simulator.plan
    monkeypatch.setattr(Simulator, "plan", lambda *asked: planned.append(1) or plan(*asked))
    own = {"sum": {"function": lambda shot: shot.raw.sum()}}
    made = gs.study(SMALL | {"measures": own})
    assert len(made.rows) == 4 and len(planned) == 2
    # as computed by a simulator of each camera
    for row in made.rows[1:3]:
        camera = gs.open_camera("machine-vision").with_(
            exposure_time_ms=10, read_e=row["noise.read_e"], f_number=row["optics.f_number"]
        )
        loop = gs.Simulator(camera).loop(gs.chart("flat", size=(48, 32)))
        raw = np.array(loop.simulator.device.numpy(loop.raw(seed=0, first=0)))
        assert row["sum"] == raw.sum()


@pytest.mark.slow
def test_shards_make_one_table(design, tmp_path, capsys):
    design.write_text(FILE.format(count=16))
    asked = ["study", str(design), "--device", "opencl", "--workers", "1", "-o"]
    for shard in ("1/2", "0/2"):
        assert main([*asked, str(tmp_path / "parts"), "--shard", shard]) == 0
    assert "of other shards" in capsys.readouterr().out
    assert main([*asked, str(tmp_path / "whole")]) == 0
    assert table(tmp_path / "parts") == table(tmp_path / "whole")
    capsys.readouterr()
    assert main([*asked, str(tmp_path / "whole"), "--shard", "0/9"]) == 2
    assert "up to 2 shards" in capsys.readouterr().err


@pytest.mark.slow  # pyarrow is imported
def test_a_parquet_table(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    made = gs.study(SMALL, tmp_path / "out", table="parquet")
    found = parquet.read_table(tmp_path / "out" / "table.parquet")
    assert found.column_names == made.columns and found["snr"].to_pylist() == [*made.column("snr")]


COMMAND = [sys.executable, "-m", "gpusim", "study"]


@pytest.mark.slow  # processes start
@pytest.mark.parametrize("device", ["opencl", "warp:cpu"])
def test_any_number_of_workers_gives_the_same_bytes(device, design, tmp_path):
    design.write_text(FILE.format(count=60))
    tables = {}
    for workers in (1, 2, 4):
        out = tmp_path / str(workers)
        asked = [str(design), "-o", str(out), "--device", device, "--workers", str(workers)]
        assert main(["study", *asked]) == 0
        tables[workers] = table(out), (out / "index.html").read_bytes()
    assert tables[1] == tables[2] == tables[4]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="there is no SIGKILL")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_run_goes_on(workers, design, tmp_path):
    """Three times killed at once with all of its processes; the table is that of one run."""
    design.write_text(FILE.format(count=60))
    out = tmp_path / "killed"
    asked = [*COMMAND, str(design), "--device", "opencl", "--workers", str(workers), "-o"]
    for count in (1, 2, 3):
        process = subprocess.Popen(
            [*asked, str(out)],
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        last = time.monotonic() + 240
        while len([*(out / "rows").glob("*.jsonl")]) < count and time.monotonic() < last:
            assert process.poll() is None
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert not (out / "table.csv").exists()
    subprocess.run([*asked, str(out)], check=True)
    subprocess.run([*asked, str(tmp_path / "whole")], check=True)
    assert table(out) == table(tmp_path / "whole")
    assert not [name for name in os.listdir(out / "rows") if name.startswith(".")]
