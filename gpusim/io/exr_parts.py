"""Parts, views and attributes of OpenEXR files.

Sources: OpenEXR's documentation: "Technical Introduction", "The OpenEXR File Layout", "Multi-View
OpenEXR", "Standard Attributes"; names of attributes as renderers and OpenImageIO write them.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gpusim.domain.errors import BadFile, UnknownName, format_value, one_line
from gpusim.io.account import Fields, note_of
from gpusim.io.exr_channels import ALPHAS, DEPTH, MAIN, Channel

SQUARE = 1e-4  # largest relative difference of the sides of a square pixel
STEREO = ("left", "right")  # views of files that do not list them
# attributes of the file's structure, and those about its making
STRUCTURE = (
    "channels compression dataWindow displayWindow lineOrder type chunkCount version name view "
    "multiView tiles pixelAspectRatio gpusimScene spectralLayoutVersion maxSamplesPerPixel "
    "dwaCompressionLevel zipCompressionLevel preview idManifest"
).split()
MAKING = (
    "owner comments capDate utcOffset Software software author Artist Copyright generatedBy log "
    "Date Time DateTime File Frame RenderTime Scene Camera Memory Hostname Note Marker Strip "
    "HostComputer DocumentName ImageDescription Make Model timeCode framesPerSecond keyCode "
    "imageCounter reelName xDensity XResolution YResolution ResolutionUnit wrapmodes textureformat "
    "fovcot BlenderMultiChannel cycles.* Exif:* IPTC:* GPS:* nuke/* input/* arnold/* vrayInfo/* "
    "cryptomatte/* oiio:* openexr:* capturingSoftwareName capturingSoftwareVersion camera* lens* "
    "isoSpeed expTime aperture tStop focus focalLength nominalFocalLength shutterAngle writer "
    "renderTimeSeconds samplesPerPixel compressionRatio"
).split()
# primaries and white of colour spaces by their names, which files without `chromaticities` may have
D65, D60 = (0.3127, 0.3290), (0.32168, 0.33767)
AP0 = ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077), D60)
AP1 = ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), D60)
REC709 = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060), D65)
SPACES = {
    **dict.fromkeys(
        ("lin_rec709_scene", "lin_rec709", "lin_srgb", "linear", "scene_linear"), REC709
    ),
    **dict.fromkeys(("lin_ap0_scene", "lin_ap0", "aces2065-1"), AP0),
    **dict.fromkeys(("lin_ap1_scene", "lin_ap1", "acescg"), AP1),
    **dict.fromkeys(
        ("lin_rec2020_scene", "lin_rec2020"),
        ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    ),
    **dict.fromkeys(
        ("lin_p3d65_scene", "lin_p3d65"), ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65)
    ),
    "lin_adobergb_scene": ((0.640, 0.330), (0.210, 0.710), (0.150, 0.060), D65),
}
UNKNOWN_SPACES = ("", "data", "raw", "unknown")
ENCODED = re.compile(
    r"(?i)(srgb|g\d\d|gamma|pq|hlg|st2084)[ _].*|srgb"
)  # names of spaces with a curve
PER_NM = re.compile(r"W\.?m\^?-2\.?sr\^?-1(\.?nm\^?-1)?")  # units of Fichet et al.


Window = tuple[int, int, int, int]  # top, left, bottom, right; the last two are exclusive


@dataclass(frozen=True)
class Part:
    """A part of a file.

    view: "" is none; views: those that the file lists. aspect: width of a pixel over its height.
    window: pixels that are stored. display: the frame. channels: their names. header: all
    attributes.
    """

    number: int
    name: str
    view: str
    views: tuple[str, ...]
    aspect: float
    window: Window
    display: Window
    channels: tuple[str, ...]
    header: Mapping[str, Any]

    @classmethod
    def of(cls, number: int, header: Mapping[str, Any]) -> "Part":
        """Return a part by its header. Raises any error for one that is damaged."""
        name, view = (str(header.get(key, "")) for key in ("name", "view"))
        views = tuple(str(one) for one in header.get("multiView", ()))
        windows = []
        for key in ("dataWindow", "displayWindow"):
            (left, top), (right, bottom) = (corner.tolist() for corner in header[key])
            windows.append((top, left, bottom + 1, right + 1))
        names = tuple(channel.name for channel in header["channels"])
        aspect = float(header["pixelAspectRatio"])
        return cls(number, name, view, views, aspect, windows[0], windows[1], names, header)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the pixels that are stored."""
        top, left, bottom, right = self.window
        return bottom - top, right - left

    @property
    def is_deep(self) -> bool:
        """Whether a pixel has several samples."""
        return "deep" in str(self.header.get("type"))


