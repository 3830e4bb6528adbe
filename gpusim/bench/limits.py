"""The measured limits of a device: what no kernel on it can exceed."""

import time
from collections.abc import Callable

import numpy as np

from gpusim.backends import Device
from gpusim.backends.probe import copy_gbps, vector_width
from gpusim.bench.result import LIMITS
from gpusim.domain.errors import DeviceError
from gpusim.domain.progress import announced

# of `fma_gflops`; enough steps to hide launch times
CHAINS = 10
CPU_STEPS = 100_000
GPU_STEPS = 16_384
# of `local_gbps`: sums of a work-item; elements in a row of local memory, a power of 2; work-items
SUMS = 8
CPU_SPAN, GPU_SPAN = 32, 256
CPU_ITEMS, GPU_ITEMS = 64, 2**18
CPU_READS, GPU_READS = 2**17, 2**12
LAUNCHES = 100  # of `launch_us`
TRANSFER_BYTES = 2**26
BEST_OF = 10


def ceilings(device: Device) -> dict[str, float | None]:
    """Return the measured limits of a device, each the best of ten.

    Args:
        device: The device.

    Returns:
        copy_gbps [GB/s], fma_gflops [GFLOP/s], local_gbps [GB/s], launch_us [us], upload_gbps and
        download_gbps [GB/s]. None: the device has no such limit. The NumPy device has none. A CPU
        copies nothing to or from itself. Warp's CPU device has no local memory.

    Raises:
        DeviceError: A kernel that measures gives wrong results, or the device's clock no times.
    """
    found: dict[str, float | None] = dict.fromkeys(LIMITS)
    if device.kind == "numpy":
        return found
    measured: dict[str, Callable[[Device], float]] = {
        "copy_gbps": copy_gbps,
        "fma_gflops": fma_gflops,
        "launch_us": launch_us,
    }
    if device.kind == "opencl" or device.is_gpu:
        measured["local_gbps"] = local_gbps
    if not device.on_host:
        measured |= {"upload_gbps": upload_gbps, "download_gbps": download_gbps}
    for name, measure in measured.items():
        with announced(f"measuring {name.partition('_')[0]}"):
            found[name] = measure(device)
    return found


def choose_best(*measured: dict[str, float | None]) -> dict[str, float | None]:
    """Return the best of each limit: the largest rate, the least time.

    Args:
        measured: Results of `ceilings` of one device.
    """
    best = {}
    for name, first in measured[0].items():
        values = [value for one in measured if (value := one[name]) is not None]
        best[name] = first if not values else min(values) if name == "launch_us" else max(values)
    return best


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
    is_cpu = not device.is_gpu
    items, steps = (64, CPU_STEPS) if is_cpu else (2**18, GPU_STEPS)
    width, defines = _vectors(device)
    out, a, b = device.empty((items * width,)), 0.99, 0.5

    def run():
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

    best_ms = _best_ms(device, run)
    # float32 rounds a by 6e-8, which 1 / (1 - a) makes 6e-6; rounding adds as little
    if not np.allclose(device.numpy(out), CHAINS * b / (1 - a), rtol=1e-4):
        raise DeviceError(
            f"{device.name}: a kernel of multiplications and additions gave other sums than it should"
        )
    return 2 * CHAINS * width * items * steps / best_ms / 1e6


def local_gbps(device: Device) -> float:
    """Return the measured rate of reads from local memory [GB/s], the best of ten.

    Work-items of a group share a few rows of numbers in local memory, and add them up in eight
    independent sums, as wide as the vectors of the device.

    Args:
        device: An OpenCL device, or a CUDA device of Warp.

    Raises:
        DeviceError: The sums are wrong.
    """
    is_cpu = not device.is_gpu
    span, items, steps, group = (
        (CPU_SPAN, CPU_ITEMS, CPU_READS, 1)
        if is_cpu
        else (GPU_SPAN, GPU_ITEMS, GPU_READS, min(GPU_SPAN, device.group_limit))
    )
    width, defines = _vectors(device)
    out, nbytes = device.empty((items * width,)), 4 * SUMS * span * width
    defines = {"VECTOR": "float"} | defines
    defines |= {"SPAN": span, "THREADS": group, "LOCAL_BYTES": nbytes}

    def run():
        device.launch(
            "common.local", "local_sums", (items,), out, steps, defines=defines, group=(group,)
        )

    best_ms = _best_ms(device, run)
    # half of the numbers are 1, half are 2; sums of whole numbers below 2^24 are exact in float32
    if not np.array_equal(device.numpy(out), np.full(items * width, 1.5 * SUMS * steps)):
        raise DeviceError(
            f"{device.name}: a kernel that reads local memory gave other sums than it should"
        )
    return 4 * SUMS * width * items * steps / best_ms / 1e6


def launch_us(device: Device) -> float:
    """Return the least time of a kernel on the device's clock [us]: one work-item copies a number.

    Args:
        device: An OpenCL or Warp device.
    """
    source, target = device.array(np.ones(1, np.float32)), device.empty((1,))

    def run():
        for _ in range(LAUNCHES):
            device.launch("common.copy", "copy", (1,), source, target, 1)

    return 1e3 * _best_ms(device, run) / LAUNCHES


def upload_gbps(device: Device) -> float:
    """Return the rate of a copy from pinned host memory to the device [GB/s], on the host's clock.

    Args:
        device: A device with a memory of its own.
    """
    source = device.pinned((TRANSFER_BYTES // 4,))
    source[...] = 1.0
    target = device.empty(source.shape)

    def run():
        device.send(source, target).wait()

    return TRANSFER_BYTES / _best_wall_ms(device, run) / 1e6


def download_gbps(device: Device) -> float:
    """Return the rate at which frames come to the host [GB/s], on the host's clock.

    As frames are read: a copy to pinned memory, and from there to an array of the caller's.

    Args:
        device: A device with a memory of its own.
    """
    source = device.array(np.ones(TRANSFER_BYTES // 4, np.float32))
    return TRANSFER_BYTES / _best_wall_ms(device, lambda: device.fetch(source)()) / 1e6


def _vectors(device):
    """Return the width of vectors [float], and the define of their type for OpenCL."""
    if device.kind != "opencl":
        return 1, {}
    width = 1 if device.is_gpu else vector_width(device)
    return width, {"VECTOR": f"float{width}" if width > 1 else "float"}


def _best_ms(device, run):
    """Return the least time of all kernels that `run` starts, on the device's clock [ms]."""
    best = np.inf
    for _ in range(BEST_OF):
        with device.timed() as ms:
            run()
        best = min(best, sum(ms.values()))
    if best <= 0:
        raise DeviceError(f"{device.name}: its clock gives no time; check the driver")
    return best


def _best_wall_ms(device, run):
    """Return the least time of `run` on the host's clock [ms], once warm."""
    run()
    best = np.inf
    for _ in range(BEST_OF):
        device.sync()
        start = time.perf_counter()
        run()
        best = min(best, 1e3 * (time.perf_counter() - start))
    return best
