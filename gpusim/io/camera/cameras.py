"""Cameras: built-in ones, and camera files (TOML) with the keys of `camera_keys`."""

import copy
import dataclasses
import os
import re
import tomllib
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import numpy as np

from gpusim.data.curves import CHANNELS, curve
from gpusim.data.displays import display_names, open_display
from gpusim.data.lights import FILES, illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.calibration import Calibration
from gpusim.domain.camera import Camera
from gpusim.domain.camera_keys import MICRO, SECTIONS, key_spoken_of, section_fields
from gpusim.domain.display import Display
from gpusim.domain.errors import (
    LONGEST_VALUE,
    BadData,
    BadFile,
    DoesNotFit,
    GpusimError,
    OutOfRange,
    UnknownName,
    format_value,
    near,
    one_line,
)
from gpusim.domain.filters import Filters
from gpusim.domain.mask_patterns import mask_pattern
from gpusim.domain.mosaics import MOSAICS
from gpusim.domain.noise import Noise, reset_noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor, fit_to_mosaic
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.domain.units import (
    AXIS,
    check_shares,
    convert_to_nm,
    is_inverse,
    letter_of,
    read_share_heading,
)
from gpusim.io.camera.learned import read_table
from gpusim.io.camera.network import read_network
from gpusim.io.files import name_in_errors, read_cells, read_text, reading

_FOLDER = Path(str(resources.files("gpusim.data")), "cameras")
BASE = "phone"  # camera whose keys a file without `base` gets
NO_BASE = "none"  # value of `base` for a file that has all of its keys
# Keys that exclude each other: a key of a file removes these of its base
REPLACED: dict[str, dict[str, tuple[str, ...]]] = {
    "optics": {
        "defocus_um": ("defocus_diopters",),
        "defocus_diopters": ("defocus_um",),
        "distortion": ("calibration",),
        "calibration": ("distortion",),
    },
    "sensor": {
        "qe": ("sensitivity", "sensitivity_peak"),
        "sensitivity": ("qe", "photodetector", "ir_cut", "sensitivity_peak"),
        "gain_dn_per_e": ("gain_e_per_dn",),
        "gain_e_per_dn": ("gain_dn_per_e",),
        "noise_profile": (
            *("full_well_e", "bits", "black_level_dn", "gain_dn_per_e", "gain_e_per_dn"),
            *("conversion_gain_uv_per_e", "adc_range_v", "analog_gain", "analog_offset_e"),
        ),
    },
}
READS = ("read_e", "reset_e", "adc_dn", "row_e", "column_e")  # keys of [noise] of a noise profile
LONGEST_TABLE = 4 * 2**20  # [byte] of a CSV file: 100,000 wavelengths
LONGEST_INTEGER = 2**64  # above all whole numbers of a camera file; seeds are below
# A key of more than 16 parts, a.b.c ...: tomllib's time grows with the square of their number.
_DEEP_KEY = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){16}""", re.ASCII
)
_KEY = re.compile(r"\[(\w+)\] (\w+)")  # in an error of a camera file


def camera_names() -> list[str]:
    """Return the names of the built-in cameras.

    Returns:
        The names, sorted.
    """
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def open_camera(name_or_path: str | os.PathLike) -> Camera:
    """Open a built-in camera by name, or a camera file (TOML).

    A file's keys are the fields of Optics, Sensor, Processor and Display; keys with a unit end in
    it, for example `pixel_pitch_um`. Missing keys are those of `base`, the name of a built-in camera
    or a file in the same folder; without `base` those of the phone, and a note names them. With
    `base = "none"` the file has all keys that a camera needs, and models that it leaves out are not
    used.

    Args:
        name_or_path: name of a built-in camera, or path of a camera file.

    Returns:
        The camera.

    Raises:
        BadData: if `name_or_path` is neither a text nor a path.
        BadFile: if the file cannot be used, naming file and key.
        UnknownName: if there is no camera of this name.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        raise BadData(f"camera: {type(name_or_path).__name__}, wanted a name or a file's path")
    path, table = camera_table(name_or_path)
    try:
        camera = camera_of(path, table)
    except BadFile as error:
        named = _KEY.search(error.details)
        if named is None:
            raise
        section, key = named.groups()
        tables = ((file, own.get(section)) for file, own in _chain(name_or_path))
        owners = (file for file, own in tables if isinstance(own, dict) and key in own)
        where = next(owners, path)
        if where == path:
            raise
        why = f"{error.details.removeprefix(f'{path}: ')} (the key is its base's, {where})"
        raise BadFile(path, why) from error
    _, own = _file_table(name_or_path)
    if note := _note_base(path, own, table):
        camera = dataclasses.replace(camera, notes=(*camera.notes, note))
    return camera


