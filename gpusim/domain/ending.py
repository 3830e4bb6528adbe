"""The end of the process: frames that other threads compute are finished first, and none are begun.

When Python ends, it ends every thread that returns from a library. A library in C++, such as SciPy's FFT, does not
survive that: it aborts the process.
"""

import atexit
import sys
import threading
import time
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

LAST = 60  # [s] that the end waits for a thread

_working: set[int] = set()  # threads
_ended_by: list[int] = []  # the thread that ends the process
_never = threading.Lock()
_never.acquire()

Function = TypeVar("Function", bound=Callable[..., Any])


def finish_before_end(function: Function) -> Function:
    """Decorate a function that uses libraries: the end of the process waits until it returns."""

    @wraps(function)
    def call(*args, **kwargs):
        thread = threading.get_ident()
        if thread in _working:  # by a function around it
            return function(*args, **kwargs)
        _working.add(thread)
        try:
            if not _ended_by or thread in _ended_by:
                return function(*args, **kwargs)
        finally:
            _working.discard(thread)
        return _never.acquire()  # for good

    return cast(Function, call)


def finish_at_exit() -> None:
    """Finish at the end of the process, before what was registered earlier: the ends of devices."""
    atexit.unregister(_finish)
    atexit.register(_finish)


def _finish():
    _ended_by.append(threading.get_ident())
    stop = time.monotonic() + LAST
    # a forked process has none of its parent's threads
    while (_working - {*_ended_by}) & sys._current_frames().keys() and time.monotonic() < stop:
        time.sleep(1e-3)
