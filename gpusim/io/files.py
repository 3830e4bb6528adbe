"""The one way into a user's file: it is there, it is a file, it fits, and what a parser raises becomes a BadFile."""

import csv
import io
import os
import stat
from contextlib import contextmanager
from pathlib import Path

from gpusim.domain.errors import BadFile, DoesNotFit, GpusimError, shown
from gpusim.domain.memory import require_memory

LONGEST_TEXT = 2**20  # [byte] of what people write; TOML takes up to 3 s for as much
# [byte] that a parser takes per byte of text: one Python object for every two letters
TEXT_COST = 64
KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def open_file(path) -> io.BufferedReader:
    """Open a regular file for reading bytes. Raises BadFile for anything else, without waiting for it.

    A pipe without a writer, a terminal or a socket would let a program wait without end, and devices have no end.
    """
    if not isinstance(path, str | os.PathLike):
        raise BadFile(shown(path), f"{type(path).__name__}, wanted a file's path")
    path = Path(path)
    try:
        _require_regular(
            path, path.stat()
        )  # before it is opened: to open a device may do something
        # nor does it wait if it has become a pipe meanwhile
        file = open(
            path,
            "rb",
            opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0)),
        )
    except FileNotFoundError:
        raise BadFile(path, "no such file") from None
    except OSError as error:
        raise BadFile(path, f"cannot be read: {error.strerror or error}") from None
    except ValueError:  # a zero byte, or letters that no file's name can have
        raise BadFile(path, "no such file: no file can have this name") from None
    try:
        _require_regular(path, os.fstat(file.fileno()))
    except BadFile:
        file.close()
        raise
    return file


def _require_regular(path, status):
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for test, name in KINDS if test(status.st_mode)), "something else")
        raise BadFile(path, f"is {kind}; wanted a file")


def file_size(file) -> int:
    """Size of an open file [byte]."""
    return os.fstat(file.fileno()).st_size


def read_text(
    path, what: str, longest: int = LONGEST_TEXT, *, older: bool = False, cost: int = TEXT_COST
) -> str:
    """Read a text in UTF-8, with or without a byte-order mark.

    what: as in `reading`. longest: [byte]. older: read UTF-16 with its mark as well, and Windows' letters where it is
    not UTF-8. cost: [byte] that its parser takes per byte. Raises BadFile, DoesNotFit.
    """
    with open_file(path) as file, reading(path, what):
        require_memory(f"{path}: a text", cost * min(file_size(file), longest))
        data = file.read(longest + 1)  # files of the system are longer than they say
        if len(data) > longest:
            raise BadFile(
                path, f"more than {longest / 2**20:g} MiB: longer than it can sensibly be"
            )
        if older and data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16", "replace")
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError:
            if older:
                return data.decode("cp1252", "replace")
            raise


def read_cells(path, longest: int) -> list[list[str]]:
    """Read a CSV table: the cells of every line that is not empty, without blanks around them.

    Cells are divided by commas, semicolons (numbers may have decimal commas then) or tabs; lines that begin with # are
    comments. Empty columns at the end, of spreadsheets, are left out. longest: [byte]. Raises BadFile, DoesNotFit.
    """
    text = read_text(path, "a CSV table", longest, older=True)
    with reading(path, "a CSV table"):
        lines = [
            line
            for line in text.splitlines()
            if line.strip(" \t,;") and not line.lstrip().startswith("#")
        ]
        divider = next((one for one in ";\t" if one in "".join(lines[:1])), ",")
        cells = [
            [cell.strip() for cell in row]
            for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=divider)
        ]
    if divider == ";":
        cells = [[cell.replace(",", ".") for cell in row] for row in cells]
    width = max(map(len, cells), default=0)
    while width and not any(row[width - 1] for row in cells if len(row) >= width):
        width -= 1
    return [row[:width] for row in cells]


@contextmanager
def reading(path, what: str):
    """While a file's bytes are read and parsed by a library: whatever it raises on them is said as BadFile.

    what: what the file should be, such as "a PNG". Parsers raise anything on damaged files (KeyError, RecursionError,
    NotImplementedError ...), and their documents do not say what. Only calls of parsers belong in the block: an error
    of this program should be seen as such. GpusimErrors pass, and NameError, which no file can cause.
    """
    try:
        yield
    except (GpusimError, NameError):
        raise
    except MemoryError:
        raise BadFile(path, f"not {what} that this computer has the memory to read") from None
    except OSError as error:
        raise BadFile(
            path, f"cannot be read: not {what}, or truncated ({error.strerror or error})"
        ) from error
    except Exception as error:
        raise BadFile(
            path, f"not {what}, or truncated ({str(error) or type(error).__name__})"
        ) from error


@contextmanager
def named(path):
    """While the parts of a file become what they describe: the domain's errors are said with the file's name.

    DoesNotFit and BadFile, which have it, pass. Memory that ran out although it was asked for is a BadFile as well.
    """
    try:
        yield
    except (BadFile, DoesNotFit):
        raise
    except GpusimError as error:
        raise BadFile(path, str(error)) from error
    except MemoryError as error:
        raise BadFile(path, "this computer has not the memory to use it") from error
