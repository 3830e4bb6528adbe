"""Damaged files made from good ones: bytes of any file, and the structure of each format with its checksums right."""

import ast
import io
import re
import struct
import zipfile

import numpy as np

WORDS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    2**63 - 1,
    2**64 - 1,
)


def pick(random, items):
    """One of the items; `random.choice` would make arrays of them."""
    return items[int(random.integers(len(items)))]


def damaged(data: bytes, other: bytes, random) -> bytes:
    """Bytes flipped, set, cut, doubled, taken from another file, or the file cut short."""
    data = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        size = len(data) or 1
        start = int(random.integers(size))
        length = int(random.integers(1, 1 + min(size, int(2 ** random.uniform(0, 10)))))
        kind = int(random.integers(8))
        if kind <= 1:
            for at in random.integers(size, size=length if kind else 1):
                data[at : at + 1] = (
                    bytes([data[at] ^ (1 << int(random.integers(8)))]) if data else b""
                )
        elif kind == 2:
            data[start : start + length] = random.bytes(length)
        elif kind == 3:
            number, wide = pick(random, WORDS), pick(random, (1, 2, 4, 8))
            data[start : start + wide] = (number % 256**wide).to_bytes(
                wide, pick(random, ("little", "big"))
            )
        elif kind == 4:
            del data[start : start + length]
        elif kind == 5:
            data[start:start] = data[start : start + length] * int(random.integers(1, 20))
        elif kind == 6:
            begin = int(random.integers(len(other) or 1))
            data[start : start + length] = other[begin : begin + length]
        else:
            del data[pick(random, (start, max(size - int(random.integers(1, 65)), 0))) :]
    return bytes(data)


# ---- NumPy archives


SHAPES = (
    "()",
    "(0,)",
    "(1,)",
    "(3,)",
    "(-1,)",
    "(3, 4)",
    "(2, 3, 4)",
    "(1000000,)",
    "(100000000000,)",
    "(2**70,)",
    f"({2**62}, 4)",
    f"({2**63},)",
    f"({10**30},)",
    "(0, 99999999999999)",
    "(1.5,)",
    "('3',)",
    "None",
    "3",
    "(" + "1, " * 70 + ")",
    "(" * 300 + ")" * 300,
    "[3]",
    "(True,)",
    "(3L, 4L, 5L)",
    "(3,",
    "{}",
)
TYPES = (
    "'<f4'",
    "'<f8'",
    "'>f8'",
    "'<f2'",
    "'|u1'",
    "'<i8'",
    "'<u8'",
    "'|b1'",
    "'<c16'",
    "'|O'",
    "'<U1'",
    "'<U0'",
    "'|S5'",
    "'|V0'",
    "'<M8[s]'",
    "'<U999999999'",
    "'<f3'",
    "'zz'",
    "''",
    "[('a', '<f4')]",
    "[]",
    "None",
    "'<f16'",
    "('<f4', (2, 2))",
    "'<f4,<f4'",
    "'(1000000,1000000)f8'",
    "{'a': ('<f4', 0)}",
    "[('a', '|O')]",
    "1",
)


def archive(arrays: dict, random) -> bytes:
    """An .npz of which some arrays, headers, members or directory entries are wrong."""
    members = {}
    for name, array in arrays.items():
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=True)
        members[name + ".npy"] = buffer.getvalue()
    for _ in range(int(random.integers(1, 3))):
        name = pick(random, list(members))
        kind = int(random.integers(-3, 9))
        if kind <= 1:
            members[name] = revalued(arrays.get(name[:-4], np.zeros(3)), random)
        elif kind <= 4:
            members[name] = reheaded(members[name], random)
        elif kind == 5:
            members[name] = damaged(members[name], b"", random)
        elif kind == 6:
            members[
                pick(
                    random,
                    (
                        "x.npy",
                        "x" * 3000,
                        "../x.npy",
                        " ",
                        "detail_0.npy",
                        "offsets.npy",
                        "cube.npy",
                    ),
                )
            ] = members.pop(name)
        elif kind == 7:
            size = int(10 ** random.uniform(3, 7))  # zeros: a thousandth of it when compressed
            members[name] = members[name][:128] + bytes(size)
        else:
            members.pop(name)
            if not members:
                break
    data = _zipped(members, random)
    return _redirected(data, random) if random.random() < 0.2 else data


def _zipped(members, random):
    buffer = io.BytesIO()
    methods = (
        zipfile.ZIP_STORED,
        zipfile.ZIP_DEFLATED,
        zipfile.ZIP_DEFLATED,
        zipfile.ZIP_BZIP2,
        zipfile.ZIP_LZMA,
    )
    with zipfile.ZipFile(buffer, "w") as file:
        for name, data in members.items():
            method = pick(random, methods) if random.random() < 0.1 else pick(random, methods[:2])
            file.writestr(name, data, method, compresslevel=1)
    return buffer.getvalue()


