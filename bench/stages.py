"""Speed of every stage against its error, and against the limits of the device.

    python bench/stages.py --device opencl --json bench/results/stages-NAME.json [--stage optics.blur ...]

The rows are those from `gpusim bench`: a stage that fails its verification on the device gets no
speed. The limits are measured in the same run: the bandwidth of a copy kernel, and multiplications
and additions in registers (`gpusim.bench.stages.fma_gflops`). `python bench/tables.py` makes the
table and the figure.
"""

from results import add_size, finish, parser, ready, start

from gpusim.bench.stages import bench, ceilings
from gpusim.domain.errors import UnknownName
from gpusim.kernels.stage import stage_names


def main():
    """Time the stages; returns the exit status."""
    made = parser(__doc__)
    add_size(made)
    made.add_argument(
        "--stage", action="append", metavar="AREA.NAME", help="may be repeated (default: all)"
    )
    arguments = made.parse_args()
    for name in arguments.stage or ():
        if name not in stage_names():
            raise UnknownName("stage", name, stage_names())
    device, old = ready(arguments, "stages")
    limits, rows = ceilings(device), []
    print(", ".join(f"{key} {value:.4g}" for key, value in limits.items() if value))
    for row in bench(device, arguments.stage, arguments.size[::-1], limits=limits):
        rows.append({"name": row["stage"], **row})
        print(
            f"{row['stage']:24s} "
            + (
                f"no speed: verification failed, {row['failed']}"
                if "failed" in row
                else f"{row['ms_p50']:9.3f} ms ({row['ms_p25']:.3f} .. {row['ms_p75']:.3f})"
            ),
            flush=True,
        )
    finish(arguments, "stages", device, rows, old, size=arguments.size, limits=limits)
    return 1 if any("failed" in row for row in rows) else 0


if __name__ == "__main__":
    start(main)
