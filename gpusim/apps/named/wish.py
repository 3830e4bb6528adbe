"""A user's wishes for a camera that is composed, with checks."""

import math
import os
from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, Conflict, OutOfRange, checked_count, format_value

LIMITS = {
    "iso": (1, 1e8),
    "focal_length": (1e-4, 10),
    "f_number": (0.1, 1000),
    "full_well": (10, 1e9),
}


@dataclass(frozen=True)
class Wish:
    """A user's wishes for a camera; None for no wish.

    Attributes have the meanings of `compose_camera`'s arguments.
    """

    iso: float | None = None
    lens: str | None = None
    focal_length: float | None = None
    f_number: float | None = None
    distance: float = math.inf
    columns: int | None = None
    channel: str = "G"
    full_well: float | None = None
    profile: str | os.PathLike | None = None
    sensitivity: str | os.PathLike | None = None


def check_wish(name: str, wish: Wish) -> None:
    """Raise BadData, OutOfRange or Conflict for arguments of a wrong kind. name: of the camera."""
    for key, value in (("camera", name), ("lens", wish.lens)):
        if not isinstance(value, str) and (key == "camera" or value is not None):
            raise BadData(f"{key}: {format_value(value)}; wanted words of its name")
    for key, (least, most) in LIMITS.items():
        value = getattr(wish, key)
        if value is not None and not _is_within(value, least, most):
            raise OutOfRange(key, format_value(value), f"a number, {least:g} .. {most:g}")
    if not _is_within(wish.distance, 0.01, math.inf):
        raise OutOfRange("distance", format_value(wish.distance), "0.01 m or more, or inf")
    if wish.columns is not None:
        checked_count("columns", wish.columns, 16, 100000)
    if wish.profile is not None and wish.sensitivity is not None:
        raise Conflict("profile", "sensitivity gives the colours too", "give one of them")


def _is_within(value, least, most):
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return is_number and least <= value <= most
