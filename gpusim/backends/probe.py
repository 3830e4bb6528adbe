"""Which devices exist and work: each is tried in its own process, because drivers may abort.

Results stay in the user's cache folder until packages, drivers or the environment change. Failures
stay for ten minutes, and not at all if only NumPy works. The process runs
`gpusim.backends.probe_child`.
"""

import contextlib
import hashlib
import json
import logging
import os
import platform
import subprocess
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from gpusim.backends.device import kernel_folder
from gpusim.domain.errors import DeviceError
from gpusim.domain.progress import announced

COPY_BYTES = 2**26  # larger than most last-level caches
MOST_GBPS = 1e5  # [GB/s] that no memory reaches: ten times a large GPU's cache
TIME_LIMIT = 120  # [s] for one device, most of it the first compilation
EMPTY = {
    "name": "",
    "device": "",
    "driver": "",
    "version": "",
    "units": 0,
    "fp64": False,
    "fp16": False,
    "gpu": False,
    "memory": 0,
    "copy_gbps": 0.0,
    "error": "",
}
SAME_RATE = 0.8  # of the fastest one's copies: devices that are alike but for what else they do now
IDENTITY = ("device", "driver", "version")  # of devices that give the same bits
KINDS = {key: type(value) for key, value in EMPTY.items()}
PATIENCE = 600  # [s] until a failed device is tried again: the machine may be less busy then
HELPER = """
import runpy, sys
_, folder, argument = sys.argv
if folder not in sys.path:  # a checkout that is not installed, or not this one
    sys.path.insert(0, folder)
sys.argv = ["gpusim", argument]
runpy.run_module("gpusim.backends.probe_child", run_name="__main__", alter_sys=True)
"""
DRIVERS = {
    "linux": "PoCL (Debian, Ubuntu: pocl-opencl-icd; conda-forge: pocl)",
    "darwin": "PoCL (conda-forge: pocl)",
    "win32": "Intel's CPU Runtime for OpenCL",
}
log = logging.getLogger(__name__)


def best(backend: str = "auto", refresh: bool = False) -> dict:
    """Return the entry of the preferred device: a GPU, then OpenCL on the CPU by the newest driver.

    Of several devices of one make it is the first, unless another one copies much faster now.
    Drivers for the CPU without float64 come last: they are slow.

    If no OpenCL device works and "auto" takes Warp's CPU device, which is slow, the log gives the
    reason.

    Args:
        backend: "auto" (any), "opencl" or "warp".
        refresh: Measure again instead of reading the cache.

    Returns:
        An entry of `devices`.

    Raises:
        DeviceError: No device works; the message has every device's reason.
    """
    entries = [
        entry
        for entry in devices(refresh)
        if backend in ("auto", entry["name"].partition(":")[0]) and entry["name"] != "numpy"
    ]
    usable = [entry for entry in entries if not entry["error"]]
    causes = (
        "; ".join(f"{entry['name']}: {entry['error']}" for entry in entries if entry["error"])
        or "none was found"
    )
    causes = " ".join(causes.split())[:300]
    if not usable:
        raise DeviceError(
            f"no usable {'' if backend == 'auto' else backend + ' '}device ({causes}); "
            "--device numpy always works"
        )
    fastest = max(usable, key=_preference)
    chosen = next(  # the first of devices that are alike: measured rates differ a little each time
        entry
        for entry in usable
        if _make(entry) == _make(fastest) and entry["copy_gbps"] >= SAME_RATE * fastest["copy_gbps"]
    )
    if backend == "auto" and chosen["name"] == "warp:cpu":
        log.warning(
            "gpusim: no OpenCL device works (%s), so Warp runs on one processor core; install %s",
            causes,
            DRIVERS.get(sys.platform, "an OpenCL driver for the processor"),
        )
    return chosen


def gpus(refresh: bool = False) -> list[str]:
    """Return the names of the best GPU and of all others of its make and driver.

    Args:
        refresh: Measure again instead of reading the cache.

    Raises:
        DeviceError: No GPU works.
    """
    entries = devices(refresh)
    usable = [entry for entry in entries if entry["gpu"] and not entry["error"]]
    if not usable:
        causes = "; ".join(f"{one['name']}: {one['error']}" for one in entries if one["error"])
        causes = " ".join(causes.split())[:200] or "none was found"
        raise DeviceError(f"gpus: no GPU works here ({causes})")

    best = max(usable, key=_preference)
    return [entry["name"] for entry in usable if _make(entry) == _make(best)]


