"""Speed against error of every stage: `gpusim bench`.

A stage that fails its verification gets no speed.
"""

import time
from collections.abc import Iterator

import numpy as np

from gpusim.backends import Device
from gpusim.backends.probe import copy_gbps, vector_width
from gpusim.domain.errors import DeviceError
from gpusim.judge.verify import verify
from gpusim.kernels.stage import make_resident, public_function, stage_module, stage_names

# the reference of a full frame takes minutes; errors are measured on this size
ERROR_SIZE = 270, 480
# of `fma_gflops`; enough steps to hide launch times
CHAINS = 10
CPU_STEPS = 100_000
GPU_STEPS = 16_384


def ceilings(device: Device) -> dict:
    """Return the measured limits of a device.

    Args:
        device: The device.

    Returns:
        copy_gbps [GB/s] and fma_gflops [GFLOP/s]; both None on the NumPy device.
    """
    if device.kind == "numpy":
        return {"copy_gbps": None, "fma_gflops": None}
    return {"copy_gbps": copy_gbps(device), "fma_gflops": fma_gflops(device)}


def fma_gflops(device: Device) -> float:
    """Return the measured float32 throughput [GFLOP/s], the best of ten.

    A multiplication and an addition are one operation each. The kernel computes s = s a + b in
    independent chains that stay in registers, as wide as the vectors of the device, on all
    work-items at once.

    Args:
        device: An OpenCL or Warp device.

    Raises:
        DeviceError: The sums are wrong.
    """
    is_cpu, is_opencl = not device.is_gpu, device.kind == "opencl"
    items, steps = (64, CPU_STEPS) if is_cpu else (2**18, GPU_STEPS)
    width = vector_width(device) if is_cpu and is_opencl else 1
    defines = {}
    if is_opencl:
        defines["VECTOR"] = f"float{width}" if width > 1 else "float"
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
    # float32 rounds a by 6e-8, which 1 / (1 - a) makes 6e-6; rounding adds as little
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
    """Yield one row per stage.

    Args:
        device: The device.
        stages: Names of stages; None for all.
        size: Rows and columns.
        seconds: Time to spend on repetitions of one stage [s].
        limits: The `ceilings` of the device; None measures them.

    Yields:
        Rows with stage, device, size, ms_p25, ms_p50, ms_p75 (device events plus host library
        calls), bytes (inputs and results, read and written once), gbps, operations (multiplications
        and additions; None if the stage does not count them), gflops, floor_ms (the larger of the
        time for the bytes at the measured copy bandwidth and for the operations at the measured
        throughput), bound ("memory" or "arithmetic"; None if the operations are not known),
        ratio_to_floor, build_ms (compilation, or loading from a cache), rel_rms_error and max_error
        (relative to the largest value) against float64. A stage that fails its verification has
        only stage, device and failed (the reason).
    """
    limits = ceilings(device) if limits is None else limits
    for name in stages or stage_names():
        failed = []
        if device.kind != "numpy":
            failed = [found for found in verify(device, [name]) if not found["ok"]]
        if failed:
            first = failed[0]
            error = f"error {first['max_error']:.3g}, tolerance {first['tolerance']:.3g}"
            yield {
                "stage": name,
                "device": device.name,
                "failed": f"{len(failed)} cases, such as {first['case']}: {error} ({first['why']})",
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
    """Return the least time within the device limits, the limit that sets it, and the ratio."""
    if limits["copy_gbps"] is None:
        return {"floor_ms": None, "bound": None, "ratio_to_floor": None}
    memory = moved / limits["copy_gbps"] / 1e6
    arithmetic = 0.0 if operations is None else operations / limits["fma_gflops"] / 1e6
    floor, bound = max((memory, "memory"), (arithmetic, "arithmetic"))
    bound = None if operations is None else bound
    return {"floor_ms": floor, "bound": bound, "ratio_to_floor": p50 / floor}


def _errors(name, device):
    """Return the relative RMS error and the largest error over the largest value."""
    inputs = stage_module(name).bench(*ERROR_SIZE)
    result = np.asarray(public_function(name)(**inputs, device=device), np.float64)
    reference = np.asarray(public_function(name)(**inputs, device="numpy"), np.float64)
    difference = result - reference
    size, peak = np.sqrt(np.mean(reference**2)), np.abs(reference).max()
    return float(np.sqrt(np.mean(difference**2)) / size), float(np.abs(difference).max() / peak)


def _measure(name, device, size, seconds):
    """Return the times of the repetitions [ms], bytes of inputs and result, and operations."""
    module = stage_module(name)
    inputs = module.bench(*size)
    moved = sum(value.nbytes for value in inputs.values() if isinstance(value, np.ndarray))
    counted = getattr(module, "operations", None)
    operations = None if counted is None else int(counted(**inputs))
    resident = make_resident(device, inputs)
    function = public_function(name)
    result = function(**resident, device=device)  # warm: built, cached
    moved += int(np.prod(result.shape)) * np.dtype(device.numpy(result).dtype).itemsize
    times, stop = [], time.perf_counter() + seconds
    while len(times) < 5 or (time.perf_counter() < stop and len(times) < 1000):
        with device.timed() as ms:
            function(**resident, device=device)
        times.append(sum(ms.values()))
    return times, moved, operations
