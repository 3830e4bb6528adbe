"""OpenBLAS's threads: none while a context is open, as before after the last one, and none for the rest of a plan."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from gpusim.optics.blas import _libraries, one_core

# A child process, because OpenBLAS reads its number of threads once. Its threads spin for some 10 ms after a product
# that wakes them: 40 to 70 ms on an EPYC. On one core no other thread runs, apart from Python's own bookkeeping.
SPIN = """
import time
import numpy as np
from contextlib import nullcontext
from gpusim.optics.blas import one_core
a = np.ones((400, 400))
a @ a
def others(context):
    with context:
        time.sleep(0.3)
        before = time.process_time() - time.thread_time()
        for _ in range(3):
            a @ a
            time.sleep(0.1)
        return time.process_time() - time.thread_time() - before
print(others(one_core()), others(nullcontext()))
"""


def counts():
    return [read() for _, read in _libraries()]


@pytest.fixture
def two():
    """OpenBLAS with two threads."""
    if not _libraries():
        pytest.skip("no OpenBLAS")
    before = counts()
    for write, _ in _libraries():
        write(2)
    yield [2] * len(before)
    for (write, _), count in zip(_libraries(), before, strict=True):
        write(count)


def test_threads_come_back_after_the_last_context(two):
    if counts() != two:
        pytest.skip("OpenBLAS has one thread only")
    inside, leave = threading.Event(), threading.Event()

    def hold():
        with one_core():
            inside.set()
            leave.wait()

    other = threading.Thread(target=hold)
    other.start()
    inside.wait()
    with pytest.raises(ZeroDivisionError), one_core(), one_core():
        assert counts() == [1] * len(two)
        _ = 1 / 0
    assert counts() == [1] * len(two)  # the other thread's context is open
    leave.set()
    other.join()
    assert counts() == two


def test_products_on_one_core_wake_no_thread():
    environment = {"OPENBLAS_NUM_THREADS": "2", "PYTHONPATH": ":".join(filter(None, sys.path))}
    found = subprocess.run(
        [sys.executable, "-c", SPIN], env=environment, capture_output=True, text=True, check=True
    )
    on_one, on_two = map(float, found.stdout.split())
    assert on_one < 5e-3
    if on_two < 5e-3:
        pytest.skip("OpenBLAS starts no threads here")


def test_results_do_not_depend_on_the_context():
    rng = np.random.default_rng(0)
    a = rng.standard_normal((300, 300))
    with one_core():
        found = a @ a
    # float64 sums of 300 products in another order: at most 300 rounding errors of the sum of magnitudes
    assert np.all(np.abs(found - a @ a) <= 300 * 2.0**-53 * 2 * (np.abs(a) @ np.abs(a)))
