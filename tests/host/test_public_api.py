"""Public names have types on all parameters and results, and docstrings in Google style.

Public are the names in `gpusim.__all__` with their public methods and properties, and the function
of every stage. A parameter needs a type and a line in `Args:`; a result needs a type and `Returns:`;
a function that raises needs `Raises:`; a class with fields needs `Args:` or `Attributes:`.
"""

import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import pytest

import gpusim as gs
from gpusim.kernels.stage import public_function, stage_names

NUMBERS = ("frame", "frame_number", "first_frame", "frames_from", "start", "number")
RAISES = re.compile(r"^\s*raise (?!NotImplementedError|AssertionError|StopIteration)[A-Z]", re.M)


def public_names() -> Iterator[tuple[str, Any]]:
    """Yield every public class and function with its name; of public modules, their members."""
    for name in gs.__all__:
        value = getattr(gs, name)
        if callable(value) and inspect.ismodule(value):  # a package that is also a function
            yield name, type(value).__call__
            continue
        if not inspect.ismodule(value):
            yield name, value
            continue
        for member in getattr(value, "__all__", [key for key in vars(value) if key[0] != "_"]):
            own = getattr(value, member)
            if getattr(own, "__module__", "").startswith(value.__name__):
                yield f"{name}.{member}", own
    for name in stage_names():
        yield f"stage {name}", public_function(name)


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that a class defines, as functions or properties."""
    for name, value in vars(cls).items():
        if name.startswith("_") and name not in ("__init__", "__call__"):
            continue
        if isinstance(value, property | cached_property):
            yield name, value
            continue
        function = getattr(value, "__func__", value)  # of class and static methods
        if inspect.isfunction(function) and function.__module__.startswith("gpusim"):
            if not function.__qualname__.startswith("__create"):  # made by `dataclass`
                yield name, function


def has_section(doc: str, *names: str) -> bool:
    """Return True if a docstring has one of these sections."""
    return bool(re.search(rf"^({'|'.join(names)}):$", doc, re.M))


def class_faults(cls: type) -> list[str]:
    """Return the faults of a class's own docstring."""
    doc = inspect.getdoc(cls) or ""
    if not vars(cls).get("__doc__"):
        return ["no docstring"]
    has_fields = any(not name.startswith("_") for name in inspect.get_annotations(cls))
    has_arguments = "__init__" in vars(cls) and len(inspect.signature(cls.__init__).parameters) > 1
    if (has_fields or has_arguments) and not issubclass(cls, Exception):
        if not has_section(doc, "Args", "Attributes"):
            return ["no Args: or Attributes:"]
    return []


def property_faults(value: Any) -> list[str]:
    """Return the faults of a property."""
    function = value.func if isinstance(value, cached_property) else value.fget
    faults = [] if inspect.getdoc(value) else ["no docstring"]
    if inspect.signature(function).return_annotation is inspect.Signature.empty:
        faults.append("result without a type")
    return faults


def function_faults(function: Any) -> list[str]:
    """Return the faults of a function or method; `__init__` is documented at its class."""
    signature, is_init = inspect.signature(function), function.__name__ == "__init__"
    parameters = [name for name in signature.parameters if name not in ("self", "cls")]
    faults = [
        f"{name} without a type"
        for name in parameters
        if signature.parameters[name].annotation is inspect.Parameter.empty
    ]
    if is_init:
        return faults
    doc, result = inspect.getdoc(function) or "", signature.return_annotation
    if result is inspect.Signature.empty:
        faults.append("result without a type")
    if not doc:
        return [*faults, "no docstring"]
    if parameters and not has_section(doc, "Args"):
        faults.append("no Args:")
    elif parameters:
        section = doc.split("Args:\n", 1)[1].split("\n\n", 1)[0]
        for name in parameters:
            if not re.search(
                rf"^ +\*{{0,2}}([\w, ]+, )?{re.escape(name)}(, [\w, ]+)?:", section, re.M
            ):
                faults.append(f"Args: lacks {name}")
    if result not in (None, "None", inspect.Signature.empty):
        if not has_section(doc, "Returns", "Yields"):
            faults.append("no Returns:")
    if RAISES.search(inspect.getsource(function)) and not has_section(doc, "Raises"):
        faults.append("no Raises:")
    return faults


def faults_of(name: str, value: Any, seen: set[int]) -> Iterator[str]:
    """Yield the faults of a class with its members, or of a function, one line each."""
    if id(value) in seen or not getattr(value, "__module__", "").startswith("gpusim"):
        return
    seen.add(id(value))
    if not inspect.isclass(value):
        yield from (f"{name}: {fault}" for fault in function_faults(value))
        return
    yield from (f"{name}: {fault}" for fault in class_faults(value))
    for key, member in members(value):
        is_property = isinstance(member, property | cached_property)
        faults = property_faults(member) if is_property else function_faults(member)
        yield from (f"{name}.{key}: {fault}" for fault in faults)


def test_public_names_have_types_and_google_docstrings():
    seen: set[int] = set()
    names = list(public_names())
    faults = [fault for name, value in names for fault in faults_of(name, value, seen)]
    assert len(seen) > 100  # the walk finds the classes and the stages
    assert not faults, f"{len(faults)} faults:\n" + "\n".join(faults)


class Bare:
    untold: int

    def __init__(self, size):
        self.size = size

    @property
    def area(self):
        return self.size**2

    def cut(self, where: int, *, deep) -> int:
        """Cut.

        Args:
            where: position.
        """
        if deep:
            raise ValueError(where)
        return where


@pytest.mark.parametrize(
    "fault",
    [
        "Bare: no docstring",
        "Bare.__init__: size without a type",
        "Bare.area: no docstring",
        "Bare.area: result without a type",
        "Bare.cut: deep without a type",
        "Bare.cut: Args: lacks deep",
        "Bare.cut: no Returns:",
        "Bare.cut: no Raises:",
    ],
)
def test_the_check_finds_faults(fault, monkeypatch):
    for part in (Bare, Bare.__init__, Bare.cut):
        monkeypatch.setattr(part, "__module__", "gpusim.sample")
    assert fault in list(faults_of("Bare", Bare, set()))


def test_frames_are_numbered_by_first():
    """A frame's number, or the number of the first of several, is `first` everywhere but in stages, which draw."""
    other, by_first = [], set()
    for path, value in public_names():
        if path.startswith("stage "):
            continue
        for key, member in members(value) if inspect.isclass(value) else [("", value)]:
            if not inspect.isfunction(member):
                continue
            name = f"{path}.{key}" if key else path
            for parameter in inspect.signature(member).parameters.values():
                if parameter.name == "first":
                    by_first.add(name)
                elif parameter.name in NUMBERS and "int" in str(parameter.annotation):
                    other.append(f"{name}({parameter})")
    assert not other
    assert {"Simulator.__call__", "Simulator.frames", "Exposure.raw", "Exposure.frames"} <= by_first
    assert {"Loop.raw", "Loop.codes", "Loop.frame", "Loop.output"} <= by_first
    assert {"Readout.draw", "PictureBatch.__call__", "burst", "bracket", "average"} <= by_first