def choose_parts(path, parts: list[Part], part: int | str | None) -> list[Part]:
    """Return the part of a name or number, or all parts with the frame of the first.

    Raises UnknownName.
    """
    if part is None:
        return [one for one in parts if one.display == parts[0].display]
    for key in ("name", "number"):
        for one in parts:
            if str(getattr(one, key)) == str(part):
                return [one]
    known = [*(one.name for one in parts if one.name), *(str(one.number) for one in parts)]
    raise UnknownName(f"part of {path}", str(part), known)


def choose_view(
    path, parts: list[Part], view: str | None
) -> tuple[list[Channel], str, tuple[str, ...]]:
    """Return the channels of a view, its name ("" if it has none), and the names of the others.

    A channel of one word belongs to the first view that the file lists, and one of several words
    without a view belongs to all. view: name, or None for the first. Raises UnknownName.
    """
    listed = parts[0].views
    if not listed and not any(part.view for part in parts) and len(parts) > 1:
        parts = [replace(part, view=_stereo(part.name)) for part in parts]
    marked = {*listed, *(part.view for part in parts if part.view)}
    found = [
        (part, name, *_split(name, marked or set(STEREO)))
        for part in parts
        for name in part.channels
    ]
    seen = {part.view or own for part, _, own, _ in found} - {""}
    views = [*dict.fromkeys(listed), *(one for one in sorted(seen) if one not in listed)]
    if not listed and any(part.view for part in parts):
        views.sort(key=[part.view for part in parts if part.view].index)
    # the picture of a file that lists no views, next to those of left and right
    is_plain = not marked and any(
        "." not in name and not DEPTH.fullmatch(name) and name not in ALPHAS
        for _, name, _, _ in found
    )
    first = "" if is_plain or not views else views[0]
    if view is not None and not views:
        raise BadFile(path, f"view = {format_value(view)}: it has no views; leave view out")
    if view is not None and view not in views:
        raise UnknownName(f"view of {path}", view, views)
    chosen = first if view is None else view
    own_first = sorted(
        (
            (part, name, plain)
            for part, name, own, plain in found
            if _is_seen(part.view or own, name, chosen, first, bool(listed) or is_plain)
        ),
        key=lambda one: one[1] == one[2],
    )
    return _in_layers(own_first, chosen), chosen, tuple(one for one in views if one != chosen)


def _stereo(name: str) -> str:
    """Return the view, left or right, that a part's name begins or ends with; "" is none."""
    words = re.split(r"[._ ]", name)
    return next((word for word in (words[-1], words[0]) if word in STEREO), "")


def _is_seen(own, name, chosen, first, is_first_plain):
    """Return whether a channel belongs to the chosen view, or to all views."""
    if own:
        return own == chosen
    return "." in name or not is_first_plain or chosen == first


def _split(name: str, views: set[str]) -> tuple[str, str]:
    """Return the view in a channel's name, "" if there is none, and the name without it."""
    words = name.split(".")
    for place in (-2, 0):
        if len(words) > 1 and words[place] in views:
            own = words.pop(place)
            return own, ".".join(words)
    return "", name


