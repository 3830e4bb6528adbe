"""The meaning of a video's codes, by its tags (ITU-T H.273).

Curves: BT.709 and BT.601 (the inverse of the camera's curve, BT.709-6, 1.2), sRGB, pure powers, PQ
(SMPTE ST 2084) and HLG (ARIB STD-B67), the last two with white at the 203 cd/m2 and 75 % of ITU-R
BT.2408. Codes of more than 8 bits are converted by the integers of the standards: in limited range
of n bits, black is 16 2^(n-8), white 235 2^(n-8), and chroma has 224 2^(n-8) steps.

A matrix or primaries without a tag follow from the other one. If neither has a tag, they are chosen
as players do: BT.709 for frames of more than 576 rows or at least 1280 columns, else BT.601, with
primaries by the number of rows. Luma and chroma without a tag are of limited range, RGB and grey of
full range.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from gpusim.apps.video.codecs import EXACT, EXACT_LINEAR, converter
from gpusim.data.transfers import TRANSFERS, light_of
from gpusim.domain.display import DISPLAYS, P3_PRIMARIES
from gpusim.domain.errors import BadData

BT709, BT2020 = DISPLAYS["srgb"].primaries, ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))
SMPTE170M = ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070))
BT470BG = ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06))
EBU3213 = ((0.630, 0.340), (0.295, 0.605), (0.155, 0.077))
PRIMARIES = {
    1: ("BT.709", BT709),
    5: ("BT.601 of 625 lines", BT470BG),
    6: ("BT.601 of 525 lines", SMPTE170M),
    7: ("SMPTE 240M", SMPTE170M),
    9: ("BT.2020", BT2020),
    12: ("Display P3", P3_PRIMARIES),
    22: ("EBU 3213-E", EBU3213),
}
# Names in FFmpeg's scaler, and the weights of red and blue in luma
MATRICES = {
    1: ("bt709", 0.2126, 0.0722),
    4: ("fcc", 0.30, 0.11),
    5: ("bt601", 0.299, 0.114),
    6: ("bt601", 0.299, 0.114),
    7: ("smpte240m", 0.212, 0.087),
    9: ("bt2020", 0.2627, 0.0593),
}
# Tags that follow from the other one, if it is the only one
PRIMARIES_OF_MATRIX = {1: 1, 5: 5, 6: 6, 7: 7, 9: 9}
MATRIX_OF_PRIMARIES = {1: 1, 5: 5, 6: 6, 7: 7, 9: 9, 12: 1, 22: 5}
UNTAGGED = (0, 2)
LIMITED, FULL = 1, 2  # libavutil's ranges
DEPTHS = (8, 9, 10, 12, 14, 16)  # bits of planar pixel formats


class Tags(NamedTuple):
    """Numbers of ITU-T H.273, and libavutil's number of the range."""

    transfer: int
    primaries: int
    matrix: int
    range: int


@dataclass(frozen=True)
class Coding:
    """The meaning of a video's codes.

    Attributes:
        transfer: Transfer function, of TRANSFERS.
        primaries: (x, y) of red, green and blue.
        matrix: Key of MATRICES.
        is_full: Whether codes use their full range.
        layout: "yuv", "rgb" or "gray".
        bits: Bits of a code.
        notes: What was guessed, and what is not used.
    """

    transfer: str
    primaries: tuple
    matrix: int
    is_full: bool
    layout: str
    bits: int
    notes: tuple[str, ...]

    @property
    def curve(self) -> np.ndarray:
        """Light of every RGB code."""
        return _table(self.transfer, 65535 if self._is_deep else 255)

    @property
    def _is_deep(self):
        """Whether codes are converted here, to 16 bits; FFmpeg converts the others, to 8 bits."""
        return self.bits > 8 or not (self.is_full or self.layout == "yuv")

    def rgb(self, frame: Any, size: tuple[int, int]) -> np.ndarray:
        """Return RGB codes of a frame (rows, cols, 3), full range, uint8 or uint16.

        Args:
            frame: VideoFrame.
            size: Columns and rows; a frame of another size is interpolated.
        """
        extent = "full" if self.is_full else "tv"
        words, matrix = f":w={size[0]}:h={size[1]}", ""
        if self.layout == "yuv":
            matrix = MATRICES[self.matrix][0]
        if not self._is_deep:
            stored, words = "rgb24", EXACT + words
            words += f":in_color_matrix={matrix}:in_range={extent}" if matrix else ""
            words += ":out_range=full"
        else:
            bits = self.bits if self.bits in DEPTHS else 16
            stored = {"yuv": "yuv444p", "rgb": "gbrp", "gray": "gray"}[self.layout]
            stored += f"{bits}le" if bits > 8 else ""
            # only chroma is interpolated: the same range and matrix on both sides
            words = f"{EXACT_LINEAR}{words}:in_range={extent}:out_range={extent}"
            words += f":in_color_matrix={matrix}:out_color_matrix={matrix}" if matrix else ""
        given = frame.format, frame.time_base
        converted = converter(words, stored, frame.width, frame.height, *given)(frame)
        return self._from_planes(converted, bits) if self._is_deep else converted.to_ndarray()

    def share_above_white(self, frame: Any) -> float:
        """Return the part of a frame's luma that is above white in limited range, which is clipped."""
        is_planar = frame.format.name.startswith("yuv") and len(frame.planes) > 2
        if self.is_full or not is_planar or frame.format.name.endswith("be"):
            return 0.0
        luma = _plane(frame.planes[0], self.bits)
        return float(np.mean(luma > 235 * 2 ** (self.bits - 8)))

    def _from_planes(self, frame, bits):
        """Return RGB codes of 16 bits from a frame of planes."""
        planes = [_plane(part, bits) for part in frame.planes]
        steps = 2 ** (bits - 8)
        black, white = (0, 2**bits - 1) if self.is_full else (16 * steps, 235 * steps)
        scale = np.float32(1 / (white - black))
        if self.layout == "yuv":
            _, red, blue = MATRICES[self.matrix]
            span = white if self.is_full else 224 * steps
            y = (planes[0] - np.float32(black)) * scale
            cb, cr = (
                (part - np.float32(128 * steps)) * np.float32(2 / span) for part in planes[1:]
            )
            r, b = y + cr * np.float32(1 - red), y + cb * np.float32(1 - blue)
            # from y = red r + green g + blue b
            cr *= np.float32(red * (1 - red) / (1 - red - blue))
            cb *= np.float32(blue * (1 - blue) / (1 - red - blue))
            colours = [r, y - cr - cb, b]
        elif self.layout == "rgb":  # stored as green, blue, red
            colours = [(planes[at] - np.float32(black)) * scale for at in (2, 0, 1)]
        else:
            colours = [(planes[0] - np.float32(black)) * scale] * 3
        codes = np.empty((*colours[0].shape, 3), np.uint16)
        for at, values in enumerate(colours):
            codes[..., at] = np.rint(np.clip(values, 0, 1) * np.float32(65535))
        return codes


