"""The machine of a result: its hardware, drivers and versions, and what disturbed the measurement."""

import contextlib
import os
import platform
import subprocess
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gpusim
from gpusim.backends import Device
from gpusim.backends.launches import BUILD_OPTIONS
from gpusim.backends.probe import identity
from gpusim.domain.cores import count_cores

PACKAGES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "pyopencl": "pyopencl",
    "warp": "warp-lang",
    "pocl": "pocl-binary-distribution",
}
MOST_LOAD = 0.25  # processes that want a core, per core, before the run
MOST_OTHERS = 0.05  # share of the cores' time that other processes take during the run
MOST_STOLEN = 0.01  # share of the cores' time that the host of a virtual machine takes
LEAST_CLOCK = 0.9  # of the highest clock that was seen
HOTTEST = 90.0  # [degree C]
SMI = (
    "temperature.gpu",
    "clocks.sm",
    "clocks.max.sm",
    "utilization.gpu",
    "clocks_throttle_reasons.active",
)
# bits of NVIDIA's reasons for a lower clock that disturb a measurement
THROTTLED = {
    0x4: "power cap",
    0x8: "hardware slowdown",
    0x20: "heat",
    0x40: "heat, by hardware",
    0x80: "power brake",
}


class Watch:
    """Watches a machine during a measurement.

    Args:
        device: The device that is measured.
        root: Root of the file system with /proc and /sys.
        ask_gpu: Function that returns the values of SMI as texts, or None if there is no NVIDIA
            GPU.
    """

    def __init__(
        self,
        device: Device,
        root: Path = Path("/"),
        ask_gpu: Callable[[Device], list[str] | None] | None = None,
    ):
        self.device, self._root = device, root
        self._ask_gpu = ask_nvidia if ask_gpu is None else ask_gpu
        self._load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        self._clocks: list[float] = []
        self._temperatures: list[float] = []
        self._reasons: set[str] = set()
        self._begin = self._times(), sum(os.times()[:4])
        gpu = self._gpu()
        self._busy = None if gpu is None else _number(gpu["utilization.gpu"])
        self._begin_throttles = self._throttles()

    def sample(self) -> None:
        """Read clocks and temperatures now. Call it while the device is warm."""
        gpu = self._gpu()
        if gpu is not None:
            _note(self._clocks, _number(gpu["clocks.sm"]))
            _note(self._temperatures, _number(gpu["temperature.gpu"]))
            with contextlib.suppress(ValueError):
                active = int(gpu["clocks_throttle_reasons.active"], 16)
                self._reasons |= {words for bit, words in THROTTLED.items() if active & bit}
            return
        if self.device.is_gpu:  # another maker's, whose state no file tells
            return
        lines = self._read("proc/cpuinfo").splitlines()
        clocks = [_number(line.partition(":")[2]) for line in lines if line.startswith("cpu MHz")]
        found = [clock for clock in clocks if clock is not None]
        _note(self._clocks, max(found, default=None))
        zones = sorted(self._root.glob("sys/class/thermal/thermal_zone*/temp"))
        told = [_number(_read(zone)) for zone in zones]
        degrees = [value / 1e3 for value in told if value is not None]
        _note(self._temperatures, max(degrees, default=None))

    def facts(self) -> dict[str, Any]:
        """Return the machine as a result has it, with the warnings of the time until now.

        Returns:
            cpu, cores, device, driver, compiler, flags, python, the versions of packages, load
            (processes per core before the run), others (share of the cores' time that other
            processes took), clock_mhz (lowest and highest that were seen), temperature (highest
            [degree C]), governor, and warnings. None: the system does not tell.
        """
        told, cores = identity(self.device), count_cores()
        others, stolen = self._disturbance()
        clocks, heat = self._clocks, self._temperatures
        return {
            "cpu": self._cpu(),
            "cores": cores,
            "device": told["device"],
            "driver": told["driver"],
            **describe_compiler(self.device, told),
            "python": platform.python_version(),
            **{name: found for name in PACKAGES if (found := _version(PACKAGES[name]))},
            "system": f"{platform.system()} {platform.release()}",
            "load": None if self._load is None else round(self._load / cores, 3),
            "others": others,
            "clock_mhz": [min(clocks), max(clocks)] if clocks else None,
            "temperature": max(heat, default=None),
            "governor": self._read("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").strip()
            or None,
            "warnings": list(self._warnings(cores, others, stolen)),
        }

    def _warnings(self, cores, others, stolen):
        """Yield what makes the times less certain, in words."""
        if self._load is not None and self._load > MOST_LOAD * cores:
            yield f"the machine was busy before the run: load {self._load:.1f} on {cores} cores"
        if others is not None and others > MOST_OTHERS:
            yield f"other processes took {100 * others:.0f} % of the cores' time during the run"
        if stolen is not None and stolen > MOST_STOLEN:
            yield f"the host of this virtual machine took {100 * stolen:.0f} % of the cores' time"
        if self._busy is not None and self._busy > 100 * MOST_OTHERS:
            yield f"the GPU was busy before the run: {self._busy:.0f} %"
        if self._clocks and min(self._clocks) < LEAST_CLOCK * max(self._clocks):
            low, high = min(self._clocks), max(self._clocks)
            yield f"the clock changed between {low:.0f} and {high:.0f} MHz"
        if self._reasons:
            yield f"the GPU lowered its clock: {', '.join(sorted(self._reasons))}"
        if self._throttles() > self._begin_throttles:
            yield "the processor lowered its clock because of heat"
        if self._temperatures and max(self._temperatures) > HOTTEST:
            yield f"hot: {max(self._temperatures):.0f} degrees C"

    def _disturbance(self) -> tuple[float | None, float | None]:
        """Return the shares of the cores' time that other processes and the host took."""
        (before, own), (after, used) = self._begin, (self._times(), sum(os.times()[:4]))
        if before is None or after is None:
            return None, None
        ticks = [last - first for first, last in zip(before, after, strict=True)]
        user, nice, system, _idle, _wait, irq, soft, steal = ticks
        total = sum(ticks)
        if total <= 0:
            return None, None
        ours = (used - own) * os.sysconf("SC_CLK_TCK")
        others = max(0.0, user + nice + system + irq + soft - ours) / total
        return round(others, 4), round(steal / total, 4)

    def _times(self):
        """Return the ticks of all cores by kind, or None."""
        first = self._read("proc/stat").partition("\n")[0].split()
        return [int(part) for part in first[1:9]] if len(first) >= 9 else None

    def _throttles(self):
        """Return how often the processor has lowered its clock because of heat."""
        pattern = "sys/devices/system/cpu/cpu*/thermal_throttle/package_throttle_count"
        return sum(_number(_read(path)) or 0 for path in self._root.glob(pattern))

    def _gpu(self):
        """Return what NVIDIA's driver says of the device, or None."""
        values = self._ask_gpu(self.device) if self.device.is_gpu else None
        return None if values is None else dict(zip(SMI, values, strict=True))

    def _cpu(self):
        lines = self._read("proc/cpuinfo").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        return names[0] if names else platform.processor() or platform.machine()

    def _read(self, path):
        return _read(self._root / path)


