"""A camera file composed from the installed data bases: body, noise, colour and lens."""

import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusim.apps.named.colour_keys import Colour
from gpusim.apps.named.keys import GUESS, Key, Sheet
from gpusim.apps.named.lens_keys import FrameSize, Use, add_lens
from gpusim.apps.named.sensor_keys import add_sensor
from gpusim.apps.named.wish import Wish, check_wish
from gpusim.domain.camera import Camera
from gpusim.domain.errors import OutOfRange
from gpusim.domain.short_repr import short_repr
from gpusim.io.atomic import atomic_path
from gpusim.io.camera.cameras import camera_of
from gpusim.io.databases.catalogue import CameraEntry, Catalogue, open_catalogue
from gpusim.io.databases.lensfun import FULL_DIAGONAL, Lens
from gpusim.io.databases.libcamera import SENSORS

COARSE = 0.7  # share of the sensor's columns below which pixels get the light of the sensor's own
COLUMNS, SMALL_COLUMNS, SMALL_CROP = (
    6000,
    4000,
    3.0,
)  # 24 and 12 Mpixel; crop factor of small sensors


@dataclass(frozen=True)
class ComposedCamera:
    """A camera composed from data bases.

    Attributes:
        camera: The camera.
        keys: The values of its file, with their sources.
        notes: For the reader.
        text: The camera file (TOML) with a comment above every value.
        size: Columns and rows of the whole frame [pixel].
    """

    camera: Camera
    keys: tuple[Key, ...]
    notes: tuple[str, ...]
    text: str
    size: tuple[int, int]

    __repr__ = short_repr

    def save(self, path: str | os.PathLike) -> None:
        """Write the camera file.

        Args:
            path: File, .toml.

        Raises:
            BadFile: The file cannot be written.
        """
        with atomic_path(path) as temporary:
            temporary.write_text(self.text, encoding="utf-8")


def compose_camera(
    name: str,
    *,
    iso: float | None = None,
    lens: str | None = None,
    focal_length: float | None = None,
    f_number: float | None = None,
    distance: float = math.inf,
    columns: int | None = None,
    channel: str = "G",
    full_well: float | None = None,
    profile: str | os.PathLike | None = None,
    sensitivity: str | os.PathLike | None = None,
    databases: str | os.PathLike | Sequence | None = None,
) -> ComposedCamera:
    """Compose a real camera from the data bases that are installed.

    Values that no data base has are guessed; the camera file says for each value where it comes from.

    Args:
        name: Words of the camera's name, such as "Nikon D750".
        iso: ISO speed; None: the lowest of the noise data.
        lens: Words of the lens's name, such as "50mm f/1.8"; None: a built-in lens, otherwise an
            ideal one.
        focal_length: [m]; None: the lens's shortest.
        f_number: None: the lens's smallest.
        distance: Of the plane in focus [m].
        columns: Pixels along the long side of the whole sensor; None: the data base's, or a guess.
            Far fewer make a coarse frame, whose pixels get as much light as the sensor's own.
        channel: "R", "G" or "B", whose noise of darktable's data base the pixels get.
        full_well: Electrons at white at the lowest ISO [e-]; None: as the noise data have it.
        profile: A DNG camera profile (.dcp, .dng) of the colours in place of the data base's.
        sensitivity: A .csv file of measured sensitivities in place of a fit to matrices.
        databases: A folder with data bases, or several; searched before the usual places.

    Returns:
        The camera and its file.

    Raises:
        BadData: There is no such camera or lens, or there are several (near names are given), or an
            argument has the wrong type.
        BadFile: A data base is damaged, or a file cannot be used.
        Conflict: Two arguments exclude each other.
        OutOfRange: A number is out of its range.
        UnknownName: There is no such channel.
    """
    wish = Wish(
        iso,
        lens,
        focal_length,
        f_number,
        distance,
        columns,
        channel,
        full_well,
        profile,
        sensitivity,
    )
    check_wish(name, wish)
    return compose(open_catalogue(databases), name, wish)


def compose(catalogue: Catalogue, name: str, wish: Wish) -> ComposedCamera:
    """Compose a camera from an open catalogue. See `compose_camera`."""
    check_wish(name, wish)
    entry = catalogue.camera(name)
    sheet = Sheet(entry.name)
    frame = _frame(sheet, entry, wish, catalogue)
    lens = _choose_lens(sheet, catalogue, entry, wish)
    colour = Colour(sheet, entry, wish, catalogue)
    _add_lens(sheet, lens, wish, frame, catalogue, colour.curves)
    add_sensor(sheet, entry, wish, frame, catalogue)
    colour.add()
    sheet.notes.append(
        f"The whole frame has {frame.columns} x {frame.rows} pixels (--size {frame.columns}x{frame.rows}): vignetting "
        "is of the whole frame."
    )
    sheet.notes.append(
        "Not known, and left out: PRNU, DSNU, row and column noise, dark current, defects, aberrations (the lens is "
        "diffraction-limited), low-pass filter, and the microlenses."
    )
    text = sheet.text()
    table = tomllib.loads(text)
    del table["base"]
    camera = camera_of(Path(f"{entry.name}.toml"), table)
    return ComposedCamera(
        camera, tuple(sheet.keys), tuple(sheet.notes), text, (frame.columns, frame.rows)
    )


