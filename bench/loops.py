"""Wall time of a frame and the sum of the device's events, for loops with every kind of change.

    python bench/loops.py --device opencl --size 1280x720 --tolerance 4e-4 --repeat 200 --json bench/results/NAME.json

Every row is a loop in which one thing changes from frame to frame. `wall` is the time per frame on
the clock, from the first change until the device has finished the last frame. `events` is the sum
of times on the device's clock, in a second loop. The spread is over several loops of this kind.
`check` compares the last frame with a new one that has a separate plan: the number of values that
differ, and the relative RMS difference of the mean electrons from a plan with every band. On CPUs
the last rows are the baseline (gpusim/bench/baseline.py) and its ratio to a new cube, in turns.
"""

from dataclasses import replace
from itertools import cycle

import numpy as np
from results import add_size, count, finish, parser, ready, start

from gpusim.bench.baseline import Baseline
from gpusim.bench.loops import LOOPS, SECONDS, WARM, Loops, make_cube, resident_scene
from gpusim.bench.timing import compare_times, find_rms, time_in_turns
from gpusim.data.charts import chart
from gpusim.domain.content import Basis, Cube
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator


def camera_with(base, part, **settings):
    """Return a camera with other settings of a part; `noise` is a part of the sensor."""
    if part == "noise":
        return camera_with(base, "sensor", noise=replace(base.sensor.noise, **settings))
    return replace(base, **{part: replace(getattr(base, part), **settings)})


class Scenes:
    """Scenes of one size in all forms and places, three of each, to give every frame a new one."""

    def __init__(self, device, size):
        self.device, picture = device, chart("deadleaves", size=size)
        self.materials = [
            replace(
                picture,
                content=replace(
                    picture.content, shading=np.float32(1 + 0.01 * k) * picture.content.shading
                ),
            )
            for k in range(3)
        ]
        bands = make_cube(picture)
        self.cubes = [
            replace(picture, content=Cube(picture.wavelengths, bands * np.float32(1 + 0.01 * k)))
            for k in range(3)
        ]
        flat = bands[:, ::16, ::16].reshape(len(bands), -1).T.astype(np.float64)
        basis = np.linalg.svd(flat, full_matrices=False)[2][:6]
        planes = np.ascontiguousarray(np.tensordot(basis, bands, 1), np.float32)
        self.bases = [
            replace(
                picture,
                content=Basis(picture.wavelengths, planes * np.float32(1 + 0.01 * k), basis),
            )
            for k in range(3)
        ]

    def resident(self, scenes):
        """Return the scenes with their samples on the device."""
        return [resident_scene(self.device, scene) for scene in scenes]

    def pinned(self, scenes):
        """Return the scenes with their samples in pinned memory, which is copied at full rate."""

        def there(array):
            values = self.device.pinned(
                array.shape, np.uint16 if array.dtype.kind in "iu" else np.float32
            )
            values[...] = array
            return values

        return [replace(scene, content=scene.content.with_samples(there)) for scene in scenes]


def scene_loops(scenes):
    """Yield name, scenes and output of the loops with a new scene in every frame."""
    kinds = {"cube": scenes.cubes, "materials": scenes.materials, "basis": scenes.bases}
    for name, given in kinds.items():
        there = scenes.resident(given)
        for output in ("raw", "codes"):
            yield f"new {name}, resident -> {output}", there, output
    yield "new cube on the host -> raw", scenes.cubes, "raw"


def changes(base):
    """Return name -> function from k to the arguments of `Loop.update` in frame k."""
    tones = [((0.0, 0.0), (0.4, 0.4 + 0.01 * k), (1.0, 1.0)) for k in range(4)]
    return {
        "frame number": lambda k: {},
        "tone curve": lambda k: {"camera": camera_with(base, "processor", tone=tones[k % 4])},
        "colour matrix": lambda k: {
            "camera": camera_with(base, "processor", training=("objects", "munsell")[k % 2])
        },
        "demosaicker": lambda k: {
            "camera": camera_with(base, "processor", demosaic=("adaptive", "malvar")[k % 2])
        },
        "read noise": lambda k: {"camera": camera_with(base, "noise", read=2.0 + k % 5)},
        "gain": lambda k: {"gain": 1.0 + 0.1 * (k % 5)},
        "exposure time": lambda k: {"exposure_time": 0.01 + 0.001 * (k % 5)},
        "f-number": lambda k: {"camera": camera_with(base, "optics", f_number=2.0 + 0.1 * (k % 5))},
    }


