"""Readable tables of cameras, lenses, data bases and composed files."""

from collections.abc import Sequence

from gpusim.apps.named.compose import ComposedCamera
from gpusim.apps.named.keys import toml
from gpusim.domain.errors import one_line
from gpusim.io.databases.catalogue import CameraEntry, Catalogue
from gpusim.io.databases.lensfun import Lens
from gpusim.io.databases.places import KINDS, VARIABLE

MOST = 40  # lines of a table
LONGEST = 40  # letters of a value in a table
COUNTS = {
    "lensfun": lambda one: one.body,
    "darktable": lambda one: one.noise,
    "camconst": lambda one: one.constants,
    "dcp": lambda one: one.profile,
    "libcamera": lambda one: one.tuning,
}


def align(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def database_lines(catalogue: Catalogue) -> list[str]:
    """Return the data bases that are found, and how to get the others."""
    rows = [("data base", "cameras", "where")]
    for kind, (_, way) in KINDS.items():
        place = catalogue.places.get(kind)
        count = sum(bool(COUNTS[kind](one)) for one in catalogue.cameras)
        more = f", {len(catalogue.lenses)} lenses" if kind == "lensfun" and place else ""
        rows.append(
            (
                kind,
                f"{count}{more}" if place else "-",
                place.label if place else f"not found; {way}",
            )
        )
    return [*align(rows), f"Folders of --databases and of {VARIABLE} are searched first."]


def camera_lines(cameras: Sequence[CameraEntry]) -> list[str]:
    """Return a table of cameras and of the data on each."""
    rows = [("camera", "crop", "noise: ISO", "levels", "colour", "mount")]
    for one in cameras[:MOST]:
        rows.append(
            (
                one.name,
                f"{one.body.crop:g}" if one.body else "-",
                _speeds(one),
                "yes" if one.tuning or (one.constants and one.constants.white) else "-",
                _colour(one),
                one.body.mount if one.body else "-",
            )
        )
    more = [f"... and {len(cameras) - MOST} more"] if len(cameras) > MOST else []
    return align(rows) + more


def _speeds(camera):
    if camera.noise and camera.noise.settings:
        own = camera.noise.settings
        return f"{own[0].iso:g} .. {own[-1].iso:g} ({len(own)})"
    return "gain" if camera.tuning and camera.tuning.noise else "-"


def _colour(camera):
    if camera.profile:
        return "profile"
    if camera.tuning and camera.tuning.matrices:
        return f"{len(camera.tuning.matrices)} lights"
    has_matrix = camera.constants is not None and camera.constants.matrix is not None
    return "matrix" if has_matrix else "-"


def lens_lines(lenses: Sequence[Lens]) -> list[str]:
    """Return a table of lenses: focal lengths [mm] and numbers of calibrations."""
    rows = [("lens", "mm", "distortion", "lateral colour", "vignetting", "crop")]
    for one in lenses[:MOST]:
        low, high = one.focal
        rows.append(
            (
                one.name,
                f"{low:g}" if low == high else f"{low:g} .. {high:g}",
                _count(one.distortion),
                _count(one.lateral),
                _count(one.vignetting),
                f"{one.crop:g}",
            )
        )
    more = [f"... and {len(lenses) - MOST} more"] if len(lenses) > MOST else []
    return align(rows) + more


def _count(calibrations):
    return f"{len(calibrations)} {calibrations[0].model}" if calibrations else "-"


def composed_lines(found: ComposedCamera) -> list[str]:
    """Return a table of a composed camera's values and sources, and its notes."""
    rows = [("key", "value", "source")]
    for key in found.keys:
        value = one_line(toml(key.value), LONGEST)
        rows.append((f"{key.section}.{key.name}", value, key.source))
    return [*align(rows), "", *found.notes]
