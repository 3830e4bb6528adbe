"""The forms of a task: how gpusim and other libraries do it."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from gpusim.bench.timing import compare_times, time_in_turns

# module -> package that installs it
PACKAGES = {
    "cv2": "opencv-python-headless",
    "colour_demosaicing": "colour-demosaicing",
    "halide": "halide",
    "rawpy": "rawpy",
    "torch": "torch",
    "ducc0": "ducc0",
    "kornia": "kornia",
    "galsim": "galsim",
    "prysm": "prysm",
    "skimage": "scikit-image",
}
Form = tuple[Callable[[], Any], str]  # does the task and waits; its error in words

TURN_MS = 50.0  # of a form in a round, at least one call


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
        times = time_in_turns(self._forms, repeat, warm=2, turn_ms=TURN_MS)
        bases = {name: base for name in times if name != base}
        return compare_times(times, bases, self._errors) + self._missing
