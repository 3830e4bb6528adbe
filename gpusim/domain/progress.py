"""Long work, such as the compilation of kernels, for whoever shows it: one channel of a process.

`with announced("compiling sensor.noise"):` announces work; `with listening(listener):` hears of it.
"""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")

# The thread that works calls it. As work begins, its words are given. As it ends, the words of the work
# around it are, or None if there is none.
Listener = Callable[[str | None], None]
_listeners: list[Listener] = []


class _Own(threading.local):
    words: str | None = None  # of the work of this thread


_own = _Own()


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call a listener for all work of the process that begins or ends inside the block."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


@contextmanager
def announced(words: str) -> Iterator[None]:
    """Announce the work of the block. words: a name of the work, such as "compiling sensor.noise"."""
    outer = _own.words
    _notify(words)
    try:
        yield
    finally:
        _notify(outer)


def announce_each(items: Iterable[Item], words: Callable[[int], str]) -> Iterator[Item]:
    """Yield items, and announce the work on each.

    Args:
        items: The items, made one by one.
        words: Returns a name of the work, from the number of items that are done.

    Yields:
        The items.
    """
    count, remaining = 0, iter(items)
    while True:
        with announced(words(count)):
            try:
                item = next(remaining)
            except StopIteration:
                return
        count += 1
        yield item


def _notify(words):
    _own.words = words
    for listener in tuple(_listeners):
        listener(words)
