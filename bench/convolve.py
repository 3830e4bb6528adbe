"""Blurs without a frame's transform, in one run: exact mode, share of the multiplications' peak, pyramid against FFT.

    python bench/convolve.py --device opencl:0 --repeat 9 [--size 1920x1080]

Rounds alternate between all forms, so that other work on the machine meets each; a ratio is of one round, the table has
the median of the rounds and the smallest and largest. Times are of whole calls: border, arithmetic and waiting. The
share of the peak is also given by the processor time of this process, which leaves out what other work took.
cv2.filter2D (two threads, float32) is OpenCV's own way: a transform for kernels from 11 x 11. The peak is measured by
chains of a * b + c in registers, as wide as the device's vectors.
"""

import argparse
import time

import numpy as np

from gpusim.backends import open_device
from gpusim.kernels.common.fft import fft_length
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.convolve import convolve, vector_defines
from gpusim.kernels.optics.convolve_ref import convolve as reference
from gpusim.kernels.optics.nearfar import nearfar

CHAINS, STEPS = 16, 300_000  # as long as a 15 x 15 convolution: longer work is interrupted more often
REACH = 246  # [pixel] of the levels below: 8 + 2 (9 + ...), what the transform's period is given on each side


def peak(device):
    """A function that runs the chains, and the operations it does."""
    import pyopencl as cl

    width = vector_defines(device)["WIDTH"] if not device.is_gpu else 1
    vector = f"float{width}" if width > 1 else "float"
    items = 8 if not device.is_gpu else 2**18
    steps = STEPS if not device.is_gpu else 4096
    # the body is written out: sums in an array would need the compiler to unroll
    names = [f"s{n}" for n in range(CHAINS)]
    source = f"""__kernel void chains(__global float *out, const float a, const float b) {{
        {vector} {', '.join(f'{name} = (float)get_global_id(0) + {n}' for n, name in enumerate(names))};
        for (int i = 0; i < {steps}; ++i) {{ {' '.join(f'{name} = {name} * a + b;' for name in names)} }}
        {vector} sum = {' + '.join(names)};
        out[get_global_id(0)] = sum{'.s0' if width > 1 else ''}; }}"""
    kernel = cl.Kernel(cl.Program(device.context, source).build(["-cl-std=CL1.2"]), "chains")
    out = device.empty((items,))

    def run():
        kernel(device.queue, (items,), (1,) if width > 1 else (256,), out.buffer, np.float32(0.999), np.float32(0.5))
        device.sync()

    return run, 2 * items * steps * CHAINS * width


