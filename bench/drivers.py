"""Verifies every stage with one driver, and writes the table of docs/drivers.md.

    python bench/drivers.py --device opencl:0 --title "PoCL 6.0" --source "Debian 13" \
        --json bench/results/drivers/pocl-6.0.json
    python bench/drivers.py --page docs/drivers.md

The first form runs all cases of all stages as `gpusim verify` does, with caches that are empty at
the beginning, and draws the same frame as every other driver: fixed patterns, chip, photons, read
noise and binning of one given mean. The second form replaces the tables between `<!-- drivers -->`
and `<!-- end of drivers -->` by the tables of all results in bench/results/drivers, also of
bench/memory.py.

A stored result of this script has a row for each stage: "cases", "passed", "used" (the largest
error over its tolerance, of cases with a tolerance above 0), "skipped" (cases that need float64, on
a device without), and "failed", the reason of its first failure. "bits" maps each part of the frame
to the number of values that differ from the reference, or "failed" to the reason why there is none.
"""

import os
import resource
import time
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from results import HERE, about, in_process, load, parser, save, start, without_folders

from gpusim.backends import open_device
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.io.atomic import atomic_path, check_output
from gpusim.judge.verify import verify_apart
from gpusim.kernels.sensor import bin as binning
from gpusim.kernels.sensor import chip, noise, pattern
from gpusim.kernels.stage import stage_names

STORED = HERE / "results" / "drivers"
MARKS = "<!-- drivers -->", "<!-- end of drivers -->"
CACHES = ("XDG_CACHE_HOME", "POCL_CACHE_DIR", "WARP_CACHE_PATH", "CUDA_CACHE_PATH")
SHAPE = 257, 385  # no multiple of a vector or a work-group
PLANES = {
    "response": {"mean": 1.0, "pixel": 0.01, "row": 1e-3, "column": 1e-3, "dead": 1e-3},
    "offset": {"pixel": 1.5, "row": 0.3, "column": 0.3},
    "dark": {"share": 0.02, "scale": 200.0},
    "telegraph": {"share": 0.01, "scale": 10.0},
}
READ = {
    "dark_electrons": 3.0,
    "read_noise": 2.0,
    "row_noise": 0.5,
    "column_noise": 0.5,
    "telegraph_switching": 0.1,
    "full_well": 9000.0,
    "gain": 0.41,
    "black_level": 64.0,
    "white_level": 4095.0,
    "frames": 2,
    "seed": 11,
}


def frame(device) -> dict:
    """Return name -> values of each part of the frame; "noise, exact" only with float64."""
    rows, cols = SHAPE
    place = np.arange(rows * cols).reshape(SHAPE)
    mean = (place * 7919 % 20011 / 2).astype(np.float32)  # 0 .. 10005 e-, exact in float32
    parts = {
        plane: pattern.pattern(rows, cols, plane, **settings, seed=5, device=device)
        for plane, settings in PLANES.items()
    }
    parts["chip"] = chip.chip(mean, parts["response"], parts["dark"], dark_time=0.05, device=device)
    chips = parts["chip"], parts["offset"], parts["telegraph"]
    parts["noise"] = noise.noise(*chips, **READ, device=device)
    if device.has_fp64:
        parts["noise, exact"] = noise.noise(*chips, **READ, photon="exact", device=device)
    electrons = noise.noise(*chips, **READ | {"frames": None}, electrons=True, device=device)
    parts["bin"] = binning.bin(electrons, binning=(2, 2), stride=(2, 2), device=device)
    return parts


def one(device: str) -> dict:
    """Return for each part of the frame the number of values that differ from the reference's."""
    found, wanted = frame(open_device(device)), frame(open_device("numpy"))
    return {name: int(np.count_nonzero(found[name] != wanted[name])) for name in found}


def stage_row(name: str, rows: list[dict]) -> dict:
    """Return the row of a stage from the rows of its cases."""
    skipped = [row for row in rows if row["skipped"]]
    rows = [row for row in rows if not row["skipped"]]
    failures = [row for row in rows if not row["ok"]]
    used = [row["max_error"] / row["tolerance"] for row in rows if row["tolerance"] and row["ok"]]
    made = {"name": name, "cases": len(rows), "passed": len(rows) - len(failures)}
    made |= {"used": max(used)} if used else {}
    made |= {"skipped": len(skipped)} if skipped else {}
    if failures:
        first = failures[0]
        error = f"error {first['max_error']:.2g} of {first['tolerance']:.2g}"
        said = first["why"] if first["case"].startswith("(") else error
        made["failed"] = without_folders(f"{first['case']}: {said}")
    return made


def verified(name: str, stages) -> list[dict]:
    """Return a row per stage, and print it."""
    rows = []
    for stage, its in groupby(verify_apart(name, stages), lambda row: row["stage"]):
        rows.append(stage_row(stage, list(its)))
        last = rows[-1]
        print(
            f"{stage:24s} {last['passed']} of {last['cases']}  {last.get('failed', '')}", flush=True
        )
    return rows


def measure(arguments):
    """Verify one driver and store the result."""
    check_output(arguments.json)
    with TemporaryDirectory() as folder:
        for name in CACHES:
            os.environ[name] = str(Path(folder) / name.lower())
        device = open_device(arguments.device)
        begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        rows = verified(device.name, arguments.stage)
        wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        bits = in_process("drivers", {"device": device.name})
    print(f"bits of a frame: {bits}")
    result = {
        "bench": "drivers",
        **about(device, arguments.commit),
        "title": arguments.title or device.name,
        "source": arguments.source,
        "gpu": device.is_gpu,
        "busy_machine": arguments.busy,
        "wall_s": round(wall, 1),
        "processor_s": round(
            after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1
        ),
        "bits": bits,
        "rows": rows,
    }
    if arguments.json is not None:
        save(result, arguments.json)


