"""Cameras: the built-in ones, and camera files (TOML)."""

import csv
import dataclasses
import difflib
import io
import os
import re
import tomllib
from pathlib import Path

import numpy as np

from gpusim.data.curves import CHANNELS, curve
from gpusim.data.displays import display_names, open_display
from gpusim.data.learned import read_table
from gpusim.data.lights import illuminant
from gpusim.data.mosaics import mosaic
from gpusim.data.psf import read_psf
from gpusim.data.reflectances import reflectances
from gpusim.domain.camera import Camera
from gpusim.domain.display import Display
from gpusim.domain.distortion import BrownConrady, RadialPolynomial, RadialTable
from gpusim.domain.errors import LONGEST_VALUE, BadFile, UnknownName, near, one_line, shown
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.noise import Noise, reset_noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.sensor import Microlens, Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.io.files import named, read_text, reading

_FOLDER = Path(__file__).with_name("cameras")
LONGEST_TABLE = 4 * 2**20  # [byte] of a CSV file: 100,000 wavelengths
LONGEST_INTEGER = 2**64  # of a camera file's whole numbers: seeds are below it
# A key of more than 16 parts, a.b.c ...: tomllib takes a time that grows with the square of their number.
_DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){16}""", re.ASCII)


def camera_names() -> list[str]:
    """Names of the built-in cameras, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def open_camera(name_or_path) -> Camera:
    """Open a built-in camera by its name, or a camera file (TOML).

    A file's keys are the fields of Optics, Sensor, Processor and Display; a key that has a unit ends in it, such as
    `pixel_pitch_um`. Raises BadFile, naming file and key, and UnknownName for a name that is neither.
    """
    if name_or_path in camera_names():
        return _read(_FOLDER / f"{name_or_path}.toml")
    path = Path(name_or_path)
    if path.suffix != ".toml" and not os.path.exists(path):  # Path.exists raises for a name that is too long
        raise UnknownName("camera", str(name_or_path), camera_names())
    return _read(path)


class _Wanted(Exception):
    """A value of the wrong type; the message says what was wanted."""


def _number(per_unit=1.0):
    """Return a reader of a number given in a unit of which there are `per_unit` in the unit used inside."""
    def read(value):
        if type(value) not in (int, float):
            raise _Wanted("a number")
        return value / per_unit  # a division, as 1.4 / 1e6 is 1.4e-6 and 1.4 * 1e-6 is not
    return read


def _number_or_auto(per_unit=1.0):
    def read(value):
        if value == "auto":
            return None
        try:
            return _number(per_unit)(value)
        except _Wanted:
            raise _Wanted('a number or "auto"') from None
    return read


def _of(kind, wanted):
    def read(value):
        if type(value) is not kind:
            raise _Wanted(wanted)
        return value
    return read


def _mosaic(value):
    if type(value) is str:
        return mosaic(value)
    if type(value) is not list or not value or not all(type(item) is str and item for item in value):
        raise _Wanted('rows of letters, such as ["RG", "GB"], or a mosaic\'s name, such as "x-trans"')
    return tuple(value)


_text, _whole, _yes_no = _of(str, "a text"), _of(int, "a whole number"), _of(bool, "true or false")


_MILLI, _MICRO = 1e3, 1e6  # millimetres and micrometres in a metre


def _numbers(count=None, per_unit=1.0):
    def read(value):
        if type(value) is not list or (count and len(value) != count):
            raise _Wanted(f"a list of {count or 'the'} numbers")
        return tuple(_number(per_unit)(item) for item in value)
    return read


def _pupil(value):
    known = {"blades": _whole, "obscuration": _number(), "rotation_deg": _number(180 / np.pi)}
    if type(value) is not dict or not value.keys() <= known.keys():
        raise _Wanted("a table of blades, obscuration, rotation_deg")
    return Pupil(**{key.removesuffix("_deg"): known[key](item) for key, item in value.items()})


def _numbers_or_lists(value):
    if type(value) is list and value and all(type(item) is list for item in value):
        return tuple(_numbers()(item) for item in value)
    return _numbers()(value)


