"""A camera file composed of what the installed data bases have on a body, its noise, colour and lens."""

import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.apps.named.keys import GUESS, Key, Sheet
from gpusim.apps.named.lens_keys import FrameSize, Use, add_lens
from gpusim.apps.named.response import (
    NODES,
    PEAK,
    Matrix,
    fit_response,
    typical_response,
)
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, Conflict, OutOfRange, checked_count, format_value
from gpusim.domain.short_repr import short_repr
from gpusim.io.atomic import atomic_path
from gpusim.io.camera.cameras import camera_of
from gpusim.io.camera.noise_profile import NoiseProfile
from gpusim.io.databases.catalogue import CameraEntry, Catalogue, open_catalogue
from gpusim.io.databases.dcp import read_profile
from gpusim.io.databases.lensfun import FULL_DIAGONAL, Lens
from gpusim.io.databases.libcamera import SENSORS

DENSITY = 2300.0  # [e- um-2] full well of a usual pixel; data sheets have 1500 .. 3500
CROWDED = 2.0  # times DENSITY from which a note says that the slope is not a pixel's
COLUMNS, SMALL_COLUMNS, SMALL_CROP = 6000, 4000, 3.0  # 24 and 12 Mpixel; crop factor of small sensors
BITS = 14
CLEARANCE = 6.0  # standard deviations of the noise at black that a guessed black level leaves
READ = 3.0  # [e-] of a camera whose noise is not known
DAYLIGHT = 6500.0  # [K]
_X_TRANS = re.compile(r"x-?(pro|e|h|s|m|t(?!100|200))\d|x-pro|x100(s|t|f|v)|x[237]0\b|xq\d", re.I)
_MONO = re.compile(r"monochrom|\bmono\b", re.I)


@dataclass(frozen=True)
class ComposedCamera:
    """A camera composed from data bases.

    Attributes:
        camera: The camera.
        keys: The values of its file, with their sources.
        notes: What the reader should know.
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


@dataclass(frozen=True)
class Wish:
    """What a user says about a camera; None is not said.

    Attributes are those of `compose_camera`.
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
        channel: "R", "G" or "B", whose noise of darktable's data base the pixels get.
        full_well: Electrons at white at the lowest ISO [e-]; None: those of the noise data.
        profile: A DNG camera profile (.dcp, .dng) of the colours in place of the data base's.
        sensitivity: A .csv file of measured sensitivities in place of a fit to matrices.
        databases: A folder with data bases, or several; searched before the usual places.

    Returns:
        The camera and its file.

    Raises:
        BadData: There is no such camera or lens (near names are given), or an argument has the wrong
            type.
        BadFile: A data base is damaged, or a file cannot be used.
        Conflict: Two arguments exclude each other.
        OutOfRange: A number is out of its range.
        UnknownName: Several cameras have these words, or there is no such channel.
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
    _check(name, wish)
    return compose(open_catalogue(databases), name, wish)


