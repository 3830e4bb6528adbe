"""What a loop gets: wall time of a frame beside the sum of the device's events, for every kind of change.

    python bench/loops.py --device opencl --size 1280x720 --tolerance 4e-4 --repeat 20

Every row is a loop in which one thing changes from frame to frame: `wall` is its time a frame on the clock, from the
first change until the device has ended the last frame; `events` the sum of what the device's own clock says, in a
second loop of its own; the spread is of several such loops. `check` compares the last frame with one that is made anew:
differing pixels, or the relative RMS difference of the mean electrons from those of the plan that treats every band.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from gpusim.backends import open_device
from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart
from gpusim.domain.content import Basis, Cube
from gpusim.simulator import Simulator

LOOPS = 5  # of each kind, whose median and spread are shown
WARM = 6  # frames before the clock runs
SECONDS = 0.01  # exposure time


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
            frame(k)
        walls = []
        for _ in range(LOOPS):
            self.device.sync()
            start = time.perf_counter()
            for k in range(self.repeat):
                frame(k + 1)
            self.device.sync()
            walls.append(1e3 * (time.perf_counter() - start) / self.repeat)
        with self.device.timed() as ms:
            for k in range(min(self.repeat, 20)):
                frame(k + 1)
        self.add(name, np.array(walls), sum(ms.values()) / min(self.repeat, 20), check())

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
        self.add(name, np.array(walls), float("nan"), f"{rate:.1f} GB/s; {check(last)}")

    def add(self, name, walls, events, check):
        """Print and keep a row."""
        wall, low, high = np.median(walls), walls.min(), walls.max()
        print(f"{name:34s} {wall:9.3f} {events:9.3f} {wall / events:6.2f} {low:9.3f} {high:9.3f}  {check}", flush=True)
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
    parser.add_argument("--json")
    arguments = parser.parse_args()
    size = tuple(map(int, arguments.size.split("x")))
    base = camera_with(open_camera(arguments.camera), "processor", demosaic=arguments.demosaic)
    device = open_device(arguments.device)
    simulator = Simulator(base, device=device, tolerance=arguments.tolerance)
    loops, scenes = Loops(device, arguments.repeat), Scenes(device, size)
    print(f"{device.name}, {arguments.size}, {len(scenes.cubes[0].wavelengths)} bands, {base.name}, "
          f"{'exact' if arguments.tolerance is None else arguments.tolerance}, {arguments.repeat} frames a loop")
    print(f"{'what changes':34s} {'wall ms':>9s} {'events ms':>9s} {'ratio':>6s} {'least':>9s} {'most':>9s}  check")
    _scenes(loops, simulator, scenes, arguments.only)
    _transfers(loops, simulator, scenes, arguments.only)
    _changes(loops, simulator, base, scenes, arguments.only)
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump({"device": device.name, "size": size, "tolerance": arguments.tolerance, "camera": base.name,
                       "rows": loops.rows}, file, indent=2)


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
