"""Cameras of a study: a base camera with the drawn values of its varied keys."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gpusim.apps.study.sampling import Sampling
from gpusim.domain.camera import Camera
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.changes import place_key
from gpusim.domain.errors import BadData, GpusimError, UnknownName, format_value
from gpusim.domain.short_repr import short_repr
from gpusim.io.camera.cameras import camera_names, camera_table, open_camera

_ITEM = re.compile(r"(.+)\[(\d+)\]")  # a number of a list, such as optics.zernike_waves[3]
LONGEST_LIST = 100


@dataclass(frozen=True, eq=False)
class Varied:
    """Cameras.

    Args:
        base: The camera whose keys are varied.
        sampling: The varied keys, and the way to choose their values.
        lists: The base's lists of which single numbers are varied, by key.
    """

    base: Camera
    sampling: Sampling
    lists: Mapping[str, list] = field(default_factory=dict)

    __repr__ = short_repr

    @classmethod
    def open(cls, given: Any, sampling: Sampling, folder: Path) -> "Varied":
        """Return the cameras of a study file: a base camera's name or file, or a table of base and further keys.

        Raises as `open_camera` and `Camera.with_` do.
        """
        if isinstance(given, Camera):
            return cls(given, sampling, _lists(given, {}, {}, sampling))
        table = dict(given) if isinstance(given, Mapping) else {"base": given}
        name = table.pop("base", None)
        if not isinstance(name, str):
            raise BadData(
                f'camera: base = {format_value(name)}, wanted a camera\'s name, such as "phone"'
            )
        place = name if name in camera_names() else folder / name
        if name not in camera_names() and not Path(place).exists():
            raise UnknownName("camera", name, camera_names())
        base, (_, known) = open_camera(place), camera_table(place)
        changes = _flatten(table)
        if changes:
            base = base.with_(**changes)
        return cls(base, sampling, _lists(base, known, changes, sampling))

    def camera(self, number: int) -> Camera:
        """Return a camera. Raises an error of GpusimError if its values are refused."""
        return self._with(self.sampling.draw(number))

    def check(self) -> None:
        """Raise an error of GpusimError for a key that cameras do not have, or a value that they refuse by itself."""
        keys: dict[tuple[str, str], str] = {}  # the varied key of each field
        for key, one in self.sampling.keys.items():
            item = _ITEM.fullmatch(key)
            section, name = place_key(key if item is None else item[1])
            field = section, SECTIONS[section][name][0]
            if field in keys and not (item and _ITEM.fullmatch(keys[field])):
                raise BadData(f'vary "{key}" and "{keys[field]}" set the same; leave one out')
            keys[field] = key
            for value in one.typical:
                try:
                    self._with({key: value})
                except UnknownName:
                    raise
                except GpusimError as error:
                    raise BadData(f'vary "{key}": {error.details}') from error

    def _with(self, values):
        changes: dict[str, Any] = {}
        for key, value in values.items():
            item = _ITEM.fullmatch(key)
            if item is None:
                changes[key] = value
                continue
            name, place = item[1], int(item[2])
            changed = list(changes.get(name, self.lists[name]))
            changed[place] = value
            changes[name] = changed
        return self.base.with_(**changes)


def _flatten(table) -> dict[str, Any]:
    """Return keys such as "optics.f_number" of a table with sections of keys, or with such keys."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping) and key in SECTIONS:
            found |= {f"{key}.{name}": one for name, one in value.items()}
        else:
            found[key] = value
    return found


def _lists(base, known, changes, sampling) -> dict[str, list]:
    """Return the base's lists of which single numbers are varied, as long as needed. Raises BadData, UnknownName."""
    found: dict[str, list] = {}
    for key in sampling.keys:
        item = _ITEM.fullmatch(key)
        if item is None:
            continue
        name, place = item[1], int(item[2])
        section, _, short = name.rpartition(".")
        value = changes.get(name, known.get(section, {}).get(short, []))
        if not isinstance(value, list) or place >= LONGEST_LIST:
            raise BadData(
                f'vary "{key}": {name} = {format_value(value)}; wanted a place in a list of up to '
                f"{LONGEST_LIST} numbers"
            )
        value = list(found.get(name, value))
        found[name] = value + [0.0] * (place + 1 - len(value))
    return found