def bits_text(bits: dict) -> str:
    """Return whether the frame has the reference's bits, in a few words."""
    if "failed" in bits:
        return f"no frame: {bits['failed']}"
    differing = [f"{name}: {count} values differ" for name, count in bits.items() if count]
    return "; ".join(differing) or ("equal" if "noise, exact" in bits else "equal, no float64")


def seconds(value: float | None) -> str:
    """Return a time as text; "-" for None, of a driver that was verified in parts."""
    return "-" if value is None else f"{value:.0f}"


def table(results: list[dict]) -> list[str]:
    """Return lines of Markdown: a row for each result, and the reasons of failures."""
    columns = "driver", "from", "device", "stages", "cases", "bits of noise", "wall s", "CPU s"
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    reasons = []
    for result in results:
        rows, machine = result["rows"], result["machine"]
        failed = [row for row in rows if "failed" in row]
        cells = (
            result["title"],
            result["source"],
            f"{machine['device']}, {machine['driver']}",
            f"{len(rows) - len(failed)} of {len(rows)}",
            f"{sum(row['passed'] for row in rows)} of {sum(row['cases'] for row in rows)}",
            bits_text(result["bits"]),
            seconds(result["wall_s"]) + (" (shared)" if result["busy_machine"] else ""),
            seconds(result["processor_s"]),
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
        reasons += [f"- {result['title']}, `{row['name']}`: {row['failed']}" for row in failed]
    return [*lines, *(["", "Failed:", "", *reasons] if reasons else [])]


def checked_table(results: list[dict]) -> list[str]:
    """Return lines of Markdown about the stages that oclgrind checked, and all of its messages."""
    lines = [
        "| checker | kernels for | stages that ended | cases | messages |",
        "|---|---|---|---|---|",
    ]
    found = []
    for result in results:
        for form in dict.fromkeys(row["form"] for row in result["rows"]):
            rows = [row for row in result["rows"] if row["form"] == form]
            ended = [row for row in rows if "failed" not in row]
            ran, cases, passed = (
                sum(row[key] for row in ended) for key in ("ran", "cases", "passed")
            )
            number = sum(sum(row["messages"].values()) for row in rows)
            driver = result["machine"]["driver"]
            lines.append(
                f"| {driver} | {form}s | {len(ended)} of {len(rows)} | {ran} of {cases} ran, "
                f"{passed} passed | {number} |"
            )
            for row in rows:
                place = f"- {driver}, {form}s, `{row['name']}`"
                found += [f"{place}: {row['failed']}"] if "failed" in row else []
                if "unchecked" in row:
                    found.append(f"{place}, not for values never written: {row['unchecked']}")
                found += [f"{place}, {n} times: {what}" for what, n in row["messages"].items()]
    return [*lines, *(["", *found] if found else [])]


def tables(results: list[dict]) -> str:
    """Return the tables of processors, of GPUs and of checked memory."""
    lines = []
    for heading, is_its, its_table in (
        ("Processors", lambda one: one["bench"] == "drivers" and not one["gpu"], table),
        ("GPUs", lambda one: one["bench"] == "drivers" and one["gpu"], table),
        ("Memory", lambda one: one["bench"] == "memory", checked_table),
    ):
        its = [result for result in results if is_its(result)]
        if its:
            hosts = sorted(
                {f"{one['machine']['cpu']}, {one['machine']['cores']} cores" for one in its}
            )
            commits = sorted(
                {f"{one['commit']}{', with changes' * bool(one['dirty'])}" for one in its}
            )
            lines += [f"## {heading}", ""]
            lines += [f"Host: {'; '.join(hosts)}. Commit: {'; '.join(commits)}.", ""]
            lines += [*its_table(its), ""]
    return "\n".join(lines)


def write_page(path: Path):
    """Replace the tables of a page by the tables of all stored results."""
    results = [load(each) for each in sorted(STORED.glob("*.json"))]
    try:
        text = path.read_text()
    except (OSError, ValueError) as error:
        raise BadFile(path, f"cannot be read: {error}") from error
    with atomic_path(path) as temporary:
        temporary.write_text(filled(text, results, path))


def filled(text: str, results: list[dict], path="docs/drivers.md") -> str:
    """Return the page's text with the tables between their marks. Raises BadFile without marks."""
    first, last = MARKS
    before, found, rest = text.partition(first)
    _, ended, after = rest.partition(last)
    if not (found and ended):
        raise BadFile(path, f"has no place for the tables: wanted {first}, followed by {last}")
    return f"{before}{first}\n\n{tables(results)}\n{last}{after}"


def main():
    """Verify a driver, or write the page."""
    made = parser(__doc__)
    made.add_argument("--title", help="name of the driver in the table (default: the device's)")
    made.add_argument("--source", default="", help="where the driver comes from")
    made.add_argument("--busy", action="store_true", help="other programs run: times are too long")
    made.add_argument("--stage", action="append", choices=stage_names(), metavar="AREA.NAME")
    made.add_argument("--page", type=Path, help="write the tables of this page instead")
    arguments = made.parse_args()
    if arguments.page is None:
        measure(arguments)
        return
    if arguments.json is not None:
        raise OutOfRange("json", arguments.json, "no --json with --page, which measures nothing")
    write_page(arguments.page)


if __name__ == "__main__":
    start(main)
