"""`gpusim verify` and `devices`: errors of the stages of every device, and the devices."""

import json
from dataclasses import asdict, dataclass

from gpusim.cli.options import Options, flag, option, write_json
from gpusim.domain.errors import UnknownName
from gpusim.domain.progress import announce_each

VERIFY = {"help": "compare every stage with its float64 reference; status 1 on any failure"}
DEVICES = {"help": "list the devices, their copy speed, and why a device is unusable"}


@dataclass(frozen=True, kw_only=True)
class StageRequest(Options):
    """Options of commands about the stages of devices."""

    device: str = option(default="all", help="as for simulate, or all (default: all)")
    stage: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="AREA.NAME",
        help="may be repeated (default: all stages)",
    )
    json: str | None = option(metavar="FILE", help="also write the rows to a JSON file")


@dataclass(frozen=True, kw_only=True)
class VerifyRequest(StageRequest):
    """Options of `gpusim verify`."""

    hard: bool = flag(
        "run the 30 hard cases instead of the stages: the limit of each, and the result"
    )
    combinations: bool = flag(
        "make small frames with every pair of features instead, and print the matrix"
    )
    feature: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="NAME",
        help="of --combinations; may be repeated (default: all features)",
    )
    tolerance: str | None = option(
        metavar="TOLERANCE", help="of the frames of --combinations (default: exact frames)"
    )


@dataclass(frozen=True, kw_only=True)
class DevicesRequest(Options):
    """Options of `gpusim devices`."""

    json: bool = flag("print JSON")


def verify(request: VerifyRequest) -> int:
    """Run `gpusim verify`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if a case fails, or if there is none.

    Raises:
        GpusimError: If an option is wrong.
    """
    from gpusim.io.atomic import check_output
    from gpusim.judge.verify import verify_devices

    check_output(request.json)
    if request.combinations:
        return _verify_combinations(request)
    if request.hard:
        request.refuse("stage", "--hard runs cases instead of stages", "leave one of them out")
    for name in ("feature", "tolerance"):
        request.refuse(name, "only --combinations uses it", "leave it out, or add --combinations")
    device, stages = request.device, check_stages(request.stage)
    request.refuse_unread("verify")
    show = _hard_line if request.hard else _stage_line
    rows = []
    judged = _hard_rows(device) if request.hard else verify_devices(device, stages)
    for row in announce_each(judged, "verifying, {} cases done".format):
        rows.append(row)
        print(show(row), flush=True)
    failed = sum(not row["ok"] for row in rows)
    skipped = sum(bool(row.get("skipped")) for row in rows)
    end = f", {skipped} not run" if skipped else ""
    print(f"{len(rows) - failed - skipped} passed, {failed} failed{end}")
    write_rows(request.json, rows)
    return 1 if failed or not rows else 0


def _verify_combinations(request):
    """Run `gpusim verify --combinations`."""
    from functools import partial

    from gpusim.apps.routes import make
    from gpusim.domain.account import Tolerance
    from gpusim.judge.combinations import NAMES, combinations, matrix, reasons

    for name in ("hard", "stage"):
        reason = "--combinations makes frames of pairs of features"
        request.refuse(name, reason, "leave one of them out")
    for name in request.feature:
        if name not in NAMES:
            raise UnknownName("feature", name, NAMES)
    tolerance = request.tolerance
    if tolerance is not None:
        Tolerance.parse(tolerance)
    names = request.feature or NAMES
    (devices, broken), rows = _open_devices(request.device), []
    request.refuse_unread("verify --combinations")
    for device in devices:
        cells = []
        found = combinations(device, partial(make, tolerance=tolerance), names)
        for cell in announce_each(found, "verifying, {} pairs done".format):
            cells.append(cell)
            start = f"{'ok  ' if cell.is_good else 'FAIL'} {device.name:10s} {len(cells):3d}"
            pair = cell.first if cell.first == cell.second else f"{cell.first} x {cell.second}"
            why = f": {cell.why}" if cell.why else ""
            print(f"{start} {pair}: {cell.state}{why}", flush=True)
            rows.append(asdict(cell) | {"device": device.name, "ok": cell.is_good})
        print("", *matrix(cells, names), "", *reasons(cells), "", sep="\n")
    rows += broken
    for row in broken:
        print(f"FAIL {row['device']:10s} (open): {row['why']}")
    failed = sum(not row["ok"] for row in rows)
    print(f"{len(rows) - failed} passed, {failed} failed")
    write_rows(request.json, rows)
    return 1 if failed or not rows else 0


