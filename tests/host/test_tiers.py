"""The tiers of the tests keep what they promise: no devices in tests/host, no test beyond its budget."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import budget
import pytest

from gpusim.backends import open_device, probe
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.warp import WarpDevice


def test_collecting_the_host_s_tests_loads_no_driver():
    """Nor the list of devices that the other tests run on, which probes them."""
    code = (
        "import sys, pytest; "
        "status = pytest.main(['-q', '--collect-only', '-n0', '-p', 'no:cacheprovider', sys.argv[1]]); "
        "print(int(status), sorted({'pyopencl', 'warp', 'devices'} & set(sys.modules)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, Path(__file__).parent],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert result.stdout.splitlines()[-1] == "0 []", result.stdout[-2000:] + result.stderr


def test_long_tests_exist():
    tests = Path(__file__).parents[1]
    for line in (tests / "long.txt").read_text("utf-8").splitlines():
        path, name = line.partition("[")[0].split("::")[:2]
        assert f"def {name}(" in (tests / path).read_text("utf-8"), line


@pytest.mark.parametrize(
    "use",
    [
        lambda: OpenCLDevice(None, "opencl:0"),
        lambda: WarpDevice("cpu", "warp:cpu"),
        lambda: open_device("auto").name,
        lambda: open_device("warp:cpu").name,
        lambda: probe.devices(refresh=True),
    ],
    ids=["opencl", "warp", "auto", "name", "probe"],
)
def test_devices_are_out_of_reach(use):
    with pytest.raises(AssertionError, match="without devices"):
        use()


def test_numpy_is_within_reach():
    assert open_device("numpy").name == "numpy"


@pytest.mark.parametrize(
    ("marked", "end"), [(None, pytest.fail.Exception), ("slow", StopIteration)]
)
def test_a_test_beyond_its_budget_fails(marked, end, monkeypatch):
    """Unless it is marked slow."""
    around = budget.budgeted(SimpleNamespace(get_closest_marker=lambda name: name == marked))
    next(around)
    with monkeypatch.context() as patch, pytest.raises(end):
        patch.setattr(budget, "BUDGET", -1.0)
        around.send(None)