def revalued(array, random):
    """The array with other values, another type or another shape."""
    kind = int(random.integers(5))
    array = np.array(array)
    if kind <= 1 and array.size and array.dtype.kind in "iuf":
        with np.errstate(all="ignore"):
            array.reshape(-1)[int(random.integers(array.size))] = np.array(
                pick(random, (0.0, -1.0, 1e9, 1e38, np.nan, np.inf, -np.inf, 255.0, 65536.0))
            ).astype(array.dtype)
    elif kind == 2:
        array = np.resize(array, tuple(random.integers(0, 6, int(random.integers(0, 5)))))
    elif kind == 3:
        with np.errstate(all="ignore"):
            wanted = pick(
                random, ("f2", "f8", "i1", "u1", "i8", "c8", "U5", "S3", "?", "M8[s]", "O", "f16")
            )
            try:
                array = array.astype(wanted)
            except (ValueError, TypeError):
                array = np.zeros(array.shape, wanted)
    else:
        array = np.array(
            pick(
                random,
                (
                    0,
                    1,
                    -1,
                    2**31,
                    2**63 - 1,
                    0.0,
                    np.nan,
                    np.inf,
                    1e300,
                    "",
                    "x" * 5000,
                    "scene",
                    "a\nb",
                    True,
                    [[]],
                    [1.0, 2.0],
                    3 + 4j,
                ),
            )
        )
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def reheaded(member, random):
    """An array whose header says something else; the numbers stay."""
    start = 10 if member[6:7] == b"\x01" else 12
    header = member[start:].split(b"\n", 1)
    try:
        said = ast.literal_eval(header[0].decode().strip())
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return member
    if (
        type(said) is not dict
        or not {"shape", "descr", "fortran_order"} <= said.keys()
        or type(said["shape"]) is not tuple
    ):  # changed before
        return member
    shape, kind, order = repr(said["shape"]), repr(said["descr"]), repr(said["fortran_order"])
    which = int(random.integers(4))
    if which <= 1:
        other = tuple(int(n) for n in random.integers(-2, 9, len(said["shape"])))
        shape = pick(random, SHAPES) if which else repr(other)
    elif which == 2:
        kind = pick(random, TYPES)
    else:
        order = pick(random, ("True", "1", "None", "'x'"))
    text = f"{{'descr': {kind}, 'fortran_order': {order}, 'shape': {shape}, }}"
    text = pick(
        random,
        (
            text,
            text,
            text,
            text,
            text + "#" * 20000,
            "[" * 5000,
            text[:-4],
            "'" + text,
            "{**1}",
            text * 2,
            "((((" * 60,
            "{'descr': '<f4' 'shape'",
            "-" * 4000 + "1",
            "'''",
            "0x" + "f" * 9000,
            "\0",
            "é",
        ),
    )
    version = pick(
        random, (b"\x01\x00",) * 6 + (b"\x02\x00", b"\x03\x00", b"\x00\x00", b"\xff\xff")
    )
    raw = text.encode("latin1" if version != b"\x03\x00" else "utf8", "replace") + b"\n"
    length = len(raw) if random.random() < 0.9 else int(pick(random, WORDS[:10]))
    wide = "<H" if version == b"\x01\x00" else "<I"
    return (
        b"\x93NUMPY"
        + version
        + struct.pack(wide, length % 256 ** struct.calcsize(wide))
        + raw
        + header[-1]
    )


def _redirected(data, random):
    """A zip file whose directory entries (or local headers) say something else: flags, method, sizes, places."""
    data = bytearray(data)
    local = random.random() < 0.3
    places = [
        match.start()
        for match in re.finditer(b"PK\x03\x04" if local else b"PK\x01\x02", bytes(data))
    ]
    for at in (places and [pick(random, places)]) or []:
        fields = (
            ((6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2))
            if local
            else (
                (6, 2),
                (8, 2),
                (8, 2),
                (10, 2),
                (10, 2),
                (16, 4),
                (20, 4),
                (24, 4),
                (28, 2),
                (30, 2),
                (42, 4),
            )
        )
        offset, wide = pick(random, fields)
        number = pick(random, (*WORDS, 8, 9, 12, 14, 93, 99, 2048, int(random.integers(10**6))))
        data[at + offset : at + offset + wide] = (number % 256**wide).to_bytes(wide, "little")
    return bytes(data)


# ---- text


VALUES = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e308",
    "1e-320",
    "-0.0",
    "0x" + "f" * 5000,
    "9" * 4000,
    "9" * 5000,
    "2.5",
    '""',
    '"x"',
    '"' + "x" * 5000 + '"',
    '"\\u0000"',
    '"../../../dev/null"',
    '"/dev/zero"',
    '"curves.csv"',
    "[]",
    "{}",
    "[[]]",
    "[1, 2]",
    "[1, 2, 3]",
    "[[1, 2], [3]]",
    "[[0, 0], [1, 1]]",
    "{a = 1}",
    "{wavelengths_nm = [1, 2], R = 3}",
    "{wavelengths_nm = [400, 700], R = [1, 1], G = [1, 1], B = [1, 1]}",
    "1979-05-27",
    "true",
    "[true]",
    '["RG"]',
    "[" * 3000,
    "[" * 3000 + "]" * 3000,
    "{a=" * 900 + "1" + "}" * 900,
    "07:32:00",
    '"""',
    "'",
    '"auto"',
    '"kTC"',
    '["RGB", "G"]',
    '["' + "R" * 3000 + '"]',
    "[" + "1," * 3000 + "]",
    "100000",
    "1_000_000_000_000",
)


