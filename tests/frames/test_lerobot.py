"""Data sets of LeRobot: a reader that knows its layout alone finds the frames that other outputs of a run have."""

import json
import shutil
import sys
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from gpusim.apps.video import lerobot
from gpusim.cli.main import main

KEY = "observation.images.phone"
FPS = 10
FRAMES = 7
ASKED = ["--camera", "phone", "--device", "numpy", "--fps", str(FPS), "--segment", "3"]
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Photographs whose light grows, so that automatic exposure differs from frame to frame."""
    folder = tmp_path_factory.mktemp("pictures")
    random = np.random.default_rng(4)
    for number in range(FRAMES):
        picture = Image.fromarray(np.uint8(255 * random.random((4, 6, 3)) ** (3 - number / 4)))
        picture.resize((48, 32), Image.Resampling.BICUBIC).save(folder / f"in_{number}.png")
    return folder


@pytest.fixture(scope="module")
def of_two(pictures, tmp_path_factory):
    """A data set of an episode, and a copy to which a second one was added; what was asked for the second."""
    one, two = tmp_path_factory.mktemp("one") / "set", tmp_path_factory.mktemp("two") / "set"
    first = [
        "video",
        *map(str, sorted(pictures.iterdir())[:2]),
        *ASKED,
        "--exposure",
        "1/100",
        "--seed",
        "5",
    ]
    assert main([*first, "--lerobot", "look", "-o", str(one)]) == 0
    shutil.copytree(one, two)
    second = ["video", str(pictures), *ASKED, "--exposure", "auto", "--seed", "6"]
    assert main([*second, "--lerobot", "hold still", "-o", str(two)]) == 0
    return one, two, second


def read(folder):
    """Information, statistics, tasks, rows of episodes, rows of frames, and pictures of a data set.

    Paths and names as in lerobot 0.4.4, `datasets/utils.py` and `LeRobotDataset._query_videos`.
    """
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    tasks = {row["task_index"]: row["task"] for row in tasks.to_pylist()}
    episodes, rows = (
        [
            row
            for path in sorted((folder / name).glob("*/*.parquet"))
            for row in pq.read_table(path).to_pylist()
        ]
        for name in ("meta/episodes", "data")
    )
    episodes, rows = episodes[: info["total_episodes"]], rows[: info["total_frames"]]
    pictures = []
    for episode in episodes:
        place = {part: episode[f"videos/{KEY}/{part}"] for part in ("chunk_index", "file_index")}
        with av.open(str(folder / info["video_path"].format(video_key=KEY, **place))) as file:
            stream = file.streams.video[0]
            assert (stream.codec.canonical_name, stream.pix_fmt) == ("h264", "yuv420p")
            assert stream.average_rate == info["fps"]  # by which torchcodec finds a frame
            frames = list(file.decode(stream))
        own = [row for row in rows if row["episode_index"] == episode["episode_index"]]
        begin = episode[f"videos/{KEY}/from_timestamp"]
        assert (
            np.abs(
                [
                    row["timestamp"] + begin - frame.time
                    for row, frame in zip(own, frames, strict=True)
                ]
            ).max()
            < 1e-4
        )
        assert episode[f"videos/{KEY}/to_timestamp"] - begin == pytest.approx(
            len(own) / info["fps"]
        )
        place = {part: episode[f"data/{part}"] for part in ("chunk_index", "file_index")}
        assert pq.read_table(folder / info["data_path"].format(**place)).to_pylist() == own
        pictures += [frame.to_ndarray(format="rgb24") for frame in frames]
    return (
        info,
        json.loads((folder / "meta/stats.json").read_text()),
        tasks,
        episodes,
        rows,
        np.array(pictures),
    )


def test_counts_and_indices(of_two):
    info, _, tasks, episodes, rows, pictures = read(of_two[1])
    assert [info[name] for name in ("total_episodes", "total_frames", "total_tasks")] == [
        2,
        2 + FRAMES,
        2,
    ]
    assert (info["fps"], info["splits"]) == (FPS, {"train": "0:2"})
    assert len(rows) == len(pictures) == 2 + FRAMES
    assert [row["index"] for row in rows] == [*range(2 + FRAMES)]
    assert [row["frame_index"] for row in rows] == [*range(2), *range(FRAMES)]
    assert [
        (one["dataset_from_index"], one["dataset_to_index"], one["length"], one["tasks"])
        for one in episodes
    ] == [(0, 2, 2, ["look"]), (2, 2 + FRAMES, FRAMES, ["hold still"])]
    assert [tasks[row["task_index"]] for row in rows] == ["look"] * 2 + ["hold still"] * FRAMES
    assert [row["seed"] for row in rows] == [5] * 2 + [6] * FRAMES
    feature = info["features"].pop(KEY)
    assert (feature["dtype"], feature["shape"], feature["names"]) == (
        "video",
        [32, 48, 3],
        ["height", "width", "channels"],
    )
    assert tuple(feature["shape"]) == pictures.shape[1:]
    told = pq.read_schema(next(of_two[1].glob("data/*/file-001.parquet")))
    assert {name: one["dtype"] for name, one in info["features"].items()} == {
        name: {"float": "float32", "int64": "int64"}[str(told.field(name).type)]
        for name in told.names
    }


def test_frames_are_those_of_other_outputs(of_two, tmp_path, capsys):
    _, two, asked = of_two
    assert main([*asked, "-o", str(tmp_path / "a.npz")]) == 0
    worst = float(capsys.readouterr().out.split("worst predicted error ")[1].split()[0])
    assert main([*asked, "-o", str(tmp_path / "a.png")]) == 0
    _, _, _, episodes, rows, pictures = read(two)
    rows = rows[2:]
    times = [np.load(path)["exposure_time_s"] for path in sorted(tmp_path.glob("*.npz"))]
    assert len(set(map(float, times))) == FRAMES
    np.testing.assert_allclose([row["exposure_time_s"] for row in rows], times, rtol=1e-7)
    assert all(row["gain"] >= 1 for row in rows)
    assert max(row["predicted_rms"] for row in rows) == pytest.approx(
        worst, rel=0.06
    )  # of two digits
    codes = np.array([np.asarray(Image.open(path)) for path in sorted(tmp_path.glob("*.png"))])
    apart = np.abs(pictures[2:, None].astype(float) - codes).mean((2, 3, 4))
    assert (
        3 * apart.diagonal().max() < apart[~np.eye(FRAMES, dtype=bool)].min()
    )  # noise and chroma are lost
    light = codes / 255
    for which, value in (
        ("min", light.min((0, 1, 2))),
        ("max", light.max((0, 1, 2))),
        ("mean", light.mean((0, 1, 2))),
        ("std", light.std((0, 1, 2))),
        ("q50", np.median(light, axis=(0, 1, 2))),
    ):
        np.testing.assert_allclose(
            np.array(episodes[1][f"stats/{KEY}/{which}"])[:, 0, 0], value, atol=1e-9
        )


def test_statistics_are_those_of_the_tables(of_two):
    info, statistics, _, episodes, rows, _ = read(of_two[1])
    assert statistics.keys() == info["features"].keys()
    assert all(one.keys() == STATISTICS for one in statistics.values())
    for name in info["features"].keys() - {KEY}:
        values, one = np.array([row[name] for row in rows], float), statistics[name]
        assert one["count"] == [len(rows)]
        for which in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(
                one[which], [getattr(values, which)()], rtol=1e-5, atol=1e-12
            )
        for episode in episodes:
            own = values[episode["dataset_from_index"] : episode["dataset_to_index"]]
            assert episode[f"stats/{name}/q50"] == [np.sort(own)[(len(own) - 1) // 2]]
    means = [np.array(episode[f"stats/{KEY}/mean"]) * episode["length"] for episode in episodes]
    np.testing.assert_allclose(statistics[KEY]["mean"], sum(means) / len(rows))
    assert np.shape(statistics[KEY]["mean"]) == (3, 1, 1)


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize(
    ("failing", "at"), [("savez", 0), ("savez", 2), *(("replace", at) for at in range(6))]
)
def test_an_interrupted_run_leaves_the_data_set_and_goes_on(
    failing, at, of_two, tmp_path, monkeypatch, capsys
):
    one, two, asked = of_two
    folder = shutil.copytree(one, tmp_path / "set")
    module = {"savez": np, "replace": lerobot.os}[failing]
    true, calls = getattr(module, failing), []

    def fails(*arguments, **options):
        if (
            failing == "savez"
            or folder / "episode-000001.parts"
            == Path(arguments[0]).parent
            != Path(arguments[1]).parent
        ):
            calls.append(arguments)
            if len(calls) == at + 1:
                raise OSError(28, "No space left on device")
        return true(*arguments, **options)

    monkeypatch.setattr(module, failing, fails)
    assert main([*asked, "--lerobot", "hold still", "-o", str(folder)]) == 2
    assert "No space left" in capsys.readouterr().err
    monkeypatch.undo()
    before, after = read(one), read(folder)
    assert before[0] == after[0] and before[3:5] == after[3:5]
    assert np.array_equal(before[5], after[5])
    assert main([*asked, "--lerobot", "hold still", "-o", str(folder)]) == 0
    assert files(folder) == files(two)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--fps", "12"], "= 12: allowed is 10"),
        (["--fps", "29.97"], "a whole number"),
        (["--size", "64x48"], "48x64x3"),
        (["--camera", "machine-vision"], f"{KEY} none"),
        (["--seed", str(2**63)], "int64"),
        (["--shard", "0/2", "--segment", "1"], "--shard"),
        (["--codec", "h265"], "h264"),
    ],
)
def test_what_does_not_fit_is_refused(wrong, said, of_two, capsys):
    one, before = of_two[0], files(of_two[0])
    assert (
        main(
            [
                "video",
                "flat",
                *ASKED,
                "--size",
                "48x32",
                "--frames",
                "2",
                "--lerobot",
                "x",
                "-o",
                str(one),
                *wrong,
            ]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert files(one) == before


def test_another_version_is_refused(of_two, tmp_path, capsys):
    folder = shutil.copytree(of_two[0], tmp_path / "set")
    path = folder / "meta/info.json"
    path.write_text(path.read_text().replace("v3.0", "v2.1"))
    assert (
        main(["video", "flat", *ASKED, "--size", "48x32", "--lerobot", "x", "-o", str(folder)]) == 2
    )
    assert "v2.1; wanted v3.0" in capsys.readouterr().err


def test_without_pyarrow_the_extra_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert (
        main(
            [
                "video",
                "flat",
                *ASKED,
                "--size",
                "48x32",
                "--lerobot",
                "x",
                "-o",
                str(tmp_path / "set"),
            ]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert "pip install 'gpusim[lerobot]'" in error and error.count("\n") == 1
    assert not (tmp_path / "set").exists()


def test_pandas_has_tasks_as_index(of_two):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    tasks = pandas.read_parquet(of_two[1] / "meta/tasks.parquet")
    assert tasks.loc["hold still"].task_index == 1
