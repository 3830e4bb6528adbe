"""Work of several devices at the same time: each has a pipeline of its own."""

from collections import deque
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import Any, TypeVar

T = TypeVar("T")
HELD = 2  # items that each pipeline makes ahead
END: Any = object()


class _Running:
    """A pipeline in its own thread, which stays HELD items ahead."""

    def __init__(self, items):
        self._items, self._pool = iter(items), ThreadPoolExecutor(1)
        self._coming = deque(self._pool.submit(next, self._items, END) for _ in range(HELD))

    def take(self):
        """Return the next item, or END. Raises the error of the pipeline."""
        item = self._coming.popleft().result()
        self._coming.append(self._pool.submit(next, self._items, END))
        return item

    def close(self):
        """End the pipeline after its current item."""
        self._pool.shutdown(cancel_futures=True)
        if isinstance(self._items, Generator):
            self._items.close()


def run_together(
    pipelines: Sequence[Iterable[T]], turns: Iterable[int] | None = None
) -> Generator[T, None, None]:
    """Yield the items of pipelines, each of which runs in its own thread.

    An error of one is raised here, when its item's turn comes. It ends the others after their
    current item, as closing this generator does.

    Args:
        pipelines: The pipelines.
        turns: For each item the number of its pipeline. None: all pipelines in turn, each until its
            end.
    """
    if len(pipelines) == 1:
        yield from pipelines[0]
        return
    with ExitStack() as stack:
        running = [stack.enter_context(closing(_Running(one))) for one in pipelines]
        for turn in () if turns is None else turns:
            yield running[turn].take()
        while turns is None and running:
            for one in [*running]:
                item = one.take()
                if item is END:
                    running.remove(one)
                else:
                    yield item
