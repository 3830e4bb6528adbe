"""Pairs for training: the same bytes whoever makes them, and raw values that scatter about what is called clean."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from devices import KINDS
from PIL import Image

import gpusim as gs
from gpusim.apps.pairs.pace import Pace
from gpusim.apps.pairs.pairs import Pairs
from gpusim.apps.pairs.shards import npy, write_shard
from gpusim.apps.pairs.variety import Variety, scene_options
from gpusim.cli.main import main
from gpusim.domain.account import SHOWN
from gpusim.io.scene.scenes import open_again


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    random = np.random.default_rng(3)
    for number, shape in enumerate([(30, 40), (30, 40), (26, 50), (30, 40), (20, 20)]):
        codes = np.uint8(255 * random.random((*shape, 3)))
        Image.fromarray(codes).resize(shape[::-1]).save(folder / f"p{number}.png")
    Image.fromarray(np.uint8(255 * random.random((24, 32)))).save(folder / "grey.png")
    return folder


def made(capsys, *arguments):
    assert main(["pairs", *map(str, arguments)]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def shards(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.tar")}


def samples(folder):
    """Key -> suffix -> bytes, in the order of the files."""
    found = {}
    for path in sorted(folder.glob("*.tar")):
        with tarfile.open(path) as file:
            for member in file:
                key, _, suffix = member.name.partition(".")
                found.setdefault(key, {})[suffix] = file.extractfile(member).read()
    return found


@pytest.mark.parametrize("device", [pytest.param("numpy", marks=pytest.mark.slow), *KINDS])
def test_any_number_of_workers_gives_the_same_bytes(device, photographs, tmp_path, capsys):
    asked = [
        photographs,
        "--camera",
        "phone",
        "--device",
        device,
        "--each",
        "2",
        "--in-shard",
        "3",
        "--pictures",
        "--vary",
        "exposure=1/500..1/20,iso=200..1600,light=D65|A,luminance=20..300",
        "--seed",
        "5",
    ]
    one, resumed = tmp_path / "one", tmp_path / "resumed"
    made(capsys, *asked, "-o", one)
    expected = shards(one)
    assert list(expected) and len(expected) == 4  # of 12 pairs
    for count in (2, 4):
        folder = tmp_path / f"of {count}"
        for number in reversed(range(count)):
            made(capsys, *asked, "-o", folder, "--shard", f"{number}/{count}")
        assert shards(folder) == expected
    made(capsys, *asked, "-o", resumed)
    (resumed / "000001.tar").unlink()
    (resumed / "000003.tar").unlink()
    assert "2 tar files were there" in made(capsys, *asked, "-o", resumed)
    assert shards(resumed) == expected


def test_samples_are_as_they_say(photographs, tmp_path, capsys):
    made(
        capsys,
        photographs,
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--each",
        "2",
        "--pictures",
        "-o",
        tmp_path / "a",
        "--vary",
        "exposure=1/500..1/20,iso=200..1600",
        "--tolerance",
        "video",
    )
    found = samples(tmp_path / "a")
    assert list(found) == [f"{number:08d}" for number in range(12)]
    times, speeds = [], []
    for number, sample in enumerate(found.values()):
        raw, clean = (np.load(io.BytesIO(sample[f"{name}.npy"])) for name in ("raw", "clean"))
        told, picture = json.loads(sample["json"]), Image.open(io.BytesIO(sample["rgb.png"]))
        assert raw.dtype == np.uint16 and clean.dtype == np.float32 and raw.shape == clean.shape
        assert (
            picture.size == raw.shape[::-1]
            and told["frame"] == number
            and told["verdict"]["state"] in SHOWN
        )
        assert 1 / 500 <= told["exposure"] <= 1 / 20 and told["exposure_time_s"] == told["exposure"]
        times.append(told["exposure"])
        speeds.append(told["iso"])
    assert len(set(times)) == len(set(speeds)) == 12
    # of one photograph, by hand: its light, and the same noise
    camera, told = gs.open_camera("phone"), json.loads(found["00000003"]["json"])
    scene = gs.open_scene(sorted(photographs.iterdir())[1])
    simulator = gs.Simulator(camera, device="numpy", tolerance="video")
    exposure = simulator.expose(scene, told["exposure"], told["gain"])
    raw = np.load(io.BytesIO(found["00000003"]["raw.npy"]))
    assert np.array_equal(raw, exposure.raw(seed=0, first=3))
    clean = np.load(io.BytesIO(found["00000003"]["clean.npy"]))
    assert np.allclose(
        clean, told["black_level"] + told["gain_dn_per_e"] * exposure.mean, rtol=1e-6
    )


def test_raw_values_scatter_about_the_clean_ones():
    """Without dark current, fixed pattern and clipping: by shot and read noise and rounding, in mean and variance."""
    camera = gs.open_camera("phone")
    noise = replace(camera.sensor.noise, dark_current=0.0, prnu=0.0, dsnu=0.0)
    camera = replace(camera, sensor=replace(camera.sensor, noise=noise, exposure_time=None))
    scene = gs.chart("flat", size=(64, 48))
    simulator = gs.Simulator(camera, device="numpy")
    seconds = simulator.expose(scene).exposure_time
    variety = Variety.parse(f"exposure={seconds / 20}..{seconds / 2}")
    found, count = [], 40
    pairs = Pairs(simulator, [Path("flat")], lambda *_: scene, variety, count, 7)
    for _, files in pairs.files(range(count)):
        raw, clean = (
            np.load(io.BytesIO(files[f"{name}.npy"])).astype(float) for name in ("raw", "clean")
        )
        told = json.loads(files["json"])
        gain = told["gain_dn_per_e"]
        variance = (
            gain * (clean - told["black_level"]) + (gain * told["read_noise_e"]) ** 2 + 1 / 12
        )
        found.append((raw - clean) / np.sqrt(variance))
    values = np.array(found)
    # the mean of n normal values is good to 1 / sqrt(n), their variance to sqrt(2 / n): five of these
    n = values.size
    assert abs(values.mean()) < 5 / np.sqrt(n) and abs(values.var() - 1) < 5 * np.sqrt(2 / n)
    flat = values.reshape(count, -1)
    assert np.abs(np.corrcoef(flat) - np.eye(count)).max() < 6 / np.sqrt(
        flat.shape[1]
    )  # pairs have noise of their own


def test_a_shard_has_the_bytes_that_tarfile_writes(tmp_path):
    random = np.random.default_rng(1)
    samples = [
        (f"{number:08d}", {"raw.npy": random.bytes(size), "json": b"{}", "empty": b""})
        for number, size in enumerate([0, 511, 512, 513, 2**21 + 7])
    ]
    write_shard(tmp_path / "own.tar", samples)
    with tarfile.open(tmp_path / "its.tar", "w", format=tarfile.USTAR_FORMAT) as file:
        for key, parts in samples:
            for suffix, data in parts.items():
                member = tarfile.TarInfo(f"{key}.{suffix}")
                member.size = len(data)
                file.addfile(member, io.BytesIO(data))
    assert (tmp_path / "own.tar").read_bytes() == (tmp_path / "its.tar").read_bytes()


@pytest.mark.parametrize(
    "array", [np.arange(6, dtype=np.uint16).reshape(2, 3).T, np.zeros((0, 3)), np.ones(5, bool)]
)
def test_arrays_have_the_bytes_that_numpy_writes(array):
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array))
    assert npy(array) == file.getvalue()


@pytest.mark.parametrize(
    "vary", ["exposure=1/500..1/20,iso=200..1600", "light=D65|A|FL11,luminance=20..300"]
)
def test_a_photograph_is_read_once(vary, photographs):
    """Also in several lights, of which each is as if the file was opened in it."""
    paths, seen, variety = sorted(photographs.iterdir()), [], Variety.parse(vary)

    def opened(path, values):
        seen.append(path)
        assert not scene_options(values)
        return gs.open_scene(path)

    def relit(path, scene, values):
        found, expected = (
            open_again(path, scene, **scene_options(values)),
            gs.open_scene(path, **scene_options(values)),
        )
        assert np.array_equal(found.illuminant.values, expected.illuminant.values)
        assert np.array_equal(found.content.planes, expected.content.planes)
        return found

    simulator = gs.Simulator(gs.open_camera("phone"), device="numpy")
    pairs = Pairs(simulator, paths, opened, variety, 7, relit=relit)
    assert [key for key, _ in pairs.files(range(len(pairs)))] == [
        f"{n:08d}" for n in range(7 * len(paths))
    ]
    assert seen == paths


@pytest.mark.parametrize("vary", ["luminance=2..900", "exposure=1/500..1/20,luminance=2..900"])
def test_a_drawn_luminance_is_that_of_a_scene_opened_with_it(vary, photographs, tmp_path, capsys):
    """Light, exposure and predicted errors, by a plan for the most light that may be drawn."""
    asked = ["--camera", "phone", "--device", "opencl", "--tolerance", "video", "--each", 4]
    made(capsys, sorted(photographs.iterdir())[1], *asked, "--vary", vary, "-o", tmp_path / "a")
    simulator = gs.Simulator(gs.open_camera("phone"), device="opencl", tolerance="video")
    for number, sample in enumerate(samples(tmp_path / "a").values()):
        told = json.loads(sample["json"])
        scene = gs.open_scene(sorted(photographs.iterdir())[1], luminance=told["luminance"])
        most = 1 / 20 if "exposure" in told else None
        plan = simulator.plan(scene, exposure_time=most, brightness=900 / told["luminance"])
        exposure = simulator.expose(scene, told.get("exposure"), plan=plan)
        assert told["exposure_time_s"] == pytest.approx(exposure.exposure_time, rel=2e-6)
        clean, raw = (np.load(io.BytesIO(sample[f"{name}.npy"])) for name in ("clean", "raw"))
        expected = told["black_level"] + told["gain_dn_per_e"] * np.asarray(exposure.mean)
        # two transforms of other light, each 2.5e-7 RMS (TRANSFORM_ERROR), four times that in the worst pixel
        assert np.abs(clean - expected).max() < 2e-6 * np.sqrt(np.mean(expected**2))
        # a rounded value changes where noise and mean are within 2e-6 of a step: seldom
        assert np.mean(raw != np.asarray(exposure.raw(first=number))) < 0.01
        account = plan.account.at(exposure.exposure_time)
        assert told["predicted_rms"] == pytest.approx(account.total.rms, rel=1e-5)
        verdict = account.verdict(simulator.tolerance).as_dict()
        assert told["verdict"] == json.loads(json.dumps(verdict))


@pytest.mark.parametrize(
    "options", [{"light": "A"}, {"luminance": 30.0}, {"light": "FL11", "luminance": 250.0}]
)
def test_a_scene_with_its_own_light_in_another(options, tmp_path):
    cube = np.random.default_rng(4).random((4, 6, 8)).astype(np.float32)
    gs.save_scene(
        gs.scene_from(cube, [450, 500, 600, 700], light="A", luminance=60.0), tmp_path / "own.npz"
    )
    found = open_again(tmp_path, gs.open_scene(tmp_path / "own.npz"), **options)
    expected = gs.open_scene(tmp_path / "own.npz", **options)
    assert np.array_equal(found.illuminant.values, expected.illuminant.values)


@pytest.fixture
def damaged(photographs, tmp_path):
    """The photographs of which the fourth is cut, and its whole bytes."""
    folder = tmp_path / "damaged"
    shutil.copytree(photographs, folder)
    cut = sorted(folder.iterdir())[3]
    whole = cut.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    return folder, cut, whole


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_damaged_photograph_ends_the_run_after_the_shards_before_it(
    jobs, damaged, photographs, tmp_path, capsys
):
    folder, cut, whole = damaged
    asked = [
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--each",
        "2",
        "--in-shard",
        "2",
        "--jobs",
        jobs,
    ]
    made(capsys, photographs, *asked, "-o", tmp_path / "whole")
    expected, out = shards(tmp_path / "whole"), tmp_path / "out"
    assert main(["pairs", *map(str, [folder, *asked, "-o", out])]) == 2
    error = capsys.readouterr().err
    assert cut.name in error and error.count("\n") == 1, error
    found = shards(out)
    assert sorted(found) == [f"{number:06d}.tar" for number in range(3)]
    assert all(expected[name] == data for name, data in found.items())
    assert not [name for name in os.listdir(out) if name.startswith(".")]
    cut.write_bytes(whole)
    (out / "pairs.json").unlink()  # of other bytes
    made(capsys, folder, *asked, "-o", out)
    assert shards(out) == expected


@pytest.mark.slow  # processes start
@pytest.mark.parametrize("device", KINDS)
def test_several_processes_write_the_same_bytes(device, photographs, tmp_path, capsys):
    asked = [photographs, "--camera", "phone", "--device", device, "--each", "3", "--in-shard", "4"]
    asked += ["--pictures", "--vary", "exposure=1/500..1/20,light=D65|A", "--tolerance", "video"]
    for jobs in (1, 3):
        made(capsys, *asked, "-o", tmp_path / str(jobs), "--jobs", jobs)
    assert shards(tmp_path / "3") == shards(tmp_path / "1")


COMMAND = [
    sys.executable,
    "-c",
    "import sys; from gpusim.__main__ import start; sys.exit(start())",
    "pairs",
]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="there are no process groups")
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_run_leaves_whole_shards(jobs, photographs, tmp_path):
    asked = [photographs, "--camera", "phone", "--device", "numpy", "--each", 40, "--in-shard", 12]
    asked = [*COMMAND, *map(str, [*asked, "--jobs", jobs, "-o", tmp_path / "out"])]
    process = subprocess.Popen(
        asked, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    last = time.monotonic() + 120
    while not list((tmp_path / "out").glob("0*.tar")) and time.monotonic() < last:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all processes
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2 and error == "gpusim: interrupted\n"
    left = os.listdir(tmp_path / "out")
    assert "000000.tar" in left or jobs > 1
    assert len(left) < 21 and not [name for name in left if name.startswith(".")]
    for name in left:
        if name.endswith(".tar"):
            with tarfile.open(tmp_path / "out" / name) as file:
                assert len(file.getnames()) == 36


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="there are no limits of file sizes")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_disk_that_is_full_is_said_in_a_line(jobs, photographs, tmp_path):
    """Here: a limit of the size of files, which fails a write likewise."""
    import resource

    asked = [photographs, "--camera", "phone", "--device", "numpy", "--each", 40, "--in-shard", 120]
    done = subprocess.run(
        [*COMMAND, *map(str, [*asked, "--jobs", jobs, "-o", tmp_path / "out"])],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (2**19, 2**19)),
    )
    assert (
        done.returncode == 2 and done.stderr.count("\n") == 1 and "cannot be written" in done.stderr
    )
    assert os.listdir(tmp_path / "out") == []


def test_the_pace_names_the_step_that_others_wait_for():
    def pace(**spent):
        found = Pace()
        for step, seconds in spent.items():
            with found.during(step):
                time.sleep(seconds)
        return found.limit

    assert Pace().limit == ""
    assert pace(reading=0.2, computing=0.02, waiting=0.02) == "reading"
    assert pace(reading=0.02, computing=0.2, waiting=0.02, writing=0.3) == "computing"
    assert pace(computing=0.02, waiting=0.2, encoding=0.02, writing=0.1) == "writing"
    assert pace(computing=0.02, waiting=0.2, encoding=0.1, writing=0.02) == "encoding"


@pytest.mark.parametrize(
    "text",
    [
        "exposure=1/20..1/200",
        "iso=0..5",
        "iso",
        "gain=1..2",
        "iso=1..2,iso=3..4",
        "light=",
        "light=A||D65",
        "exposure=soon",
        "iso=nan..5",
    ],
)
def test_a_variety_that_cannot_be_is_refused(text, capsys):
    with pytest.raises(SystemExit) as status:
        main(["pairs", "a.png", "--camera", "phone", "-o", "out", "--vary", text])
    assert status.value.code == 2 and capsys.readouterr().err.count("\n") == 1


def test_a_variety_is_even_in_the_logarithm():
    variety = Variety.parse("exposure=1ms..100ms,light=A|D65|FL11")
    drawn = [variety.draw(3, number) for number in range(3000)]
    place = np.log10([one["exposure"] / 1e-3 for one in drawn]) / 2
    assert 0 <= place.min() and place.max() <= 1
    assert abs(place.mean() - 0.5) < 5 / np.sqrt(12 * 3000) and abs(place.var() - 1 / 12) < 0.01
    assert {one["light"] for one in drawn} == {"A", "D65", "FL11"}
    assert drawn[7] == variety.draw(3, 7) != variety.draw(4, 7)


def test_what_is_wrong_is_said_in_a_line(photographs, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for words, arguments in {
        "no scene files": [tmp_path / "empty"],
        "no such file": [tmp_path / "none.png"],
        "--iso: --vary iso draws it for each pair": [
            photographs,
            "--iso",
            "200",
            "--vary",
            "iso=100..200",
        ],
        "base speed": [photographs, "--vary", "iso=1..200"],
        "automatic exposure": [photographs, "--exposure", "auto", "--vary", "iso=200..400"],
        "smaller --in-shard": [photographs, "--in-shard", "3", "--shard", "0/3"],
        "unknown light": [photographs, "--vary", "light=D65|foo"],
    }.items():
        assert (
            main(
                [
                    "pairs",
                    *map(str, arguments),
                    "--camera",
                    "phone",
                    "--device",
                    "numpy",
                    "-o",
                    str(tmp_path / "out"),
                ]
            )
            == 2
        )
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1, error
        assert not list(tmp_path.rglob("*.tar")) and not list(tmp_path.rglob("*.json"))
    assert (
        main(
            [
                "pairs",
                str(photographs),
                "--camera",
                "phone",
                "--device",
                "numpy",
                "-o",
                str(photographs),
            ]
        )
        == 2
    )
    assert "another folder" in capsys.readouterr().err
    made(capsys, photographs, "--camera", "phone", "--device", "numpy", "-o", tmp_path / "done")
    assert (
        main(
            [
                "pairs",
                str(photographs),
                "--camera",
                "phone",
                "--device",
                "numpy",
                "-o",
                str(tmp_path / "done"),
                "--seed",
                "1",
            ]
        )
        == 2
    )
    assert "other seed" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="there is no SIGKILL")
def test_a_run_that_was_killed_leaves_nothing_behind(photographs, tmp_path):
    """16 runs that end at any time: the next one makes the same bytes, and there is nothing else."""
    code = "import sys; from gpusim.__main__ import start; sys.exit(start())"
    command = [
        sys.executable,
        "-c",
        code,
        "pairs",
        *map(
            str,
            (
                photographs,
                "--camera",
                "phone",
                "--device",
                "numpy",
                "--each",
                5,
                "--in-shard",
                6,
                "--pictures",
                "-o",
            ),
        ),
    ]

    def run(folder):
        assert subprocess.run([*command, folder], capture_output=True).returncode == 0
        return {name: (folder / name).read_bytes() for name in os.listdir(folder)}

    begun = time.monotonic()
    expected = run(tmp_path / "whole")
    took, random, left = time.monotonic() - begun, np.random.default_rng(5), 0
    for number in range(16):
        folder = tmp_path / str(number)
        process = subprocess.Popen(
            [*command, folder], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(took * random.uniform(0.3, 1))
        process.kill()
        process.wait()
        left += folder.exists() and any(name.startswith(".") for name in os.listdir(folder))
        assert run(folder) == expected
    print(f"{left} of 16 left a temporary file to the next run")
