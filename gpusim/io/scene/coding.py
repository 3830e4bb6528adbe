"""Meaning of the numbers in photographs: curves and primaries by profiles, chunks and tags.

Sources: ICC.1:2010 (profile version 4.3.0.0): header 7.2, types 10.5, 10.15 and 10.28, matrix and
grey models annex F.3; PNG specification, third edition (W3C 2025), 4.3 and 11.3.2; ITU-T H.273
(2023), tables 2 and 3; DCF 2.0 (JEITA CP-3461B), optional colour space. Pillow's LittleCMS, which
computes in 8 bits, converts by profiles of tables only.
"""

import io
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpusim.data.colorimetry import adaptation
from gpusim.data.srgb import srgb_from_rgb, srgb_to_xyz
from gpusim.data.transfers import HDR_WHITE, TRANSFERS, light_of
from gpusim.domain.display import DISPLAYS, P3_PRIMARIES
from gpusim.domain.errors import BadData, BadFile, one_line
from gpusim.io.files import reading

Curve = Callable[[np.ndarray], np.ndarray]  # from codes, 0 .. 1, to light, 0 .. 1

SRGB = DISPLAYS["srgb"]
D65 = SRGB.white
ADOBE_RGB = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65)
ADOBE_GAMMA = 563 / 256
# primaries and white by H.273's code points
PRIMARIES = {
    1: (*SRGB.primaries, D65),
    4: ((0.67, 0.33), (0.21, 0.71), (0.14, 0.08), (0.310, 0.316)),
    5: ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), D65),
    6: ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65),
    7: ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65),
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    10: ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (1 / 3, 1 / 3)),
    11: (*P3_PRIMARIES, (0.314, 0.351)),
    12: (*P3_PRIMARIES, D65),
}
LONGEST_CURVE = 65536
SAME_LIGHT, SAME_MIX = 2e-4, 2e-3  # differences of profiles named sRGB: digits of tables and whites
LAB = (b"Lab ", 903.2963, 8.0)  # connection space; slope and end of the line of L*


@dataclass(frozen=True)
class Coding:
    """Light of the numbers of a picture.

    curves: of grey, or of red, green and blue. matrix: from linear RGB to linear sRGB, None is the
    same. white: luminance of white [cd/m2], None is unknown. table: a profile that only LittleCMS
    can apply, to samples of 8 bits; they then become sRGB. notes: what was not used.
    """

    curves: tuple[Curve, ...] = (SRGB.decode,)
    matrix: np.ndarray | None = None
    white: float | None = None
    table: bytes | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def is_srgb(self) -> bool:
        """Whether the numbers are sRGB."""
        return self.curves == (SRGB.decode,) and self.matrix is None and self.table is None

    def decode(self, colours: np.ndarray) -> np.ndarray:
        """Return light in linear sRGB or grey, (rows, cols, channels), which may be negative.

        colours: uint8, uint16, or floats with white 1.
        """
        if self.table is not None:
            colours = apply_table(self.table, colours)
        *shape, channels = colours.shape
        # channels first in memory: each is read and written in a run
        planes = np.empty((channels, *shape), np.float64 if self.is_srgb else np.float32)
        for channel, plane in enumerate(planes):
            curve = self.curves[channel % len(self.curves)]
            _take_light(curve, colours[..., channel], plane)
        light = np.moveaxis(planes, 0, -1)
        if self.matrix is None:
            return light
        return np.einsum("ij,klj->kli", self.matrix.astype(np.float32), light)


def _take_light(curve, samples, out):
    """Write the light of samples to an array; a table has that of all whole numbers."""
    if samples.dtype.kind != "u":
        out[...] = curve(samples)
        return
    most = np.iinfo(samples.dtype).max
    table = np.asarray(curve(np.arange(most + 1) / most), out.dtype)
    np.take(table, samples, out=out, mode="clip")  # no number is clipped, and none is checked


LINEAR = Coding((np.asarray,))


def by_primaries(curve: Curve, chromaticities, white: float | None = None) -> Coding:
    """Return the coding of a curve, and of (x, y) of red, green, blue and white. Raises BadData."""
    return Coding((curve,), srgb_from_rgb(chromaticities), white)


def by_gamma(exponent: float, chromaticities=None) -> Coding:
    """Return the coding of a power law. Raises BadData."""
    primaries = PRIMARIES[1] if chromaticities is None else chromaticities

    def curve(codes):
        return np.copysign(np.abs(codes) ** exponent, codes)

    return by_primaries(curve, primaries)


def adobe_rgb() -> Coding:
    """Return the coding of Adobe RGB (1998)."""
    return by_gamma(ADOBE_GAMMA, ADOBE_RGB)


def by_h273(most: int, primaries: int, transfer: int, matrix: int, full_range: int) -> Coding:
    """Return the coding of four code points. most: largest code. Raises BadData for unknown ones."""
    is_known = primaries in PRIMARIES and transfer in TRANSFERS and matrix == 0
    if not is_known or full_range not in (0, 1):
        raise BadData(f"code points {primaries}, {transfer}, {matrix}, {full_range}")
    name = TRANSFERS[transfer]

    def light(codes):
        return light_of(name, codes)

    def limited(codes):
        unit = (most + 1) // 256  # codes of a step of 8 bits
        return light((codes * most - 16 * unit) / (219 * unit))

    white = HDR_WHITE if name == "pq" else None
    return by_primaries(light if full_range else limited, PRIMARIES[primaries], white)


def by_profile(path, profile: bytes, is_grey: bool) -> Coding:
    """Return the coding of an ICC profile of RGB or grey; is_grey: the picture is.

    Raises BadFile for a profile that cannot be used.
    """
    with reading(path, "an ICC profile"):
        if profile[36:40] != b"acsp":
            raise ValueError("no signature")
        tags = {}
        for number in range(min(struct.unpack_from(">I", profile, 128)[0], 200)):
            name, start, size = struct.unpack_from(">4sII", profile, 132 + 12 * number)
            tags[name] = profile[start : start + size]
        space, connection = profile[16:20], profile[20:24]
        if space not in (b"RGB ", b"GRAY") or (space == b"GRAY") > is_grey:
            kind = one_line(space.decode("latin-1"))
            raise ValueError(
                f"a profile of {kind}, for a {'grey' if is_grey else 'colour'} picture"
            )
        has_table = {b"A2B0", b"A2B1", b"D2B0", b"D2B1"} & tags.keys()
        if has_table and not is_grey:
            _littlecms(profile)  # checks it
            return Coding(table=profile, notes=("colours by a profile of tables: in 8 bits",))
        if space == b"GRAY":
            curve = _curve(tags[b"kTRC"])
            return Coding((_from_lightness(curve) if connection == LAB[0] else curve,))
        curves = tuple(_curve(tags[letter + b"TRC"]) for letter in (b"r", b"g", b"b"))
        columns = [_xyz(tags[letter + b"XYZ"]) for letter in (b"r", b"g", b"b")]
        return _snap(curves[1:2] if is_grey else curves, None if is_grey else _to_srgb(columns))


def _snap(curves, matrix) -> Coding:
    """Return the coding of a profile: sRGB itself for one whose rounded numbers are those of sRGB."""
    codes = np.linspace(0, 1, 256)
    off = [np.abs(curve(codes) - SRGB.decode(codes)).max() for curve in curves]
    if max(off) < SAME_LIGHT and (matrix is None or np.abs(matrix - np.eye(3)).max() < SAME_MIX):
        return Coding()
    return Coding(curves, matrix)


def _to_srgb(columns):
    """Return the matrix to linear sRGB from XYZ of the primaries, adapted to D50."""
    to_xyz = np.array(columns).T
    white, own = to_xyz.sum(axis=1), srgb_to_xyz().sum(axis=1)
    if not (white > 0.1).all() or abs(np.linalg.det(to_xyz)) < 1e-6:
        raise ValueError("primaries that give no white")
    return np.linalg.inv(srgb_to_xyz()) @ adaptation(white, own) @ to_xyz


def _xyz(tag):
    kind, *numbers = struct.unpack_from(">4s4x3i", tag)
    if kind != b"XYZ ":
        raise ValueError("a primary that is no XYZ")
    return np.array(numbers) / 65536


def _curve(tag: bytes) -> Curve:
    """Return the curve of a tag of type curv or para; any error if it is none."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count > LONGEST_CURVE:
            raise ValueError("a curve that is too long")
        stored = np.frombuffer(tag, ">u2", count, 12)
        if count == 0:
            return np.asarray
        if count == 1:
            return _power(float(stored[0]) / 256)
        light = stored / 65535
        return lambda codes: np.interp(codes, np.linspace(0, 1, len(light)), light)
    if tag[:4] != b"para":
        raise ValueError("a curve of an unknown type")
    (kind,) = struct.unpack_from(">H", tag, 8)
    count = (1, 3, 4, 5, 7)[kind]
    g, a, b, c, d, e, f = (
        *(np.array(struct.unpack_from(f">{count}i", tag, 12)) / 65536),
        *[0.0] * 6,
    )[:7]
    if kind == 0:
        return _power(g)
    if kind in (1, 2):  # c is added, below the corner too
        if a <= 0:
            raise ValueError("a curve without a slope")
        a, b, c, d, e, f = a, b, 0.0, -b / a, c, c
    _require_gamma(g)

    def parametric(codes):
        return np.where(codes >= d, np.maximum(a * codes + b, 0) ** g + e, c * codes + f)

    return parametric


def _power(exponent: float) -> Curve:
    _require_gamma(exponent)
    if exponent == 1:
        return np.asarray
    return lambda codes: np.copysign(np.abs(codes) ** exponent, codes)


def _require_gamma(exponent):
    if not 0.05 <= exponent <= 20:
        raise ValueError(f"a curve of the power {exponent:g}")


def _from_lightness(curve: Curve) -> Curve:
    """Return the curve to light of one to L* / 100."""

    def light(codes):
        lightness = 100 * curve(codes)
        return np.where(lightness > LAB[2], ((lightness + 16) / 116) ** 3, lightness / LAB[1])

    return light


def _littlecms(profile: bytes):
    """Return LittleCMS's transform from a profile to sRGB."""
    from PIL import ImageCms

    return ImageCms.buildTransform(
        ImageCms.ImageCmsProfile(io.BytesIO(profile)),
        ImageCms.createProfile("sRGB"),
        "RGB",
        "RGB",
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )


def apply_table(profile: bytes, colours: np.ndarray) -> np.ndarray:
    """Return sRGB of 8 bits of colours (rows, cols, 3) by a profile of tables."""
    from PIL import Image, ImageCms

    if colours.dtype == np.uint16:
        colours = np.round(colours / 257.0)
    elif colours.dtype.kind == "f":
        colours = np.round(255 * np.clip(colours, 0, 1))
    image = Image.fromarray(np.ascontiguousarray(colours, np.uint8), "RGB")
    return np.asarray(ImageCms.applyTransform(image, _littlecms(profile)))


def coding_of(path, tags: Mapping[str, Any], is_grey: bool, most: int) -> Coding:
    """Return the coding of a picture, by the first of its tags that can be used.

    tags: any of "cICP" (four bytes), "icc", "sRGB" (True), "gAMA" (of encoding), "cHRM" (4, 2),
    "adobe" (True: Adobe RGB by EXIF), "uncalibrated", in this order of precedence. most: largest
    code. Tags that cannot be used become notes.
    """
    notes: list[str] = []
    makers: dict[str, Callable[[], Coding]] = {
        "cICP": lambda: by_h273(most, *tags["cICP"]),
        "icc": lambda: by_profile(path, tags["icc"], is_grey),
        "sRGB": Coding,
        "gAMA": lambda: by_gamma(1 / _require_inside("gAMA", tags["gAMA"]), tags.get("cHRM")),
        "cHRM": lambda: by_primaries(SRGB.decode, tags["cHRM"]),
        "adobe": adobe_rgb,
    }
    for name, make in makers.items():
        if tags.get(name) is None:
            continue
        try:
            found = make()
        except (BadData, BadFile) as error:
            what = "colour profile" if name == "icc" else name
            why = str(error).removeprefix(f"{path}: ")
            notes.append(f"{what} not used: {one_line(why, 120)}")
            continue
        if is_grey:
            found = Coding(found.curves, None, found.white, found.table, found.notes)
        return Coding(found.curves, found.matrix, found.white, found.table, (*notes, *found.notes))
    if tags.get("uncalibrated"):
        notes.append("EXIF says a colour space without a profile: taken as sRGB")
    return Coding(notes=tuple(notes))


def _require_inside(name, value):
    if not 0.05 <= value <= 20:
        raise BadData(f"{value:g}")
    return value


def colour_space(space, index) -> dict[str, Any]:
    """Return the tags for `coding_of` of EXIF's ColorSpace and InteroperabilityIndex."""
    if "R03" in str(index) or space == 2:  # 2 is not in the standard, but written
        return {"adobe": True}
    return {"uncalibrated": True} if space == 0xFFFF else {}


def chunk_tags(chunks: Mapping[bytes, bytes]) -> dict[str, Any]:
    """Return the tags of a PNG's chunks, for `coding_of`; those of a wrong length are left out."""
    tags: dict[str, Any] = {}
    lengths = {b"cICP": 4, b"sRGB": 1, b"gAMA": 4, b"cHRM": 32}
    sound = {kind: chunks[kind] for kind, n in lengths.items() if len(chunks.get(kind, b"")) == n}
    if b"cICP" in sound:
        tags["cICP"] = tuple(sound[b"cICP"])
    if b"sRGB" in sound:
        tags["sRGB"] = True
    if b"gAMA" in sound:
        tags["gAMA"] = struct.unpack(">I", sound[b"gAMA"])[0] / 1e5
    if b"cHRM" in sound:
        places = np.array(struct.unpack(">8I", sound[b"cHRM"])) / 1e5
        tags["cHRM"] = np.roll(places.reshape(4, 2), -1, axis=0)  # white is the first
    if b"iCCP" in chunks:
        tags["icc"] = _inflate(chunks[b"iCCP"])
    return tags


MOST_PROFILE = 2**24  # [byte]


def _inflate(body: bytes) -> bytes:
    """Return the profile in a chunk iCCP, b"" if it is damaged."""
    _, zero, packed = body.partition(b"\0")
    try:
        return zlib.decompressobj().decompress(packed[1:], MOST_PROFILE) if zero else b""
    except zlib.error:
        return b""
