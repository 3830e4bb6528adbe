"""Result files of `gpusim bench run`: written, read, checked, and summed up.

A result is one JSON object. `docs/benchmark.md` lists its keys. Every time stays in the file, round
by round, so that two files can be compared with statistics.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.atomic import atomic_path

KIND, FORMAT = "suite", 1
NUMBER = (int, float)
# Keys of a result and the types of their values; LIMITS, ROW and ROUND: of the objects inside it
RESULT: dict[str, tuple[type, ...]] = {
    "device": (str,),
    "machine": (dict,),
    "commit": (str, type(None)),
    "dirty": (bool, type(None)),
    "date": (str,),
    "hash": (str,),
    "limits": (dict,),
    "cold_build_s": (*NUMBER, type(None)),
    "quick": (bool,),
    "scores": (dict,),
    "rows": (list,),
}
LIMITS = (
    "copy_gbps",
    "fma_gflops",
    "local_gbps",
    "launch_us",
    "upload_gbps",
    "download_gbps",
)
ROW: dict[str, tuple[type, ...]] = {
    "name": (str,),
    "kind": (str,),
    "family": (str,),
    "size": (str,),
    "hash": (str,),
    "verified": (bool,),
}
# of a verified row; the reason why another one failed is in "failed"
TIMED: dict[str, tuple[type, ...]] = {
    "rounds": (list,),
    "ms_p20": NUMBER,
    "ms_p50": NUMBER,
    "ms_p80": NUMBER,
    "attained": (*NUMBER, type(None)),
}
ROUND: dict[str, tuple[type, ...]] = {"at": NUMBER, "ms": (list,)}


def write_result(result: dict[str, Any], path: str | Path) -> None:
    """Write a result to a file, which is complete or absent.

    Args:
        result: The result.
        path: The file.

    Raises:
        BadFile: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")


def read_result(path: str | Path) -> dict[str, Any]:
    """Return a stored result.

    Args:
        path: A file that `write_result` wrote, or the runner of a pack.

    Returns:
        The result.

    Raises:
        BadFile: The file is missing, is not JSON, or is not such a result.
    """
    try:
        result = json.loads(Path(path).read_text(), parse_constant=_refuse_constant)
    except OSError as error:
        raise BadFile(path, f"cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise BadFile(path, f"is not JSON: {error}") from error
    fault = find_fault(result)
    if fault:
        raise BadFile(path, f"is not a result of gpusim bench run: {fault}")
    return result


def _refuse_constant(name):
    raise ValueError(f"it has {name}, which is no number of JSON")


def find_fault(result: Any) -> str:
    """Return what is wrong with a result, in words; "" if nothing is.

    Args:
        result: Plain data, as JSON has it.
    """
    if not isinstance(result, dict):
        return "wanted an object"
    if result.get("bench") != KIND:
        return f'"bench" is {_show(result.get("bench"))}, wanted "{KIND}"'
    if result.get("format") != FORMAT:
        return f'"format" is {_show(result.get("format"))}, this version reads {FORMAT}'
    fault = _find_wrong_key(result, RESULT) or _find_wrong_limit(result["limits"])
    if fault:
        return fault
    names: set[str] = set()
    for number, row in enumerate(result["rows"], 1):
        fault = _find_row_fault(row)
        if not fault and row["name"] in names:
            fault = f"the name {_show(row['name'])} is there twice"
        if fault:
            return f"row {number}: {fault}"
        names.add(row["name"])
    return ""


def _find_row_fault(row):
    """Return what is wrong with a row, in words."""
    if not isinstance(row, dict):
        return "wanted an object"
    fault = _find_wrong_key(row, ROW)
    if fault:
        return fault
    if row["kind"] not in ("stage", "pipeline"):
        return f'"kind" is {_show(row["kind"])}, wanted "stage" or "pipeline"'
    if not row["verified"]:
        return _find_wrong_key(row, {"failed": (str,)})
    fault = _find_wrong_key(row, TIMED)
    if fault or not row["rounds"]:
        return fault or '"rounds" is empty'
    for each in row["rounds"]:
        fault = _find_wrong_key(each, ROUND) if isinstance(each, dict) else "a round is no object"
        if fault:
            return fault
        if not each["ms"] or not all(_is_time(ms) for ms in each["ms"]):
            return 'a round\'s "ms" is no list of times above 0'
    return ""


def _find_wrong_key(found, wanted):
    """Return the first key of `wanted` that is missing or has another type, in words."""
    for key, types in wanted.items():
        if key not in found:
            return f'"{key}" is missing'
        value = found[key]
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            return f'"{key}" is {_show(value)}'
    return ""


def _find_wrong_limit(limits):
    """Return the first limit that is missing or no positive number, in words."""
    for key in LIMITS:
        if key not in limits:
            return f'"limits" has no "{key}"'
        if limits[key] is not None and not _is_time(limits[key]):
            return f'"{key}" is {_show(limits[key])}, wanted a number above 0'
    return ""


def _is_time(value):
    """Return whether a value is a finite number above 0."""
    is_number = isinstance(value, NUMBER) and not isinstance(value, bool)
    return is_number and 0 < value < math.inf


def _show(value):
    """Return a value of JSON in at most 40 letters."""
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:36]} ..."


def sum_up(row: dict[str, Any]) -> dict[str, Any]:
    """Return a verified row with the percentiles of all its repetitions and the share attained.

    Args:
        row: A row with `rounds` and `floor_ms`.

    Returns:
        The row with ms_p20, ms_p50, ms_p80 [ms], and attained: floor_ms over ms_p50, or None
        without a floor.
    """
    times = np.concatenate([each["ms"] for each in row["rounds"]])
    p20, p50, p80 = map(float, np.percentile(times, (20, 50, 80)))
    floor = row["floor_ms"]
    attained = None if floor is None else floor / p50
    return row | {"ms_p20": p20, "ms_p50": p50, "ms_p80": p80, "attained": attained}


def score_rows(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    """Return the score of each family of rows, and of "all".

    A score is the geometric mean of `attained`, of each row at most 1: every row then takes the
    least time that the measured limits of the device allow. A row beyond 1 reads from a cache, or
    leaves out inputs of no weight, and must not make up for a slow one. A family has no score with
    a row that failed its verification, or without a floor: a wrong answer must not raise it.

    Args:
        rows: The rows of a result.

    Returns:
        Family -> score or None, in the order of the rows, and "all" last.
    """
    groups: dict[str, list] = {}
    for row in rows:
        attained = row["attained"] if row["verified"] else None
        attained = None if attained is None else min(attained, 1.0)
        groups.setdefault(row["family"], []).append(attained)
    groups["all"] = [attained for group in groups.values() for attained in group]
    return {
        name: None if not group or None in group else float(np.exp(np.mean(np.log(group))))
        for name, group in groups.items()
    }
