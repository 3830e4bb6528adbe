"""PNG, JPEG, WebP and TIFF pictures for display, tagged with their colour space."""

import io
import struct
import zlib

import numpy as np

from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.io.atomic import atomic_path
from gpusim.io.frame.icc import icc_profile
from gpusim.io.png import Header, png

LONGEST_JPEG = 65500  # pixels along an axis, of libjpeg
LONGEST_WEBP = 16383  # of the format
LOSSLESS = 100  # quality of a WebP without loss
TIFF_KINDS = (np.uint8, np.uint16, np.float32)


def write_png(path, image, display=DISPLAYS["srgb"]):
    """Write a PNG, tagged with the display that its codes are for.

    image: uint8 or uint16, shape (rows, cols, 3), or (rows, cols) grey. Raises BadData and BadFile.
    """
    data = png_bytes(image, display, path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def png_bytes(image, display=DISPLAYS["srgb"], name="picture") -> bytes:
    """Return the PNG as bytes, see `write_png`; name: for errors. Raises BadData."""
    image = np.ascontiguousarray(image)
    is_shaped = image.ndim > 1 and image.shape[2:] in ((), (3,)) and image.size > 0
    if not (is_shaped and image.dtype in (np.uint8, np.uint16)):
        raise BadData(
            f"{name}: a PNG needs uint8 or uint16 of shape (rows, cols, 3) or (rows, cols), "
            f"got {image.dtype} {image.shape}"
        )
    return _png(image, _chunks(display, image.ndim == 3))


def _png(image, chunks):
    """Return a PNG.

    Every byte is stored as its difference from the byte above. The compressor only looks for runs:
    frames with noise hold nothing else, and it takes 40 % of the time of level 1. Source: PNG, third
    edition (W3C 2025), 9.2, filter type 2.
    """
    rows, cols, channels = (*image.shape, 1)[:3]
    bits = 8 * image.itemsize
    lines = image.astype(f">u{image.itemsize}", copy=False).view(np.uint8).reshape(rows, -1)
    filtered = np.empty((rows, 1 + lines.shape[1]), np.uint8)
    filtered[:, 0] = 2
    filtered[0, 1:] = lines[0]
    np.subtract(lines[1:], lines[:-1], out=filtered[1:, 1:])
    if b"iCCP" in chunks:
        chunks |= {b"iCCP": b"ICC profile\0\0" + zlib.compress(chunks[b"iCCP"])}
    header = Header(cols, rows, bits, 2 if channels == 3 else 0, interlaced=False)
    packer = zlib.compressobj(1, memLevel=9, strategy=zlib.Z_RLE)
    return png(header, packer.compress(filtered) + packer.flush(), chunks)


def _chunks(display, has_color):
    """Return the chunks that define the codes, iCCP not yet compressed.

    Source: PNG, third edition (W3C 2025), 11.3.2.
    """
    exponent = 2.2 if display.curve == "srgb" else display.curve
    places = [round(1e5 * x) for x in np.ravel((display.white, *display.primaries))]
    chunks = {
        b"gAMA": struct.pack(">I", round(1e5 / exponent)),
        b"cHRM": struct.pack(">8I", *places),
    }
    if display.encodes_like(DISPLAYS["srgb"]):
        return chunks | {b"sRGB": b"\1"}  # relative colorimetric
    if display.encodes_like(DISPLAYS["display-p3"]):
        # code points of ITU-T H.273: P3 primaries, sRGB curve, RGB, full range
        chunks[b"cICP"] = bytes([12, 13, 0, 1])
    # a profile of three colours does not apply to grey
    return chunks | ({b"iCCP": icc_profile(display)} if has_color else {})


def write_jpeg(path, codes, display=DISPLAYS["srgb"], quality: int = 95):
    """Write a JPEG, uint8 (rows, cols, 3), with the profile of the display that its codes are for.

    Colour is not subsampled. quality: of libjpeg, 1 .. 100. Raises BadData and BadFile.
    """
    _write_by_pillow(path, codes, display, "JPEG", LONGEST_JPEG, quality=quality, subsampling=0)


def write_webp(path, codes, display=DISPLAYS["srgb"], quality: int = 95):
    """Write a WebP, uint8 (rows, cols, 3), with the profile of the display that its codes are for.

    A WebP with loss has one value of colour for 2 x 2 pixels. quality: of libwebp, 1 .. 99, or LOSSLESS. Raises
    BadData and BadFile.
    """
    options = {"quality": quality, "lossless": quality == LOSSLESS}
    _write_by_pillow(path, codes, display, "WebP", LONGEST_WEBP, **options)


def _write_by_pillow(path, codes, display, kind, longest, **options):
    """Write a picture by Pillow. longest: pixels along an axis. options: of the encoder. Raises BadData, BadFile."""
    from PIL import Image

    codes = np.ascontiguousarray(codes)
    is_shaped = codes.ndim == 3 and codes.shape[2] == 3 and 0 < codes.size
    if codes.dtype != np.uint8 or not is_shaped or max(codes.shape) > longest:
        raise BadData(
            f"{path}: a {kind} needs uint8 of shape (rows, cols, 3), up to {longest} pixels along "
            f"an axis, got {codes.dtype} {codes.shape}"
        )
    file = io.BytesIO()
    Image.fromarray(codes).save(file, format=kind, icc_profile=icc_profile(display), **options)
    with atomic_path(path) as temporary:
        temporary.write_bytes(file.getvalue())


def write_tiff(path, image, display=DISPLAYS["srgb"]):
    """Write one uncompressed RGB picture, shape (rows, cols, 3).

    image: codes of the display, uint8 or uint16, or linear display RGB, white 1, float32. Raises
    BadData and BadFile.
    """
    import tifffile

    image = np.asarray(image)
    if image.dtype not in TIFF_KINDS or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise BadData(
            f"{path}: a TIFF needs uint8, uint16 or float32 of shape (rows, cols, 3), got "
            f"{image.dtype} {image.shape}"
        )
    if not np.isfinite(image).all():
        raise BadData(f"{path}: NaN or infinite values")
    with atomic_path(path) as temporary:
        tifffile.imwrite(
            temporary,
            image,
            photometric="rgb",
            metadata=None,
            software="gpusim",
            iccprofile=icc_profile(display, linear=image.dtype == np.float32),
        )
