"""Every stage on every device against its float64 reference: the cases that `gpusim verify` runs."""

import re
from pathlib import Path

import pytest
from devices import BROKEN, DEVICES

from gpusim.backends.probe import best
from gpusim.backends.select import open_device
from gpusim.kernels.stage import ROOT, stage_module, stage_names
from gpusim.verify import verify

QUICK = best()
ON_DEVICES = [pytest.param(name, marks=pytest.mark.quick) if name == QUICK else name for name in DEVICES]


def test_every_device_works():
    """The one test that a driver fails which cannot build an empty kernel, with its cause; no other runs on it."""
    assert BROKEN == {}


def test_an_opencl_device_and_warp_work():
    assert any(name.startswith("opencl:") for name in DEVICES)
    assert any(name.startswith("warp:") for name in DEVICES)


@pytest.mark.parametrize("device", ON_DEVICES)
@pytest.mark.parametrize("stage", stage_names())
def test_stage_agrees_with_its_reference(stage, device):
    failed = [row for row in verify(open_device(device), [stage]) if not row["ok"]]
    assert failed == []


@pytest.mark.parametrize("stage", stage_names())
def test_stage_is_complete(stage):
    """Four files, cases, and OpenCL and Warp kernels with the same names."""
    path = ROOT.joinpath(*stage.split("."))
    for suffix in (".py", "_ref.py", ".cl", "_warp.py"):
        assert Path(f"{path}{suffix}").exists()
    assert list(stage_module(stage).cases())
    patterns = {".cl": r"__kernel void (\w+)\(", "_warp.py": r"@wp\.kernel[^\n]*\n\s*def (\w+)\("}
    names = [set(re.findall(pattern, Path(f"{path}{suffix}").read_text())) for suffix, pattern in patterns.items()]
    launched = set(re.findall(r"device\.launch\(\s*\"[\w.]+\",\s*\"(\w+)\"", Path(f"{path}.py").read_text()))
    assert names[0] & names[1] or not launched
    assert launched <= names[0] & names[1]


@pytest.mark.parametrize("name", ["opencl:99", "warp:cuda:99", "metal:0", "opencl:no-such-vendor"])
def test_a_device_that_is_not_there_is_refused(name):
    from gpusim.domain.errors import DeviceError

    with pytest.raises(DeviceError):
        open_device(name)
