"""The sensor's noise against NumPy's generator in one run, and frames per second.

    python bench/noise.py --device opencl:0 --repeat 15 [--size 1920x1080] [--json bench/results/noise-NAME.json]

Rounds alternate between all forms. NumPy draws `poisson(mean)` and `normal(0, 2)`. "full" has all
noise sources: photons, dark current, read noise, rows, columns, fixed offsets, traps in 1 of 1000
pixels, full well and a 12-bit converter; the mean electrons rise from 1 to 10000. "chip" is the
step before it, once per exposure: the mean with the response and the hot pixels. "16 frames" draws
them in one call; the time is per frame. All arrays stay on the device. On CUDA by Warp it also
prints the kernel's time, from 20 calls in one graph. There is no error, since the digital numbers
for given mean electrons equal the reference bit for bit (`gpusim verify --stage sensor.noise`).
"""

from functools import partial

import numpy as np
from results import add_repeat, add_size, compared, parser, ready, start

from gpusim.bench.baseline import noise as by_numpy
from gpusim.kernels.sensor import chip, noise
from gpusim.kernels.stage import make_resident

BATCH = 16


def forms(device, rows, cols):
    """Return name -> (function, number of frames it draws)."""
    full = noise.bench(rows, cols)
    mean, own = full["expected"], make_resident(device, chip.bench(rows, cols))
    full = make_resident(device, full)
    plain = {
        name: value
        for name, value in full.items()
        if name not in ("offset", "amplitude", "row_noise", "column_noise")
    }

    def stage(function, inputs):
        def run():
            function(**inputs, device=device)
            device.sync()

        return run

    return {
        "NumPy": (partial(by_numpy, np.random.default_rng(0), mean, 2.0), 1),
        "full": (stage(noise.noise, full), 1),
        "full, 16 frames": (stage(noise.noise, {**full, "frames": BATCH}), BATCH),
        "full, exact": (stage(noise.noise, {**full, "photon": "exact"}), 1),
        "photon and read": (stage(noise.noise, plain), 1),
        "chip": (stage(chip.chip, own), 1),
    }


def graph_us(device, run):
    """Return the microseconds of one call among 20 in a CUDA graph, without Python."""
    wp, times = device._wp, []
    wait, device.sync = device.sync, lambda: None  # not possible in a graph
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


def clock_us(device, run, frames):
    """Return the device time of a frame [us] as text, also in a CUDA graph if possible."""
    events = []
    for _ in range(10):
        with device.timed() as ms:
            run()
        events.append(1e3 * sum(ms.values()) / frames)
    graph = f", {graph_us(device, run) / frames:.1f} us in a graph" if device.kind == "warp" else ""
    return f"device's clock {np.median(events):.1f} us{graph}"


def main():
    """Print the table."""
    made = parser(__doc__)
    add_repeat(made, 15)
    add_size(made)
    arguments = made.parse_args()
    device, old = ready(arguments, "noise")
    runs = forms(device, *arguments.size[::-1])
    told = {
        name: clock_us(device, *runs[name]) for name in runs if device.is_gpu and name != "NumPy"
    }
    compared(
        arguments,
        "noise",
        device,
        old,
        {name: run for name, (run, _) in runs.items()},
        dict.fromkeys([name for name in runs if name != "NumPy"], "NumPy"),
        told,
        {name: frames for name, (_, frames) in runs.items()},
        size=arguments.size,
    )


if __name__ == "__main__":
    start(main)