def compose(catalogue: Catalogue, name: str, wish: Wish) -> ComposedCamera:
    """Compose a camera from an open catalogue. See `compose_camera`."""
    _check(name, wish)
    entry = catalogue.camera(name)
    sheet = Sheet(entry.name)
    frame = _frame(sheet, entry, wish, catalogue)
    lens = _choose_lens(sheet, catalogue, entry, wish)
    qe = _Colour(sheet, entry, wish, catalogue)
    _add_lens(sheet, lens, wish, frame, catalogue, qe.curves)
    _add_sensor(sheet, entry, wish, frame, catalogue)
    qe.add()
    sheet.notes.append(
        f"The whole frame has {frame.columns} x {frame.rows} pixels (--size {frame.columns}x{frame.rows}): vignetting is "
        "of the whole frame."
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


def _check(name, wish):
    """Raise BadData, OutOfRange or Conflict for arguments of a wrong kind."""
    for key, value in (("camera", name), ("lens", wish.lens)):
        if not isinstance(value, str) and (key == "camera" or value is not None):
            raise BadData(f"{key}: {format_value(value)}; wanted words of its name")
    limits = {
        "iso": (1, 1e8),
        "focal_length": (1e-4, 10),
        "f_number": (0.1, 1000),
        "full_well": (10, 1e9),
    }
    for key, (least, most) in limits.items():
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


def _frame(sheet, entry: CameraEntry, wish, catalogue) -> FrameSize:
    """Return the sensor's pixels, and add the pitch."""
    body, tuning = entry.body, entry.tuning
    if tuning is not None and tuning.name.split("_")[0] in SENSORS:
        columns, rows, pitch, _ = SENSORS[tuning.name.split("_")[0]]
        if wish.columns not in (None, columns):
            pitch, rows = pitch * columns / wish.columns, round(rows * wish.columns / columns)
            columns = wish.columns
        sheet.add("sensor", f"the data sheet of {tuning.name}", pixel_pitch_um=pitch)
        crop = FULL_DIAGONAL / (math.hypot(columns, rows) * pitch * 1e-3)
        return FrameSize(columns, rows, pitch * 1e-6, crop)
    crop, aspect = (body.crop, body.aspect) if body else (1.5, 1.5)
    size = entry.constants.size if entry.constants else None
    if wish.columns is not None:
        columns, rows = wish.columns, max(1, round(wish.columns / aspect))
        of = f"{columns} columns (given)"
    elif size is not None and abs(size[0] / size[1] / aspect - 1) < 0.03:
        (columns, rows), of = size, f"{size[0]} columns ({catalogue.places['camconst'].label})"
    else:
        columns = SMALL_COLUMNS if crop > SMALL_CROP else COLUMNS
        rows, of = max(1, round(columns / aspect)), f"{columns} columns, a guess"
    width = FULL_DIAGONAL / crop / math.hypot(1, 1 / aspect)
    pitch = width / columns * 1e-3
    where = (
        f"crop factor {crop:g} ({catalogue.places['lensfun'].label}, {body.file}: {body.maker} {body.model})"
        if body
        else f"crop factor {crop:g}, a guess"
    )
    is_guess = body is None or "guess" in of
    start = GUESS if is_guess else ""
    sheet.add("sensor", f"{start}{where}, width {width:.4g} mm over {of}", pixel_pitch_um=pitch * 1e6)
    return FrameSize(columns, rows, pitch, crop)


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
    body = entry.body
    if body is not None and body.mount[:1].islower():  # lensfun's mark of a lens that stays on
        own = [one for one in catalogue.lenses if body.mount in one.mounts]
        return min(own, key=lambda one: len(one.model), default=None)
    return None


def _add_lens(sheet, lens, wish, frame, catalogue, curves):
    """Add the keys of [optics]."""
    if lens is None:
        focal = (wish.focal_length or 50e-3 / frame.crop) * 1e3
        f_number = wish.f_number or 2.8
        sheet.add("optics", f"{'given' if wish.f_number else GUESS + 'no lens is named'}", f_number=f_number)
        given = "given" if wish.focal_length else GUESS + "no lens is named: the view of 50 mm on 36 x 24 mm"
        sheet.add("optics", given, focal_length_mm=focal)
        _add_distance(sheet, wish)
        sheet.notes.append("The lens is ideal: no distortion, no lateral colour, cos^4 vignetting.")
        return
    use = _use(lens, wish)
    label = catalogue.places["lensfun"].label
    own = f"{label}, {lens.file}: {lens.name}"
    source = "given" if wish.f_number else f"{own}: its smallest, {_known_aperture(lens)}"
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
    """Return the smallest f-number, and whether it is known: the entry's, the name's, a calibration's."""
    if lens.aperture[0]:
        return lens.aperture[0], True
    named = re.search(r"(?:f/?|1:)\s?(\d+(?:\.\d+)?)", lens.model, re.I)
    if named and 0.5 <= float(named[1]) <= 32:
        return float(named[1]), True
    near = [one.aperture for one in lens.vignetting if abs(one.focal - focal) < 0.1 * focal]
    return (min(near), True) if near else (4.0, False)


def _known_aperture(lens):
    if lens.aperture[0]:
        return "of the entry"
    return "of its name or calibrations"


def _add_sensor(sheet, entry, wish, frame, catalogue):
    """Add levels, gain, full well and read noise."""
    a, b, of, base = _noise(sheet, entry, wish, frame, catalogue)
    bits, white, black, of_levels = _levels(entry, wish, b, catalogue)
    profile = NoiseProfile(a, b, black, white)
    fields = profile.fields
    sheet.add("sensor", of_levels, bits=bits, black_level_dn=black)
    start = GUESS if of.startswith(GUESS) else ""
    words = of.removeprefix(GUESS)
    sheet.add(
        "sensor",
        f"{start}1 / a electrons at white, a = {a:.5g} of {words}",
        full_well_e=fields["full_well"],
    )
    sheet.add("sensor", f"{start}a times the {white - black:g} DN from black to white", gain_dn_per_e=profile.gain)
    if b <= 0:
        source = f"b = {b:.4g} <= 0, less than no noise: read noise 0, {words}"
    elif profile.read == 0:
        source = f"b = {b:.4g} is below the rounding of the converter: read noise 0, {words}"
    else:
        source = f"sqrt(b - rounding) / a, b = {b:.5g} of {words}"
    sheet.add("noise", start + source, read_e=profile.read)
    density = 1 / base / (frame.pitch * 1e6) ** 2
    if density > CROWDED * DENSITY and wish.full_well is None:
        usual = DENSITY * (frame.pitch * 1e6) ** 2
        sheet.notes.append(
            f"Noise: white is {1 / base:.3g} electrons at the lowest ISO, {density:.3g} a square micrometre, where pixels "
            f"have 1500 .. 3500. The data base's slope is of data that were smoothed before, not of one pixel: give "
            f"full_well, such as {usual:.2g} (--full-well), to scale all its noise."
        )


def _noise(sheet, entry, wish, frame, catalogue):
    """Return a and b, their source, and a of the lowest ISO."""
    iso = wish.iso
    if entry.noise is not None:
        own = entry.noise.usable(wish.channel)
        at = "RGB".index(wish.channel)
        iso = own[0].iso if iso is None else float(iso)
        a, b, is_entry = entry.noise.at(iso, wish.channel)
        base = min(one.a[at] for one in own)
        of = f"{catalogue.places['darktable'].label}: {entry.noise.maker} {entry.noise.model}, ISO {iso:g}, "
        of += f"channel {wish.channel}" + ("" if is_entry else ", interpolated")
        if iso == own[0].iso and wish.iso is None:
            of += " (the lowest)"
    elif entry.tuning is not None and entry.tuning.noise is not None:
        base, b = entry.tuning.slopes()
        iso = 100.0 if iso is None else float(iso)
        if iso < 100:
            raise OutOfRange("iso", f"{iso:g}", "100 or more: 100 is gain 1 of the tuning file")
        a, b = base * iso / 100, b * (iso / 100) ** 2
        of = f"{catalogue.places['libcamera'].label}: {entry.tuning.name}, rpi.noise at gain {iso / 100:g}"
        sheet.notes.append("Read noise: libcamera's noise has only a slope (its constant is 0).")
    else:
        base = 1 / (DENSITY * (frame.pitch * 1e6) ** 2)
        iso = 100.0 if iso is None else float(iso)
        a, b = base * iso / 100, (READ * base) ** 2 * iso / 100
        return a, b, f"{GUESS}no noise data of this camera: {DENSITY:g} e- a square micrometre at ISO 100", base
    if wish.full_well is not None:
        factor = 1 / (wish.full_well * base)
        a, b, base = a * factor, b * factor, base * factor
        of += f", scaled to {wish.full_well:g} e- at the lowest ISO (given)"
    return a, b, of, base


def _levels(entry, wish, b, catalogue) -> tuple[int, float, int, str]:
    """Return bits, white and black level [DN] and their source."""
    constants, tuning = entry.constants, entry.tuning
    iso = wish.iso or 100
    bits, white = BITS, None
    if tuning is not None:
        bits = SENSORS.get(tuning.name.split("_")[0], (0, 0, 0, 10))[3]
        white = 2.0**bits - 1
        black = round(tuning.black * 2**bits)
        source = f"{catalogue.places['libcamera'].label}: {tuning.name}, rpi.black_level; bits of the data sheet"
        return bits, white, black, source
    source = "14 bits and their highest value as white"
    label = catalogue.places["camconst"].label if constants else ""
    if constants and (level := constants.white_at(iso)) and 255 <= level <= 65535:
        white, bits = level, max(1, math.ceil(math.log2(level + 1)))
        source = f"white {level:g} of {label}: {constants.names[0]}"
    white = white or 2.0**bits - 1
    if constants and constants.is_absolute and (black := constants.black_at(iso)) is not None:
        if black < white:
            return bits, white, round(black), f"{source}; black of the same"
    noise = CLEARANCE * math.sqrt(max(b, 0)) * white
    black = max(2**bits // 32, math.ceil(noise))
    black = min(black, int(white // 2))
    return bits, white, black, f"{GUESS}black level; {source}"


class _Colour:
    """Responses of the channels, with their source.

    Attributes:
        curves: Wavelengths [nm] and responses of R, G, B; None for one channel or a file.
    """

    def __init__(self, sheet, entry, wish, catalogue):
        self.sheet, self.entry, self.wish = sheet, entry, wish
        self.places = catalogue.places
        self.is_mono = bool(_MONO.search(entry.name)) or bool(entry.tuning and entry.tuning.is_mono)
        self.matrices, self.source = self._matrices()
        self.curves, self.rms = None, 0.0
        if wish.sensitivity is not None:
            self.curves = NODES, self._measured()
        elif self.is_mono:
            pass
        elif self.matrices:
            found = fit_response(self.matrices)
            self.curves, self.rms = (NODES, found.qe), found.error
        else:
            typical = typical_response()
            self.curves = NODES, typical * PEAK / typical.max()

    def _measured(self):
        """Return the curves of the file of sensitivities at NODES, for lateral colour."""
        from gpusim.io.camera.cameras import read_curves

        path = Path(self.wish.sensitivity)
        found, letters = read_curves(Path("camera.toml"), "sensitivity", str(path.absolute()), False)
        if letters != ("R", "G", "B"):
            raise BadData(f"{path}: columns {', '.join(letters)}; wanted R, G, B")
        return found.at(NODES)

    def _matrices(self):
        """Return the matrices that are known, and their source."""
        entry = self.entry
        path = self.wish.profile or entry.profile
        if path is not None:
            profile = read_profile(Path(path))
            lights = ", ".join(light for light, _ in profile.matrices)
            source = f"ColorMatrix in {lights} of {profile.file.name}"
            if not self.wish.profile:
                source += f" ({self.places['dcp'].label})"
            return [Matrix(light, own, light) for light, own in profile.matrices], source
        if entry.constants is not None and entry.constants.matrix is not None:
            source = f"dcraw_matrix in D65 of {self.places['camconst'].label}: {entry.constants.names[0]}"
            return [Matrix("D65", entry.constants.matrix, "D65")], source
        if entry.tuning is not None and (found := entry.tuning.nearest(DAYLIGHT)):
            matrix, kelvin = found
            light = f"daylight-{kelvin:.0f}K" if kelvin >= 4000 else f"blackbody-{kelvin:.0f}K"
            source = f"{self.places['libcamera'].label}: {entry.tuning.name}, rpi.ccm and rpi.awb at {kelvin:g} K"
            return [Matrix(light, matrix, "D65")], source
        return [], ""

    def add(self):
        """Add mosaic, responses and the processor's keys."""
        sheet, entry = self.sheet, self.entry
        if self.is_mono:
            sheet.add("sensor", "one channel, of its name", cfa=["W"])
            sheet.add("sensor", f"{GUESS}a typical sensor without filters", qe="mt9v024", qe_ends="zero")
            sheet.add("processor", "one channel", color="none")
        else:
            is_trans = "fuji" in entry.name.lower() and _X_TRANS.search(entry.name)
            mosaic = "x-trans" if is_trans else ["RG", "GB"]
            sheet.add("sensor", f"{GUESS}the mosaic, of the model's name", cfa=mosaic)
            self._add_curves()
        if entry.tuning is not None and entry.tuning.shading is not None:
            self._add_shading(entry.tuning)

    def _add_curves(self):
        sheet = self.sheet
        if self.wish.sensitivity is not None:
            path = str(Path(self.wish.sensitivity).absolute())
            sheet.add("sensor", "measured sensitivities, given", sensitivity=path)
            sheet.add("sensor", f"{GUESS}efficiency of the highest sensitivity", sensitivity_peak=PEAK)
            return
        wavelengths, values = self.curves
        table = {"wavelengths_nm": wavelengths.tolist()}
        table |= {letter: np.round(own, 5).tolist() for letter, own in zip("RGB", values, strict=True)}
        if self.matrices:
            source = (
                f"fitted to {self.source}, within {100 * self.rms:.2g} % of white rms over surfaces; guess: their shape "
                f"beyond that (typical curves) and the peak of {PEAK:g} e-/photon"
            )
        else:
            source = f"{GUESS}typical curves with a peak of {PEAK:g} e-/photon; no matrix is known"
        sheet.add("sensor", source, qe=table, qe_ends="zero")

    def _add_shading(self, tuning):
        """Add the lens shading of a tuning file, at nodes from edge to edge."""
        source = f"{self.places['libcamera'].label}: {tuning.name}, inverse of rpi.alsc luminance_lut"
        source += "; colour shading is left out"
        self.sheet.add("sensor", source, vignetting=np.round(spread_to_edges(tuning.shading), 5).tolist())
        self.sheet.keys = [
            key for key in self.sheet.keys if key.name != "relative_illumination"
        ]
        self.sheet.add("optics", "the measured shading has it", relative_illumination="none")


def spread_to_edges(cells: np.ndarray) -> np.ndarray:
    """Return values at as many places from edge to edge of the values in the middle of cells.

    Linear between the middles, and beyond the last ones as between the last two; at most 1.
    """
    for axis in (0, 1):
        count = cells.shape[axis]
        at = np.linspace(-0.5, count - 0.5, count)
        first = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = (at - first).reshape([-1 if axis == one else 1 for one in (0, 1)])
        low, high = cells.take(first, axis), cells.take(first + 1, axis)
        cells = low + part * (high - low)
    return np.clip(cells, 0.0, 1.0)
