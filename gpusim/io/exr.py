"""OpenEXR: spectral scenes in, spectral scenes and linear pictures out.

Layout of spectral files: Fichet, Pacanowski & Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3), 2021.
"""

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile, UnknownName
from gpusim.domain.memory import require_memory
from gpusim.domain.spectrum import LIGHT_SPEED, PLANCK
from gpusim.io.atomic import atomic_path
from gpusim.io.files import open_file, reading

BAND = re.compile(r"(S0|T)\.(\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?)nm")
SPECTRAL = re.compile(r"(S0|T)\.\d")  # meant to be a band, whether or not its name can be read
UNITS = "W.m^-2.sr^-1.nm^-1"


def read_exr(path, bands=None) -> tuple[str, np.ndarray | None, np.ndarray]:
    """Read a spectral or a linear sRGB OpenEXR file.

    bands: {channel: wavelength [nm]} for files that do not say the wavelength in the channel's name, such as
        Mitsuba's; these channels then are the spectral radiance, whatever other channels there are.
    Returns (kind, wavelengths, values), values float32 of shape (L, rows, cols):
    "radiance", wavelengths [nm], values [photon s-1 m-2 sr-1 nm-1], from channels S0.<wavelength>nm
        [W m-2 sr-1 nm-1]; the polarisation channels S1 to S3 are not read;
    "reflectance", wavelengths [nm], values [1], from channels T.<wavelength>nm;
    "rgb", None, linear values, from a file that has only R, G, B and perhaps A.
    Raises BadFile, UnknownName (a name in `bands`) and DoesNotFit.
    """
    import OpenEXR

    path = Path(path)
    open_file(path).close()  # OpenEXR opens it once more, by its name
    with reading(path, "an OpenEXR file"):
        parts = [part.header for part in OpenEXR.File(str(path), separate_channels=True, header_only=True).parts]
        sizes = [_size(header) for header in parts]
        names = [channel.name for channel in parts[0]["channels"]]
        deep = any("deep" in str(header.get("type")) for header in parts)
    if deep:
        raise BadFile(path, "deep data (several samples in a pixel); wanted a flat picture")
    kind, chosen = _choose(path, names, bands or {})
    rows, cols = sizes[0]
    # Every channel of every part is read, at worst as 4-byte numbers, and what was chosen is copied into the cube.
    stored = sum(len(header["channels"]) * math.prod(size) for header, size in zip(parts, sizes, strict=True))
    require_memory(f"{path}: {len(names)} channels of {cols} x {rows} pixels", 4 * (stored + len(chosen) * rows * cols))
    with reading(path, "an OpenEXR file whose pixels can be read"):
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
    values = np.empty((len(chosen), rows, cols), np.float32)
    for plane, (name, nm) in zip(values, chosen, strict=True):
        pixels = channels[name].pixels
        if pixels is None or pixels.shape != (rows, cols):
            raise BadFile(path, f"channel {name!r}: subsampled or damaged, wanted {cols} x {rows} pixels")
        if pixels.dtype.kind != "f":
            raise BadFile(path, f"channel {name!r}: {pixels.dtype}, wanted half or float")
        if not np.isfinite([pixels.min(), pixels.max()]).all():
            raise BadFile(path, f"channel {name!r}: NaN or infinite values")
        if pixels.min() < 0:
            raise BadFile(path, f"channel {name!r}: negative values (lowest {pixels.min():.3g})")
        plane[:] = pixels
        if kind == "radiance":
            plane *= nm * 1e-9 / (PLANCK * LIGHT_SPEED)
    return kind, None if kind == "rgb" else np.array([nm for _, nm in chosen]), values


def _size(header):
    """Rows and columns of a part."""
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    return bottom - top + 1, right - left + 1


