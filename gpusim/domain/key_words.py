"""What a camera file's keys mean in words: units, allowed values, defaults."""

import dataclasses
from collections.abc import Callable
from numbers import Real
from typing import Any

from gpusim.domain.camera_keys import SECTIONS, _Wanted
from gpusim.domain.display import Display
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.pupil import Wavefront
from gpusim.domain.sensor import Sensor

CLASSES: dict[str, tuple[type, ...]] = {
    "optics": (Optics, Wavefront),
    "sensor": (Sensor,),
    "noise": (Noise,),
    "processor": (Processor,),
    "display": (Display,),
}
UNITS = {
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "m": "m",
    "ms": "ms",
    "us": "µs",
    "e": "e⁻",
    "dn": "DN",
    "c": "°C",
    "k": "K",
    "deg": "degree",
    "waves": "wave",
    "diopters": "1/m",
    "v": "V",
    "dn_per_e": "DN/e⁻",
    "uv_per_e": "µV/e⁻",
    "e_per_s": "e⁻/s",
    "e_per_dn": "e⁻/DN",
    "cd_per_m2": "cd/m²",
}
CURVE = "a curve"
CURVES = {
    "_curve": CURVE,
    "_number_or_curve": f"a number or {CURVE}",
    "_micrometres_or_curve": f"a number or {CURVE}",
}
AUTO = "auto"


def unit_of(key: str) -> str:
    """Return the unit at the end of a key: the longest known one, or ""."""
    parts = key.split("_")
    for first in range(1, len(parts)):
        if "_".join(parts[first:]) in UNITS:
            return UNITS["_".join(parts[first:])]
    return ""


def describe_wanted(read: Callable[[Any], Any]) -> str:
    """Return a description of the values that a reader of SECTIONS accepts, in its words."""
    if read.__name__ in CURVES:
        return CURVES[read.__name__]
    try:
        read(object())
    except _Wanted as error:
        return str(error)
    raise ValueError(f"{read.__name__} accepts anything: describe it in CURVES")


def field_of(section: str, key: str) -> dataclasses.Field | None:
    """Return the field that a key sets, or None if it sets none by itself."""
    name, _ = SECTIONS[section][key]
    fields = {
        field.name: field for cls in reversed(CLASSES[section]) for field in dataclasses.fields(cls)
    }
    return fields.get(name)


def default_of(section: str, key: str) -> Any:
    """Return the default of a key in the file's unit and form.

    A number, a text, a switch, a list, or AUTO. None if it has none, or none that a file can say.
    """
    field, (_, read) = field_of(section, key), SECTIONS[section][key]
    if field is None or field.default is dataclasses.MISSING:
        return None
    value = field.default
    if value is None:
        return AUTO if f'"{AUTO}"' in describe_wanted(read) else None
    if isinstance(value, Real) and not isinstance(value, int):
        try:
            one = read(1.0)
        except _Wanted:
            one = 1.0
        return float(f"{value / one:.12g}") if isinstance(one, float) else value
    return _lists(value)


def _lists(value):
    return [*map(_lists, value)] if isinstance(value, tuple) else value
