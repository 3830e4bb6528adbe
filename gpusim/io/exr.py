"""OpenEXR: reads spectral scenes, writes spectral scenes and linear pictures.

The names of the channels are interpreted by `exr_channels`.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from gpusim.data.srgb import draw_into_srgb, srgb_from_rgb, srgb_to_xyz
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile
from gpusim.domain.memory import require_memory
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.account import note_of
from gpusim.io.atomic import atomic_path
from gpusim.io.exr_channels import Channel, Contents, contents
from gpusim.io.exr_chroma import rgb_from_chroma
from gpusim.io.exr_parts import (
    Attributes,
    Frame,
    Part,
    choose_parts,
    choose_view,
    note_parts,
)
from gpusim.io.files import name_in_errors, open_file, reading
from gpusim.io.orientation import turn

UNITS = "W.m^-2.sr^-1.nm^-1"
SRGB = np.array((*DISPLAYS["srgb"].primaries, DISPLAYS["srgb"].white))
PLANES_OF_COLORS = 9  # extra planes held during the conversion to sRGB
SPECTRA = 2 * 43 * 8  # [byte] a pixel of a line, whose spectra are checked
OUTSIDE = (
    "colours outside sRGB, which have no reflectance here: {:.2g} % of the samples, moved towards grey of "
    "the same luminance until they fit"
)


@dataclass(frozen=True, eq=False)
class Exr:
    """Content of an OpenEXR file.

    kind: "radiance", values [photon s-1 m-2 sr-1 nm-1]; "reflectance", values [1]; "rgb", linear
    sRGB, white 1; or "grey", one plane, white 1. wavelengths: [nm], None for pictures. values:
    float32, shape (L, rows, cols). depth_channel, depth: name and stored distances, shape (rows,
    cols), or None. notes: values that were changed or not read. labels: maps of whole numbers by
    name, int32, shape (rows, cols). white: luminance of white [cd/m2], or None. is_panorama:
    whether the pixels are longitudes and latitudes.
    """

    kind: str
    wavelengths: np.ndarray | None
    values: np.ndarray
    depth_channel: str | None
    depth: np.ndarray | None
    notes: tuple[str, ...]
    labels: dict[str, np.ndarray]
    white: float | None
    is_panorama: bool


def read_exr(
    path,
    bands=None,
    *,
    depth: bool = True,
    part: int | str | None = None,
    layer: str | None = None,
    view: str | None = None,
) -> Exr:
    """Read a spectral or a linear RGB OpenEXR file, and its depth.

    Channels read are S0.<wavelength>nm [W m-2 sr-1 nm-1], T.<wavelength>nm (reflectance), Indigo's
    wavelength<edge> [W m-2 sr-1 m-1] at the middle of each bucket; otherwise a picture of R, G, B,
    of X, Y, Z, of Y, RY, BY (luminance and chroma), or of Y (grey). A picture in a layer is found
    if it is the only one, or the only one named Combined, beauty, rgba or the like. RGB of other
    primaries (`chromaticities`, `colorInteropID`) becomes linear sRGB, its white adapted
    (Bradford): (1, 1, 1) stays white; XYZ is kept. Polarised and bispectral files are refused.

    The display window is the frame: pixels that are not stored are black, those outside are cut.
    The channels of all parts with the same frame go together. Whatever is not used is in the notes.

    bands: {channel: wavelength [nm]} for files without wavelengths in the names, for example
    Mitsuba's; only these channels are then read, as spectral radiance [W m-2 sr-1 nm-1]. depth:
    read a channel of distances: Z, depth, Depth.Z (Blender), depth.T (Mitsuba's AOV). part: name or
    number (from 0) of the only part to read. layer: name of the picture's layer. view: name of the
    view; None is the file's first. Labels are channels label.NAME, and Blender's IndexOB
    ("instance") and IndexMA ("material").

    Raises BadFile, UnknownName (a band's, part's, layer's or view's name) and DoesNotFit.
    """
    path = Path(path)
    parts = _parts(path)
    chosen = choose_parts(path, parts, part)
    channels, view, others = choose_view(path, chosen, view)
    held = contents(path, channels, bands or {}, layer)
    frames = {one.number: Frame.of(path, one) for one in chosen}
    home = frames[held.channels[0][0].part]
    home.require_overlap(path)
    used = [*(one for one, _ in held.channels), *held.labels.values()]
    used += [held.depth] if depth and held.depth else []
    attributes = Attributes(path, [parts[n] for n in sorted({one.part for one in used})])
    is_panorama, white = attributes.is_panorama(), None
    if held.is_picture:
        white = attributes.white()
    elif held.kind == "radiance" and held.unit == 1 and not bands:
        attributes.require_units()
    rows, cols = home.shape
    # Every channel of every part is read, at worst as 4-byte numbers; the cube is a copy.
    stored = sum(len(one.channels) * math.prod(one.size) for one in parts)
    copied = len(used) + (PLANES_OF_COLORS if held.is_picture else 1)
    needed = 4 * (stored + copied * rows * cols) + SPECTRA * held.is_picture * max(rows, cols)
    rows, cols = max(home.shape, *(one.size for one in parts), key=math.prod)
    require_memory(f"{path}: {len(channels)} channels of {cols} x {rows} pixels", needed)
    pixels = _Pixels(path, parts, _read(path), frames, attributes.orientation())
    with name_in_errors(path):
        values, notes = (_picture if held.is_picture else _bands)(held, pixels, attributes)
    distances, said = None, []
    if depth and held.depth:
        if is_panorama:
            said = [f"channel {held.depth.name!r}: distances of a panorama are not used"]
        else:
            distances = pixels.frame(held.depth, pixels.numbers(held.depth))
        said += note_of(f"depth is channel {held.depth.name!r}; not read", held.names_of_depths)
    return Exr(
        {"xyz": "rgb", "yc": "rgb"}.get(held.kind, held.kind),
        None if held.is_picture else np.array([nm for _, nm in held.channels]),
        values,
        None if distances is None or held.depth is None else held.depth.name,
        distances,
        (
            *home.notes(),
            *notes,
            *said,
            *held.notes(),
            *note_parts(parts, {one.part for one in channels}, others, view),
            *attributes.notes(),
        ),
        {name: pixels.frame(one, pixels.whole_numbers(one)) for name, one in held.labels.items()},
        white,
        is_panorama,
    )


def _parts(path) -> list[Part]:
    """Return the parts of a file by their headers. Raises BadFile."""
    import OpenEXR

    open_file(path).close()  # OpenEXR opens it again by its name
    with reading(path, "an OpenEXR file"):
        file = OpenEXR.File(str(path), separate_channels=True, header_only=True)
        parts = [Part.of(number, one.header) for number, one in enumerate(file.parts)]
    if any(one.is_deep for one in parts):
        raise BadFile(path, "deep data (several samples in a pixel); write a flat picture")
    return parts


def _read(path) -> list[dict]:
    """Return the channels of each part by name. Raises BadFile."""
    import OpenEXR

    with reading(path, "an OpenEXR file whose pixels can be read"):
        return [one.channels for one in OpenEXR.File(str(path), separate_channels=True).parts]


@dataclass(frozen=True)
class _Pixels:
    """The pixels of a file that was read.

    read: channels of each part by name. frames: by the number of a part. orientation: of the frame.
    """

    path: Path
    parts: list[Part]
    read: list[dict]
    frames: dict[int, Frame]
    orientation: int

    def shape_of(self, frame: Frame) -> tuple[int, int]:
        """Return rows and columns of a frame in its orientation."""
        return frame.shape[::-1] if self.orientation > 4 else frame.shape

    def frame(self, channel: Channel, pixels: np.ndarray) -> np.ndarray:
        """Return the frame with the pixels of a channel's data window."""
        return turn(self.frames[channel.part].place(pixels), self.orientation)

    def stored(self, channel: Channel, is_halved: bool = False) -> np.ndarray:
        """Return the numbers of a channel; is_halved: it may have every second row and column."""
        # OpenEXR does not find all parts and channels that it lists
        held = self.read[channel.part] if channel.part < len(self.read) else {}
        found = held.get(channel.name)
        pixels = getattr(found, "pixels", None)
        wanted = self.parts[channel.part].size
        steps = (getattr(found, "ySampling", 0), getattr(found, "xSampling", 0))
        if pixels is not None and {*steps} <= ({1, 2} if is_halved else {1}):
            # modules before OpenEXR 3.5.3 return arrays of the full size, whose numbers are wrong
            if pixels.shape == tuple(-(-n // step) for n, step in zip(wanted, steps, strict=True)):
                return pixels
        self.refuse(channel, f"subsampled or damaged, wanted {wanted[1]} x {wanted[0]} pixels")

    def numbers(self, channel: Channel, is_halved: bool = False) -> np.ndarray:
        """Return the floats of a channel."""
        pixels = self.stored(channel, is_halved)
        if pixels.dtype.kind != "f":
            self.refuse(channel, f"{pixels.dtype}, wanted half or float")
        return pixels

    def finite(self, channel: Channel, is_halved: bool = False) -> np.ndarray:
        """Return the finite floats of a channel."""
        pixels = self.numbers(channel, is_halved)
        if not np.isfinite([pixels.min(), pixels.max()]).all():
            self.refuse(channel, "NaN or infinite values")
        return pixels

    def light(self, channel: Channel) -> np.ndarray:
        """Return the floats of a channel, finite and not negative."""
        pixels = self.finite(channel)
        if pixels.min() < 0:
            self.refuse(channel, f"negative values (lowest {pixels.min():.3g})")
        return pixels

    def whole_numbers(self, channel: Channel) -> np.ndarray:
        """Return the whole numbers of a channel, int32."""
        pixels = self.stored(channel)
        with np.errstate(invalid="ignore"):
            is_whole = (
                np.isfinite(pixels) & (np.abs(pixels) < 2.0**31) & (pixels == np.rint(pixels))
            )
        if not is_whole.all():
            self.refuse(channel, "a label, wanted whole numbers below 2^31")
        return pixels.astype(np.int32)

    def refuse(self, channel: Channel, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, f"channel {channel.name!r}: {why}")


def _bands(held: Contents, pixels: _Pixels, attributes) -> tuple[np.ndarray, list[str]]:
    """Return the planes of a spectral file, and no notes. Raises BadFile."""
    frame = pixels.frames[held.channels[0][0].part]
    values = np.empty((len(held.channels), *pixels.shape_of(frame)), np.float32)
    for plane, (one, nm) in zip(values, held.channels, strict=True):
        plane[:] = pixels.frame(one, pixels.light(one))
        if held.kind == "radiance":
            plane *= held.unit / energy_per_photon(nm)
    return values, []


def _picture(held: Contents, pixels: _Pixels, attributes: Attributes):
    """Return a picture, linear sRGB or grey, not negative, and notes. Raises BadData, BadFile."""
    channels = [one for one, _ in held.channels]
    chromaticities = attributes.chromaticities()
    matrix = None
    if held.kind == "xyz":
        matrix = np.linalg.inv(srgb_to_xyz())
    elif chromaticities is not None:
        matrix = srgb_from_rgb(chromaticities)
    if held.kind == "yc":
        primaries = SRGB if chromaticities is None else chromaticities
        luminance, red, blue = (pixels.finite(one, True) for one in channels)
        planes = list(rgb_from_chroma(luminance, red, blue, primaries))
    else:
        planes = [pixels.finite(one) for one in channels]
    frame = pixels.frames[channels[0].part]
    values = np.empty((len(channels), *pixels.shape_of(frame)), np.float32)
    for plane, one, found in zip(values, channels, planes, strict=True):
        plane[:] = pixels.frame(one, found)
    with np.errstate(over="ignore", invalid="ignore"):
        if held.kind == "grey":
            below = float((values < 0).mean())
            np.maximum(values, 0, out=values)
            notes = [f"negative values, {100 * below:.2g} % of them: taken as 0"] if below else []
        else:
            if matrix is not None:
                values = np.einsum("ij,jkl->ikl", matrix.astype(np.float32), values)
            outside = draw_into_srgb(values)
            notes = [OUTSIDE.format(100 * outside)] if outside else []
    if not np.isfinite([values.min(), values.max()]).all():
        raise BadData("colours too large: not finite in sRGB")
    if held.alpha and pixels.finite(held.alpha).min() < 1:
        notes.append(f"channel {held.alpha.name!r}: what is transparent is dark behind")
    return values, notes


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
