"""Loops of frames and their timing. `time_loop` runs in a process of its own."""

import json
import os
import resource
import subprocess
import sys
import time
import weakref
from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.backends import open_device
from gpusim.bench.timing import find_quartiles
from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.domain.errors import DoesNotFit
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Scene
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Blur

LOOPS = 5  # of each kind, for median and spread
WARM = 6  # frames before the clock runs
SECONDS = 0.01  # exposure time
LONGEST = 2.0  # [s] of a loop
BLOCK = 64  # rows of a cube per block


def make_cube(picture: Scene) -> np.ndarray:
    """Return all bands of a chart, float32 (L, rows, cols)."""
    content = picture.content
    values = np.empty((len(content.wavelengths), *content.shape), np.float32)
    for row in range(0, content.shape[0], BLOCK):
        values[:, row : row + BLOCK] = content.bands_at(slice(row, row + BLOCK))
    return values


class Loops:
    """Measures loops on a device, prints and stores their rows."""

    def __init__(self, device, repeat):
        self.device, self.repeat, self.rows = device, repeat, []

    def measure(self, name, frame, check=lambda: ""):
        """Add a row for `frame(k)`, which launches frame k."""
        for k in range(WARM):
            self.device.sync()
            start = time.perf_counter()
            frame(k)
            self.device.sync()
        count = max(5, min(self.repeat, int(LONGEST / (time.perf_counter() - start))))
        walls = []
        for _ in range(LOOPS):
            self.device.sync()
            start = time.perf_counter()
            for k in range(count):
                frame(k + 1)
            self.device.sync()
            walls.append(1e3 * (time.perf_counter() - start) / count)
        with self.device.timed() as ms:
            for k in range(min(count, 20)):
                frame(k + 1)
        self.add(name, walls, sum(ms.values()) / min(count, 20), check())

    def time_stream(self, name, simulator, scenes, output, nbytes, check):
        """Add a row for a stream of scenes from the host; the rate counts the samples."""
        walls = []
        for loop in range(LOOPS + 1):
            frames = simulator.stream(
                (scenes[k % 3] for k in range(self.repeat + WARM)),
                output,
                seed=1,
                exposure_time=SECONDS,
            )
            for _ in range(WARM):
                next(frames)
            self.device.sync()
            start, last = time.perf_counter(), None
            for one in frames:
                last = one
            self.device.sync()
            if loop:
                walls.append(1e3 * (time.perf_counter() - start) / self.repeat)
        rate = nbytes / np.median(walls) / 1e6
        self.add(name, walls, None, f"{rate:.1f} GB/s; {check(last)}")

    def add(self, name, walls, events, check):
        """Print and store a row."""
        row = {"name": name, **find_quartiles(walls), "events_ms": events, "check": check}
        clock = " " * 16 if events is None else f"{events:9.3f} {row['ms_p50'] / events:6.2f}"
        print(
            f"{name:34s} {row['ms_p50']:9.3f} {clock} {row['ms_p25']:9.3f} {row['ms_p75']:9.3f}  {check}",
            flush=True,
        )
        self.rows.append(row)


class Peak:
    """Peak memory [byte] of a device's arrays since this object was made, or None if it is unknown.

    For OpenCL it counts each allocation and release; for CUDA by Warp it uses the memory pool.
    """

    def __init__(self, device):
        self.device, self.now, self.most = device, 0, 0
        if device.kind == "opencl":
            self._allocate, device._allocate = device._allocate, self._count_allocation
        elif device.is_gpu:
            self.before = device._wp.get_mempool_used_mem_current(device.wp_device)

    def _count_allocation(self, nbytes):
        buffer, host = self._allocate(nbytes)
        if host is None:  # pyopencl's class has no weak references
            cl = self.device._cl
            buffer = type("Buffer", (cl.Buffer,), {})(
                self.device.context, cl.mem_flags.READ_WRITE, nbytes
            )
        self.now += nbytes
        self.most = max(self.most, self.now)
        weakref.finalize(
            buffer if host is None else host, self._count_release, nbytes
        ).atexit = False
        return buffer, host

    def _count_release(self, nbytes):
        self.now -= nbytes

    @property
    def bytes(self) -> int | None:
        """Peak memory until now [byte], or None."""
        if self.device.kind == "opencl":
            return self.most
        if self.device.is_gpu:
            return self.device._wp.get_mempool_used_mem_high(self.device.wp_device) - self.before
        return None


