"""`gpusim study`: many cameras in several scenes, with measures, requirements and sensitivities."""

from dataclasses import dataclass
from pathlib import Path

from gpusim.apps.video.segments import Shard
from gpusim.cli.options import DEVICE_HELP, Options, option, whole
from gpusim.cli.video import shard_option

TEXTS = {
    "help": "measure many cameras: tolerances, yield and sensitivities",
    "description": "A study file (TOML) has a base camera, keys that vary, scenes, measures and requirements; see the "
    "documentation. The folder gets a table of all cameras and scenes, and a page with plots. A run that was stopped "
    "goes on where it was.",
}


@dataclass(frozen=True, kw_only=True)
class StudyRequest(Options):
    """Options of `gpusim study`."""

    design: str = option(positional=True, metavar="STUDY", help="study file, such as design.toml")
    out: str = option(
        "-o",
        "--out",
        metavar="FOLDER",
        help="folder of the results: table.csv, index.html and the rows; it is created if it does not exist",
        required=True,
    )
    device: str = option(default="auto", help=DEVICE_HELP)
    workers: int | None = option(
        type=whole(1, 1024),
        metavar="N",
        help="processes that share the rows (default: from the cores, the number of rows and the device's memory)",
    )
    shard: Shard = shard_option(
        "part I of N of the rows, counted from 0; the last one to end writes the table"
    )
    table: str = option(
        default="csv",
        choices=("csv", "parquet"),
        help="format of the table; parquet needs pyarrow (default: csv)",
    )


def study(request: StudyRequest) -> int:
    """Run `gpusim study`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from tqdm import tqdm

    from gpusim.apps.study.run import PAGE, TABLE, run_study

    def show(count, there):
        return tqdm(total=count, initial=there, unit="row", disable=None)

    made = run_study(
        request.design,
        request.out,
        request.device,
        request.workers,
        request.shard,
        request.table,
        show,
    )
    if made.missing:
        print(f"{len(made.rows)} of {len(made.design)} rows; the others are of other shards")
        return 0
    folder = Path(request.out)
    for line in describe(made):
        print(line)
    table = folder / f"{TABLE}.{request.table}"
    print(f"{table}, {folder / PAGE}")
    return 0


def describe(made) -> list[str]:
    """Return the results of a complete study in lines: rows, errors and yields."""
    failed = len(made.errors)
    words = f", {failed} with an error, such as {made.errors[0][1]}" if failed else ""
    lines = [f"{len(made.design.sampling)} cameras, {len(made.rows)} rows{words}"]
    for one in made.yields:
        interval = ""
        if one.exact is not None:
            interval = f" ({100 * one.exact[0]:.1f} .. {100 * one.exact[1]:.1f} %)"
        lines.append(f"{one.words}: {one.passed} of {one.count}, {100 * one.share:.1f} %{interval}")
    return lines