def _hard_rows(name):
    """Yield a row per hard case of every device of this name, also for those that do not open."""
    from gpusim.judge.hard import hard

    devices, broken = _open_devices(name)
    yield from map(_as_hard, broken)
    for device in devices:
        yield from hard(device)


def _stage_line(row):
    """Return a line of a stage's case."""
    if row["skipped"]:
        return f"skip {row['device']:10s} {row['stage']:22s} {row['case']}: {row['skipped']}"
    start = "ok  " if row["ok"] else "FAIL"
    error = f"{row['max_error']:9.2e} (tolerance {row['tolerance']:8.2e})"
    end = "" if row["ok"] else f": {row['why']}"
    return f"{start} {row['device']:10s} {row['stage']:22s} {error}  {row['case']}{end}"


def _hard_line(row):
    """Return a line of a hard case."""
    start = "ok  " if row["ok"] else "FAIL"
    case = f"{row['device']:10s} {row['number']:2d} {row['name']}: {row['asked']}"
    return f"{start} {case} | got {row['got']:.2g} of {row['limit']:.2g}: {row['why']}"


def _as_hard(row):
    """Return the row of a device that does not open as a hard case has it."""
    return {
        "number": 0,
        "name": "(open)",
        "device": row["device"],
        "asked": "the device opens",
        "got": float("inf"),
        "limit": 0.0,
        "ok": False,
        "why": row["why"],
    }


def list_devices(request: DevicesRequest) -> int:
    """Run `gpusim devices`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.
    """
    from gpusim.backends.probe import devices

    entries = devices(refresh=True)
    if request.json:
        print(json.dumps(entries, indent=2))
        return 0
    for entry in entries:
        if entry["error"]:
            print(f"{entry['name']:12s} unusable: {entry['error']}")
            continue
        kinds = ", ".join(kind if entry[kind] else f"no {kind}" for kind in ("fp64", "fp16"))
        driver = f"{entry['driver']} ({entry['version']})"
        memory = f"{entry['memory'] / 2**30:.1f} GiB"
        copy = f"copy {entry['copy_gbps']:.1f} GB/s"
        units = f"{entry['units']} units, {kinds}"
        print(f"{entry['name']:12s} {entry['device']}; {driver}; {units}; {memory}; {copy}")
    return 0


def _open_devices(name):
    """Return the named device, or all of them for "all", and a failed row for each unusable one."""
    from gpusim.backends import open_device
    from gpusim.backends.probe import devices
    from gpusim.judge.verify import failed_row

    if name != "all":
        return [open_device(name)], []
    entries = [entry for entry in devices() if entry["name"] != "numpy"]
    broken = [
        failed_row("(open)", entry["name"], "(failed to open)", entry["error"])
        for entry in entries
        if entry["error"]
    ]
    return [open_device(entry["name"]) for entry in entries if not entry["error"]], broken


def check_stages(names):
    """Return the names of stages, of all if there are none. Raises UnknownName."""
    from gpusim.kernels.stage import stage_names

    known = stage_names()
    for name in names:
        if name not in known:
            raise UnknownName("stage", name, known)
    return names or known


def write_rows(path, rows):
    """Write rows to a JSON file, if there is a path. JSON has no infinity: it becomes null."""
    plain = [
        {key: None if value == float("inf") else value for key, value in row.items()}
        for row in rows
    ]
    write_json(path, plain)
