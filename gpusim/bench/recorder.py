"""A device that starts nothing: it records what a stage would launch on an OpenCL device."""

import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from math import prod
from types import SimpleNamespace
from typing import Any

import numpy as np

from gpusim.backends.launches import Piece, program_head, split_grid, stage_source
from gpusim.backends.tape import Taped

UNITS = 8  # by default


class NotRecordable(Exception):
    """The stage needs values that only the kernels could give. The text says which part of it."""


@dataclass(frozen=True)
class Program:
    """A program as OpenCL compiles it.

    Attributes:
        stage: File of kernels, as `area.name`.
        text: OpenCL C without include files.
        registers: Most registers of a work-item, for compilers that take it; 0 for any.
    """

    stage: str
    text: str
    registers: int


@dataclass(frozen=True)
class Launch:
    """A kernel over a grid.

    Attributes:
        program: The program.
        kernel: Name of the kernel in it.
        pieces: Size, group and offset of each start, the slowest axis first.
        args: Arrays, ints and floats, in the kernel's order.
    """

    program: Program
    kernel: str
    pieces: list[Piece]
    args: tuple


@dataclass(frozen=True)
class CopyOf:
    """A copy between two arrays: `nbytes` from byte `start` of `source` to byte `to` of `target`."""

    target: "Recorded"
    source: "Recorded"
    start: int
    to: int
    nbytes: int


class Memory:
    """Memory of a device.

    Attributes:
        nbytes: Its size.
        values: NumPy array of its contents at the start; None if it has none.
        is_written: Whether a kernel or a copy may have written to it.
    """

    def __init__(self, nbytes: int, values: np.ndarray | None = None):
        self.nbytes, self.values, self.is_written = nbytes, values, False


class Recorded:
    """An array of a `Recorder`: its memory, shape and type."""

    def __init__(self, device, memory, shape, dtype):
        self.device, self.memory = device, memory
        self.shape, self.dtype = tuple(map(int, shape)), np.dtype(dtype)
        self.nbytes = prod(self.shape) * self.dtype.itemsize

    @property
    def size(self) -> int:
        """Number of values."""
        return prod(self.shape)

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    def __len__(self):
        return self.shape[0]

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.device.numpy(self), dtype)


class Recorder(Taped):
    """An OpenCL device that records. Values that a kernel may have written cannot be read.

    Args:
        is_gpu: Whether stages take their form for GPUs.
        group_limit: Most work-items of a group.
        local_bytes: Local memory of a group [byte].
        units: Compute units, for stages that cut a frame into as many strips.

    Attributes:
        steps: Launches and copies since `begin`, in order.
        asked_fp64: Whether a stage has asked for float64 since `begin`.
    """

    kind = "opencl"
    array_type = Recorded

    def __init__(self, is_gpu: bool, group_limit: int, local_bytes: int, units: int = UNITS):
        super().__init__()
        self.name = "recorder"
        self.is_gpu, self.on_host = is_gpu, not is_gpu
        self.group_limit, self.local_bytes, self._units = group_limit, local_bytes, units
        self._programs: dict = {}
        self.begin()

    def begin(self, width: int = 8) -> None:
        """Forget what was recorded.

        Args:
            width: Floats in a vector of the processor.
        """
        self.cl_device = SimpleNamespace(
            max_compute_units=self._units, native_vector_width_float=width, driver_version=""
        )
        self.steps: list[Launch | CopyOf] = []
        self.asked_fp64 = False

    @property
    def has_fp64(self):  # noqa: D102  the protocol's
        self.asked_fp64 = True
        return True

    @contextmanager
    def host_work(self) -> Iterator[None]:  # noqa: D102  the protocol's
        raise NotRecordable("it works on the host between kernels, with SciPy")
        yield

    @contextmanager
    def timed(self) -> Iterator[dict[str, float]]:  # noqa: D102  the protocol's
        # nothing runs, and no function divides by zero
        yield defaultdict(lambda: 1.0, {"": 1.0})

    def _array(self, values, dtype):
        values = np.array(values, dtype, order="C")
        return Recorded(self, Memory(values.nbytes, values), values.shape, dtype)

    def _fitting(self, array, dtype):
        return array if array.dtype == dtype else self._array(self._numpy(array), dtype)

    def _empty(self, shape, dtype):
        return Recorded(self, Memory(prod(shape) * np.dtype(dtype).itemsize), shape, dtype)

    def _reshape(self, array, shape):
        return Recorded(self, array.memory, shape, array.dtype)

    def _numpy(self, array):
        memory = array.memory
        if memory.values is None or memory.is_written:
            raise NotRecordable("the host reads what kernels computed")
        return memory.values.reshape(array.shape)

    def _dtype(self, array):
        return array.dtype

    def _copy(self, stage, target, source, count, start, to):
        size = source.dtype.itemsize
        target.memory.is_written = True
        self.steps.append(CopyOf(target, source, start * size, to * size, count * size))

    def _launch(self, stage, kernel, grid, args, defines, group):
        program = self._program(stage, defines)
        read_only = _find_read_only(program, kernel)
        if len(read_only) != len(args):
            read_only = [False] * len(args)
        for arg, is_read_only in zip(args, read_only, strict=True):
            if isinstance(arg, Recorded) and not is_read_only:
                arg.memory.is_written = True
        pieces = split_grid(tuple(map(int, grid)), group, self.is_gpu)
        self.steps.append(Launch(program, kernel, pieces, args))

    def _program(self, stage, defines):
        key = (stage, *sorted(defines.items()))
        if key not in self._programs:
            text = program_head(defines, self.is_gpu) + _with_includes(*stage_source(stage))
            self._programs[key] = Program(stage, text, int(defines.get("REGISTERS", 0)))
        return self._programs[key]


@cache
def _find_read_only(program, kernel):
    """Return for each parameter of a kernel whether it is declared const or __constant.

    The list is shorter if macros make the kernel or its parameters.
    """
    text = re.sub(r"//[^\n]*", "", program.text)
    found = re.search(rf"__kernel void {kernel}\(([^)]*)\)", text)
    if found is None:
        return []
    return [{"const", "__constant"} & {*part.split()} != set() for part in found[1].split(",")]


def _with_includes(text: str, folder: Any) -> str:
    """Return a program's text with its include files in it, each as often as it is included."""
    lines = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["#include"]:
            lines.append(f"// begin of {words[1]}")
            lines.append(_with_includes((folder / words[1].strip('"')).read_text(), folder))
            lines.append(f"// end of {words[1]}\n")
        else:
            lines.append(line + "\n")
    return "".join(lines)
