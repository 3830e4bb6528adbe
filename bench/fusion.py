"""Fused bands against a transform per band, in one run: time and true error of a frame's blur.

    python bench/fusion.py --device opencl --repeat 5

The naive form is scipy.fft in float32 with kept transfer tables and two workers: per band a forward transform of the
extended plane, its table, an inverse transform, and the weighted sums of three channels. Both start from the 31 planes
of a cube and end with what the sensor's pixels get. Rounds alternate, so that other work on the machine meets both.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
import scipy.fft

from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.domain.tolerance import Tolerance
from gpusim.kernels.optics.airy import airy
from gpusim.planner.plan import BORDER_REACH
from gpusim.simulator import Simulator


def naive(values, tables, weights, period, cfa, workers=2):
    """Mosaic of a cube, one transform pair per band."""
    rows, cols = values.shape[1:]
    pad = [((length - n) // 2, length - n - (length - n) // 2) for length, n in zip(period, (rows, cols), strict=True)]
    inside = tuple(slice(before, before + n) for (before, _), n in zip(pad, (rows, cols), strict=True))
    channels = np.zeros((len(weights), rows, cols), np.float32)
    for plane, table, weight in zip(values, tables, weights.T.astype(np.float32), strict=True):
        spectrum = scipy.fft.rfft2(np.pad(plane, pad, mode="edge"), workers=workers, overwrite_x=True)
        spectrum *= table
        blurred = scipy.fft.irfft2(spectrum, period, workers=workers, overwrite_x=True)[inside]
        for channel, factor in zip(channels, weight, strict=True):
            channel += factor * blurred
    out = np.empty((rows, cols), np.float32)
    for y, row in enumerate(cfa):
        for x, channel in enumerate(row):
            out[y :: len(cfa), x :: len(row)] = channels[channel, y :: len(cfa), x :: len(row)]
    return out


def transforms(values, tables, period, workers=2):
    """The 62 transforms and nothing else: what no per-band form can be faster than."""
    for plane, table in zip(values, tables, strict=True):
        spectrum = scipy.fft.rfft2(plane, period, workers=workers)
        spectrum *= table
        scipy.fft.irfft2(spectrum, period, workers=workers, overwrite_x=True)


def main():
    """Print milliseconds, ratios with their spread, and errors against the exact plan of the same device."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="opencl")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    cols, rows = map(int, arguments.size.split("x"))
    camera = open_camera("phone")
    camera = replace(camera, optics=replace(camera.optics, f_number=2.8))
    cfa = camera.sensor.cfa_indices
    scene = chart("deadleaves", size=(cols, rows), surfaces="objects")
    content = scene.content
    cube = np.ascontiguousarray(np.moveaxis(content.spectra.astype(np.float32)[content.ids], -1, 0))
    scene = replace(scene, content=Cube(content.wavelengths, cube))
    exact = Simulator(camera, device=arguments.device, reach=BORDER_REACH)
    made = exact.plan(scene)
    truth = naive(cube.astype(np.float64), tables := _tables(made, np.float64), made.weights, made.period, cfa)
    tables = tables.astype(np.float32)
    forms = {"per band, scipy": lambda: naive(cube, tables, made.weights, made.period, cfa)}
    for rank in (3, 4, 6):
        simulator, plan = _of_rank(camera, arguments.device, scene, rank)
        forms[f"rank {rank}, folded"] = lambda simulator=simulator, plan=plan: _mosaic(simulator, plan)
    forms["per band, folded"] = lambda: _mosaic(exact, made)
    times = {name: [] for name in forms}
    for name, form in forms.items():  # warm: built, tables kept
        result = form()
        error = np.sqrt(np.mean((result - truth) ** 2) / np.mean(truth**2))
        print(f"{name:20s} relative rms error {error:.2e}")
    forms["its transforms alone"] = lambda: transforms(cube, tables, made.period)
    times["its transforms alone"] = []
    for _ in range(arguments.repeat):
        for name, form in forms.items():
            start = time.perf_counter()
            form()
            times[name].append(1e3 * (time.perf_counter() - start))
    for base in ("per band, scipy", "its transforms alone"):
        for name, taken in times.items():
            ratios = np.array(times[base]) / taken
            print(f"{name:20s} {np.median(taken):8.1f} ms   {base} over it: {np.median(ratios):.2f} "
                  f"({ratios.min():.2f} .. {ratios.max():.2f})")


def _tables(plan, dtype):
    half = airy(plan.q, 1.0, *plan.period, device="opencl").astype(dtype)
    fold = np.minimum(np.arange(plan.period[0]), plan.period[0] - np.arange(plan.period[0]))
    return half[:, fold]


def _of_rank(camera, device, scene, rank):
    """A simulator and its plan at the tolerance that makes the planner choose `rank`."""
    for limit in np.geomspace(1e-2, 1e-6, 60):
        simulator = Simulator(camera, device=device, tolerance=Tolerance(rms=limit), reach=BORDER_REACH)
        plan = simulator.plan(scene)
        if plan.mix.shape[1] == rank and plan.transfers is not None:
            return simulator, plan
    raise SystemExit(f"no tolerance gives rank {rank}")


def _mosaic(simulator, plan):
    rates, _ = simulator.imaging.rates(plan)
    return simulator.device.numpy(rates)[0]


if __name__ == "__main__":
    main()