def _make(entry):
    """What devices of one make, driver and backend share."""
    return entry["name"].partition(":")[0], *(entry[key] for key in IDENTITY)


def _preference(entry):
    numbers = "".join(c if c.isdigit() else " " for c in entry["driver"]).split()
    return (
        entry["gpu"],
        entry["name"].startswith("opencl"),
        entry["gpu"] or entry["fp64"],
        tuple(map(int, numbers)),
        entry["copy_gbps"],
    )


def devices(refresh: bool = False) -> list[dict]:
    """Return one entry per device.

    Args:
        refresh: Measure again instead of reading the cache.

    Returns:
        Entries with name, device, driver, version, units, fp64, fp16, gpu, memory [byte], copy_gbps
        [GB/s] and error, "" for a device that works, else the reason.
    """
    cache = cache_file("devices")
    entries = None if refresh or cache is None else _read_cache(cache)
    if entries:
        return entries
    with announced("trying devices"):
        names, failure = _names()
        entries = [_try(name) for name in names]
    if failure:
        entries.insert(1, EMPTY | {"name": "opencl", "error": failure})
    if cache is not None and any(
        not entry["error"] for entry in entries if entry["name"] != "numpy"
    ):
        write_cache(cache, entries)
    return entries


def _read_cache(cache):
    """Return the cache's entries; None if they are missing, invalid, or a failure is old."""
    try:
        entries, age = json.loads(cache.read_text()), abs(time.time() - cache.stat().st_mtime)
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(entries, list) or not all(
        isinstance(entry, dict) and {key: type(value) for key, value in entry.items()} == KINDS
        for entry in entries
    ):
        return None
    return None if age > PATIENCE and any(entry["error"] for entry in entries) else entries


def write_cache(cache: Path, entries):
    """Write plain data to a file in the user's cache folder, if it is writable."""
    temporary = cache.with_suffix(f".{os.getpid()}")
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(entries))
        temporary.replace(cache)
    except OSError:  # a read-only home only costs the time of the next probe
        with contextlib.suppress(OSError):
            temporary.unlink()


def cache_file(name: str) -> Path | None:
    """Return a file in the user's cache folder for measurements with these packages and drivers.

    None if there is no home folder.
    """
    try:
        return _cache_path(name)
    except RuntimeError:
        return None


def _cache_path(name="devices"):
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gpusim"
    facts = [
        sys.prefix,
        *_installation(),
        platform.node(),
        platform.processor(),
        *(
            f"{name}={os.environ.get(name)}"
            for name in (
                "OCL_ICD_VENDORS",
                "OCL_ICD_FILENAMES",
                "CUDA_VISIBLE_DEVICES",
                "POCL_DEVICES",
                "POCL_MAX_PTHREAD_COUNT",
            )
        ),
    ]
    for package in ("gpusim", "pyopencl", "pocl-binary-distribution", "warp-lang"):
        try:
            facts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            facts.append(f"no {package}")
    vendors = Path(os.environ.get("OCL_ICD_VENDORS", "/etc/OpenCL/vendors"))
    facts += (
        sorted(f"{icd} {icd.stat().st_mtime_ns}" for icd in vendors.glob("*.icd"))
        if vendors.is_dir()
        else []
    )
    with contextlib.suppress(OSError):
        facts.append(Path("/proc/driver/nvidia/version").read_text())
    return folder / f"{name}-{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}.json"


def _installation():
    """Return the folders of gpusim and its kernels, with times: an update may end a failure."""
    try:
        folders = [*map(Path, sys.modules["gpusim"].__path__), kernel_folder()]
    except ImportError:
        return ["no kernels"]
    return [f"{folder} {folder.stat().st_mtime_ns}" for folder in folders if folder.is_dir()]


