"""PoCL 3.0, which pip installs, on processors that its compiler does not know.

Its LLVM 14 calls them "generic", and its C compiler then refuses that very name, so that nothing can be built (PoCL's
issue 1049). Neither a build option nor the environment can set another, so it is put in the place where PoCL keeps it.
"""

import ctypes
import os
import re
import struct
from pathlib import Path

UNKNOWN = b"generic"
SEARCHED = 2048  # bytes of PoCL's device structure: the name's address was seen at 640
# Processors to build for and the features that their code uses, best first. The widths of vectors are those of the
# built-in functions that PoCL chooses by features, so that both pass them alike.
HASWELL = {"avx2", "bmi1", "bmi2", "abm", "cx16", "f16c", "fma", "movbe", "popcnt"}
PROCESSORS = {"skylake-avx512": HASWELL | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
              "haswell": HASWELL, "sandybridge": {"avx", "cx16", "popcnt", "sse4_2"}, "x86-64": {"sse2"}}


def known_processor(cl_device) -> str:
    """Name that PoCL builds for from now on, where it does not know the processor's own; "" where nothing is changed.

    cl_device: of pyopencl, before its first build.
    """
    if not (cl_device.version.endswith("-x86_64-unknown-linux-gnu-generic")
            and " PoCL 3.0" in cl_device.platform.version):
        return ""
    flags = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    features = set(flags[1].split()) if flags else set()
    name = next((name for name, needed in PROCESSORS.items() if needed <= features), "")
    return name if name and _renamed(cl_device.int_ptr, name.encode()) else ""


def _renamed(structure, name):
    """Whether PoCL's device at this address has `name` for its processor now, in place of the unknown one."""
    try:
        memory = os.open("/proc/self/mem", os.O_RDWR)  # what is not mapped is an error there and not a crash
    except OSError:
        return False
    try:
        found = [(place, text) for place in range(structure, structure + SEARCHED, 8)
                 if (text := _text(memory, _read(memory, place, 8))) in (UNKNOWN, name)]
        if len(found) != 1:
            return False
        place, text = found[0]
        if text == UNKNOWN:
            copy = ctypes.CDLL(None).strdup  # PoCL may free it, as it would its own
            copy.restype = ctypes.c_void_p
            os.pwrite(memory, struct.pack("P", copy(name)), place)
        return True
    finally:
        os.close(memory)


def _text(memory, address):
    """The text at an address, as far as it may be a processor's name."""
    return b"" if len(address) < 8 else _read(memory, *struct.unpack("P", address), 32).partition(b"\0")[0]


def _read(memory, address, count):
    """Bytes at an address, none where nothing is."""
    try:
        return os.pread(memory, count, address)
    except (OSError, OverflowError):
        return b""