def _in_layers(found, view) -> list[Channel]:
    """Return channels with their layers. found: (part, name, name without view) of each.

    Channels of one word in another part than the main one are of the layer with the part's name.
    """
    parts = list(dict.fromkeys(part.number for part, _, _ in found))
    names = {part.number: _layer_of(part, view) for part, _, _ in found}
    main = [number for number in parts if names[number].rpartition(".")[2].lower() in MAIN]
    root = main[0] if len(main) == 1 else parts[0] if parts and not main else None
    return [
        Channel(
            part.number,
            name,
            plain,
            plain.rpartition(".")[0] or ("" if part.number == root else names[part.number]),
        )
        for part, name, plain in found
    ]


def _layer_of(part, view):
    """Return the layer that a part is: its name without its view."""
    words = re.split(r"([._ ])", part.name)
    if view in words[-1:]:
        words = words[:-2]
    elif view in words[:1]:
        words = words[2:]
    return "".join(words) or str(part.number)


@dataclass(frozen=True)
class Frame:
    """The frame of a file, its display window, and the pixels of a part in it.

    shape: rows and columns of the frame. window, display: see Part.
    """

    shape: tuple[int, int]
    window: Window
    display: Window

    @classmethod
    def of(cls, path, part: Part) -> "Frame":
        """Return the frame of a part. Raises BadFile for pixels that are not square."""
        if not abs(part.aspect - 1) <= SQUARE:
            raise BadFile(
                path,
                f"pixelAspectRatio = {part.aspect:g}: pixels that are not square; resample the picture "
                f"to {'more' if part.aspect > 1 else 'fewer'} columns, with a ratio of 1",
            )
        top, left, bottom, right = part.display
        return cls((bottom - top, right - left), part.window, part.display)

    @property
    def _inside(self) -> Window:
        """The part of the window inside the frame, as Part's windows."""
        window, display = self.window, self.display
        near = [max(one, other) for one, other in zip(window[:2], display[:2], strict=True)]
        far = [min(one, other) for one, other in zip(window[2:], display[2:], strict=True)]
        return near[0], near[1], far[0], far[1]

    def require_overlap(self, path) -> None:
        """Raise BadFile if no pixel of the window lies in the frame."""
        top, left, bottom, right = self._inside
        if top >= bottom or left >= right:
            why = "its data window has no pixel in its display window; write it with both the same"
            raise BadFile(path, why)

    def place(self, pixels: np.ndarray) -> np.ndarray:
        """Return the frame with the pixels of the window, 0 outside them."""
        if self.window == self.display:
            return pixels
        top, left, bottom, right = self._inside
        placed = np.zeros(self.shape, pixels.dtype)
        y, x = self.window[:2]
        if bottom > top and right > left:
            placed[
                top - self.display[0] : bottom - self.display[0],
                left - self.display[1] : right - self.display[1],
            ] = pixels[top - y : bottom - y, left - x : right - x]
        return placed

    def notes(self) -> list[str]:
        """Return notes on pixels that the frame lacks, and on those that are not in it."""
        if self.window == self.display:
            return []
        top, left, bottom, right = self.window
        inside = self._inside
        held = (inside[2] - inside[0]) * (inside[3] - inside[1])
        rows, cols = self.shape
        where = (
            f"pixels of the data window, {right - left} x {bottom - top} from column "
            f"{left - self.display[1]}, row {top - self.display[0]} of the display window, which is the "
            f"frame of {cols} x {rows}"
        )
        changes = ["black outside"] * (held < rows * cols)
        changes += ["cut at the frame"] * (held < (bottom - top) * (right - left))
        return [f"{where}: {', '.join(changes)}"]


