"""Speed of field-varying blur against SciPy's overlap-add on the same kernels: one run, ratios.

    python bench/field.py [--device opencl] [--bands 4]

8 x 8 kernels of 31 x 31 (rotating comatic Gaussians), bilinear between them, a 1080p scene with 60 highlights of 1e5.
The error is that of the worst 0.1 % of the pixels, |difference| over the local value, against float64.
"""

import argparse
import time

import numpy as np
from scipy.signal import fftconvolve

from gpusim.backends import open_device
from gpusim.kernels.common.fft import fft_length
from gpusim.kernels.optics.field import field, transfer
from gpusim.planner.field import overlap_add

SHAPE, SIZE, GRID = (1080, 1920), 31, 8


def comatic(places):
    """A Gaussian that turns and grows with the field, with a tail to the outside."""
    y, x = np.mgrid[-(SIZE // 2) : SIZE // 2 + 1, -(SIZE // 2) : SIZE // 2 + 1]
    kernels = []
    for row, col in places:
        v, u = row / SHAPE[0] - 0.5, col / SHAPE[1] - 0.5
        r, angle = np.hypot(v, u), np.arctan2(v, u)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        core = np.exp(-(along**2 + across**2) / (2 * (1 + 2 * r) ** 2))
        tail = r * np.exp(-((along - 6 * r) ** 2) / (2 * (1 + 6 * r) ** 2) - across**2 / (2 * (1 + 3 * r) ** 2))
        kernels.append((core + tail) / (core + tail).sum())
    return np.stack(kernels)[:, None]


def overlap_add_scipy(plane, blur, dtype):
    """Each kernel on its own window (up to four cells), by scipy.signal.fftconvolve, added up."""
    half, cells = SIZE // 2, GRID - 1
    edges = [np.clip(edge, 0, n) for edge, n in zip(blur.edges, SHAPE, strict=True)]
    weights, kernels = blur.coefficients.astype(dtype), blur.kernels.astype(dtype)
    out = np.zeros((SHAPE[0] + 2 * half, SHAPE[1] + 2 * half), dtype)
    for i in range(GRID):
        for j in range(GRID):
            y0, x0 = edges[0][max(i - 1, 0)], edges[1][max(j - 1, 0)]
            y1, x1 = edges[0][min(i + 1, cells)], edges[1][min(j + 1, cells)]
            window = np.zeros((y1 - y0, x1 - x0), dtype)
            for term in range(4):
                a, b = i - term // 2, j - term % 2
                if 0 <= a < cells and 0 <= b < cells:
                    cell = np.s_[edges[0][a] : edges[0][a + 1], edges[1][b] : edges[1][b + 1]]
                    window[cell[0].start - y0 : cell[0].stop - y0, cell[1].start - x0 : cell[1].stop - x0] = (
                        weights[term][cell] * plane[cell])
            out[y0 : y1 + 2 * half, x0 : x1 + 2 * half] += fftconvolve(window, kernels[i * GRID + j, 0])
    return out[half:-half, half:-half]


def main():
    """Time both, alternating, and print times, ratio and errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--bands", type=int, default=4)
    arguments = parser.parse_args()
    device = open_device(arguments.device)
    random = np.random.default_rng(0)
    planes = random.random((arguments.bands, *SHAPE), np.float32) + 0.5
    for plane in planes:
        plane[tuple(random.integers(0, n, 60) for n in SHAPE)] = 1e5
    blur = overlap_add(comatic, SHAPE, (GRID, GRID), fft_length, window="bilinear")
    inputs = blur.stage_inputs
    tables = transfer(device, inputs["kernels"], inputs["edges"])
    inputs["coefficients"] = device.array(inputs["coefficients"])
    one = np.ones((1, 1), np.float32)

    def run():
        results = [field(plane[None], mix=one, border="zero", threshold=100.0, tables=tables, device=device, **inputs)
                   for plane in planes]
        device.sync()
        return np.concatenate([device.numpy(result) for result in results])

    def scipy_run():
        return np.stack([overlap_add_scipy(plane, blur, np.float32) for plane in planes])

    times = {"field": [], "scipy": []}
    run()
    for _ in range(4):
        for name, function in (("field", run), ("scipy", scipy_run)):
            start = time.perf_counter()
            function()
            times[name].append((time.perf_counter() - start) / arguments.bands)
    truth = np.stack([overlap_add_scipy(plane.astype(np.float64), blur, np.float64) for plane in planes])
    for name, function in (("field", run), ("scipy", scipy_run)):
        local = np.abs(function() - truth) / truth
        print(f"{name:6s} {1e3 * min(times[name]):7.1f} ms per band (median {1e3 * np.median(times[name]):.1f}); local "
              f"error: median {np.median(local):.1e}, 99.9 % {np.quantile(local, 0.999):.1e}, max {local.max():.1e}")
    print(f"ratio  {min(times['scipy']) / min(times['field']):.2f} of minima, "
          f"{np.median(times['scipy']) / np.median(times['field']):.2f} of medians on {device.name}")


if __name__ == "__main__":
    main()
