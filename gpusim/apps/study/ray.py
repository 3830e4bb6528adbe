"""For Ray Data: a callable class for `map_batches`, one device for each actor.

Ray itself is not imported here.

    numbers = ray.data.range(len(open_design("design.toml")))  # column "id"
    numbers.map_batches(gpusim.apps.study.ray.StudyRows, fn_constructor_kwargs={"design": "design.toml",
                        "device": "warp:cuda:0"}, batch_size=24, concurrency=4, num_gpus=1)

Each row depends only on its number, however Ray distributes them.
"""

import math
from typing import Any

import numpy as np

from gpusim.apps.study.design import open_design
from gpusim.apps.study.rows import Rows
from gpusim.domain.errors import BadData


class StudyRows:
    """Adds the columns of a study's table to numbers of rows.

    Args:
        design: Path of the study file, which each actor reads.
        device: Name of the device.
        number: Column of the numbers.

    Raises:
        BadData: When called with rows without this column, or with numbers that the study does not have.
        GpusimError: As `gpusim.study` does.
    """

    def __init__(self, design: Any, *, device: str = "auto", number: str = "id"):
        self._rows, self._number = Rows(open_design(design), device), number

    def __call__(self, rows: dict) -> dict:
        """Return the rows of a batch, columns by name, with those of the table. Missing numbers are NaN."""
        if self._number not in rows:
            there = ", ".join(map(str, rows))
            raise BadData(f"rows: no column {self._number!r}; there are {there}")
        numbers = [int(one) for one in rows[self._number]]
        count = len(self._rows.design)
        if not all(0 <= one < count for one in numbers):
            raise BadData(f"rows: the study has the numbers 0 .. {count - 1}")
        found = [*self._rows.each(numbers)]
        return rows | {
            name: _column([row[name] for row in found]) for name in self._rows.design.columns
        }


def _column(values) -> np.ndarray:
    """Return a column: numbers with NaN for missing ones, or texts."""
    if all(one is None or isinstance(one, int | float) for one in values):
        if None not in values:
            return np.array(values)
        return np.array([math.nan if one is None else float(one) for one in values])
    return np.array(["" if one is None else str(one) for one in values])
