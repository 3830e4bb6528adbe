"""Threads that import lazily at once, each test in a fresh process."""

import subprocess
import sys

import pytest

START = """
import sys, threading, time
import numpy as np
import gpusim as gs
from gpusim.measure import difference

errors, ready = [], threading.Barrier(2)

def run(actions):
    ready.wait()
    for action in actions:
        try:
            action()
        except BaseException as error:
            errors.append(f"{type(error).__name__}: {error}")

white = np.ones(3)
lab = lambda: difference.cielab(np.full((2, 3), 0.2), white)
delta = lambda: difference.ciede2000(np.full((2, 2, 3), 0.2), np.full((2, 2, 3), 0.3))
"""
END = """
threads = [threading.Thread(target=run, args=(one,)) for one in (first, second)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(errors)
"""


def said(actions):
    """What a process prints whose threads do these actions."""
    words = [sys.executable, "-W", "ignore", "-c", START + actions + END]
    end = subprocess.run(words, capture_output=True, text=True, timeout=300)
    return end.stdout.strip(), end.stderr


@pytest.mark.parametrize("part", ["colour.appearance"])
def test_colours_are_computed_by_two_threads(part):
    """One begins when the other has loaded a part of colour-science, whose modules import each other."""
    wait = f"""
def wait():
    while {part!r} not in sys.modules:
        time.sleep(0.001)
"""
    assert said(f"{wait}\nfirst, second = [lab], [wait, delta]") == ("[]", "")


@pytest.mark.slow
def test_all_names_are_loaded_by_two_threads():
    """From both ends; and what a plot and the preview's measures load inside functions."""
    actions = """
names = [lambda name=name: getattr(gs, name) for name in gs.__all__]
plot = lambda: gs.plot.scene(gs.chart("colorchecker", size=(48, 32)))
frame = lambda: gs.Simulator(gs.open_camera("phone"), device="numpy")(gs.chart("flat", size=(16, 16)))
first, second = [*names, delta, plot, frame], [frame, plot, delta, *names[::-1]]
"""
    assert said(actions) == ("[]", "")
