"""Calls of packages that build on this one, by name: of readers, for values that files may stand for."""

from importlib import import_module
from typing import Any


def call_above(name: str, *args: Any) -> Any:
    """Return the result of a function of another package, which is loaded if necessary.

    Names of lights, reflectances and curves may be those of files, and files are read by packages
    that build on the domain and its data. This is the only way up.

    Args:
        name: Module in gpusim, and function: "io.lamps.read_lamp".
        args: Arguments of the function.

    Returns:
        Its result.
    """
    module, _, function = name.rpartition(".")
    return getattr(import_module(f"gpusim.{module}"), function)(*args)
