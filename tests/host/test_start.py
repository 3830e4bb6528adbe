"""The start of a process: results of libraries that take long to import, computed without them."""

import os
import subprocess
import sys

import numpy as np
import pytest
import scipy.ndimage
from scipy.interpolate import CubicSpline

from gpusim.domain.interpolation import spline_weights
from gpusim.optics.windows import average_boxes

# parts of SciPy that frames of a simple lens do without: each takes 40 to 500 ms to import
SLOW = ("signal", "stats", "interpolate", "optimize", "ndimage", "linalg", "sparse.linalg")
NAME = "OPENBLAS_NUM_THREADS"
PLAN = """
import sys
import gpusim as gs
simulator = gs.Simulator(gs.open_camera("phone"), device="opencl:pocl", tolerance="video")
simulator.plan(gs.open_scene("colorchecker"))
print(*({*sys.argv[1:]} & {*sys.modules}))
"""


def test_a_plan_imports_nothing_slow():
    slow = [f"scipy.{name}" for name in SLOW]
    slow += ["numpy.f2py.crackfortran", "numpy.testing.overrides", "warp", "PIL", "tifffile"]
    command = [sys.executable, "-W", "ignore", "-c", PLAN, *slow]
    end = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (end.stdout.strip(), end.stderr) == ("", "")


@pytest.mark.parametrize(
    ("command", "own", "expected"),
    [("simulate", None, "1"), ("simulate", "3", "3"), ("verify", None, "None")],
)
def test_commands_without_large_products_start_no_threads_for_them(command, own, expected):
    words = "import os; from gpusim.__main__ import start; start(); print(os.environ.get(NAME))"
    words = f"import sys; sys.argv = ['gpusim', {command!r}, '--help']; NAME = {NAME!r}; {words}"
    others = {name: value for name, value in os.environ.items() if name != NAME}
    environment = others | ({} if own is None else {NAME: own})
    end = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, env=environment
    )
    assert end.stdout.split()[-1] == expected, end.stderr


@pytest.mark.parametrize("wide", [40, 4000])  # the second: rows of the equations are exchanged
@pytest.mark.parametrize("count", [2, 3, 4, 5, 31])
def test_spline_weights_are_those_of_scipy(count, wide):
    nodes = np.cumsum(np.random.default_rng(count).uniform(5, wide, count)) + 380
    at = np.linspace(nodes[0] - 20, nodes[-1] + 20, 97)
    ends = "not-a-knot" if count > 3 else "natural"
    expected = CubicSpline(nodes, np.eye(count), bc_type=ends)(at)
    assert np.array_equal(spline_weights(nodes, at), expected)


@pytest.mark.parametrize("size", [1, 3, 15, 41])
@pytest.mark.parametrize("mode, of_scipy", [("constant", "constant"), ("symmetric", "reflect")])
def test_means_of_boxes_are_those_of_scipy(size, mode, of_scipy):
    values = np.random.default_rng(size).exponential(1, (2, 37, 24)).astype(np.float32)
    expected = scipy.ndimage.uniform_filter(values, (0, size, size), mode=of_scipy)
    assert np.array_equal(average_boxes(values, size, mode), expected)
