"""What stages do for GPUs, one pixel per work-item or another kernel altogether, run on the CPU by OpenCL.

All with `slow`: each form is built anew, which takes seconds.
"""

import re

import numpy as np
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


class FullOfNaN(OpenCLDevice):
    """A CPU's OpenCL device that claims to be a GPU apart from the host; its new memory has NaN."""

    def __init__(self):
        shared = open_device("opencl:pocl")
        super().__init__(shared.cl_device, shared.name)
        self.is_gpu, self.on_host = True, False

    def _empty(self, shape, dtype):
        array = super()._empty(shape, dtype)
        if array.nbytes:
            self._cl.enqueue_fill_buffer(self.queue, array.buffer, np.uint8(0xFF), 0, array.nbytes)
        return array

    def _entry(self, stage, program, kernel, args):
        """Return a kernel, which may use as much local memory as the device says."""
        entry, of = super()._entry(stage, program, kernel, args), self._cl.kernel_work_group_info
        taken = entry.get_work_group_info(of.LOCAL_MEM_SIZE, self.cl_device)
        assert taken <= self.local_bytes, f"{stage}, {kernel}: {taken} bytes of local memory"
        return entry


@pytest.fixture(scope="module")
def device():
    """A device of this file alone: values that no kernel wrote are NaN, and end in a result if it uses them."""
    return FullOfNaN()


def test_stages_with_a_form_for_gpus_are_found():
    assert {
        "processor.align",
        "processor.average",
        "processor.flash",
        "processor.merge",
        "processor.multiscale",
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "stage",
    ["optics.blur", "optics.tiles", "optics.mosaic", "sensor.meter", "processor.multiscale"],
)
def test_kernels_of_groups_need_only_the_local_memory_that_every_gpu_has(stage):
    """OpenCL's least is 32 KiB; sensor.meter needed 16 bytes more for four quantiles."""
    device = FullOfNaN()
    device.local_bytes = 2**15
    for case in list(stage_module(stage).cases())[: 2 * EVERY]:
        found = public_function(stage)(**case.inputs, device=device)
        wanted = public_function(stage)(**case.inputs, device="numpy")
        assert case.error(found, wanted) <= case.tolerance, case.name


@pytest.mark.parametrize("stage, first", CASES)
def test_the_form_for_gpus_agrees_with_the_reference(stage, first, device):
    """Within the cases' own tolerances, which hold for either form."""
    function = public_function(stage)
    for case in list(stage_module(stage).cases())[first::EVERY]:
        error = case.error(
            function(**case.inputs, device=device), function(**case.inputs, device="numpy")
        )
        assert error <= case.tolerance, case.name
