"""Studies: many cameras in several scenes, with measures, requirements and sensitivities; `gpusim study`."""

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gpusim.apps.study.run import Study


def study(
    design: str | PathLike | Mapping[str, Any],
    out: str | PathLike | None = None,
    *,
    device: Any = "auto",
    workers: int | None = 1,
    shard: tuple[int, int] = (0, 1),
    table: str = "csv",
) -> "Study":
    """Simulate many cameras in several scenes and measure their pictures.

    Each row of the table is one camera in one scene with one seed. It depends only on the design and its own number,
    so any number of workers, and a run that was killed and resumed, give the same table.

    Args:
        design: Path of a study file (TOML), or its content as a dictionary. There, a measure's "function" may also be
            a function.
        out: Folder of the results: rows, table and page. None: nothing is written.
        device: Name of a device, or a Device if there is one worker.
        workers: Processes that share the rows; they need `out`. None chooses the number.
        shard: Part of the work (number from 0, count), for several machines that write to one folder.
        table: Format of the table: "csv", or "parquet", which needs pyarrow.

    Returns:
        The study, with its table. If other shards have not finished, rows are missing.

    Raises:
        BadData: The design or an argument is wrong.
        BadFile: The study file cannot be used, or `out` holds another study.
        OutOfRange: A number is out of range.
        UnknownName: A key, a measure, a scene, a camera or a device is unknown.
    """
    from gpusim.apps.study.run import run_study

    return run_study(design, out, device, workers, shard, table)
