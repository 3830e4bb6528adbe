"""Damaged files made from good ones: bytes of any file, and the structure of each format with its checksums right."""

import ast
import io
import math
import re
import struct
import zipfile
import zlib

import numpy as np

WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)


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
                data[at:at + 1] = bytes([data[at] ^ (1 << int(random.integers(8)))]) if data else b""
        elif kind == 2:
            data[start:start + length] = random.bytes(length)
        elif kind == 3:
            number, wide = pick(random, WORDS), pick(random, (1, 2, 4, 8))
            data[start:start + wide] = (number % 256**wide).to_bytes(wide, pick(random, ("little", "big")))
        elif kind == 4:
            del data[start:start + length]
        elif kind == 5:
            data[start:start] = data[start:start + length] * int(random.integers(1, 20))
        elif kind == 6:
            begin = int(random.integers(len(other) or 1))
            data[start:start + length] = other[begin:begin + length]
        else:
            del data[start:]
    return bytes(data)


# ---- NumPy archives


SHAPES = ("()", "(0,)", "(1,)", "(3,)", "(-1,)", "(3, 4)", "(2, 3, 4)", "(1000000,)", "(100000000000,)", "(2**70,)",
          f"({2**62}, 4)", f"({2**63},)", f"({10**30},)", "(0, 99999999999999)", "(1.5,)", "('3',)", "None", "3",
          "(" + "1, " * 70 + ")", "(" * 300 + ")" * 300, "[3]", "(True,)", "(3L, 4L, 5L)", "(3,", "{}")
TYPES = ("'<f4'", "'<f8'", "'>f8'", "'<f2'", "'|u1'", "'<i8'", "'<u8'", "'|b1'", "'<c16'", "'|O'", "'<U1'", "'<U0'",
         "'|S5'", "'|V0'", "'<M8[s]'", "'<U999999999'", "'<f3'", "'zz'", "''", "[('a', '<f4')]", "[]", "None", "'<f16'",
         "('<f4', (2, 2))", "'<f4,<f4'", "'(1000000,1000000)f8'", "{'a': ('<f4', 0)}", "[('a', '|O')]", "1")


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
            members[name] = _revalued(arrays.get(name[:-4], np.zeros(3)), random)
        elif kind <= 4:
            members[name] = _reheaded(members[name], random)
        elif kind == 5:
            members[name] = damaged(members[name], b"", random)
        elif kind == 6:
            members[pick(random, ("x.npy", "x" * 3000, "../x.npy", " ", "detail_0.npy", "offsets.npy", "cube.npy"))] = (
                members.pop(name))
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
    methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    with zipfile.ZipFile(buffer, "w") as file:
        for name, data in members.items():
            method = pick(random, methods) if random.random() < 0.1 else pick(random, methods[:2])
            file.writestr(name, data, method, compresslevel=1)
    return buffer.getvalue()


def _revalued(array, random):
    """The array with other values, another type or another shape."""
    kind = int(random.integers(5))
    array = np.array(array)
    if kind <= 1 and array.size and array.dtype.kind in "iuf":
        with np.errstate(all="ignore"):
            array.reshape(-1)[int(random.integers(array.size))] = np.array(
                pick(random, (0.0, -1.0, 1e9, 1e38, np.nan, np.inf, -np.inf, 255.0, 65536.0))).astype(array.dtype)
    elif kind == 2:
        array = np.resize(array, tuple(random.integers(0, 6, int(random.integers(0, 5)))))
    elif kind == 3:
        with np.errstate(all="ignore"):
            wanted = pick(random, ("f2", "f8", "i1", "u1", "i8", "c8", "U5", "S3", "?", "M8[s]", "O", "f16"))
            try:
                array = array.astype(wanted)
            except (ValueError, TypeError):
                array = np.zeros(array.shape, wanted)
    else:
        array = np.array(pick(random, (0, 1, -1, 2**31, 2**63 - 1, 0.0, np.nan, np.inf, 1e300, "", "x" * 5000, "scene",
                                       "a\nb", True, [[]], [1.0, 2.0], 3 + 4j)))
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _reheaded(member, random):
    """An array whose header says something else; the numbers stay."""
    start = 10 if member[6:7] == b"\x01" else 12
    header = member[start:].split(b"\n", 1)
    try:
        said = ast.literal_eval(header[0].decode().strip())
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return member
    if type(said) is not dict or not {"shape", "descr", "fortran_order"} <= said.keys():  # changed before
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
    text = pick(random, (text, text, text, text, text + "#" * 20000, "[" * 5000, text[:-4], "'" + text, "{**1}",
                         text * 2, "((((" * 60, "{'descr': '<f4' 'shape'", "-" * 4000 + "1", "'''", "0x" + "f" * 9000,
                         "\0", "é"))
    version = pick(random, (b"\x01\x00",) * 6 + (b"\x02\x00", b"\x03\x00", b"\x00\x00", b"\xff\xff"))
    raw = text.encode("latin1" if version != b"\x03\x00" else "utf8", "replace") + b"\n"
    length = len(raw) if random.random() < 0.9 else int(pick(random, WORDS[:10]))
    wide = "<H" if version == b"\x01\x00" else "<I"
    return b"\x93NUMPY" + version + struct.pack(wide, length % 256 ** struct.calcsize(wide)) + raw + header[-1]


