"""Content of an OpenEXR file, derived from the names of its channels.

Spectral layouts: Fichet, Pacanowski & Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3),
2021; Indigo's technical reference ("Spectral Input and Output"). Passes: names of Blender and
Mitsuba 3.
"""

import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gpusim.domain.errors import BadFile, UnknownName

NUMBER = r"\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?"
BAND = re.compile(rf"(S0|T)\.({NUMBER})nm")
SPECTRAL = re.compile(r"(S0|T)\.\d")  # a band, also if the rest cannot be read
BISPECTRAL = re.compile(rf"T\.{NUMBER}nm\.{NUMBER}nm")
POLARISED = re.compile(r"S[123]\..+")
BUCKET = re.compile(r"wavelength(\d+(?:_\d+)?)")
UNEVEN = 0.01  # of a bucket's width: names have two decimals
PICTURE = re.compile(r"(|(?:.+\.)?Combined\.)R")  # layer of a colour picture
# gpusim's own labels, and Blender's passes of indices of objects and materials
LABEL = re.compile(r"label\.([A-Za-z_]\w*)|(?:.+\.)?Index(OB|MA)(?:\.\w+)?")
INDICES = {"OB": "instance", "MA": "material"}
DEPTH = re.compile(r"Z|(?:.+\.)?depth(?:\.\w+)?|(?:.+\.)?Depth(?:\.\w+)?")


def label_channels(names) -> dict[str, str]:
    """Return the channels of labels by the names of the labels: the first channel of each."""
    found: dict[str, str] = {}
    for channel in sorted(names):
        match = LABEL.fullmatch(channel)
        if match:
            found.setdefault(match[1] or INDICES[match[2]], channel)
    return found


@dataclass(frozen=True)
class Contents:
    """Kind and channels of a file.

    kind: "radiance", "reflectance", "rgb" or "xyz". channels: (name, wavelength [nm] or None), in
    order. unit: of radiance [W m-2 sr-1 nm-1]. depth: name of the channel of distances, or None;
    other_depths: further ones.
    """

    kind: str
    channels: list[tuple[str, float | None]]
    unit: float = 1.0
    depth: str | None = None
    other_depths: tuple[str, ...] = ()

    @property
    def is_picture(self) -> bool:
        """Whether the channels are colours, not wavelengths."""
        return self.kind in ("rgb", "xyz")


def contents(path, names, bands) -> Contents:
    """Return the content of a file.

    names: names of its channels. bands: {channel: wavelength [nm]} from the user; only these
    are then used. Raises BadFile, and UnknownName for a name in `bands`.
    """
    depths = [name for name in names if DEPTH.fullmatch(name) and name not in bands]
    depths.sort(key=lambda name: name != "Z")
    found = _picture(path, names, bands, depths)
    if found.kind == "xyz" and "Z" in depths:
        depths.remove("Z")
    return Contents(
        found.kind, found.channels, found.unit, depths[0] if depths else None, tuple(depths[1:])
    )


def _picture(path, names, bands, depths):
    for name in bands:
        if name not in names:
            raise UnknownName(f"channel of {path}", name, names)
    if bands:
        return Contents("radiance", _ascending(path, bands.items()))
    _require_intensity(path, names)
    found = _fichet(path, names) or _indigo(path, names) or _colors(path, names, depths)
    if found is None:
        listed = ", ".join(sorted(names)[:8])
        raise BadFile(
            path,
            "no spectral channels (S0.<wavelength>nm, T.<wavelength>nm, wavelength<nm>) and no picture "
            f"of only R, G, B; there are {listed}; give wavelengths with --band NAME=nm",
        )
    return found


def _require_intensity(path, names):
    """Raise BadFile for polarised light and bispectral reflectances."""
    for name in sorted(names):
        if POLARISED.fullmatch(name):
            raise BadFile(
                path,
                f"channel {name!r}: polarised light, which is not simulated; write the file without "
                "S1, S2 and S3, or name the channels of S0 with --band NAME=nm",
            )
        if BISPECTRAL.fullmatch(name):
            raise BadFile(
                path,
                f"channel {name!r}: bispectral (fluorescent) reflectance, which is not simulated; "
                "write the file without its T.<nm>.<nm> channels",
            )


def _fichet(path, names):
    matches = [(name, BAND.fullmatch(name)) for name in names if SPECTRAL.match(name)]
    for name, match in matches:
        if not match:
            raise BadFile(
                path,
                f"channel {name!r}: cannot be read; wanted S0.<wavelength>nm or T.<wavelength>nm "
                "(other units and frequencies are not supported)",
            )
    kinds = {match[1] for _, match in matches}
    if len(kinds) > 1:
        why = "holds both emissive (S0) and reflective (T) channels; write only one kind"
        raise BadFile(path, why)
    if not kinds:
        return None
    found = [(name, float(match[2].replace(",", "."))) for name, match in matches]
    return Contents("radiance" if kinds == {"S0"} else "reflectance", _ascending(path, found))


def _indigo(path, names):
    """Return Indigo's buckets, W m-2 sr-1 m-1, at their middle; names have the lower edges."""
    edges = [
        (name, float(match[1].replace("_", ".")))
        for name in names
        if (match := BUCKET.fullmatch(name))
    ]
    if not edges:
        return None
    edges = _ascending(path, edges)
    if len(edges) < 2:
        why = f"only one bucket ({edges[0][0]!r}) of unknown width; at least 2 are needed"
        raise BadFile(path, why)
    width = (edges[-1][1] - edges[0][1]) / (len(edges) - 1)
    if np.abs(np.diff([edge for _, edge in edges]) - width).max() > UNEVEN * width:
        raise BadFile(
            path,
            f"channels {edges[0][0]!r} .. {edges[-1][0]!r}: buckets of unequal width; wanted "
            "equally spaced edges",
        )
    return Contents("radiance", [(name, edge + width / 2) for name, edge in edges], unit=1e-9)


def _colors(path, names, depths):
    layers = sorted(match[1] for name in names if (match := PICTURE.fullmatch(name)))
    if "" in layers:
        layers = [""]  # the others are passes of this one
    if len(layers) > 1:
        shown = ", ".join(f"{layer}R" for layer in layers[:4])
        raise BadFile(path, f"{len(layers)} pictures ({shown} ...); wanted one")
    plain = {name for name in names if "." not in name} - set(depths) - set("RGBA")
    for kind, layer in [("rgb", layer) for layer in layers] or [("xyz", "")]:
        channels = [f"{layer}{letter}" for letter in kind.upper()]
        if set(channels) <= set(names) and not plain - set(channels):
            return Contents(kind, [(name, None) for name in channels])
    return None


def _ascending(path, channels):
    channels = sorted(channels, key=lambda channel: channel[1])
    for (one, first), (two, second) in pairwise(channels):
        if first == second:
            why = f"channels {one!r} and {two!r} have the same wavelength, {first:g} nm"
            raise BadFile(path, why)
    for name, nm in channels:
        if not 0 < nm < np.inf:
            raise BadFile(path, f"channel {name!r}: {nm:g} nm, wanted a positive wavelength")
    return channels
