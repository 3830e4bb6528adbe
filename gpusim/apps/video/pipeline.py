"""Concurrent steps of a loop: each runs in its own thread, a few items ahead of the next step."""

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from queue import Empty, Full, Queue
from threading import Event, Lock, Thread
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")
WAIT = 0.1  # [s] between two checks of a waiting thread whether it should end


class Clock:
    """Seconds that the parts of a pipeline take, by name, from any thread."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._lock = Lock()

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Add the time of the block to a part."""
        start = time.perf_counter()
        try:
            yield
        finally:
            with self._lock:
                self.seconds[name] += time.perf_counter() - start  # type: ignore[assignment]

    def each(self, name: str, items: Iterable[T]) -> Generator[T, None, None]:
        """Yield the items; the time until each one comes belongs to a part."""
        iterator = iter(items)
        try:
            while True:
                with self.of(name):
                    try:
                        item = next(iterator)
                    except StopIteration:
                        return
                yield item
        finally:
            if isinstance(iterator, Generator):
                iterator.close()


def ahead(items: Iterable[T], count: int) -> Generator[T, None, None]:
    """Yield the items, computed by a thread up to `count` items ahead. Errors are raised here.

    When this generator is closed, the thread ends after its current item.
    """
    queue: Queue = Queue(count)
    over = Event()

    def put(item, error):
        while not over.is_set():
            try:
                queue.put((item, error), timeout=WAIT)
                return
            except Full:
                continue

    def work():
        try:
            for item in items:
                put(item, None)
                if over.is_set():
                    return
            put(None, StopIteration())
        except BaseException as error:  # handed to the caller
            put(None, error)
        finally:
            if isinstance(items, Generator):
                items.close()

    thread = Thread(target=work, daemon=True)
    thread.start()
    try:
        while True:
            try:
                item, error = queue.get(timeout=WAIT)  # interrupts arrive between two waits
            except Empty:
                continue
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield item
    finally:
        over.set()
        thread.join()


def in_pool(items: Iterable[T], work: Callable[[T], Any], workers: int) -> Generator[T, None, None]:
    """Yield the items, nearly in order, after `work(item)` was done by one of `workers` threads.

    At most twice as many items wait or are worked on. If an item fails, those that were begun are
    finished.
    """
    with ThreadPoolExecutor(workers) as pool:
        begun: dict[Future, T] = {}

        def finish(tasks):
            for task in [task for task in begun if task in tasks]:
                item = begun.pop(task)
                task.result()  # raises the error of the task
                yield item

        for item in items:
            begun[pool.submit(work, item)] = item
            is_full = len(begun) >= 2 * workers
            yield from finish(wait(begun, None if is_full else 0, FIRST_COMPLETED).done)
        yield from finish(wait(begun).done)


class _Abandoned(Exception):
    """The items of a group end early, because the whole work does."""


def in_groups(
    items: Iterator[T],
    sizes: Sequence[int],
    work: Callable[[int, Iterator[T]], Iterable[R]],
    *,
    workers: int,
    held: int,
) -> Generator[R, None, None]:
    """Yield the results of groups of items. Each group is worked on by its own thread.

    If the items raise an error, the groups before it are finished first. If a group does, or if this
    generator is closed, all others are abandoned: an exception ends their work.

    Args:
        items: Items of all groups.
        sizes: Number of items of each group.
        work: Function from the number of a group and its items to one result an item.
        workers: Most groups at a time.
        held: Most items that wait or are worked on.
    """
    results: Queue = Queue()
    over, threads, count = Event(), [], Counter[str]()

    def arrive(queue):
        while not over.is_set():
            try:
                kind, item = queue.get(timeout=WAIT)
            except Empty:
                continue
            if kind == "end":
                return
            if kind == "abandon":
                break
            yield item
        raise _Abandoned

    def run(number, queue):
        try:
            for result in work(number, arrive(queue)):
                results.put(("result", result))
            results.put(("end", None))
        except _Abandoned:
            results.put(("end", None))
        except BaseException as error:  # handed to the caller
            results.put(("error", error))

    def take(is_full):
        """Yield results that are there; while `is_full()`, also those that come."""
        while True:
            try:
                kind, value = results.get(timeout=WAIT) if is_full() else results.get_nowait()
            except Empty:
                if is_full():
                    continue
                return
            if kind == "error":
                raise value
            if kind == "end":
                count["groups"] -= 1
            else:
                count["items"] -= 1
                yield value

    failed: Any = None
    try:
        for number, size in enumerate(sizes):
            yield from take(lambda: count["groups"] >= workers)
            queue: Queue = Queue()
            threads.append(Thread(target=run, args=(number, queue), daemon=True))
            threads[-1].start()
            count["groups"] += 1
            for _ in range(size):
                yield from take(lambda: count["items"] >= held)
                try:
                    queue.put(("item", next(items)))
                except Exception as error:  # raised when the groups before are done
                    failed = error
                    break
                count["items"] += 1
            queue.put(("abandon" if failed else "end", None))
            if failed:
                break
        yield from take(lambda: count["groups"] > 0)
        if failed:
            raise failed
    finally:
        over.set()
        for thread in threads:
            thread.join()