def _redirected(data, random):
    """A zip file whose directory entries (or local headers) say something else: flags, method, sizes, places."""
    data = bytearray(data)
    local = random.random() < 0.3
    places = [match.start() for match in re.finditer(b"PK\x03\x04" if local else b"PK\x01\x02", bytes(data))]
    for at in (places and [pick(random, places)]) or []:
        fields = (((6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2)) if local else
                  ((6, 2), (8, 2), (8, 2), (10, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4)))
        offset, wide = pick(random, fields)
        number = pick(random, (*WORDS, 8, 9, 12, 14, 93, 99, 2048, int(random.integers(10**6))))
        data[at + offset:at + offset + wide] = (number % 256**wide).to_bytes(wide, "little")
    return bytes(data)


# ---- PNG and JPEG


def png(data: bytes, random) -> bytes:
    """A PNG of other chunks, with right checksums; pixel data too short, too long or of other filters."""
    chunks, at = [], 8
    while at < len(data):
        length, = struct.unpack_from(">I", data, at)
        chunks.append([data[at + 4:at + 8], data[at + 8:at + 8 + length]])
        at += length + 12
    for _ in range(int(random.integers(1, 3))):
        where = int(random.integers(len(chunks)))
        kind = int(random.integers(8))
        if kind <= 1:
            header = bytearray(chunks[0][1])
            at, wide = pick(random, ((0, 4), (4, 4), (8, 1), (9, 1), (9, 1), (10, 1), (11, 1), (12, 1)))
            number = pick(random, (*WORDS, 2, 3, 4, 6, 8, 16, 5000, 40000))
            header[at:at + wide] = (number % 256**wide).to_bytes(wide, "big")
            chunks[0][1] = bytes(header)
        elif kind <= 3:
            _repacked(chunks, random)
        elif kind == 4:
            chunks[where][1] = damaged(chunks[where][1], b"", random)
        elif kind == 5:
            chunks.insert(where, list(pick(random, chunks)))
        elif kind == 6:
            name = pick(random, (b"PLTE", b"tRNS", b"iCCP", b"eXIf", b"gAMA", b"zTXt", b"iTXt", b"acTL", b"fcTL",
                                 b"fdAT", b"cHRM", b"pHYs", b"sRGB", b"QQQQ", b"qqqq", b"\0\0\0\0", b"IEND", b"IDAT",
                                 b"IHDR"))
            body = pick(random, (b"", random.bytes(int(random.integers(40))), b"a\0\0" + zlib.compress(bytes(10**6)),
                                 b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + random.bytes(8)))
            chunks.insert(where, [name, body])
        elif len(chunks) > 1:
            del chunks[where]
    return png_of(chunks)


def png_of(chunks) -> bytes:
    """A PNG of chunks (name, body)."""
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks)


def _repacked(chunks, random):
    """Other pixel data, compressed rightly."""
    raw = b"".join(body for name, body in chunks if name == b"IDAT")
    try:
        lines = zlib.decompress(raw)
    except zlib.error:
        return
    lines = pick(random, (lines[:int(random.integers(len(lines) + 1))], lines + bytes(int(10 ** random.uniform(0, 7))),
                          damaged(lines, b"", random), b""))
    packed = zlib.compress(lines, 1)
    packed = pick(random, (packed, packed, packed[:-4], packed[:-4] + b"abcd", packed + packed))
    rest = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
    cut = int(random.integers(len(packed) + 1))
    chunks[:] = [*rest[:-1], [b"IDAT", packed[:cut]], [b"IDAT", packed[cut:]], *rest[-1:]]


