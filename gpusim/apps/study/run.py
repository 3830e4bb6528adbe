"""Runs a study: rows by one or several processes, then table, summary and page."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.processes import share_work
from gpusim.apps.study.design import Design, open_design
from gpusim.apps.study.requirements import Yield
from gpusim.apps.study.rows import Rows
from gpusim.apps.study.sensitivity import Sensitivity, find_sensitivities, find_slopes
from gpusim.apps.study.store import (
    block_path,
    blocks_of,
    check_format,
    read_blocks,
    write_block,
    write_table,
)
from gpusim.apps.video.manifest import describe_run, keep_manifest
from gpusim.apps.video.segments import Shard
from gpusim.backends import Device
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import (
    BadData,
    Conflict,
    OutOfRange,
    UnknownName,
    checked_count,
    format_value,
)
from gpusim.io.atomic import atomic_path, check_output

WORTH = 96  # rows for which it is worth to start a process
CONTEXT = 2**29  # [byte] that a driver takes of a GPU's memory for each process
PAGE = "index.html"
MANIFEST = "study.json"
TABLE = "table"
Report = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Study:
    """A study that was run.

    Args:
        design: Its design.
        rows: Rows of its table, in their order.
        folder: Folder of its files, or None.
    """

    design: Design
    rows: list[dict[str, Any]] = field(repr=False)
    folder: Path | None = None

    def __repr__(self):
        return f"Study({self.design.name!r}, {len(self.rows)} of {len(self.design)} rows)"

    @property
    def columns(self) -> list[str]:
        """Names of the columns of the table."""
        return self.design.columns

    @property
    def missing(self) -> int:
        """Rows of other shards that are not there yet."""
        return len(self.design) - len(self.rows)

    def column(self, name: str) -> np.ndarray:
        """Return a column of the table.

        Args:
            name: Its name.

        Returns:
            Its values (N,): numbers, NaN without a value; texts and others as objects.

        Raises:
            UnknownName: There is no such column.
        """
        if name not in self.columns:
            raise UnknownName("column of the study", str(name), self.columns)
        values = [row[name] for row in self.rows]
        if all(one is None or isinstance(one, int | float) for one in values):
            return np.array([math.nan if one is None else one for one in values], float)
        return np.array(values, object)

    @cached_property
    def yields(self) -> list[Yield]:
        """The yield of each requirement, and of all together: the last. [] without requirements."""
        design, is_random = self.design, self.design.sampling.is_random
        if not design.requirements:
            return []
        passed: dict[int, dict[str, bool]] = {}
        for row in self.rows:
            own = passed.setdefault(row["camera"], {})
            for one in design.requirements:
                if row[one.name] is not None:
                    own[one.name] = own.get(one.name, True) and row[one.name]
        found = [
            Yield.of(
                one.name,
                one.words,
                sum(own.get(one.name, False) for own in passed.values()),
                len(passed),
                is_random,
            )
            for one in design.requirements
        ]
        names = [one.name for one in design.requirements]
        whole = sum(all(own.get(name, False) for name in names) for own in passed.values())
        return [*found, Yield.of("all", "all requirements", whole, len(passed), is_random)]

    @cached_property
    def sensitivities(self) -> list[Sensitivity]:
        """The effect of each varied key on each measure in each scene."""
        found = []
        for one in self.design.measures:
            for scene in one.scenes:
                rows = [row for row in self.rows if row["scene"] == scene]
                found += self._effects(one.name, scene, rows)
        return found

    @property
    def errors(self) -> list[tuple[int, str]]:
        """Number and error of the rows that have one."""
        return [(row["row"], row["error"]) for row in self.rows if row["error"]]

    def _effects(self, measure, scene, rows) -> list[Sensitivity]:
        keys = self.design.sampling.keys
        values = np.array([math.nan if row[measure] is None else row[measure] for row in rows])
        if self.design.sampling.method != "one-at-a-time":
            return find_sensitivities(
                measure, scene, {key: [row[key] for row in rows] for key in keys}, values
            )
        points: dict[str, list[tuple[float, float]]] = {
            key: [] for key, one in keys.items() if one.is_number
        }
        middle = self.design.sampling.draw(0)
        for row, value in zip(rows, values, strict=True):
            moved = [key for key in keys if row[key] != middle[key]]
            for key in points:
                if not moved or moved == [key]:
                    points[key].append((row[key], float(value)))
        return find_slopes(measure, scene, points)


def run_study(
    given: str | PathLike | Mapping[str, Any],
    out: str | PathLike | None = None,
    device: Any = "auto",
    workers: int | None = 1,
    shard: Any = (0, 1),
    table: str = "csv",
    show: Callable[[int, int], Any] | None = None,
) -> Study:
    """Return a study, see `gpusim.study`. show: starts a bar of rows in all and of those that are there."""
    design, part = open_design(given), _checked_shard(shard)
    check_format(table)
    workers = None if workers is None else checked_count("workers", workers, 1, 1024)
    rows = Rows(design, device)
    if out is None:
        if workers not in (None, 1) or part != Shard():
            raise Conflict("workers, shard", "they share a folder of results", "give out")
        return Study(design, [*_shown(rows.each(range(len(design))), len(design), show)])
    folder, blocks = Path(out), blocks_of(design)
    if part.count > len(blocks):
        raise OutOfRange(
            "shard",
            f"{part.number}/{part.count}",
            f"up to {len(blocks)} shards of {len(design)} rows",
        )
    blocks = part.of(blocks)
    check_output(folder / MANIFEST)
    missing = [block for block in blocks if not block_path(folder, block).exists()]
    if workers is None:
        workers = choose_workers(rows, sum(map(len, missing)))
    workers = max(min(workers, len(missing)), 1)
    if workers > 1 and (isinstance(given, Mapping) or isinstance(device, Device)):
        raise Conflict(
            "workers", "processes open the study file and the device themselves", "give their names"
        )

    def is_empty():
        return not any((folder / "rows").glob("*.jsonl"))

    with keep_manifest(folder / MANIFEST, _describe(rows), "the folder rows next to it", is_empty):
        there = sum(map(len, blocks)) - sum(map(len, missing))
        with show(sum(map(len, blocks)), there) if show else nullcontext() as bar:
            report = (lambda count: None) if bar is None else bar.update
            if workers > 1:
                start = partial(_open_worker, str(given), folder, device)
                share_work([start], missing, workers, report)
            else:
                for block in missing:
                    _write(rows, folder, block, report)
    made = Study(design, read_blocks(folder, design), folder)
    if not made.missing:
        write_results(made, table)
    return made


def write_results(made: Study, table: str) -> None:
    """Write the table, the study file and the page of a complete study to its folder. Raises BadFile."""
    from gpusim.apps.study.page import study_page

    assert made.folder is not None
    write_table(made.folder / f"{TABLE}.{table}", made.columns, made.rows)
    for name, text in (("study.toml", made.design.text), (PAGE, study_page(made))):
        if name == PAGE or made.design.is_file:
            with atomic_path(made.folder / name) as temporary:
                temporary.write_text(text, encoding="utf-8")


def choose_workers(rows: Rows, count: int) -> int:
    """Return the number of processes for this many rows."""
    device, cores = rows.simulator.device, count_cores()
    if device.kind == "numpy" or count < 2 * WORTH:
        return 1
    workers = min(cores, count // WORTH)
    if device.is_gpu:  # each has memory of its own there
        place = next(iter(rows.design.places.values()))
        each = 2 * rows.simulator.plan(place.scene).bytes_needed + CONTEXT
        workers = min(workers, device.memory // each)
    return max(workers, 1)


def _describe(rows) -> dict[str, Any]:
    """Return the manifest: everything that the table depends on."""
    design = rows.design
    files = [one.source for one in design.places.values() if one.source]
    return describe_run(rows.simulator, files, {}, study=design.text)


def _open_worker(given, folder, device, threads):
    """Return the function that computes a block in a process."""
    return partial(_write, Rows(open_design(given), device), folder)


def _write(rows, folder, block, report):
    """Compute and write a block. report: gets the number of new rows."""

    def told(found):
        for row in found:
            yield row
            report(1)

    with closing(rows.each(block)) as found:
        write_block(block_path(folder, block), told(found))


def _shown(rows, count, show) -> Iterator[dict[str, Any]]:
    """Yield rows and move the bar."""
    with show(count, 0) if show else nullcontext() as bar:
        for row in rows:
            yield row
            if bar is not None:
                bar.update(1)


def _checked_shard(given) -> Shard:
    """Return a shard of (number, count). Raises BadData, OutOfRange."""
    if isinstance(given, Shard):
        return given
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise BadData(f"shard = {format_value(given)}: wanted (number from 0, count)")
    number, count = checked_count("shard", given[0], 0), checked_count("shard", given[1], 1)
    if number >= count:
        raise OutOfRange("shard", f"{number}/{count}", "0 <= number < count")
    return Shard(number, count)