def _names():
    """Return all devices' names, listed in a separate process, and OpenCL's failure, if any."""
    try:
        result = _run("list")
    except subprocess.TimeoutExpired:
        return ["numpy", "warp:cpu"], f"listing its platforms took more than {TIME_LIMIT} s"
    if result.returncode == 0:
        names, failure = json.loads(result.stdout.splitlines()[-1])
        return ["numpy", *names], failure
    last = (result.stderr.strip().splitlines() or ["no message"])[-1]
    return ["numpy", "warp:cpu"], f"a driver ended the listing (status {result.returncode}): {last}"


def _try(name):
    entry = EMPTY | {"name": name}
    try:
        result = _run(name)
    except subprocess.TimeoutExpired:
        return entry | {"error": f"no answer within {TIME_LIMIT} s"}
    lines = result.stdout.splitlines()
    if result.returncode == 0 and lines:
        return entry | json.loads(lines[-1])
    last = (result.stderr.strip().splitlines() or ["no message"])[-1]
    return entry | {"error": f"its driver ended the process (status {result.returncode}): {last}"}


def _run(argument):
    # -P: this package, and not another one in the current folder
    return subprocess.run(
        [sys.executable, "-P", "-c", HELPER, str(Path(__file__).parents[2]), argument],
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        check=False,
    )


def identity(device) -> dict:
    """Return the entry of an open device without its measurements."""
    if device.kind == "opencl":
        cl_device = device.cl_device
        extensions = cl_device.extensions.split()
        return {
            "device": cl_device.name.strip(),
            "driver": f"{cl_device.platform.name} {cl_device.driver_version}",
            "version": cl_device.version.strip(),
            "units": cl_device.max_compute_units,
            "gpu": device.is_gpu,
            "fp64": "cl_khr_fp64" in extensions,
            "fp16": "cl_khr_fp16" in extensions,
        }
    processor = platform.processor() or platform.machine()
    if device.kind == "warp":
        import warp as wp

        gpu = device.is_gpu
        driver = ".".join(map(str, wp.get_cuda_driver_version() or ())) if gpu else "none"
        return {
            "device": device.wp_device.name if gpu else processor,
            "driver": f"CUDA {driver}" if gpu else "LLVM",
            "version": f"Warp {wp.__version__}",
            "units": device.wp_device.sm_count if gpu else 1,
            "gpu": gpu,
            "fp64": True,
            "fp16": gpu,
        }
    return {
        "device": processor,
        "driver": f"NumPy {np.__version__}",
        "version": f"NumPy {np.__version__}",
        "units": 1,
        "gpu": False,
        "fp64": True,
        "fp16": False,
    }


def hardware_id(device) -> str:
    """Return hardware and driver of a device. Results are bit-identical only if these are equal.

    Devices of one make are interchangeable.
    """
    found = identity(device)
    return f"{device.kind}: {', '.join(found[key] for key in IDENTITY)}"


def copy_gbps(device) -> float:
    """Return the bandwidth of a copy kernel [GB/s], bytes read plus bytes written; best of ten.

    Raise DeviceError if the copy differs from the original, or its time is impossible.
    """
    values = np.arange(COPY_BYTES // 4, dtype=np.float32)
    source, target = device.array(values), device.empty(values.shape)
    best_ms = np.inf
    for _ in range(10):
        with device.timed() as ms:
            device.launch("common.copy", "copy", values.shape, source, target, len(values))
        best_ms = min(best_ms, ms["common.copy"])
    if not np.array_equal(device.numpy(target), values):
        raise DeviceError(f"{device.name}: a copy kernel changed its values; check the driver")
    if best_ms < 2 * COPY_BYTES / MOST_GBPS / 1e6:
        raise DeviceError(
            f"{device.name}: its driver states impossible times, {best_ms:g} ms for a copy of "
            f"{COPY_BYTES >> 20} MiB, so plans and reports would be wrong; update the driver"
        )
    return 2 * COPY_BYTES / best_ms / 1e6


def vector_width(device) -> int:
    """Return the width of vectors in OpenCL kernels of this processor: 8 or 16 floats.

    PoCL before 3.1 aborts on vectors of 16.
    """
    driver = device.cl_device.driver_version
    is_wide = device.cl_device.native_vector_width_float >= 16
    return 16 if is_wide and not driver.startswith(("1.", "2.", "3.0")) else 8