def _note_base(path, own, table):
    """Return a note on the phone's keys that a file without a base uses; "" if there are none.

    own: keys of the file. table: these with the phone's.
    """
    if "base" in own or not own.keys() - {"name"} or _is_built_in(path):
        return ""
    _, below = _file_table(BASE)
    taken = [
        key
        for section in below
        for key in below[section]
        if key not in _section(own, section) and key in _section(table, section)
    ]
    return f"{path.name} has no base: {', '.join(taken)} are the {BASE}'s" if taken else ""


def _is_built_in(path):
    """Return whether a file is that of a built-in camera."""
    return path.resolve().parent == _FOLDER.resolve()


def camera_table(name_or_path) -> tuple[Path, dict]:
    """Return a camera's file and its keys, including its base's keys.

    Raises as `open_camera`.
    """
    (path, table), *bases = _chain(name_or_path)
    name = table.pop("name", path.stem)
    for file, below in bases:
        table = override_keys(anchor_paths(file, below), table)
    return path, {**table, "name": name}


def override_keys(below: dict, table: dict) -> dict:
    """Return a camera's table with the keys of `table` in place of its own.

    A key also removes those that exclude it. A new mosaic also changes the keys of [processor] that
    would not fit, except for those in `table`.
    """
    own, is_new = table.get("processor", {}), "cfa" in _section(table, "sensor")
    base = _section(below, "sensor")
    merged = _merge_keys(below, table)
    if is_new and "cfa" in base:
        merged = _fit_processor(merged, own, base["cfa"])
    return merged


def _section(table, name):
    """Return the keys of a section; {} if there are none, or it is no section."""
    return table.get(name) if isinstance(table.get(name), dict) else {}


def _fit_processor(table, own, before):
    """Return a table whose processor fits a mosaic that replaces its base's.

    own: keys of [processor] that come with the mosaic, and stay. before: the base's mosaic.
    """
    rows, old = (_rows(value) for value in (table["sensor"]["cfa"], before))
    processor = _section(table, "processor")
    if not rows or not old or not isinstance(own, dict) or table.get("processor", {}) != processor:
        return table
    known = {
        key: value
        for key, value in processor.items()
        if key in ("demosaic", "color", "white_balance", "table")
    }
    free = {"demosaic", "color", "white_balance"} - own.keys()
    is_stacked = table["sensor"].get("stacked") is True
    return {**table, "processor": processor | fit_to_mosaic(rows, old, is_stacked, known, free)}


def _rows(cfa):
    """Return the rows of a mosaic of a camera file, () if it is none."""
    if isinstance(cfa, str):
        return MOSAICS.get(cfa, ())
    is_rows = isinstance(cfa, list) and all(isinstance(row, str) and row for row in cfa)
    return tuple(cfa) if is_rows else ()


def _chain(name_or_path):
    """Yield a camera's file, its base, the base of that ..., each with its own keys."""
    path, table = _file_table(name_or_path)
    has_focal_length = "base" not in table and "calibration" in _section(table, "optics")
    files, base = [path.resolve()], table.pop("base", None if _is_built_in(path) else BASE)
    yield path, table
    while base not in (None, NO_BASE):
        word, place = f"base = {format_value(base)}", base
        if not isinstance(base, str):
            raise BadFile(files[-1], f"{word}: wanted a camera's name or file")
        if base not in camera_names():
            place = files[-1].parent / base
            if not os.path.exists(place):
                known = ", ".join(camera_names())
                raise BadFile(files[-1], f"{word}: no such camera or file; cameras are {known}")
        path, table = _file_table(place)
        if path.resolve() in files:
            raise BadFile(files[-1], f"{word}: the bases form a loop")
        files.append(path.resolve())
        base = table.pop("base", None if _is_built_in(path) else BASE)
        if has_focal_length:  # that of the phone would hide the calibration's
            table["optics"].pop("focal_length_mm")
        yield path, table


