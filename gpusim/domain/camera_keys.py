"""Keys of camera files: sections, types and units of values, and the fields they set."""

import dataclasses
import difflib
import re

import numpy as np

from gpusim.domain.calibration import FISHEYE, PINHOLE, Calibration
from gpusim.domain.display import Display
from gpusim.domain.distortion import BrownConrady, RadialPolynomial, RadialTable
from gpusim.domain.dual import DualPixels
from gpusim.domain.errors import BadData, BadFile, UnknownName, format_value, near
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.lenslets import Lenslets
from gpusim.domain.mosaics import mosaic
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.pupil import Pupil
from gpusim.domain.sensor import Microlens, Sensor
from gpusim.domain.spectrum import Spectrum


class _Wanted(Exception):
    """A value has the wrong type; the message names the right one."""


def _number(per_unit=1.0):
    """Return a reader of a number. The internal unit holds `per_unit` units of the file."""

    def read(value):
        if type(value) not in (int, float):
            raise _Wanted("a number")
        try:
            return value / per_unit  # a division, as 1.4 / 1e6 is 1.4e-6 and 1.4 * 1e-6 is not
        except OverflowError:
            raise _Wanted("a number below 1e308") from None

    return read


def _number_or(word, wanted, per_unit=1.0):
    """Return a reader of a number or a word; "auto" becomes None."""

    def read(value):
        if value == word:
            return None if word == "auto" else word
        try:
            return _number(per_unit)(value)
        except _Wanted:
            raise _Wanted(wanted) from None

    return read


def _number_or_auto(per_unit=1.0):
    return _number_or("auto", 'a number or "auto"', per_unit)


def _of(kind, wanted):
    def read(value):
        if type(value) is not kind:
            raise _Wanted(wanted)
        return value

    return read


def _mosaic(value):
    if type(value) is str:
        return mosaic(value)
    if (
        type(value) is not list
        or not value
        or not all(type(item) is str and item for item in value)
    ):
        raise _Wanted(
            'rows of letters, such as ["RG", "GB"], or a mosaic\'s name, such as "x-trans"'
        )
    return tuple(value)


_text, _whole, _yes_no = _of(str, "a text"), _of(int, "a whole number"), _of(bool, "true or false")


def _or_auto(read, wanted):
    """Return a reader of "auto", which becomes None, or of what `read` takes."""

    def read_or_auto(value):
        if value == "auto":
            return None
        try:
            return read(value)
        except _Wanted:
            raise _Wanted(f'{wanted}, or "auto"') from None

    return read_or_auto


_yes_no_or_auto = _or_auto(_yes_no, "true, false")
_text_or_auto = _or_auto(_text, "a text")


_MILLI, MICRO = 1e3, 1e6  # millimetres and micrometres in a metre


def _list(read_item, words, count=None):
    """Return a reader of a list of `count` items, or of any number of them."""

    def read(value):
        if type(value) is not list or (count and len(value) != count):
            raise _Wanted(f"a list of {count or 'the'} {words}")
        return tuple(map(read_item, value))

    return read


def _numbers(count=None, per_unit=1.0):
    return _list(_number(per_unit), "numbers", count)


def _pairs(count=None):
    return _list(_numbers(2), "pairs of numbers", count)


def _table(cls, known):
    """Return a reader of an object from a table; known: its keys, with fields and their readers."""

    def read(value):
        if type(value) is not dict or not value.keys() <= known.keys():
            raise _Wanted(f"a table of {', '.join(known)}")
        fields = {}
        for key, item in value.items():
            field, read_item = known[key]
            fields[field] = read_item(item)
        return cls(**fields)

    return read


def _tone(value):
    if type(value) is str:
        return None if value == "auto" else value
    try:
        return _pairs()(value)
    except _Wanted:
        raise _Wanted('a list of pairs of numbers, the name of a tone curve, or "auto"') from None


