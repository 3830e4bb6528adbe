"""Change settings of a camera with the keys of camera files: `Camera.with_`."""

from dataclasses import replace

import numpy as np

from gpusim.domain.above import call_above
from gpusim.domain.camera_keys import SECTIONS, value_of
from gpusim.domain.distortion import Distortion
from gpusim.domain.dual import DualPixels
from gpusim.domain.errors import BadData, UnknownName
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.filters import Filters
from gpusim.domain.learned import FilterTable
from gpusim.domain.lenslets import Lenslets
from gpusim.domain.mask import Mask
from gpusim.domain.network import Network
from gpusim.domain.noise import reset_noise
from gpusim.domain.processor import fit_to_mosaic
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum

# Fields that camera files give as tables or file names. In Python they may be the objects.
OBJECTS = {
    "transmission": Spectrum,
    "defocus": Spectrum,
    "lateral_color": Spectrum,
    "qe": Spectrum,
    "sensitivity": Spectrum,
    "photodetector_curve": Spectrum,
    "ir_cut": Spectrum,
    "pupil": Pupil,
    "mask": Mask,
    "psf": PointSpread,
    "distortion": Distortion,
    "calibration": Distortion,
    "microlens": Microlens,
    "lenslets": Lenslets,
    "dual": DualPixels,
    "auto_exposure": AutoExposure,
    "table": FilterTable,
    "network": Network,
}
NONE = (
    "psf",
    "mask",
    "distortion",
    "microlens",
    "lenslets",
    "dual",
    "table",
    "network",
)  # fields that None resets
WAVEFRONT = {"zernike", "heights", "seidel", "reference"}
# Fields that a noise profile replaces
GAINS = {"conversion_gain", "adc_range", "analog_gain", "analog_offset"}
READS = {"read", "reset", "adc", "row", "column"}
# Parts of the quantum efficiency; a camera keeps their curves, and the product
PARTS = ("photodetector_curve", "ir_cut", "qe_ends", "sensitivity_peak")
WHOLE = ("optics", "sensor", "processor", "display")


def apply_changes(camera, changes: dict):
    """Return a camera with some settings changed, see `Camera.with_`."""
    parts: dict[str, dict] = {}
    for key, value in changes.items():
        if key in WHOLE:
            parts.setdefault("camera", {})[key] = _whole(camera, key, value)
            continue
        section, name = place_key(key)
        field, read = SECTIONS[section][name]
        fields = parts.setdefault(section, {})
        if field in fields:
            raise BadData(f"{key}: another key sets the same; wanted one of them")
        fields[field] = _value(key, field, read, value)
    made = parts.pop("camera", {})
    noise = parts.pop("noise", {})
    if noise:
        parts.setdefault("sensor", {})
    change = {"optics": _lens, "display": _display}
    if "sensor" in parts:
        own = made.get("sensor", camera.sensor)
        made["sensor"] = _sensor(own, parts.pop("sensor"), noise)
        if "processor" not in made:
            parts.setdefault("processor", {})
    if "processor" in parts:
        before = replace(camera, processor=made.get("processor", camera.processor))
        made["processor"] = _processor(
            before, parts.pop("processor"), made.get("sensor", camera.sensor)
        )
    for section, fields in parts.items():
        made[section] = change[section](made.get(section, getattr(camera, section)), fields)
    return replace(camera, **made)


def place_key(key):
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


def _value(key, field, read, value):
    """Return the value of a field: the object itself, or what a camera file's value stands for."""
    kind = OBJECTS.get(field)
    if kind and isinstance(value, kind):
        return value
    if value is None and field in NONE:
        return None
    given = value_of(key, read, _plain(value))
    return call_above("io.camera.cameras.read_part", key, field, given)


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
    if "calibration" in fields:
        if "distortion" in fields:
            raise BadData("calibration and distortion: wanted one of them")
        fields["distortion"] = fields.pop("calibration")
    if {"mask", "pupil"} & fields.keys():  # a mask stays in another pupil
        pupil = fields.get("pupil", optics.pupil)
        mask = fields.pop("mask", pupil.mask or optics.pupil.mask)
        fields["pupil"] = replace(pupil, mask=mask)
    diopters = fields.pop("diopters", None)
    wavefront = {key: fields.pop(key) for key in WAVEFRONT & fields.keys()}
    if wavefront:
        fields["wavefront"] = replace(optics.wavefront, **wavefront)
    if fields.get("psf") is not None:
        fields.setdefault("model", "measured")
    optics = replace(optics, **fields)
    return optics if diopters is None else replace(optics, defocus=optics.displacement(diopters))


