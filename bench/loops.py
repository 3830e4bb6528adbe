"""What a loop gets: wall time of a frame beside the sum of the device's events, for every kind of change.

    python bench/loops.py --device opencl --size 1280x720 --tolerance 4e-4 --repeat 200 --json bench/results/NAME.json
    python bench/loops.py --tables

Every row is a loop in which one thing changes from frame to frame: `wall` is its time a frame on the clock, from the
first change until the device has ended the last frame; `events` the sum of what the device's own clock says, in a
second loop of its own; the spread is of several such loops. `check` compares the last frame with one that is made anew
by a plan of its own scene: differing values, and the relative RMS difference of the mean electrons from those of the
plan that treats every band. On CPUs the last rows are the baseline (bench/baseline.py) and its ratio to a new cube, in
turns. `--tables` writes the tables of bench/README.md from all files in bench/results.
"""

import argparse
import json
import platform
import re
import subprocess
import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from baseline import Baseline

from gpusim.backends import open_device
from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart
from gpusim.domain.content import Basis, Cube
from gpusim.simulator import Simulator

LOOPS = 5  # of each kind, whose median and spread are shown
WARM = 6  # frames before the clock runs
SECONDS = 0.01  # exposure time
LONGEST = 2.0  # [s] of a loop
HERE = Path(__file__).parent


def camera_with(base, part, **settings):
    """A camera with other settings of a part, `noise` that of its sensor."""
    if part == "noise":
        return camera_with(base, "sensor", noise=replace(base.sensor.noise, **settings))
    return replace(base, **{part: replace(getattr(base, part), **settings)})


class Scenes:
    """Scenes of one size in all forms and places, three of each, so that a loop has a new one for every frame."""

    def __init__(self, device, size):
        self.device, picture = device, chart("deadleaves", size=size)
        self.materials = [replace(picture, content=replace(picture.content, shading=np.float32(1 + 0.01 * k)
                                                           * picture.content.shading)) for k in range(3)]
        bands = np.ascontiguousarray(picture.content.bands_at(slice(None)), np.float32)
        self.cubes = [replace(picture, content=Cube(picture.wavelengths, bands * np.float32(1 + 0.01 * k)))
                      for k in range(3)]
        flat = bands[:, ::16, ::16].reshape(len(bands), -1).T.astype(np.float64)
        basis = np.linalg.svd(flat, full_matrices=False)[2][:6]
        planes = np.ascontiguousarray(np.tensordot(basis, bands, 1), np.float32)
        self.bases = [replace(picture, content=Basis(picture.wavelengths, planes * np.float32(1 + 0.01 * k), basis))
                      for k in range(3)]

    def resident(self, scenes):
        """The same with their samples on the device."""
        def there(array):
            return self.device.array(array, np.uint16 if array.dtype.kind in "iu" else np.float32)

        return [replace(scene, content=scene.content.with_samples(there)) for scene in scenes]

    def pinned(self, scenes):
        """The same with their samples in memory that the device copies from at full rate."""
        def there(array):
            values = self.device.pinned(array.shape, np.uint16 if array.dtype.kind in "iu" else np.float32)
            values[...] = array
            return values

        return [replace(scene, content=scene.content.with_samples(there)) for scene in scenes]


def scene_loops(scenes):
    """Name, scenes and output of loops in which every frame is of a new scene."""
    kinds = {"cube": scenes.cubes, "materials": scenes.materials, "basis": scenes.bases}
    for name, given in kinds.items():
        there = scenes.resident(given)
        for output in ("raw", "codes"):
            yield f"new {name}, resident -> {output}", there, output
    yield "new cube on the host -> raw", scenes.cubes, "raw"


def changes(base):
    """Name -> what `Program.update` is given in frame k."""
    tones = [((0.0, 0.0), (0.4, 0.4 + 0.01 * k), (1.0, 1.0)) for k in range(4)]
    return {
        "frame number": lambda k: {},
        "tone curve": lambda k: {"camera": camera_with(base, "processor", tone=tones[k % 4])},
        "colour matrix": lambda k: {"camera": camera_with(base, "processor", training=("objects", "munsell")[k % 2])},
        "demosaicker": lambda k: {"camera": camera_with(base, "processor", demosaic=("adaptive", "malvar")[k % 2])},
        "read noise": lambda k: {"camera": camera_with(base, "noise", read=2.0 + k % 5)},
        "gain": lambda k: {"gain": 1.0 + 0.1 * (k % 5)},
        "exposure time": lambda k: {"exposure_time": 0.01 + 0.001 * (k % 5)},
        "f-number": lambda k: {"camera": camera_with(base, "optics", f_number=2.0 + 0.1 * (k % 5))},
    }


