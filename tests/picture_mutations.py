"""Damaged pictures made from good ones: chunks, segments, directories and headers that say something else."""

import io
import math
import struct
import zlib

import numpy as np
from mutations import WORDS, damaged, pick

# ---- PNG and JPEG


def png(data: bytes, random) -> bytes:
    """A PNG of other chunks, with right checksums; pixel data too short, too long or of other filters."""
    chunks, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append([data[at + 4 : at + 8], data[at + 8 : at + 8 + length]])
        at += length + 12
    for _ in range(int(random.integers(1, 3))):
        where = int(random.integers(len(chunks)))
        kind = int(random.integers(8))
        if kind <= 1:
            header = bytearray(chunks[0][1])
            at, wide = pick(
                random, ((0, 4), (4, 4), (8, 1), (9, 1), (9, 1), (10, 1), (11, 1), (12, 1))
            )
            number = pick(random, (*WORDS, 2, 3, 4, 6, 8, 16, 5000, 40000))
            header[at : at + wide] = (number % 256**wide).to_bytes(wide, "big")
            chunks[0][1] = bytes(header)
        elif kind <= 3:
            _repacked(chunks, random)
        elif kind == 4:
            chunks[where][1] = damaged(chunks[where][1], b"", random)
        elif kind == 5:
            chunks.insert(where, list(pick(random, chunks)))
        elif kind == 6:
            name = pick(
                random,
                (
                    b"PLTE",
                    b"tRNS",
                    b"iCCP",
                    b"eXIf",
                    b"gAMA",
                    b"zTXt",
                    b"iTXt",
                    b"acTL",
                    b"fcTL",
                    b"fdAT",
                    b"cHRM",
                    b"cICP",
                    b"pHYs",
                    b"sRGB",
                    b"QQQQ",
                    b"qqqq",
                    b"\0\0\0\0",
                    b"IEND",
                    b"IDAT",
                    b"IHDR",
                ),
            )
            body = pick(
                random,
                (
                    b"",
                    random.bytes(int(random.integers(40))),
                    b"a\0\0" + zlib.compress(bytes(10**6)),
                    b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + random.bytes(8),
                ),
            )
            chunks.insert(where, [name, body])
        elif len(chunks) > 1:
            del chunks[where]
    return png_of(chunks)


def png_of(chunks) -> bytes:
    """A PNG of chunks (name, body)."""
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )


def _repacked(chunks, random):
    """Other pixel data, compressed rightly."""
    raw = b"".join(body for name, body in chunks if name == b"IDAT")
    try:
        lines = zlib.decompress(raw)
    except zlib.error:
        return
    lines = pick(
        random,
        (
            lines[: int(random.integers(len(lines) + 1))],
            lines + bytes(int(10 ** random.uniform(0, 7))),
            damaged(lines, b"", random),
            b"",
        ),
    )
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
        segments.append(data[at : at + length])
        at += length
    rest = data[at:]
    for _ in range(int(random.integers(1, 3))):
        where = int(random.integers(len(segments))) if segments else 0
        kind = int(random.integers(6))
        if kind == 0:
            rest = rest[: int(random.integers(len(rest) + 1))] + b"\xff\xd9"
        elif kind == 1 and segments:
            for number, segment in enumerate(segments):
                if segment[1] in (0xC0, 0xC2):
                    at, wide = pick(random, ((4, 1), (5, 2), (7, 2), (9, 1), (11, 1)))
                    body = bytearray(segment)
                    body[at : at + wide] = (pick(random, (*WORDS, 3000, 12)) % 256**wide).to_bytes(
                        wide, "big"
                    )
                    segments[number] = bytes(body)
        elif kind == 2 and segments:
            segments[where] = segments[where][:4] + damaged(segments[where][4:], b"", random)
        elif kind == 3 and segments:
            segments.insert(where, pick(random, segments))
        elif kind == 4 and segments:
            del segments[where]
        else:
            body = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + random.bytes(
                int(random.integers(12))
            )
            segments.insert(where, b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body)
    return data[:2] + b"".join(segments) + rest


# ---- TIFF and OpenEXR


TAGS = (
    254,
    256,
    257,
    258,
    259,
    262,
    273,
    274,
    277,
    278,
    279,
    284,
    317,
    320,
    322,
    323,
    324,
    325,
    330,
    338,
    339,
    347,
    512,
    530,
    32995,
    34665,
    42112,
    42113,
    50838,
    50839,
)


def tiff(data: bytes, random) -> bytes:
    """A TIFF (classic, little-endian) with other entries in its directories: tags, types, counts, values, next ones."""
    data = bytearray(data)
    places, at = [], struct.unpack_from("<I", data, 4)[0]
    while at and at + 2 <= len(data) and len(places) < 1000:
        (count,) = struct.unpack_from("<H", data, at)
        places += [at + 2 + 12 * number for number in range(count)]
        end = at + 2 + 12 * count
        (at,) = struct.unpack_from("<I", data, end)
        places.append(end)
    for _ in range(int(random.integers(1, 4))):
        place, kind = pick(random, places), int(random.integers(8))
        within = int(random.integers(len(data)))
        number = pick(random, (*WORDS, 2, 3, 4, 5, 7, 8, 16, 32, 64, 40000, 2**20, within, within))
        if kind == 0:
            data[place : place + 2] = struct.pack("<H", pick(random, TAGS))
        elif kind == 1:
            data[place + 2 : place + 4] = struct.pack("<H", int(random.integers(0, 20)))
        elif kind == 2:
            data[place + 4 : place + 8] = struct.pack("<I", number % 2**32)
        elif kind <= 5:
            data[place + 8 : place + 12] = struct.pack("<I", number % 2**32)
        elif kind == 6:
            other = pick(random, places)
            data[place : place + 12] = data[other : other + 12]
        else:
            data[place : place + 4] = struct.pack(
                "<I", pick(random, places) - 2
            )  # a chain that bites its tail
    return damaged(bytes(data), b"", random) if random.random() < 0.1 else bytes(data)