def jpeg(data: bytes, random) -> bytes:
    """A JPEG of other segments: sizes, tables, orientation, an early end."""
    segments, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        length = struct.unpack_from(">H", data, at + 2)[0] + 2
        segments.append(data[at:at + length])
        at += length
    rest = data[at:]
    for _ in range(int(random.integers(1, 3))):
        where = int(random.integers(len(segments))) if segments else 0
        kind = int(random.integers(6))
        if kind == 0:
            rest = rest[:int(random.integers(len(rest) + 1))] + b"\xff\xd9"
        elif kind == 1 and segments:
            for number, segment in enumerate(segments):
                if segment[1] in (0xC0, 0xC2):
                    at, wide = pick(random, ((4, 1), (5, 2), (7, 2), (9, 1), (11, 1)))
                    body = bytearray(segment)
                    body[at:at + wide] = (pick(random, (*WORDS, 3000, 12)) % 256**wide).to_bytes(wide, "big")
                    segments[number] = bytes(body)
        elif kind == 2 and segments:
            segments[where] = segments[where][:4] + damaged(segments[where][4:], b"", random)
        elif kind == 3 and segments:
            segments.insert(where, pick(random, segments))
        elif kind == 4 and segments:
            del segments[where]
        else:
            body = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + random.bytes(int(random.integers(12)))
            segments.insert(where, b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body)
    return data[:2] + b"".join(segments) + rest


# ---- TIFF and OpenEXR


TAGS = (254, 256, 257, 258, 259, 262, 273, 274, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 330, 338, 339, 347,
        512, 530, 32995, 34665, 42112, 42113, 50838, 50839)


def tiff(data: bytes, random) -> bytes:
    """A TIFF (classic, little-endian) with other entries in its directories: tags, types, counts, values, next ones."""
    data = bytearray(data)
    places, at = [], struct.unpack_from("<I", data, 4)[0]
    while at and at + 2 <= len(data) and len(places) < 1000:
        count, = struct.unpack_from("<H", data, at)
        places += [at + 2 + 12 * number for number in range(count)]
        end = at + 2 + 12 * count
        at, = struct.unpack_from("<I", data, end)
        places.append(end)
    for _ in range(int(random.integers(1, 4))):
        place, kind = pick(random, places), int(random.integers(8))
        within = int(random.integers(len(data)))
        number = pick(random, (*WORDS, 2, 3, 4, 5, 7, 8, 16, 32, 64, 40000, 2**20, within, within))
        if kind == 0:
            data[place:place + 2] = struct.pack("<H", pick(random, TAGS))
        elif kind == 1:
            data[place + 2:place + 4] = struct.pack("<H", int(random.integers(0, 20)))
        elif kind == 2:
            data[place + 4:place + 8] = struct.pack("<I", number % 2**32)
        elif kind <= 5:
            data[place + 8:place + 12] = struct.pack("<I", number % 2**32)
        elif kind == 6:
            other = pick(random, places)
            data[place:place + 12] = data[other:other + 12]
        else:
            data[place:place + 4] = struct.pack("<I", pick(random, places) - 2)  # a chain that bites its tail
    return damaged(bytes(data), b"", random) if random.random() < 0.1 else bytes(data)


NAMES = (b"R", b"G", b"B", b"A", b"X", b"Y", b"Z", b"Z", b"depth.T", b"Depth.Z", b"L.Combined.R", b"S0.400nm",
         b"S0.500nm", b"S1.400nm", b"T.400nm", b"T.400nm.500nm", b"T.1e400nm", b"wavelength400", b"wavelength430_25",
         b"wavelength0", b"S0.", b"S0.0nm", b"\xff", b"a\nb", b"x" * 300)