def _distortion(value):
    models = {("k1", "k2", "radius_mm"): RadialPolynomial, ("k1", "k2", "k3", "p1", "p2", "radius_mm"): BrownConrady}
    keys = tuple(value) if type(value) is dict else ()
    if set(keys) == {"ideal_mm", "real_mm"}:
        return RadialTable(*(np.array(_numbers(None, _MILLI)(value[key])) for key in ("ideal_mm", "real_mm")))
    for known, model in models.items():
        if keys and set(keys) == set(known):
            return model(**{key.removesuffix("_mm"): _number(_MILLI if key == "radius_mm" else 1.0)(value[key])
                            for key in known})
    raise _Wanted("a table of " + ", or of ".join(", ".join(known) for known in (*models, ("ideal_mm", "real_mm"))))


def _illumination(value):
    if type(value) is list:
        return _numbers()(value)
    if type(value) is dict and value.keys() == {"heights", "values"}:
        return tuple(np.array(_numbers()(value[key])) for key in ("heights", "values"))
    if type(value) is not str:
        raise _Wanted("a text, a list of coefficients or a table of heights and values")
    return value


def _microlens(value):
    if type(value) is not dict or not {"angles_deg", "response"} <= value.keys() <= {"angles_deg", "response", "shift"}:
        raise _Wanted("a table of angles_deg, response and shift")
    return Microlens(np.radians(_numbers()(value["angles_deg"])), np.array(_numbers()(value["response"])),
                     _number()(value.get("shift", 0.0)))


def _map(value):
    if type(value) is not list or not value or any(type(row) is not list or len(row) != len(value[0]) for row in value):
        raise _Wanted("a list of equally long lists of numbers")
    return np.array([_numbers()(row) for row in value])


def _wholes(value):
    if type(value) is not list or len(value) != 2 or any(type(item) is not int for item in value):
        raise _Wanted("a list of 2 whole numbers")
    return tuple(value)


def _pairs(count):
    def read(value):
        if type(value) is not list or (count and len(value) != count):
            raise _Wanted(f"a list of {count or 'the'} pairs of numbers")
        return tuple(_numbers(2)(pair) for pair in value)
    return read


def _number_or_srgb(value):
    if value == "srgb":
        return value
    try:
        return _number()(value)
    except _Wanted:
        raise _Wanted('"srgb" or an exponent') from None


def _auto_exposure(value):
    known = {"method": ("method", _text), "level": ("level", _number()), "percentile": ("percentile", _number()),
             "longest_ms": ("longest", _number(_MILLI)), "most_gain": ("most_gain", _number())}
    if type(value) is not dict or not value.keys() <= known.keys():
        raise _Wanted(f"a table of {', '.join(known)}")
    return AutoExposure(**{known[key][0]: known[key][1](item) for key, item in value.items()})


def _number_or_ktc(value):
    if value == "kTC":
        return value  # made a number when conversion gain and temperature are known
    try:
        return _number()(value)
    except _Wanted:
        raise _Wanted('a number or "kTC"') from None


def _curve(value):
    return value  # read later, when the folder and the mosaic are known


def _number_or_curve(value):
    return _number()(value) if type(value) in (int, float) else _curve(value)


def _micrometres_or_curve(value):
    return _number(1e6)(value) if type(value) in (int, float) else _curve(value)