_pupil = _table(
    Pupil,
    {
        "blades": ("blades", _whole),
        "obscuration": ("obscuration", _number()),
        "rotation_deg": ("rotation", _number(180 / np.pi)),
    },
)
_auto_exposure = _table(
    AutoExposure,
    {
        "method": ("method", _text),
        "level": ("level", _number()),
        "percentile": ("percentile", _number()),
        "longest_ms": ("longest", _number(_MILLI)),
        "most_gain": ("most_gain", _number()),
    },
)
_lenslets_fields = _table(
    Lenslets,
    {
        "pitch_um": ("pitch", _number(MICRO)),
        "focal_length_um": ("focal_length", _number(MICRO)),
        "gap_um": ("gap", _number_or_auto(MICRO)),
        "layout": ("layout", _text),
        "rotation_deg": ("rotation", _number(180 / np.pi)),
        "offset_um": ("offset", _numbers(2, MICRO)),
        "fill": ("fill", _number()),
    },
)


def _lenslets(value):
    if type(value) is dict and not {"pitch_um", "focal_length_um"} <= value.keys():
        raise _Wanted("a table with pitch_um and focal_length_um")
    return _lenslets_fields(value)


def _numbers_or_lists(value):
    if type(value) is list and value and all(type(item) is list for item in value):
        return tuple(_numbers()(item) for item in value)
    return _numbers()(value)


def _distortion(value):
    models = {
        ("k1", "k2", "radius_mm"): RadialPolynomial,
        ("k1", "k2", "k3", "p1", "p2", "radius_mm"): BrownConrady,
    }
    keys = tuple(value) if type(value) is dict else ()
    if set(keys) == {"ideal_mm", "real_mm"}:
        return RadialTable(
            *(np.array(_numbers(None, _MILLI)(value[key])) for key in ("ideal_mm", "real_mm"))
        )
    for known, model in models.items():
        if keys and set(keys) == set(known):
            return model(
                **{
                    key.removesuffix("_mm"): _number(_MILLI if key == "radius_mm" else 1.0)(
                        value[key]
                    )
                    for key in known
                }
            )
    raise _Wanted(
        "a table of "
        + ", or of ".join(", ".join(known) for known in (*models, ("ideal_mm", "real_mm")))
    )


def _calibration(value):
    """Return a Calibration, or the name of a file that is read later, when its folder is known."""
    if type(value) is str:
        return {"file": value}
    known = ("width", "height", "fx", "fy", "cx", "cy")
    if type(value) is not dict or not ({*known} <= value.keys() or "file" in value):
        raise _Wanted(
            f'a file, such as "camera_info.yaml", or a table of {", ".join(known)} and coefficients'
        )
    if "file" in value:
        if not value.keys() <= {"file", "camera"}:
            raise _Wanted(
                'a table of file and camera, such as {file = "camchain.yaml", camera = "cam0"}'
            )
        return {key: _text(item) for key, item in value.items()}
    given = dict(value)
    fisheye = _yes_no(given.pop("fisheye", False))
    order = FISHEYE if fisheye else PINHOLE
    read = [_whole, _whole, *[_number()] * 4]
    matrix = [convert(given.pop(key)) for key, convert in zip(known, read, strict=True)]
    if not given.keys() <= {*order, "skew"}:
        raise _Wanted(
            f"a table of {', '.join(known)}, skew and the coefficients {', '.join(order)}"
            + ("" if fisheye else "; or fisheye = true with k1, k2, k3, k4")
        )
    skew = _number()(given.pop("skew", 0.0))
    used = 1 + max((order.index(key) for key in given), default=-1)
    count = next(count for count in (0, 4, 5, 8, 12, 14) if count >= used)
    return Calibration(
        *matrix, tuple(_number()(given.get(key, 0.0)) for key in order[:count]), fisheye, skew
    )


