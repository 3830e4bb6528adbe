"""Cameras and lenses of lensfun's data base (XML, versions 1 and 2)."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from gpusim.domain.errors import BadFile, format_value
from gpusim.io.databases.lens_models import DISTORTIONS, LATERAL, VIGNETTINGS, Calibration
from gpusim.io.files import open_file, reading

LONGEST = 16 * 2**20  # [byte] of a file
FULL_DIAGONAL = math.hypot(36.0, 24.0)  # [mm] of the frame with crop factor 1
PROJECTIONS = {
    "rectilinear": "rectilinear",
    "fisheye": "equidistant",
    "stereographic": "stereographic",
    "equisolid": "equisolid",
    "fisheye_equisolid": "equisolid",
    "fisheye_stereographic": "stereographic",
    "orthographic": "orthographic",
    "thoby": "thoby",
    "panoramic": "panoramic",
    "equirectangular": "equirectangular",
}
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Body:
    """A camera.

    Attributes:
        maker, model: Its names.
        aliases: Further names, such as those in other countries.
        mount: Of lenses.
        crop: Diagonal of 36 x 24 mm over the sensor's diagonal.
        aspect: Long side over short side; 0 if the entry does not say.
        file: Name of the file.
    """

    maker: str
    model: str
    aliases: tuple[str, ...]
    mount: str
    crop: float
    aspect: float
    file: str


@dataclass(frozen=True)
class Lens:
    """A lens with its calibrations.

    Attributes:
        maker, model: Its names.
        aliases: Further names.
        mounts: Mounts it is made for.
        crop: Crop factor of the camera that it was calibrated on.
        aspect: Long side over short side of that camera's frame.
        projection: A value of PROJECTIONS.
        focal: Shortest and longest focal length [mm].
        aperture: Smallest and largest f-number; 0 if not known.
        distortion, lateral, vignetting: Calibrations.
        file: Name of the file.
    """

    maker: str
    model: str
    aliases: tuple[str, ...]
    mounts: tuple[str, ...]
    crop: float
    aspect: float
    projection: str
    focal: tuple[float, float]
    aperture: tuple[float, float]
    distortion: tuple[Calibration, ...] = ()
    lateral: tuple[Calibration, ...] = ()
    vignetting: tuple[Calibration, ...] = ()
    file: str = ""

    @property
    def name(self) -> str:
        """Maker and model, the maker once."""
        return (
            self.model
            if self.model.lower().startswith(self.maker.lower())
            else f"{self.maker} {self.model}"
        )

    @property
    def names(self) -> tuple[str, ...]:
        """All names, the main one first."""
        return self.name, *self.aliases


@dataclass(frozen=True)
class Lensfun:
    """The content of the data base.

    Attributes:
        bodies: Cameras.
        lenses: Lenses.
        fits: Mount of a camera -> mounts of lenses that fit.
    """

    bodies: tuple[Body, ...]
    lenses: tuple[Lens, ...]
    fits: dict[str, frozenset[str]] = field(default_factory=dict)


def read_lensfun(files: Iterable[Path]) -> Lensfun:
    """Read the files of the data base.

    Args:
        files: XML files.

    Returns:
        Cameras, lenses and mounts.

    Raises:
        BadFile: A file is not lensfun's, or damaged.

    Source:
        The manual of lensfun, "Database format".
    """
    bodies: list[Body] = []
    lenses: list[Lens] = []
    fits: dict[str, frozenset[str]] = {}
    for path in files:
        root = _root(path)
        with reading(path, "lensfun's XML"):
            bodies += [_body(path, item) for item in root.iter("camera")]
            lenses += [_lens(path, item) for item in root.iter("lens")]
            for item in root.iter("mount"):
                names = [one.text.strip() for one in item.findall("name") if one.text]
                other = {one.text.strip() for one in item.findall("compat") if one.text}
                if names:
                    fits[names[0]] = frozenset({names[0], *other})
    return Lensfun(tuple(bodies), tuple(lenses), fits)


def _root(path):
    """Return the root of a file. Raises BadFile."""
    with open_file(path) as file, reading(path, "lensfun's XML"):
        data = file.read(LONGEST + 1)
    if len(data) > LONGEST:
        raise BadFile(path, f"more than {LONGEST / 2**20:g} MiB: too long for lensfun's XML")
    if b"<!ENTITY" in data:
        raise BadFile(path, "not lensfun's XML: it defines entities")
    with reading(path, "lensfun's XML"):
        root = ElementTree.fromstring(data)
    if root.tag != "lensdatabase":
        raise BadFile(path, f"not lensfun's XML: its root is <{root.tag}>, wanted <lensdatabase>")
    if root.get("version", "0") not in ("0", "1", "2"):
        why = f"version {format_value(root.get('version'))} of lensfun's XML; wanted 0, 1 or 2"
        raise BadFile(path, why)
    return root


def _texts(item, tag) -> tuple[list[str], list[str]]:
    """Return the texts of a tag without a language, and those with one."""
    every = [one for one in item.findall(tag) if one.text and one.text.strip()]
    plain = [one.text.strip() for one in every if not one.get("lang")]
    return plain, [one.text.strip() for one in every if one.get("lang")]


def _read_names(path, item) -> tuple[str, str, tuple[str, ...]]:
    """Return maker, model and other names."""
    makers, more_makers = _texts(item, "maker")
    models, more_models = _texts(item, "model")
    variants = " ".join(_texts(item, "variant")[0])
    if not (makers or more_makers) or not (models or more_models):
        raise BadFile(path, f"<{item.tag}> without maker or model")
    model = " ".join(filter(None, ((models or more_models)[0], variants)))
    return (makers or more_makers)[0], model, tuple(dict.fromkeys(more_models))


def _body(path, item) -> Body:
    maker, model, aliases = _read_names(path, item)
    mounts = _texts(item, "mount")[0]
    crop = _positive(path, model, "cropfactor", _texts(item, "cropfactor")[0], 1e3)
    return Body(
        maker,
        model,
        aliases,
        mounts[0] if mounts else "",
        crop,
        _aspect(path, item, 0.0),
        path.name,
    )


def _positive(path, model, tag, texts, most):
    """Return the number of a tag, 0 < number < most. Raises BadFile."""
    try:
        value = float(texts[0])
    except (IndexError, ValueError):
        value = math.nan
    if not 0 < value < most:
        shown = format_value(texts[0]) if texts else "missing"
        raise BadFile(path, f"{model}: <{tag}> {shown}; wanted a number above 0")
    return value


def _aspect(path, item, default: float) -> float:
    """Return long side over short side."""
    texts = _texts(item, "aspect-ratio")[0]
    if not texts:
        return default
    try:
        long, _, short = texts[0].partition(":")
        value = float(long) / float(short or 1)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not 0.1 < value < 10:
        raise BadFile(path, f"<aspect-ratio> {format_value(texts[0])}; wanted a ratio such as 3:2")
    return max(value, 1 / value)


def _lens(path, item) -> Lens:
    maker, model, aliases = _read_names(path, item)
    calibrations: dict[str, list[Calibration]] = {"distortion": [], "tca": [], "vignetting": []}
    for part in item.findall("calibration"):
        for one in part:
            if one.tag in calibrations and (found := _calibration(path, model, one)):
                calibrations[one.tag].append(found)
    projection = (_texts(item, "type")[0] or ["rectilinear"])[0].lower()
    crops = _texts(item, "cropfactor")[0]
    crops = crops or [one.get("cropfactor") for one in item.findall("calibration")]
    focal = _span(path, model, item, "focal")
    return Lens(
        maker,
        model,
        aliases,
        tuple(_texts(item, "mount")[0]),
        _positive(path, model, "cropfactor", [one for one in crops if one] or ["1"], 1e3),
        _aspect(path, item, 1.5),  # as lensfun takes it
        PROJECTIONS.get(projection, projection),
        focal if any(focal) else _focal_of(model, calibrations),
        _span(path, model, item, "aperture"),
        tuple(calibrations["distortion"]),
        tuple(calibrations["tca"]),
        tuple(calibrations["vignetting"]),
        path.name,
    )


def _span(path, model, item, tag) -> tuple[float, float]:
    """Return the least and the greatest value of a tag; zeros if it is missing."""
    one = item.find(tag)
    if one is None:
        return 0.0, 0.0
    texts = (one.get("min") or one.get("value"), one.get("max") or one.get("value"))
    low = _positive(path, model, tag, [texts[0] or texts[1]], 1e5)
    return low, max(low, _positive(path, model, tag, [texts[1] or texts[0]], 1e5))


def _focal_of(model, calibrations) -> tuple[float, float]:
    """Return the span of focal lengths that a name says, otherwise of the calibrations."""
    found = re.search(rf"({_NUMBER.pattern})(?:-({_NUMBER.pattern}))?\s*mm", model)
    if found:
        low = float(found[1])
        return low, max(low, float(found[2] or low))
    focals = [one.focal for own in calibrations.values() for one in own]
    return (min(focals), max(focals)) if focals else (0.0, 0.0)


def _calibration(path, model, item) -> Calibration | None:
    """Return the calibration of an element; None for a model that does nothing."""
    models: dict[str, dict[str, tuple[str, ...]]] = {
        "distortion": dict(DISTORTIONS),
        "tca": dict(LATERAL),
        "vignetting": dict(VIGNETTINGS),
    }
    known = models[item.tag]
    name = item.get("model", "none")
    if name == "none":
        return None
    if name not in known:
        why = f"{model}: <{item.tag}> model {format_value(name)}; wanted {', '.join(known)}"
        raise BadFile(path, why)
    ratios = ("kr", "kb", "vr", "vb")  # 1 if they are missing
    terms = tuple(
        _term(path, model, item, key, 1.0 if key in ratios else 0.0) for key in known[name]
    )
    focal = _positive(path, model, item.tag, [item.get("focal", "")], 1e5)
    if item.tag != "vignetting":
        return Calibration(name, terms, focal)
    aperture, distance = (
        _positive(path, model, item.tag, [item.get(key, "")], 1e6)
        for key in ("aperture", "distance")
    )
    return Calibration(name, terms, focal, aperture, distance)


def _term(path, model, item, key, default) -> float:
    text = item.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e3:
        raise BadFile(path, f"{model}: <{item.tag}> {key} = {format_value(text)}; wanted a number")
    return value
