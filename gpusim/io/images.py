"""8-bit pictures for display."""

import io
import struct

import numpy as np

from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.io.atomic import atomic_path


def write_png(path, image, display=DISPLAYS["srgb"]):
    """Write a PNG of 8 bits, tagged with the display that its codes are for; untagged it is taken as sRGB.

    image: uint8, shape (rows, cols, 3), or (rows, cols) grey. Raises BadData and BadFile.
    """
    data = png_bytes(image, display, path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def png_bytes(image, display=DISPLAYS["srgb"], name="picture") -> bytes:
    """The same as bytes; name: what an error says. Raises BadData."""
    from PIL import Image

    image, file = np.asarray(image), io.BytesIO()
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)) or image.size == 0:
        raise BadData(f"{name}: a PNG needs uint8 of shape (rows, cols, 3) or (rows, cols), "
                      f"got {image.dtype} {image.shape}")
    # level 6 takes six times as long for noise that does not compress
    Image.fromarray(np.ascontiguousarray(image)).save(file, format="PNG", compress_level=1, pnginfo=_tags(display))
    return file.getvalue()


def _tags(display):
    """The chunks that say what the codes mean: PNG, third edition (W3C 2025), 11.3.2."""
    from PIL.PngImagePlugin import PngInfo

    tags = PngInfo()
    if display.encodes_like(DISPLAYS["srgb"]):
        return tags
    if display.encodes_like(DISPLAYS["display-p3"]):
        # code points of ITU-T H.273: P3 primaries, sRGB curve, RGB, full range
        tags.add(b"cICP", bytes([12, 13, 0, 1]))
    exponent = 2.2 if display.curve == "srgb" else display.curve
    tags.add(b"gAMA", struct.pack(">I", round(1e5 / exponent)))
    tags.add(b"cHRM", struct.pack(">8I", *(round(1e5 * x) for x in np.ravel((display.white, *display.primaries)))))
    return tags
