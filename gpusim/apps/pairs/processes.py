"""Shards by several processes. Each process reads, computes and writes whole shards."""

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from gpusim.apps.pairs.pairs import Pairs
from gpusim.apps.pairs.shards import write_shard
from gpusim.apps.processes import share_work

OFTEN = 0.2  # [s] between two messages of a process
Shards = Sequence[tuple[Path, range]]


@dataclass
class Progress:
    """Samples since the last message.

    Attributes:
        count: Number of samples.
        states: Number of samples for each state of a verdict.
        limit: Step that limits the rate.
    """

    count: int = 0
    states: Counter = field(default_factory=Counter)
    limit: str = ""


def write_shards(made: Pairs, shards: Shards, report: Callable[[Progress], None]) -> None:
    """Write shards, each a path and the numbers of its samples, in this process.

    The next shard is computed while one is written. Raises as `Pairs.files` and `write_shard` do.
    """
    numbers = (number for _, own in shards for number in own)
    with closing(made.files(numbers)) as samples:
        for path, own in shards:
            write_shard(path, _reported(samples, len(own), made, report))


def share_shards(
    starts: Sequence[Callable[[], Pairs]],
    shards: Shards,
    jobs: int,
    report: Callable[[Progress], None],
) -> None:
    """Write shards by several processes, see `share_work`.

    Args:
        starts: Functions that make the samples, one for each device.
        shards: Path and numbers of each shard.
        jobs: Number of processes.
        report: Function that is called with the progress of a process.

    Raises:
        GpusimError: A photograph or a file is wrong.
    """
    share_work([partial(_open_worker, start) for start in starts], shards, jobs, report)


def _open_worker(start, threads):
    """Return the function that writes a shard."""
    made = start()
    made.threads = threads
    return partial(_write, made)


def _write(made, shard, tell):
    write_shards(made, [shard], tell)


def _reported(samples, count, made, report):
    """Yield `count` samples, and report the progress from time to time."""
    progress, last = Progress(), time.monotonic()
    for number, (key, parts) in enumerate(samples, 1):
        verdict = json.loads(parts["json"]).get("verdict")
        yield key, parts
        progress.count += 1
        if verdict:
            progress.states[verdict["state"]] += 1
        if number == count or time.monotonic() - last > OFTEN:
            progress.limit = made.pace.limit
            report(progress)
            progress, last = Progress(), time.monotonic()
        if number == count:
            return
