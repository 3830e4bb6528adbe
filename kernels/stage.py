"""What a stage is, how its three versions are found, and how they are compared.

A stage `area.name` is four files in `kernels/area/`:

    name.py        the contract: the host function `name(device, ...)`, `cases()` for the tests, `bench(rows, cols)`;
                   `operations` where a formula is easy: multiplications and additions on the inputs of `bench`
    name_ref.py    `name(...)`: NumPy float64, reads like the formula, shares nothing with the kernels; it may
                   stand in gpusim.optics, where plans are made by it as well
    name.cl        the same as OpenCL C kernels
    name_warp.py   the same as Warp kernels, with the same names and arguments as the OpenCL ones; a function
                   `specialised(kernel, **defines)` there makes those whose code depends on compile-time constants

They are found by file name; there is no registry. Discontinuous stages state how they are compared in their cases.
"""

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import numpy as np

from gpusim.backends import Device, open_device

AREAS = ("spectral", "optics", "sensor", "processor", "display")  # in the order the light goes
ROOT = Path(__file__).parent


@dataclass(frozen=True)
class Case:
    """One input of a stage, and how far a device may stray from the reference on it.

    inputs: keyword arguments of the stage's function (NumPy arrays, numbers).
    tolerance: bound on the error; why: its derivation.
    metric: "peak": max |device - reference| / max |reference|;
            "local": max over pixels of |device - reference| / max(|reference|, floor), floor below;
            "exact": the largest absolute difference (tolerance 0 means bit for bit).
    """

    name: str
    inputs: dict = field(repr=False)
    tolerance: float
    why: str
    metric: str = "peak"
    floor: float = 0.0

    def error(self, result, reference) -> float:
        """The largest error of `result` against `reference` in this case's metric; infinite if one is NaN alone."""
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


def stage(function: Callable) -> Callable:
    """Make `function(device, ...)` in `kernels/area/name.py` the public function of stage `area.name`.

    The public form is called as `name(..., device="auto")`, and its signature says so. On the NumPy device it is the
    reference. Otherwise arrays may be NumPy arrays or arrays of that device; the result is NumPy when every array given
    was. Other arguments than the signature's raise TypeError, which names the stage.
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
        except TypeError:  # checked only then: binding takes as long as a small kernel's launch
            _require_arguments(name, signature, args, kwargs)
            raise
        on_device = any(isinstance(value, device.array_type) for value in (*args, *kwargs.values()))
        return result if on_device else device.numpy(result).copy()

    vars(public)["__signature__"] = signature
    return public


def _public_signature(function):
    """The signature of `function` with its first parameter, the device, as the last one by keyword."""
    inner = inspect.signature(function)
    parameters = [
        *list(inner.parameters.values())[1:],
        inspect.Parameter(
            "device", inspect.Parameter.KEYWORD_ONLY, default="auto", annotation=Device | str
        ),
    ]
    return inner.replace(
        parameters=sorted(parameters, key=lambda parameter: parameter.kind)
    )  # **kwargs stay last


def _require_arguments(name, signature, args, kwargs):
    """Refuse arguments that do not fit the stage's signature. Raises TypeError."""
    try:
        signature.bind(*args, **kwargs)
    except TypeError as wrong:
        raise TypeError(f"{name}: {wrong}; wanted {name.rpartition('.')[2]}{signature}") from None


def _reference_of(module, name):
    return lambda: getattr(import_module(f"{module}_ref"), name)


def stage_names() -> list[str]:
    """Every stage as `area.name`, in the order the light goes."""
    return [
        f"{area}.{path.name.removesuffix('_ref.py')}"
        for area in AREAS
        for path in sorted((ROOT / area).glob("*_ref.py"))
    ]


def stage_module(name: str):
    """The contract module of stage `area.name`."""
    return import_module(f"gpusim.kernels.{name}")


def public_function(name: str) -> Callable:
    """The public function of stage `area.name`."""
    return getattr(stage_module(name), name.rpartition(".")[2])


def compare(name: str, device: Device) -> Iterator[tuple[Case, float]]:
    """Run every case of a stage on `device` and yield (case, error against the float64 reference)."""
    module = stage_module(name)
    leaf = name.rpartition(".")[2]
    reference = getattr(import_module(f"{module.__name__}_ref"), leaf)
    for case in module.cases():
        yield (
            case,
            case.error(
                getattr(module, leaf)(**case.inputs, device=device), reference(**case.inputs)
            ),
        )
