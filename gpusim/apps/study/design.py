"""A study's design, from one TOML file: everything that its table depends on."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from gpusim.apps.study.measures import Measure
from gpusim.apps.study.requirements import Requirement
from gpusim.apps.study.sampling import Distribution, Sampling
from gpusim.apps.study.scenes import StudyScene
from gpusim.apps.study.varied import Varied
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.errors import (
    BadData,
    BadFile,
    GpusimError,
    UnknownName,
    checked_count,
    format_value,
)
from gpusim.domain.short_repr import short_repr
from gpusim.io.files import read_text, reading

SECTIONS = (
    "name camera vary sampling scenes seeds measures requirements tolerance".split()
)  # of a study file
COLUMNS = ("row", "camera", "scene", "seed", "error")  # of the table, next to keys and measures
MOST_ROWS = 10**8


@dataclass(frozen=True, eq=False)
class Design:
    """A study.

    Row n is scene and seed n % R of camera n // R, with R = scenes x seeds; seeds change first.

    Args:
        name: Its name.
        text: The study file.
        varied: The cameras.
        places: The scenes by name.
        seeds: Seeds of the noise.
        measures: The measures.
        requirements: The requirements.
        tolerance: Tolerance of each plan, or None, see `Simulator`.
        is_file: Whether `text` is that of a study file.
    """

    name: str
    text: str = field(repr=False)
    varied: Varied
    places: Mapping[str, StudyScene] = field(repr=False)
    seeds: tuple[int, ...]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...] = ()
    tolerance: Tolerance | None = None
    is_file: bool = True

    __repr__ = short_repr

    @property
    def sampling(self) -> Sampling:
        """The way in which cameras are drawn."""
        return self.varied.sampling

    @property
    def each(self) -> int:
        """Rows of a camera."""
        return len(self.places) * len(self.seeds)

    def __len__(self):
        return len(self.sampling) * self.each

    def place_of(self, row: int) -> tuple[int, str, int]:
        """Return the number of a row's camera, the name of its scene, and its seed."""
        camera, rest = divmod(row, self.each)
        scene, seed = divmod(rest, len(self.seeds))
        return camera, list(self.places)[scene], self.seeds[seed]

    @property
    def columns(self) -> list[str]:
        """Names of the columns of the table."""
        *first, last = COLUMNS
        measures = (one.name for one in self.measures)
        requirements = (one.name for one in self.requirements)
        return [*first, *self.sampling.keys, *measures, *requirements, last]

    def camera(self, number: int) -> Camera:
        """Return a camera. Raises an error of GpusimError if its values are refused."""
        return self.varied.camera(number)


def open_design(given: str | PathLike | Mapping[str, Any]) -> Design:
    """Return the design of a study file or of its content. Everything that can be checked before the work is.

    Raises BadData, BadFile, OutOfRange, UnknownName.
    """
    if isinstance(given, Mapping):
        return _design("study", dict(given), Path(), None)
    if not isinstance(given, str | PathLike):
        raise BadData(
            f"study: {type(given).__name__}, wanted the path of a study file or its content, a dictionary"
        )
    path = Path(given)
    text = read_text(path, "TOML")
    with reading(path, "TOML"):
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:  # names the line
            raise BadFile(path, f"not TOML: {error}") from None
    try:
        return _design(path.stem, table, path.parent, text)
    except BadFile:
        raise
    except GpusimError as error:
        raise BadFile(path, error.details) from error


def _design(name, table, folder, text) -> Design:
    """Return the design of a table. text: of its file, or None."""
    for key in table:
        if key not in SECTIONS:
            raise UnknownName("section of a study", key, SECTIONS)
    for key in ("camera", "vary", "scenes", "measures"):
        if not table.get(key):
            raise BadData(
                f"study: no {key}; a study has camera, vary, sampling, scenes and measures"
            )
    keys = {key: Distribution.parse(key, one) for key, one in _table("vary", table["vary"]).items()}
    sampling = Sampling.parse(table.get("sampling"), keys)
    places = {
        key: StudyScene.parse(key, one, folder)
        for key, one in _table("scenes", table["scenes"]).items()
    }
    own = table["measures"]
    own = dict.fromkeys(own, True) if isinstance(own, list | tuple) else _table("measures", own)
    measures = tuple(Measure.parse(key, one, places, folder) for key, one in own.items())
    made = {one.name: one.scenes for one in measures}
    requirements = tuple(
        Requirement.parse(key, one, made)
        for key, one in _table("requirements", table.get("requirements", {})).items()
    )
    _require_different([*COLUMNS, *keys, *made, *(one.name for one in requirements)])
    wanted = table.get("tolerance")
    design = Design(
        str(table.get("name", name)),
        json.dumps(table, default=repr, indent=2) if text is None else text,
        Varied.open(table["camera"], sampling, folder),
        places,
        _seeds(table.get("seeds", 1)),
        measures,
        requirements,
        None if wanted is None else Tolerance.parse(wanted),
        text is not None,
    )
    checked_count("rows of the study", len(design), 1, MOST_ROWS)
    design.varied.check()
    return design


def _table(name, given) -> dict[str, Any]:
    """Return a section. Raises BadData."""
    if not isinstance(given, Mapping):
        raise BadData(f"{name} = {format_value(given)}: wanted a section [{name}]")
    return dict(given)


def _seeds(given) -> tuple[int, ...]:
    """Return the seeds of a count or a list. Raises BadData, OutOfRange."""
    if not isinstance(given, list | tuple):
        return tuple(range(checked_count("seeds", given, 1, 10**6)))
    seeds = tuple(checked_count("seeds", one, 0, 2**64 - 1) for one in given)
    if not seeds or len(set(seeds)) < len(seeds):
        raise BadData(f"seeds = {format_value(given)}: wanted a count, or different numbers")
    return seeds


def _require_different(names):
    for name in names:
        if names.count(name) > 1:
            raise BadData(f"study: two columns of the table would be {name}; give one another name")
