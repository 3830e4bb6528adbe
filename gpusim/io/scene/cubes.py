"""Spectral cubes in MATLAB and HDF5 files of any program, found by their wavelengths or by name.

One array of three axes is a cube if one axis is as long as a vector of wavelengths: the user's, or
one in the file (a data set, variable or attribute). Names do not matter unless several fit. So the
data bases of hyperspectral pictures can be read: ICVL, ARAD_1K, CAVE, Harvard, KAUST, TokyoTech, and
products such as NEON's.
"""

import math
import re
from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange, format_value
from gpusim.io.account import Fields, note_of
from gpusim.io.scene.envi import NANOMETRES
from gpusim.io.scene.stacks import SAY_WAVELENGTHS, check_reflectances, read_planes, whole_scale
from gpusim.io.scene.values import Value

SHORTEST, LONGEST = 200, 2600  # [nm] of vectors that count as wavelengths
UNITS = NANOMETRES | {"m": 1e9, "meter": 1e9, "meters": 1e9, "metre": 1e9, "metres": 1e9}
# a vector with such a name has wavelengths even if they are not in order
WAVELENGTHS = re.compile(r"wave|(^|_)(wl|wls|wvl|wav|lam|nm|lambdas?|bands?|centers?)(_|$)", re.I)
# vectors along other axes in HDF5; MATLAB's files have none
OTHERS = re.compile(
    r"([xyt]|lat.*|lon.*|time|rows?|cols?|columns|lines|samples|east.*|north.*)", re.I
)
FILL = ("_FillValue", "missing_value", "Data_Ignore_Value")  # NetCDF's, NEON's
SCALE, OFFSET = "scale_factor", "add_offset"  # NetCDF's: number * factor + offset
DIVISOR = "Scale_Factor"  # NEON's: the number that stands for 1
UNKNOWN = re.compile(r"scale|factor|gain|offset", re.I)
# words of units, without spaces, signs of powers, points and brackets
RADIANCES = {
    word: factor
    for unit, factor in (("nm-1", 1.0), ("um-1", 1e3), ("µm-1", 1e3), ("/nm", 1.0), ("/um", 1e3))
    for word in (f"wm-2sr-1{unit}", f"w/m2/sr{unit}", f"wm-2{unit}sr-1", f"w/m2{unit}/sr")
} | {"w/m2srnm": 1.0, "w/m2srum": 1e3, "w/m2nmsr": 1.0, "w/m2umsr": 1e3}
REFLECTANCES = dict.fromkeys(("", "1", "-", "none", "unitless", "reflectance"), 1.0)
REFLECTANCES |= dict.fromkeys(("%", "percent"), 100.0)


@dataclass(frozen=True, eq=False)
class CubeOfFile:
    """A cube: kind as in `open_scene`, wavelengths [nm] ascending, values float32 (L, rows, cols)."""

    kind: str
    wavelengths: np.ndarray
    values: np.ndarray
    notes: tuple[str, ...]


def read_cube(
    path,
    root: Value,
    key: str | None = None,
    wavelengths: np.ndarray | None = None,
    kind: str | None = None,
    scale: float | None = None,
) -> CubeOfFile:
    """Read a cube from the values of an open file.

    key: its name, such as "rad", "scene.cube" or "/scene/cube"; None: the only array that has an
    axis of wavelengths. wavelengths: [nm], of its bands; None: those of the file. kind, scale: as in
    `open_scene`. Raises BadFile, OutOfRange, DoesNotFit.
    """
    values = root.leaves()
    if key is not None:
        cubes = [_named(path, values, key)]
        if len(_lengths(cubes[0])) != 3 and (wavelengths is None or len(wavelengths) != 1):
            why = f"{cubes[0].label}: {_describe(cubes[0])}, wanted an array of three axes"
            raise BadFile(path, why)
    else:
        cubes = [one for one in values if one.kind == "numbers" and len(_lengths(one)) == 3]
    if not cubes:
        raise BadFile(path, f"no cube, an array of three axes; it holds {_list(values)}")
    found = [(cube, _wavelengths(path, cube, values, root, wavelengths)) for cube in cubes]
    found = [(cube, waves) for cube, waves in found if waves is not None]
    if len(found) != 1:
        _refuse_choice(path, cubes, found, wavelengths)
    cube, waves = found[0]
    return _read(path, root, cube, waves, kind, scale)