# [section] key: (field of the domain's class, reader)
_OPTICS = {
    "f_number": ("f_number", _number()),
    "focal_length_mm": ("focal_length", _number(_MILLI)),
    "model": ("model", _text),
    "transmission": ("transmission", _number_or_curve),
    "relative_illumination": ("relative_illumination", _illumination),
    "object_distance_m": ("object_distance", _number()),
    "pupil": ("pupil", _pupil),
    "defocus_um": ("defocus", _micrometres_or_curve),
    "defocus_diopters": ("diopters", _number()),
    "zernike_waves": ("zernike", _numbers_or_lists),
    "zernike_heights": ("heights", _numbers()),
    "seidel_waves": ("seidel", _numbers(5)),
    "reference_nm": ("reference", _number()),
    "birefringence_um": ("birefringence", _numbers(2, _MICRO)),
    "diffuser_um": ("diffuser", _number(_MICRO)),
    "psf": ("psf", _text),
    "distortion": ("distortion", _distortion),
    "lateral_color": ("lateral_color", _number_or_curve),
}
_SENSOR = {
    "pixel_pitch_um": ("pixel_pitch", _number(_MICRO)),
    "fill_factor": ("fill_factor", _number()),
    "microlens": ("microlens", _microlens),
    "cfa": ("cfa", _mosaic),
    "stacked": ("stacked", _yes_no),
    "photodetector_size": ("photodetector", _numbers(2)),
    "photodetector_centre": ("centre", _numbers(2)),
    "offset": ("offset", _numbers(2)),
    "vignetting": ("vignetting", _map),
    "qe": ("qe", _curve),
    "photodetector": ("photodetector_curve", _curve),
    "ir_cut": ("ir_cut", _curve),
    "qe_ends": ("qe_ends", _text),
    "exposure_time_ms": ("exposure_time", _number_or_auto(_MILLI)),
    "auto_exposure": ("auto_exposure", _auto_exposure),
    "row_time_us": ("row_time", _number(_MICRO)),
    "binning": ("binning", _wholes),
    "binning_mode": ("binning_mode", _text),
    "full_well_e": ("full_well", _number()),
    "bits": ("bits", _whole),
    "black_level_dn": ("black_level", _whole),
    "gain_dn_per_e": ("gain", _number_or_auto()),
    "conversion_gain_uv_per_e": ("conversion_gain", _number(_MICRO)),
    "adc_range_v": ("adc_range", _number()),
    "analog_gain": ("analog_gain", _number()),
    "analog_offset_e": ("analog_offset", _number()),
}
_NOISE = {
    "photon": ("photon", _text),
    "dark_current_e_per_s": ("dark_current", _number()),
    "temperature_c": ("temperature", _number()),
    "reference_temperature_c": ("reference_temperature", _number()),
    "doubling_k": ("doubling", _number()),
    **{f"{key}_e": (key, _number()) for key in ("read", "row", "column", "dsnu", "row_dsnu", "column_dsnu",
                                               "telegraph")},
    "reset_e": ("reset", _number_or_ktc),
    "adc_dn": ("adc", _number()),
    **{key: (key, _number()) for key in ("prnu", "row_prnu", "column_prnu", "hot_pixels", "dead_pixels",
                                        "telegraph_pixels", "telegraph_switching")},
    "hot_current_e_per_s": ("hot_current", _number()),
    "seed": ("seed", _whole),
}
_PROCESSOR = {
    **{key: (key, _text) for key in ("defects", "demosaic", "table", "white_balance", "color", "training", "target",
                                     "scaling")},
    "shading": ("shading", _yes_no),
    "denoise": ("denoise", _number()),
    "tone": ("tone", _pairs(None)),
}
_DISPLAY = {
    "name": ("name", _text),
    "primaries": ("primaries", _pairs(3)),
    "white": ("white", _numbers(2)),
    "curve": ("curve", _number_or_srgb),
    "luminance_cd_per_m2": ("luminance", _number()),
}
_SECTIONS = {"optics": _OPTICS, "sensor": _SENSOR, "noise": _NOISE, "processor": _PROCESSOR, "display": _DISPLAY}


def _read(path):
    text = read_text(path, "TOML")
    deep = _DEEP_KEY.search(text)
    if deep:
        line = text.count("\n", 0, deep.start()) + 1
        raise BadFile(path, f"not TOML of a camera: line {line} has a key of more than 16 parts")
    with reading(path, "TOML"):
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:  # it says the line
            raise BadFile(path, f"not TOML: {error}") from None
        _require_short_integers(path, table)
    with named(path):  # the domain's own checks know the key but not the file
        return _camera(path, table)


def _require_short_integers(path, value):
    """Refuse whole numbers that no field takes: beyond 4300 digits Python does not even print them."""
    if isinstance(value, int) and abs(value) >= LONGEST_INTEGER:
        raise BadFile(path, "has a whole number of more than 64 bits: wanted a smaller number")
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _require_short_integers(path, item)


def _camera(path, table):
    name = table.pop("name", path.stem)
    if type(name) is not str:
        raise BadFile(path, f"name = {shown(name)}: wanted a text")
    for section in table:
        if section not in _SECTIONS:
            raise BadFile(path, f"unknown section [{one_line(section, LONGEST_VALUE)}]{near(section, _SECTIONS)}")
    optics, sensor = _fields(path, table, "optics", Optics), _fields(path, table, "sensor", Sensor)
    if not isinstance(optics.get("transmission", 1.0), float):
        optics["transmission"] = _single(path, "[optics] transmission", optics["transmission"])
    optics = _lens(path, optics)
    sensor["qe"], sensor["channels"] = _efficiency(path, sensor)
    sensor["noise"] = _noise(path, _fields(path, table, "noise"), sensor)
    return Camera(name, optics, Sensor(**sensor), _processor(path, _fields(path, table, "processor")),
                  _display(path, _fields(path, table, "display")))


