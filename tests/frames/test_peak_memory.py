"""The benchmark's loops count the memory that a device's arrays take."""

import gc

import pytest

from gpusim.backends.driver import cl_devices
from gpusim.backends.opencl import OpenCLDevice
from gpusim.bench.loops import Peak, time_in_process


@pytest.mark.parametrize("on_host", [True, False])
def test_what_is_allocated_and_let_go_is_counted(on_host):
    device = OpenCLDevice(cl_devices()[0], "opencl:0")
    device.on_host = on_host
    peak = Peak(device)
    first, second = device.empty((1000,)), device.empty((500,))
    assert (peak.now, peak.bytes) == (6000, 6000)
    del first
    again = device.empty((1000,))  # of the memory that is free
    assert (peak.now, peak.bytes) == (6000, 6000)
    del again
    device._free.clear()
    gc.collect()
    assert (peak.now, peak.bytes) == (2000, 6000)
    assert second.nbytes == 2000


@pytest.mark.parametrize("bands", [10, 31])
def test_a_loop_is_measured(bands):
    row = time_in_process(
        {
            "device": "opencl:0",
            "size": (160, 96),
            "bands": bands,
            "tolerance": 4e-4,
            "camera": "phone",
            "repeat": 5,
        },
    )
    assert "failed" not in row, row["failed"]
    assert 0 < row["ms_p25"] <= row["ms_p50"] <= row["ms_p75"]
    cube = 4 * bands * 160 * 96
    assert (
        cube < row["bytes_peak"] <= row["bytes_predicted"] < row["rss"]
    )  # the plan's figure is an upper bound
    assert row["planning_ms"] > 0 and row["busy"] > 0
