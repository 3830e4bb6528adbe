"""Raw numbers to a picture, against OpenCV's demosaicking and a camera pipeline in Halide.

    python bench/picture.py --device opencl [--json bench/results/picture-NAME.json]

On a CPU, rounds alternate between gpusim and the other libraries; on a GPU it measures the time per
launch, launches back to back.

The pipeline in Halide is the example of its authors (Ragan-Kelley et al. 2012, ACM Transactions on
Graphics 31 (4), section 6; after Adams et al. 2010, The Frankencamera), written from its
description: hot pixels suppressed, edge-directed demosaicking on the four half-size planes, colour
matrix in fixed point, curve by table, sharpening. It is scheduled by hand like theirs, fused over
strips of rows with line buffers; table look-ups are scalar, which is faster on CPUs with slow
gathers. It reads a margin of pixels instead of mirroring the border, so it has less work at the
edges. Its work per pixel is larger: `processor.develop` is bilinear and does not sharpen, but works
in float32, with any phase, and rounds codes exactly.

Needs `pip install opencv-python-headless halide`.
"""

import os
from importlib.util import find_spec

import numpy as np
from results import add_repeat, compared, finish, parser, ready, start

from gpusim.bench.timing import find_quartiles, print_times
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import make_resident, public_function, stage_module

SIZE = 1080, 1920
STAGES = ("processor.bilinear", "processor.color", "display.encode", "processor.develop")
MATRIX = ((1.9, -0.6, -0.3), (-0.3, 1.6, -0.3), (0.0, -0.5, 1.5))
MARGIN_ROWS, MARGIN_COLS = 12, 16  # of the mosaic around Halide's picture