def _choose(path, names, bands):
    """Return what the file holds, and its channels as (name, wavelength) in ascending wavelength."""
    for name in bands:
        if name not in names:
            raise UnknownName(f"channel of {path}", name, names)
    if bands:
        return "radiance", _ascending(path, bands.items())
    matches = [(name, BAND.fullmatch(name)) for name in names if SPECTRAL.match(name)]
    for name, match in matches:
        if not match:
            raise BadFile(path, f"channel {name!r}: cannot be read; wanted S0.<wavelength>nm or T.<wavelength>nm "
                                "(fluorescence and frequencies are not supported)")
    kinds = {match[1] for _, match in matches}
    if len(kinds) > 1:
        raise BadFile(path, "holds both emissive (S0) and reflective (T) channels, which cannot be told apart as light")
    if kinds:
        found = [(name, float(match[2].replace(",", "."))) for name, match in matches]
        return "radiance" if kinds == {"S0"} else "reflectance", _ascending(path, found)
    if {"R", "G", "B"} <= set(names) <= {"R", "G", "B", "A"}:
        return "rgb", [("R", None), ("G", None), ("B", None)]
    listed = ", ".join(sorted(names)[:8])
    raise BadFile(path, f"no spectral channels (S0.<wavelength>nm or T.<wavelength>nm); there are {listed}; "
                        "say their wavelengths with --band NAME=nm")


def _ascending(path, channels):
    channels = sorted(channels, key=lambda channel: channel[1])
    if len(channels) < 2:
        raise BadFile(path, f"only one spectral channel ({channels[0][0]!r}); at least 2 are needed")
    for (one, first), (two, second) in pairwise(channels):
        if first == second:
            raise BadFile(path, f"channels {one!r} and {two!r} have the same wavelength, {first:g} nm")
        if not 0 < first < second < np.inf:
            raise BadFile(path, f"channels {one!r} and {two!r}: {first:g} and {second:g} nm, wanted positive ones")
    return channels


def write_spectral_exr(path, wavelengths, values, *, reflectance=False, half=False, more=None, **attributes):
    """Write a spectral OpenEXR.

    wavelengths: [nm], shape (L,). values: shape (L, rows, cols), radiance [photon s-1 m-2 sr-1 nm-1], written as
    S0 channels in W m-2 sr-1 nm-1; or, with `reflectance`, reflectance [1], written as T channels. half: 16-bit floats.
    more: {name: plane (rows, cols)} of other channels, as 32-bit floats. attributes: of the header, besides.
    Raises BadData and BadFile.
    """
    values = np.asarray(values)
    if values.ndim != 3 or len(values) != len(wavelengths) or values.size == 0:
        raise BadData(f"{path}: values {values.shape} do not match {len(wavelengths)} wavelengths")
    channels = {}
    for nm, plane in zip(wavelengths, values, strict=True):
        energy = 1.0 if reflectance else PLANCK * LIGHT_SPEED / (nm * 1e-9)
        name = ("T." if reflectance else "S0.") + f"{nm:.6f}nm".replace(".", ",")
        channels[name] = _narrowed(path, name, np.asarray(plane, np.float64) * energy, half)
    if len(channels) < len(values):
        raise BadData(f"{path}: wavelengths nearer to each other than the 1e-6 nm that channels' names tell apart")
    channels |= {name: _narrowed(path, name, plane, False) for name, plane in (more or {}).items()}
    units = {} if reflectance else {"emissiveUnits": UNITS}
    _write(path, channels, spectralLayoutVersion="1.0", **units, **attributes)


def write_rgb_exr(path, rgb, *, half=False, display=DISPLAYS["srgb"]):
    """Write a linear picture, shape (3, rows, cols), with the chromaticities of the display that it is for.

    Raises BadData and BadFile.
    """
    rgb = np.asarray(rgb)
    if rgb.ndim != 3 or len(rgb) != 3 or rgb.size == 0:
        raise BadData(f"{path}: a picture needs shape (3, rows, cols), got {rgb.shape}")
    channels = {name: _narrowed(path, name, plane, half) for name, plane in zip("RGB", rgb, strict=True)}
    _write(path, channels, chromaticities=tuple(np.ravel((*display.primaries, display.white)).tolist()))


def _narrowed(path, name, plane, half):
    if not np.isfinite([plane.min(), plane.max()]).all():
        raise BadData(f"{path}: channel {name!r}: NaN or infinite values")
    if half and np.abs(plane).max() > np.finfo(np.float16).max:
        raise BadData(f"{path}: channel {name!r}: {np.abs(plane).max():.3g} does not fit 16-bit floats (65504)")
    return np.ascontiguousarray(plane, np.float16 if half else np.float32)


def _write(path, channels, **attributes):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
            OpenEXR.File(str(temporary))  # what does not fit the disk as the file is closed is lost without a word
        except (RuntimeError, ValueError) as error:
            raise OSError(f"the disk may be full ({error})") from error
