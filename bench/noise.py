"""The sensor's noise against NumPy's generator in one run, and frames per second.

    python bench/noise.py --device opencl:0 --repeat 15 [--size 1920x1080]

Rounds alternate between all forms, so that other work on the machine meets each; a ratio is of one round, the table has
the median of the rounds and the smallest and largest. NumPy draws `poisson(mean)` and `normal(0, 2)`; "full" has every
noise there is: photons, dark current, read, rows, columns, fixed offsets, traps in 1 of 1000 pixels, full well and a
12-bit converter; the mean electrons rise from 1 to 10000. "chip" is what comes before it once per exposure: the mean
through the response and the hot pixels. "16 frames" draws them in one call; the time is that of one frame. All arrays
stay on the device. On CUDA also the kernel's own time, 20 calls in one graph.
"""

import argparse
import time

import numpy as np

from gpusim.backends import open_device
from gpusim.kernels.sensor import chip, noise

BATCH = 16


def forms(device, rows, cols):
    """Name -> (function, frames that it draws)."""
    full, own = noise.bench(rows, cols), chip.bench(rows, cols)
    mean, random = full["expected"], np.random.default_rng(0)

    def resident(inputs):
        return {name: device.array(value) if isinstance(value, np.ndarray) else value for name, value in inputs.items()}

    full, own = resident(full), resident(own)
    plain = {name: value for name, value in full.items()
             if name not in ("offset", "amplitude", "row_noise", "column_noise")}

    def stage(function, inputs):
        def run():
            function(**inputs, device=device)
            device.sync()
        return run

    return {
        "NumPy": (lambda: (random.poisson(mean), random.normal(0.0, 2.0, mean.shape)), 1),
        "full": (stage(noise.noise, full), 1),
        "full, 16 frames": (stage(noise.noise, {**full, "frames": BATCH}), BATCH),
        "full, exact": (stage(noise.noise, {**full, "photon": "exact"}), 1),
        "photon and read": (stage(noise.noise, plain), 1),
        "chip": (stage(chip.chip, own), 1),
    }


def graph_us(device, run):
    """Microseconds of one call among 20 in a CUDA graph, where Python has no part."""
    wp, times = device._wp, []
    wait, device.sync = device.sync, lambda: None  # a graph cannot hold it
    with wp.ScopedCapture(device.wp_device) as capture:
        for _ in range(20):
            run()
    device.sync = wait
    for _ in range(10):
        first, last = (wp.Event(device.wp_device, enable_timing=True) for _ in range(2))
        wp.record_event(first)
        wp.capture_launch(capture.graph)
        wp.record_event(last)
        wp.synchronize_device(device.wp_device)
        times.append(1e3 * wp.get_event_elapsed_time(first, last) / 20)
    return float(np.median(times))


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--size", default="1920x1080")
    arguments = parser.parse_args()
    cols, rows = map(int, arguments.size.split("x"))
    device = open_device(arguments.device)
    runs = forms(device, rows, cols)
    times, events = ({name: [] for name in runs} for _ in range(2))
    for number in range(-2, arguments.repeat):  # two rounds to warm up
        for name, (run, frames) in runs.items():
            start = time.perf_counter()
            with device.timed() as ms:
                run()
            if number >= 0:
                times[name].append(1e3 * (time.perf_counter() - start) / frames)
                events[name].append(1e3 * sum(ms.values()) / frames)
    print(f"{device.name}, {cols}x{rows}: ms a frame, median (smallest .. largest) of {arguments.repeat} rounds")
    for name, (run, frames) in runs.items():
        ratio = np.array(times["NumPy"]) / times[name]
        line = (f"{name:16s} {np.median(times[name]):8.3f} ({min(times[name]):.3f} .. {max(times[name]):.3f})  "
                f"NumPy over it {np.median(ratio):7.2f} ({ratio.min():.2f} .. {ratio.max():.2f})")
        if device.is_gpu and name != "NumPy":
            line += f"  device's clock {np.median(events[name]):.1f} us"
            if device.kind == "warp":
                line += f", in a graph {graph_us(device, run) / frames:.1f} us"
        print(line)


if __name__ == "__main__":
    main()