NAMES = (
    b"RY",
    b"BY",
    b"right.R",
    b"left.right.G",
    b"Combined.B",
    b".",
    b"..R",
    b"R",
    b"G",
    b"B",
    b"A",
    b"X",
    b"Y",
    b"Z",
    b"Z",
    b"depth.T",
    b"Depth.Z",
    b"L.Combined.R",
    b"S0.400nm",
    b"S0.500nm",
    b"S1.400nm",
    b"T.400nm",
    b"T.400nm.500nm",
    b"T.1e400nm",
    b"wavelength400",
    b"wavelength430_25",
    b"wavelength0",
    b"S0.",
    b"S0.0nm",
    b"\xff",
    b"a\nb",
    b"x" * 300,
)


def exr(data: bytes, random) -> bytes:
    """An OpenEXR file whose header says something else; the offsets of its lines follow the header's length."""
    if data[5] & 0x10:  # several parts
        return _other_parts(data, random)
    attributes, at = [], 8
    while data[at : at + 1] != b"\0":
        name, kind, rest = data[at:].split(b"\0", 2)
        (size,) = struct.unpack_from("<I", rest)
        attributes.append([name, kind, rest[4 : 4 + size]])
        at += len(name) + len(kind) + 6 + size
    window = next(body for name, _, body in attributes if name == b"dataWindow")
    lines = math.ceil(
        (1 + window[12] - window[4]) / 16
    )  # ZIP packs 16 at once; these windows are small
    offsets = struct.unpack_from(f"<{lines}Q", data, at + 1)
    for _ in range(int(random.integers(1, 3))):
        one, kind = pick(random, attributes), int(random.integers(8))
        if kind <= 3:
            channels = next((body for body in attributes if body[0] == b"channels"), one)
            _channels(channels, random)
        elif kind == 4:
            one[2] = damaged(one[2], b"", random)
        elif kind == 5:
            one[1] = pick(
                random,
                (b"float", b"string", b"box2i", b"chromaticities", b"v2f", b"int", b"x" * 40),
            )
        elif kind == 6:
            attributes.append(
                [
                    b"chromaticities",
                    b"chromaticities",
                    struct.pack(
                        "<8f",
                        *(
                            pick(
                                random,
                                (0.0, 0.3, 0.64, 1.0, -1.0, float("nan"), float("inf"), 1e-30),
                            )
                            for _ in range(8)
                        ),
                    ),
                ]
            )
        elif len(attributes) > 1:
            attributes.remove(one)
    header = (
        b"".join(
            name + b"\0" + kind + b"\0" + struct.pack("<I", len(body)) + body
            for name, kind, body in attributes
        )
        + b"\0"
    )
    table = struct.pack(f"<{lines}Q", *(offset + len(header) + 8 - at - 1 for offset in offsets))
    return data[:8] + header + table + data[at + 1 + 8 * lines :]


def _other_parts(data, random):
    """Other values, names or types in the headers of several parts, of the same lengths."""
    changed = bytearray(data)
    places = [
        (at, word)
        for word in (
            b"dataWindow\0",
            b"displayWindow\0",
            b"view\0",
            b"name\0",
            b"chlist\0",
            b"left",
            b"rgba",
        )
        for at in range(len(data))
        if data.startswith(word, at)
    ]
    for _ in range(int(random.integers(1, 4))):
        at, word = pick(random, places)
        start = at + len(word) + int(random.integers(0, 24)) if random.random() < 0.7 else at
        number = pick(random, (*WORDS, 1, 2, 3, 7, 8, 9))
        for place in range(start, min(start + int(random.integers(1, 5)), len(data))):
            changed[place] = number % 256
            number //= 256
    return bytes(changed)


def _channels(attribute, random):
    """Other names or types in a list of channels."""
    body, entries, at = attribute[2], [], 0
    while 0 <= body.find(b"\0", at) and body[at : at + 1] != b"\0":
        end = body.index(b"\0", at)
        entries.append([body[at:end], body[end + 1 : end + 17]])
        at = end + 17
    for _ in range(int(random.integers(1, 1 + len(entries))) if entries else 0):
        entry, kind = pick(random, entries), int(random.integers(5))
        if kind <= 2:
            entry[0] = pick(random, NAMES)
        elif kind == 3:
            entry[1] = struct.pack("<I", pick(random, (0, 1, 2, 3, 2**31))) + entry[1][4:]
        else:
            entry[1] = entry[1][:8] + struct.pack(
                "<II", pick(random, (0, 1, 2, 2**31)), pick(random, (0, 1, 2, 7))
            )
    entries.sort()
    attribute[2] = b"".join(name + b"\0" + rest for name, rest in entries) + b"\0"


def good_profile(random):
    """Bytes of a DNG's like: a mosaic with levels and a noise profile of three planes."""
    import tifffile

    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        random.integers(0, 1024, (8, 8), np.uint16),
        photometric="cfa",
        metadata=None,
        extratags=[
            (33421, "H", 2, (2, 2), True),
            (33422, "B", 4, bytes([0, 1, 1, 2]), True),
            (50714, "H", 1, 64, True),
            (50716, "2i", 8, (1, 2) * 8, True),
            (50829, "I", 4, (0, 0, 8, 8), True),
            (51009, "B", 4, bytes(4), True),
            (50717, "H", 1, 1023, True),
            (51041, "d", 6, (1e-3, 1e-6) * 3, True),
        ],
    )
    return buffer.getvalue()
