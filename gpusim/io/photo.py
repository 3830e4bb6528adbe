"""Photographs as scenes: sRGB pictures lifted to spectra."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np

from gpusim.data.srgb import srgb_primaries
from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Basis, Materials

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # PNG colour types without a palette: channels
ALPHA = {2, 4}  # numbers of channels of which the last is alpha
BYTES_PER_PIXEL = 64  # four float64 channels, the picture itself and the coefficients


def read_photo(path) -> Basis | Materials:
    """Read a PNG or JPEG as reflectances: white (1, 1, 1) reflects 1 at every wavelength.

    The picture is taken as sRGB (an embedded colour profile is not applied), 8 or 16 bits per channel, turned as its
    EXIF orientation says. Where it is transparent there is darkness behind it.
    Colour: `lift`ed; grey: one neutral material and its shading. Raises BadFile and DoesNotFit.
    """
    path = Path(path)
    if not path.is_file():
        raise BadFile(path, "no such file")
    try:
        samples = _decode(path)
    except (OSError, SyntaxError, ValueError, IndexError, struct.error, zlib.error, MemoryError) as error:
        raise BadFile(path, "not a PNG or JPEG, or truncated") from error
    linear = linear_from_srgb(samples[..., :3] if samples.shape[-1] > 2 else samples[..., :1])
    if samples.shape[-1] in ALPHA:
        linear *= samples[..., -1:]
    if linear.shape[-1] == 1:
        shading = linear[..., 0].astype(np.float32)
        wavelengths = srgb_primaries().wavelengths
        return Materials(wavelengths, np.zeros(shading.shape, np.uint8), shading, np.ones((1, len(wavelengths))))
    return lift(np.moveaxis(linear, -1, 0))


def lift(linear) -> Basis:
    """Reflectances that have these colours in D65.

    linear: linear sRGB, shape (3, rows, cols), not negative. Each pixel is the mixture of the reflectances of the three
    primaries, as on a display whose white is the light: Farrell & Wandell, section 3; spectra of `srgb_primaries`.
    """
    primaries = srgb_primaries()
    return Basis(primaries.wavelengths, np.ascontiguousarray(linear, np.float32), primaries.values)


def linear_from_srgb(values) -> np.ndarray:
    """Decode sRGB values, 0 .. 1, to linear ones. Source: IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _decode(path):
    """Return samples 0 .. 1, shape (rows, cols, channels): 1 (grey), 2 (grey, alpha), 3 or 4 (RGB, alpha)."""
    from PIL import Image, ImageOps

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked against memory below
        try:
            image = Image.open(path, formats=("PNG", "JPEG"))
        except Image.DecompressionBombError as error:
            raise BadFile(path, f"too large: {error}") from error
    with image:
        cols, rows = image.size
        require_memory(f"{path}: picture of {cols} x {rows} pixels", BYTES_PER_PIXEL * cols * rows)
        if image.format == "PNG" and path.read_bytes()[24] == 16:
            return _decode_png16(path)
        image = ImageOps.exif_transpose(image)
        if image.mode == "P" or "transparency" in image.info:
            image = image.convert("RGBA")
        elif image.mode == "1":
            image = image.convert("L")
        if image.mode not in ("L", "LA", "RGB", "RGBA"):
            raise BadFile(path, f"colour mode {image.mode}; wanted grey or RGB, with or without alpha")
        samples = np.asarray(image) / 255
    return samples if samples.ndim == 3 else samples[..., None]


def _decode_png16(path):
    """Decode a PNG of 16 bits per channel, of which Pillow would drop the lower 8.

    PNG predicts each byte from the same byte of neighbouring pixels. So the high bytes alone, with the same filter
    bytes, are a PNG of 8 bits, and so are the low bytes: Pillow decodes both.
    """
    from PIL import Image

    data = path.read_bytes()
    chunks, position = [], len(PNG_SIGNATURE)
    while position < len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        chunks.append((kind, data[position + 8:position + 8 + length]))
        position += length + 12
    cols, rows, _, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
    if interlaced:
        raise BadFile(path, "an interlaced PNG of 16 bits; save it without interlacing")
    filtered = zlib.decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"))
    lines = np.frombuffer(filtered, np.uint8).reshape(rows, 1 + 2 * cols * CHANNELS[colour])
    halves = []
    for first in (1, 2):
        half = zlib.compress(np.hstack([lines[:, :1], lines[:, first::2]]).tobytes(), 1)
        header = struct.pack(">IIBBBBB", cols, rows, 8, colour, 0, 0, 0)
        parts = [(b"IHDR", header), (b"IDAT", half), (b"IEND", b"")]
        png = PNG_SIGNATURE + b"".join(struct.pack(">I", len(body)) + kind + body
                                       + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in parts)
        halves.append(np.asarray(Image.open(io.BytesIO(png)), np.float64))
    samples = (256 * halves[0] + halves[1]) / 65535
    return samples if samples.ndim == 3 else samples[..., None]