class Loops:
    """Measures loops on a device, prints and keeps their rows."""

    def __init__(self, device, repeat):
        self.device, self.repeat, self.rows = device, repeat, []

    def measure(self, name, frame, check=lambda: ""):
        """A row of `frame(k)`, which launches frame k."""
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
        self.add(name, np.array(walls), sum(ms.values()) / min(count, 20), check())

    def streamed(self, name, simulator, scenes, output, nbytes, check):
        """A row of a stream of scenes from the host; the rate is that of their samples."""
        walls = []
        for loop in range(LOOPS + 1):
            frames = simulator.stream((scenes[k % 3] for k in range(self.repeat + WARM)), output, seed=1,
                                      exposure_time=SECONDS)
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
        self.add(name, np.array(walls), None, f"{rate:.1f} GB/s; {check(last)}")

    def add(self, name, walls, events, check):
        """Print and keep a row."""
        wall, low, high = np.median(walls), walls.min(), walls.max()
        clock = " " * 16 if events is None else f"{events:9.3f} {wall / events:6.2f}"
        print(f"{name:34s} {wall:9.3f} {clock} {low:9.3f} {high:9.3f}  {check}", flush=True)
        self.rows.append({"loop": name, "wall_ms": wall, "events_ms": events, "wall_ms_least": low,
                          "wall_ms_most": high, "check": check})


