"""Long work on a terminal: one line that goes when the work ends."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from gpusim.domain.progress import listening

WAIT = 0.5  # [s] until work is shown, and between changes of its time


def showing_progress() -> AbstractContextManager[None]:
    """Show work that takes long, inside the block, if standard error is a terminal."""
    return _showing() if sys.stderr.isatty() else nullcontext()


@contextmanager
def _showing() -> Iterator[None]:
    line = _Line()
    thread = threading.Thread(target=line.show, daemon=True)
    thread.start()
    try:
        with listening(line.hear):
            yield
    finally:
        line.is_over.set()
        thread.join()


class _Line:
    """The line. `hear` is called by threads that work, `show` runs in a thread of its own."""

    def __init__(self):
        self.is_over, self._lock = threading.Event(), threading.Lock()
        self._words, self._seconds, self._start = "", 0.0, 0.0
        self._is_shown = False

    def hear(self, words):
        now = time.monotonic()
        with self._lock:
            if self._words:
                self._seconds += now - self._start
            self._words, self._start = words or "", now
            if self._is_shown and not words:
                self._write("")
                self._is_shown = False

    def show(self):
        while not self.is_over.wait(WAIT):
            with self._lock:
                if self._words:
                    seconds = self._seconds + time.monotonic() - self._start
                    self._write(f"{self._words} ({seconds:.0f} s in all)")
                    self._is_shown = True

    def _write(self, line):
        print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)
