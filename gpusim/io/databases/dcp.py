"""Colour matrices of a camera in two lights: DNG camera profiles (.dcp), and the same tags of a DNG."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.io.files import open_file, reading

LONGEST = 64 * 2**20  # [byte]
WHAT = "a DNG camera profile"
MAGIC = (0x4352, 42)  # of a profile, of a TIFF
MOST_TAGS = 4096
MATRICES = {50721: 50778, 50722: 50779}  # ColorMatrix -> CalibrationIlluminant
MODEL, NAME = 50708, 50936
# LightSource of Exif -> light
LIGHTS = {
    **{1: "D55", 2: "FL2", 3: "A", 4: "D55", 9: "D55", 10: "D65", 11: "D75", 17: "A"},
    **{18: "B", 19: "C", 20: "D55", 21: "D65", 22: "D75", 23: "D50", 24: "blackbody-3200K"},
}
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 9: 4, 10: 8}


@dataclass(frozen=True)
class Profile:
    """Colour of a camera.

    Attributes:
        model: Name of the camera.
        name: Name of the profile.
        matrices: (light, matrix) pairs; a matrix goes from XYZ in its light to the channels, (3, 3).
        file: The file.
    """

    model: str
    name: str
    matrices: tuple[tuple[str, np.ndarray], ...]
    file: Path


def read_profile(path: Path) -> Profile:
    """Read the colour matrices of a camera profile, or of a DNG.

    Args:
        path: .dcp, or .dng with a ColorMatrix.

    Returns:
        The profile.

    Raises:
        BadFile: The file is none, damaged, or without a matrix of three channels.

    Source:
        Adobe, "Digital Negative (DNG) Specification", 1.4.0.0, chapter 6, and appendix "Camera
        profiles".
    """
    with open_file(path) as file, reading(path, WHAT):
        data = file.read(LONGEST)
        tags = _tags(data)
        if tags is None:
            raise BadFile(path, f"not {WHAT}: it begins otherwise; wanted a .dcp or .dng file")
        matrices = tuple(
            (LIGHTS.get(int(tags.get(light, [0])[0]), "D65"), np.reshape(tags[matrix], (3, 3)))
            for matrix, light in MATRICES.items()
            if len(tags.get(matrix, ())) == 9
        )
        texts = [
            bytes(tags.get(tag, b"")).split(b"\0")[0].decode("utf-8", "replace")
            for tag in (MODEL, NAME)
        ]
    for _, matrix in matrices:
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-6:
            raise BadFile(path, "its ColorMatrix has no inverse")
    if not matrices:
        raise BadFile(path, "has no ColorMatrix1 or ColorMatrix2 of three channels")
    return Profile(texts[0] or path.stem, texts[1], matrices, path)


def profile_camera(path: Path) -> str:
    """Return the name of the camera of a profile's file, without a check of the rest: its file's name."""
    return path.stem


def _tags(data) -> dict | None:
    """Return the tags of the first directory that are used; None if the data are no profile's."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None or struct.unpack_from(f"{order}H", data, 2)[0] not in MAGIC:
        return None
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, start)
    tags = {}
    for number in range(min(count, MOST_TAGS)):
        at = start + 2 + 12 * number
        tag, kind, length = struct.unpack_from(f"{order}HHI", data, at)
        if tag in (*MATRICES, *MATRICES.values(), MODEL, NAME) and kind in _SIZES:
            size = _SIZES[kind] * length
            place = at + 8 if size <= 4 else struct.unpack_from(f"{order}I", data, at + 8)[0]
            tags[tag] = _values(data[place : place + size], order, kind, length)
    return tags


def _values(part, order, kind, length):
    """Return the values of a tag: bytes, or numbers."""
    if kind in (1, 2):
        return part
    letters = {3: "H", 4: "I", 5: "I", 9: "i", 10: "i"}[kind]
    if kind in (5, 10):
        pairs = np.array(struct.unpack(f"{order}{2 * length}{letters}", part), np.float64)
        return pairs[::2] / np.where(pairs[1::2] == 0, np.nan, pairs[1::2])
    return np.array(struct.unpack(f"{order}{length}{letters}", part), np.float64)
