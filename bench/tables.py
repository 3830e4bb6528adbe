"""Writes all generated tables and figures of bench/README.md from the results in bench/results.

    python bench/tables.py

The tables of all results of the script NAME are between `<!-- NAME -->` and `<!-- end of NAME -->`,
in the order of the file names. Text between marks without a stored result stays unchanged.
"""

from pathlib import Path

from results import HERE, OneLineParser, load, spread, start
from runner import tables as runner_tables
from tolerances import by_tolerance, within
from triple_summary import BAND, summary

from gpusim.domain.errors import BadFile
from gpusim.io.atomic import atomic_path

FIGURES = ("suite", "scaling")  # results with a figure


def main():
    """Write the README and the figures."""
    made = OneLineParser(description=__doc__.splitlines()[0])
    made.add_argument("--readme", type=Path, default=HERE / "README.md")
    made.add_argument("--results", type=Path, default=HERE / "results", metavar="FOLDER")
    arguments = made.parse_args()
    stored = stored_results(arguments.results)
    try:
        text = arguments.readme.read_text()
    except (OSError, ValueError) as error:
        raise BadFile(arguments.readme, f"cannot be read: {error}") from error
    text = filled(text, stored, arguments.readme)
    drawn = [path for path, result in stored.items() if result["bench"] in FIGURES]
    if drawn:
        from figures import draw

        for path in drawn:
            with atomic_path(path.with_suffix(".png")) as temporary:
                draw(stored[path], temporary)
    with atomic_path(arguments.readme) as temporary:
        temporary.write_text(text)


def stored_results(folder) -> dict:
    """Return path -> result of all files in a folder. Raises BadFile."""
    if not Path(folder).is_dir():
        raise BadFile(folder, "is not a folder; wanted one with results (.json)")
    stored = {path: load(path) for path in sorted(Path(folder).glob("*.json"))}
    for path, result in stored.items():
        if result["bench"] not in TABLES:
            raise BadFile(
                path,
                f"is a result of {result['bench']!r}, which has no tables; known: "
                f"{', '.join(sorted(TABLES))}",
            )
    return stored


def filled(text: str, stored: dict, readme="README.md") -> str:
    """Return the text with the tables between their marks. Raises BadFile if marks are missing."""
    for name in dict.fromkeys(result["bench"] for result in stored.values()):
        first, last = f"<!-- {name} -->", f"<!-- end of {name} -->"
        if text.count(first) != 1 or text.count(last) != 1 or text.index(first) > text.index(last):
            raise BadFile(
                readme,
                f"has no place for the tables of {name}: wanted one {first}, followed by one "
                f"{last}",
            )
        tables = [table(path, result) for path, result in stored.items() if result["bench"] == name]
        before, after = text.partition(first)[0], text.partition(last)[2]
        text = before + "\n\n".join([first, *tables, last]) + after
    return text


def table(path: Path, result: dict) -> str:
    """Return one result in Markdown."""
    try:
        parts = [_head(result), *TABLES[result["bench"]](result)]
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise BadFile(path, f"lacks values of its table: {error!r}; measure again") from error
    if result["bench"] in FIGURES:
        parts.append(f"![{path.stem}]({path.parent.name}/{path.stem}.png)")
    return "\n\n".join(parts)


def _head(result):
    """Return a line with device, settings, machine and commit."""
    told, size = result["machine"], result.get("size")
    shown = [f"{size[0]}x{size[1]}"] if size else []
    shown += [f"{result['bands']} bands"] if "bands" in result else []
    shown += [result["camera"]] if "camera" in result else []
    shown += [f"scenes as {result['content']}"] if "content" in result else []
    if "tolerance" in result:
        shown.append("exact" if result["tolerance"] is None else f"tolerance {result['tolerance']}")
    shown += [
        f"{rate:.3g} {unit}"
        for key, unit in (("copy_gbps", "GB/s copied"), ("fma_gflops", "GFLOP/s measured"))
        if (rate := result.get("limits", {}).get(key))
    ]
    cores = f", {told['cores']} cores" if "cores" in told else ""
    dirty = ", with changes" if result.get("dirty") else ""
    date = f", {result['date'][:10]}" if result.get("date") else ""
    place = ", ".join(filter(None, (told["device"], told["driver"])))
    return (
        f"**{result['device']}**" + "".join(f", {text}" for text in shown) + f": {place}; host "
        f"{told['cpu']}{cores}, Python {told['python']}; commit {result['commit']}{dirty}{date}"
    )


