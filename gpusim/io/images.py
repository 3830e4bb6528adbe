"""8-bit pictures for display."""

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.io.atomic import atomic_path


def write_png(path, image):
    """Write a PNG of 8 bits.

    image: uint8, shape (rows, cols, 3) sRGB, or (rows, cols) grey. Raises BadData and BadFile.
    """
    from PIL import Image

    image = np.asarray(image)
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)) or image.size == 0:
        raise BadData(f"{path}: a PNG needs uint8 of shape (rows, cols, 3) or (rows, cols), "
                      f"got {image.dtype} {image.shape}")
    with atomic_path(path) as temporary:  # level 6 takes six times as long for noise that does not compress
        Image.fromarray(np.ascontiguousarray(image)).save(temporary, format="PNG", compress_level=1)
