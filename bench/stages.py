"""Speed of every stage against its error, and against the limits of the device.

    python bench/stages.py --device opencl --json bench/results/stages-NAME.json [--stage optics.blur ...]

The rows are from `gpusim bench run`, in the form of the tables of bench/README.md: a stage that
fails its verification on the device gets no speed. `python bench/tables.py` makes the table and the
figure.
"""

import numpy as np
from results import add_size, finish, parser, quartiles, ready, start

from gpusim.bench.stages import Stage
from gpusim.bench.suite import measure
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
    stages = [Stage(name) for name in arguments.stage or stage_names()]
    result = measure(device, stages, [arguments.size])
    rows = [in_table(row, device) for row in result["rows"]]
    for row in rows:
        times = "" if "failed" in row else f"{row['ms_p50']:9.3f} ms"
        print(f"{row['name']:24s} {times or row['failed']}")
    finish(arguments, "stages", device, rows, old, size=arguments.size, limits=result["limits"])
    return 1 if any("failed" in row for row in rows) else 0


def in_table(row: dict, device) -> dict:
    """Return a row of the suite as the table of stages has it."""
    name = row["name"].partition(" ")[0]
    if not row["verified"]:
        return {"name": name, "failed": row["failed"]}
    p50, attained = row["ms_p50"], row["attained"]
    return {
        "name": name,
        **quartiles(np.concatenate([each["ms"] for each in row["rounds"]])),
        "gbps": row["bytes"] / p50 / 1e6,
        "gflops": None if row["operations"] is None else row["operations"] / p50 / 1e6,
        "ratio_to_floor": None if attained is None else 1 / attained,
        "bound": row["bound"],
        "build_ms": getattr(device, "build_ms", {}).get(name, 0.0),
        "rel_rms_error": row["rel_rms_error"],
        "max_error": row["max_error"],
    }


if __name__ == "__main__":
    start(main)