def _plane(part, bits):
    """Return a plane of a frame as float32 (rows, cols)."""
    kind = np.dtype("<u2" if bits > 8 else np.uint8)
    values = np.frombuffer(part, kind).reshape(part.height, -1)
    return values[:, : part.width].astype(np.float32)


def read_coding(tags: Tags, pixels: Any, cols: int, rows: int, transfer: str | None) -> Coding:
    """Return the meaning of codes.

    Args:
        tags: Tags of the video.
        pixels: VideoFormat.
        cols: Columns of a frame.
        rows: Rows of a frame.
        transfer: Transfer function in place of the tag, of TRANSFERS.

    Raises:
        BadData: If the meaning is unknown.
    """
    known = sorted(set(TRANSFERS.values()))
    if transfer is None and tags.transfer not in TRANSFERS:
        tag = "not tagged" if tags.transfer in UNTAGGED else f"tag {tags.transfer}"
        raise BadData(
            f"its transfer function is {tag}, so the meaning of its codes is unknown; give "
            f"--transfer {' or '.join(known)}"
        )
    layout, bits = _layout(pixels), max(part.bits for part in pixels.components)
    names = ", ".join(name for name, _ in PRIMARIES.values())
    if tags.primaries not in (*UNTAGGED, *PRIMARIES):
        raise BadData(f"its primaries have the tag {tags.primaries}; wanted {names}")
    primaries, matrix, notes = _guess(tags, layout, cols, rows)
    if matrix not in MATRICES and layout == "yuv":
        raise BadData(
            f"its matrix has the tag {matrix}; wanted BT.601, BT.709, BT.2020 with non-constant "
            "luminance, FCC or SMPTE 240M"
        )
    is_full = tags.range == FULL or pixels.name.startswith("yuvj")
    if tags.range not in (LIMITED, FULL) and layout != "yuv":
        is_full = True
    if len(pixels.components) in (2, 4) and pixels.name not in ("nv12", "nv21"):
        notes.append("its alpha is not used")
    name, places = PRIMARIES[primaries]
    if places != BT709:
        notes.append(f"primaries of {name} are converted to sRGB; colours outside it are clipped")
    chosen = TRANSFERS[tags.transfer] if transfer is None else transfer
    return Coding(chosen, places, matrix, is_full, layout, bits, tuple(notes))


def _layout(pixels):
    """Return "yuv", "rgb" or "gray". Raises BadData."""
    name = pixels.name
    if name.startswith("xyz") or "f16" in name or "f32" in name:
        raise BadData(
            f"its pixel format is {name}; wanted RGB, luma and chroma, or grey, in integers"
        )
    if pixels.is_rgb or name.startswith(("pal", "mono", "rgb", "bgr", "gbr", "bayer")):
        return "rgb"
    return "gray" if name.startswith(("gray", "ya")) else "yuv"


def _guess(tags, layout, cols, rows):
    """Return the tags of primaries and matrix, and notes on the ones that were guessed."""
    primaries, matrix, notes = tags.primaries, tags.matrix, []
    guessed = []
    if layout == "yuv" and matrix in UNTAGGED:
        is_large = cols >= 1280 or rows > 576
        matrix = MATRIX_OF_PRIMARIES.get(primaries) or (1 if is_large else 6)
        guessed.append(f"matrix {MATRICES[matrix][0]}")
    if primaries in UNTAGGED:
        sd = {480: 6, 486: 6, 488: 6, 576: 5}.get(rows, 1) if cols < 1280 else 1
        of_matrix = PRIMARIES_OF_MATRIX.get(tags.matrix) if layout == "yuv" else 1
        primaries = of_matrix or sd
        guessed.append(f"primaries {PRIMARIES[primaries][0]}")
    if layout == "yuv" and tags.range not in (LIMITED, FULL):
        guessed.append("limited range")
    if guessed and layout == "yuv":
        notes.append(f"not tagged, so taken as players do: {', '.join(guessed)}")
    return primaries, matrix, notes


@cache
def _table(transfer: str, most: int) -> np.ndarray:
    """Return the light of every code 0 .. most, white 1, float32."""
    return light_of(transfer, np.arange(most + 1) / most).astype(np.float32)
