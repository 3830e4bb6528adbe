"""Settings of a camera by the keys of camera files, in Python: `Camera.with_`."""

import dataclasses

import numpy as np

from gpusim.domain.camera_keys import SECTIONS, value_of
from gpusim.domain.distortion import Distortion
from gpusim.domain.errors import BadData, UnknownName, shown
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.learned import FilterTable
from gpusim.domain.noise import reset_noise
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum

# Fields whose values are read from tables and files: in Python they are what is read.
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
READ = {"qe", "psf", "table"}  # of them those that a camera file names by a text
WAVEFRONT = {"zernike", "heights", "seidel", "reference"}
IN_QE = (
    "photodetector",
    "ir_cut",
    "qe_ends",
)  # keys of factors of the quantum efficiency, which keeps their product
IN_FILES = ("calibration", "noise_profile")  # keys that name a file of several settings
WHOLE = ("optics", "sensor", "processor", "display")


def changed(camera, changes: dict):
    """A camera with other values, see `Camera.with_`."""
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
    """The section of a key, and the key without it. Raises UnknownName, BadData."""
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
    """A value as its field takes it: read as a camera file's, or the object that a file's would become."""
    if name in IN_QE:
        raise BadData(
            f"{key}: a camera has it in its qe, as a factor; wanted qe, a Spectrum with all factors"
        )
    if name in IN_FILES:
        raise BadData(
            f"{key}: is read by camera files alone; wanted the settings that its file holds"
        )
    kind = OBJECTS.get(field)
    if kind and isinstance(value, kind):
        return value
    if value is None and field in ("psf", "distortion", "microlens", "table"):
        return None
    if field in READ:
        raise BadData(
            f"{key} = {shown(value)}: wanted a {kind.__name__}, which a camera file names"
        )
    if kind is Spectrum and isinstance(value, dict | str):
        raise BadData(f"{key} = {shown(value)}: wanted a number or a Spectrum")
    return value_of(key, read, _plain(value))


def _plain(value):
    """A value as TOML has it: without tuples, and without numbers of NumPy."""
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
