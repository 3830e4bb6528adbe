"""Blurs without a frame's transform against blurs by transforms: the pyramid of separable kernels, and `optics.blur`.

    python bench/pyramid.py --device opencl:0 --repeat 9 [--size 1920x1080] [--json bench/results/pyramid-NAME.json]

Direct convolution stands beside its peers in compare.py, and under the roofline in stages.py.
"""

import numpy as np
from results import add_repeat, add_size, compared, parser, ready, start

from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.nearfar import nearfar
from gpusim.optics.lengths import fft_length

REACH = 246  # [pixel] of the levels below: 8 + 2 (9 + ...), what the transform's period is given on each side
SHAPES = ((3, 15), (4, 15), (4, 15), (4, 15), (4, 15), (4, 17))  # separable terms and taps of the pyramid's levels


def forms(device, rows, cols):
    """Name -> function that runs and waits, and name -> its base."""
    random, made, bases = np.random.default_rng(0), {}, {}

    def ready_form(function, *args):
        def run():
            function(*args, device=device)
            device.sync()
        return run

    for planes, groups in ((3, 3), (8, 1)):
        several = device.array(random.random((planes, rows, cols), np.float32))
        gains = random.random((3, planes), np.float32)
        levels = [tuple(random.random((groups, planes, *shape), np.float32) for _ in range(2)) for shape in SHAPES]
        period = tuple(fft_length(n + 2 * REACH) for n in (rows, cols))
        tables = device.array(random.random((groups, planes, period[0] // 2 + 1, period[1] // 2 + 1), np.float32))
        name = f"{planes} planes, {'own' if groups > 1 else 'shared'} kernels"
        made[f"transforms, {name}"] = ready_form(blur, several, tables, gains, "edge", period)
        made[f"pyramid, {name}"] = ready_form(nearfar, several, levels, gains, "edge")
        bases[f"pyramid, {name}"] = f"transforms, {name}"
    return made, bases


def main():
    """Print the table."""
    made = parser(__doc__, "opencl")
    add_size(made)
    add_repeat(made)
    arguments = made.parse_args()
    device, old = ready(arguments, "pyramid")
    compared(arguments, "pyramid", device, old, *forms(device, *arguments.size[::-1]), size=arguments.size)


if __name__ == "__main__":
    start(main)