def main():
    """Print the table; write it as JSON if requested."""
    made = parser(__doc__)
    add_size(made, "1280x720")
    made.add_argument("--camera", default="phone")
    made.add_argument("--demosaic", default="bilinear")
    made.add_argument("--tolerance", type=float)
    made.add_argument("--repeat", type=count, default=20)
    made.add_argument(
        "--only", default="", metavar="TEXT", help="only rows with this text in their name"
    )
    arguments = made.parse_args()
    device, old = ready(arguments, "loops")
    base = camera_with(open_camera(arguments.camera), "processor", demosaic=arguments.demosaic)
    simulator = Simulator(base, device=device, tolerance=arguments.tolerance)
    loops, scenes = Loops(device, arguments.repeat), Scenes(device, arguments.size)
    print(
        f"{'what changes':34s} {'wall ms':>9s} {'events ms':>9s} {'ratio':>6s} {'p25':>9s} {'p75':>9s}  check"
    )
    _scenes(loops, simulator, scenes, arguments.only)
    _transfers(loops, simulator, scenes, arguments.only)
    _changes(loops, simulator, base, scenes, arguments.only)
    if device.on_host and device.kind == "opencl" and arguments.only in "baseline":
        _baseline(loops, simulator, scenes)
    finish(
        arguments,
        "loops",
        device,
        loops.rows,
        old,
        size=arguments.size,
        bands=len(scenes.cubes[0].wavelengths),
        tolerance=arguments.tolerance,
        camera=base.name,
        demosaic=arguments.demosaic,
        repeat=arguments.repeat,
    )


def _baseline(loops, simulator, scenes):
    """Measure the baseline and a new cube in turns, and the ratio of their times."""
    loop, baseline = (
        simulator.loop(scenes.cubes[0], SECONDS),
        Baseline(simulator, scenes.cubes[0]),
    )
    values, device = cycle(scene.content.values for scene in scenes.cubes), simulator.device

    def ours():
        for k in range(3):
            loop.update(scene=scenes.cubes[k]).raw(seed=1, first=k)
        device.sync()

    slow, fast = "baseline: NumPy and SciPy, cube -> raw", "new cube, alternating"
    times = time_in_turns(
        {slow: lambda: baseline.raw(next(values), SECONDS), fast: ours}, LOOPS, warm=2
    )
    exact = Simulator(simulator.camera, device=device).expose(scenes.cubes[0], SECONDS).mean
    error = find_rms(baseline.mean(scenes.cubes[0].content.values, SECONDS), device.numpy(exact))
    row = compare_times(times, {fast: slow}, each={fast: 3})[1]
    loops.add(slow, times[slow], None, f"rms {error:.2g}")
    loops.add(
        fast,
        times[fast] / 3,
        None,
        f"{row['over_p50']:.2f} times as fast ({row['over_least']:.2f} .. {row['over_most']:.2f})",
    )


def _differing(simulator, scene, output, last, number):
    """Return the number of values that differ from the output of a loop for only this scene."""
    fresh = simulator.loop(scene, SECONDS)
    again = np.array(simulator.device.numpy(getattr(fresh, output)(seed=1, first=number)))
    return f"{np.count_nonzero(again != last)} of {last.size} values differ"


def _scenes(loops, simulator, scenes, only):
    device = simulator.device
    for name, given, output in scene_loops(scenes):
        if only not in name:
            continue
        loop = simulator.loop(given[0], SECONDS)

        def frame(k, loop=loop, given=given, output=output):
            return getattr(loop.update(scene=given[k % 3]), output)(seed=1, first=k)

        def check(loop=loop, frame=frame, given=given, output=output):
            last = np.array(device.numpy(frame(4)))
            mean = np.array(device.numpy(loop.exposure.mean))
            exact = Simulator(simulator.camera, device=device).expose(given[1], SECONDS).mean
            return (
                f"rms {find_rms(mean, device.numpy(exact)):.2g}; "
                f"{_differing(simulator, given[1], output, last, 4)}"
            )

        loops.measure(name, frame, check)


def _transfers(loops, simulator, scenes, only):
    for name, given in (
        ("cube", scenes.cubes),
        ("materials", scenes.materials),
        ("basis", scenes.bases),
    ):
        title = f"stream of {name} from pinned -> raw"
        if only not in title:
            continue
        pinned = scenes.pinned(given)
        nbytes = sum(getattr(pinned[0].content, part).nbytes for part in pinned[0].content.samples)
        number = loops.repeat + WARM - 1

        def check(last, given=given, number=number):
            return _differing(
                simulator, given[number % 3], "raw", np.array(simulator.device.numpy(last)), number
            )

        loops.time_stream(title, simulator, pinned, "raw", nbytes, check)


def _changes(loops, simulator, base, scenes, only):
    exposure = simulator.expose(scenes.materials[0], SECONDS)
    if only in "draw of a kept exposure":
        loops.measure("draw of a kept exposure", lambda k: exposure.raw(seed=1, first=k))
    for name, change in changes(base).items():
        if only not in f"{name} -> codes":
            continue
        loop = simulator.loop(scenes.materials[0], SECONDS)
        loops.measure(
            f"{name} -> codes",
            lambda k, loop=loop, change=change: loop.update(**change(k)).codes(seed=1, first=k),
        )


if __name__ == "__main__":
    start(main)
