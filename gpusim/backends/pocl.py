"""PoCL 3.0, as installed by pip, on processors that its compiler does not know or confuses.

It links built-in functions, chosen by a processor's features, into kernels compiled for its name in
LLVM 14. If LLVM knows no name, "generic", PoCL's C compiler refuses that very name, and nothing can
be built (PoCL's issue 1049). If the name is older than the features, for example Zen 4 taken for
Zen 3, the two parts pass wide vectors in different ways: such kernels can be wrong, and are not
found in the cache. No build option or environment variable sets another name, so it is written to
PoCL's own memory.
"""

import ctypes
import os
import re
import struct
from pathlib import Path

SEARCHED = 2048  # bytes of PoCL's device structure: the name's address was seen at 640
# Processors to build for and the features that their code uses, best first. Vectors are as wide as
# in the built-in functions that PoCL chooses by features: both pass them in the same way.
HASWELL = {"avx2", "bmi1", "bmi2", "abm", "cx16", "f16c", "fma", "movbe", "popcnt"}
PROCESSORS = {
    "skylake-avx512": HASWELL | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
    "haswell": HASWELL,
    "sandybridge": {"avx", "cx16", "popcnt", "sse4_2"},
    "x86-64": {"sse2"},
}


# LLVM 14's names of processors with vectors of 64 and of 32 bytes
WITH_AVX512 = {
    "knl",
    "knm",
    "skylake-avx512",
    "cascadelake",
    "cooperlake",
    "cannonlake",
    "icelake-client",
    "icelake-server",
    "rocketlake",
    "tigerlake",
    "sapphirerapids",
}
WITH_AVX = {
    "sandybridge",
    "ivybridge",
    "haswell",
    "broadwell",
    "skylake",
    "alderlake",
    "btver2",
    "bdver1",
    "bdver2",
    "bdver3",
    "bdver4",
    "znver1",
    "znver2",
    "znver3",
}


def known_processor(cl_device) -> str:
    """Correct the processor for which PoCL builds, and return its name; "" if it is right.

    cl_device: pyopencl's device, before its first build.
    """
    found = re.search(r"-x86_64-unknown-linux-gnu-(\S+)$", cl_device.version)
    if not found or " PoCL 3.0" not in cl_device.platform.version:
        return ""
    flags = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    features = set(flags[1].split()) if flags else set()
    widest = "avx512f" if "avx512f" in features else "avx" if "avx" in features else ""
    known = "avx512f" if found[1] in WITH_AVX512 else "avx" if found[1] in WITH_AVX else ""
    if found[1] != "generic" and known == widest:
        return ""
    name = next((name for name, needed in PROCESSORS.items() if needed <= features), "")
    return (
        name
        if name and _rename_processor(cl_device.int_ptr, found[1].encode(), name.encode())
        else ""
    )


def _rename_processor(structure, wrong, name):
    """Write `name` over the wrong processor of PoCL's device at this address; return success."""
    try:
        memory = os.open("/proc/self/mem", os.O_RDWR)  # unmapped memory is an error, not a crash
    except OSError:
        return False
    try:
        # the first one: behind the structure lies other memory, perhaps with names of processors
        place, text = next(
            (
                (place, text)
                for place in range(structure, structure + SEARCHED, 8)
                if (text := _text(memory, _read(memory, place, 8))) in (wrong, name)
            ),
            (None, None),
        )
        if place is None:
            return False
        if text == wrong:
            copy = ctypes.CDLL(None).strdup  # PoCL may free it, as it would its own
            copy.restype = ctypes.c_void_p
            os.pwrite(memory, struct.pack("P", copy(name)), place)
        return True
    finally:
        os.close(memory)


def _text(memory, address):
    """Return the text at an address, up to the length of a processor's name."""
    return (
        b""
        if len(address) < 8
        else _read(memory, *struct.unpack("P", address), 32).partition(b"\0")[0]
    )


def _read(memory, address, count):
    """Return bytes at an address, none if it is not mapped."""
    try:
        return os.pread(memory, count, address)
    except (OSError, OverflowError):
        return b""
