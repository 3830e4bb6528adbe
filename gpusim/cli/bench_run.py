"""`gpusim bench run`: the benchmark of a device."""

from dataclasses import dataclass

from gpusim.cli.judges import StageRequest, check_stages, open_devices, write_rows
from gpusim.cli.options import option, size

TEXTS = {"help": "speed of every stage, with its error"}


@dataclass(frozen=True, kw_only=True)
class RunRequest(StageRequest):
    """Options of `gpusim bench run`."""

    size: tuple[int, int] | None = option(
        type=size, metavar="COLSxROWS", help="size of the frame (default: 1920x1080)"
    )


def run(request: RunRequest) -> int:
    """Run `gpusim bench run`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if a stage fails, or if there is none.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.bench.stages import bench as time_stages
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output

    check_output(request.json)
    size = checked_size(request.size or (1920, 1080))[::-1]
    rows: list[dict] = []
    stages = check_stages(request.stage)
    devices, broken = open_devices(request.device)
    request.refuse_unread("bench run")
    print(
        f"{'device':10s} {'stage':22s} {'size':>10s} {'ms p25':>9s} {'p50':>9s} {'p75':>9s} {'GB/s':>7s} "
        f"{'GFLOP/s':>8s} {'x floor':>8s} {'build ms':>9s} {'rms error':>10s} {'max error':>10s}"
    )
    for device in devices:
        for row in time_stages(device, stages, size):
            rows.append(row)
            print(_speed_line(row), flush=True)
    for row in broken:
        rows.append({"stage": row["stage"], "device": row["device"], "failed": row["why"]})
        print(f"{row['device']:10s} no speed: {row['why']}")
    write_rows(request.json, rows)
    return 1 if any("failed" in row for row in rows) or not rows else 0


def _speed_line(row):
    """Return a line of a stage's speed."""
    stage = f"{row['device']:10s} {row['stage']:22s}"
    if "failed" in row:
        return f"{stage} no speed: verification failed, {row['failed']}"
    rate, ratio = (
        f"{'-':>8s}" if row[key] is None else f"{row[key]:8.1f}"
        for key in ("gflops", "ratio_to_floor")
    )
    times = f"{row['ms_p25']:9.3f} {row['ms_p50']:9.3f} {row['ms_p75']:9.3f}"
    errors = f"{row['rel_rms_error']:10.1e} {row['max_error']:10.1e}"
    speeds = f"{row['gbps']:7.1f} {rate} {ratio}"
    return f"{stage} {row['size']:>10s} {times} {speeds} {row['build_ms']:9.1f} {errors}"