def _processor(path, fields):
    """Processor of its fields, with its filter table read; names are looked up while the file is known."""
    if "table" in fields:
        fields["table"] = read_table(path.parent / fields["table"])
    processor = Processor(**fields)
    reflectances(processor.training)
    illuminant(processor.target)
    return processor


def _display(path, fields):
    """A display by its name, or of its own primaries, white and curve."""
    name = fields.pop("name", None)
    if not fields:
        return open_display(name or "srgb")
    if name in display_names():
        raise BadFile(path, f"[display] name = {shown(name)} is a known display; leave out {', '.join(fields)}, or "
                            "give it another name")
    return Display(name or path.stem, **fields)


def _noise(path, fields, sensor):
    """Noise of its fields, with the reset noise of the pixel's capacitance where "kTC" asks for it."""
    if fields.get("reset") == "kTC":
        noise = Noise(**{key: value for key, value in fields.items() if key != "reset"})  # its checks first
        if "conversion_gain" not in sensor:
            raise BadFile(path, '[noise] reset_e = "kTC" needs [sensor] conversion_gain_uv_per_e and adc_range_v')
        fields["reset"] = reset_noise(sensor["conversion_gain"], noise.temperature)
    return Noise(**fields)


def _lens(path, fields):
    """Optics of its fields and of those that are parts of its wavefront or another measure of its defocus."""
    diopters = fields.pop("diopters", None)
    if diopters is not None and "defocus" in fields:
        raise BadFile(path, "[optics] defocus_um and defocus_diopters: wanted one of them")
    defocus = fields.get("defocus", 0.0)
    if not isinstance(defocus, float):
        table = _single(path, "[optics] defocus_um", defocus)
        fields["defocus"] = Spectrum(table.wavelengths, table.values / _MICRO, table.name)
    aberrations = {key: fields.pop(key) for key in ("zernike", "heights", "seidel", "reference") if key in fields}
    if not isinstance(fields.get("lateral_color", 0.0), float):
        fields["lateral_color"] = _single(path, "[optics] lateral_color", fields["lateral_color"])
    if "psf" in fields:
        fields["psf"] = read_psf(path.parent / fields["psf"])
        fields.setdefault("model", "measured")
    optics = Optics(**fields, wavefront=Wavefront(**aberrations))
    return optics if diopters is None else dataclasses.replace(optics, defocus=optics.displacement(diopters))


def _fields(path, table, section, cls=None):
    """One section's keys as arguments of `cls`, whose fields without a default must be there."""
    known = _SECTIONS[section]
    given = table.get(section, {})
    if type(given) is not dict:
        raise BadFile(path, f"{section} = {shown(given)}: wanted a section [{section}]")
    fields = {}
    for key, value in given.items():
        if key not in known:
            raise BadFile(path, f"unknown key {shown(key)} in [{section}]{_near_key(key, section)}")
        field, read = known[key]
        try:
            fields[field] = read(value)
        except _Wanted as wanted:
            raise BadFile(path, f"[{section}] {key} = {shown(value)}: wanted {wanted}") from None
        except UnknownName as error:
            raise BadFile(path, f"[{section}] {key}: {error}") from None
    required = {field.name for field in dataclasses.fields(cls)
                if field.default is field.default_factory is dataclasses.MISSING} if cls else ()
    missing = [key for key, (field, _) in known.items() if field in required and field not in fields]
    if missing:
        raise BadFile(path, f"[{section}] lacks {', '.join(missing)}")
    return fields


def _near_key(key, section):
    """Hint at the nearest key of any section: noise has one of its own, apart from the sensor's."""
    sections = {other: name for name, keys in _SECTIONS.items() for other in keys} | dict.fromkeys(
        _SECTIONS[section], section)
    found = (difflib.get_close_matches(key[:100], sections, n=1)  # no known key is as long, and its time grows
             or [name for name in sections if key.endswith(f"_{name}")])
    if not found or sections[found[0]] == section:
        return near(key, _SECTIONS[section])
    return f"; did you mean {found[0]!r} in [{sections[found[0]]}]?"


