"""Concurrent steps of a loop: each runs in its own thread, a few items ahead of the next step."""

from collections.abc import Generator, Iterable
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar("T")
WAIT = 0.1  # [s] between two checks of a waiting thread whether it should end


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
