"""Masks for the pupil from pictures and arrays."""

from os import PathLike
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.mask import MOST_CELLS, Mask
from gpusim.io.archive import NUMBERS, open_archive
from gpusim.io.files import name_in_errors, open_file, reading

KEY = "mask"  # of an archive
COPIES = 2.0  # of the numbers, as complex ones


def read_mask(path: str | PathLike) -> Mask:
    """Read a mask.

    Args:
        path: A picture, whose grey values over the largest possible one are the shares of light that pass; or a NumPy
            file, .npy, or .npz with the key "mask": amplitudes, real or complex, shape (rows, cols).

    Returns:
        The mask.

    Raises:
        BadFile: The file cannot be used, naming file and problem.
    """
    path = Path(path)
    with name_in_errors(path):
        if path.suffix.lower() == ".npz":
            with open_archive(path) as archive:
                archive.require((KEY,))
                archive.shape(KEY, NUMBERS + "c", wanted=(None, None))
                archive.require_memory(COPIES)
                return Mask(archive[KEY])
        if path.suffix.lower() == ".npy":
            with open_file(path) as file, reading(path, "a NumPy array"):
                values = np.lib.format.read_array(file, allow_pickle=False)
            return Mask(values)
        return mask_of_light(_grey_values(path))


def mask_of_light(shares) -> Mask:
    """Return the mask through whose cells these shares of light pass, shape (rows, cols).

    Raises BadData, or OutOfRange for shares outside 0 .. 1.
    """
    try:
        light = np.array(shares, np.float64)
    except (TypeError, ValueError):
        raise BadData("optics.mask: wanted rows of numbers, equally long") from None
    if light.size and not (light.min() >= 0 and light.max() <= 1):
        span = f"{light.min():.6g} .. {light.max():.6g}"
        raise OutOfRange("optics.mask", span, "shares of light, 0 .. 1")
    return Mask(np.sqrt(light))


def _grey_values(path):
    """Grey values of a picture over the largest possible one, (rows, cols)."""
    from PIL import Image

    with open_file(path) as file, reading(path, "a picture"), Image.open(file) as picture:
        if max(picture.size) > MOST_CELLS:
            size = "{} x {}".format(*picture.size)
            raise BadFile(path, f"{size} pixels; wanted up to {MOST_CELLS} along a side")
        if picture.mode.startswith("I"):
            return np.asarray(picture, np.float64) / 65535
        return np.asarray(picture.convert("L"), np.float64) / 255