def anchor_paths(path: Path, table: dict) -> dict:
    """Return a table with absolute paths for files next to the camera's file `path`."""
    anchored = dict(table)
    for section, keys in table.items():
        if isinstance(keys, dict):
            anchored[section] = {key: _anchor(path, value) for key, value in keys.items()}
    return anchored


def _anchor(path, value):
    is_name = isinstance(value, str) and Path(value).suffix
    is_file = is_name and os.path.isfile(path.parent / value)
    return str((path.parent / value).resolve()) if is_file else value


def _merge_keys(below, table):
    """Return a base's table with the keys of `table` replaced, section by section."""
    merged = copy.deepcopy(below)
    if "noise_profile" in _section(table, "sensor"):
        for key in READS:
            _section(merged, "noise").pop(key, None)
    for section, keys in table.items():
        if isinstance(keys, dict) and isinstance(merged.get(section), dict):
            for key in keys:
                for other in REPLACED.get(section, {}).get(key, ()):
                    merged[section].pop(other, None)
            merged[section] |= keys
        else:
            merged[section] = keys
    return merged


def _file_table(name_or_path):
    """Return a camera's file and its keys as written there."""
    if name_or_path in camera_names():
        path = _FOLDER / f"{name_or_path}.toml"
    else:
        path = Path(name_or_path)
        # Path.exists raises for a name that is too long
        if path.suffix != ".toml" and not os.path.exists(path):
            raise UnknownName("camera", str(name_or_path), camera_names())
    text = read_text(path, "TOML")
    deep = _DEEP_KEY.search(text)
    if deep:
        line = text.count("\n", 0, deep.start()) + 1
        raise BadFile(path, f"not TOML of a camera: line {line} has a key of more than 16 parts")
    with reading(path, "TOML"):
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:  # names the line
            raise BadFile(path, f"not TOML: {error}") from None
        _require_short_integers(path, table)
    return path, table


def camera_of(path: Path, table: dict) -> Camera:
    """Return the camera of a table of keys; path: its file for errors. Raises as `open_camera`."""
    with name_in_errors(path):  # the domain's checks know neither file nor key and unit
        try:
            return _camera(path, dict(table))
        except (BadData, OutOfRange, UnknownName) as error:
            key = key_spoken_of(table, error.details)
            raise BadFile(path, f"{key}: {error.details}") if key else error from error


@contextmanager
def _name_key_in_errors(path, label):
    """Add the camera's file and the key to errors of a lookup or read."""
    try:
        yield
    except DoesNotFit:
        raise
    except GpusimError as error:
        raise BadFile(path, f"{label}: {error.details}") from error


def _require_short_integers(path, value):
    """Raise BadFile for integers beyond 64 bits; Python cannot print more than 4300 digits."""
    if isinstance(value, int) and abs(value) >= LONGEST_INTEGER:
        raise BadFile(path, "has a whole number of more than 64 bits; wanted a smaller number")
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            _require_short_integers(path, item)


def _camera(path, table):
    name = table.pop("name", path.stem)
    if type(name) is not str:
        raise BadFile(path, f"name = {format_value(name)}: wanted a text")
    for section in table:
        if section not in SECTIONS:
            why = f"unknown section [{one_line(section, LONGEST_VALUE)}]{near(section, SECTIONS)}"
            raise BadFile(path, why)
    optics = section_fields(path, table, "optics", Optics)
    sensor = section_fields(path, table, "sensor", Sensor)
    if not isinstance(optics.get("transmission", 1.0), float):
        optics["transmission"] = read_curve(path, "[optics] transmission", optics["transmission"])
    optics, notes = _lens(path, _apply_calibration(path, optics, sensor))
    filters = sensor["filters"] = _efficiency(path, sensor)
    sensor["qe"], sensor["channels"] = filters.of(sensor.get("cfa", Sensor.cfa))
    noise = section_fields(path, table, "noise")
    if "profile" in sensor:
        notes += _apply_profile(path, sensor, noise)
    sensor["noise"] = _noise(path, noise, sensor)
    return Camera(
        name,
        optics,
        Sensor(**sensor),
        _processor(path, section_fields(path, table, "processor")),
        _display(path, section_fields(path, table, "display")),
        notes,
    )