def time_loop(
    device: str,
    size: tuple[int, int],
    bands: int,
    tolerance: str | None,
    camera: str,
    repeat: int,
    content: str = "cube",
    threads: int | None = None,
) -> dict[str, Any]:
    """Return the row of a loop with a new resident scene in every frame: times, planning, memory.

    Args:
        device: Name of the device.
        size: Columns and rows.
        bands: Of the scenes.
        tolerance: Relative RMS error; None: every band.
        camera: Name of the camera.
        repeat: Most frames of a loop.
        content: "cube" or "materials".
        threads: Cores that this process may use; None: all.

    Returns:
        bytes_predicted is the plan's. bytes_peak is the peak of the device's arrays with one of the
        two scenes [byte]; rss the peak memory of the process, with both scenes. busy is processor
        time over wall time of the loops.

    Raises:
        DoesNotFit: Before memory is allocated.
        GpusimError: The device or the camera cannot be opened.
    """
    if threads and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    opened = open_device(device)
    _require_room(opened, size, bands, content)
    picture = chart("deadleaves", size=size, wavelengths=np.linspace(400, 700, bands))
    scenes = [resident_scene(opened, scene) for scene in _two(picture, content)]
    each = scenes[0].content.nbytes
    peak = Peak(opened)
    loop = Simulator(open_camera(camera), device=opened, tolerance=tolerance).loop(
        scenes[0], SECONDS
    )
    begun = time.perf_counter()
    loop.raw(seed=1)
    opened.sync()
    first = 1e3 * (time.perf_counter() - begun)
    loops, begun, used = Loops(opened, repeat), time.perf_counter(), time.process_time()
    loops.measure(
        f"{size[0]}x{size[1]}, {bands} bands",
        lambda k: loop.update(scene=scenes[k % 2]).raw(seed=1, first=k),
    )
    busy = (time.process_time() - used) / (time.perf_counter() - begun)
    most, plan = peak.bytes, loop.plan
    begun = time.perf_counter()
    Simulator(open_camera(camera), device=opened, tolerance=tolerance).plan(scenes[0])
    planning = 1e3 * (time.perf_counter() - begun)
    return {
        **loops.rows[0],
        "megapixels": size[0] * size[1] / 1e6,
        "bands": bands,
        "first_ms": first,
        "planning_ms": planning,
        "bytes_predicted": plan.bytes_needed,
        "bytes_peak": None if most is None else most + each,
        "rss": _rss(),
        "busy": busy,
        "planes": None if plan.find(Blur) is None else plan.count,
    }


def resident_scene(device, scene):
    """Return the scene with its samples on the device."""
    return replace(
        scene,
        content=scene.content.with_samples(
            lambda array: device.array(array, np.uint16 if array.dtype.kind in "iu" else np.float32)
        ),
    )


def _two(picture, content):
    """Return the chart, and a slightly brighter copy."""
    values = make_cube(picture) if content == "cube" else None
    for gain in np.float32((1, 1.01)):
        yield replace(
            picture,
            content=Cube(picture.wavelengths, values * gain)
            if content == "cube"
            else replace(picture.content, shading=gain * picture.content.shading),
        )


def _require_room(device, size, bands, content):
    """Raise DoesNotFit if two scenes and their sources do not fit, or one is too big."""
    each = size[0] * size[1] * (4 * bands if content == "cube" else 6)
    what = f"a scene of {size[0]}x{size[1]}, {bands} bands,"
    require_memory(f"three times {what}", 3 * each)
    most = device.cl_device.max_mem_alloc_size if device.kind == "opencl" else each
    if each > most:
        raise DoesNotFit(what, each, most, f"one buffer of {device.name}")


def _rss():
    """Return the peak memory of this process [byte]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )


def time_in_process(
    settings: dict[str, Any], environment: dict[str, str] | None = None
) -> dict[str, Any]:
    """Return the row of `time_loop`, run in a process of its own.

    Args:
        settings: Its arguments.
        environment: Variables of the process, in addition to those of this one.

    Returns:
        The row, or {"failed": why}.
    """
    run = f"import json, sys; from {__name__} import time_loop; "
    run += "print(json.dumps(time_loop(**json.loads(sys.argv[1]))))"
    command = [sys.executable, "-c", run, json.dumps(settings)]
    ended = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, **(environment or {})}
    )
    if ended.returncode == 0:
        found: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
        return found
    last = (ended.stderr.strip().splitlines() or [f"status {ended.returncode}"])[-1]
    return {"failed": last.removeprefix("gpusim.domain.errors.")}