@dataclass(frozen=True, eq=False)
class _Waves:
    """Wavelengths [nm] of bands in their order in the file, and the note on their source."""

    nm: np.ndarray
    note: str = ""
    source: Value | None = None

    def __len__(self):
        return len(self.nm)


def _lengths(value):
    """Return the shape of an array without axes of one sample, or as it is if it has three axes."""
    shape = value.shape
    return shape if len(shape) == 3 else tuple(length for length in shape if length > 1)


def _list(values):
    """Return names and shapes of values for errors."""
    words = [f"{one.label} ({_describe(one)})" for one in values]
    return note_of("", words)[0][2:] if words else "nothing"


def _describe(value):
    shape = " x ".join(map(str, value.shape))
    return shape if value.kind == "numbers" else value.kind


def _words(name):
    """Return the parts of a name in a file."""
    return [part for part in re.split(r"[./]", name) if part]


def _named(path, values, key):
    """Return the value with a name. Raises BadFile."""
    if not isinstance(key, str):
        raise OutOfRange("key", format_value(key), "the name of a cube in the file, as text")
    exact = [one for one in values if one.label == key.lstrip("/")]
    exact = exact or [one for one in values if _words(one.label) == _words(key)]
    # at the end of a longer name
    found = exact or [
        one for one in values if _words(one.label)[-len(_words(key)) :] == _words(key)
    ]
    if len(found) != 1:
        why = f"several values are named {key!r}" if found else f"no value is named {key!r}"
        raise BadFile(path, f"{why}; it holds {_list(found or values)}")
    if found[0].kind != "numbers":
        raise BadFile(path, f"{found[0].label}: {found[0].kind}, wanted real numbers of three axes")
    return found[0]


def _refuse_choice(path, cubes, found, wavelengths):
    """Raise BadFile if not exactly one array is the cube."""
    if found:
        raise BadFile(
            path,
            f"{len(found)} cubes: {_list([cube for cube, _ in found])}; choose one by "
            f'key="{found[0][0].label}" or --key',
        )
    if wavelengths is None:
        raise BadFile(path, f"no wavelengths for the bands of {_list(cubes)}; {SAY_WAVELENGTHS}")
    why = f"{len(wavelengths)} wavelengths, but no axis of that length in {_list(cubes)}"
    raise BadFile(path, why)


# ---- wavelengths


def _wavelengths(path, cube, values, root, given):
    """Return the wavelengths of a cube's bands, or None if there are none."""
    shape = _lengths(cube)
    if given is not None:
        fits = len(given) in shape or (len(given) == 1 and len(shape) == 2)
        return _Waves(given) if fits else None
    near = _group(cube)
    attributes = [*_vectors(cube, shape)]
    vectors = [
        one
        for one in values
        if one.kind == "numbers" and one is not cube and len(_lengths(one)) < 2
    ]
    vectors = [one for one in vectors if math.prod(one.shape) in shape]
    if not cube.rows_first:
        vectors = [one for one in vectors if not OTHERS.fullmatch(_words(one.label)[-1])]
    named = [one for one in vectors if WAVELENGTHS.search(_words(one.label)[-1])]
    for level in (
        attributes,
        [_vector(one, True) for one in named if _group(one) == near],
        [_vector(one, True) for one in named if _group(one) != near],
        [*_vectors(root, shape)],
        [_vector(one, False) for one in vectors if one not in named],
    ):
        found = [waves for waves in level if waves is not None]
        for other in found[1:]:
            if not np.array_equal(other.nm, found[0].nm):
                raise BadFile(
                    path,
                    f"several vectors could be the wavelengths of {cube.label}: {found[0].note}; "
                    f"{other.note}; {SAY_WAVELENGTHS}",
                )
        if found:
            return found[0]
    return None


