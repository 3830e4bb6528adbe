"""Frames per second of a stream on one device and on several, in turns.

    python bench/two_devices.py --device opencl:0,opencl:1 --size 1920x1080 --json bench/results/two-devices-NAME.json

Each frame is one of a new scene, whose cube is in the memory of the device that takes it. Every stream
plans its first scene, and probes some of the later ones (`gpusim.pipeline.probing`): a probe is work of the
host, in which the frames that were launched before end and no others begin. The clock starts after WARM
frames.

`frames/s` has these probes in it. `between probes` leaves out the calls that probed. `over` is the rate of
all devices over the rate of the first one, in the same round. `host us` is the processor time of the thread
that asks for frames, per frame between probes: it limits the number of devices. `check` counts the values
of a stream's frames that the first device makes differently.
"""

import time
from dataclasses import replace

import numpy as np
from results import add_repeat, add_size, checked, count, finish, parser, start

from gpusim.backends import open_devices
from gpusim.bench.loops import SECONDS, WARM, make_cube
from gpusim.bench.timing import find_quartiles
from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.probing import Probing
from gpusim.pipeline.simulator import Simulator

COMPARED = 24  # frames of which all values are compared
CUBES = 3  # on each device


class Streams:
    """Streams of scenes that are resident, on one device or several."""

    def __init__(self, arguments, devices):
        self.arguments, self.camera = arguments, open_camera(arguments.camera)
        self.picture = chart("deadleaves", size=arguments.size)
        bands = make_cube(self.picture)
        self.cubes = {
            device: [device.array(bands * np.float32(1 + 0.01 * k)) for k in range(CUBES)]
            for device in devices
        }

    def scenes(self, devices, frames):
        """Yield new scenes, each on the device whose turn it is."""
        wavelengths = self.picture.wavelengths
        for number in range(frames):
            values = self.cubes[devices[number % len(devices)]][number % CUBES]
            yield replace(self.picture, content=Cube(wavelengths, values), name=str(number))

    def stream(self, devices, output, frames):
        """Return a stream of so many frames."""
        tolerance = self.arguments.tolerance or None
        simulator = Simulator(self.camera, device=devices, tolerance=tolerance)
        return simulator.stream(self.scenes(devices, frames), output, seed=1, exposure_time=SECONDS)

    def timed(self, devices, output) -> dict:
        """Return a row of one stream: rates [1/s], probes, and the host's time of a frame [us]."""
        frames = self.arguments.frames
        stream = self.stream(devices, output, WARM + frames)
        for _ in range(WARM):
            next(stream)
        for device in devices:
            device.sync()
        calls, probes = [], []
        begin = time.perf_counter()
        for _ in range(frames):
            known, wall, used = Watched.count, time.perf_counter(), time.thread_time()
            next(stream)
            call = time.perf_counter() - wall, time.thread_time() - used
            (calls if Watched.count == known else probes).append(call)
        for device in devices:
            device.sync()
        whole = time.perf_counter() - begin
        stream.close()
        probed = sum(wall for wall, _ in probes)
        return {
            "rate": frames / whole,
            "between": len(calls) / (whole - probed),
            "probes": len(probes),
            "probe_ms": 1e3 * probed / max(len(probes), 1),
            "host_us": 1e6 * float(np.median([used for _, used in calls])),
        }

    def differing(self, devices, output) -> str:
        """Return the number of values in the first frames that the first device makes differently."""
        differing = size = 0
        one, several = (self.stream(each, output, COMPARED) for each in (devices[:1], devices))
        for own, its in zip(one, several, strict=True):
            own, its = np.array(own), np.array(its)
            differing, size = differing + np.count_nonzero(own != its), size + own.size
        return f"{differing} of {size} values differ"


class Watched:
    """Counts the probes of this process."""

    count = 0

    @classmethod
    def start(cls):
        """Begin to count."""
        found = Probing.found

        def counted(self, *args):
            cls.count += 1
            found(self, *args)

        Probing.found = counted


def main():
    """Print the rows; write them as JSON if requested."""
    made = parser(__doc__, "gpus")
    add_size(made)
    add_repeat(made, 5)
    made.add_argument("--camera", default="phone")
    made.add_argument(
        "--tolerance",
        type=float,
        default=4e-4,
        help="relative RMS error (default: 4e-4); 0: every band",
    )
    made.add_argument(
        "--frames", type=count, default=300, help="frames of a stream that are timed (default: 300)"
    )
    arguments = made.parse_args()
    old = checked(arguments, "two_devices")
    devices = open_devices(arguments.device)
    streams, rows = Streams(arguments, devices), []
    Watched.start()
    for output in ("raw", "codes"):
        check = streams.differing(devices, output)
        turns = [devices[:1], devices]
        rounds = [[streams.timed(each, output) for each in turns] for _ in range(arguments.repeat)]
        for place, each in enumerate(turns):
            mine = [of_turn[place] for of_turn in rounds]
            row = {"name": f"{output}, {len(each)} of {len(devices)} devices", "check": check}
            for key in mine[0]:
                row |= find_quartiles([one[key] for one in mine], key)
            for key in ("rate", "between"):
                ratios = [one[place][key] / one[0][key] for one in rounds]
                row |= find_quartiles(ratios, f"{key}_over")
            row |= find_quartiles([1e3 / one["rate"] for one in mine])
            print(shown(row), flush=True)
            rows.append(row)
    finish(
        arguments,
        "two_devices",
        devices[0],
        rows,
        old,
        devices=[device.name for device in devices],
        size=arguments.size,
        tolerance=arguments.tolerance or None,
        camera=arguments.camera,
        frames=arguments.frames,
        repeat=arguments.repeat,
    )


def shown(row) -> str:
    """Return a row as a line."""

    def over(key):
        return (
            f"{row[f'{key}_p50']:8.1f} frames/s, over {row[f'{key}_over_p50']:.3f} "
            f"({row[f'{key}_over_p25']:.3f} .. {row[f'{key}_over_p75']:.3f})"
        )

    return (
        f"{row['name']:24s} {over('rate')}; between probes {over('between')}; {row['probes_p50']:.0f} probes of "
        f"{row['probe_ms_p50']:.0f} ms; host {row['host_us_p50']:.0f} us; {row['check']}"
    )


if __name__ == "__main__":
    start(main)