def _markdown(columns, rows):
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _number(value, form=".3g"):
    """Return a number as text, in full from 1000, or "" for None."""
    return "" if value is None else f"{value:.0f}" if abs(value) >= 1000 else f"{value:{form}}"


def _times(row):
    """Return median and quartiles."""
    return _number(row["ms_p50"]), " .. ".join(map(_number, spread(row)))


def _ratio(row, key):
    return f"{row[f'{key}_p50']:.2f} ({row[f'{key}_p25']:.2f} .. {row[f'{key}_p75']:.2f})"


def _suite(result):
    """Yield the scores, and the rows of the largest frames."""
    yield "Scores: " + ", ".join(
        f"{name} {'-' if score is None else f'{score:.2f}'}"
        for name, score in result["scores"].items()
    )
    columns = (
        "stage or pipeline",
        "ms p20",
        "p50",
        "p80",
        "GB/s",
        "GFLOP/s",
        "attained",
        "bound",
        "rms error",
        "max error",
    )
    rows = []
    for row in largest(result["rows"]):
        name = row["name"].rpartition(" ")[0]
        if not row["verified"]:
            rows.append((name, f"no speed: {row['failed']}", *[""] * 8))
            continue
        times = (_number(row[f"ms_{part}"]) for part in ("p20", "p50", "p80"))
        count = row["operations"]
        rows.append(
            (
                name,
                *times,
                _number(row["bytes"] / row["ms_p50"] / 1e6),
                _number(None if count is None else count / row["ms_p50"] / 1e6),
                _number(row["attained"], ".2f"),
                row["bound"] or "",
                *(_number(row[key], ".1e") for key in ("rel_rms_error", "max_error")),
            )
        )
    yield _markdown(columns, rows)


def largest(rows: list[dict]) -> list[dict]:
    """Return the rows of the suite's largest frames."""
    area = {
        row["size"]: int(row["size"].split("x")[0]) * int(row["size"].split("x")[1]) for row in rows
    }
    most = max(area.values())
    return [row for row in rows if area[row["size"]] == most]


def _loops(result):
    columns = ("loop", "wall ms a frame", "least .. most", "events ms", "ratio", "checked")
    rows = []
    for row in result["rows"]:
        events = row["events_ms"]
        rows.append(
            (
                row["name"],
                _number(row["ms_p50"]),
                f"{_number(row['ms_least'])} .. {_number(row['ms_most'])}",
                _number(events),
                "" if events is None else f"{row['ms_p50'] / events:.2f}",
                row["check"],
            )
        )
    yield _markdown(columns, rows)


def _scaling(result):
    columns = (
        "frame",
        "wall ms",
        "quartiles",
        "ms a megapixel",
        "over 1080p",
        "planes",
        "planning ms",
        "MiB predicted",
        "MiB taken",
        "MiB of the process",
    )
    base = next(
        (
            row["ms_p50"] / row["megapixels"]
            for row in result["rows"]
            if row["name"] == "1920x1080, 31 bands" and "failed" not in row
        ),
        None,
    )
    rows = []
    for row in result["rows"]:
        if "failed" in row:
            rows.append((row["name"], row["failed"], *[""] * 8))
            continue
        each = row["ms_p50"] / row["megapixels"]
        rows.append(
            (
                row["name"],
                *_times(row),
                _number(each),
                "" if base is None else f"{each / base:.2f}",
                row["planes"] or "",
                _number(row["planning_ms"]),
                *(
                    "" if row[key] is None else f"{row[key] / 2**20:.0f}"
                    for key in ("bytes_predicted", "bytes_peak", "rss")
                ),
            )
        )
    yield _markdown(columns, rows)