def _processor(path, fields):
    """Return the processor of its fields, with its filter table and network read and names checked."""
    if "table" in fields:
        with _name_key_in_errors(path, "[processor] table"):
            fields["table"] = read_table(path.parent / fields["table"])
    if "network" in fields:
        with _name_key_in_errors(path, "[processor] network"):
            fields["network"] = read_network(path.parent / fields["network"])
    for key in ("training", "target"):
        if str(fields.get(key)).lower().endswith(FILES):
            fields[key] = str(path.parent / fields[key])
    processor = Processor(**fields)
    with _name_key_in_errors(path, "[processor] training"):
        reflectances(processor.training)
    with _name_key_in_errors(path, "[processor] target"):
        illuminant(processor.target)
    return processor


def _display(path, fields):
    """Return a display by name, or with custom primaries, white and curve."""
    name = fields.pop("name", None)
    if not fields:
        with _name_key_in_errors(path, "[display] name"):
            return open_display(name or "srgb")
    if name in display_names():
        raise BadFile(
            path,
            f"[display] name = {format_value(name)} is a known display; leave out "
            f"{', '.join(fields)}, or use another name",
        )
    return Display(name or path.stem, **fields)


def _apply_profile(path, sensor, noise):
    """Move the values of a DNG's noise profile into the fields; return its notes."""
    from gpusim.io.camera.noise_profile import read_noise_profile

    with _name_key_in_errors(path, "[sensor] noise_profile"):
        profile = read_noise_profile(path.parent / sensor.pop("profile"))
    own = [
        *(profile.fields.keys() | {"conversion_gain", "adc_range", "analog_gain", "analog_offset"})
        & sensor.keys(),
        *{"read", "reset", "adc", "row", "column"} & noise.keys(),
    ]
    if own:
        why = f"[sensor] noise_profile and {', '.join(sorted(own))}: wanted one or the other"
        raise BadFile(path, why)
    sensor.update(profile.fields)
    noise["read"] = profile.read
    return profile.notes


def _noise(path, fields, sensor):
    """Return the noise of its fields, with the capacitor's reset noise for reset "kTC"."""
    if fields.get("reset") == "kTC":
        # run its checks first
        noise = Noise(**{key: value for key, value in fields.items() if key != "reset"})
        if "conversion_gain" not in sensor:
            why = '[noise] reset_e = "kTC" needs [sensor] conversion_gain_uv_per_e and adc_range_v'
            raise BadFile(path, why)
        fields["reset"] = reset_noise(sensor["conversion_gain"], noise.temperature)
    return Noise(**fields)


def _apply_calibration(path, fields, sensor):
    """Return the lens's fields with its calibration as distortion and default focal length."""
    calibration = fields.pop("calibration", None)
    if calibration is None:
        return fields
    if "distortion" in fields:
        raise BadFile(path, "[optics] calibration and distortion: wanted one of them")
    if not isinstance(calibration, Calibration):
        from gpusim.io.camera.calibration import read_calibration

        with _name_key_in_errors(path, "[optics] calibration"):
            calibration = read_calibration(
                path.parent / calibration["file"], calibration.get("camera")
            )
    # fx is the image distance of the plane in focus: 1/f = 1/b + 1/g
    if "focal_length" not in fields:
        image_distance = calibration.fx * sensor["pixel_pitch"]
        ratio = image_distance / fields.get("object_distance", np.inf)
        fields["focal_length"] = image_distance / (1 + ratio)
    return {**fields, "distortion": calibration}


