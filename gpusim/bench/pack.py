"""Writes kernels with inputs and right answers for a runner in C: `gpusim bench pack`.

A pack is a folder that needs no Python: `index.txt` (lines of words), `data.bin` (inputs and
answers), `programs/` (OpenCL C without include files), and the runner's source. The runner's
README.md describes the format.

The launches are recorded by a device that starts nothing (`gpusim.bench.recorder`), so a pack
depends on no driver. The answers are those of each stage's float64 reference. A stage is recorded
in each of FORMS; the runner takes the one for its device.
"""

import datetime
import gzip
import hashlib
import shutil
import tarfile
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from importlib import import_module
from importlib.resources import files
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.backends.launches import BUILD_OPTIONS
from gpusim.backends.probe import COPY_BYTES
from gpusim.bench import limits
from gpusim.bench.recorder import UNITS, CopyOf, NotRecordable, Program, Recorded, Recorder
from gpusim.bench.stages import Stage
from gpusim.bench.subject import digest_values, write_size
from gpusim.domain.errors import BadFile, Conflict
from gpusim.domain.leftovers import remove_leftovers, temporary_name
from gpusim.domain.progress import announced
from gpusim.io.atomic import atomic_path
from gpusim.kernels.stage import Case, public_function, stage_module, stage_names

HEAD = "gpusim-pack 1"
SIZE = 96, 72  # of the timed input
# pixels of a timed input; the float64 reference of more takes minutes, and is left out
MOST_JUDGED = 480 * 270
# Form -> arguments of `Recorder`. "small": for GPUs whose groups or local memory are smaller than
# those of "gpu"; it is left out where it is the same
FORMS = {
    "cpu": (False, 256, 48 << 10),
    "gpu": (True, 1024, 48 << 10),
    "small": (True, 256, 32 << 10),
}
TYPES = "u1", "u2", "i4", "u4", "f4", "f8"  # of answers, the first that holds all values
ARCHIVES = ".tar.gz", ".zip"
RUNNER = "runner.c", "pocl.c", "CMakeLists.txt", "README.md", "LICENSE"


