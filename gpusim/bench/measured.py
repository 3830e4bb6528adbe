"""A result of `gpusim bench peers` or `scaling`: its rows, and where and when they were measured."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gpusim.bench.machine import Watch, find_commit
from gpusim.bench.result import write_result


def write_rows(
    path: str | Path, bench: str, watch: Watch, rows: list[dict[str, Any]], **settings: Any
) -> None:
    """Write a result to a file.

    Args:
        path: The file.
        bench: What was measured.
        watch: Of the machine, begun before the measurement.
        rows: The rows.
        settings: Values that tell how it was measured.

    Raises:
        BadFile: The file cannot be written.
    """
    commit, dirty = find_commit()
    told: dict[str, Any] = {
        "bench": bench,
        "device": watch.device.name,
        "machine": watch.facts(),
        "commit": commit,
        "dirty": dirty,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    write_result(told | settings | {"rows": rows}, path)
