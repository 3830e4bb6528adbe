"""What the optics' kernels take on a GPU: reduce, forward, fold, inverse; and cuFFT, where PyTorch has it.

    python bench/transforms.py --device opencl:nvidia --device warp:cuda:0

1080p, 31 bands to r planes, border extended to the period, Bayer mosaic. Rounds of devices and planes alternate. Device
events; a copy of 2 GB goes first, so that no kernel waits for the host to launch it. p50 (p20 .. p80) in microseconds.
"""

import argparse
from collections import defaultdict
from contextlib import contextmanager

import numpy as np

from gpusim.backends import open_device
from gpusim.kernels.common import fft
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.spectral.integrate import integrate

ROWS, COLS, BANDS, CFA = 1080, 1920, 31, np.array([[0, 1], [1, 2]], np.int32)


@contextmanager
def by_kernel(device):
    """Microseconds of each kernel launched inside, after a long one that keeps the device busy meanwhile."""
    launch = device.launch
    ahead = device.empty((2**28,)), device.empty((2**28,))

    def charged(stage, kernel, *args, **options):
        with device.charged(kernel):
            launch(stage, kernel, *args, **options)

    times = {}
    device.launch = charged
    try:
        with device.timed() as ms:
            launch("common.copy", "copy", (2**28,), *ahead, 2**28)
            yield times
    finally:
        device.launch = launch
    times.update({kernel: 1e3 * ms[kernel] for kernel in ms if kernel != "common.copy"})


def of_device(name, period, planes):
    """Function that runs once and returns microseconds by stage and kernel."""
    device, random = open_device(name), np.random.default_rng(planes)
    content = device.array(random.random((BANDS, ROWS, COLS), np.float32))
    weights = device.array(random.random((planes, BANDS), np.float32))
    tables = device.array(random.random((3, planes, period[0] // 2 + 1, period[1] // 2 + 1), np.float32))
    mix = random.random((3, planes), np.float32)

    def once():
        found = {}
        with by_kernel(device) as times:
            reduced = integrate(content, weights, device=device)
        found["reduce"] = sum(times.values())
        with by_kernel(device) as times:
            spectra = fft.forward_extended(device, reduced, 0, planes, "edge", period)
        found |= {"forward": sum(times.values())} | {f"  forward {k}": t for k, t in times.items()}
        with by_kernel(device) as times:
            fft.inverse(device, spectra, period[1])
        found |= {"inverse": sum(times.values())} | {f"  inverse {k}": t for k, t in times.items()}
        with by_kernel(device) as times:
            mosaic(reduced, tables, mix, CFA, "edge", period, device=device)
        return found | {"mosaic (extend, forward, fold, inverse)": sum(times.values())} | {
            f"  mosaic {k}": t for k, t in times.items()}

    return once


def of_library(period, planes):
    """The same for cuFFT's transforms through PyTorch: planes that are extended already, a fold not counted."""
    import torch

    extended = torch.rand((planes, *period), device="cuda")
    phases = torch.rand((4, period[0] // 2, period[1] // 4 + 1), device="cuda").to(torch.complex64)
    ahead = torch.empty(2**28, device="cuda"), torch.empty(2**28, device="cuda")
    forms = {"forward": lambda: torch.fft.rfft2(extended),
             "inverse of the four phases": lambda: torch.fft.irfft2(phases)}

    def once():
        found = {}
        for name, form in forms.items():
            first, last = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            ahead[0].copy_(ahead[1])
            first.record()
            form()
            last.record()
            torch.cuda.synchronize()
            found[name] = 1e3 * first.elapsed_time(last)
        return found

    return once


def main():
    """Print a table for each device."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", action="append")
    parser.add_argument("--period", default="1200x2048", help="rows x columns of the transforms")
    parser.add_argument("--planes", type=int, nargs="*", default=[3, 4, 6])
    parser.add_argument("--repeat", type=int, default=50)
    arguments = parser.parse_args()
    period = tuple(map(int, arguments.period.split("x")))
    runs = {(name, planes): of_device(name, period, planes)
            for name in arguments.device or ["opencl"] for planes in arguments.planes}
    try:
        runs |= {("cuFFT", planes): of_library(period, planes) for planes in arguments.planes}
    except (ImportError, RuntimeError, AssertionError) as error:
        print(f"cuFFT: {error}")
    times = {run: defaultdict(list) for run in runs}
    for once in runs.values():  # warm: built, tables kept
        once()
    for _ in range(arguments.repeat):
        for run, once in runs.items():
            for stage, value in once().items():
                times[run][stage].append(value)
    for name in dict.fromkeys(name for name, _ in runs):
        print(f"\n{name}, {arguments.period}, us: " + ", ".join(f"{planes} planes" for planes in arguments.planes))
        for stage in times[name, arguments.planes[0]]:
            cells = (np.percentile(times[name, planes][stage], (50, 20, 80)) for planes in arguments.planes)
            print(f"{stage:42s}" + "  ".join(f"{p50:7.1f} ({p20:.1f} .. {p80:.1f})" for p50, p20, p80 in cells))


if __name__ == "__main__":
    main()
