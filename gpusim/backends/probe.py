"""What devices there are, and whether they work: each is tried in a process of its own, for drivers may abort.

Results are kept in the user's cache folder until the packages, the drivers or the environment change; those of devices
that fail for ten minutes, and not at all if none works but NumPy.
`gpusim.backends.probe_child` is what such a process runs.
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

COPY_BYTES = 2**26  # larger than most last-level caches
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
KINDS = {key: type(value) for key, value in EMPTY.items()}
PATIENCE = 600  # [s] until a device that failed is tried again: its driver may have been mended, the machine less busy
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
    """Entry of the device to prefer (see `devices`): a GPU, then OpenCL on the CPU by the newest driver.

    backend: "auto" (any), "opencl" or "warp". Raises DeviceError with every device's reason when none works; where no
    OpenCL device does and "auto" takes Warp's CPU, which is slow, the log says why.
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
    chosen = max(usable, key=_preference)
    if backend == "auto" and chosen["name"] == "warp:cpu":
        log.warning(
            "gpusim: no OpenCL device works (%s), so Warp runs on one processor core; install %s",
            causes,
            DRIVERS.get(sys.platform, "an OpenCL driver for the processor"),
        )
    return chosen


def _preference(entry):
    numbers = "".join(c if c.isdigit() else " " for c in entry["driver"]).split()
    return (
        entry["gpu"],
        entry["name"].startswith("opencl"),
        tuple(map(int, numbers)),
        entry["copy_gbps"],
    )


def devices(refresh: bool = False) -> list[dict]:
    """One entry per device: name, device, driver, version, units, fp64, fp16, gpu, memory [byte], copy_gbps, error.

    error is "" for a usable device, else why it is not. refresh: measure again instead of reading the cache.
    """
    cache = cache_file("devices")
    entries = None if refresh or cache is None else _cached(cache)
    if entries:
        return entries
    names, failure = _names()
    entries = [_try(name) for name in names]
    if failure:
        entries.insert(1, EMPTY | {"name": "opencl", "error": failure})
    if cache is not None and any(
        not entry["error"] for entry in entries if entry["name"] != "numpy"
    ):
        write_cache(cache, entries)
    return entries


def _cached(cache):
    """Entries kept before, None where there are none, they are no such thing, or what failed may have been mended."""
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
    """Write plain data to a file in the user's cache folder, where that can be written to."""
    temporary = cache.with_suffix(f".{os.getpid()}")
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(entries))
        temporary.replace(cache)
    except OSError:  # a read-only home only costs the time of the next probe
        with contextlib.suppress(OSError):
            temporary.unlink()


def cache_file(name: str) -> Path | None:
    """A file in the user's cache folder for what was measured with these packages and drivers; None without a home."""
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
    """Where gpusim and its kernels are, and since when: what failed for want of them may work now."""
    try:
        folders = [*map(Path, sys.modules["gpusim"].__path__), kernel_folder()]
    except ImportError:
        return ["no kernels"]
    return [f"{folder} {folder.stat().st_mtime_ns}" for folder in folders if folder.is_dir()]


def _names():
    """Names of all devices, asked for in a process of its own, and why OpenCL's could not be listed, if so."""
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
    # -P: of this package, and not of another one in the folder where it is run
    return subprocess.run(
        [sys.executable, "-P", "-c", HELPER, str(Path(__file__).parents[2]), argument],
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        check=False,
    )


def identity(device) -> dict:
    """What an entry of `devices` says of an open device, but for what is measured."""
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


def made_by(device) -> str:
    """What a result's bits depend on beside what it is of: hardware and driver, whichever of a host's devices it is."""
    told = identity(device)
    return f"{device.kind}: {told['device']}, {told['driver']}, {told['version']}"


def copy_gbps(device) -> float:
    """Measured bandwidth of a copy kernel [GB/s], bytes read plus bytes written; best of ten.

    Raises DeviceError when the copy is not the original.
    """
    values = np.arange(COPY_BYTES // 4, dtype=np.float32)
    source, target = device.array(values), device.empty(values.shape)
    best_ms = np.inf
    for _ in range(10):
        with device.timed() as ms:
            device.launch("common.copy", "copy", values.shape, source, target, len(values))
        best_ms = min(best_ms, ms["common.copy"])
    if not np.array_equal(device.numpy(target), values):
        raise DeviceError(f"{device.name}: a copy kernel returned other values than it was given")
    return 2 * COPY_BYTES / best_ms / 1e6


def vector_width(device) -> int:
    """Return the width of the vectors that OpenCL kernels of this processor compile for: 8 or 16 floats.

    PoCL before 3.1 aborts on vectors of 16.
    """
    driver = device.cl_device.driver_version
    is_wide = device.cl_device.native_vector_width_float >= 16
    return 16 if is_wide and not driver.startswith(("1.", "2.", "3.0")) else 8