def _frame(sheet, entry: CameraEntry, wish, catalogue) -> FrameSize:
    """Return the sensor's pixels, and add the pitch."""
    body, tuning = entry.body, entry.tuning
    if tuning is not None and tuning.name.split("_")[0] in SENSORS:
        own, own_rows, pitch, _ = SENSORS[tuning.name.split("_")[0]]
        of, width = f"the data sheet of {tuning.name}", own * pitch * 1e-3
        crop, ratio = FULL_DIAGONAL / (math.hypot(own, own_rows) * pitch * 1e-3), own / own_rows
    else:
        crop = body.crop if body else 1.5
        ratio, is_known = _aspect(entry, crop, catalogue.built_in(entry))
        width = FULL_DIAGONAL / crop / math.hypot(1, 1 / ratio)
        of = (
            f"crop factor {crop:g} ({catalogue.places['lensfun'].label}, {body.file}: {body.maker} {body.model})"
            if body
            else f"{GUESS}crop factor {crop:g}"
        )
        of += f", {ratio:.3g} : 1{'' if is_known else ' (guess)'}: width {width:.4g} mm"
        size = entry.constants.size if entry.constants else None
        own = SMALL_COLUMNS if crop > SMALL_CROP else COLUMNS
        own_rows = max(1, round(own / ratio))
        if size is not None and abs(size[0] / size[1] / ratio - 1) < 0.03:
            own, own_rows = size
            of += f" over {own} columns ({catalogue.places['camconst'].label})"
        elif wish.columns is None:
            of = f"{GUESS}{own} columns; {of.removeprefix(GUESS)}"
    columns, rows = own, own_rows
    if wish.columns is not None:
        columns, rows = wish.columns, max(1, round(own_rows * wish.columns / own))
        of += f"; {columns} columns (given)"
    pitch = width / columns * 1e-3
    sheet.add("sensor", of, pixel_pitch_um=pitch * 1e6)
    if columns > COARSE * own:
        return FrameSize(columns, rows, pitch, crop, pitch)
    own_pitch = width / own * 1e-3
    source = f"fewer columns than the sensor's {own}: a pixel gets the light of one of {own_pitch * 1e6:.3g} um"
    sheet.add("optics", source, transmission=(own_pitch / pitch) ** 2)
    return FrameSize(columns, rows, pitch, crop, own_pitch)


def _aspect(entry, crop, lens) -> tuple[float, bool]:
    """Return long side over short side, and whether body, lens or mount say so."""
    body = entry.body
    if body is not None and body.aspect:
        return body.aspect, True
    if lens is not None and lens.aspect != 1.5:
        return lens.aspect, True
    if body is not None and "4/3" in body.mount:
        return 4 / 3, True
    return (4 / 3 if crop > SMALL_CROP else 1.5), False


def _choose_lens(sheet, catalogue, entry, wish) -> Lens | None:
    """Return the lens that is asked for, or the built-in one; None for an ideal lens."""
    if wish.lens is not None:
        lens, others = catalogue.lens(wish.lens, entry)
        names = list(dict.fromkeys(one.name for one in others if one.name != lens.name))
        if names:
            more = f" and {len(names) - 4} more" if len(names) > 4 else ""
            sheet.notes.append(
                f"{lens.name} is the first of {len(names) + 1} lenses with these words; others: "
                f"{', '.join(names[:4])}{more}."
            )
        return lens
    return catalogue.built_in(entry)


def _add_lens(sheet, lens, wish, frame, catalogue, curves):
    """Add the keys of [optics]."""
    if lens is None:
        focal = (wish.focal_length or 50e-3 / frame.crop) * 1e3
        f_number = wish.f_number or 2.8
        sheet.add(
            "optics",
            f"{'given' if wish.f_number else GUESS + 'no lens is named'}",
            f_number=f_number,
        )
        given = (
            "given"
            if wish.focal_length
            else GUESS + "no lens is named: the view of 50 mm on 36 x 24 mm"
        )
        sheet.add("optics", given, focal_length_mm=focal)
        _add_distance(sheet, wish)
        sheet.notes.append("The lens is ideal: no distortion, no lateral colour, cos^4 vignetting.")
        return
    use = _use(lens, wish)
    label = catalogue.places["lensfun"].label
    own = f"{label}, {lens.file}: {lens.name}"
    source = "given" if wish.f_number else f"{own}: its smallest"
    if not wish.f_number and not _aperture(lens, use.focal)[1]:
        source = f"{GUESS}lensfun does not know the f-number of {lens.name}"
    sheet.add("optics", source, f_number=use.f_number)
    source = "given" if wish.focal_length else f"{own}: its shortest, nominal"
    sheet.add("optics", source, focal_length_mm=use.focal)
    _add_distance(sheet, wish)
    add_lens(sheet, lens, use, frame, label, curves)


def _add_distance(sheet, wish):
    if math.isfinite(wish.distance):
        sheet.add("optics", "given", object_distance_m=float(wish.distance))


def _use(lens, wish) -> Use:
    """Return focal length, f-number and distance. Raises OutOfRange."""
    low, high = lens.focal
    focal = wish.focal_length * 1e3 if wish.focal_length else low or 50.0
    if low and not low * 0.99 <= focal <= high * 1.01:
        allowed = f"{low:g} .. {high:g} mm, those of {lens.name}"
        raise OutOfRange("focal length", f"{focal:g} mm", allowed)
    return Use(focal, wish.f_number or _aperture(lens, focal)[0], wish.distance)


def _aperture(lens, focal) -> tuple[float, bool]:
    """Return the smallest f-number, and whether calibrations, the entry or the name say it."""
    near = [one.aperture for one in lens.vignetting if abs(one.focal - focal) < 0.1 * focal]
    if near and lens.focal[0] != lens.focal[1]:
        return min(near), True
    if lens.aperture[0]:
        return lens.aperture[0], True
    named = re.search(r"(?:f/?|1:)\s?(\d+(?:\.\d+)?)", lens.model, re.I)
    if named and 0.5 <= float(named[1]) <= 32:
        return float(named[1]), True
    return (min(near), True) if near else (4.0, False)
