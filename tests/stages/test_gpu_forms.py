"""What stages do for GPUs, one pixel per work-item or another kernel altogether, run on the CPU by OpenCL.

All with `slow`: each form is built anew, which takes seconds.
"""

import re

import pytest

from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.select import open_device
from gpusim.kernels.stage import public_function, stage_module, stage_names

EVERY = 5


def has_gpu_form(stage):
    """Whether it asks what the device is."""
    with open(stage_module(stage).__file__) as file:
        return re.search(r"\b(is_gpu|on_host|is_opencl_cpu)\b", file.read())


STAGES = [stage for stage in stage_names() if has_gpu_form(stage)]
CASES = [
    pytest.param(stage, first, marks=pytest.mark.slow) for stage in STAGES for first in range(EVERY)
]  # builds


@pytest.fixture(scope="module")
def device():
    """A CPU's OpenCL device, of this file alone, that claims to be a GPU apart from the host."""
    shared = open_device("opencl:pocl")
    own = OpenCLDevice(shared.cl_device, shared.name)
    own.is_gpu, own.on_host = True, False
    return own


def test_stages_with_a_form_for_gpus_are_found():
    assert {
        "processor.align",
        "processor.average",
        "processor.flash",
        "processor.merge",
        "processor.denoise",
        "processor.defects",
        "processor.malvar",
        "processor.thumbnail",
        "processor.learned",
    } <= {*STAGES}


@pytest.mark.slow
def test_tiles_are_transformed_in_batches_where_no_local_memory_holds_one(device, monkeypatch):
    contract = stage_module("optics.tiles")
    monkeypatch.setattr(contract, "_room", lambda *_: device.local_bytes + 1)
    for case in contract.cases():
        found = contract.tiles(**case.inputs, device=device)
        assert case.error(found, contract.tiles(**case.inputs, device="numpy")) <= case.tolerance, (
            case.name
        )


@pytest.mark.slow
def test_the_far_field_goes_one_axis_after_the_other_where_local_memory_does_not_hold_both(
    device, monkeypatch
):
    contract = stage_module("optics.far")
    monkeypatch.setattr(
        device, "local_bytes", contract.STEP - 1
    )  # of which none of its groups is content with so few
    launched, launch = [], device.launch
    monkeypatch.setattr(
        device,
        "launch",
        lambda stage, *args, **kwargs: (launched.append(stage), launch(stage, *args, **kwargs))[1],
    )
    for case in contract.cases():
        found = contract.far(**case.inputs, device=device)
        assert case.error(found, contract.far(**case.inputs, device="numpy")) <= case.tolerance, (
            case.name
        )
    assert "optics.far" in launched and "optics.far_groups" not in launched


@pytest.mark.parametrize("stage, first", CASES)
def test_the_form_for_gpus_agrees_with_the_reference(stage, first, device):
    """Within the cases' own tolerances, which hold for either form."""
    function = public_function(stage)
    for case in list(stage_module(stage).cases())[first::EVERY]:
        error = case.error(
            function(**case.inputs, device=device), function(**case.inputs, device="numpy")
        )
        assert error <= case.tolerance, case.name
