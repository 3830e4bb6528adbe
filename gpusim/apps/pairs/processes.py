"""Shards by several processes: Python computes in one thread at a time, so one process leaves cores idle.

Each process reads, computes and writes whole shards.
"""

import json
import multiprocessing
import os
import pickle
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from gpusim.apps.pairs.pairs import Pairs
from gpusim.apps.pairs.shards import write_shard
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import GpusimError

OFTEN = 0.2  # [s] between two messages of a process
PATIENCE = 20.0  # [s] in which a process ends its work after it was asked to
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


@dataclass(frozen=True)
class _Failure:
    """Error of a process. is_known: it is an error of a user's input."""

    words: str
    is_known: bool


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
    """Write shards by several processes.

    After an error the shards before the wrong one are completed; others in work are dropped.

    Args:
        starts: Functions that make the samples, one for each device. Processes take them in turn; each
            unpickles and calls its own.
        shards: Path and numbers of each shard.
        jobs: Number of processes.
        report: Function that is called with the progress of a process.

    Raises:
        GpusimError: A photograph or a file is wrong.
    """
    context, packed = multiprocessing.get_context("spawn"), [*map(pickle.dumps, starts)]
    threads = max(count_cores() // jobs, 1)
    processes: list[Any] = []
    connections: list[Connection] = []
    working: dict[Connection, int] = {}  # number of the shard
    waiting = iter(range(len(shards)))
    failed: tuple[int, _Failure] | None = None
    try:
        with _interrupts_held():
            for number in range(jobs):
                own, its = context.Pipe()
                process = context.Process(
                    target=_work, args=(its, packed[number % len(packed)], threads), daemon=True
                )
                process.start()
                processes.append(process)
                connections.append(own)
                its.close()
                working[own] = next(waiting)
                own.send(shards[working[own]])
        while working:
            for connection in wait([*working]):
                assert isinstance(connection, Connection)
                try:
                    news = connection.recv()
                except (EOFError, ConnectionError):
                    news = _Failure("a process of this command was killed", True)
                if isinstance(news, Progress):
                    report(news)
                    continue
                number = working.pop(connection)
                if isinstance(news, _Failure) and (failed is None or number < failed[0]):
                    failed = number, news
                following = next(waiting, None) if failed is None else None
                if following is not None:
                    working[connection] = following
                    connection.send(shards[following])
            if failed is not None:
                working = {own: number for own, number in working.items() if number < failed[0]}
        if failed is None:
            for connection in connections:
                connection.close()  # they end by themselves
            for process in processes:
                process.join(PATIENCE)
    finally:
        _end(processes)
    if failed is not None:
        raise (GpusimError if failed[1].is_known else RuntimeError)(failed[1].words)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes that are started in the block never get it, but SIGTERM."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(processes):
    """End processes. They remove their temporary files."""
    for process in processes:
        process.terminate()
    last = time.monotonic() + PATIENCE
    for process in processes:
        process.join(max(last - time.monotonic(), 0))
        if process.is_alive():
            process.kill()
            process.join()


def _work(connection: Connection, packed: bytes, threads: int):
    """Write the shards that another process sends, until it ends."""

    def stop(number, frame):
        raise KeyboardInterrupt  # removes temporary files

    signal.signal(signal.SIGTERM, stop)
    os.environ.setdefault("POCL_MAX_PTHREAD_COUNT", str(threads))  # read when a driver is loaded

    def tell(news):
        with suppress(OSError):  # the other process may have ended
            connection.send(news)

    try:
        made = pickle.loads(packed)()
        made.threads = threads
        while True:
            write_shards(made, [connection.recv()], tell)
            tell(None)
    except (EOFError, ConnectionError, KeyboardInterrupt):
        return  # the other process has ended, or ends this one
    except GpusimError as error:
        tell(_Failure(error.details, True))
    except MemoryError:
        tell(_Failure("out of memory", True))
    except Exception:
        tell(_Failure(traceback.format_exc(), False))


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