def _group(value):
    return _words(value.label)[:-1]


def _vectors(owner, shape):
    """Yield the wavelengths in attributes of a value, if as many as samples along an axis."""
    attributes = owner.attributes()
    for name, numbers in attributes.items():
        if isinstance(numbers, str):
            try:
                numbers = np.array(
                    [float(word) for word in re.split(r"[\s,;]+", numbers.strip("{[ ]}"))]
                )
            except ValueError:
                continue
        if WAVELENGTHS.search(name) and numbers.size in shape:
            unit = next(
                (attributes[key] for key in attributes if key.lower() == f"{name}_units"), ""
            )
            label = f"{owner.label}@{name}"
            waves = _nanometres(numbers.ravel().astype(np.float64), str(unit) or name, label, True)
            if waves is not None:
                yield waves


def _vector(value, is_named):
    """Return the wavelengths in a vector, or None."""
    attributes = {name.lower(): word for name, word in value.attributes().items()}
    unit = attributes.get("units", attributes.get("unit", _words(value.label)[-1]))
    is_used, numbers = value.is_used, value.numbers().ravel().astype(np.float64)
    value.is_used = is_used  # it may serve another cube only
    return _nanometres(numbers, str(unit), value.label, is_named, value)


def _nanometres(numbers, unit, label, is_named, source=None):
    """Return numbers as wavelengths, or None if they are not plausible.

    unit: text with the unit as a word; without one the size of the numbers determines it.
    """
    if not (np.isfinite(numbers).all() and len(np.unique(numbers)) == len(numbers)):
        return None
    if not is_named and not (np.diff(numbers) > 0).all():
        return None
    words = re.split(r"[\s_()\[\]]+", unit.strip().lower())
    factors = [UNITS[word] for word in words if word in UNITS]
    if not factors and np.array_equal(numbers - numbers[0], np.arange(len(numbers))):
        if numbers[0] in (0, 1):  # numbers of bands
            return None
    factors = factors or [1, 1e3, 1e9]
    for factor in factors:
        nm = np.round(numbers * factor, 6)  # 0.57 um is not exact in binary
        if SHORTEST <= nm.min() and nm.max() <= LONGEST:
            scale = {1: "", 1e3: ", um in the file", 1e9: ", m in the file"}.get(factor, "")
            note = f"wavelengths from {label}: {len(nm)} of {nm.min():g} .. {nm.max():g} nm{scale}"
            return _Waves(nm, note, source)
    return None


# ---- numbers


def _axis(path, cube, count):
    """Return the axis of the bands in `_lengths` of a cube, and notes. Raises BadFile."""
    shape = _lengths(cube)
    axes = [axis for axis, length in enumerate(shape) if length == count]
    if len(axes) == 1:
        return axes[0], []
    if cube.rows_first and axes[-1] == 2:
        return 2, [f"{cube.label}: {_describe(cube)}; the last axis is taken for the bands"]
    raise BadFile(
        path,
        f"{cube.label}: {_describe(cube)} for {count} wavelengths: the axis of the bands is not "
        "known; use gpusim.scene_from(array, axis=...)",
    )