def _illumination(value):
    if type(value) is list:
        return _numbers()(value)
    if type(value) is dict and value.keys() == {"heights", "values"}:
        return tuple(np.array(_numbers()(value[key])) for key in ("heights", "values"))
    if type(value) is not str:
        raise _Wanted("a text, a list of coefficients or a table of heights and values")
    return value


def _microlens(value):
    if type(value) is not dict or not {"angles_deg", "response"} <= value.keys() <= {
        "angles_deg",
        "response",
        "shift",
    }:
        raise _Wanted("a table of angles_deg, response and shift")
    return Microlens(
        np.radians(_numbers()(value["angles_deg"])),
        np.array(_numbers()(value["response"])),
        _number()(value.get("shift", 0.0)),
    )


def _number_or_table(value):
    if type(value) in (int, float):
        return _number()(value)
    if type(value) is not dict or value.keys() != {"wavelengths_nm", "values"}:
        raise _Wanted("a number, or a table of wavelengths_nm and values")
    return Spectrum(
        *(np.array(_numbers()(value[key]), np.float64) for key in ("wavelengths_nm", "values"))
    )


def _phase_pixel(value):
    if type(value) is not list or [type(item) for item in value] != [int, int, str]:
        raise _Wanted('a list of row, column and half, such as [0, 1, "left"]')
    return tuple(value)


def _map(value):
    if (
        type(value) is not list
        or not value
        or any(type(row) is not list or len(row) != len(value[0]) for row in value)
    ):
        raise _Wanted("a list of equally long lists of numbers")
    return np.array([_numbers()(row) for row in value])


def _mask(value):
    """Return the name of a mask or of its file, or rows of shares of light."""
    if type(value) is str:
        return value
    try:
        return _map(value)
    except _Wanted:
        raise _Wanted(
            'a file, such as "mask.png", a name, such as "mura-13", or a list of equally long lists of numbers'
        ) from None


def _wholes(value):
    if type(value) is not list or len(value) != 2 or any(type(item) is not int for item in value):
        raise _Wanted("a list of 2 whole numbers")
    return tuple(value)


_dual = _table(
    DualPixels,
    {
        "split": ("split", _text),
        "transition": ("transition", _number()),
        "reference_f_number": ("reference_f_number", _number()),
        "crosstalk": ("crosstalk", _number_or_table),
        "misalignment_deg": ("misalignment", _number(180 / np.pi)),
        "follows_chief_ray": ("follows_chief_ray", _yes_no),
        "sparse": ("sparse", _text),
        "cell": ("cell", _wholes),
        "places": ("places", _list(_phase_pixel, "places")),
    },
)


def _inverse(value):
    """Return a gain [DN/e-] from electrons per digital number, [e-/DN]."""
    number = _number()(value)
    if not 1e-4 <= number <= 1e4:
        raise _Wanted("a number 0.0001 .. 10000, electrons per digital number")
    return 1 / number


def _ends(value):
    if value != "zero":
        raise _Wanted('"zero" (no light outside the table), or leave it out')
    return value


def _curve(value):
    return value  # read later, when the folder and the mosaic are known


def _number_or_curve(value):
    return _number()(value) if type(value) in (int, float) else _curve(value)


def _micrometres_or_curve(value):
    return _number(MICRO)(value) if type(value) in (int, float) else _curve(value)


