"""Input files: opened with checks of their kind and size; errors of parsers become BadFile."""

import csv
import io
import logging
import os
import stat
from contextlib import contextmanager
from pathlib import Path

from gpusim.domain.errors import BadFile, DoesNotFit, GpusimError, format_value
from gpusim.domain.memory import require_memory

LONGEST_TEXT = 2**20  # [byte] of files written by hand; TOML takes up to 3 s for this
# [byte] memory of a parser per byte of text: one Python object for every two letters
TEXT_COST = 64
KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def open_file(path) -> io.BufferedReader:
    """Open a regular file for reading bytes; raise BadFile for anything else.

    Pipes without a writer, terminals and sockets are refused because a read could wait forever,
    devices because they have no end.
    """
    if not isinstance(path, str | os.PathLike):
        raise BadFile(format_value(path), f"{type(path).__name__}, wanted a file's path")
    path = Path(path)
    try:
        _require_regular(path, path.stat())  # before opening: opening a device may have effects
        # non-blocking, in case it has become a pipe meanwhile
        file = open(path, "rb", opener=_open_at_once)
    except FileNotFoundError:
        raise BadFile(path, "no such file") from None
    except OSError as error:
        raise BadFile(path, f"cannot be read: {error.strerror or error}") from None
    except ValueError:  # a zero byte or other invalid characters
        raise BadFile(path, "no such file: no file can have this name") from None
    try:
        _require_regular(path, os.fstat(file.fileno()))
    except BadFile:
        file.close()
        raise
    return file


def _open_at_once(name, flags):
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def _require_regular(path, status):
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for test, name in KINDS if test(status.st_mode)), "something else")
        raise BadFile(path, f"is {kind}; wanted a file")


def file_size(file) -> int:
    """Return the size of an open file [byte]."""
    return os.fstat(file.fileno()).st_size


def read_text(
    path, what: str, longest: int = LONGEST_TEXT, *, older: bool = False, cost: int = TEXT_COST
) -> str:
    """Read a text in UTF-8, with or without a byte-order mark.

    what: as in `reading`. longest: [byte]. older: also accept UTF-16 with a byte-order mark, and
    Windows-1252 if it is not UTF-8. cost: memory of its parser per byte of text [byte]. Raises
    BadFile, DoesNotFit.
    """
    with open_file(path) as file, reading(path, what):
        require_memory(f"{path}: a text", cost * min(file_size(file), longest))
        data = file.read(longest + 1)  # system files are longer than their size
        if len(data) > longest:
            raise BadFile(path, f"more than {longest / 2**20:g} MiB: too long for {what}")
        if older and data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16", "replace")
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError:
            if older:
                return data.decode("cp1252", "replace")
            raise


def read_cells(path, longest: int) -> list[list[str]]:
    """Read a CSV table: the stripped cells of every line that is not empty.

    Cells are separated by commas, semicolons (numbers may then have decimal commas) or tabs; lines
    that begin with # are comments. Empty columns at the end are left out. longest: [byte]. Raises
    BadFile, DoesNotFit.
    """
    text = read_text(path, "a CSV table", longest, older=True)
    with reading(path, "a CSV table"):
        lines = [line for line in text.splitlines() if line.strip(" \t,;")]
        lines = [line for line in lines if not line.lstrip().startswith("#")]
        divider = next((one for one in ";\t" if one in "".join(lines[:1])), ",")
        rows = csv.reader(io.StringIO("\n".join(lines)), delimiter=divider)
        cells = [[cell.strip() for cell in row] for row in rows]
    if divider == ";":
        cells = [[cell.replace(",", ".") for cell in row] for row in cells]
    width = max(map(len, cells), default=0)
    while width and not any(row[width - 1] for row in cells if len(row) >= width):
        width -= 1
    return [row[:width] for row in cells]


@contextmanager
def reading(path, what: str):
    """Raise BadFile for any error of a library that reads and parses a file's bytes.

    what: expected kind of file, for example "a PNG". Parsers raise undocumented errors on damaged
    files (KeyError, RecursionError, NotImplementedError ...). Put only calls of parsers into the
    block, to keep errors of this program visible. GpusimErrors pass, and NameError, which no file
    can cause.
    """
    try:
        yield
    except (GpusimError, NameError):
        raise
    except MemoryError:
        why = f"not {what}, or this computer has too little memory to read it"
        raise BadFile(path, why) from None
    except OSError as error:
        why = f"cannot be read: not {what}, or truncated ({error.strerror or error})"
        raise BadFile(path, why) from error
    except Exception as error:
        why = f"not {what}, or truncated ({str(error) or type(error).__name__})"
        raise BadFile(path, why) from error


@contextmanager
def silence(logger: str):
    """Silence a library's logger, whose messages on a file are also raised as errors."""
    log = logging.getLogger(logger)
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


@contextmanager
def name_in_errors(path):
    """Raise the domain's errors as BadFile with the file's name.

    DoesNotFit and BadFile pass. Memory that runs out in spite of the check is a BadFile too.
    """
    try:
        yield
    except (BadFile, DoesNotFit):
        raise
    except GpusimError as error:
        raise BadFile(path, str(error)) from error
    except MemoryError as error:
        raise BadFile(path, "this computer has too little memory to use it") from error
