"""`gpusim bench run`: the benchmark of a device."""

from dataclasses import dataclass
from typing import Any

from gpusim.cli.judges import check_stages
from gpusim.cli.options import DEVICE_HELP, Options, flag, option, size, whole
from gpusim.domain.errors import UnknownName

TEXTS = {
    "help": "time every stage and twelve pipelines, verified, against the limits of the device",
    "description": "Time every stage and twelve whole pipelines in three sizes. Each is verified "
    "in the same run and compared with the measured limits of the device. Status 1 if any fails.",
}
UNITS = {
    "copy_gbps": ("copy", "GB/s"),
    "fma_gflops": ("multiply-add", "GFLOP/s"),
    "local_gbps": ("local memory", "GB/s"),
    "launch_us": ("launch", "us"),
    "upload_gbps": ("upload", "GB/s"),
    "download_gbps": ("download", "GB/s"),
}


@dataclass(frozen=True, kw_only=True)
class RunRequest(Options):
    """Options of `gpusim bench run`."""

    device: str = option(default="auto", help=DEVICE_HELP)
    quick: bool = flag("one size, 1280x720, short rounds, without the cold build")
    stage: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="AREA.NAME",
        help="only this stage; may be repeated",
    )
    only: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="TEXT",
        help='only stages and pipelines with this text in their name, such as "video"; may be '
        "repeated",
    )
    size: list[tuple[int, int]] | tuple = option(
        default=(),
        type=size,
        action="append",
        metavar="COLSxROWS",
        help="may be repeated (default: 640x480, 1280x720 and 1920x1080)",
    )
    rounds: int = option(
        default=3, type=whole(1, 100), metavar="N", help="rounds over all rows (default: 3)"
    )
    json: str | None = option(metavar="FILE", help="also write the result, with every time")
    append: str | None = option(
        metavar="FILE", help="add one round to the rows of a stored result instead"
    )


def run(request: RunRequest) -> int:
    """Run `gpusim bench run`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if a row fails its verification.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.backends import open_device
    from gpusim.bench.result import read_result, write_result
    from gpusim.bench.suite import append_round
    from gpusim.io.atomic import check_output

    if request.append is not None:
        for name in ("quick", "stage", "only", "size", "rounds", "json"):
            request.refuse(name, "--append repeats the rows of its file", "leave it out")
        stored = read_result(request.append)
        device = request.device if request.is_given("device") else stored["device"]
        check_output(request.append)
        result = append_round(stored, request.append, open_device(device))
        write_result(result, request.append)
    else:
        result = _measure(request)
    _print_result(result)
    return 0 if all(row["verified"] for row in result["rows"]) else 1


def _measure(request):
    """Return the result of a new run, which is written if that is asked for."""
    from gpusim.backends import open_device
    from gpusim.bench import suite
    from gpusim.bench.cold import measure_cold_build
    from gpusim.bench.result import write_result
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output

    check_output(request.json)
    sizes = request.size or (suite.QUICK_SIZES if request.quick else suite.SIZES)
    sizes = list(dict.fromkeys(checked_size(size) for size in sizes))
    subjects = _choose(suite.all_subjects(), request.stage, request.only)
    device = open_device(request.device)
    seconds = suite.QUICK_SECONDS if request.quick else suite.SECONDS
    result = suite.measure(device, subjects, sizes, rounds=request.rounds, seconds=seconds)
    result["quick"] = request.quick
    good = {row["name"].split()[0] for row in result["rows"] if row["verified"]}
    stages = [one.name for one in subjects if one.kind == "stage" and one.name in good]
    if stages and not request.quick and device.kind != "numpy":
        result["cold_build_s"] = measure_cold_build(device, stages)
    if request.json is not None:
        write_result(result, request.json)
    return result


def _choose(subjects, stages, texts):
    """Return the subjects that are asked for, all of them without a request."""
    if not stages and not texts:
        return subjects
    names = check_stages(stages) if stages else []
    for text in texts:
        if not any(text in subject.name for subject in subjects):
            raise UnknownName("stage or pipeline", text, [subject.name for subject in subjects])
    return [
        subject
        for subject in subjects
        if subject.name in names or any(text in subject.name for text in texts)
    ]


def _print_result(result: dict[str, Any]) -> None:
    """Print the machine, the limits, a line per row, the scores and the warnings."""
    machine, limits = result["machine"], result["limits"]
    print(f"{result['device']}: {machine['device']}; {machine['driver']}; {machine['compiler']}")
    measured = [
        f"{words} {limits[key]:.4g} {unit}" for key, (words, unit) in UNITS.items() if limits[key]
    ]
    print(f"limits: {', '.join(measured) or 'none'}")
    heads = ("ms p20", "p50", "p80", "floor ms", "attained")
    print(
        f"{'row':34s} {' '.join(f'{head:>9s}' for head in heads)}  bound       error of tolerance"
    )
    for row in result["rows"]:
        print(_row_line(row))
    cold = result["cold_build_s"]
    print(f"cold build: {'not measured' if cold is None else f'{cold:.1f} s'}")
    scores = [f"{name} {_format(score, '.2g')}" for name, score in result["scores"].items()]
    print(f"scores (floor / time, geometric means): {', '.join(scores)}")
    for warning in machine["warnings"]:
        print(f"warning: {warning}")
    failed = sum(not row["verified"] for row in result["rows"])
    if failed:
        print(f"{failed} of {len(result['rows'])} rows failed their verification and have no speed")


def _row_line(row):
    """Return the line of a row."""
    if not row["verified"]:
        return f"{row['name']:34s} no speed: {row['failed']}"
    times = " ".join(f"{row[key]:9.3f}" for key in ("ms_p20", "ms_p50", "ms_p80"))
    floor, attained = _format(row["floor_ms"], ".3f"), _format(row["attained"], ".2g")
    error = f"{row['max_error']:.1e} of {row['tolerance']:.1e}"
    return (
        f"{row['name']:34s} {times} {floor:>9s} {attained:>9s}  {row['bound'] or '-':10s}  {error}"
    )


def _format(value, form):
    """Return a number, or "-" for None."""
    return "-" if value is None else format(value, form)
