"""The benchmark on devices: planted wrong answers, limits, counted launches, and the pipelines' own checks."""

import numpy as np
import pytest
from devices import DEVICES, KINDS, apart

from gpusim.backends import open_device
from gpusim.bench import limits, suite
from gpusim.bench.pipelines import list_pipelines
from gpusim.bench.result import find_fault
from gpusim.bench.stages import Stage
from gpusim.domain.errors import DeviceError
from gpusim.judge.verify import verify
from gpusim.kernels.stage import stage_module

QUICK = "noise only", "transforms", "batch"  # the other pipelines take longer


@pytest.mark.parametrize("name", DEVICES[:1])
def test_a_planted_wrong_answer_is_reported_and_gets_no_speed(name, monkeypatch):
    device, module = open_device(name), stage_module("display.encode")
    right = module.encode

    def wrong(*args, device, **options):
        codes = right(*args, device=device, **options)
        return codes if device.kind == "numpy" else np.asarray(codes) ^ 1

    monkeypatch.setattr(module, "encode", wrong)
    found = suite.measure(
        device,
        [Stage("sensor.flag"), Stage("display.encode")],
        [(24, 16)],
        seconds=0.0,
        verify=lambda names: verify(device, names),
    )
    good, bad = found["rows"]
    assert good["verified"] and good["ms_p50"] > 0 and good["attained"] > 0
    assert not bad["verified"] and "error 1, tolerance 0" in bad["failed"]
    assert not {"rounds", "ms_p50", "attained", "floor_ms"} & bad.keys()
    assert found["scores"]["sensor"] > 0
    assert found["scores"]["display"] is found["scores"]["all"] is None
    assert not find_fault(found)


@pytest.mark.skipif(not DEVICES or not DEVICES[0].startswith("opencl"), reason="no OpenCL device")
def test_local_memory_is_read_as_it_was_written(monkeypatch):
    """The kernel's sums are checked in `local_gbps`: in the form of CPUs, and of GPUs on the CPU."""
    for name, value in (("CPU_READS", 64), ("GPU_READS", 64), ("GPU_ITEMS", 512)):
        monkeypatch.setattr(limits, name, value)
    monkeypatch.setattr(limits, "BEST_OF", 1)
    for device in (open_device(DEVICES[0]), apart()):
        assert limits.local_gbps(device) > 0


@pytest.mark.skipif(not DEVICES or not DEVICES[0].startswith("opencl"), reason="no OpenCL device")
def test_a_device_with_its_own_memory_has_rates_of_copies(monkeypatch):
    monkeypatch.setattr(limits, "TRANSFER_BYTES", 2**16)
    device = apart()
    assert limits.upload_gbps(device) > 0 and limits.download_gbps(device) > 0


@pytest.mark.parametrize("name", DEVICES)
def test_a_wrong_sum_is_no_limit(name, monkeypatch):
    device = open_device(name)
    monkeypatch.setattr(limits, "CPU_STEPS", 8)  # the sums do not converge to b / (1 - a)
    monkeypatch.setattr(limits, "GPU_STEPS", 8)
    with pytest.raises(DeviceError, match="gave other sums"):
        limits.fma_gflops(device)


@pytest.mark.parametrize("name", DEVICES)
def test_launches_are_counted(name):
    device = open_device(name)
    source, target = device.array(np.ones(4, np.float32)), device.empty((4,))

    def run():
        for _ in range(3):
            device.launch("common.copy", "copy", (1,), source, target, 1)

    assert device.count_launches(run) == 3
    with device.timed():
        run()
        assert device.count_launches(run) == 3


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    "one",
    [
        pytest.param(
            one,
            id=one.name,
            marks=[] if one.name in QUICK else pytest.mark.slow,
        )
        for one in list_pipelines()
    ],
)
def test_a_pipeline_is_verified_and_runs(one, name):
    device = open_device(name)
    checks = list(one.check(device))
    assert checks and all(check.is_good for check in checks), checks
    work = one.start(device, (96, 64))
    for _ in range(3):
        work.run()
    device.sync()
    assert work.moved > 0 and device.count_launches(work.run) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES[:1])
def test_a_cold_build_takes_longer_than_a_run(name):
    from gpusim.bench.cold import measure_cold_build

    found = measure_cold_build(open_device(name), ["sensor.flag", "display.encode"])
    assert found is not None and found > 0.05
