"""Folders in which drivers keep compiled kernels: what is corrupt goes; one is lent where none can be written.

Drivers trust what they find there: PoCL aborts at a file that was cut off, Warp raises.
"""

import atexit
import os
import shutil
import struct
import tempfile
from pathlib import Path

ELF_TABLE = slice(40, 48), slice(58, 62)  # of the header: where the section table begins; its entries' size and count


def lent_folder() -> Path:
    """An empty folder that goes with the process."""
    folder = tempfile.mkdtemp(prefix="gpusim-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def is_writable(folder: Path) -> bool:
    """Whether files can be made in the folder; it is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def prepare_opencl():
    """Make caches usable, before pyopencl and PoCL are loaded: PoCL's programs with a damaged file are built anew."""
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # nobody's home: the system's folder for temporary files serves
        return
    if not is_writable(home / "pytools"):
        os.environ["PYOPENCL_NO_CACHE"] = "1"
    folder = Path(os.environ.get("POCL_CACHE_DIR") or home / "pocl" / "kcache")
    if not is_writable(folder):
        os.environ["POCL_CACHE_DIR"] = str(lent_folder())
        return
    for program in folder.glob("*/*/program.bc"):
        if not (_is_whole_bitcode(program) and all(map(_is_whole_elf, program.parent.glob("*/*/*.so")))):
            shutil.rmtree(program.parent, ignore_errors=True)


def _is_whole_bitcode(path):
    """Whether the blocks of LLVM's bitcode fill the file: each says its length in words of 4 bytes after its header."""
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(4) != b"BC\xc0\xde":
                return False
            while (place := file.tell()) < size:
                kind, length = struct.unpack("<II", file.read(8))
                if kind & 3 != 1 or place + 8 + 4 * length > size:  # 1: a block begins
                    return False
                file.seek(4 * length, os.SEEK_CUR)
    except (OSError, struct.error):
        return False
    return True


def _is_whole_elf(path):
    """Whether a shared library reaches to the end of its section table, which linkers put last."""
    try:
        with open(path, "rb") as file:
            header = file.read(64)
            (begin,), (entry, count) = (struct.unpack(form, header[part])
                                        for form, part in zip(("<Q", "<HH"), ELF_TABLE, strict=True))
            return header[:4] == b"\x7fELF" and begin + entry * count <= os.fstat(file.fileno()).st_size
    except (OSError, struct.error):
        return False