def _read(path, root, cube, waves, kind, scale):
    """Return the cube in the order of its wavelengths, and the account of the file."""
    shape, notes = _lengths(cube), []
    if len(waves) == 1 and len(shape) == 2:
        shape = (*shape, 1)
    if len(shape) != 3:
        raise BadFile(path, f"{cube.label}: {_describe(cube)}, wanted an array of three axes")
    axis, notes = (2, []) if shape != _lengths(cube) else _axis(path, cube, len(waves))
    attributes = cube.attributes()
    fields = Fields(attributes, f"attributes of {cube.label} not used")
    fields.ignore("MATLAB_*", "H5PATH", "Python.*", "DIMENSION_*", "_Netcdf4*", "_NCProperties")
    fields.ignore("CLASS", "NAME", "PALETTE", "coordinates", "grid_mapping", "long_name", "*_name")
    fields.ignore("*_units", *filter(WAVELENGTHS.search, attributes))
    gain, offset, ignored, own = _factors(path, cube, fields, scale)
    units = [fields.take(name) for name in attributes if name.lower() in ("unit", "units")]
    unit = units[0] if units else ""
    kind, factor = _quantity(path, cube, unit, kind, scale, notes)
    array = cube.numbers().reshape(shape)
    if scale is None:
        is_whole = array.dtype.kind != "f" and gain is None and own == factor == 1
        scale = whole_scale(path, array.dtype, cube.label) if is_whole else own * factor
        if is_whole:
            notes.append(f"{cube.label}: whole numbers; {scale:g} is taken as 1")
    order = np.argsort(waves.nm, kind="stable")
    planes = np.moveaxis(array, axis, 0)
    planes = planes if (np.diff(order) == 1).all() else planes[order]
    values, changes = read_planes(
        path,
        planes,
        scale=scale,
        gains=None if gain is None else np.full(len(waves), gain),
        offsets=None if offset is None else np.full(len(waves), offset),
        ignored=ignored,
    )
    if kind == "reflectance" and scale == 1:
        check_reflectances(path, values)
    if waves.source is not None:
        waves.source.is_used = True
    notes = [*filter(None, [waves.note]), *notes, *changes, *fields.notes()]
    notes += note_of("not used", root.unused())
    return CubeOfFile(kind, waves.nm[order], values, tuple(notes))


def _number(path, cube, fields, name):
    """Return an attribute as one finite number, None if it is missing. Raises BadFile."""
    value = fields.take(name)
    if value is None:
        return None
    if isinstance(value, str) or value.size != 1 or not np.isfinite(value).all():
        raise BadFile(path, f"{cube.label}: attribute {name}, wanted one finite number")
    return float(value.item())


def _factors(path, cube, fields, scale):
    """Return factor, offset and mark of no data in the attributes, and the number that means 1."""
    marks = [fields.take(name) for name in FILL if name in fields]
    marks = [mark for mark in marks if not isinstance(mark, str) and mark.size == 1]
    ignored = marks[0].item() if marks else None
    gain, offset = _number(path, cube, fields, SCALE), _number(path, cube, fields, OFFSET)
    own = _number(path, cube, fields, DIVISOR) or 1.0
    others = [name for name in fields.unused if UNKNOWN.search(name)]
    if others and scale is None:
        raise BadFile(
            path,
            f"{cube.label} has the attribute {others[0]}, whose meaning is not known; give the number "
            "that stands for 1 by scale=, --scale",
        )
    return gain, offset, ignored, own


def _quantity(path, cube, unit, kind, scale, notes):
    """Return the kind of the numbers, and the number that stands for 1, from their unit."""
    word = re.sub(r"[\s*^()\[\]{}.·]|\*\*", "", str(unit)).lower()
    if word in RADIANCES:
        return kind or "radiance", RADIANCES[word] if kind != "reflectance" else 1.0
    if word in REFLECTANCES or (kind and scale):
        if kind is None:
            notes.append(
                f"{cube.label}: taken as reflectances; give kind=radiance if it is radiance"
            )
        return kind or "reflectance", REFLECTANCES.get(word, 1.0)
    raise BadFile(
        path,
        f"{cube.label} in units {format_value(str(unit))}: give kind= and scale=, the number in the "
        "file that stands for 1 or for 1 W m-2 sr-1 nm-1",
    )