def toml(text: bytes, lines: list, random) -> bytes:
    """A TOML file with lines left out, moved, taken from elsewhere, and values of other kinds."""
    own = text.decode().split("\n")
    for _ in range(int(random.integers(1, 4))):
        where = int(random.integers(len(own)))
        kind = int(random.integers(8))
        if kind <= 2 and "=" in own[where]:
            own[where] = own[where].split("=")[0] + "= " + pick(random, VALUES)
        elif kind <= 4:
            own.insert(where, pick(random, lines))
        elif kind == 5:
            del own[where : where + int(random.integers(1, 3))]
        elif kind == 6:
            own.insert(where, pick(random, own) if own else "")
        else:
            letters = pick(random, ("a", '"a"', "a" * 300, "\t", "é", '""', "'b'"))
            own.insert(
                where,
                pick(random, ("{} = 1", "[{}]", "[[{}]]")).format(
                    ".".join([letters] * int(2 ** random.uniform(0, 13)))
                ),
            )
        own = own or [""]
    whole = "\n".join(own).encode()
    return pick(
        random,
        (whole,) * 6
        + (
            b"\xef\xbb\xbf" + whole,
            whole.replace(b"\n", b"\r"),
            whole + b"\0",
            whole + b"\xff",
            whole.decode().encode("utf-16"),
            damaged(whole, b"", random),
        ),
    )


YAML = (
    ".nan",
    ".inf",
    "-1",
    "0",
    "2.5",
    "1e308",
    "1e-320",
    "9" * 5000,
    "''",
    "[]",
    "{}",
    "[[]]",
    "*a",
    "&a [*a]",
    "null",
    "!!python/object:os.system x",
    "!!binary x",
    "!!opencv-matrix 3",
    "2020-01-01",
    "12:30:45",
    "true",
    "[1, 2]",
    "[" * 900,
    "{a: " * 900,
    "1_000",
    "0x" + "f" * 4000,
    "<<: *x",
    "radtan",
    "equi",
    "[equi]",
    "{radtan: 1}",
    "&x;",
)


def yaml(text: bytes, random) -> bytes:
    """YAML, JSON or XML with lines left out and moved, and values of other kinds."""
    lines = text.decode().split("\n")
    for _ in range(int(random.integers(1, 4))):
        where, kind = int(random.integers(len(lines))), int(random.integers(7))
        if kind <= 2 and ":" in lines[where]:
            lines[where] = lines[where].split(":")[0] + ": " + pick(random, YAML)
        elif kind == 3:
            lines.insert(where, pick(random, lines))
        elif kind == 4 and len(lines) > 1:
            del lines[where]
        else:
            numbers = re.findall(r"-?\d+\.?\d*", lines[where]) or [" "]
            lines[where] = lines[where].replace(pick(random, numbers), pick(random, YAML), 1)
    return "\n".join(lines).encode()


CELLS = (
    "nan",
    "inf",
    "-1",
    "1e400",
    "",
    " ",
    "x",
    '"',
    '"a\nb"',
    "0",
    "1e-5",
    "1e5",
    "400",
    "\0",
    "é",
    "1" * 5000,
    "0x10",
    "1_0",
    "wavelength_nm",
    "=1+1",
    "\ufeff",
)


def table(text: bytes, random) -> bytes:
    """A CSV file with other cells, lines and ends."""
    divider = next((one for one in ";\t" if one in text.decode()), ",")
    rows = [line.split(divider) for line in text.decode().split("\n")]
    for _ in range(int(random.integers(1, 4))):
        row = pick(random, rows)
        kind = int(random.integers(5))
        if kind <= 1 and row:
            row[int(random.integers(len(row)))] = pick(random, CELLS)
        elif kind == 2:
            row[:] = row * int(2 ** random.uniform(0, 10)) if len(row) < 999 else row[:1]
        elif kind == 3:
            rows.insert(int(random.integers(len(rows))), list(pick(random, rows)))
        else:
            rows.remove(row)
            rows = rows or [[""]]
    whole = "\n".join(divider.join(row) for row in rows).encode("utf-8", "surrogatepass")
    return pick(
        random,
        (whole,) * 5
        + (
            b"\xef\xbb\xbf" + whole,
            whole.replace(b"\n", b"\r"),
            whole + b"\xff",
            damaged(whole, b"", random),
        ),
    )
