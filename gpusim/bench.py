"""Speed against error: `gpusim bench`. A stage that fails its verification gets no speed."""

import time
from collections.abc import Iterator

import numpy as np

from gpusim.backends import Device
from gpusim.backends.probe import copy_gbps
from gpusim.kernels.stage import public_function, stage_module, stage_names
from gpusim.verify import verify

ERROR_SIZE = (270, 480)  # the reference of a full frame takes minutes; errors are measured on this size


def bench(device: Device, stages: list[str] | None = None, size: tuple[int, int] = (1080, 1920),
          seconds: float = 2.0) -> Iterator[dict]:
    """One row per stage.

    size: rows and columns. seconds: time spent on repeating one stage.
    Keys: stage, device, size, ms_p20, ms_p50, ms_p80 (device events plus host library calls), bytes (what must be read
    and written once: inputs and results), gbps, floor_ms (bytes at the measured copy bandwidth), ratio_to_floor,
    build_ms (compilation, or loading what was cached), rel_rms_error and max_error (over the largest value) against
    float64; or, for a stage that fails its verification, stage, device and failed (why).
    """
    ceiling = copy_gbps(device) if device.kind != "numpy" else None
    for name in stages or stage_names():
        failed = [row for row in verify(device, [name]) if not row["ok"]] if device.kind != "numpy" else []
        if failed:
            worst = failed[0]
            yield {"stage": name, "device": device.name,
                   "failed": f"{len(failed)} cases, such as {worst['case']}: error {worst['max_error']:.3g}, tolerance "
                             f"{worst['tolerance']:.3g} ({worst['why']})"}
            continue
        rms, largest = _errors(name, device)
        times, moved = _measure(name, device, size, seconds)
        p20, p50, p80 = np.percentile(times, (20, 50, 80))
        floor = moved / ceiling / 1e6 if ceiling else None
        yield {"stage": name, "device": device.name, "size": f"{size[1]}x{size[0]}", "ms_p20": p20, "ms_p50": p50,
               "ms_p80": p80, "bytes": moved, "gbps": moved / p50 / 1e6, "floor_ms": floor,
               "ratio_to_floor": p50 / floor if floor else None,
               "build_ms": getattr(device, "build_ms", {}).get(name, 0.0), "rel_rms_error": rms, "max_error": largest}


def _errors(name, device):
    inputs = stage_module(name).bench(*ERROR_SIZE)
    result = np.asarray(public_function(name)(**inputs, device=device), np.float64)
    reference = np.asarray(public_function(name)(**inputs, device="numpy"), np.float64)
    difference = result - reference
    size, peak = np.sqrt(np.mean(reference**2)), np.abs(reference).max()
    return float(np.sqrt(np.mean(difference**2)) / size), float(np.abs(difference).max() / peak)


def _measure(name, device, size, seconds):
    """Milliseconds of each repetition with all arrays on the device, and the bytes of inputs and result."""
    inputs = stage_module(name).bench(*size)
    moved = sum(value.nbytes for value in inputs.values() if isinstance(value, np.ndarray))
    resident = {key: device.array(value, value.dtype) if isinstance(value, np.ndarray) else value
                for key, value in inputs.items()}
    function = public_function(name)
    result = function(**resident, device=device)  # warm: built, cached
    moved += int(np.prod(result.shape)) * np.dtype(device.numpy(result).dtype).itemsize
    times, stop = [], time.perf_counter() + seconds
    while len(times) < 5 or (time.perf_counter() < stop and len(times) < 1000):
        with device.timed() as ms:
            function(**resident, device=device)
        times.append(sum(ms.values()))
    return times, moved