def _sensor(sensor, fields, noise):
    if "profile" in fields:
        profile = fields.pop("profile")
        own = (profile.fields.keys() | GAINS) & fields.keys() | READS & noise.keys()
        if own:
            raise BadData(f"noise_profile and {', '.join(sorted(own))}: wanted one or the other")
        sensor = profile.apply_to(sensor)
    _apply_curves(sensor, fields)
    if noise.get("reset") == "kTC":
        gain = fields.get("conversion_gain", sensor.conversion_gain)
        if gain is None:
            raise BadData('reset_e = "kTC" needs conversion_gain_uv_per_e and adc_range_v')
        noise["reset"] = reset_noise(gain, noise.get("temperature", sensor.noise.temperature))
    if noise:
        fields["noise"] = replace(sensor.noise, **noise)
    return replace(sensor, **fields)


def _apply_curves(sensor, fields):
    """Turn changes of curves and mosaic into the product `qe`, with its channels."""
    parts = {key: fields.pop(key) for key in PARTS if key in fields}
    table = {key: fields.pop(key) for key in ("qe", "sensitivity") if key in fields}
    if len(table) > 1:
        raise BadData("qe and sensitivity: wanted one of them")
    filters, name = sensor.filters, next(iter(table), "")
    if name and isinstance(table[name], Spectrum):
        if parts:
            raise BadData(f"{name}, a Spectrum of all factors, and {', '.join(parts)}: wanted one")
        found = table[name]
        if name == "sensitivity":
            found = found.scale(1 / max(1.0, float(found.values.max())))
        fields |= {"qe": found, "filters": None}
        return
    if name:
        spectrum, letters = table[name]
        old = filters if filters is not None and name == "qe" and not filters.is_whole else None
        filters = Filters(
            spectrum,
            letters,
            old and old.photodetector,
            old and old.ir_cut,
            filters and filters.ends,
            name == "sensitivity",
        )
    if not (parts or name or ("cfa" in fields and filters is not None)):
        return
    if filters is None:
        raise BadData(
            f"{', '.join(parts)}: the camera's curves are known as a product only; set qe, a Spectrum with all factors"
        )
    given = [key for key in ("photodetector_curve", "ir_cut") if parts.get(key) is not None]
    if given and filters.is_whole:
        raise BadData(f"sensitivity and {given[0]}: wanted one of them; sensitivity has them all")
    if "sensitivity_peak" in parts and not filters.is_whole:
        raise BadData("sensitivity_peak: for a sensitivity only")
    names = {"photodetector_curve": "photodetector", "qe_ends": "ends", "sensitivity_peak": "peak"}
    filters = replace(filters, **{names.get(key, key): part for key, part in parts.items()})
    qe, channels = filters.of(fields.get("cfa", sensor.cfa))
    fields |= {"qe": qe, "channels": channels, "filters": filters}


def _processor(camera, fields, sensor):
    """Return the processor with changes, and those that another mosaic needs."""
    own, processor = camera.sensor, camera.processor
    if sensor.cfa != own.cfa:
        known = {key: getattr(processor, key) for key in ("demosaic", "color", "white_balance")}
        free = known.keys() - fields.keys()
        fields = fit_to_mosaic(sensor.cfa, own.cfa, sensor.stacked, known, free) | fields
    return replace(processor, **fields)


def _display(display, fields):
    """Return the display with changes, or another one by its name."""
    if fields.get("name") not in call_above("data.displays.display_names"):
        return replace(display, **fields)
    if len(fields) > 1:
        others = ", ".join(fields.keys() - {"name"})
        raise BadData(f"display.name = {fields['name']!r} is a known display; leave out {others}")
    return call_above("data.displays.open_display", fields["name"])