def _lens(path, fields):
    """Return the optics of its fields, with their wavefront and defocus, and notes on their files."""
    notes = getattr(fields.get("distortion"), "notes", ())
    diopters = fields.pop("diopters", None)
    if diopters is not None and "defocus" in fields:
        raise BadFile(path, "[optics] defocus_um and defocus_diopters: wanted one of them")
    defocus = fields.get("defocus", 0.0)
    if not isinstance(defocus, float):
        table = read_curve(path, "[optics] defocus_um", defocus, has_shares=False)
        fields["defocus"] = Spectrum(table.wavelengths, table.values / MICRO, table.name)
    aberrations = {
        key: fields.pop(key)
        for key in ("zernike", "heights", "seidel", "reference")
        if key in fields
    }
    if not isinstance(fields.get("lateral_color", 0.0), float):
        fields["lateral_color"] = read_curve(
            path, "[optics] lateral_color", fields["lateral_color"], has_shares=False
        )
    if "mask" in fields:
        with _name_key_in_errors(path, "[optics] mask"):
            mask = _mask_of(path.parent, fields.pop("mask"))
            fields["pupil"] = dataclasses.replace(fields.get("pupil", Pupil()), mask=mask)
    if "psf" in fields:
        from gpusim.io.camera.psf import read_psf

        with _name_key_in_errors(path, "[optics] psf"):
            fields["psf"] = read_psf(path.parent / fields["psf"])
        notes += fields["psf"].notes
        fields.setdefault("model", "measured")
    optics = Optics(**fields, wavefront=Wavefront(**aberrations))
    if diopters is not None:
        optics = dataclasses.replace(optics, defocus=optics.displacement(diopters))
    return optics, notes


def _efficiency(path, sensor):
    """Return the curves of a sensor's parts; remove them from `sensor`.

    A measured sensitivity replaces quantum efficiency, photodetector and infrared cut.
    """
    is_whole = "sensitivity" in sensor
    if is_whole == ("qe" in sensor):
        why = "[sensor] qe and sensitivity: wanted one of them"
        raise BadFile(path, why if is_whole else "[sensor] lacks qe, or sensitivity in its place")
    name = "sensitivity" if is_whole else "qe"
    has_shares = not is_whole  # a relative sensitivity has any scale
    table, letters = read_curves(path, f"[sensor] {name}", sensor.pop(name), has_shares)
    parts = {}
    for key, field in (("photodetector", "photodetector_curve"), ("ir_cut", "ir_cut")):
        value = sensor.pop(field, "none")
        if value != "none":
            if is_whole:
                why = (
                    f"[sensor] sensitivity and {key}: wanted one of them; sensitivity has them all"
                )
                raise BadFile(path, why)
            parts[key] = read_curve(path, f"[sensor] {key}", value)
    ends, peak = sensor.pop("qe_ends", None), sensor.pop("sensitivity_peak", None)
    if peak is not None and not is_whole:
        raise BadFile(path, "[sensor] sensitivity_peak: for a sensitivity only")
    return Filters(table, letters, **parts, ends=ends, is_whole=is_whole, peak=peak)


def read_curve(path, label, value, has_shares=True):
    """Return a curve that is one function of wavelength."""
    spectrum, _ = read_curves(path, label, value, has_shares)
    if len(spectrum.values) != 1:
        raise BadFile(path, f"{label}: wanted one curve, got {len(spectrum.values)}")
    return Spectrum(spectrum.wavelengths, spectrum.values[0], spectrum.name)


def read_curves(path, label, value, has_shares=True):
    """Return a named table, .csv file or inline table as Spectrum (C, L) and C letters.

    has_shares: the values are efficiencies or transmissions, 0 .. 1 or percent.
    """
    if type(value) is dict:
        axes = [key for key in value if AXIS.search(key)]
        columns = {key: column for key, column in value.items() if key not in axes}
        if len(axes) != 1 or not columns:
            why = f"{label}: wanted wavelengths_nm = [...] and one list of values per curve"
            raise BadFile(path, why)
        try:
            numbers = np.array(value[axes[0]], np.float64)
            values = np.array(list(columns.values()), np.float64)
        except (TypeError, ValueError):
            raise BadFile(path, f"{label}: wanted lists of numbers with equal lengths") from None
        with name_in_errors(path):
            return _table(numbers, axes[0], values, tuple(columns), label, has_shares)
    if type(value) is not str:
        raise BadFile(
            path,
            f"{label} = {format_value(value)}: wanted a curve's name, a .csv file or a table of "
            "wavelengths_nm and values",
        )
    with _name_key_in_errors(path, label):
        if value.endswith(".csv"):
            return _read_csv(path.parent / value, has_shares)
        spectrum = curve(value)
    values = np.atleast_2d(spectrum.values)
    return Spectrum(spectrum.wavelengths, values, value), tuple(CHANNELS[value])


