"""Settings of a client of the preview: changes of a camera file, the scene's light, and the view."""

import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Any

from gpusim.apps.preview.control import Control
from gpusim.apps.preview.controls import CONTROLS, TOLERANCES, VIEWS
from gpusim.apps.preview.scene_choice import SceneChoice, is_file_name, is_sha
from gpusim.data.lights import BRIGHTEST
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.io.camera.cameras import (
    NO_BASE,
    REPLACED,
    anchor_paths,
    camera_names,
    camera_of,
    camera_table,
    override_keys,
)

COMPARISONS = ("split", "side by side", "difference", "blink")
MOST_SNAPSHOTS, MOST_BESIDE = 8, 3
MOST_STEPS, REST = 200, 1.0  # of undo; [s] after which a slider that moves again makes another
LONGEST_LINK = 8192  # [character]
SUFFIX = re.compile(r"\.[A-Za-z]\w*$")


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
        snapshots: Name -> `camera` and `changes` of a camera that was kept.
        against: Name of the snapshot that is compared with. None: nothing is compared.
        compare: One of COMPARISONS.
        split: Part of the width left of which this camera's picture is shown.
        scene: The scene.
        files: Name -> SHA-256 of the other files that the settings name: of a light, of the camera.
        marks_clipped: Whether clipped pixels are marked in the picture.
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
    snapshots: dict[str, dict[str, Any]] = field(default_factory=dict)
    against: str | None = None
    compare: str = "split"
    split: float = 0.5
    scene: SceneChoice = field(default_factory=SceneChoice)
    files: dict[str, str] = field(default_factory=dict)
    marks_clipped: bool = False

    @property
    def other_names(self) -> tuple[str, ...]:
        """Snapshots that are shown with this camera: one, or up to MOST_BESIDE - 1 side by side."""
        if self.against is None:
            return ()
        names = (self.against, *(name for name in self.snapshots if name != self.against))
        return names[: MOST_BESIDE - 1] if self.compare == "side by side" else names[:1]

    @property
    def others(self) -> tuple["State", ...]:
        """The states whose pictures are shown with this one."""
        return tuple(map(self.snapshot, self.other_names))

    def keep(self, name: str) -> "State":
        """Return a state that keeps this camera as a snapshot, and compares with it."""
        one = {"camera": self.camera, "changes": self.changes}
        return replace(self, snapshots={**self.snapshots, name: one}, against=name)

    def drop(self, name: str) -> "State":
        """Return a state without a snapshot."""
        kept = {one: value for one, value in self.snapshots.items() if one != name}
        against = self.against if self.against != name else next(iter(kept), None)
        return replace(self, snapshots=kept, against=against)

    def value(self, control: Control, table: dict) -> Any:
        """Return the value of a control: set, of the camera file, or its default."""
        if control.name in self.changes:
            return self.changes[control.name]
        if control.named:
            return next(iter(control.named))  # the file's own
        given = table.get(control.section, {}).get(control.key)
        if given is None and control.item is None:
            return control.default
        return control.value_in(given)

    def change(self, name: str, value: Any) -> "State":
        """Return a state with another value of a control, without the changes that it replaces."""
        control = CONTROLS[name]
        replaced = REPLACED.get(control.section, {}).get(control.key, ())
        gone = {f"{control.section}.{key}" for key in replaced} | {name}
        if control.item is None:  # the whole list replaces its items
            gone |= {one for one in self.changes if one.startswith(f"{name}.")}
        kept = {one: value for one, value in self.changes.items() if one not in gone}
        return replace(self, changes=kept | {name: value})

    def reset(self, name: str) -> "State":
        """Return a state in which a control has the camera file's value again."""
        kept = {one: value for one, value in self.changes.items() if one != name}
        return replace(self, changes=kept)

    def table(self) -> dict:
        """Return the camera file's table with the changes and absolute file names.

        Raises BadFile, UnknownName.
        """
        below = anchor_paths(*camera_table(self.camera))
        return override_keys(below, self.own_keys(below))

    def own_keys(self, table: dict) -> dict[str, dict]:
        """Return the changed keys by their sections. table: the camera file's.

        Raises BadData or OutOfRange for a value.
        """
        own: dict[str, dict] = {}
        for name, value in self.changes.items():
            control = CONTROLS[name]
            control.check(value)
            if control.named and (value := control.named[value]) is None:
                continue
            section = own.setdefault(control.section, {})
            given = section.get(control.key, table.get(control.section, {}).get(control.key))
            section[control.key] = control.put_in(given, value)
        return own

    def build(self) -> Camera:
        """Return the camera. Raises as `open_camera` does."""
        return camera_of(camera_table(self.camera)[0], self.table())

    def with_paths(self, path_of: Callable[[str, str], Path]) -> "State":
        """Return the settings with the paths of the files in `files` in place of their names.

        path_of: Function from a name and a SHA-256 to the path. Raises as it does.
        """
        if not self.used_files:
            return self
        paths = {name: str(path_of(name, sha)) for name, sha in self.used_files.items()}
        light = None if self.light is None else paths.get(self.light, self.light)
        changes = {key: _with_paths(value, paths) for key, value in self.changes.items()}
        return replace(self, light=light, changes=changes)

    def toml(self) -> str:
        """Return the text of the camera file."""
        import tomli_w

        return tomli_w.dumps({"base": NO_BASE} | self.table())  # it has all keys

    @property
    def asked(self) -> str | None:
        """Tolerance for a Simulator."""
        return None if self.tolerance == "exact" else self.tolerance

    @property
    def _texts(self) -> set[str]:
        """All texts of the settings that may name files, except the camera and the scene."""
        kept = [one["changes"] for one in self.snapshots.values()]
        return {self.light or "", *_texts_in(self.changes), *_texts_in(kept)}

    @property
    def used_files(self) -> dict[str, str]:
        """The part of `files` that the settings name."""
        return {name: sha for name, sha in self.files.items() if name in self._texts}

    @property
    def _names_other_files(self) -> bool:
        """Whether the settings name files that no client has sent: files of this machine."""
        return any(names_file(text) for text in self._texts - self.files.keys())

    @property
    def is_sound(self) -> bool:
        """Return whether all fields have their types, and values that the page can set."""
        one, numbers, kept = self.luminance, (self.seed, self.frame), self.snapshots
        return (
            isinstance(self.camera, str)
            and isinstance(self.changes, dict)
            and self.changes.keys() <= {*CONTROLS}
            and not any(value is None for value in self.changes.values())
            and not any(
                isinstance(value, list | dict) and not CONTROLS[name].is_text
                for name, value in self.changes.items()
            )
            and (self.light is None or isinstance(self.light, str))
            and isinstance(self.files, dict)
            and all(is_file_name(name) and is_sha(sha) for name, sha in self.files.items())
            and isinstance(self.scene, SceneChoice)
            and self.scene.is_sound
            and (one is None or (type(one) in (int, float) and 0 < one <= BRIGHTEST))
            and self.tolerance in TOLERANCES
            and self.view in VIEWS
            and isinstance(self.is_live, bool)
            and isinstance(self.marks_clipped, bool)
            and all(type(number) is int and 0 <= number < 2**32 for number in numbers)
            and isinstance(kept, dict)
            and len(kept) <= MOST_SNAPSHOTS
            and all(isinstance(each, dict) for each in kept.values())
            and all(each.keys() == {"camera", "changes"} for each in kept.values())
            and (self.against is None or self.against in kept)
            and self.compare in COMPARISONS
            and type(self.split) in (int, float)
            and 0 <= self.split <= 1
        )

    def link(self) -> str:
        """Return all settings as text for an address, which `State.of_link` reads."""
        own = replace(self, files=self.used_files)
        found = {key: value for key, value in asdict(own).items() if value != _DEFAULTS.get(key)}
        if "scene" in found:
            found["scene"] = {key: value for key, value in found["scene"].items() if value}
        return json.dumps(found, separators=(",", ":"))

    @classmethod
    def of_link(cls, text: str, camera: str) -> "State":
        """Return the state of a link, which may be of an older page. camera: if it names none.

        Raises BadData.
        """
        try:
            if len(text) > LONGEST_LINK:
                raise ValueError
            found = {"camera": camera} | json.loads(text)
            found["scene"] = SceneChoice.of_json(found.get("scene", {}))
            state = cls(**found)
            known = (
                state.is_sound
                and all(state.snapshot(name).is_sound for name in state.snapshots)
                and not state._names_other_files
            )
        except (ValueError, TypeError, RecursionError):  # RecursionError: of JSON, lists in lists
            known = False
        if not known:
            raise BadData("link: not one of this preview's; wanted one that its page made")
        # a link may come from anybody: it names no files of this machine
        kept = {
            name: one if one["camera"] in camera_names() else one | {"camera": camera}
            for name, one in state.snapshots.items()
        }
        state = replace(state, snapshots=kept)
        return state if state.camera in camera_names() else replace(state, camera=camera)

    def snapshot(self, name: str) -> "State":
        """Return the state with the camera of a snapshot."""
        return replace(self, **self.snapshots[name], snapshots={}, against=None)


def names_file(text: str) -> bool:
    """Return whether a text names a file, not a built-in table: "FL3.15" has no suffix."""
    return bool(set(text) & set("/\\")) or SUFFIX.search(text) is not None


def _with_paths(value, paths):
    """Return a value of JSON with other texts."""
    if isinstance(value, list):
        return [_with_paths(item, paths) for item in value]
    if isinstance(value, dict):
        return {key: _with_paths(item, paths) for key, item in value.items()}
    return paths.get(value, value) if isinstance(value, str) else value


def _texts_in(value):
    """Yield all texts in a value of JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts_in(item)


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

    def replace(self, state: State):
        """Change the present state, not as a step."""
        self._states[self._at] = state

    @property
    def steps(self) -> tuple[list[State], int]:
        """All states, and the position of the present one."""
        return self._states, self._at

    def go_to(self, place: int) -> bool:
        """Go to the state at a position. Return whether there is one."""
        return self._go(place - self._at)

    def _go(self, step):
        self._last = "", 0.0
        if not 0 <= self._at + step < len(self._states):
            return False
        self._at += step
        return True