# [section] key: (field of the domain's class, reader)
_OPTICS = {
    "focal_length_mm": ("focal_length", _number(_MILLI)),
    "transmission": ("transmission", _number_or_curve),
    "relative_illumination": ("relative_illumination", _illumination),
    "object_distance_m": ("object_distance", _number()),
    "pupil": ("pupil", _pupil),
    "mask": ("mask", _mask),
    "defocus_um": ("defocus", _micrometres_or_curve),
    "defocus_diopters": ("diopters", _number()),
    "zernike_waves": ("zernike", _numbers_or_lists),
    "zernike_heights": ("heights", _numbers()),
    "seidel_waves": ("seidel", _numbers(5)),
    "reference_nm": ("reference", _number()),
    "birefringence_um": ("birefringence", _numbers(2, MICRO)),
    "diffuser_um": ("diffuser", _number(MICRO)),
    "psf": ("psf", _text),
    "distortion": ("distortion", _distortion),
    "calibration": ("calibration", _calibration),
    "lateral_color": ("lateral_color", _number_or_curve),
}
_SENSOR = {
    "pixel_pitch_um": ("pixel_pitch", _number(MICRO)),
    "microlens": ("microlens", _microlens),
    "lenslets": ("lenslets", _lenslets),
    "dual": ("dual", _dual),
    "cfa": ("cfa", _mosaic),
    "photodetector_size": ("photodetector", _numbers(2)),
    "photodetector_centre": ("centre", _numbers(2)),
    "offset": ("offset", _numbers(2)),
    "vignetting": ("vignetting", _map),
    "qe": ("qe", _curve),
    "sensitivity": ("sensitivity", _curve),
    "sensitivity_peak": ("sensitivity_peak", _number()),
    "photodetector": ("photodetector_curve", _curve),
    "ir_cut": ("ir_cut", _curve),
    "qe_ends": ("qe_ends", _ends),
    "exposure_time_ms": ("exposure_time", _number_or_auto(_MILLI)),
    "auto_exposure": ("auto_exposure", _auto_exposure),
    "row_time_us": ("row_time", _number(MICRO)),
    "binning": ("binning", _wholes),
    "noise_profile": ("profile", _text),
    "full_well_e": ("full_well", _number()),
    "bits": ("bits", _whole),
    "black_level_dn": ("black_level", _whole),
    "gain_dn_per_e": ("gain", _number_or_auto()),
    "gain_e_per_dn": ("gain", _inverse),
    "conversion_gain_uv_per_e": ("conversion_gain", _number(MICRO)),
    "adc_range_v": ("adc_range", _number()),
    "analog_offset_e": ("analog_offset", _number()),
}
_NOISE = {
    "dark_current_e_per_s": ("dark_current", _number()),
    "temperature_c": ("temperature", _number()),
    "reference_temperature_c": ("reference_temperature", _number()),
    "doubling_k": ("doubling", _number()),
    **{
        f"{key}_e": (key, _number())
        for key in ("read", "row", "column", "dsnu", "row_dsnu", "column_dsnu", "telegraph")
    },
    # becomes a number when conversion gain and temperature are known
    "reset_e": ("reset", _number_or("kTC", 'a number or "kTC"')),
    "adc_dn": ("adc", _number()),
    "hot_current_e_per_s": ("hot_current", _number()),
}
_PROCESSOR = {
    "table": ("table", _text),
    "network": ("network", _text),
    "white": ("white", _numbers()),
    "denoise": ("denoise", _number_or_auto()),
    "tone": ("tone", _tone),
    "sharpen": ("sharpen", _number_or_auto()),
    "shading": ("shading", _yes_no_or_auto),
    "highlights": ("highlights", _text_or_auto),
    "lens_corrections": ("lens_corrections", _yes_no_or_auto),
    "local_tone": ("local_tone", _number_or_auto()),
    "gamut": ("gamut", _text_or_auto),
}
_DISPLAY = {
    "primaries": ("primaries", _pairs(3)),
    "white": ("white", _numbers(2)),
    "curve": ("curve", _number_or("srgb", '"srgb" or an exponent')),
    "luminance_cd_per_m2": ("luminance", _number()),
}
# required fields, and the field that may replace each
INSTEAD = {
    "focal_length": "calibration",
    "full_well": "profile",
    "bits": "profile",
    "qe": "sensitivity",
}
SPOKEN = {"diopters": "defocus"}  # fields that messages of the domain call by another name
_PLAIN = {float: _number(), int: _whole, bool: _yes_no, str: _text}


