"""Episodes of a LeRobot data set: each is a video and a table of data on its frames.

The layout is version 3.0, after Hugging Face's lerobot 0.4.4 (`datasets/utils.py`,
`lerobot_dataset.py`, `compute_stats.py`). Every episode has its own files, as episodes that LeRobot
adds to an existing data set.
"""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.video.codecs import Encoder
from gpusim.apps.video.video import EncodedFile
from gpusim.domain.errors import BadFile, GpusimError, OutOfRange
from gpusim.io.atomic import atomic_path
from gpusim.io.files import read_text, reading

VERSION = "v3.0"
INFO, STATISTICS, TASKS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
EPISODES = f"meta/episodes/{FILE}.parquet"
NEW = {
    "codebase_version": VERSION,
    "robot_type": None,
    "chunks_size": 1000,
    "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200,
    "data_path": f"data/{FILE}.parquet",
    "video_path": f"videos/{{video_key}}/{FILE}.mp4",
}
COLUMNS = {  # of a frame
    "exposure_time_s": "float32",
    "gain": "float32",
    "predicted_rms": "float32",
    "seed": "int64",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
QUANTILES = 0.01, 0.1, 0.5, 0.9, 0.99
CODES = 256


def pyarrow():
    """Return the package with its Parquet module. Raises GpusimError if it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        why = f"LeRobot data sets need pyarrow ({error}); pip install 'gpusim[lerobot]'"
        raise GpusimError(why) from error
    return pyarrow


class Episode(EncodedFile):
    """A new episode of the data set in a folder.

    The table has `exposure_time_s` [s], analog `gain`, `predicted_rms` (relative) and `seed` of
    each frame in addition to LeRobot's columns.

    Args:
        folder: Folder of the data set.
        task: Task that the episode shows, in words.
        camera: Name of the camera; the pictures are "observation.images.<camera>".
        seed: Seed of the noise.
        encoder: Encoder of the segments, h264.
        segments: All segments.

    Raises:
        OutOfRange: If the rate is not a whole number, the seed is not an int64, or rate, size or
            features differ from earlier episodes.
        BadFile: If the folder has another version, or is damaged.
        GpusimError: If pyarrow is not installed.
    """

    def __init__(
        self,
        folder: Path,
        task: str,
        camera: str,
        seed: int,
        encoder: Encoder,
        segments: list[range],
    ):
        pyarrow()
        rate = encoder.rate
        if rate.denominator != 1:
            raise OutOfRange("--fps of a LeRobot data set", f"{float(rate):g}", "a whole number")
        if seed >= 2**63:
            raise OutOfRange("--seed of a LeRobot data set", seed, "0 .. 2^63 - 1, an int64")
        self._root, self._task, self._rate, self._seed = folder, task, int(rate), seed
        self._key = f"observation.images.{re.sub('[^A-Za-z0-9_-]+', '_', camera)}"
        self._features = _features(self._key, encoder.shape, self._rate)
        self._info, self._before = self._read()
        self.number = len(self._before)
        super().__init__(folder / f"episode-{self.number:06d}", encoder, segments)

    def _read(self):
        """Return the information on the data set, and a row for each of its episodes."""
        path = self._root / INFO
        if not path.exists():
            return NEW, []
        with reading(path, "the information on a LeRobot data set"):
            info = json.loads(read_text(path, "JSON"))
            version = info["codebase_version"]
            if version != VERSION:
                raise BadFile(path, f"is of LeRobot's version {version}; wanted {VERSION}")
            there = {name: _kind(feature) for name, feature in info["features"].items()}
            if info["fps"] != self._rate:
                raise OutOfRange(
                    f"--fps of an episode in {self._root}",
                    self._rate,
                    f"{info['fps']}, as the others",
                )
        here = {name: _kind(feature) for name, feature in self._features.items()}
        others = sorted(
            name for name in here.keys() | there.keys() if here.get(name) != there.get(name)
        )
        if others:
            ours = ", ".join(f"{name} {here.get(name, 'none')}" for name in others)
            theirs = ", ".join(f"{name} {there.get(name, 'none')}" for name in others)
            raise OutOfRange(
                f"features of an episode in {self._root}",
                ours,
                f"the features of the others, {theirs}",
            )
        tables = sorted(self._root.glob("meta/episodes/*/*.parquet"))
        with reading(self._root / "meta/episodes", "tables of episodes"):
            rows = [row for table in tables for row in _read_rows(table, "episode_index")]
            # a run that ended between two files leaves a row that the information does not count
            rows = [row for row in rows if row["episode_index"] < info["total_episodes"]]
            return info, sorted(rows, key=lambda row: row["episode_index"])

    @property
    def result(self) -> str:
        """The finished output, for messages."""
        return f"{self._root}: episode {self.number}"

    @property
    def folders(self) -> tuple[Path, ...]:
        """See `EncodedFile`."""
        return self._root, self.folder

    def _encode(self, segment, computed):
        """Encode a segment, store data on its frames next to it, and yield each frame."""
        known, counts = [], np.zeros((3, CODES), np.int64)

        def note_data():
            for one in computed:
                known.append((one.exposure_time, one.gain, one.account.total.rms))
                for count, plane in zip(counts, np.moveaxis(one.values, -1, 0), strict=True):
                    count += np.bincount(plane.ravel(), minlength=CODES)
                yield one

        for one in super()._encode(segment, note_data()):
            if one.number == segment[-1]:  # before the segment's file, which marks it as complete
                with atomic_path(self._notes(segment)) as temporary:
                    np.savez(temporary, known=known, counts=counts)
            yield one

    def _notes(self, segment):
        return self.part(segment).with_suffix(".npz")

    def finish(self) -> bool:
        """Add the episode to the data set if all segments exist. Return whether they do.

        All files are complete before the first one gets its name; the file that lists them comes
        last. Raises BadFile.
        """
        if not self._is_complete():
            return False
        last: dict[str, Any] = self._before[-1] if self._before else {}
        info = self._info
        videos = f"videos/{self._key}"
        places = {
            name: _following(last, name, info["chunks_size"])
            for name in ("data", videos, "meta/episodes")
        }
        data, video, episodes = places.values()
        tasks = self._tasks()
        table, statistics, length = self._table(tasks.index(self._task))
        begin = last.get("dataset_to_index", 0)
        row: dict[str, Any] = {
            "episode_index": self.number,
            "tasks": [self._task],
            "length": length,
            "dataset_from_index": begin,
            "dataset_to_index": begin + length,
        }
        for name, (chunk, file) in places.items():
            row[f"{name}/chunk_index"] = chunk
            row[f"{name}/file_index"] = file
        row[f"{videos}/from_timestamp"] = 0.0
        row[f"{videos}/to_timestamp"] = length / self._rate
        whole = {}
        for name, own in statistics.items():
            for which, value in own.items():
                row[f"stats/{name}/{which}"] = value
            earlier = [
                {which: before[f"stats/{name}/{which}"] for which in own} for before in self._before
            ]
            whole[name] = _together([*earlier, own])
        info = info | {
            "fps": self._rate,
            "features": info.get("features", self._features),
            "total_episodes": self.number + 1,
            "total_frames": begin + length,
            "total_tasks": len(tasks),
            "splits": {"train": f"0:{self.number + 1}"},
        }
        arrow = pyarrow()
        written = [
            (_path(info["video_path"], video, video_key=self._key), self._join),
            (_path(info["data_path"], data), table),
            (TASKS, _task_table(tasks)),
            (_path(EPISODES, episodes), arrow.Table.from_pylist([row])),
            (STATISTICS, whole),
            (INFO, info),
        ]
        staged = []
        for number, (name, content) in enumerate(written):
            path = self.folder / f"{number}{Path(name).suffix}"
            with atomic_path(path) as temporary:
                if callable(content):
                    content(temporary)
                elif isinstance(content, dict):
                    temporary.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
                else:
                    arrow.parquet.write_table(content, temporary)
            staged.append((path, self._root / name))
        try:
            for path, final in staged:
                final.parent.mkdir(parents=True, exist_ok=True)
                os.replace(path, final)
        except OSError as error:
            raise BadFile(final, f"cannot be written: {error.strerror or error}") from error
        self._remove_segments()
        return True

    def _tasks(self):
        """Return all tasks in the order of their numbers, including this one."""
        path = self._root / TASKS
        if not self._before:
            return [self._task]
        with reading(path, "a table of tasks"):
            rows = _read_rows(path, "task_index")
            found = [
                next(value for name, value in row.items() if name != "task_index") for row in rows
            ]
        return found if self._task in found else [*found, self._task]

    def _table(self, task):
        """Return the table of the frames, statistics of each feature, and the number of frames."""
        notes = []
        for segment in self._segments:
            path = self._notes(segment)
            with reading(path, "data on frames"), np.load(path) as file:
                notes.append((file["known"], file["counts"]))
        known = np.concatenate([one for one, _ in notes])
        frames = np.arange(len(known))
        begin = self._before[-1]["dataset_to_index"] if self._before else 0
        values = [
            *known.T,
            self._seed,
            frames / self._rate,
            frames,
            self.number,
            begin + frames,
            task,
        ]
        columns = {
            name: np.broadcast_to(one, frames.shape).astype(kind)
            for (name, kind), one in zip(COLUMNS.items(), values, strict=True)
        }
        statistics: dict[str, dict[str, list]] = {}
        for name, one in columns.items():
            found = _statistics(one, np.ones(len(one)))
            statistics[name] = {which: [value] for which, value in found.items()}
        codes = np.arange(CODES) / (CODES - 1)
        channels = [_statistics(codes, count) for count in sum(one for _, one in notes)]
        statistics[self._key] = {
            which: [[[one[which]]] for one in channels] for which in channels[0]
        }
        for one in statistics.values():
            one["count"] = [len(known)]
        return pyarrow().table(columns), statistics, len(known)


def _features(key, shape, rate):
    rows, cols = shape
    info = {
        "video.height": rows,
        "video.width": cols,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": rate,
        "video.channels": 3,
        "has_audio": False,
    }
    names = ["height", "width", "channels"]
    video = {"dtype": "video", "shape": [rows, cols, 3], "names": names, "info": info}
    return {key: video} | {
        name: {"dtype": kind, "shape": [1], "names": None} for name, kind in COLUMNS.items()
    }


def _read_rows(path, index):
    """Return the rows of a table in the order of a column."""
    rows = pyarrow().parquet.read_table(path).to_pylist()
    return sorted(rows, key=lambda row: row[index])


def _kind(feature):
    """Return type and shape of a feature, for example "video 480x640x3"."""
    return f"{feature['dtype']} {'x'.join(map(str, feature['shape']))}"


def _following(last, name, size):
    """Return the next numbers of chunk and file after an episode's row. size: files per chunk."""
    if not last:
        return 0, 0
    return divmod(last[f"{name}/chunk_index"] * size + last[f"{name}/file_index"] + 1, size)


def _path(template, place, **others):
    return template.format(chunk_index=place[0], file_index=place[1], **others)


def _statistics(values, weights):
    """Return weighted statistics of values (n,)."""
    there, mean = values[weights > 0], np.average(values, weights=weights)
    quantiles = np.quantile(values.astype(float), QUANTILES, weights=weights, method="inverted_cdf")
    found = {
        "min": there.min().item(),
        "max": there.max().item(),
        "mean": float(mean),
        "std": float(np.sqrt(np.average((values - mean) ** 2, weights=weights))),
    }
    for part, value in zip(QUANTILES, quantiles, strict=True):
        found[f"q{round(100 * part):02d}"] = float(value)
    return found


def _together(parts):
    """Return the statistics of all episodes; quantiles are averaged by count, as in LeRobot."""
    of = {which: np.array([part[which] for part in parts]) for which in parts[-1]}
    count = of.pop("count")

    def average(values):
        return np.average(values, axis=0, weights=count[:, 0])

    mean = average(of["mean"])
    found = {which: average(values) for which, values in of.items()}
    found["min"] = of["min"].min(0)
    found["max"] = of["max"].max(0)
    found["count"] = count.sum(0)
    found["std"] = np.sqrt(average(of["std"] ** 2 + (of["mean"] - mean) ** 2))
    return {which: value.tolist() for which, value in found.items()}


def _task_table(tasks):
    """Return the table of tasks. Its metadata declare them as the index of a pandas table."""
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": numpy,
            "metadata": None,
        }
        for name, kind, numpy in (
            ("task_index", "int64", "int64"),
            ("task", "unicode", "object"),
        )
    ]
    metadata = {
        "index_columns": ["task"],
        "column_indexes": [],
        "pandas_version": "2.0.0",
        "columns": columns,
    }
    table = pyarrow().table({"task_index": range(len(tasks)), "task": tasks})
    return table.replace_schema_metadata({"pandas": json.dumps(metadata)})