def _read(path):
    """Return the text of a file of the system, "" if there is none."""
    try:
        return Path(path).read_text(errors="replace")
    except OSError:
        return ""


def _number(text):
    """Return a number, or None."""
    try:
        return float(text)
    except ValueError:
        return None


def _note(values, value):
    """Append a value that is known."""
    if value is not None:
        values.append(value)


def _version(package):
    """Return the version of a package, or None."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def ask_nvidia(device: Device) -> list[str] | None:
    """Return the values of SMI of a GPU by nvidia-smi, or None if they are not known.

    Args:
        device: The GPU.
    """
    bus = _bus_of(device)
    if bus is None:
        return None
    command = ["nvidia-smi", f"--query-gpu={','.join(SMI)}", "--format=csv,noheader,nounits"]
    try:
        said = subprocess.run(
            [*command, f"--id={bus}"],
            capture_output=True,
            text=True,
            timeout=20,
            check=True,
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    values = [part.strip() for part in said.strip().split(",")]
    return values if len(values) == len(SMI) else None


def _bus_of(device):
    """Return the PCI address of an NVIDIA GPU, "0" if its driver does not tell, or None."""
    if device.kind == "warp":
        return device.wp_device.pci_bus_id
    if "nvidia" not in device.cl_device.vendor.lower():
        return None
    try:
        bus, slot = device.cl_device.pci_bus_id_nv, device.cl_device.pci_slot_id_nv
    except Exception:  # pyopencl's class for an unknown question depends on the driver
        return "0"
    return f"00000000:{bus:02X}:{slot >> 3:02X}.0"


def describe_compiler(device: Device, told: dict[str, Any]) -> dict[str, str]:
    """Return the compiler of a device's kernels, and its flags.

    Args:
        device: The device.
        told: The device's `identity`.
    """
    if device.kind == "opencl":
        platform_version = vars(device)["cl_device"].platform.version
        return {"compiler": platform_version.strip(), "flags": " ".join(BUILD_OPTIONS)}
    if device.kind == "warp":
        kind = "NVRTC" if device.is_gpu else "LLVM"
        return {"compiler": f"{told['version']}, {kind}", "flags": "release"}
    return {"compiler": told["version"], "flags": ""}


def find_commit() -> tuple[str | None, bool | None]:
    """Return the commit of the checkout that gpusim is imported from, and whether files differ.

    Returns:
        None and None for an installed package, or without git.
    """
    folder = Path(gpusim.__file__).parents[1]
    if not (folder / ".git").exists():
        return None, None
    try:
        commit, changed = (
            subprocess.run(
                ["git", *command], cwd=folder, capture_output=True, text=True, check=True
            ).stdout.strip()
            for command in (
                ("rev-parse", "--short=12", "HEAD"),
                ("status", "--porcelain", "--untracked-files=no"),
            )
        )
    except (OSError, subprocess.CalledProcessError):
        return None, None
    return commit, bool(changed)