def main():
    """Print the table; write it as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--camera", default="phone")
    parser.add_argument("--demosaic", default="bilinear")
    parser.add_argument("--tolerance", type=float)
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("--only", default="")
    parser.add_argument("--commit", default="")
    parser.add_argument("--json")
    parser.add_argument("--tables", action="store_true")
    arguments = parser.parse_args()
    if arguments.tables:
        return write_tables()
    size = tuple(map(int, arguments.size.split("x")))
    base = camera_with(open_camera(arguments.camera), "processor", demosaic=arguments.demosaic)
    device = open_device(arguments.device)
    simulator = Simulator(base, device=device, tolerance=arguments.tolerance)
    loops, scenes = Loops(device, arguments.repeat), Scenes(device, size)
    about = {"machine": machine(device), "commit": arguments.commit or commit(), "device": device.name, "size": size,
             "bands": len(scenes.cubes[0].wavelengths), "tolerance": arguments.tolerance, "camera": base.name,
             "demosaic": arguments.demosaic, "repeat": arguments.repeat}
    print(about)
    print(f"{'what changes':34s} {'wall ms':>9s} {'events ms':>9s} {'ratio':>6s} {'least':>9s} {'most':>9s}  check")
    _scenes(loops, simulator, scenes, arguments.only)
    _transfers(loops, simulator, scenes, arguments.only)
    _changes(loops, simulator, base, scenes, arguments.only)
    if device.on_host and device.kind == "opencl" and arguments.only in "baseline":
        _baseline(loops, simulator, scenes)
    if arguments.json:
        Path(arguments.json).write_text(json.dumps({**about, "rows": loops.rows}, indent=1) + "\n")


def machine(device) -> dict:
    """Processor, what the device runs on, and the versions that matter."""
    cpu = next((line.partition(":")[2].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                if line.startswith("model name")), platform.processor())
    told = getattr(device, "cl_device", None)
    driver = (f"{told.name.strip()}, {told.platform.name} {told.driver_version}" if told is not None
              else str(getattr(device, "wp_device", "")))
    return {"cpu": cpu, "driver": driver, "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "scipy", "pyopencl", "warp-lang")}}


def commit() -> str:
    """What is checked out, or nothing."""
    found = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True)
    return found.stdout.strip()


def write_tables():
    """Put the tables of all stored results between the marks in bench/README.md."""
    readme = HERE / "README.md"
    parts = [table(json.loads(path.read_text())) for path in sorted((HERE / "results").glob("loops-*.json"))]
    text = "<!-- loops -->\n\n" + "\n".join(parts) + "\n<!-- end of loops -->"
    readme.write_text(re.sub(r"<!-- loops -->.*<!-- end of loops -->", lambda _: text, readme.read_text(), flags=re.S))


def table(result) -> str:
    """One result as a table in Markdown."""
    columns, rows = result["size"]
    asked = "exact" if result["tolerance"] is None else f"tolerance {result['tolerance']:g}"
    told = result["machine"]
    lines = [f"**{result['device']}**, {columns}x{rows}, {result['bands']} bands, {result['camera']}, {asked}: "
             f"{told['driver']}; host {told['cpu']}, Python {told['python']}; commit {result['commit']}", "",
             "| loop | wall ms a frame | events ms | ratio | least .. most | checked |", "|---|---|---|---|---|---|"]
    for row in result["rows"]:
        wall, events = row["wall_ms"], row["events_ms"]
        ratio = "" if events is None else f"{wall / events:.2f}"
        lines.append(f"| {row['loop']} | {wall:.3g} | {'' if events is None else f'{events:.3g}'} | {ratio} | "
                     f"{row['wall_ms_least']:.3g} .. {row['wall_ms_most']:.3g} | {row['check']} |")
    return "\n".join(lines) + "\n"


def _baseline(loops, simulator, scenes):
    """The baseline and a new cube in turns, and how many times as fast the latter is."""
    values = [scene.content.values for scene in scenes.cubes]
    program, baseline = simulator.program(scenes.cubes[0], SECONDS), Baseline(simulator, scenes.cubes[0])
    slow, fast = [], []
    for turn in range(2 + LOOPS):
        start = time.perf_counter()
        baseline.raw(values[turn % 3], SECONDS)
        middle = time.perf_counter()
        for k in range(3):
            program.update(scene=scenes.cubes[k]).raw(seed=1, frame=k)
        simulator.device.sync()
        if turn >= 2:
            slow.append(1e3 * (middle - start))
            fast.append(1e3 * (time.perf_counter() - middle) / 3)
    exact = np.array(simulator.device.numpy(Simulator(simulator.camera, device=simulator.device).expose(
        scenes.cubes[0], SECONDS).mean), np.float64)
    rms = np.sqrt(np.mean((baseline.mean(values[0], SECONDS) - exact) ** 2) / np.mean(exact**2))
    loops.add("baseline: NumPy and SciPy, cube -> raw", np.array(slow), None, f"rms {rms:.2g}")
    ratios = np.sort(np.array(slow) / np.array(fast))
    loops.add("new cube beside it", np.array(fast), None,
              f"{np.median(ratios):.2f} times as fast ({ratios[0]:.2f} .. {ratios[-1]:.2f})")


def _differing(simulator, scene, output, last, number):
    """In how many values an output differs from that of a program of this scene alone."""
    fresh = simulator.program(scene, SECONDS)
    again = np.array(simulator.device.numpy(getattr(fresh, output)(seed=1, frame=number)))
    return f"{np.count_nonzero(again != last)} of {last.size} values differ"


def _scenes(loops, simulator, scenes, only):
    device = simulator.device
    for name, given, output in scene_loops(scenes):
        if only not in name:
            continue
        program = simulator.program(given[0], SECONDS)

        def frame(k, program=program, given=given, output=output):
            return getattr(program.update(scene=given[k % 3]), output)(seed=1, frame=k)

        def check(program=program, frame=frame, given=given, output=output):
            last = np.array(device.numpy(frame(4)))
            mean = np.array(device.numpy(program.exposure.mean), np.float64)
            exact = np.array(device.numpy(Simulator(simulator.camera, device=device).expose(given[1], SECONDS).mean),
                             np.float64)
            rms = np.sqrt(np.mean((mean - exact) ** 2) / np.mean(exact**2))
            return f"rms {rms:.2g}; {_differing(simulator, given[1], output, last, 4)}"

        loops.measure(name, frame, check)


def _transfers(loops, simulator, scenes, only):
    for name, given in (("cube", scenes.cubes), ("materials", scenes.materials), ("basis", scenes.bases)):
        title = f"stream of {name} from pinned -> raw"
        if only not in title:
            continue
        pinned = scenes.pinned(given)
        nbytes = sum(getattr(pinned[0].content, part).nbytes for part in pinned[0].content.samples)
        number = loops.repeat + WARM - 1

        def check(last, given=given, number=number):
            return _differing(simulator, given[number % 3], "raw", np.array(simulator.device.numpy(last)), number)

        loops.streamed(title, simulator, pinned, "raw", nbytes, check)


def _changes(loops, simulator, base, scenes, only):
    exposure = simulator.expose(scenes.materials[0], SECONDS)
    if only in "draw of a kept exposure":
        loops.measure("draw of a kept exposure", lambda k: simulator.draw(exposure, seed=1, frame=k))
    for name, change in changes(base).items():
        if only not in f"{name} -> codes":
            continue
        program = simulator.program(scenes.materials[0], SECONDS)
        loops.measure(f"{name} -> codes", lambda k, program=program, change=change: program.update(
            **change(k)).codes(seed=1, frame=k))


if __name__ == "__main__":
    main()
