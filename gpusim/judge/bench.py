"""Speed against error of every stage: `gpusim bench`. A stage that fails its verification gets no speed."""

import time
from collections.abc import Iterator

import numpy as np

from gpusim.backends import Device
from gpusim.backends.probe import copy_gbps, vector_width
from gpusim.domain.errors import DeviceError
from gpusim.judge.verify import verify
from gpusim.kernels.stage import public_function, stage_module, stage_names

ERROR_SIZE = (
    270,
    480,
)  # the reference of a full frame takes minutes; errors are measured on this size
CHAINS, CPU_STEPS, GPU_STEPS = (
    10,
    100_000,
    16_384,
)  # of `fma_gflops`; steps enough to hide launching


def ceilings(device: Device) -> dict:
    """Measured limits of a device: copy_gbps [GB/s] and fma_gflops [GFLOP/s]; None on the NumPy device."""
    if device.kind == "numpy":
        return {"copy_gbps": None, "fma_gflops": None}
    return {"copy_gbps": copy_gbps(device), "fma_gflops": fma_gflops(device)}


def fma_gflops(device: Device) -> float:
    """Measured float32 throughput [GFLOP/s], an operation being a multiplication or an addition; best of ten.

    The kernel does s = s a + b in chains that do not wait for one another and stay in registers, as wide as the
    device's vectors, on all work-items at once. Raises DeviceError when the sums are not what the recurrence tends to.
    """
    is_cpu = not device.is_gpu
    items, steps = (64, CPU_STEPS) if is_cpu else (2**18, GPU_STEPS)
    width = vector_width(device) if is_cpu and device.kind == "opencl" else 1
    defines = (
        {"VECTOR": f"float{width}" if width > 1 else "float"} if device.kind == "opencl" else {}
    )
    out, a, b, best_ms = device.empty((items * width,)), 0.99, 0.5, np.inf
    for _ in range(10):
        with device.timed() as ms:
            device.launch(
                "common.fma",
                "fma_chains",
                (items,),
                out,
                a,
                b,
                steps,
                items,
                defines=defines,
                group=(1,) if is_cpu else None,
            )
        best_ms = min(best_ms, ms["common.fma"])
    # rounded to float32 a is off by 6e-8 of 1, which 1 / (1 - a) makes 6e-6; what rounding adds is as small
    if not np.allclose(device.numpy(out), CHAINS * b / (1 - a), rtol=1e-4):
        raise DeviceError(
            f"{device.name}: a kernel of multiplications and additions gave other sums than it should"
        )
    return 2 * CHAINS * width * items * steps / best_ms / 1e6


def bench(
    device: Device,
    stages: list[str] | None = None,
    size: tuple[int, int] = (1080, 1920),
    seconds: float = 2.0,
    limits: dict | None = None,
) -> Iterator[dict]:
    """One row per stage.

    size: rows and columns. seconds: time spent on repeating one stage. limits: the device's `ceilings`, if measured.
    Keys: stage, device, size, ms_p25, ms_p50, ms_p75 (device events plus host library calls), bytes (what must be read
    and written once: inputs and results), gbps, operations (multiplications and additions, where the stage's contract
    says them, else None), gflops, floor_ms (bytes at the measured copy bandwidth, or operations at the measured rate
    of multiplications and additions if that takes longer), bound ("memory" or "arithmetic"; None where operations are
    not known), ratio_to_floor, build_ms (compilation, or loading what was cached), rel_rms_error and max_error (over
    the largest value) against float64; or, for a stage that fails its verification, stage, device and failed (why).
    """
    limits = ceilings(device) if limits is None else limits
    for name in stages or stage_names():
        failed = (
            [row for row in verify(device, [name]) if not row["ok"]]
            if device.kind != "numpy"
            else []
        )
        if failed:
            worst = failed[0]
            yield {
                "stage": name,
                "device": device.name,
                "failed": f"{len(failed)} cases, such as {worst['case']}: error {worst['max_error']:.3g}, tolerance "
                f"{worst['tolerance']:.3g} ({worst['why']})",
            }
            continue
        rms, largest = _errors(name, device)
        times, moved, operations = _measure(name, device, size, seconds)
        p25, p50, p75 = map(float, np.percentile(times, (25, 50, 75)))
        yield {
            "stage": name,
            "device": device.name,
            "size": f"{size[1]}x{size[0]}",
            "ms_p25": p25,
            "ms_p50": p50,
            "ms_p75": p75,
            "bytes": moved,
            "gbps": moved / p50 / 1e6,
            "operations": operations,
            "gflops": None if operations is None else operations / p50 / 1e6,
            **_floor(moved, operations, p50, limits),
            "build_ms": getattr(device, "build_ms", {}).get(name, 0.0),
            "rel_rms_error": rms,
            "max_error": largest,
        }


def _floor(moved, operations, p50, limits):
    """The least time that the device's limits allow, what sets it, and how many times as long the stage takes."""
    if limits["copy_gbps"] is None:
        return {"floor_ms": None, "bound": None, "ratio_to_floor": None}
    memory = moved / limits["copy_gbps"] / 1e6
    arithmetic = 0.0 if operations is None else operations / limits["fma_gflops"] / 1e6
    floor, bound = max((memory, "memory"), (arithmetic, "arithmetic"))
    return {
        "floor_ms": floor,
        "bound": None if operations is None else bound,
        "ratio_to_floor": p50 / floor,
    }


def _errors(name, device):
    inputs = stage_module(name).bench(*ERROR_SIZE)
    result = np.asarray(public_function(name)(**inputs, device=device), np.float64)
    reference = np.asarray(public_function(name)(**inputs, device="numpy"), np.float64)
    difference = result - reference
    size, peak = np.sqrt(np.mean(reference**2)), np.abs(reference).max()
    return float(np.sqrt(np.mean(difference**2)) / size), float(np.abs(difference).max() / peak)


def _measure(name, device, size, seconds):
    """Milliseconds of each repetition with all arrays on the device, bytes of inputs and result, and operations."""
    module = stage_module(name)
    inputs = module.bench(*size)
    moved = sum(value.nbytes for value in inputs.values() if isinstance(value, np.ndarray))
    counted = getattr(module, "operations", None)
    operations = None if counted is None else int(counted(**inputs))
    resident = {
        key: device.array(value, value.dtype) if isinstance(value, np.ndarray) else value
        for key, value in inputs.items()
    }
    function = public_function(name)
    result = function(**resident, device=device)  # warm: built, cached
    moved += int(np.prod(result.shape)) * np.dtype(device.numpy(result).dtype).itemsize
    times, stop = [], time.perf_counter() + seconds
    while len(times) < 5 or (time.perf_counter() < stop and len(times) < 1000):
        with device.timed() as ms:
            function(**resident, device=device)
        times.append(sum(ms.values()))
    return times, moved, operations
