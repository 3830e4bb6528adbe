"""The end of the process while other threads use libraries."""

import subprocess
import sys

CODE = """
import threading
import numpy as np
import scipy.fft
from gpusim.domain.ending import finish_at_exit, finish_before_end

def work(values=np.ones((256, 256))):
    for _ in range(50):
        scipy.fft.fft2(values)
        begun.set()
    print("done", flush=True)

def go_on():
    while True:
        use()

use = finish_before_end(work) if {finish} else work
begun = threading.Event()
threading.Thread(target=go_on, daemon=True).start()
finish_at_exit()
begun.wait()
"""


def ended(finish):
    return subprocess.run(
        [sys.executable, "-P", "-c", CODE.format(finish=finish)],
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_the_end_waits_for_a_frame_and_begins_none():
    """SciPy's FFT is written in C++: Python before 3.14 aborts the process in a thread that returns from it."""
    if sys.version_info < (3, 14):
        assert any(ended(False).returncode for _ in range(10))  # the test can fail
    for _ in range(3):
        done = ended(True)
        assert (done.returncode, done.stderr, {*done.stdout.split()}) == (0, "", {"done"})
