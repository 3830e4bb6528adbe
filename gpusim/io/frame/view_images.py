"""Views through the cells of a pupil as NumPy archives.

values                        (T, S, rows, cols, C) float32, linear pictures
slope_px_per_radius_diopter   displacement of things by distance
object_distance_m, focal_length_m, f_number, extent_radii, name   as in ViewImages
light                         (T, S), only if the pupil cuts cells
"""

import os
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, BadFile
from gpusim.domain.view_images import ViewImages
from gpusim.io.archive import NUMBERS, TEXT, open_archive, write_archive
from gpusim.io.files import name_in_errors

FIELDS = {  # field -> key
    "slope_per_diopter": "slope_px_per_radius_diopter",
    "object_distance": "object_distance_m",
    "focal_length": "focal_length_m",
    "f_number": "f_number",
    "extent": "extent_radii",
}
COPIES = 0.5  # of the numbers in float64


def save_views(views: ViewImages, path: str | os.PathLike) -> None:
    """Write views to an .npz for `open_views`.

    Args:
        views: The views.
        path: The file, .npz.

    Raises:
        BadData: `views` is no ViewImages.
        BadFile: The file cannot be written.
    """
    if not isinstance(views, ViewImages):
        raise BadData(f"views: {type(views).__name__}, wanted ViewImages")
    arrays = {key: getattr(views, field) for field, key in FIELDS.items()}
    if views.light is not None:
        arrays["light"] = views.light
    write_archive(path, {"values": views.values, "name": views.name} | arrays)


def open_views(path: str | os.PathLike) -> ViewImages:
    """Open views that `save_views` has written.

    Args:
        path: The file, .npz.

    Returns:
        The views.

    Raises:
        BadFile: The file is missing or damaged.
        DoesNotFit: The views do not fit into memory.
    """
    with open_archive(path) as stored, name_in_errors(path):
        stored.require(("values", *FIELDS.values()))
        stored.shape("values", wanted=(None, None, None, None, None))
        stored.require_memory(COPIES)
        numbers: dict[str, Any] = {}
        for field, key in FIELDS.items():
            stored.shape(key, wanted=())
            numbers[field] = float(stored[key])
        if "light" in stored:
            stored.shape("light", NUMBERS, wanted=(None, None))
            numbers["light"] = stored["light"]
        name = os.path.basename(path)
        if "name" in stored:
            stored.shape("name", TEXT, wanted=())
            name = str(stored["name"])
        values = stored["values"]
        largest = float(np.abs(values).max()) if values.size else 0.0
        if not largest <= float(np.finfo(np.float32).max):
            raise BadFile(path, "values: NaN, infinite, or more than float32 holds")
        return ViewImages(values.astype(np.float32), **numbers, name=name)