def note_parts(parts: list[Part], used: set[int], views: tuple[str, ...], view: str) -> list[str]:
    """Return notes on parts of which nothing is used, and on views that were not chosen."""
    others = [
        one.name or str(one.number)
        for one in parts
        if one.number not in used and (one.view or _stereo(one.name)) not in views
    ]
    shown = f"view {view!r} is used; not used" if view else "views not used"
    return [*note_of("parts not used", others), *note_of(shown, views)]


class Attributes(Fields):
    """The attributes of the parts that are used, checked when they are taken."""

    def __init__(self, path, parts: list[Part]):
        merged: dict[str, Any] = {}
        for part in parts:
            for name, value in part.header.items():
                merged.setdefault(name, value)
        super().__init__(merged, "attributes not used")
        self.path = path
        self.ignore(*STRUCTURE, *MAKING)
        # the projection of a renderer, which says nothing at its default
        for name, default in (("screenWindowCenter", [0, 0]), ("screenWindowWidth", [1])):
            if np.array_equal(np.ravel(merged.get(name, ())), default):
                self.ignore(name)

    def chromaticities(self):
        """Return (x, y) of red, green, blue and white, (4, 2), or None. Raises BadFile.

        They are the attribute's, or those of the colour space that is named.
        """
        space = self._space()
        stored = self.take("chromaticities")
        if stored is not None:
            if np.shape(stored) != (8,) or np.asarray(stored).dtype.kind != "f":
                why = "chromaticities: not (x, y) of red, green, blue and white"
                raise BadFile(self.path, why)
            found = np.reshape(np.asarray(stored, np.float64), (4, 2))
        else:
            found = None if space is None else np.array(space)
        white = D65 if found is None else found[3]
        neutral = self._values.get("adoptedNeutral")
        if np.shape(neutral) == (2,) and np.allclose(neutral, white, atol=1e-3):
            self.ignore("adoptedNeutral")
        return found

    def _space(self):
        """Return the primaries and the white of a colour space that is named, or None."""
        if str(self.take("acesImageContainerFlag")) == "1":
            return AP0
        for key in ("colorInteropID", "oiio:ColorSpace"):
            name = str(self.take(key, "")).strip().lower()
            if name in SPACES:
                return SPACES[name]
            if ENCODED.fullmatch(name):
                raise BadFile(
                    self.path,
                    f"{key} = {format_value(name)}: encoded values; wanted values proportional to light",
                )
            if name not in UNKNOWN_SPACES:
                self._done.discard(key)  # a space that is not known is not used
        return None

    def white(self) -> float | None:
        """Return the luminance of (1, 1, 1) [cd/m2], or None. Raises BadFile."""
        white = self.take("whiteLuminance")
        if white is None:
            return None
        if not (isinstance(white, float | int) and 0 < white < math.inf):
            why = f"whiteLuminance = {format_value(white)}: wanted cd/m2 above 0; or give luminance"
            raise BadFile(self.path, why)
        return float(white)

    def is_panorama(self) -> bool:
        """Return whether it is an environment of longitudes and latitudes. Raises BadFile."""
        envmap = one_line(self.take("envmap", "")).upper()
        if "CUBE" in envmap:
            raise BadFile(
                self.path,
                "envmap = cube: six faces of a cube; convert it to longitudes and latitudes (exrenvmap "
                "-latlong)",
            )
        return "LATLONG" in envmap

    def require_units(self) -> None:
        """Raise BadFile for radiance of another unit than W m-2 sr-1 nm-1."""
        unit = self.take("emissiveUnits")
        if unit is not None and not PER_NM.fullmatch("".join(str(unit).split())):
            raise BadFile(
                self.path,
                f"emissiveUnits = {format_value(str(unit))}: wanted W.m^-2.sr^-1.nm^-1; convert it, or "
                "name the channels with --band NAME=nm",
            )

    def orientation(self) -> int:
        """Return the orientation, 1 .. 8 as in TIFF. 1 if there is none."""
        turn = self.take("Orientation", 1)
        return turn if isinstance(turn, int) and 1 <= turn <= 8 else 1
