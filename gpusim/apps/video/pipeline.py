"""Steps of a loop that go on at the same time: each in a thread of its own, a few items ahead of the next one."""

from collections.abc import Generator, Iterable
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar("T")
WAIT = 0.1  # [s] until a thread that cannot go on looks whether it should end


def ahead(items: Iterable[T], count: int) -> Generator[T, None, None]:
    """The items, made in a thread up to `count` before they are asked for. What is raised there is raised here.

    When this generator is closed, that thread ends after the item that it is making.
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
        except BaseException as error:  # whatever it is, it is the caller's
            put(None, error)
        finally:
            if isinstance(items, Generator):
                items.close()

    thread = Thread(target=work, daemon=True)
    thread.start()
    try:
        while True:
            try:
                item, error = queue.get(timeout=WAIT)  # an interrupt is seen between two waits
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
