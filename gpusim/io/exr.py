"""OpenEXR: reads spectral scenes, writes spectral scenes and linear pictures.

The names of the channels are interpreted by `exr_channels`.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.data.srgb import draw_into_srgb, srgb_from_rgb, srgb_to_xyz
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile
from gpusim.domain.memory import require_memory
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.atomic import atomic_path
from gpusim.io.exr_channels import contents, label_channels
from gpusim.io.files import name_in_errors, open_file, reading

UNITS = "W.m^-2.sr^-1.nm^-1"
PLANES_OF_COLORS = 9  # extra planes held during the conversion to sRGB
OUTSIDE = (
    "colours outside sRGB, which have no reflectance here: {:.2g} % of the samples, moved towards grey of "
    "the same luminance until they fit"
)


@dataclass(frozen=True, eq=False)
class Exr:
    """Content of an OpenEXR file.

    kind: "radiance", values [photon s-1 m-2 sr-1 nm-1]; "reflectance", values [1]; or "rgb", linear
    sRGB, white 1. wavelengths: [nm], None for "rgb". values: float32, shape (L, rows, cols).
    depth_channel, depth: name and stored distances, shape (rows, cols), or None. notes: values that
    were changed or not read. labels: maps of whole numbers by name, int32, shape (rows, cols).
    """

    kind: str
    wavelengths: np.ndarray | None
    values: np.ndarray
    depth_channel: str | None
    depth: np.ndarray | None
    notes: tuple[str, ...]
    labels: dict[str, np.ndarray]


def read_exr(path, bands=None, *, depth: bool = True) -> Exr:
    """Read a spectral or a linear RGB OpenEXR file, and its depth.

    Channels read are S0.<wavelength>nm [W m-2 sr-1 nm-1], T.<wavelength>nm (reflectance), Indigo's
    wavelength<edge> [W m-2 sr-1 m-1] at the middle of each bucket; otherwise a picture of R, G, B,
    also in a layer Combined, or X, Y, Z. RGB of other primaries (`chromaticities`) becomes linear
    sRGB, its white adapted (Bradford): (1, 1, 1) stays white; XYZ is kept. Polarised and bispectral
    files are refused.

    bands: {channel: wavelength [nm]} for files without wavelengths in the names, for example
    Mitsuba's; only these channels are then read, as spectral radiance [W m-2 sr-1 nm-1]. depth:
    read a channel of distances: Z, depth, Depth.Z (Blender), depth.T (Mitsuba's AOV). Labels are
    channels label.NAME, and Blender's IndexOB ("instance") and IndexMA ("material").

    Raises BadFile, UnknownName (a name in `bands`) and DoesNotFit.
    """
    import OpenEXR

    path = Path(path)
    open_file(path).close()  # OpenEXR opens it again by its name
    with reading(path, "an OpenEXR file"):
        parts = [
            part.header
            for part in OpenEXR.File(str(path), separate_channels=True, header_only=True).parts
        ]
        sizes = [_size(header) for header in parts]
        names = [channel.name for channel in parts[0]["channels"]]
        deep = any("deep" in str(header.get("type")) for header in parts)
    if deep:
        raise BadFile(path, "deep data (several samples in a pixel); write a flat picture")
    held = contents(path, names, bands or {})
    rows, cols = sizes[0]
    # Every channel of every part is read, at worst as 4-byte numbers; the cube is a copy.
    counts = [len(header["channels"]) for header in parts]
    stored = sum(n * math.prod(size) for n, size in zip(counts, sizes, strict=True))
    copied = len(held.channels) + (PLANES_OF_COLORS if held.is_picture else 1)
    needed = 4 * (stored + copied * rows * cols)
    require_memory(f"{path}: {len(names)} channels of {cols} x {rows} pixels", needed)
    with reading(path, "an OpenEXR file whose pixels can be read"):
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
    values = np.empty((len(held.channels), rows, cols), np.float32)
    for plane, (name, nm) in zip(values, held.channels, strict=True):
        plane[:] = _pixels(path, channels, name, (rows, cols), finite=True, negative=nm is None)
        if held.kind == "radiance" and nm is not None:
            plane *= held.unit / energy_per_photon(nm)
    notes = []
    if held.is_picture:
        with name_in_errors(path):
            values, notes = _colors(values, held.kind, parts[0].get("chromaticities"))
    distances = _pixels(path, channels, held.depth, (rows, cols)) if depth and held.depth else None
    if distances is not None and held.other_depths:
        others = ", ".join(held.other_depths[:4])
        notes = [*notes, f"depth is channel {held.depth!r}; not read: {others}"]
    kind = "rgb" if held.is_picture else held.kind
    nodes = None if held.is_picture else np.array([nm for _, nm in held.channels])
    source = None if distances is None else held.depth
    labels = {
        label: _whole_numbers(path, channels, name, (rows, cols))
        for label, name in label_channels(names).items()
        if name not in (bands or {})
    }
    return Exr(kind, nodes, values, source, distances, tuple(notes), labels)


def _whole_numbers(path, channels, name, shape):
    """Return the whole numbers of a channel, int32. Raises BadFile."""
    pixels = getattr(channels.get(name), "pixels", None)
    if pixels is None or pixels.shape != shape:
        why = f"channel {name!r}: subsampled or damaged, wanted {shape[1]} x {shape[0]} pixels"
        raise BadFile(path, why)
    with np.errstate(invalid="ignore"):
        is_whole = np.isfinite(pixels) & (np.abs(pixels) < 2.0**31) & (pixels == np.rint(pixels))
    if not is_whole.all():
        raise BadFile(path, f"channel {name!r}: a label, wanted whole numbers below 2^31")
    return pixels.astype(np.int32)


def _pixels(path, channels, name, shape, *, finite=False, negative=True):
    """Return the numbers of a channel; raise BadFile if they are not usable."""
    # None: OpenEXR does not find all channels that it lists
    pixels = getattr(channels.get(name), "pixels", None)
    if pixels is None or pixels.shape != shape:
        why = f"channel {name!r}: subsampled or damaged, wanted {shape[1]} x {shape[0]} pixels"
        raise BadFile(path, why)
    if pixels.dtype.kind != "f":
        raise BadFile(path, f"channel {name!r}: {pixels.dtype}, wanted half or float")
    if finite and not np.isfinite([pixels.min(), pixels.max()]).all():
        raise BadFile(path, f"channel {name!r}: NaN or infinite values")
    if not negative and pixels.min() < 0:
        raise BadFile(path, f"channel {name!r}: negative values (lowest {pixels.min():.3g})")
    return pixels


def _colors(values, kind, chromaticities):
    """Return a picture in linear sRGB, not negative, and notes. Raises BadData."""
    matrix = None
    if kind == "xyz":
        matrix = np.linalg.inv(srgb_to_xyz())
    elif chromaticities is not None:
        if np.shape(chromaticities) != (8,) or np.asarray(chromaticities).dtype.kind != "f":
            raise BadData("chromaticities: not (x, y) of red, green, blue and white")
        matrix = srgb_from_rgb(np.reshape(chromaticities, (4, 2)))
    with np.errstate(over="ignore", invalid="ignore"):
        if matrix is not None:
            values = np.einsum("ij,jkl->ikl", matrix.astype(np.float32), values)
        outside = draw_into_srgb(values)
    if not np.isfinite([values.min(), values.max()]).all():
        raise BadData("colours too large: not finite in sRGB")
    return values, [OUTSIDE.format(100 * outside)] if outside else []


def _size(header):
    """Return rows and columns of a part."""
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    return bottom - top + 1, right - left + 1


def write_spectral_exr(
    path, wavelengths, values, *, reflectance=False, half=False, more=None, **attributes
):
    """Write a spectral OpenEXR.

    wavelengths: [nm], shape (L,). values: shape (L, rows, cols), radiance [photon s-1 m-2 sr-1
    nm-1], written as S0 channels in W m-2 sr-1 nm-1; or, with `reflectance`, reflectance [1],
    written as T channels. half: use 16-bit floats. more: {name: plane (rows, cols)} of other
    channels, as 32-bit floats. attributes: further attributes of the header. Raises BadData and
    BadFile.
    """
    values = np.asarray(values)
    if values.ndim != 3 or len(values) != len(wavelengths) or values.size == 0:
        raise BadData(f"{path}: values {values.shape} do not match {len(wavelengths)} wavelengths")
    channels = {}
    for nm, plane in zip(wavelengths, values, strict=True):
        energy = 1.0 if reflectance else energy_per_photon(nm)
        name = ("T." if reflectance else "S0.") + f"{nm:.6f}nm".replace(".", ",")
        channels[name] = _to_floats(path, name, np.asarray(plane, np.float64) * energy, half)
    if len(channels) < len(values):
        why = f"{path}: wavelengths differ by less than 1e-6 nm, the resolution of channel names"
        raise BadData(why)
    channels |= {name: _to_floats(path, name, plane, False) for name, plane in (more or {}).items()}
    units = {} if reflectance else {"emissiveUnits": UNITS}
    _write(path, channels, spectralLayoutVersion="1.0", **units, **attributes)


def write_rgb_exr(path, rgb, *, half=False, display=DISPLAYS["srgb"]):
    """Write a linear picture, shape (rows, cols, 3), with the chromaticities of its display.

    Raises BadData and BadFile.
    """
    rgb = np.asarray(rgb)
    if rgb.ndim != 3 or rgb.shape[-1] != 3 or rgb.size == 0:
        raise BadData(f"{path}: a picture needs shape (rows, cols, 3), got {rgb.shape}")
    channels = {
        name: _to_floats(path, name, rgb[..., index], half) for index, name in enumerate("RGB")
    }
    _write(
        path, channels, chromaticities=tuple(np.ravel((*display.primaries, display.white)).tolist())
    )


def _to_floats(path, name, plane, half):
    """Return a plane as 16- or 32-bit floats; raise BadData if it does not fit."""
    if not np.isfinite([plane.min(), plane.max()]).all():
        raise BadData(f"{path}: channel {name!r}: NaN or infinite values")
    if half and np.abs(plane).max() > np.finfo(np.float16).max:
        largest = np.abs(plane).max()
        raise BadData(f"{path}: channel {name!r}: {largest:.3g} does not fit 16-bit floats (65504)")
    return np.ascontiguousarray(plane, np.float16 if half else np.float32)


def _write(path, channels, **attributes):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
            # OpenEXR does not report a full disk when it closes the file
            OpenEXR.File(str(temporary))
        except (RuntimeError, ValueError) as error:
            raise OSError(f"the disk may be full ({error})") from error
