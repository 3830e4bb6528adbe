"""Loads PoCL's compiled programs from their places in its cache.

PoCL finds a program in its cache by the preprocessed text: 22 ms of its compiler's front end for
each program. A binary names the place, and takes 2 ms. PoCL itself makes binaries only with code for
work-groups of any size, which takes as long to compile as the program. So a record is written for
each program: the head of such a binary, and its description of the kernels. The binary is composed
of the record and the bitcode in PoCL's cache.

Format: pocl_binary.c of PoCL 3.0, version 8. Other versions of PoCL build from text.
"""

import hashlib
import os
import struct
import uuid
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from gpusim.backends import caches
from gpusim.domain.leftovers import temporary_name

HEAD = 73  # [byte]: magic, device, version, number of kernels, flags, place in the cache
MAGIC, VERSION = b"poclbin\0", 8
EXECUTABLE = 4 << 1  # flags of a program that is linked
BITCODE = "/program.bc"
ALL_KNOWN = 31  # of the arguments: qualifiers, type, name
POINTER = 8  # [byte]
# [byte]; other types are not recorded
SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4}
# PoCL's own variables that change what it compiles
VARIABLES = ("POCL_WORK_GROUP_METHOD", "POCL_EXTRA_BUILD_FLAGS", "PYOPENCL_BUILD_OPTIONS")


class Programs:
    """Builds OpenCL programs for one device; PoCL 3.0 loads those that were built before.

    Args:
        cl: pyopencl.
        context: Its context of one device.
    """

    def __init__(self, cl, context):
        self._cl, self._context = cl, context
        (self._device,) = context.devices
        platform = self._device.platform
        is_pocl = platform.name == "Portable Computing Language"
        self._folder = caches.pocl_folder() if is_pocl else None
        self._is_recorded = " PoCL 3.0" in platform.version
        self._facts = (platform.version, self._device.version, self._device.name)

    def build(self, text: str, options: list[str]) -> tuple[Any, bool]:
        """Return the program of a text, and whether its kernels are new: PoCL compiles them as they start.

        Args:
            text: OpenCL C.
            options: Of the compiler.

        Raises:
            pyopencl.Error: The text has an error.
        """
        if self._folder is None:
            return self._cl.Program(self._context, text).build(options), False
        path = self._record_path(text, options)
        record = _read(path) if self._is_recorded else b""
        place = self._folder / _place(record) if record else None
        if place is not None and not (place.is_dir() and caches.is_sound(place)):
            place = None
        is_new = place is None
        if place is not None and len(record) > HEAD:
            with suppress(OSError, self._cl.Error):  # then it is built from its text
                bitcode = (place / BITCODE[1:]).read_bytes()
                binary = record[:HEAD] + _string(BITCODE) + _string(bitcode) + record[HEAD:]
                program = self._cl.Program(self._context, [self._device], [binary]).build()
                caches.use(place)
                return program, False
        if is_new and not caches.prepare_build(self._folder):
            text += f"\ntypedef int apart_{uuid.uuid4().hex};\n"  # its place is in no use
        program = self._cl.Program(self._context, text).build(options)
        if is_new:
            place = self._write_record(path, text, options)
        caches.use(self._folder if place is None else place)
        return program, is_new

    def _write_record(self, path, text, options):
        """Record a program that was just built from its text; return its place, None if unknown."""
        if not self._is_recorded:
            return None
        with suppress(Exception):  # whatever fails, the program itself is built
            # It takes the bitcode from the cache, and has no kernels, which PoCL would compile
            unlinked = self._cl.Program(self._cl._cl._Program(self._context, text))
            (binary,) = unlinked.compile(options).get_info(self._cl.program_info.BINARIES)
            magic, _, version, kernels = struct.unpack_from("<8sQII", binary)
            start = HEAD + len(_string(BITCODE))
            is_known = (magic, version, kernels) == (MAGIC, VERSION, 0)
            if not is_known or binary[HEAD:start] != _string(BITCODE):
                return None
            # PoCL describes arguments only to programs that were built with this option
            described = self._cl.Program(self._context, [self._device], [binary[start + 4 :]])
            described.build(["-cl-kernel-arg-info"])
            names = described.get_info(self._cl.program_info.KERNEL_NAMES).split(";")
            parts = [self._describe(self._cl.Kernel(described, name)) for name in names]
            head = binary[:20] + struct.pack("<IQ", len(names), EXECUTABLE) + binary[32:HEAD]
            record = head + (b"" if None in parts else b"".join(parts))
            if path.is_dir() or not path.parent.is_dir():
                caches.remove(path.parent)
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = path.with_name(temporary_name())
            temporary.write_bytes(hashlib.sha256(record).digest() + record)
            temporary.replace(path)
            return self._folder / _place(record)
        return None

    def _record_path(self, text, options):
        """Return the file of a program's record. Include files count by their text."""
        facts = [*self._facts, text, *map(os.environ.get, VARIABLES)]
        facts += [_included(option) if os.path.isdir(option) else option for option in options]
        return (
            self._folder
            / "gpusim"
            / hashlib.sha256(repr(facts).encode()).hexdigest()[:40]
            / "record"
        )

    def _describe(self, kernel):
        """Return a kernel's description in PoCL's binaries, without code; None if it is not known."""
        of, group = self._cl.kernel_arg_info, self._cl.kernel_work_group_info
        if kernel.get_work_group_info(group.LOCAL_MEM_SIZE, self._device):
            return None  # the sizes of its arrays are not known
        arguments = b""
        for number in range(kernel.num_args):
            access, address, qualifier, name, kind = (
                kernel.get_arg_info(number, part)
                for part in (
                    *(of.ACCESS_QUALIFIER, of.ADDRESS_QUALIFIER, of.TYPE_QUALIFIER),
                    *(of.NAME, of.TYPE_NAME),
                )
            )
            is_pointer = kind.endswith("*")
            if not is_pointer and kind not in SIZES:
                return None
            size = POINTER if is_pointer else SIZES[kind]
            arguments += struct.pack("<IIQII", access, address, qualifier, is_pointer, size)
            arguments += _string(name) + _string(kind)
        sizes = kernel.get_work_group_info(group.COMPILE_WORK_GROUP_SIZE, self._device)
        described = (
            _string(kernel.function_name)
            + struct.pack("<II3Q", kernel.num_args, 0, *sizes)
            + _string(kernel.attributes)
            + struct.pack("<Q", ALL_KNOWN)
            + arguments
        )
        return struct.pack("<QQI", 20 + len(described), 0, len(arguments)) + described


def _string(text):
    """Return a text or bytes behind their length."""
    content = text.encode() if isinstance(text, str) else text
    return struct.pack("<I", len(content)) + content


def _read(path):
    """Return a record; nothing if there is none, or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return b""
    checksum, record = content[:32], content[32:]
    return record if hashlib.sha256(record).digest() == checksum else b""


def _place(record):
    """Return the place of a program in PoCL's cache."""
    return record[32:HEAD].rstrip(b"\0").decode("ascii")


@cache
def _included(folder):
    """Return a checksum of the files of a folder that programs include."""
    found = hashlib.sha256()
    for path in sorted(Path(folder).glob("*.clh")):
        found.update(path.read_bytes())
    return found.hexdigest()
