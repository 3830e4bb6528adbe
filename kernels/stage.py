"""What a stage is, how its versions are found, and how they are compared.

A stage `area.name` is four files in `kernels/area/`:

    name.py        the contract: the host function `name(device, ...)`, `cases()` for the tests,
                   `bench(rows, cols)`; and, if a formula is easy, `operations(...)`: multiplications
                   and additions for the inputs of `bench`
    name_ref.py    the reference `name(...)`: NumPy, float64, written like the formula. It shares
                   nothing with the kernels. It may stand in gpusim.optics if plans need it too
    name.cl        OpenCL C kernels
    name_warp.py   Warp kernels with the same names and arguments; a function
                   `specialise(kernel, **defines)` there builds those whose code depends on
                   compile-time constants

Stages are found by file name; there is no registry. KERNELS.md describes the conventions.
"""

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias, TypeVar

import numpy as np

from gpusim.backends import Device, open_device

AREAS = ("spectral", "optics", "sensor", "processor", "display")  # in the order of the light
ROOT = Path(__file__).parent
Array: TypeAlias = Any  # a NumPy array, or an array of the device that runs the stage
Result = TypeVar("Result")


@dataclass(frozen=True)
class Case:
    """One input of a stage, and the largest error of a device against the reference.

    Attributes:
        name: Content of the case, in a few words.
        inputs: Keyword arguments of the stage's function: NumPy arrays and numbers.
        tolerance: Bound on the error, in units of the metric.
        why: How the tolerance is derived.
        metric: "peak": max |device - reference| / max |reference|. "local": max over pixels of
            |device - reference| / max(|reference|, floor). "exact": the largest absolute
            difference; tolerance 0 then means bit for bit.
        floor: Least denominator of the metric "local", in the reference's unit.
        needs_float64: Whether devices without float64 refuse this input.
    """

    name: str
    inputs: dict = field(repr=False)
    tolerance: float
    why: str
    metric: str = "peak"
    floor: float = 0.0
    needs_float64: bool = False

    def error(self, result: np.ndarray, reference: np.ndarray) -> float:
        """Return the largest error of `result` in this case's metric.

        Args:
            result: The stage's result, any shape.
            reference: The reference's result, of the same shape.

        Returns:
            The error; infinite if the shapes differ or only one of two values is NaN.
        """
        result, reference = np.asarray(result, np.float64), np.asarray(reference, np.float64)
        if result.shape != reference.shape:
            return np.inf
        both_nan = np.isnan(result) & np.isnan(reference)
        same = both_nan | (result == reference)  # equal infinities count as equal
        with np.errstate(invalid="ignore"):
            difference = np.where(same, 0.0, np.abs(result - reference))
        difference[np.isnan(difference)] = np.inf
        if not difference.size:
            return 0.0
        if self.metric == "exact":
            return float(difference.max())
        magnitude = np.abs(np.where(both_nan, 0.0, reference))
        if self.metric == "local":
            return float(
                (difference / np.maximum(magnitude, max(self.floor, np.finfo(float).tiny))).max()
            )
        return float(
            difference.max() / max(float(np.nanmax(magnitude, initial=0.0)), np.finfo(float).tiny)
        )


def exact_case(name: str, why: str, **inputs: Any) -> Case:
    """Return a case in which devices and the reference must agree bit for bit.

    Args:
        name: Content of the case, in a few words.
        why: Why they agree.
        **inputs: Arguments of the stage's function.

    Returns:
        The case.
    """
    return Case(name, inputs, 0.0, why, metric="exact")


def stage(function: Callable[..., Result]) -> Callable[..., Result]:
    """Make `function(device, ...)` the public function of the stage that its module is named after.

    The public function is called as `name(..., device="auto")`, and its signature says so. The
    NumPy device runs the reference. On other devices, arrays may be NumPy arrays or arrays of that
    device.

    Args:
        function: The stage's host function, with the device as its first parameter.

    Returns:
        The public function. It returns a NumPy array if no argument is an array of the device. It
        raises TypeError, with the stage's name, for arguments that do not fit the signature.
    """
    name = function.__module__.removeprefix("gpusim.kernels.")
    reference = _reference_of(function.__module__, function.__name__)
    signature = _public_signature(function)

    @functools.wraps(function)
    def public(*args, device: Device | str = "auto", **kwargs):
        device = open_device(device) if isinstance(device, str) else device
        try:
            if device.kind == "numpy":
                with device.charged(name), device.host_work():
                    return reference()(*args, **kwargs)
            with device.charged(name):
                result = function(device, *args, **kwargs)
        except TypeError:  # checked only now: binding takes as long as a small kernel's launch
            _require_arguments(name, signature, args, kwargs)
            raise
        on_device = any(isinstance(value, device.array_type) for value in (*args, *kwargs.values()))
        return result if on_device else device.numpy(result).copy()

    vars(public)["__signature__"] = signature
    public.__annotations__ = {
        parameter.name: parameter.annotation for parameter in signature.parameters.values()
    } | {"return": signature.return_annotation}
    return public


