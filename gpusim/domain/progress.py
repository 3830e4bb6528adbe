"""Long work, such as the compilation of kernels, for whoever shows it: one channel of a process.

`with announced("compiling sensor.noise"):` announces work; `with listening(listener):` hears of it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Called with the words as work begins, and with None as it ends, by the thread that works
Listener = Callable[[str | None], None]
_listeners: list[Listener] = []


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
    """Announce the work of the block. words: what is done, such as "compiling sensor.noise"."""
    for listener in tuple(_listeners):
        listener(words)
    try:
        yield
    finally:
        for listener in tuple(_listeners):
            listener(None)
