"""The crop that a container asks for, which FFmpeg's decoders do not apply: Matroska and MP4.

Source: RFC 9559 (Matroska), 5.1.4.1.28; ISO/IEC 14496-12, CleanApertureBox.
"""

import io
import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

LARGEST = 1 << 24  # [byte] of a header
SEGMENT, TRACKS, TRACK, VIDEO = 0x18538067, 0x1654AE6B, 0xAE, 0xE0
LEFT, TOP, RIGHT, BOTTOM = 0x54CC, 0x54BB, 0x54DD, 0x54AA
SAMPLE_ENTRY = 78  # bytes of a VisualSampleEntry before its boxes
MATROSKA = b"\x1a\x45\xdf\xa3"


class Crop(NamedTuple):
    """Pixels that are cut off each side of a stored frame."""

    left: int = 0
    top: int = 0
    right: int = 0
    bottom: int = 0


def read_crop(file: BinaryIO, track: int, cols: int, rows: int) -> Crop:
    """Return the crop of a track; none in other containers, or if the header is damaged.

    Args:
        file: Open file.
        track: Index of the track.
        cols: Columns of a stored frame.
        rows: Rows of a stored frame.
    """
    start = file.read(4)
    file.seek(0)
    try:
        found = _matroska(file, track) if start == MATROSKA else _mp4(file, track, cols, rows)
    except (struct.error, IndexError, ValueError, ZeroDivisionError, StopIteration):
        return Crop()
    is_inside = min(found) >= 0 and found.left + found.right < cols
    return found if is_inside and found.top + found.bottom < rows else Crop()


def _matroska(file, track):
    body = _child(_elements(file.read(LARGEST)), SEGMENT, TRACKS)
    tracks = [content for name, content in _elements(body) if name == TRACK]
    values = {
        name: int.from_bytes(content[:8], "big")
        for name, content in _elements(_child(_elements(tracks[track]), VIDEO))
    }
    return Crop(*(values.get(name, 0) for name in (LEFT, TOP, RIGHT, BOTTOM)))


def _child(elements, *path):
    """Return the content of the first element of a path; empty if there is none."""
    body = next((content for name, content in elements if name == path[0]), b"")
    return _child(_elements(body), *path[1:]) if len(path) > 1 else body


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the number and the content of each EBML element."""
    at = 0
    while at < len(data):
        length = 9 - data[at].bit_length()
        name = int.from_bytes(data[at : at + length], "big")
        at += length
        length = 9 - data[at].bit_length()
        size = int.from_bytes(data[at : at + length], "big") & ((1 << 7 * length) - 1)
        at += length
        yield name, data[at : at + size]  # a size of only ones means: to the end
        at += size


def _mp4(file, track, cols, rows):
    boxes = [body for name, body in _boxes(file) if name == b"moov"]
    tracks = [body for name, body in _boxes(io.BytesIO(boxes[0])) if name == b"trak"]
    body = tracks[track]
    for name in (b"mdia", b"minf", b"stbl", b"stsd"):
        body = next(content for one, content in _boxes(io.BytesIO(body)) if one == name)
    _, entry = next(_boxes(io.BytesIO(body[8:])))
    for name, content in _boxes(io.BytesIO(entry[SAMPLE_ENTRY:])):
        if name == b"clap":
            numbers = struct.unpack(">iIiIiIiI", content[:32])
            width, height, right, down = (
                above / below for above, below in zip(numbers[::2], numbers[1::2], strict=True)
            )
            left = round((cols - width) / 2 + right)
            top = round((rows - height) / 2 + down)
            return Crop(left, top, cols - left - round(width), rows - top - round(height))
    return Crop()


def _boxes(file) -> Iterator[tuple[bytes, bytes]]:
    """Yield the name and the content of each box; the content of media data is empty."""
    while len(header := file.read(8)) == 8:
        size, name = struct.unpack(">I4s", header)
        before = 8
        if size == 1:
            (size,) = struct.unpack(">Q", file.read(8))
            before = 16
        if size and size < before:
            return
        if name == b"mdat" or size - before > LARGEST:
            file.seek(size - before, io.SEEK_CUR)
            yield name, b""
        else:
            yield name, file.read(size - before if size else LARGEST)
