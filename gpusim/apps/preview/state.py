"""Settings of a client of the preview: changes of a camera file, the scene's light, and the view."""

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from shlex import join
from time import monotonic
from typing import Any

from gpusim.apps.preview.controls import CONTROLS, TOLERANCES, VIEWS, Control
from gpusim.data.lights import BRIGHTEST
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.io.camera.cameras import NO_BASE, anchor_paths, camera_of, camera_table

MOST_STEPS, REST = 200, 1.0  # of undo; [s] after which a slider that moves again makes another
LONGEST_LINK = 8192  # [character]


@dataclass(frozen=True)
class State:
    """Settings of a client.

    Attributes:
        camera: Name of a built-in camera, or a file.
        changes: Name of a control -> value in the camera file's unit.
        light, luminance: Light of the scene and luminance of white [cd m-2]. None: the scene's own.
        tolerance: One of TOLERANCES.
        view: One of VIEWS.
        is_live: Whether noise and moving scenes run.
        seed, frame: Seed of the noise, and number of the frame while nothing runs.
        against: `camera` and `changes` of a second camera, shown right of `split` of the width.
            None: no second one.
    """

    camera: str
    changes: dict[str, Any] = field(default_factory=dict)
    light: str | None = None
    luminance: float | None = None
    tolerance: str = "1e-3"
    view: str = "rendered"
    is_live: bool = True
    seed: int = 0
    frame: int = 0
    against: dict[str, Any] | None = None
    split: float = 0.5

    @property
    def other(self) -> "State | None":
        """The state of the second camera, or None."""
        return None if self.against is None else replace(self, **self.against, against=None)

    def value(self, control: Control, table: dict) -> Any:
        """Return the value of a control: set, of the camera file, or its default."""
        if control.name in self.changes:
            return self.changes[control.name]
        if control.named:
            return next(iter(control.named))  # the file's own
        given = table.get(control.section, {}).get(control.key, control.default)
        return given if control.item is None else _long(given, control)[control.item]

    def table(self) -> dict:
        """Return the camera file's table with the changes and absolute file names.

        Raises BadFile, UnknownName.
        """
        return self.apply_changes(anchor_paths(*camera_table(self.camera)))

    def apply_changes(self, table: dict) -> dict:
        """Return a camera file's table with the changes.

        Raises BadData or OutOfRange for a value.
        """
        for name, value in self.changes.items():
            control = CONTROLS[name]
            control.check(value)
            if control.named and (value := control.named[value]) is None:
                continue
            section = table.setdefault(control.section, {})
            if control.item is not None:
                section[control.key] = _long(section.get(control.key, control.default), control)
                section[control.key][control.item] = value
            else:
                section[control.key] = value
        return table

    def build(self) -> Camera:
        """Return the camera. Raises as `open_camera` does."""
        return camera_of(camera_table(self.camera)[0], self.table())

    def toml(self) -> str:
        """Return the text of the camera file."""
        import tomli_w

        return tomli_w.dumps({"base": NO_BASE} | self.table())  # it has all keys

    def command(self, scene: str, file: str = "camera.toml") -> str:
        """Return the command line of the picture, with the camera's file next to it."""
        words = ["gpusim", "simulate", scene, "--camera", file]
        given = {"light": self.light, "luminance": self.luminance, "tolerance": self.asked}
        for option, value in given.items():
            if value is not None:
                text = f"{value:g}" if isinstance(value, float) else str(value)
                words += [f"--{option}", text]
        return join([*words, "--seed", str(self.seed), "-o", "frame.npz"])

    @property
    def asked(self) -> str | None:
        """Tolerance for a Simulator."""
        return None if self.tolerance == "exact" else self.tolerance

    @property
    def is_sound(self) -> bool:
        """Return whether all fields have their types, and values that the page can set."""
        one, numbers, other = self.luminance, (self.seed, self.frame), self.against
        return (
            isinstance(self.camera, str)
            and isinstance(self.changes, dict)
            and self.changes.keys() <= {*CONTROLS}
            and not any(isinstance(value, list | dict | None) for value in self.changes.values())
            and (self.light is None or isinstance(self.light, str))
            and (one is None or (type(one) in (int, float) and 0 < one <= BRIGHTEST))
            and self.tolerance in TOLERANCES
            and self.view in VIEWS
            and isinstance(self.is_live, bool)
            and all(type(number) is int and 0 <= number < 2**32 for number in numbers)
            and isinstance(other, dict | None)
            and (other or {}).keys() <= {"camera", "changes"}
            and type(self.split) in (int, float)
            and 0 <= self.split <= 1
        )

    def link(self) -> str:
        """Return all settings as text for an address, which `State.of_link` reads."""
        return json.dumps(
            {key: value for key, value in asdict(self).items() if value != _DEFAULTS.get(key)},
            separators=(",", ":"),
        )

    @classmethod
    def of_link(cls, text: str, camera: str) -> "State":
        """Return the state of a link, which may be of an older page. camera: if it names none.

        Raises BadData.
        """
        try:
            if len(text) > LONGEST_LINK:
                raise ValueError
            found = {"camera": camera} | json.loads(text)
            state = cls(**found)
            known = state.is_sound and (state.other or state).is_sound
        except (ValueError, TypeError, RecursionError):  # RecursionError: of JSON, lists in lists
            known = False
        if not known:
            raise BadData("link: not one of this preview's; wanted one that its page made")
        # a link may come from anybody: it names no files of this machine
        if state.against and Path(state.against.get("camera", "")).suffix:
            state = replace(state, against=state.against | {"camera": camera})
        return replace(state, camera=camera) if Path(state.camera).suffix else state


def _long(given, control):
    """Return a list with a place for a control's item."""
    return [*given, *control.default[len(given) :]]


_DEFAULTS = {key: value for key, value in asdict(State("")).items() if key != "camera"}


class History:
    """A sequence of states and the position of the present one."""

    def __init__(self, state: State):
        self._states, self._at, self._last = [state], 0, ("", 0.0)

    @property
    def state(self) -> State:
        """The present one."""
        return self._states[self._at]

    def set(self, state: State, by: str):
        """Go to another state. Movements of the slider `by` are one step until it rests."""
        last, then = self._last
        if by and by == last and monotonic() - then < REST and self._at:
            self._states[self._at :] = [state]
        else:
            self._states = [*self._states[: self._at + 1][-MOST_STEPS:], state]
            self._at = len(self._states) - 1
        self._last = by, monotonic()

    def undo(self) -> bool:
        """Go a step back. Return whether there was one."""
        return self._go(-1)

    def redo(self) -> bool:
        """Go a step forward. Return whether there was one."""
        return self._go(1)

    def _go(self, step):
        self._last = "", 0.0
        if not 0 <= self._at + step < len(self._states):
            return False
        self._at += step
        return True