def camera_pipeline(rows, cols, matrix, curve):
    """Return a Halide function and its input.

    The function gives the picture (cols, rows, 3) uint8; the input is a GRBG mosaic with a margin,
    uint16.
    """
    import halide as hl

    x, y, c, value = (hl.Var(name) for name in ("x", "y", "c", "value"))
    raw = hl.ImageParam(hl.UInt(16), 2)
    raw.dim(0).set_bounds(0, cols + 2 * MARGIN_COLS)
    raw.dim(1).set_bounds(0, rows + 2 * MARGIN_ROWS).set_stride(cols + 2 * MARGIN_COLS)
    mean = hl.rounding_halving_add

    number, calm, plane = hl.Func("number"), hl.Func("calm"), hl.Func("plane")
    number[x, y] = hl.i16(raw[x + MARGIN_COLS, y + MARGIN_ROWS])
    brightest = hl.max(
        hl.max(number[x - 2, y], number[x + 2, y]), hl.max(number[x, y - 2], number[x, y + 2])
    )
    calm[x, y] = hl.clamp(number[x, y], hl.i16(0), brightest)
    plane[x, y, c] = hl.mux(
        c,
        [
            calm[2 * x, 2 * y],
            calm[2 * x + 1, 2 * y],
            calm[2 * x, 2 * y + 1],
            calm[2 * x + 1, 2 * y + 1],
        ],
    )

    def sample(number):
        return lambda dx=0, dy=0: plane[x + dx, y + dy, number]

    green_r, red, blue, green_b = map(
        sample, range(4)
    )  # green of the red rows, ... in the 2 x 2 cell
    at_red, at_blue = hl.Func("green_at_red"), hl.Func("green_at_blue")

    def smoother(one, other):  # the mean of the pair that differs less
        return hl.select(hl.absd(*one) < hl.absd(*other), mean(*one), mean(*other))

    at_red[x, y] = smoother((green_r(1), green_r()), (green_b(0, -1), green_b()))
    at_blue[x, y] = smoother((green_b(-1), green_b()), (green_r(0, 1), green_r()))

    def carried(color, green, here, p, q):  # a colour's mean plus green's deviation from its mean
        return (
            here
            + mean(color(*p), color(*q))
            - mean(green[x + p[0], y + p[1]], green[x + q[0], y + q[1]])
        )

    def diagonal(color, green, here, one, other):
        return hl.select(
            hl.absd(color(*one[0]), color(*one[1])) < hl.absd(color(*other[0]), color(*other[1])),
            carried(color, green, here, *one),
            carried(color, green, here, *other),
        )

    here = (0, 0)
    cells = (
        (
            carried(red, at_red, green_r(), (-1, 0), here),
            red(),
            diagonal(red, at_red, at_blue[x, y], (here, (-1, 1)), ((-1, 0), (0, 1))),
            carried(red, at_red, green_b(), here, (0, 1)),
        ),
        (green_r(), at_red[x, y], at_blue[x, y], green_b()),
        (
            carried(blue, at_blue, green_r(), here, (0, -1)),
            diagonal(blue, at_blue, at_red[x, y], (here, (1, -1)), ((1, 0), (0, -1))),
            blue(),
            carried(blue, at_blue, green_b(), here, (1, 0)),
        ),
    )
    colors = []
    for cell in cells:
        parts = [hl.Func(f"part{number}") for number in range(4)]
        for part, expression in zip(parts, cell, strict=True):
            part[x, y] = expression
        corner = [part[x // 2, y // 2] for part in parts]
        colors.append(
            hl.select(
                y % 2 == 0,
                hl.select(x % 2 == 0, corner[0], corner[1]),
                hl.select(x % 2 == 0, corner[2], corner[3]),
            )
        )
    camera, corrected, curved, table = (
        hl.Func("camera"),
        hl.Func("corrected"),
        hl.Func("curved"),
        hl.Func("table"),
    )
    camera[x, y, c] = hl.mux(c, colors)
    fixed = np.rint(256 * np.asarray(matrix)).astype(int)
    sums = [
        sum((hl.i32(camera[x, y, k]) * int(row[k]) for k in range(3)), hl.i32(0)) // 256
        for row in fixed
    ]
    last = len(curve) - 1
    corrected[x, y, c] = hl.u16(hl.clamp(hl.mux(c, sums), 0, last))
    table[value] = hl.Buffer(curve)[value]
    curved[x, y, c] = table[hl.i32(hl.unsafe_promise_clamped(corrected[x, y, c], 0, last))]
    down, blurred, picture = hl.Func("down"), hl.Func("blurred"), hl.Func("picture")
    down[x, y, c] = mean(mean(curved[x, y - 1, c], curved[x, y + 1, c]), curved[x, y, c])
    blurred[x, y, c] = mean(mean(down[x - 1, y, c], down[x + 1, y, c]), down[x, y, c])
    detail = hl.i16(curved[x, y, c]) - hl.i16(blurred[x, y, c])
    picture[x, y, c] = hl.u8_sat(hl.i16(curved[x, y, c]) + detail // 2)

    lanes, strip = 32, 36
    strips, steps, two, xi, yi = (hl.Var(name) for name in ("strips", "steps", "two", "xi", "yi"))
    picture.bound(c, 0, 3).bound(x, 0, cols).bound(y, 0, rows).compute_root()
    picture.split(y, strips, steps, strip).split(steps, steps, two, 2).split(x, x, xi, 2 * lanes)
    picture.reorder(xi, c, two, x, steps, strips).vectorize(xi, lanes).unroll(c).parallel(strips)
    table.compute_root()
    calm.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 16).vectorize(
        x, lanes
    )
    plane.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 8).vectorize(
        x, lanes
    )
    plane.reorder(c, x, y).unroll(c)
    curved.compute_at(picture, steps).store_at(picture, strips).fold_storage(y, 8).align_bounds(
        x, 2
    ).align_bounds(y, 2)
    curved.reorder(c, x, y).tile(x, y, x, y, xi, yi, 2 * lanes, 2).reorder(xi, c, yi, x, y).unroll(
        c
    ).unroll(yi)
    curved.unroll(xi, 8)
    corrected.compute_at(curved, x).reorder(c, x, y).vectorize(x, lanes).unroll(c)
    camera.compute_at(curved, x).vectorize(x, lanes).reorder(c, x, y).unroll(c).unroll(y)
    for green in (at_red, at_blue):
        green.compute_at(curved, x).vectorize(x, lanes)
    return picture, raw


def peers():
    """Return name -> function that makes one frame, for the other libraries."""
    import cv2
    import halide as hl

    cv2.setNumThreads(count_cores())
    rows, cols = SIZE
    mosaic = stage_module("processor.bilinear").bench(rows, cols)["raw"]
    planes = np.empty((rows, cols, 3), np.uint16)
    curve = np.rint(255 * (np.arange(1024) / 1023) ** (1 / 2.2)).astype(np.uint8)
    picture, raw = camera_pipeline(rows, cols, MATRIX, curve)
    wide = np.pad(mosaic, ((MARGIN_ROWS, MARGIN_ROWS), (MARGIN_COLS, MARGIN_COLS)), mode="reflect")
    raw.set(hl.Buffer(wide))
    shown = hl.Buffer(hl.UInt(8), [cols, rows, 3])

    def halide(kept=(wide, curve)):  # Halide's buffers do not own their memory
        picture.realize(shown)

    return {
        "OpenCV": lambda: cv2.demosaicing(mosaic, cv2.COLOR_BayerRG2RGB, dst=planes),
        "Halide": halide,
    }


def ours(device):
    """Return name -> function that makes one frame and waits, for gpusim."""
    made = {}
    for name in STAGES:
        made[name] = _frame(device, name, stage_module(name).bench(*SIZE))
    electrons = stage_module("processor.develop").bench(*SIZE)
    electrons |= {"raw": (electrons["raw"] * np.float32(4)), "converter": (0.25, 0.0, 1023)}
    made["processor.develop, from electrons"] = _frame(device, "processor.develop", electrons)
    return made


def _frame(device, name, inputs):
    inputs = make_resident(device, inputs)

    def run():
        public_function(name)(**inputs, device=device)
        device.sync()

    return run


def _launches(device, stage):
    """Return the launches of one call of a stage, with their arguments."""
    run, calls = _frame(device, stage, stage_module(stage).bench(*SIZE)), []
    launch = device.launch
    device.launch = lambda *arguments, **options: (
        calls.append((arguments, options)),
        launch(*arguments, **options),
    )
    try:
        run()
    finally:
        device.launch = launch
    return calls


def _opencl(device, calls, rounds, repetitions=7, busy_bytes=2**31):
    """Return microseconds per launch by the device's clock; a copy fills the queue first."""
    import pyopencl as cl

    busy = [cl.Buffer(device.context, cl.mem_flags.READ_WRITE, busy_bytes) for _ in range(2)]
    each = []
    for _ in range(repetitions):
        for _ in range(16):
            cl.enqueue_copy(device.queue, *busy)
        device.queue.flush()
        first = cl.enqueue_marker(device.queue)
        for _ in range(rounds):
            for arguments, options in calls:
                device.launch(*arguments, **options)
        last = cl.enqueue_marker(device.queue)
        device.sync()
        each.append(1e-3 * (last.profile.end - first.profile.end) / (rounds * len(calls)))
    return each


def _warp(device, calls, rounds, repetitions=7):
    """Return microseconds per launch in a captured graph."""
    import warp as wp

    with wp.ScopedCapture(device=device.wp_device) as capture:
        for _ in range(rounds):
            for arguments, options in calls:
                device.launch(*arguments, **options)
    first, last = (wp.Event(device.wp_device, enable_timing=True) for _ in range(2))
    each = []
    for _ in range(repetitions):
        with wp.ScopedDevice(device.wp_device):
            wp.record_event(first)
            wp.capture_launch(capture.graph)
            wp.record_event(last)
        wp.synchronize_event(last)
        each.append(1e3 * wp.get_event_elapsed_time(first, last) / (rounds * len(calls)))
    return each


def main():
    """Print the table, and write it if requested."""
    made = parser(__doc__)
    add_repeat(made, 30)
    arguments = made.parse_args()
    device, old = ready(arguments, "picture")
    size = {"size": SIZE[::-1]}
    if device.is_gpu:
        rows = [
            {"name": f"{stage}, a launch", **find_quartiles(per_launch(device, stage)), "error": ""}
            for stage in STAGES
        ]
        print_times(rows)
        finish(arguments, "picture", device, rows, old, **size)
        return
    if not (find_spec("cv2") and find_spec("halide")):
        raise BadData(
            "picture.py: the peers are not installed; pip install opencv-python-headless halide"
        )
    os.environ.setdefault("HL_NUM_THREADS", str(count_cores()))
    own = ours(device)
    bases = {
        name: "Halide" if "develop" in name else "OpenCV"
        for name in own
        if "develop" in name or name == "processor.bilinear"
    }
    compared(arguments, "picture", device, old, peers() | own, bases, **size)


def per_launch(device, stage, launches=200, frames=4):
    """Return milliseconds per launch, back to back over more frames than a GPU's cache holds."""
    calls = [call for _ in range(frames) for call in _launches(device, stage)]
    return (
        np.array((_opencl if device.kind == "opencl" else _warp)(device, calls, launches // frames))
        / 1e3
    )


if __name__ == "__main__":
    start(main)
