"""What tests expect of a refusal: one short line, in time and without much memory."""

import contextlib
import signal
import tracemalloc

import fuzz
import numpy as np
import pytest

from gpusim.domain.errors import GpusimError

SMALL = 8 * 2**20  # [byte] that a refusal may take: modules, a directory, pieces of 1 MiB
WAVES = np.array([400.0, 500.0, 650.0])


@contextlib.contextmanager
def refused(*parts, error=GpusimError, seconds=5):
    """Expect an error in one short line that holds all `parts`, in time."""

    def late(number, frame):
        raise TimeoutError("still reading")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        with pytest.raises(error) as caught:
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    text = str(caught.value)
    assert (
        len(text) < fuzz.LONGEST_MESSAGE
        and text.isprintable()
        and all(str(part) in text for part in parts)
    ), text


@contextlib.contextmanager
def takes(most):
    """Expect the block to take less than `most` bytes at once, of what Python and NumPy allocate."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < most, f"{peak / 2**20:.1f} MiB"


def archive(path, **arrays):
    np.savez_compressed(path, **arrays)
    return path
