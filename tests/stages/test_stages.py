"""Every stage on every device against its float64 reference: the cases that `gpusim verify` runs."""

import inspect
import re
from importlib import import_module
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from devices import BROKEN, DEVICES

from gpusim.backends.probe import best
from gpusim.backends.select import open_device
from gpusim.judge.verify import verify
from gpusim.kernels.processor.linear import linear
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.stage import ROOT, public_function, stage_module, stage_names

QUICK = best()["name"]
FEW = 2  # cases of a stage in the quick tests: each may compile kernels of its own


def test_every_device_works():
    """The one test that a driver fails which cannot build an empty kernel, with its cause; no other runs on it."""
    assert BROKEN == {}


def test_an_opencl_device_and_warp_work():
    assert any(name.startswith("opencl:") for name in DEVICES)
    assert any(name.startswith("warp:") for name in DEVICES)


@pytest.mark.quick
@pytest.mark.parametrize("stage", stage_names())
def test_first_cases_of_a_stage_agree_with_its_reference(stage):
    rows = list(islice(verify(open_device(QUICK), [stage]), FEW))
    assert rows and not [row for row in rows if not row["ok"]]


@pytest.mark.parametrize("device", DEVICES)
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
    names = [
        set(re.findall(pattern, Path(f"{path}{suffix}").read_text()))
        for suffix, pattern in patterns.items()
    ]
    launched = set(
        re.findall(r"device\.launch\(\s*\"[\w.]+\",\s*\"(\w+)\"", Path(f"{path}.py").read_text())
    )
    assert names[0] & names[1] or not launched
    assert launched <= names[0] & names[1]


@pytest.mark.parametrize("stage", stage_names())
def test_signature_is_that_of_a_call(stage):
    """The device is last and by keyword only, the rest is as for the reference; every case's inputs fit."""
    signature = inspect.signature(public_function(stage))
    *others, device = signature.parameters.values()
    assert (device.name, device.kind, device.default) == (
        "device",
        inspect.Parameter.KEYWORD_ONLY,
        "auto",
    )
    reference = getattr(import_module(f"gpusim.kernels.{stage}_ref"), stage.rpartition(".")[2])
    assert not [one.name for one in others if one.annotation is one.empty]
    assert signature.return_annotation is not signature.empty
    expected = inspect.signature(reference).parameters.values()
    assert [(p.name, p.kind, p.default) for p in others] == [
        (p.name, p.kind, p.default) for p in expected
    ]
    for case in stage_module(stage).cases():
        signature.bind(**case.inputs, device="numpy")


@pytest.mark.parametrize("device", ["numpy", QUICK])
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda raw, device: linear(raw, 0, 1, device=device), "too many positional arguments"),
        (
            lambda raw, device: linear(raw, black_level=0, device=device),
            "missing a required argument: 'scale'",
        ),
        (
            lambda raw, device: linear(raw, black_level=0, scale=1, white=2, device=device),
            "unexpected keyword.*'white'",
        ),
    ],
    ids=["positional", "missing", "unknown"],
)
def test_a_wrong_call_names_the_stage(call, words, device):
    with pytest.raises(
        TypeError, match=rf"^processor\.linear: .*{words}.*; wanted linear\(raw, \*, "
    ) as caught:
        call(np.ones((2, 2), np.uint16), device)
    assert "\n" not in str(caught.value)


def test_a_type_error_of_the_stage_itself_stays():
    """Its arguments fit: what is wrong is a value, and the message is that of whoever found it."""
    with pytest.raises(TypeError) as caught:
        chip(np.ones((2, 2), np.float32), scale=object(), device="numpy")
    assert "sensor.chip" not in str(caught.value)


@pytest.mark.parametrize("name", ["opencl:99", "warp:cuda:99", "metal:0", "opencl:no-such-vendor"])
def test_a_device_that_is_not_there_is_refused(name):
    from gpusim.domain.errors import DeviceError

    with pytest.raises(DeviceError):
        open_device(name)
