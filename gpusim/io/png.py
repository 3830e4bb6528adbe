"""Completeness of a PNG: checksums of its chunks, and the bytes of every line of its picture.

Pillow accepts a file whose compressed lines end early, with black for the missing lines. Source:
PNG specification, third edition (W3C 2025): chunks 5, interlacing 8, filtering 9.
"""

import math
import struct
import zlib
from dataclasses import dataclass

from gpusim.domain.errors import BadFile

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of PNG's colour types
ADAM7 = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
PIECE = 2**20  # [byte] inflated at once


@dataclass(frozen=True)
class Header:
    """Columns, rows, bits of a sample, colour type, and whether the lines are interlaced."""

    cols: int
    rows: int
    bits: int
    colour: int
    interlaced: bool

    @property
    def nbytes(self) -> int:
        """Bytes of all lines, each with its filter byte."""
        passes = ADAM7 if self.interlaced else ((0, 0, 1, 1),)
        nbytes = 0
        for x, y, dx, dy in passes:
            rows, cols = math.ceil((self.rows - y) / dy), math.ceil((self.cols - x) / dx)
            if rows > 0 and cols > 0:
                nbytes += rows * (1 + math.ceil(cols * self.bits * CHANNELS[self.colour] / 8))
        return nbytes


def read_lines(path, data: bytes, keep: bool) -> tuple[Header, bytes, dict[bytes, bytes]]:
    """Check a PNG from its signature to its end; return its header, its lines and other chunks.

    The lines are filtered, and left out without `keep`. The first chunk of each kind is returned.
    Takes no more memory than the declared lines and the file. Raises BadFile.
    """
    header, packed, others = _chunks(path, data)
    inflate, pieces, found = zlib.decompressobj(), [], 0
    for piece in packed:
        while piece and not inflate.eof:
            lines = inflate.decompress(piece, min(PIECE, header.nbytes - found + 1))
            found += len(lines)
            if found > header.nbytes:
                why = f"damaged: holds more than the lines of {header.cols} x {header.rows} pixels"
                raise BadFile(path, why)
            if keep:
                pieces.append(lines)
            piece = inflate.unconsumed_tail
    if found < header.nbytes or not inflate.eof:
        raise BadFile(
            path,
            f"truncated: holds {found} of the {header.nbytes} bytes that {header.cols} x "
            f"{header.rows} pixels take",
        )
    return header, b"".join(pieces), others


def _chunks(path, data):
    """Return header, compressed pieces and other chunks; raise BadFile if a chunk is damaged."""
    header, packed, others, place = None, [], {}, len(SIGNATURE)
    view = memoryview(data)
    while True:
        if place + 12 > len(data):
            raise BadFile(path, "truncated: its end is missing")
        length, kind = struct.unpack_from(">I4s", data, place)
        body = view[place + 8 : place + 8 + length]
        if place + 12 + length > len(data):
            raise BadFile(path, f"truncated: {len(body)} of {length} bytes of a chunk are present")
        (checksum,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(body, zlib.crc32(kind)) != checksum:
            raise BadFile(path, f"damaged: wrong checksum of a chunk at byte {place}")
        if header is None:
            cols, rows, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", body)
            if kind != b"IHDR" or colour not in CHANNELS:
                raise BadFile(path, "damaged: not the header of a PNG")
            header = Header(cols, rows, bits, colour, bool(interlaced))
        elif kind == b"IDAT":
            packed.append(body)
        elif kind == b"IEND":
            return header, packed, others
        else:
            others.setdefault(kind, bytes(body))
        place += length + 12


def without_profile(data: bytes) -> bytes:
    """Return a PNG without its colour profile, of which Pillow accepts no more than 1 MiB."""
    place = len(SIGNATURE)
    while data.startswith(SIGNATURE) and place + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, place)
        end = place + 12 + length
        if kind == b"iCCP":
            return data[:place] + data[end:]
        if kind == b"IDAT":
            break
        place = end
    return data


def png(header: Header, packed: bytes, chunks: dict | None = None) -> bytes:
    """Return a PNG of these compressed lines; chunks: {kind: body} of chunks before them."""
    start = struct.pack(
        ">IIBBBBB", header.cols, header.rows, header.bits, header.colour, 0, 0, header.interlaced
    )
    parts = [(b"IHDR", start), *(chunks or {}).items(), (b"IDAT", packed), (b"IEND", b"")]
    return SIGNATURE + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )
