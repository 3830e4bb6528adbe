"""Photographs as scenes: sRGB pictures converted to spectra."""

import dataclasses
import io
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.data.srgb import draw_into_srgb, srgb_primaries
from gpusim.domain.content import Basis, Materials
from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.account import Fields, note_resolution
from gpusim.io.exr import OUTSIDE
from gpusim.io.files import file_size, name_in_errors, open_file, reading
from gpusim.io.orientation import turn
from gpusim.io.png import png, read_lines, without_profile
from gpusim.io.scene.coding import LINEAR, Coding, chunk_tags, coding_of, colour_space
from gpusim.io.scene.tiff import SUFFIXES as TIFF
from gpusim.io.scene.tiff import read_picture

JPEG = b"\xff\xd8"  # signature
ALPHA = {2, 4}  # numbers of channels with alpha as the last
ORIENTATION, EXIF, INTEROPERABILITY, COLOUR_SPACE = 274, 0x8769, 0xA005, 0xA001
UNUSED = "chunks not used"
# chunks of a PNG that are used, and those that say nothing about the light
IDLE_CHUNKS = (
    "PLTE cICP sRGB gAMA cHRM iCCP eXIf pHYs tEXt zTXt iTXt tIME bKGD hIST sPLT sBIT oFFs".split()
)
# Of a JPEG: each block of 8 x 8 has at least one bit (its mean; ITU-T T.81, F.1.2 and G.1.2), and
# at least one component has a sample per four pixels. libjpeg fills in missing data.
PIXELS_PER_BYTE = 8 * 64 * 4
BYTES_PER_PIXEL = 64  # four float64 channels, the picture itself and the coefficients


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture as it is stored.

    samples: uint8, uint16 or (linear) float32, (rows, cols, channels): 1 (grey), 2 (grey, alpha), 3
    or 4 (RGB, alpha). coding: the light of the samples. notes: what was not used.
    """

    samples: np.ndarray
    coding: Coding
    notes: tuple[str, ...] = ()

    def light(self) -> tuple[np.ndarray, np.ndarray | None, list[str]]:
        """Return light (rows, cols, 1 or 3), white 1, alpha (rows, cols) or None, and notes."""
        channels = self.samples.shape[-1]
        light = self.coding.decode(self.samples[..., : 3 if channels > 2 else 1])
        notes = [*self.notes, *self.coding.notes]
        if self.coding.matrix is None and not self.coding.is_srgb:
            np.maximum(light, 0, out=light)  # a limited range has codes below black
        elif self.coding.matrix is not None:
            planes = np.moveaxis(light, -1, 0)
            outside = draw_into_srgb(planes)
            light = np.moveaxis(planes, 0, -1)
            notes += [OUTSIDE.format(100 * outside)] if outside else []
        if channels not in ALPHA:
            return light, None, notes
        white = np.iinfo(self.samples.dtype).max if self.samples.dtype.kind == "u" else 1
        return light, self.samples[..., -1] / white, notes


def read_photo(
    path, part: int | str | None = None
) -> tuple[Basis | Materials, float | None, tuple[str, ...]]:
    """Read a PNG, JPEG or TIFF as reflectances: white (1, 1, 1) reflects 1 at every wavelength.

    The picture has 8 or 16 bits per channel, or linear floats, and is turned to its orientation.
    It is converted to linear sRGB by its colour profile (ICC) or its tags (a PNG's cICP, sRGB, gAMA
    and cHRM; Adobe RGB by EXIF); without one it is sRGB. Transparent parts have darkness behind
    them. Colour is converted by `lift`; grey becomes one neutral material and its shading. part:
    number of the page of a TIFF. Raises BadFile and DoesNotFit.

    Returns:
        The content, the luminance of white [cd/m2] if the file says it, and notes.
    """
    with name_in_errors(path):
        photo = open_photo(path, part)
        linear, alpha, notes = photo.light()
        if alpha is not None:
            linear = linear * alpha[..., None]
            notes += ["what is transparent is dark behind"] * bool(alpha.min() < 1)
        return lift(np.moveaxis(linear, -1, 0)), photo.coding.white, (*notes, *damage(path))


def read_cutout(path) -> tuple[Basis, np.ndarray]:
    """Read a PNG as reflectances in colour, see `read_photo`, and its coverage.

    The coverage is alpha, shape (rows, cols), 0 .. 1; 1 if there is no alpha. Raises BadFile and
    DoesNotFit.
    """
    with name_in_errors(path):
        linear, alpha, _ = open_photo(path).light()
        covers = np.ones(linear.shape[:2]) if alpha is None else alpha
        colours = np.broadcast_to(linear, (*linear.shape[:2], 3))
        content = lift(np.moveaxis(colours, -1, 0))
        assert isinstance(content, Basis)  # three colours
        return content, covers.astype(np.float32)


def damage(path) -> tuple[str, ...]:
    """Return notes on damage that libjpeg finds in a JPEG; it fills in the missing pixels.

    Pillow does not pass on libjpeg's warnings; simplejpeg does. Without it there are no notes.
    Raises BadFile.
    """
    with open_file(path) as file, reading(path, "a JPEG"):
        data = file.read() if file.peek(2)[:2] == JPEG else b""
    if not data:
        return ()
    try:
        import simplejpeg
    except ImportError:
        return ()
    try:
        # reads all, and computes one pixel in 64
        simplejpeg.decode_jpeg(data, "GRAY", fastdct=True, min_factor=8)
    except ValueError as error:
        return (f"damaged; read as far as libjpeg can: {error}",)
    return ()


def lift(linear) -> Basis | Materials:
    """Return reflectances with these colours in D65.

    linear: linear sRGB, shape (3, rows, cols), or grey, (1, rows, cols), not negative. Grey becomes
    one neutral material and its shading. Each coloured pixel is the mixture of the
    reflectances of the three primaries, as on a display whose white is the light: Farrell &
    Wandell, section 3; spectra of `srgb_primaries`.
    """
    primaries = srgb_primaries()
    if len(linear) == 1:
        ids, neutral = np.zeros(linear.shape[1:], np.uint8), np.ones_like(primaries.wavelengths)
        shading = np.ascontiguousarray(linear[0], np.float32)
        return Materials(primaries.wavelengths, ids, shading, neutral[None])
    return Basis(primaries.wavelengths, np.ascontiguousarray(linear, np.float32), primaries.values)


def open_photo(path, part: int | str | None = None) -> Photograph:
    """Read a PNG, JPEG or TIFF as it is stored; part: see `read_photo`. Raises BadFile, DoesNotFit."""
    from PIL import Image

    if Path(path).suffix.lower() in TIFF:
        samples, tags, notes = read_picture(path, part)
        return _photograph(path, samples, tags, notes)
    with open_file(path) as file, reading(path, "a PNG or JPEG"), warnings.catch_warnings():
        # of large pictures: they are checked against memory below; of EXIF data
        warnings.simplefilter("ignore")
        require_memory(f"{path}: a file", file_size(file))
        data = file.read()
        try:
            image = Image.open(io.BytesIO(without_profile(data)), formats=("PNG", "JPEG"))
        except Image.DecompressionBombError as error:
            raise BadFile(path, f"too large: {error}") from error
        cols, rows = image.size
        if image.format != "PNG" and cols * rows > PIXELS_PER_BYTE * len(data):
            raise BadFile(
                path,
                f"truncated or damaged: a JPEG of {cols} x {rows} pixels needs more than {len(data)} "
                "bytes",
            )
        require_memory(f"{path}: picture of {cols} x {rows} pixels", BYTES_PER_PIXEL * cols * rows)
        samples, tags, notes = (_png if image.format == "PNG" else _jpeg)(path, data, image)
        turned = turn(samples, image.getexif().get(ORIENTATION, 1))
    return _photograph(path, np.ascontiguousarray(turned), tags, notes)


def _photograph(path, samples, tags, notes):
    """Return a photograph, whose grey has an axis of channels."""
    samples = samples if samples.ndim == 3 else samples[..., None]
    if samples.dtype.kind == "f" and "icc" not in tags:
        return Photograph(samples, LINEAR, tuple(notes))
    most = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1
    coding = coding_of(path, tags, samples.shape[-1] < 3, most)
    return Photograph(samples, coding, tuple(notes))


def _png(path, data, image):
    """Return samples of a PNG that Pillow has opened but not decoded, its tags, and notes."""
    deep = data[24] == 16
    if deep and data[28]:
        raise BadFile(path, "an interlaced PNG of 16 bits; save it without interlacing")
    header, lines, chunks = read_lines(path, data, keep=deep)
    fields = Fields({kind.decode("latin-1"): body for kind, body in chunks.items()}, UNUSED)
    fields.ignore(*IDLE_CHUNKS)
    samples = _decode_png16(header, lines) if deep else _samples(path, image, header.colour)
    clear = fields.take("tRNS")
    if clear is not None and header.colour in (0, 2):
        samples = _with_alpha(samples, header, clear)
    notes = (
        note_resolution(*struct.unpack(">II", chunks[b"pHYs"][:8]))
        if len(chunks.get(b"pHYs", b"")) == 9
        else []
    )
    if "acTL" in fields:
        fields.ignore("acTL", "fcTL", "fdAT")
        notes.append("an animation: its first picture is used")
    return samples, chunk_tags(chunks) | _exif_tags(image), [*notes, *fields.notes()]


def _samples(path, image, colour=2):
    """Return the samples of 8 bits that Pillow decodes. Palettes become RGB with alpha."""
    if image.mode == "P":
        image = image.convert("RGBA" if "transparency" in image.info else "RGB")
    elif image.mode == "1":
        image = image.convert("L")
    if image.mode not in ("L", "LA", "RGB", "RGBA"):
        raise BadFile(
            path,
            f"colour mode {image.mode}; wanted grey or RGB, with or without alpha; convert it to RGB",
        )
    return np.asarray(image)


def _with_alpha(samples, header, clear):
    """Return samples with an alpha of 0 at the one colour that is transparent, tRNS."""
    samples = samples if samples.ndim == 3 else samples[..., None]
    channels = samples.shape[-1]
    if len(clear) < 2 * channels:
        return samples
    stored = np.array(struct.unpack_from(f">{channels}H", clear)) & (2**header.bits - 1)
    most = np.iinfo(samples.dtype).max
    shown = stored * (most // (2**header.bits - 1))  # bits are repeated to fill 8
    alpha = np.where((samples == shown).all(axis=-1), 0, most).astype(samples.dtype)
    return np.dstack([samples, alpha])


def _jpeg(path, data, image):
    """Return samples of a JPEG that Pillow has opened but not decoded, its tags, and notes."""
    notes, info = [], image.info
    if info.get("jfif_unit") in (1, 2):
        notes += note_resolution(*info.get("jfif_density", (1, 1)))
    count = getattr(image, "n_frames", 1)
    if count > 1:
        notes.append(f"further pictures in the file, {count - 1} of them, are not used")
    if b"hdrgm:" in data or b"HDRGainMap" in data:
        notes.append("a gain map for bright displays is not used")
    icc = {"icc": info["icc_profile"]} if info.get("icc_profile") else {}
    return _samples(path, image), icc | _exif_tags(image), notes


def _exif_tags(image) -> dict:
    """Return the colour space by EXIF, for `coding_of`."""
    try:
        exif = image.getexif()
        inside, between = exif.get_ifd(EXIF), exif.get_ifd(INTEROPERABILITY)
    except Exception:  # damaged EXIF data, of which Pillow raises many errors
        return {}
    return colour_space(inside.get(COLOUR_SPACE), between.get(1))


def _decode_png16(header, lines):
    """Decode a PNG of 16 bits per channel; Pillow would drop the lower 8.

    PNG predicts each byte from the same byte of neighbouring pixels. So the high bytes with the
    same filter bytes are a PNG of 8 bits, and so are the low bytes: Pillow decodes both.
    """
    from PIL import Image

    rows = np.frombuffer(lines, np.uint8).reshape(header.rows, -1)
    small = dataclasses.replace(header, bits=8)

    def decode(half):
        packed = zlib.compress(np.hstack([rows[:, :1], half]), 1)
        return np.asarray(Image.open(io.BytesIO(png(small, packed))))

    return decode(rows[:, 1::2]).astype(np.uint16) * 256 + decode(rows[:, 2::2])
