"""Whole tasks with gpusim and with what a user would take instead: `gpusim bench peers`.

Every form of a task is timed in turns with the others, and has its error against a float64 truth in
the same row. A library that is not installed has a row that says so.
"""

from collections.abc import Sequence
from typing import Any

from gpusim.backends import Device
from gpusim.bench.peer_demosaic import make_demosaic
from gpusim.bench.peer_frame import make_frame
from gpusim.bench.peer_noise import make_noise
from gpusim.bench.peer_picture import make_picture
from gpusim.bench.peer_spread import make_spread
from gpusim.bench.peer_task import Task
from gpusim.domain.errors import UnknownName
from gpusim.domain.progress import announced

TASKS = ("frame", "demosaic", "picture", "spread", "noise")


def make_task(
    name: str, device: Device, size: tuple[int, int], tolerance: float | None = None
) -> Task:
    """Return a task with all its forms.

    Args:
        name: One of TASKS.
        device: The device of gpusim's forms.
        size: Columns and rows of the frame [pixel].
        tolerance: Relative RMS error of a form of the frame; None: no such form.

    Raises:
        UnknownName: There is no such task.
    """
    if name == "frame":
        return make_frame(device, size, tolerance)
    if name == "demosaic":
        return make_demosaic(device, size)
    if name == "picture":
        return make_picture(device, size)
    if name == "spread":
        return make_spread(device)
    if name == "noise":
        return make_noise(device, size)
    raise UnknownName("task", name, TASKS)


def time_peers(
    device: Device,
    tasks: Sequence[str] = TASKS,
    size: tuple[int, int] = (1920, 1080),
    tolerance: float | None = 4e-4,
    repeat: int = 9,
) -> list[dict[str, Any]]:
    """Return the rows of all forms of tasks.

    Args:
        device: The device of gpusim's forms.
        tasks: Names of TASKS.
        size: Columns and rows of the frame [pixel].
        tolerance: See `make_task`.
        repeat: See `Task.time`.

    Returns:
        Rows, see `Task.time`. A form that is not installed has name and "failed".

    Raises:
        UnknownName: There is no such task.
    """
    rows: list[dict[str, Any]] = []
    for number, name in enumerate(tasks, 1):
        with announced(f"task {number} of {len(tasks)}: {name}"):
            rows += make_task(name, device, size, tolerance).time(repeat)
    return rows
