"""Short reprs: what a prompt, a debugger or a failed test shows of an object in a line or two."""

import dataclasses

import numpy as np

LONGEST, NESTED = 200, 60  # letters of a repr, and of a part of it


def brief(made) -> str:
    """The repr of a dataclass: its name, and fields that are not as by default; of arrays the type and the shape."""
    parts = [
        f"{field.name}={_part(getattr(made, field.name))}"
        for field in dataclasses.fields(made)
        if field.repr
        and (field.name == "name" or not _is_default(field, getattr(made, field.name)))
    ]
    return shortened(f"{type(made).__name__}({', '.join(parts)})")


def shortened(text: str) -> str:
    """A repr of LONGEST letters at most."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]}...{text[-1]}"


def span(wavelengths) -> str:
    """How many wavelengths [nm] there are, and from where to where."""
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