def exr(data: bytes, random) -> bytes:
    """An OpenEXR file whose header says something else; the offsets of its lines follow the header's length."""
    attributes, at = [], 8
    while data[at:at + 1] != b"\0":
        name, kind, rest = data[at:].split(b"\0", 2)
        size, = struct.unpack_from("<I", rest)
        attributes.append([name, kind, rest[4:4 + size]])
        at += len(name) + len(kind) + 6 + size
    window = next(body for name, _, body in attributes if name == b"dataWindow")
    lines = math.ceil((1 + window[12] - window[4]) / 16)  # ZIP packs 16 at once; these windows are small
    offsets = struct.unpack_from(f"<{lines}Q", data, at + 1)
    for _ in range(int(random.integers(1, 3))):
        one, kind = pick(random, attributes), int(random.integers(8))
        if kind <= 3:
            channels = next((body for body in attributes if body[0] == b"channels"), one)
            _channels(channels, random)
        elif kind == 4:
            one[2] = damaged(one[2], b"", random)
        elif kind == 5:
            one[1] = pick(random, (b"float", b"string", b"box2i", b"chromaticities", b"v2f", b"int", b"x" * 40))
        elif kind == 6:
            attributes.append([b"chromaticities", b"chromaticities", struct.pack("<8f", *(pick(
                random, (0.0, 0.3, 0.64, 1.0, -1.0, float("nan"), float("inf"), 1e-30)) for _ in range(8)))])
        elif len(attributes) > 1:
            attributes.remove(one)
    header = b"".join(name + b"\0" + kind + b"\0" + struct.pack("<I", len(body)) + body
                      for name, kind, body in attributes) + b"\0"
    table = struct.pack(f"<{lines}Q", *(offset + len(header) + 8 - at - 1 for offset in offsets))
    return data[:8] + header + table + data[at + 1 + 8 * lines:]


def _channels(attribute, random):
    """Other names or types in a list of channels."""
    body, entries, at = attribute[2], [], 0
    while 0 <= body.find(b"\0", at) and body[at:at + 1] != b"\0":
        end = body.index(b"\0", at)
        entries.append([body[at:end], body[end + 1:end + 17]])
        at = end + 17
    for _ in range(int(random.integers(1, 1 + len(entries))) if entries else 0):
        entry, kind = pick(random, entries), int(random.integers(5))
        if kind <= 2:
            entry[0] = pick(random, NAMES)
        elif kind == 3:
            entry[1] = struct.pack("<I", pick(random, (0, 1, 2, 3, 2**31))) + entry[1][4:]
        else:
            entry[1] = entry[1][:8] + struct.pack("<II", pick(random, (0, 1, 2, 2**31)), pick(random, (0, 1, 2, 7)))
    entries.sort()
    attribute[2] = b"".join(name + b"\0" + rest for name, rest in entries) + b"\0"


# ---- text


VALUES = ("nan", "inf", "-inf", "-1", "0", "1e308", "1e-320", "-0.0", "0x" + "f" * 5000, "9" * 4000, "9" * 5000, "2.5",
          '""', '"x"', '"' + "x" * 5000 + '"', '"\\u0000"', '"../../../dev/null"', '"/dev/zero"', '"curves.csv"', "[]",
          "{}", "[[]]", "[1, 2]", "[1, 2, 3]", "[[1, 2], [3]]", "[[0, 0], [1, 1]]", "{a = 1}",
          "{wavelengths_nm = [1, 2], R = 3}",
          "{wavelengths_nm = [400, 700], R = [1, 1], G = [1, 1], B = [1, 1]}", "1979-05-27", "true", "[true]", '["RG"]',
          "[" * 3000, "[" * 3000 + "]" * 3000, "{a=" * 900 + "1" + "}" * 900, "07:32:00", '"""', "'", '"auto"', '"kTC"',
          '["RGB", "G"]', '["' + "R" * 3000 + '"]', "[" + "1," * 3000 + "]", "100000", "1_000_000_000_000")


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
            del own[where:where + int(random.integers(1, 3))]
        elif kind == 6:
            own.insert(where, pick(random, own) if own else "")
        else:
            letters = pick(random, ("a", '"a"', "a" * 300, "\t", "é", '""', "'b'"))
            own.insert(where, pick(random, ("{} = 1", "[{}]", "[[{}]]")).format(
                ".".join([letters] * int(2 ** random.uniform(0, 13)))))
        own = own or [""]
    whole = "\n".join(own).encode()
    return pick(random, (whole,) * 6 + (b"\xef\xbb\xbf" + whole, whole.replace(b"\n", b"\r"), whole + b"\0",
                                        whole + b"\xff", whole.decode().encode("utf-16"), damaged(whole, b"", random)))


CELLS = ("nan", "inf", "-1", "1e400", "", " ", "x", '"', '"a\nb"', "0", "1e-5", "1e5", "400", "\0", "é", "1" * 5000,
         "0x10", "1_0", "wavelength_nm", "=1+1", "\ufeff")


def table(text: bytes, random) -> bytes:
    """A CSV file with other cells, lines and ends."""
    rows = [line.split(",") for line in text.decode().split("\n")]
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
    whole = "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass")
    return pick(random, (whole,) * 5 + (b"\xef\xbb\xbf" + whole, whole.replace(b"\n", b"\r"), whole + b"\xff",
                                        damaged(whole, b"", random)))
