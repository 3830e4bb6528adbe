"""What a loop gets: wall time of a frame beside the sum of the stages that ran, for every kind of change.

    python bench/loops.py --device opencl --size 1280x720 --tolerance 4e-4 --repeat 20

Every row is a loop in which one thing changes from frame to frame: `wall` its median time a frame on the clock, from
the change to values that the host can read; `stages` the sum of what the device's own clock says, in a second loop of
its own. The last figure is the spread of the wall times (10 % and 90 % quantiles).
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.simulator import Simulator


def camera_with(base, part, **settings):
    """A camera with other settings of a part, `noise` that of its sensor."""
    if part == "noise":
        return camera_with(base, "sensor", noise=replace(base.sensor.noise, **settings))
    return replace(base, **{part: replace(getattr(base, part), **settings)})


def changes(base, scenes):
    """Name -> what `Program.update` is given in frame k, and which output is asked for."""
    tones = [((0.0, 0.0), (0.4, 0.4 + 0.01 * k), (1.0, 1.0)) for k in range(4)]
    return {
        "nothing but the frame number": lambda k: {},
        "tone curve": lambda k: {"camera": camera_with(base, "processor", tone=tones[k % 4])},
        "colour matrix": lambda k: {"camera": camera_with(base, "processor", training=("objects", "munsell")[k % 2])},
        "demosaicker": lambda k: {"camera": camera_with(base, "processor", demosaic=("adaptive", "malvar")[k % 2])},
        "read noise": lambda k: {"camera": camera_with(base, "noise", read=2.0 + k % 5)},
        "gain": lambda k: {"gain": 1.0 + 0.1 * (k % 5)},
        "exposure time": lambda k: {"exposure_time": 0.01 + 0.001 * (k % 5)},
        "f-number": lambda k: {"camera": camera_with(base, "optics", f_number=2.0 + 0.1 * (k % 5))},
        "scene (cube on the host)": lambda k: {"scene": scenes[k % len(scenes)]},
    }


def measured(simulator, scene, change, repeat):
    """Wall times [ms] of the frames of a loop, and the sums of stages of a second one."""
    walls, sums = [], []
    for values, timed in ((walls, False), (sums, True)):
        program = simulator.program(scene, exposure_time=0.01)
        for k in range(-2, repeat):
            device = program.simulator.device
            start = time.perf_counter()
            if timed:
                with device.timed() as ms:
                    device.numpy(program.update(**change(k)).codes(seed=1, frame=k % 7 + 7))
                value = sum(ms.values())
            else:
                device.numpy(program.update(**change(k)).codes(seed=1, frame=k % 7 + 7))
                value = 1e3 * (time.perf_counter() - start)
            if k >= 0:
                values.append(value)
    return np.array(walls), np.array(sums)


def main():
    """Print the table; write it as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--camera", default="phone")
    parser.add_argument("--tolerance", type=float)
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("--json")
    arguments = parser.parse_args()
    size = tuple(map(int, arguments.size.split("x")))
    base = camera_with(open_camera(arguments.camera), "processor", demosaic="adaptive")
    picture = chart("deadleaves", size=size)
    bands = np.ascontiguousarray(picture.content.bands_at(slice(None)), np.float32)
    scenes = [replace(picture, content=Cube(picture.wavelengths, bands * np.float32(1 + 0.01 * k))) for k in range(3)]
    simulator = Simulator(base, device=arguments.device, tolerance=arguments.tolerance)
    rows = []
    print(f"{simulator.device.name}, {arguments.size}, {len(bands)} bands, {base.name}, "
          f"{'exact' if arguments.tolerance is None else arguments.tolerance}: codes, {arguments.repeat} frames each")
    print(f"{'what changes':30s} {'wall ms':>9s} {'stages ms':>9s} {'ratio':>6s} {'10 %':>9s} {'90 %':>9s}")
    for name, change in changes(base, scenes).items():
        walls, sums = measured(simulator, scenes[0], change, arguments.repeat)
        wall, stages, (low, high) = np.median(walls), np.median(sums), np.quantile(walls, [0.1, 0.9])
        print(f"{name:30s} {wall:9.2f} {stages:9.2f} {wall / stages:6.2f} {low:9.2f} {high:9.2f}", flush=True)
        rows.append({"change": name, "wall_ms": wall, "stages_ms": stages, "wall_ms_p10": low, "wall_ms_p90": high})
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump({"device": simulator.device.name, "size": size, "tolerance": arguments.tolerance, "rows": rows},
                      file, indent=2)


if __name__ == "__main__":
    main()
