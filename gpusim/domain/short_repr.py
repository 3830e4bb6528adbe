"""Short reprs of objects for prompts, debuggers and failed tests."""

import dataclasses

import numpy as np

LONGEST, NESTED = 200, 60  # largest number of letters of a repr, and of a part of it


def short_repr(made) -> str:
    """Return the repr of a dataclass: its name, and the fields that differ from their defaults.

    Arrays show their type and shape.
    """
    parts = [
        f"{field.name}={_part(getattr(made, field.name))}"
        for field in dataclasses.fields(made)
        if field.repr
        and (field.name == "name" or not _is_default(field, getattr(made, field.name)))
    ]
    return shorten_repr(f"{type(made).__name__}({', '.join(parts)})")


def shorten_repr(text: str) -> str:
    """Return a repr shortened to at most LONGEST letters."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]}...{text[-1]}"


def span(wavelengths) -> str:
    """Return the number of wavelengths, the first and the last [nm], as text."""
    return f"{len(wavelengths)} wavelengths {wavelengths[0]:g} .. {wavelengths[-1]:g} nm"


def _is_default(field, value):
    if field.default_factory is not dataclasses.MISSING:
        return value == field.default_factory()
    return value is field.default or (
        isinstance(value, int | float | str | tuple) and value == field.default
    )


def _part(value):
    if hasattr(value, "shape") and hasattr(value, "dtype") and value.shape != ():
        return f"{value.dtype} {tuple(value.shape)}"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    text = " ".join(repr(value).split())
    if len(text) <= NESTED:
        return text
    return f"{text[: NESTED - 3]}..." if isinstance(value, str) else f"{type(value).__name__}(...)"
