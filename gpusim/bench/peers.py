"""Whole tasks by gpusim and by what a user would take instead: `gpusim bench peers`.

Every form of a task is timed in turns with the others, and has its error against a float64 truth in
the same row. A library that is not installed has a row that says so.
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

from gpusim.backends import Device
from gpusim.bench.timing import compare_times, time_in_turns
from gpusim.domain.errors import UnknownName
from gpusim.domain.progress import announced

# module -> package that installs it
PACKAGES = {
    "cv2": "opencv-python-headless",
    "colour_demosaicing": "colour-demosaicing",
    "rawpy": "rawpy",
    "torch": "torch",
    "ducc0": "ducc0",
    "kornia": "kornia",
    "galsim": "galsim",
    "prysm": "prysm",
    "skimage": "scikit-image",
}
TASKS = ("frame", "demosaic", "spread", "noise")
Form = tuple[Callable[[], Any], str]  # does the task and waits; its error in words


class Task:
    """The forms of a task.

    Args:
        name: Name of the task.
        base: Name of the form that the others are compared with.
    """

    def __init__(self, name: str, base: str):
        self.name, self.base = name, base
        self._forms: dict[str, Callable[[], Any]] = {}
        self._errors: dict[str, str] = {}
        self._missing: list[dict[str, Any]] = []

    def add(self, name: str, make: Callable[[], Form], *modules: str) -> None:
        """Add a form.

        Args:
            name: Name of the form.
            make: Returns the form. It is called at once, if the modules are installed.
            modules: Modules that it needs.
        """
        name = f"{self.name}: {name}"
        missing = [PACKAGES[module] for module in modules if find_spec(module) is None]
        if missing:
            failed = f"not installed: pip install {' '.join(missing)}"
            self._missing.append({"name": name, "failed": failed})
            return
        try:
            self._forms[name], self._errors[name] = make()
        except ImportError as error:  # installed, but not usable here
            self._missing.append({"name": name, "failed": f"cannot be imported: {error}"})

    def time(self, repeat: int) -> list[dict[str, Any]]:
        """Return a row for each form.

        Args:
            repeat: Rounds in which all forms are timed in turns.

        Returns:
            Rows with name, times [ms], ratios to the base, and error in words.
        """
        base = f"{self.name}: {self.base}"
        times = time_in_turns(self._forms, repeat)
        bases = {name: base for name in times if name != base}
        return compare_times(times, bases, self._errors) + self._missing


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
        from gpusim.bench.peer_frame import make_frame

        return make_frame(device, size, tolerance)
    if name == "demosaic":
        from gpusim.bench.peer_demosaic import make_demosaic

        return make_demosaic(device, size)
    if name == "spread":
        from gpusim.bench.peer_spread import make_spread

        return make_spread(device)
    if name == "noise":
        from gpusim.bench.peer_noise import make_noise

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
