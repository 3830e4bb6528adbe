"""Work shared by several processes: Python computes in one thread at a time, so one process leaves cores idle.

Each process does whole pieces of the work, and each piece depends on nothing but itself.
"""

import multiprocessing
import os
import pickle
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from gpusim.domain.cores import count_cores
from gpusim.domain.errors import GpusimError

PATIENCE = 20.0  # [s] in which a process ends its work after it was asked to
Worker = Callable[[Any, Callable[[Any], None]], None]


@dataclass(frozen=True)
class _Failure:
    """Error of a process. is_known: it is an error of a user's input."""

    words: str
    is_known: bool


def share_work(
    starts: Sequence[Callable[[int], Worker]],
    pieces: Sequence[Any],
    jobs: int,
    report: Callable[[Any], None],
) -> None:
    """Do pieces of work in several processes.

    After an error the pieces before the wrong one are completed; others in work are dropped.

    Args:
        starts: Functions from a number of threads to a worker, one for each device. Processes take them in turn;
            each unpickles and calls its own. A worker is a function of a piece and of a function that it tells its
            progress to.
        pieces: The pieces, which are sent to the processes.
        jobs: Number of processes.
        report: Function that is called with the progress of a process, which is not None.

    Raises:
        GpusimError: An input is wrong.
    """
    context, packed = multiprocessing.get_context("spawn"), [*map(pickle.dumps, starts)]
    threads = max(count_cores() // jobs, 1)
    processes: list[Any] = []
    connections: list[Connection] = []
    working: dict[Connection, int] = {}  # number of the piece
    waiting = iter(range(len(pieces)))
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
                own.send(pieces[working[own]])
        while working:
            for connection in wait([*working]):
                assert isinstance(connection, Connection)
                try:
                    news = connection.recv()
                except (EOFError, ConnectionError):
                    news = _Failure("a process of this command was killed", True)
                if news is not None and not isinstance(news, _Failure):
                    report(news)
                    continue
                number = working.pop(connection)
                if isinstance(news, _Failure) and (failed is None or number < failed[0]):
                    failed = number, news
                following = next(waiting, None) if failed is None else None
                if following is not None:
                    working[connection] = following
                    connection.send(pieces[following])
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
    """Do the pieces that another process sends, until it ends."""

    def stop(number, frame):
        raise KeyboardInterrupt  # removes temporary files

    signal.signal(signal.SIGTERM, stop)
    os.environ.setdefault("POCL_MAX_PTHREAD_COUNT", str(threads))  # read when a driver is loaded

    def tell(news):
        with suppress(OSError):  # the other process may have ended
            connection.send(news)

    try:
        work = pickle.loads(packed)(threads)
        while True:
            work(connection.recv(), tell)
            tell(None)
    except (EOFError, ConnectionError, KeyboardInterrupt):
        return  # the other process has ended, or ends this one
    except GpusimError as error:
        tell(_Failure(error.details, True))
    except MemoryError:
        tell(_Failure("out of memory", True))
    except Exception:
        tell(_Failure(traceback.format_exc(), False))