def _efficiency(path, sensor):
    """Return colour filter x photodetector x infrared cut, and the letters of its curves; takes them out of `sensor`.

    Only the curves whose letters the mosaic uses are kept: red, green and blue first, then in the table's order.
    """
    spectrum, letters = _curves(path, "[sensor] qe", sensor.pop("qe"))
    used = set("".join(sensor.get("cfa", Sensor.cfa)))
    if not used <= set(letters):
        raise BadFile(path, f"[sensor] qe has no curve for {', '.join(sorted(used - set(letters)))}; "
                            f"it has {', '.join(letters) or 'one without a letter'}")
    channels = tuple(sorted(used, key=("RGB" + "".join(letters)).index))
    rows = [letters.index(letter) for letter in channels]
    product = Spectrum(spectrum.wavelengths, spectrum.values[rows], spectrum.name)
    for key, field in (("photodetector", "photodetector_curve"), ("ir_cut", "ir_cut")):
        if field in sensor:
            product = _product(path, product, _single(path, f"[sensor] {key}", sensor.pop(field)))
    ends = sensor.pop("qe_ends", None)
    if ends == "zero":
        low, high = product.wavelengths[0], product.wavelengths[-1]
        nodes = np.concatenate([[0.1 * low, low - 1], product.wavelengths, [high + 1, 10 * high]])
        product = Spectrum(nodes, np.pad(product.values, ((0, 0), (2, 2))), product.name)
    elif ends is not None:
        raise BadFile(path, f'[sensor] qe_ends = {shown(ends)}: wanted "zero": no light is counted outside the table')
    return product, channels


def _product(path, first, second):
    """Product of two tables at the nodes of both, where both are defined; `first` may hold several functions."""
    nodes = np.union1d(first.wavelengths, second.wavelengths)
    low = max(first.wavelengths[0], second.wavelengths[0])
    high = min(first.wavelengths[-1], second.wavelengths[-1])
    nodes = nodes[(nodes >= low) & (nodes <= high)]
    if len(nodes) < 2:
        raise BadFile(path, f"[sensor] {first.name} and {second.name} have no wavelengths in common")
    return Spectrum(nodes, first.at(nodes) * second.at(nodes), f"{first.name} x {second.name}")


def _single(path, label, value):
    """Read a curve that is one function of wavelength."""
    spectrum, _ = _curves(path, label, value)
    if len(spectrum.values) != 1:
        raise BadFile(path, f"{label}: wanted one curve, got {len(spectrum.values)}")
    return Spectrum(spectrum.wavelengths, spectrum.values[0], spectrum.name)


def _curves(path, label, value):
    """Read a named table, a .csv file beside the camera file or an inline table: Spectrum (C, L) and C letters."""
    if type(value) is dict:
        columns = {key: column for key, column in value.items() if key != "wavelengths_nm"}
        if "wavelengths_nm" not in value or not columns:
            raise BadFile(path, f"{label}: wanted wavelengths_nm = [...] and one list of values per curve")
        try:
            wavelengths = np.array(value["wavelengths_nm"], np.float64)
            values = np.array(list(columns.values()), np.float64)
        except (TypeError, ValueError):
            raise BadFile(path, f"{label}: wanted lists of equally many numbers") from None
        return Spectrum(wavelengths, values, label), tuple(columns)
    if type(value) is not str:
        raise BadFile(path, f"{label} = {shown(value)}: wanted a curve's name, a .csv file or a table of "
                            "wavelengths_nm and values")
    if value.endswith(".csv"):
        return _read_csv(path.parent / value)
    try:
        spectrum = curve(value)
    except UnknownName as error:
        raise BadFile(path, f"{label}: {error}") from None
    return (Spectrum(spectrum.wavelengths, np.atleast_2d(spectrum.values), value), tuple(CHANNELS[value]))


def _read_csv(path):
    """Read a .csv whose first line is `wavelength_nm,R,G,B` or the like, and the others numbers."""
    text = read_text(path, "a CSV table", LONGEST_TABLE)
    with reading(path, "a CSV table"):
        lines = [[cell.strip() for cell in line] for line in csv.reader(io.StringIO(text, newline=""))
                 if any(map(str.strip, line))]
    if not lines or lines[0][0] != "wavelength_nm" or len(lines[0]) < 2:
        raise BadFile(path, "the first line must be wavelength_nm,R,G,B or the like")
    try:
        table = np.array(lines[1:], np.float64).reshape(-1, len(lines[0])).T
    except ValueError:
        raise BadFile(path, f"wanted {len(lines[0])} numbers on every line after the first") from None
    return Spectrum(table[0], table[1:], path.name), tuple(lines[0][1:])
