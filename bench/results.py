"""Shared code of all scripts here: writes, reads and compares results, and parses the command line.

A result is a dict, stored as JSON: its subject ("bench", one of the names in bench/tables.py),
place and time ("device", "machine", "commit", "dirty", "date"), the settings, and "rows". A row has
a "name", times in milliseconds as "ms_p25", "ms_p50", "ms_p75" or "ms_least", "ms_p50", "ms_most",
and other figures.
"""

import argparse
import datetime
import json
import os
import re
import subprocess
import sys
from pathlib import Path

from gpusim.backends import open_device
from gpusim.bench.machine import Watch, find_commit
from gpusim.bench.timing import compare_times, print_times, time_in_turns
from gpusim.cli.main import OneLineParser
from gpusim.cli.options import size
from gpusim.data.charts import checked_size
from gpusim.domain.errors import BadFile, GpusimError, OutOfRange
from gpusim.io.atomic import atomic_path, check_output

HERE = Path(__file__).parent
FOUND = {
    "rows",
    "columns",
    "limits",
    "machine",
    "commit",
    "dirty",
    "date",
    "device",
}  # all other keys are settings
PLACE = ("cpu", "cores", "device", "driver")  # of a machine: keys that affect times


def parser(doc: str, device: str = "auto") -> argparse.ArgumentParser:
    """Return a command line with the options of all scripts."""
    made = OneLineParser(description=doc.splitlines()[0])
    made.add_argument(
        "--device", default=device, help=f"as for gpusim simulate (default: {device})"
    )
    made.add_argument("--json", metavar="FILE", help="write the result")
    made.add_argument(
        "--against", metavar="OLD.json", help="compare with a stored result of the same script"
    )
    made.add_argument("--commit", help="commit, if there is no checkout")
    return made


def add_size(made, default="1920x1080"):
    """Add the option `--size`."""
    made.add_argument(
        "--size", type=size, default=size(default), metavar="COLSxROWS", help=f"default: {default}"
    )


def count(text: str) -> int:
    """Parse a whole number of repetitions, from 1."""
    value = int(text) if text.isascii() and text.isdecimal() and len(text) < 7 else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted a whole number, 1 .. 999999")
    return value


def ready(arguments, bench: str):
    """Check all arguments before anything is timed; returns the device and the old result, if any.

    Raises BadFile, DeviceError, OutOfRange, DoesNotFit.
    """
    old = checked(arguments, bench)
    return open_device(arguments.device), old


def checked(arguments, bench: str) -> dict | None:
    """Check all arguments but the device; returns the old result, if any.

    Raises BadFile, OutOfRange, DoesNotFit.
    """
    if getattr(arguments, "size", None) is not None:
        checked_size(arguments.size)
    check_output(arguments.json)
    old = None
    if arguments.against is not None:
        old = load(arguments.against)
        if old["bench"] != bench:
            raise BadFile(
                arguments.against, f"is a result of {old['bench']!r}; wanted one of {bench!r}"
            )
    return old


def finish(
    arguments, bench: str, device, rows: list[dict], old: dict | None = None, **settings
) -> dict:
    """Write the result and compare it with the old one, as requested; returns it."""
    result = json.loads(
        json.dumps({"bench": bench, **about(device, arguments.commit), **settings, "rows": rows})
    )
    if arguments.json is not None:
        save(result, arguments.json)
    if old is not None:
        print(against(old, result))
    return result


def start(main):
    """Run a script's `main()`; a user's mistake gives one line and exit status 2."""
    try:
        status = main()
    except GpusimError as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        status = 2
    except (MemoryError, KeyboardInterrupt) as error:
        print(
            f"{Path(sys.argv[0]).name}: {'out of memory' if isinstance(error, MemoryError) else 'interrupted'}",
            file=sys.stderr,
        )
        status = 2
    sys.exit(status)


