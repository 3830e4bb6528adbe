"""Keys of a camera file with the source of each value, and their text."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.errors import one_line

GUESS = "guess: "  # beginning of the source of a value that no data base has
WIDTH = 110  # letters of a comment's line


@dataclass(frozen=True)
class Key:
    """A value of a camera file.

    Attributes:
        section: Of the file.
        name: Of the key.
        value: As TOML has it: a number, text, list or table.
        source: Where it comes from; a guess begins with GUESS.
    """

    section: str
    name: str
    value: object
    source: str

    @property
    def is_guess(self) -> bool:
        """Whether no data base has the value."""
        return self.source.startswith(GUESS)


@dataclass
class Sheet:
    """The keys of a camera file as they are collected.

    Attributes:
        name: Of the camera.
        keys: In the order of the file, section by section.
        notes: For the reader of the file.
    """

    name: str
    keys: list[Key] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, section: str, source: str, **values: object) -> None:
        """Add keys of one section with the same source."""
        self.keys += [Key(section, name, value, source) for name, value in values.items()]

    def text(self) -> str:
        """Return the camera file, a comment with the source above every key."""
        lines = [f"# {self.name}, composed by gpusim from public data bases."]
        lines += ["#", *_comments(self.notes)] if self.notes else []
        lines += ['base = "none"', f"name = {toml(self.name)}"]
        known = {key.section for key in self.keys}
        for section in (one for one in SECTIONS if one in known):
            lines += ["", f"[{section}]"]
            before = ""
            for key in self.keys:
                if key.section == section:
                    lines += _comments([key.source]) if key.source != before else []
                    lines.append(f"{key.name} = {toml(key.value)}")
                    before = key.source
        return "\n".join(lines) + "\n"


def _comments(texts: Sequence[str]) -> list[str]:
    """Return texts as lines of comments, broken between words."""
    lines = []
    for text in texts:
        line = "#"
        for word in one_line(text, 2000).split():
            if len(line) + len(word) > WIDTH and line != "#":
                lines.append(line)
                line = "#  "
            line += f" {word}"
        lines.append(line)
    return lines


def toml(value: object) -> str:
    """Return a value as TOML writes it on one line; numbers with seven digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, str):
        return '"' + "".join(_escape(letter) for letter in value) + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, Sequence):
        raise TypeError(f"{type(value).__name__} is no value of TOML")
    return "[" + ", ".join(map(toml, value)) + "]"


def _number(value):
    if not math.isfinite(value):
        return repr(value)
    text = f"{value:.9g}"
    return text if any(letter in text for letter in ".en") else f"{text}.0"


def _escape(letter):
    if letter in '"\\':
        return f"\\{letter}"
    return letter if letter.isprintable() else f"\\u{ord(letter):04x}"
