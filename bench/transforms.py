"""Times of the optics' kernels on a GPU: reduce, forward, fold, inverse; also cuFFT.

    python bench/transforms.py --device opencl:nvidia [--json bench/results/transforms-NAME.json]

1080p, 31 bands to r planes, border extended to the period, Bayer mosaic. Rounds of planes
alternate. Times are device events; a copy of 2 GB goes first, so no kernel waits for the host.
"""

from collections import defaultdict
from contextlib import contextmanager

import numpy as np
from results import add_repeat, count, finish, parser, ready, start

from gpusim.bench.timing import find_quartiles, print_times
from gpusim.cli.options import size
from gpusim.domain.errors import OutOfRange, one_line
from gpusim.kernels.common import fft
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.spectral.integrate import integrate

ROWS, COLS, BANDS, CFA = 1080, 1920, 31, np.array([[0, 1], [1, 2]], np.int32)


@contextmanager
def by_kernel(device):
    """Collect the microseconds of each kernel launched inside; a long one fills the queue."""
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


def of_device(device, period, planes):
    """Return a function that runs once and returns microseconds by stage and kernel."""
    random = np.random.default_rng(planes)
    content = device.array(random.random((BANDS, ROWS, COLS), np.float32))
    weights = device.array(random.random((planes, BANDS), np.float32))
    tables = device.array(
        random.random((3, planes, period[0] // 2 + 1, period[1] // 2 + 1), np.float32)
    )
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
        return (
            found
            | {"mosaic (extend, forward, fold, inverse)": sum(times.values())}
            | {f"  mosaic {k}": t for k, t in times.items()}
        )

    return once


def of_library(period, planes):
    """Return the same for cuFFT through PyTorch: planes already extended, without a fold."""
    import torch

    extended = torch.rand((planes, *period), device="cuda")
    phases = torch.rand((4, period[0] // 2, period[1] // 4 + 1), device="cuda").to(torch.complex64)
    ahead = torch.empty(2**28, device="cuda"), torch.empty(2**28, device="cuda")
    forms = {
        "forward": lambda: torch.fft.rfft2(extended),
        "inverse of the four phases": lambda: torch.fft.irfft2(phases),
    }

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
    """Print a row for each part, and write them if requested."""
    made = parser(__doc__)
    made.add_argument(
        "--period",
        type=size,
        default=(2048, 1200),
        metavar="COLSxROWS",
        help="size of the transforms (default: 2048x1200)",
    )
    made.add_argument("--planes", type=count, nargs="*", default=[3, 4, 6])
    add_repeat(made, 50)
    arguments = made.parse_args()
    device, old = ready(arguments, "transforms")
    period = arguments.period[::-1]
    if period[0] < ROWS or period[1] < COLS or any(n % 2 or n not in fft.LENGTHS for n in period):
        raise OutOfRange(
            "--period",
            "x".join(map(str, arguments.period)),
            f"even products of 2, 3 and 5 from {COLS}x{ROWS} on",
        )
    runs = {f"{planes} planes": of_device(device, period, planes) for planes in arguments.planes}
    try:
        runs |= {
            f"cuFFT, {planes} planes": of_library(period, planes) for planes in arguments.planes
        }
    except (ImportError, RuntimeError, AssertionError) as error:
        print(f"cuFFT: {one_line(error)}")
    times: dict = defaultdict(list)
    for number in range(-1, arguments.repeat):  # warm: compiled, tables cached
        for run, once in runs.items():
            for stage, value in once().items():
                if number >= 0:
                    times[f"{run}: {stage.strip()}"].append(value / 1e3)
    rows = [{"name": name, **find_quartiles(taken), "error": ""} for name, taken in times.items()]
    print_times(rows)
    finish(arguments, "transforms", device, rows, old, period=period, repeat=arguments.repeat)


if __name__ == "__main__":
    start(main)