def write_pack(
    folder: str | Path,
    stages: Iterable[str] | None = None,
    size: tuple[int, int] = SIZE,
    archive: str | Path | None = None,
    cores: int = UNITS,
) -> dict[str, Any]:
    """Write a pack.

    Args:
        folder: Its folder, which must not exist.
        stages: Names of stages; None for all.
        size: Columns and rows of the timed input of each stage.
        archive: Also an archive of the folder, .tar.gz or .zip.
        cores: Compute units of the processor that times are compared on. Some stages cut a frame
            into as many strips.

    Returns:
        stages, cases, programs (their numbers), bytes (size of the folder), and left: pairs of a
        stage's form and why some of its cases are not in the pack.

    Raises:
        BadFile: The folder exists, or cannot be written.
        Conflict: The archive has another suffix.
    """
    folder = Path(folder)
    if archive is not None and not str(archive).endswith(ARCHIVES):
        raise Conflict("--archive", f"{archive}: unknown form", f"wanted {' or '.join(ARCHIVES)}")
    if folder.exists():
        raise BadFile(folder, "exists; a pack needs a new folder")
    remove_leftovers(folder.absolute().parent)
    temporary = folder.with_name(temporary_name())
    try:
        (temporary / "programs").mkdir(parents=True)
        with open(temporary / "data.bin", "wb") as data:
            pack = _Pack(temporary, data, cores)
            for name in stages or stage_names():
                with announced(f"packing {name}"):
                    pack.add_stage(name, size)
            pack.add_limits()
        pack.write_index()
        for name in RUNNER:
            (temporary / name).write_bytes(files(__package__).joinpath("runner", name).read_bytes())
        if archive is not None:
            with atomic_path(archive) as path:
                _archive(temporary, path, folder.name)
        temporary.rename(folder)
    except OSError as error:
        raise BadFile(folder, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    nbytes = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {**pack.counts, "bytes": nbytes, "left": pack.left}


class _Pack:
    """A pack that is being written to a folder."""

    def __init__(self, folder, data, cores):
        self.folder, self.data, self.end = folder, data, 0
        self.places: dict[bytes, int] = {}  # checksum of data -> its place
        self.programs: dict[Program, int] = {}
        self.lines: list[str] = []
        self.left: list[tuple[str, str]] = []
        self.counts = {"stages": 0, "cases": 0, "programs": 0}
        self.recorders = {form: Recorder(*limits, cores) for form, limits in FORMS.items()}

    def add_stage(self, name, size):
        """Add all cases of a stage, and its timed input."""
        module = stage_module(name)
        reference = _reference(name)
        self.counts["stages"] += 1
        self.lines.append(f"stage {name}")
        missed: dict[tuple[str, str], int] = {}
        cases = list(module.cases())
        for number, case in enumerate(cases):
            answer = reference(**case.inputs)
            self._add_forms(missed, name, number, case, answer, [])
        inputs = module.bench(*size[::-1])
        is_exact = all(case.metric == "exact" and case.tolerance == 0 for case in cases)
        why = "every case of the stage is exact" if is_exact else "measured, not judged"
        timed = Case("timed input", inputs, 0.0, why, "exact" if is_exact else "rms")
        answer = reference(**inputs) if prod(size) <= MOST_JUDGED else None
        counted = getattr(module, "operations", None)
        moved = sum(value.nbytes for value in inputs.values() if isinstance(value, np.ndarray))
        facts = {
            "size": write_size(size),
            "bytes": moved,
            "operations": -1 if counted is None else int(counted(**inputs)),
            "hash": digest_values(Stage(name).digest(), write_size(size)),
        }
        self._add_forms(missed, name, len(cases), timed, answer, facts)
        for (form, why), count in missed.items():
            self.left.append((f"{name} {form}", why))
            self.lines.append(f"left {form} {count} {why}")

    def _add_forms(self, missed, name, number, case, answer, facts):
        """Add a case in each form that can be recorded. facts: of the timed input, else empty."""
        seen = []
        for form, device in self.recorders.items():
            device.begin()
            try:
                with device.charged(name):
                    result = public_function(name).__wrapped__(device, **case.inputs)
            except NotRecordable as reason:
                missed[form, str(reason)] = missed.get((form, str(reason)), 0) + 1
                continue
            body = self._body(device.steps, result)
            if body not in seen:  # the small form is often that of all GPUs
                seen.append(body)
                self._add_case(form, number, case, answer, facts, device, result, body)

    def _add_case(self, form, number, case, answer, facts, device, result, body):
        self.counts["cases"] += 1
        self.lines.append(f"case {form} {number} {case.name}")
        if facts:
            facts = facts | {"bytes": facts["bytes"] + result.nbytes}
            self.lines.append("timed " + " ".join(map(str, facts.values())))
        self.lines.append(f"why {case.why}")
        if device.asked_fp64:
            self.lines.append("fp64")
        self.lines += body
        self.lines.append(self._judge(case, answer, result))
        self.lines.append("end")

    def _judge(self, case, answer, result):
        """Return the line that says how the result is judged."""
        if answer is None:
            return "unjudged"
        answer = np.asarray(answer)
        if answer.shape != result.shape:
            raise ValueError(f"{case.name}: shape {result.shape}, the reference's {answer.shape}")
        kind = next(kind for kind in TYPES if _holds(answer, kind))
        numbers = " ".join(float(value).hex() for value in (case.tolerance, case.floor))
        with np.errstate(invalid="ignore"):  # a signalling NaN
            place = self._store(answer.astype(kind))
        return f"judge {result.dtype.str[1:]} {result.size} {kind} {place} {case.metric} {numbers}"

    def _body(self, steps, result):
        """Return the lines of buffers, launches and copies; the result's buffer is the first.

        Without a result, buffers have no contents.
        """
        buffers: dict[Any, int] = {}
        lines = []

        def number_of(array):
            memory = array.memory
            if memory not in buffers:
                is_empty = result is None or memory.values is None
                place = -1 if is_empty else self._store(memory.values)
                buffers[memory] = len(buffers)
                lines.append(f"buffer {max(memory.nbytes, 1)} {place}")
            return buffers[memory]

        if result is not None:
            number_of(result)
        for step in steps:
            if isinstance(step, CopyOf):
                source, target = number_of(step.source), number_of(step.target)
                lines.append(f"copy {source} {step.start} {target} {step.to} {step.nbytes}")
                continue
            args = [
                f"b{number_of(arg)}" if isinstance(arg, Recorded) else _write_number(arg)
                for arg in step.args
            ]
            program = self._number_of_program(step.program)
            for size, group, offset in step.pieces:
                words = [len(size), *size[::-1], *group[::-1], *offset[::-1], len(args), *args]
                lines.append(f"run {program} {step.kernel} {' '.join(map(str, words))}")
        return lines

    def _number_of_program(self, program):
        """Return the number of a program, and write its text if it is new."""
        if program not in self.programs:
            self.programs[program] = len(self.programs)
            self.counts["programs"] += 1
            path = self.folder / _file_of(program, self.programs[program])
            path.write_text(program.text, newline="\n")
        return self.programs[program]

    def _store(self, values):
        """Return the place of an array's bytes in the data, where each is stored once."""
        content = np.ascontiguousarray(values).tobytes()
        key = hashlib.sha256(content).digest()
        if key not in self.places:
            self.places[key] = self.end
            padded = content + bytes(-len(content) % 16)
            self.data.write(padded)
            self.end += len(padded)
        return self.places[key]

    def add_limits(self):
        """Add the kernels of `gpusim.bench.limits`, which the runner measures a device with."""
        for form in ("cpu", "gpu"):
            is_gpu = form == "gpu"
            items, steps = (2**18, limits.GPU_STEPS) if is_gpu else (64, limits.CPU_STEPS)
            sums = (
                limits.GPU_ITEMS * limits.GPU_READS
                if is_gpu
                else limits.CPU_ITEMS * limits.CPU_READS
            )
            self._add_limit(form, limits.copy_gbps, 2 * COPY_BYTES)
            self._add_limit(form, limits.launch_us, 1)
            for width in (1,) if is_gpu else (8, 16):
                self._add_limit(form, limits.fma_gflops, 2 * limits.CHAINS * items * steps, width)
                self._add_limit(form, limits.local_gbps, 4 * limits.SUMS * sums, width)

    def _add_limit(self, form, measure, amount, width=1):
        """Add the last launch of a function that measures.

        amount: bytes or operations of a launch by vectors of one number.
        """
        device = self.recorders[form]
        device.begin(width)
        with suppress(NotRecordable):
            measure(device)
        self.lines.append(f"limit {form} {measure.__name__} {amount * width} {width}")
        self.lines += [*self._body(device.steps[-1:], None), "end"]

    def write_index(self):
        """Write the index, the last file: a pack without it is not complete."""
        programs = [
            f"program {_file_of(program, number)} {program.registers}"
            for program, number in self.programs.items()
        ]
        digest = hashlib.sha256()
        for line in (*programs, *self.lines):
            digest.update(f"{line}\n".encode())
        for program in self.programs:
            digest.update(program.text.encode())
        for key in self.places:
            digest.update(key)
        head = [
            HEAD,
            f"date {datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds')}",
            f"hash {digest.hexdigest()}",
            f"options {' '.join(BUILD_OPTIONS)}",
        ]
        text = "".join(f"{line}\n" for line in (*head, *programs, *self.lines))
        (self.folder / "index.txt").write_text(text, newline="\n")


def _reference(name):
    """Return the float64 reference of a stage."""
    return getattr(import_module(f"gpusim.kernels.{name}_ref"), name.rpartition(".")[2])


def _file_of(program, number):
    return f"programs/{program.stage}-{number}.cl"


def _write_number(value):
    """Return a scalar argument as the runner reads it: an int32, or the exact bits of a float32."""
    if isinstance(value, int | np.integer):
        return f"i{int(np.int32(value))}"
    return f"f{float(np.float32(value)).hex()}"


def _holds(values, kind):
    """Return whether a type holds all values exactly."""
    with np.errstate(all="ignore"):
        return np.array_equal(values.astype(kind).astype(np.float64), values, equal_nan=True)


def _archive(folder, path, name):
    """Write an archive of a folder, named `name` in it, without times and owners."""
    found = sorted(each for each in folder.rglob("*") if each.is_file())
    if str(path).endswith(".zip"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for each in found:
                entry = zipfile.ZipInfo(f"{name}/{each.relative_to(folder).as_posix()}")
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, each.read_bytes())
        return
    with (
        gzip.GzipFile(path, "wb", mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        for each in found:
            entry = archive.gettarinfo(each, f"{name}/{each.relative_to(folder).as_posix()}")
            entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = 0, 0, 0, "", ""
            with open(each, "rb") as file:
                archive.addfile(entry, file)