def read_part(key: str, field: str, given):
    """Return what the value of a key stands for, as `Camera.with_` takes it; other values stay.

    Files are named from the current folder. Raises BadData, UnknownName, DoesNotFit.
    """
    here = Path("camera.toml")
    try:
        return _part(here, key, field, given)
    except BadFile as error:  # there is no camera's file
        why = error.details.replace(f"{here}: ", "").removeprefix(f"{key}: ")
        raise BadData(f"{key}: {why}") from None


def _mask_of(folder, given):
    """Return the mask of a name, of a file in a folder, or of shares of light."""
    from gpusim.io.camera.masks import mask_of_light, read_mask

    if not isinstance(given, str):
        return mask_of_light(given)
    return read_mask(folder / given) if Path(given).suffix else mask_pattern(given)


def _part(here, key, field, given):
    if field == "target":
        illuminant(given)
    if field == "training":
        reflectances(given)
    if isinstance(given, tuple):
        return given
    if field in ("qe", "sensitivity"):
        return read_curves(here, key, given, field == "qe")
    if field in ("photodetector_curve", "ir_cut"):
        return None if given in (None, "none") else read_curve(here, key, given)
    if isinstance(given, float | int):
        return given
    if field in ("transmission", "defocus", "lateral_color"):
        found = read_curve(here, key, given, field == "transmission")
        per_unit = MICRO if field == "defocus" else 1.0
        return dataclasses.replace(found, values=found.values / per_unit)
    if given is None:
        return given
    if field == "calibration" and isinstance(given, dict):
        from gpusim.io.camera.calibration import read_calibration

        return read_calibration(Path(given["file"]), given.get("camera"))
    if field == "mask":
        return _mask_of(Path(), given)
    if field == "psf":
        from gpusim.io.camera.psf import read_psf

        return read_psf(Path(given))
    if field == "profile":
        from gpusim.io.camera.noise_profile import read_noise_profile

        return read_noise_profile(Path(given))
    if field == "network":
        return read_network(Path(given))
    return read_table(Path(given)) if field == "table" else given


def _read_csv(path, has_shares=True):
    """Read a .csv with a first line of the form `wavelength_nm,R,G,B`, then numbers.

    Separators, decimal commas and comments are as in `read_cells`; units as in
    `gpusim.domain.units`.
    """
    lines = read_cells(path, LONGEST_TABLE)
    if not lines or not AXIS.search(lines[0][0]) or len(lines[0]) < 2:
        raise BadFile(path, "wanted a first line of the form wavelength_nm,R,G,B")
    try:
        table = np.array(lines[1:], np.float64).reshape(-1, len(lines[0])).T
    except ValueError:
        why = f"wanted {len(lines[0])} numbers on every line after the first"
        raise BadFile(path, why) from None
    with name_in_errors(path):
        return _table(table[0], lines[0][0], table[1:], lines[0][1:], path.name, has_shares)


def _table(numbers, heading, values, names, label, has_shares):
    """Return the Spectrum of a table with headings, and the letters of its curves.

    numbers: below `heading`, (L,). values: (C, L) with C names. Raises BadData.
    """
    wavelengths = convert_to_nm(numbers, heading)
    if is_inverse(heading) and len(numbers) and wavelengths[0] > wavelengths[-1]:
        wavelengths, values = wavelengths[::-1], values[:, ::-1]
    if has_shares:
        names, factors = zip(*map(read_share_heading, names), strict=True)
        values = values * np.array(factors)[:, None]
        check_shares(values, label, names[0])
    return Spectrum(wavelengths, values, label), tuple(map(letter_of, names))