def _public_signature(function):
    """Return the signature of `function` with the device moved to the end, as a keyword."""
    inner = inspect.signature(function)
    parameters = [
        *list(inner.parameters.values())[1:],
        inspect.Parameter(
            "device", inspect.Parameter.KEYWORD_ONLY, default="auto", annotation=Device | str
        ),
    ]
    # **kwargs stay last
    return inner.replace(parameters=sorted(parameters, key=lambda parameter: parameter.kind))


def _require_arguments(name, signature, args, kwargs):
    """Raise TypeError if the arguments do not fit the stage's signature."""
    try:
        signature.bind(*args, **kwargs)
    except TypeError as wrong:
        plain = signature.replace(
            parameters=[
                each.replace(annotation=each.empty) for each in signature.parameters.values()
            ],
            return_annotation=signature.empty,
        )
        raise TypeError(f"{name}: {wrong}; wanted {name.rpartition('.')[2]}{plain}") from None


def _reference_of(module, name):
    return lambda: getattr(import_module(f"{module}_ref"), name)


def dtype_name(array: Array) -> str:
    """Return the name of an array's type.

    Args:
        array: A NumPy array or an array of a device; Warp's types are classes.

    Returns:
        The name, for example "uint16".
    """
    return getattr(array.dtype, "name", None) or array.dtype.__name__


def is_opencl_cpu(device: Device) -> bool:
    """Return whether the device is a CPU that runs OpenCL.

    Its kernels spell out their vectors and their loops along a row.
    """
    return device.kind == "opencl" and not device.is_gpu


def warp_only(device: Device, *numbers: Any) -> tuple:
    """Return the arguments that only Warp kernels take, because OpenCL has them as defines.

    Args:
        device: The device.
        *numbers: The arguments, in the kernel's order.

    Returns:
        The arguments, or none for OpenCL.
    """
    return () if device.kind == "opencl" else numbers


def stage_names() -> list[str]:
    """Return every stage as `area.name`, in the order in which light passes them.

    Returns:
        The names.
    """
    return [
        f"{area}.{path.name.removesuffix('_ref.py')}"
        for area in AREAS
        for path in sorted((ROOT / area).glob("*_ref.py"))
    ]


def stage_module(name: str) -> ModuleType:
    """Return the contract module of stage `area.name`.

    Args:
        name: The stage.

    Returns:
        The module `kernels/area/name.py`.
    """
    return import_module(f"gpusim.kernels.{name}")


def public_function(name: str) -> Callable:
    """Return the public function of stage `area.name`.

    Args:
        name: The stage.

    Returns:
        The function, called as `name(..., device="auto")`.
    """
    return getattr(stage_module(name), name.rpartition(".")[2])


def make_resident(device: Device, inputs: dict[str, Any]) -> dict[str, Any]:
    """Return inputs of a stage with their arrays on the device.

    Args:
        device: The device.
        inputs: Arguments of a stage's public function by name.

    Returns:
        The same arguments, each NumPy array copied to the device in its own type.
    """
    return {
        key: device.array(value, value.dtype) if isinstance(value, np.ndarray) else value
        for key, value in inputs.items()
    }


def compare(name: str, device: Device) -> Iterator[tuple[Case, float | None]]:
    """Run every case of a stage on `device`.

    Args:
        name: The stage, as `area.name`.
        device: The device to compare with the reference.

    Yields:
        Each case and its error against the float64 reference; None for a case that needs float64
        on a device without.
    """
    module = stage_module(name)
    leaf = name.rpartition(".")[2]
    reference = getattr(import_module(f"{module.__name__}_ref"), leaf)
    for case in module.cases():
        if case.needs_float64 and not device.has_fp64:
            yield case, None
            continue
        result = getattr(module, leaf)(**case.inputs, device=device)
        yield case, case.error(result, reference(**case.inputs))
