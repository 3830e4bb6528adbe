"""Photographs as scenes: sRGB pictures converted to spectra."""

import dataclasses
import io
import warnings
import zlib
from pathlib import Path

import numpy as np

from gpusim.data.srgb import srgb_primaries
from gpusim.domain.content import Basis, Materials
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadFile
from gpusim.domain.memory import require_memory
from gpusim.io.files import file_size, name_in_errors, open_file, reading
from gpusim.io.png import png, read_lines
from gpusim.io.scene.tiff import SUFFIXES as TIFF
from gpusim.io.scene.tiff import read_picture

JPEG = b"\xff\xd8"  # signature
ALPHA = {2, 4}  # numbers of channels with alpha as the last
# Of a JPEG: each block of 8 x 8 has at least one bit (its mean; ITU-T T.81, F.1.2 and G.1.2), and
# at least one component has a sample per four pixels. libjpeg fills in missing data.
PIXELS_PER_BYTE = 8 * 64 * 4
BYTES_PER_PIXEL = 64  # four float64 channels, the picture itself and the coefficients


def read_photo(path) -> Basis | Materials:
    """Read a PNG, JPEG or TIFF as reflectances: white (1, 1, 1) reflects 1 at every wavelength.

    The picture is read as sRGB (an embedded colour profile is not applied) with 8 or 16 bits per
    channel, or as linear sRGB floats, turned to its orientation. Transparent parts have
    darkness behind them. Colour is converted by `lift`; grey becomes one neutral material and its
    shading. Raises BadFile and DoesNotFit.
    """
    with name_in_errors(path):
        linear, alpha = _decode_light(read_samples(path))
        if alpha is not None:
            linear = linear * alpha[..., None]
        return lift(np.moveaxis(linear, -1, 0))


def read_cutout(path) -> tuple[Basis, np.ndarray]:
    """Read a PNG as reflectances in colour, see `read_photo`, and its coverage.

    The coverage is alpha, shape (rows, cols), 0 .. 1; 1 if there is no alpha. Raises BadFile and
    DoesNotFit.
    """
    with name_in_errors(path):
        linear, alpha = _decode_light(read_samples(path))
        covers = np.ones(linear.shape[:2]) if alpha is None else alpha
        colours = np.broadcast_to(linear, (*linear.shape[:2], 3))
        return lift(np.moveaxis(colours, -1, 0)), covers.astype(np.float32)


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


def _decode_light(samples):
    """Return linear light (rows, cols, 1 or 3), white 1, and alpha (rows, cols) or None.

    samples: from `read_samples`.
    """
    colours, white = samples[..., : 3 if samples.shape[-1] > 2 else 1], 1
    if samples.dtype.kind == "u":
        white = np.iinfo(samples.dtype).max
        colours = DISPLAYS["srgb"].decode(np.arange(white + 1) / white)[colours]
    return colours, samples[..., -1] / white if samples.shape[-1] in ALPHA else None


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


def read_samples(path) -> np.ndarray:
    """Return samples of a PNG, JPEG or TIFF, shape (rows, cols, channels).

    uint8, uint16 or (linear) float32. Channels: 1 (grey), 2 (grey, alpha), 3 or 4 (RGB, alpha).
    Raises BadFile and DoesNotFit.
    """
    from PIL import Image

    if Path(path).suffix.lower() in TIFF:
        return read_picture(path)
    with open_file(path) as file, reading(path, "a PNG or JPEG"), warnings.catch_warnings():
        # of large pictures: they are checked against memory below; of EXIF data
        warnings.simplefilter("ignore")
        require_memory(f"{path}: a file", file_size(file))
        data = file.read()
        try:
            image = Image.open(io.BytesIO(data), formats=("PNG", "JPEG"))
        except Image.DecompressionBombError as error:
            raise BadFile(path, f"too large: {error}") from error
        cols, rows = image.size
        if image.format == "JPEG" and cols * rows > PIXELS_PER_BYTE * len(data):
            raise BadFile(
                path,
                f"truncated or damaged: a JPEG of {cols} x {rows} pixels needs more than {len(data)} "
                "bytes",
            )
        require_memory(f"{path}: picture of {cols} x {rows} pixels", BYTES_PER_PIXEL * cols * rows)
        samples = _decode(path, data, image)
    return samples if samples.ndim == 3 else samples[..., None]


def _decode(path, data, image):
    """Return the samples of a picture that Pillow has opened but not decoded."""
    from PIL import ImageOps

    if image.format == "PNG":
        deep = data[24] == 16
        if deep and data[28]:
            raise BadFile(path, "an interlaced PNG of 16 bits; save it without interlacing")
        header, lines = read_lines(path, data, keep=deep)
        if deep:
            return _decode_png16(header, lines)
    image = ImageOps.exif_transpose(image)
    if image.mode == "P" or "transparency" in image.info:
        image = image.convert("RGBA")
    elif image.mode == "1":
        image = image.convert("L")
    if image.mode not in ("L", "LA", "RGB", "RGBA"):
        raise BadFile(path, f"colour mode {image.mode}; wanted grey or RGB, with or without alpha")
    return np.asarray(image)


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