def forms(device, rows, cols):
    """Name -> (function, operations)."""
    random = np.random.default_rng(0)
    plane = random.uniform(0.5, 1.5, (1, rows, cols)).astype(np.float32)
    plane[0, rows // 2, cols // 2] = 1e6
    resident = device.array(plane)

    def ready(function):
        def run():
            result = function()
            device.sync()
            return result
        return run

    made = {}
    if device.kind == "opencl":
        made["peak"] = peak(device)
    for size in (15, 63):
        kernel = random.uniform(0.5, 1, (1, size, size))
        kernel /= kernel.sum()
        for precision in ("single", "double"):
            made[f"{precision} {size}x{size}"] = (
                ready(lambda kernel=kernel, precision=precision:
                      convolve(resident, kernel, "edge", precision, device=device)), 2 * rows * cols * size * size)
            show_error(device, f"{precision} {size}x{size}", made[f"{precision} {size}x{size}"][0], plane, kernel)
        try:
            import cv2
        except ImportError:  # the ratio is left out
            continue
        cv2.setNumThreads(2)
        small = kernel[0, ::-1, ::-1].astype(np.float32)  # filter2D correlates
        made[f"filter2D {size}x{size}"] = (lambda small=small: cv2.filter2D(
            plane[0], -1, small, borderType=cv2.BORDER_REPLICATE), 2 * rows * cols * size * size)
        show_error(device, f"filter2D {size}x{size}", made[f"filter2D {size}x{size}"][0], plane, kernel)
    shapes = ((3, 15), (4, 15), (4, 15), (4, 15), (4, 15), (4, 17))
    for planes, groups in ((3, 3), (8, 1)):
        several = device.array(random.random((planes, rows, cols), np.float32))
        mix = random.random((3, planes), np.float32)
        levels = [tuple(random.random((groups, planes, *shape), np.float32) for _ in range(2)) for shape in shapes]
        period = tuple(fft_length(n + 2 * REACH) for n in (rows, cols))
        tables = device.array(random.random((groups, planes, period[0] // 2 + 1, period[1] // 2 + 1), np.float32))
        name = f"{planes} planes, {'own' if groups > 1 else 'shared'} kernels"
        made[f"pyramid, {name}"] = (ready(lambda several=several, levels=levels, mix=mix: nearfar(
            several, levels, mix, "edge", device=device)), 0)
        made[f"FFT, {name}"] = (ready(lambda several=several, tables=tables, mix=mix, period=period: blur(
            several, tables, mix, "edge", period, device=device)), 0)
    return made


def show_error(device, name, function, plane, kernel):
    """Largest local error around the highlight, against float64."""
    middle, half = [n // 2 for n in plane.shape[1:]], kernel.shape[1] + 8
    area = tuple(slice(max(m - half, 0), m + half) for m in middle)
    wide = tuple(slice(max(m - 2 * half, 0), m + 2 * half) for m in middle)
    truth = reference(plane[(slice(None), *wide)], kernel)[0]
    truth = truth[tuple(slice(a.start - w.start, a.stop - w.start) for a, w in zip(area, wide, strict=True))]
    result = np.asarray(device.numpy(function())).reshape(plane.shape[1:])[area]
    print(f"{name:28s} largest local error beside a 1e6 highlight {np.abs(result / truth - 1).max():.1e}")


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="opencl")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--repeat", type=int, default=9)
    arguments = parser.parse_args()
    cols, rows = map(int, arguments.size.split("x"))
    device = open_device(arguments.device)
    made = forms(device, rows, cols)
    times: dict = {name: [] for name in made}
    used: dict = {name: [] for name in made}
    for n in range(arguments.repeat + 1):
        for name, (function, _) in made.items():
            start, busy = time.perf_counter(), time.process_time()
            function()
            if n:  # the first round warms up
                times[name].append(1e3 * (time.perf_counter() - start))
                used[name].append(1e3 * (time.process_time() - busy))
    for name, (_, operations) in made.items():
        rate = f"{operations / np.median(times[name]) / 1e6:8.1f} GFLOP/s" if operations else ""
        print(f"{name:28s} {np.median(times[name]):8.1f} ms ({min(times[name]):.1f} .. {max(times[name]):.1f}) {rate}")

    def compare(what, first, second, scale=1.0, taken=times):
        if first in taken and second in taken:
            ratios = scale * np.array(taken[first]) / taken[second]
            print(f"{what:44s} {np.median(ratios):.2f} ({ratios.min():.2f} .. {ratios.max():.2f})")

    for size in (15, 63):
        own = f"{size}x{size}"
        for precision in ("double", "single"):
            compare(f"filter2D over {precision}, {own}", f"filter2D {own}", f"{precision} {own}")
        if "peak" in made:
            scale = made[f"single {own}"][1] / made["peak"][1]
            compare(f"share of peak, single {own}", "peak", f"single {own}", scale)
            compare(f"share of peak, single {own}, processor time", "peak", f"single {own}", scale, used)
    for name in ("3 planes, own kernels", "8 planes, shared kernels"):
        compare(f"FFT over pyramid, {name}", f"FFT, {name}", f"pyramid, {name}")


if __name__ == "__main__":
    main()
