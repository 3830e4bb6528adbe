"""A camera file's text, with intervals and provenance as comments."""

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gpusim.domain.errors import one_line
from gpusim.domain.psf import PointSpread
from gpusim.fit.estimate import Estimate
from gpusim.io.camera.cameras import camera_names

if TYPE_CHECKING:
    from gpusim.fit.fitting import Fit

WIDTH = 118
SECTIONS = ("optics", "sensor", "noise", "processor", "display")
MOST_NAMES = 2


def camera_text(fit: "Fit", path: Path) -> str:
    """Return the text of a camera file.

    Args:
        fit: The fit.
        path: Where the file will be; the base is named from there.

    Returns:
        TOML.
    """
    lines = [
        *_comment(f"{fit.name or 'A camera'}, fitted by gpusim to its own raw files."),
        *_comment(
            "Numbers in brackets are intervals of 95 % confidence. Keys that are not here are the base's."
        ),
        *(line for one in fit.lines for line in _comment(one)),
        "",
        f"name = {_value(fit.name or 'fitted')}",
        f"base = {_value(_base(fit.base, path))}",
    ]
    estimates = fit.estimates
    for section in SECTIONS:
        keys = fit.settings.get(section)
        if not keys:
            continue
        lines += ["", f"[{section}]"]
        for key, value in keys.items():
            if isinstance(value, PointSpread):
                value = spread_path(path).name
            lines += _key_lines(section, key, value, estimates)
    used = {f"{section}.{key}" for section, keys in fit.settings.items() for key in keys}
    rest = {key: one for key, one in estimates.items() if key not in used}
    lines += _list("Other estimates", [f"{key}: {words(one)}" for key, one in rest.items()])
    lines += _list("Not explained by the model", fit.unexplained)
    lines += _list("Not fitted", fit.failed)
    lines += _list("Not known from these shots", fit.unknown)
    return "\n".join(lines) + "\n"


def spread_path(path: Path) -> Path:
    """Return the file of the point spreads next to a camera file."""
    return path.with_suffix(".psf.npz")


def words(one: Estimate) -> str:
    """Return an estimate with its interval in words."""
    unit = f" {one.unit}" if one.unit else ""
    note = f"; {one.note}" if one.note else ""
    if one.low == one.high:
        return f"{one.value:.5g}{unit}{note}"
    return f"{one.value:.5g} [{one.low:.5g} .. {one.high:.5g}]{unit}{note}"


def names_of(one: Estimate) -> str:
    """Return the files of an estimate: all of them, or the first and the last."""
    names = sorted(one.sources)
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    return f"{names[0]} .. {names[-1]}, {len(names)} frames"


def _key_lines(section, key, value, estimates):
    full = f"{section}.{key}"
    named = [
        one for name, one in estimates.items() if name == full or name.startswith(f"{full} at")
    ]
    lines = []
    if named:
        lines += _comment(f"{words(named[0])}, from {names_of(named[0])}")
    elif value == 0:
        lines += _comment("not measured, or not above 0")
    return [*lines, f"{key} = {_value(value)}"]


def _list(title, lines):
    if not lines:
        return []
    return ["", f"# {title}:", *(part for line in lines for part in _comment(f"- {line}"))]


def _comment(text):
    """Return a text as lines of a comment."""
    found, line = [], "#"
    for word in one_line(text, 2000).split(" "):
        if len(line) + len(word) + 1 > WIDTH and line != "#":
            found.append(line)
            line = "#  "
        line = f"{line} {word}"
    return [*found, line]


def _base(base, path):
    if base in camera_names():
        return base
    return Path(os.path.relpath(base, path.absolute().parent)).as_posix()


def _value(value) -> str:
    """Return a value in TOML."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = re.sub(r'[\\"]', lambda found: f"\\{found[0]}", value)
        return f'"{"".join(letter if letter.isprintable() else " " for letter in text)}"'
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_value(one)}' for key, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, int | np.integer):
        return str(int(value))
    number = float(value)
    return f"{number:.8g}" if math.isfinite(number) else "0.0"
