"""Time and memory of a loop of new resident scenes to raw: VGA to 8K, 3 to 301 bands.

    python bench/scaling.py --device opencl --tolerance 4e-4 --json bench/results/scaling-NAME.json [--only "31 bands"]

Each row is measured in a separate process (bench/frames.py): wall time per frame; planning of a
scene of this kind with everything loaded; the device memory that the plan predicted, and its peak,
including one scene; the peak memory of the process, including two scenes. A chart's reflectances
are interpolated to the bands, 400 to 700 nm. If a size does not fit, its row says so, and the
others continue.
"""

from results import count, finish, in_process, parser, ready, start

from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator

SIZES = (
    (640, 480),
    (1280, 720),
    (1920, 1080),
    (2560, 1440),
    (3840, 2160),
    (7680, 4320),
)  # of 31 bands
BANDS = (3, 10, 31, 61, 101, 301)  # at 1080p
HD = (1920, 1080)


def cases() -> dict:
    """Return name -> size and bands."""
    pairs = [(size, 31) for size in SIZES] + [(HD, bands) for bands in BANDS if bands != 31]
    return {f"{cols}x{rows}, {bands} bands": ((cols, rows), bands) for (cols, rows), bands in pairs}


def options(made):
    """Add the options of the loop, for this script and threads.py."""
    made.add_argument(
        "--tolerance",
        type=float,
        default=4e-4,
        help="relative RMS error (default: 4e-4); 0: every band",
    )
    made.add_argument("--camera", default="phone")
    made.add_argument(
        "--content",
        choices=("cube", "materials"),
        default="cube",
        help="form of the scenes (default: cube)",
    )
    made.add_argument(
        "--repeat", type=count, default=200, help="most frames of a loop; it takes 2 s at most"
    )


def settings(arguments, device) -> dict:
    """Return the options as arguments of `frames.one`, after a check by a Simulator."""
    Simulator(open_camera(arguments.camera), device=device, tolerance=arguments.tolerance or None)
    return {
        "device": device.name,
        "tolerance": arguments.tolerance or None,
        "camera": arguments.camera,
        "content": arguments.content,
        "repeat": arguments.repeat,
    }


def shown(name, row) -> str:
    """Return a row as a line."""
    if "failed" in row:
        return f"{name:24s} {row['failed']}"
    peak = "-" if row["bytes_peak"] is None else f"{row['bytes_peak'] / 2**20:.0f}"
    return (
        f"{name:24s} {row['ms_p50']:9.3f} ms ({row['ms_p25']:.3f} .. {row['ms_p75']:.3f})  "
        f"{row['ms_p50'] / row['megapixels']:8.3f} ms/Mpixel  planning {row['planning_ms']:.0f} ms  memory "
        f"{row['bytes_predicted'] / 2**20:.0f} MiB predicted, {peak} taken, process {row['rss'] / 2**20:.0f}  "
        f"{row['busy']:.2f} cores busy"
    )


def main():
    """Print the rows, and write them if requested."""
    made = parser(__doc__)
    options(made)
    made.add_argument(
        "--only", default="", metavar="TEXT", help="only rows with this text in their name"
    )
    arguments = made.parse_args()
    device, old = ready(arguments, "scaling")
    given, rows = settings(arguments, device), []
    for name, (size, bands) in cases().items():
        if arguments.only in name:
            row = in_process("frames", {**given, "size": size, "bands": bands})
            rows.append({"name": name, **row})
            print(shown(name, row), flush=True)
    del given["device"]
    finish(arguments, "scaling", device, rows, old, **given)


if __name__ == "__main__":
    start(main)