def about(device, commit: str | None = None) -> dict:
    """Return device, machine, commit and date of a result."""
    found, dirty = (commit, None) if commit else find_commit()
    return {
        "device": device.name,
        "machine": Watch(device).facts(),
        "commit": found,
        "dirty": dirty,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def without_folders(text: str) -> str:
    """Return a text in which absolute paths are only the names of their files: no result tells a user's folders."""
    return re.sub(r"(?<![\w.])/(?:[^\s/:()'\"]+/)+", "", text)


def save(result: dict, path):
    """Write a result. Raises BadFile."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")


def load(path) -> dict:
    """Return a stored result. Raises BadFile if it is missing, not JSON, or not a result."""
    try:
        result = json.loads(Path(path).read_text())
    except OSError as error:
        raise BadFile(path, f"cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise BadFile(path, f"is no JSON: {error}") from error
    is_one = (
        isinstance(result, dict)
        and {"bench", "device", "machine", "rows"} <= set(result)
        and isinstance(result["machine"], dict)
        and isinstance(result["rows"], list)
        and all(isinstance(row, dict) and "name" in row for row in result["rows"])
    )
    if not is_one:
        raise BadFile(
            path,
            "is no result of a script in bench/: wanted an object with bench, device, machine and "
            "rows, each with a name; --json writes one",
        )
    return result


def spread(row: dict) -> tuple[float, float]:
    """Return the quartiles of a row's times [ms], or its extremes if only these are stored."""
    return row.get("ms_p25", row.get("ms_least")), row.get("ms_p75", row.get("ms_most"))


def against(old: dict, new: dict) -> str:
    """Return each row's median over the old one, "same" if quartiles overlap; old text for text.

    One line before them states other differences in machine or settings.
    """
    lines, before = [], {_key(row): row for row in old["rows"]}
    differing = [
        f"{key} {old['machine'].get(key)!r} then, {new['machine'].get(key)!r} now"
        for key in PLACE
        if old["machine"].get(key) != new["machine"].get(key)
    ]
    differing += [
        f"{key} {old[key]!r} then, {new[key]!r} now"
        for key in sorted(set(old) & set(new) - FOUND)
        if old[key] != new[key]
    ]
    if differing:
        lines.append(f"warning: not measured alike: {'; '.join(differing)}")
    lines.append(
        f"{'now over ' + str(old.get('commit') or 'the old'):40s} {'ratio':>7s} {'quartiles':>18s}"
    )
    for row in new["rows"]:
        lines.append(f"{row['name']:40s} {_change(before.pop(_key(row), None), row)}")
    return "\n".join([*lines, *(f"{row['name']:40s} {'-':>7s}  gone" for row in before.values())])


def _key(row):
    return row.get("table"), row["name"]


def _change(was, row):
    """Return the change from an old row, or None, to the row of the same name."""
    if was is None:
        return f"{'-':>7s}  new"
    if "cells" in row and "cells" in was:
        same = list(row["cells"]) == list(was["cells"])
        return f"{'-':>7s}  " + (
            "same" if same else f"was {' | '.join(was['cells'])}, is {' | '.join(row['cells'])}"
        )
    if not was.get("ms_p50") or row.get("ms_p50") is None:
        return f"{'-':>7s}  no times"
    (was_low, was_high), (low, high) = spread(was), spread(row)
    ratio = row["ms_p50"] / was["ms_p50"]
    verdict = "same" if low <= was_high and was_low <= high else "slower" if ratio > 1 else "faster"
    return f"{ratio:7.2f} {f'{low / was_high:.2f} .. {high / was_low:.2f}':>18s}  {verdict}"


def compared(
    arguments,
    bench: str,
    device,
    old,
    forms: dict,
    bases: dict,
    errors: dict | None = None,
    each: dict | None = None,
    **settings,
):
    """Time forms in turns for `--repeat` rounds, print their rows and finish."""
    rows = compare_times(time_in_turns(forms, arguments.repeat, warm=2), bases, errors, each)
    print_times(rows)
    finish(arguments, bench, device, rows, old, repeat=arguments.repeat, **settings)


def add_repeat(made, default=9):
    """Add the option `--repeat`."""
    made.add_argument("--repeat", type=count, default=default, help=f"rounds (default: {default})")


class Tables:
    """Results without times: tables of text, printed as they grow. A row has a cell per column.

    columns: title -> names of columns. rows: of the result.
    """

    def __init__(self):
        self.columns, self.rows = {}, []

    def table(self, title: str, *columns):
        """Begin a table."""
        self.title, self.columns[title] = title, columns
        print(f"\n{title}: {', '.join(columns)}")

    def row(self, name: str, *cells: str):
        """Add a row to the last table."""
        self.rows.append({"name": name, "table": self.title, "cells": cells})
        print("  ", " | ".join((name, *cells)), flush=True)


def in_process(
    module: str, settings: dict, environment: dict | None = None, limit: float | None = None
) -> dict:
    """Return the dict from `one(**settings)` of a module here, run in a separate process.

    {"failed": why} if it fails, or takes more than `limit` seconds.
    """
    command = [
        sys.executable,
        "-c",
        f"import {module}, json, sys; print(json.dumps({module}.one(**json.loads(sys.argv[1]))))",
        json.dumps(settings),
    ]
    folders = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH")]))
    variables = {**os.environ, **(environment or {}), "PYTHONPATH": folders}
    try:
        ended = subprocess.run(
            command, cwd=HERE, capture_output=True, text=True, env=variables, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return {"failed": f"took more than {limit:g} s"}
    if ended.returncode == 0:
        return json.loads(ended.stdout.splitlines()[-1])
    last = (ended.stderr.strip().splitlines() or [f"status {ended.returncode}"])[-1]
    return {"failed": without_folders(last.removeprefix("gpusim.domain.errors."))}


def require_cpu(device, what: str):
    """Raise OutOfRange unless the device is the processor by OpenCL."""
    if not (device.kind == "opencl" and device.on_host):
        raise OutOfRange(
            "device", device.name, f"{what}: an OpenCL device of the CPU, such as --device opencl:0"
        )