def _with_plain(keys, cls):
    """Return keys with those of all other fields that are plain numbers, texts or switches, by their own names."""
    by_field = {field: key for key, (field, _) in keys.items()}
    found = {}
    for field in dataclasses.fields(cls):
        if key := by_field.get(field.name):
            found[key] = keys[key]
        elif field.type in _PLAIN:
            found[field.name] = field.name, _PLAIN[field.type]
    return found | keys


# a field with a unit or a form of its own is named in a table above; other plain fields need no entry
SECTIONS = {
    "optics": _with_plain(_OPTICS, Optics),
    "sensor": _with_plain(_SENSOR, Sensor),
    "noise": _with_plain(_NOISE, Noise),
    "processor": _with_plain(_PROCESSOR, Processor),
    "display": _with_plain(_DISPLAY, Display),
}


def section_fields(path, table, section, cls=None):
    """Return the keys of one section as arguments of `cls`.

    Args:
        path: Path of the camera file, for messages.
        table: The file as tomllib reads it.
        section: Name of the section.
        cls: Class whose fields without a default must be present; None: no check.

    Returns:
        Names of fields and their values.

    Raises:
        BadFile: A key is unknown or missing, or a value has the wrong type.
    """
    known = SECTIONS[section]
    given = table.get(section, {})
    if type(given) is not dict:
        raise BadFile(path, f"{section} = {format_value(given)}: wanted a section [{section}]")
    fields = {}
    for key, value in given.items():
        if key not in known:
            raise BadFile(
                path, f"unknown key {format_value(key)} in [{section}]{_near_key(key, section)}"
            )
        field, read = known[key]
        if field in fields:
            both = " and ".join(other for other in given if known.get(other, ("",))[0] == field)
            raise BadFile(path, f"[{section}] {both}: wanted one of them")
        try:
            fields[field] = value_of(f"[{section}] {key}", read, value)
        except (BadData, UnknownName) as error:
            raise BadFile(path, str(error)) from None
    required = (
        {
            field.name
            for field in dataclasses.fields(cls)
            if field.default is field.default_factory is dataclasses.MISSING
        }
        if cls
        else ()
    )
    missing = [
        key
        for key, (field, _) in known.items()
        if field in required and not {field, INSTEAD.get(field)} & fields.keys()
    ]
    if missing:
        raise BadFile(path, f"[{section}] lacks {', '.join(missing)}")
    return fields


def key_spoken_of(table, message: str) -> str:
    """Return the key, section and value of the field that an error message begins with.

    Messages of the domain say "optics.focal_length = -0.003 m" if the file says focal_length_mm =
    -3. Returns "" if the message contains the key already or names no field of the file.
    """
    section = message.partition(".")[0]
    given = table.get(section, {}) if section in SECTIONS else {}
    found = []
    for key in given:
        field = SECTIONS[section][key][0]
        at = re.search(rf"\b{SPOKEN.get(field, field)}\b", message)
        if at:
            found.append((at.start(), key))
    key = min(found, default=(0, ""))[1]
    return f"[{section}] {key} = {format_value(given[key])}" if key and key not in message else ""


def value_of(label, read, value):
    """Read a value with a reader of SECTIONS. Raise BadData with `label`, the name of the key."""
    try:
        return read(value)
    except _Wanted as wanted:
        raise BadData(f"{label} = {format_value(value)}: wanted {wanted}") from None
    except UnknownName as error:
        raise BadData(f"{label}: {error}") from None


def _near_key(key, section):
    """Return a hint at the nearest key of any section; noise has its own section."""
    sections = {other: name for name, keys in SECTIONS.items() for other in keys} | dict.fromkeys(
        SECTIONS[section], section
    )
    found = (
        # all known keys are shorter, and the search time grows with the length
        difflib.get_close_matches(key[:100], sections, n=1)
        or [name for name in sections if key.endswith(f"_{name}")]
    )
    if not found or sections[found[0]] == section:
        return near(key, SECTIONS[section])
    return f"; did you mean {found[0]!r} in [{sections[found[0]]}]?"