def _threads(result):
    columns = ("threads", "wall ms", "quartiles", "speed-up", "efficiency", "cores busy")
    rows, base = [], None
    for row in result["rows"]:
        if "failed" in row:
            rows.append((row["name"], row["failed"], *[""] * 4))
            continue
        base = row["ms_p50"] if row["threads"] == 1 else base
        gain = None if base is None else base / row["ms_p50"]
        rows.append(
            (
                row["name"],
                *_times(row),
                *(("", "") if gain is None else (f"{gain:.2f}", f"{gain / row['threads']:.2f}")),
                f"{row['busy']:.2f}",
            )
        )
    yield _markdown(columns, rows)


def _peers(result):
    columns = ("form", "ms", "quartiles", "compared with", "its time / this", "error")
    rows = [
        (row["name"], row["failed"], *[""] * 4)
        if "failed" in row
        else (
            row["name"],
            *_times(row),
            *((row["base"], _ratio(row, "over")) if "base" in row else ("", "")),
            row["error"],
        )
        for row in result["rows"]
    ]
    yield _markdown(columns, rows)


def _triples(result):
    found = summary(result["rows"])[1]["promise"]
    yield (
        f"{result['half']} half: {found['rows']} triples, {len(found['refused'])} refused, "
        f"{len(found['crashes'])} crashed. Reported as met: {found['met']} (within the tolerance: "
        f"{found['met_within']}); as NOT met: {found['unmet']} (beyond it: {found['unmet_beyond']}). "
        f"Predicted over true within 1/{BAND} .. {BAND}: {found['in_band']} of {found['ratios']}, for root mean "
        f"squares only {found['rms_in_band']} of {found['rms_ratios']}."
    )
    columns = (
        "tolerance",
        "triples",
        "reported met",
        "within",
        "silent misses",
        "needless NOT met",
        "predicted over true",
        "true over allowed",
    )
    yield _markdown(
        columns,
        [
            (
                name,
                one["count"],
                one["met"],
                one["within"],
                one["silent"],
                one["needless"],
                _number(one["ratio"], ".2f"),
                _number(one["used"], ".2g"),
            )
            for name, one in found["tolerances"].items()
        ],
    )


def _tolerances(result):
    cols, rows = result["size"]
    yield (
        f"{result['device']}, {cols} x {rows}: {', '.join(result['cameras'])}; {', '.join(result['charts'])}. "
        f"Predicted time within a factor of 1.5: {within(result['rows'])}."
    )
    columns = (
        "tolerance",
        "met",
        "rms, median",
        "exact / plan",
        "least .. most",
        "SciPy / plan",
        "least .. most",
    )
    yield _markdown(
        columns,
        [
            (
                one["tolerance"],
                f"{one['met']} of {one['count']}",
                f"{one['error']:.1e}",
                *(
                    cell
                    for key in ("exact", "baseline")
                    for cell in (
                        f"{one[key][f'{key}_p50']:.2f}",
                        f"{one[key][f'{key}_least']:.2f} .. {one[key][f'{key}_most']:.2f}",
                    )
                ),
            )
            for one in by_tolerance(result["rows"])
        ],
    )


def _several(result):
    columns = (
        "stream",
        "frames/s",
        "over one",
        "between probes",
        "over one",
        "probes",
        "ms of one",
        "host us",
        "against one device",
    )
    yield _markdown(
        columns,
        [
            (
                row["name"],
                _number(row["rate_p50"]),
                _ratio(row, "rate_over"),
                _number(row["between_p50"]),
                _ratio(row, "between_over"),
                f"{row['probes_p50']:.0f}",
                _number(row["probe_ms_p50"]),
                _number(row["host_us_p50"]),
                row["check"],
            )
            for row in result["rows"]
        ],
    )


def _cells(result):
    for title, columns in result["columns"].items():
        yield title + ":"
        yield _markdown(
            columns,
            [(row["name"], *row["cells"]) for row in result["rows"] if row["table"] == title],
        )


TABLES = {
    "suite": _suite,
    "loops": _loops,
    "scaling": _scaling,
    "threads": _threads,
    "two_devices": _several,
    "peers": _peers,
    "runner": runner_tables,
    "noise": _peers,
    "field": _peers,
    "fusion": _peers,
    "transforms": _peers,
    "triples": _triples,
    "tolerances": _tolerances,
    "demosaic": _cells,
    "color": _cells,
    "figure8": _cells,
    "figure14": _cells,
}

if __name__ == "__main__":
    start(main)
