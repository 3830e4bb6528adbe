"""Change settings of a camera with the keys of camera files: `Camera.with_`."""

import dataclasses

import numpy as np

from gpusim.domain.camera_keys import SECTIONS, value_of
from gpusim.domain.distortion import Distortion
from gpusim.domain.errors import BadData, UnknownName, format_value
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.learned import FilterTable
from gpusim.domain.noise import reset_noise
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum

# Fields that camera files give as tables or file names. In Python they are the objects themselves.
OBJECTS = {
    "transmission": Spectrum,
    "defocus": Spectrum,
    "lateral_color": Spectrum,
    "qe": Spectrum,
    "pupil": Pupil,
    "psf": PointSpread,
    "distortion": Distortion,
    "microlens": Microlens,
    "auto_exposure": AutoExposure,
    "table": FilterTable,
}
READ = {"qe", "psf", "table"}  # fields that a camera file gives by a name
WAVEFRONT = {"zernike", "heights", "seidel", "reference"}
# Factors of the quantum efficiency; a camera keeps only their product.
IN_QE = ("photodetector", "ir_cut", "qe_ends")
IN_FILES = ("calibration", "noise_profile")  # keys that name a file of several settings
WHOLE = ("optics", "sensor", "processor", "display")


def apply_changes(camera, changes: dict):
    """Return a camera with some settings changed, see `Camera.with_`."""
    parts: dict[str, dict] = {}
    for key, value in changes.items():
        if key in WHOLE:
            parts.setdefault("camera", {})[key] = _whole(camera, key, value)
            continue
        section, name = _place(key)
        field, read = SECTIONS[section][name]
        parts.setdefault(section, {})[field] = _value(key, name, field, read, value)
    made = parts.pop("camera", {})
    noise = parts.pop("noise", {})
    if noise:
        parts.setdefault("sensor", {})
    for section, fields in parts.items():
        own = made.get(section, getattr(camera, section))
        if section == "optics":
            made[section] = _lens(own, fields)
        elif section == "sensor":
            made[section] = _sensor(own, fields, noise)
        else:
            made[section] = dataclasses.replace(own, **fields)
    return dataclasses.replace(camera, **made)


def _place(key):
    """Return the section of a key, and the key without it. Raise UnknownName or BadData."""
    if "." in key:
        section, _, name = key.partition(".")
        if name in SECTIONS.get(section, ()):
            return section, name
        raise UnknownName(
            "key of a camera",
            key,
            [f"{section}.{name}" for section, keys in SECTIONS.items() for name in keys],
        )
    found = [section for section, keys in SECTIONS.items() if key in keys]
    if not found:
        known = {name for keys in SECTIONS.values() for name in keys}
        raise UnknownName("key of a camera", key, sorted({*WHOLE, *known}))
    if len(found) > 1:
        raise BadData(
            f"{key}: a key of {' and '.join(found)}; wanted "
            + " or ".join(f'**{{"{section}.{key}": ...}}' for section in found)
        )
    return found[0], key


def _whole(camera, key, value):
    kind = type(getattr(camera, key))
    if not isinstance(value, kind):
        raise BadData(f"{key}: {type(value).__name__}, wanted {kind.__name__}")
    return value


def _value(key, name, field, read, value):
    """Return the value of a field, read as in a camera file or passed as the object itself."""
    if name in IN_QE:
        raise BadData(
            f"{key}: a camera keeps it as a factor of qe; set qe, a Spectrum with all factors"
        )
    if name in IN_FILES:
        raise BadData(f"{key}: only camera files read it; set the values that its file holds")
    kind = OBJECTS.get(field)
    if kind and isinstance(value, kind):
        return value
    if value is None and field in ("psf", "distortion", "microlens", "table"):
        return None
    if field in READ:
        raise BadData(
            f"{key} = {format_value(value)}: wanted a {kind.__name__}, which a camera file names"
        )
    if kind is Spectrum and isinstance(value, dict | str):
        raise BadData(f"{key} = {format_value(value)}: wanted a number or a Spectrum")
    return value_of(key, read, _plain(value))


def _plain(value):
    """Return a value as TOML has it: without tuples and NumPy numbers."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _lens(optics, fields):
    if "diopters" in fields and "defocus" in fields:
        raise BadData("defocus_um and defocus_diopters: wanted one of them")
    diopters = fields.pop("diopters", None)
    wavefront = {key: fields.pop(key) for key in WAVEFRONT & fields.keys()}
    if wavefront:
        fields["wavefront"] = dataclasses.replace(optics.wavefront, **wavefront)
    if fields.get("psf") is not None:
        fields.setdefault("model", "measured")
    optics = dataclasses.replace(optics, **fields)
    return (
        optics
        if diopters is None
        else dataclasses.replace(optics, defocus=optics.displacement(diopters))
    )


def _sensor(sensor, fields, noise):
    if noise.get("reset") == "kTC":
        gain = fields.get("conversion_gain", sensor.conversion_gain)
        if gain is None:
            raise BadData('reset_e = "kTC" needs conversion_gain_uv_per_e and adc_range_v')
        noise["reset"] = reset_noise(gain, noise.get("temperature", sensor.noise.temperature))
    if noise:
        fields["noise"] = dataclasses.replace(sensor.noise, **noise)
    return dataclasses.replace(sensor, **fields)
