"""The scene of a client: a chart or files, and how they are read."""

import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import PurePath
from typing import Any, NamedTuple

from gpusim.data.charts import CHARTS
from gpusim.domain.errors import BadData, OutOfRange, format_value
from gpusim.domain.scene import PANORAMA, PLANE
from gpusim.io.scene.option_texts import (
    WAVELENGTHS,
    format_size,
    parse_band,
    parse_degrees,
    parse_size,
    parse_wavelengths,
)
from gpusim.io.scene.readers import CHARTS_TAKE, READERS

DEFAULT_SIZE = (768, 512)  # columns and rows of a chart [pixel]
MOST_PIXELS = 2**25  # of a frame
MOST_FILES, LONGEST_NAME, LONGEST_OPTION = 64, 120, 400  # of a scene; [character]
SHA = re.compile(r"[0-9a-f]{64}")


class Option(NamedTuple):
    """An option of `open_scene`.

    label: On the page. parse: Function from a text to the value; it raises ValueError. wanted: The
    allowed texts in words. flag: On the command line. choices: The allowed texts; (): any.
    """

    label: str
    parse: Callable[[str], Any]
    wanted: str
    flag: str
    choices: tuple[str, ...] = ()


def _parse_bands(text):
    return dict(parse_band(part) for part in text.split(","))


def _choice(label, flag, *choices):
    return Option(label, str, " or ".join(choices), flag, choices)


OPTIONS = {
    "wavelengths": Option("wavelengths [nm]", parse_wavelengths, WAVELENGTHS, "--wavelengths"),
    "kind": _choice("values are", "--kind", "reflectance", "radiance"),
    "scale": Option("value of 1.0", float, "a number, such as 100 for percent", "--scale"),
    "key": Option("name of the cube", str, "a name in the file", "--key"),
    "bands": Option("bands [nm]", _parse_bands, "NAME=NM,NAME=NM ...", "--band"),
    "part": Option("part or page", str, "a name, or a number from 0", "--part"),
    "layer": Option("layer", str, "a name, such as ViewLayer", "--layer"),
    "view": Option("view", str, "a name, such as right", "--view"),
    "border": _choice("outside", "--border", "zero", "edge", "reflect"),
    "samples_per_pixel": Option(
        "samples per pixel", float, "a number from 1", "--samples-per-pixel"
    ),
    "fov": Option("field of view [degree]", parse_degrees, "degrees", "--fov"),
    "depth": _choice("depth", "--depth", "axis", "ray", "none"),
    "projection": _choice("projection", "--projection", PLANE, PANORAMA),
}
OF_ALL = ("border", "samples_per_pixel", "fov")  # options that every scene takes
OF_DEPTH = {"ray": "depth", "no_depth": "depth"}  # a reader's name -> the option


@dataclass(frozen=True)
class SceneChoice:
    """The scene that a client has chosen.

    Attributes:
        name: Name of a chart; or of a file in `files`, or of the folder that they make. "": the
            scenes that the preview was started with.
        files: Name -> SHA-256 of each file of the scene, in hexadecimal. {}: no file.
        size: Columns and rows of a chart, of patches or of a view of a panorama [pixel]. None: the
            default of `open_scene`.
        options: Options of `open_scene` by their names, as texts.
    """

    name: str = ""
    files: dict[str, str] = field(default_factory=dict)
    size: tuple[int, int] | None = None
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_json(cls, found: Any) -> "SceneChoice":
        """Return the choice of a link. Raises TypeError or ValueError."""
        choice = cls(**found)
        if isinstance(choice.size, list):
            choice = cls(choice.name, choice.files, tuple(choice.size), choice.options)
        if not choice.is_sound:
            raise ValueError
        return choice

    @property
    def is_sound(self) -> bool:
        """Return whether all fields have their types, and the scene is a chart or named files."""
        files, size, options = self.files, self.size, self.options
        return (
            isinstance(self.name, str)
            and isinstance(files, dict)
            and len(files) <= MOST_FILES
            and all(is_file_name(name) and is_sha(sha) for name, sha in files.items())
            and (is_file_name(self.name) if files else self.name in ("", *CHARTS))
            and (size is None or is_size(size))
            and isinstance(options, dict)
            and options.keys() <= OPTIONS.keys()
            and all(
                isinstance(text, str) and len(text) <= LONGEST_OPTION for text in options.values()
            )
        )

    @property
    def key(self) -> str:
        """Text that is equal for equal choices."""
        return json.dumps(asdict(self), sort_keys=True)

    @property
    def is_given(self) -> bool:
        """Return whether it is the scenes that the preview was started with."""
        return not self.name

    @property
    def suffix(self) -> str:
        """Suffix of the file, in lower case. "": a chart, or a folder of bands."""
        return PurePath(self.name).suffix.lower() if self.name in self.files else ""

    @property
    def takes(self) -> tuple[str, ...]:
        """Names of the options of `open_scene` that this scene takes, "size" among them."""
        if self.is_given:
            return ()
        if not self.files:
            own: tuple[str, ...] = CHARTS_TAKE
        elif self.suffix in READERS:
            own = READERS[self.suffix].options
        else:
            own = ("wavelengths", "kind", "scale")  # a folder
        own = tuple(dict.fromkeys(OF_DEPTH.get(name, name) for name in own))
        return (*own, *OF_ALL, *(["projection"] if self.files else []))

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `open_scene` without the name. Raises BadData."""
        found: dict[str, Any] = {} if self.size is None else {"size": self.size}
        for name, text in self.options.items():
            found[name] = parse_option(name, text)
        return found

    def words(self) -> list[str]:
        """Return the scene and its options as words of a command line."""
        found = [self.name]
        if self.size is not None:
            found += ["--size", format_size(self.size)]
        for name, text in self.options.items():
            for part in text.split(",") if name == "bands" else [text]:
                found += [OPTIONS[name].flag, part]
        return found


def parse_option(name: str, text: str) -> Any:
    """Return the value of an option of OPTIONS. Raises BadData."""
    option = OPTIONS[name]
    try:
        if option.choices and text not in option.choices:
            raise ValueError
        return option.parse(text)
    except (ValueError, ZeroDivisionError, OverflowError):
        raise BadData(f"{option.label} = {format_value(text)}: wanted {option.wanted}") from None


def is_file_name(name: Any) -> bool:
    """Return whether a value is the name of a file without a folder."""
    return (
        isinstance(name, str)
        and 0 < len(name) <= LONGEST_NAME
        and len(name.encode("utf-8", "replace")) < 2 * LONGEST_NAME
        and name.isprintable()
        and not name.startswith((".", "-", " "))
        and not set(name) & set('/\\:*?"<>|')
    )


def is_sha(text: Any) -> bool:
    """Return whether a value is a SHA-256 in lower hexadecimal letters."""
    return isinstance(text, str) and SHA.fullmatch(text) is not None


def is_size(size: Any) -> bool:
    """Return whether a value is columns and rows of a frame that a preview makes."""
    return (
        isinstance(size, tuple)
        and len(size) == 2
        and all(type(length) is int and length > 0 for length in size)
        and size[0] * size[1] <= MOST_PIXELS
    )


def checked_size(text: str) -> tuple[int, int]:
    """Return columns and rows of a text COLSxROWS. Raises OutOfRange."""
    try:
        size = parse_size(text)
    except ValueError:
        size = (0, 0)
    if not is_size(size):
        most = f"{MOST_PIXELS / 1e6:.0f} million pixels"
        raise OutOfRange("size", text, f"COLSxROWS of up to {most}, such as 1280x720")
    return size
