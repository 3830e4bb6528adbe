"""Content of an OpenEXR file, derived from the names of its channels.

A name is layer.channel, a layer possibly of several words. A part without dots in its channels is
a layer by itself. Views (stereo) are taken out before, see `exr_parts`.

Spectral layouts: Fichet, Pacanowski & Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3),
2021; Indigo's technical reference ("Spectral Input and Output"). Passes: names of Blender, Mitsuba
3, Nuke, Arnold and V-Ray.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from gpusim.domain.errors import BadFile, UnknownName, one_line
from gpusim.io.account import note_of

NUMBER = r"\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?"
BAND = re.compile(rf"(S0|T)\.({NUMBER})nm")
SPECTRAL = re.compile(r"(S0|T)\.\d")  # a band, also if the rest cannot be read
BISPECTRAL = re.compile(rf"T\.{NUMBER}nm\.{NUMBER}nm")
POLARISED = re.compile(r"S[123]\..+")
BUCKET = re.compile(r"wavelength(\d+(?:_\d+)?)")
UNEVEN = 0.01  # of a bucket's width: names have two decimals
# gpusim's own labels, and Blender's passes of indices of objects and materials
LABEL = re.compile(r"label\.([A-Za-z_]\w*)|(?:.+\.)?Index(OB|MA)(?:\.\w+)?")
INDICES = {"OB": "instance", "MA": "material"}
DEPTH = re.compile(r"Z|(?:.+\.)?depth(?:\.\w+)?|(?:.+\.)?Depth(?:\.\w+)?")
IDS = re.compile(r"(?i)(?:.+\.)?u?crypto\w*(?:\..+)?")  # Cryptomatte's layers of object ids
PASS = re.compile(r"(?i)depth|index(ob|ma)|label")  # last words of layers of passes
# last word of the layer or part that is the picture itself, among passes
MAIN = ("combined", "beauty", "rgba", "rgb", "main", "c")
COLOURS = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"}
ALPHAS = ("A", "a", "alpha", "Alpha")
# colours of each kind of picture, in the order in which they are looked for
KINDS = {"rgb": ("R", "G", "B"), "xyz": ("X", "Y", "Z"), "yc": ("Y", "RY", "BY"), "grey": ("Y",)}


@dataclass(frozen=True)
class Channel:
    """A channel of a file.

    part: number of its part. name: name in the file. plain: the name without its view. layer:
    name of its layer, "" is none.
    """

    part: int
    name: str
    plain: str
    layer: str

    @property
    def letter(self) -> str:
        """The last word of the name."""
        return self.plain.rpartition(".")[2]

    @property
    def place(self) -> str:
        """The layer, or the name of a channel without a layer: a name for a list."""
        return self.layer or self.plain


@dataclass(frozen=True)
class Contents:
    """Kind and channels of a file.

    kind: "radiance", "reflectance", "rgb", "xyz", "yc" (luminance, and chroma of a quarter of the
    pixels) or "grey". channels: with a wavelength [nm] or None each, in order. unit: of radiance
    [W m-2 sr-1 nm-1]. depth: channel of distances, or None; other_depths: further ones. labels:
    channels of labels by name. alpha: of a picture. unused: all others.
    """

    kind: str
    channels: list[tuple[Channel, float | None]]
    unit: float = 1.0
    depth: Channel | None = None
    other_depths: tuple[Channel, ...] = ()
    labels: dict[str, Channel] = field(default_factory=dict)
    alpha: Channel | None = None
    unused: tuple[Channel, ...] = ()

    @property
    def is_picture(self) -> bool:
        """Whether the channels are colours, not wavelengths."""
        return self.kind in KINDS

    @property
    def names_of_depths(self) -> list[str]:
        """Names of the channels of distances that are not used."""
        return [one.name for one in self.other_depths]

    def notes(self) -> list[str]:
        """Return notes on the layers and channels that are not used."""
        places = dict.fromkeys(one.place for one in self.unused)
        ids = [one for one in places if IDS.fullmatch(one)]
        others = [one for one in places if one not in ids]
        return [
            *note_of("object ids (Cryptomatte) not used", ids),
            *note_of("channels not used", others),
        ]


def contents(path, channels: list[Channel], bands, layer: str | None = None) -> Contents:
    """Return the content of a file.

    bands: {channel: wavelength [nm]} from the user; only these are then used. layer: the layer of
    the picture, or None. Raises BadFile, and UnknownName for a name in `bands` or the layer.
    """
    free = [one for one in channels if one.name not in bands]
    names = {(one.layer, one.plain) for one in channels}
    depths = [
        one
        for one in free
        if (DEPTH.fullmatch(one.plain) or DEPTH.fullmatch(one.layer))
        # the last of three coordinates is none
        and not (one.plain == "Z" and {(one.layer, "X"), (one.layer, "Y")} <= names)
    ]
    found = _picture(path, channels, bands, layer, depths)
    used = [one for one, _ in found.channels]
    home = used[0].layer if found.is_picture else ""
    depths = _nearest_first([one for one in depths if one not in used], home)
    labels: dict[str, Channel] = {}
    for one in _nearest_first([one for one in free if LABEL.fullmatch(one.plain)], home):
        match = LABEL.fullmatch(one.plain)
        assert match
        labels.setdefault(match[1] or INDICES[match[2]], one)
    alpha = next((one for one in free if one.layer == home and one.letter in ALPHAS), None)
    alpha = alpha if found.is_picture else None
    known = [*used, alpha, *depths, *labels.values()]
    return Contents(
        found.kind,
        found.channels,
        found.unit,
        depths[0] if depths else None,
        tuple(depths[1:]),
        labels,
        alpha,
        tuple(one for one in channels if one not in known),
    )


def _nearest_first(channels: list[Channel], home: str) -> list[Channel]:
    """Sort the passes of a picture: its layer's first, then those without a layer.

    Passes of another layer are left out if the picture has a layer: they show something else.
    """
    base = _base(home)
    own = [
        one for one in channels if not home or f"{base}.".startswith(f"{_above(one)}.".lstrip("."))
    ]

    def order(one):
        return _above(one) != base, _above(one) != "", one.plain != "Z", one.plain

    return sorted(own, key=order)


def _above(one: Channel) -> str:
    """Return the layer to which a pass belongs, of which the last word is its own name."""
    above, _, word = one.layer.rpartition(".")
    return above if "." not in one.plain or PASS.fullmatch(word) else one.layer


def _base(layer: str) -> str:
    """Return a layer without its last word, if that says that it is the picture."""
    above, _, word = layer.rpartition(".")
    return above if word.lower() in MAIN else layer


def _picture(path, channels, bands, layer, depths):
    names = [one.name for one in channels]
    for name in bands:
        if name not in names:
            raise UnknownName(f"channel of {path}", name, names)
    if bands:
        return Contents(
            "radiance",
            _ascending(path, [(channels[names.index(name)], nm) for name, nm in bands.items()]),
        )
    found = None
    if layer is None:
        _require_intensity(path, [one.plain for one in channels])
        found = _fichet(path, channels) or _indigo(path, channels)
    found = found or _colors(path, channels, depths, layer)
    if found is None:
        listed = ", ".join(one_line(one, 40) for one in sorted(names)[:8])
        raise BadFile(
            path,
            "no spectral channels (S0.<wavelength>nm, T.<wavelength>nm, wavelength<nm>) and no picture "
            f"(R, G, B or Y); there are {listed}; give wavelengths with --band NAME=nm",
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


def _fichet(path, channels):
    matches = [(one, BAND.fullmatch(one.plain)) for one in channels if SPECTRAL.match(one.plain)]
    for one, match in matches:
        if not match:
            raise BadFile(
                path,
                f"channel {one.name!r}: cannot be read; wanted S0.<wavelength>nm or T.<wavelength>nm "
                "(other units and frequencies are not supported)",
            )
    kinds = {match[1] for _, match in matches}
    if len(kinds) > 1:
        why = "holds both emissive (S0) and reflective (T) channels; write only one kind"
        raise BadFile(path, why)
    if not kinds:
        return None
    found = [(one, float(match[2].replace(",", "."))) for one, match in matches]
    return Contents("radiance" if kinds == {"S0"} else "reflectance", _ascending(path, found))


def _indigo(path, channels):
    """Return Indigo's buckets, W m-2 sr-1 m-1, at their middle; names have the lower edges."""
    edges = [
        (one, float(match[1].replace("_", ".")))
        for one in channels
        if (match := BUCKET.fullmatch(one.plain))
    ]
    if not edges:
        return None
    edges = _ascending(path, edges)
    if len(edges) < 2:
        why = f"only one bucket ({edges[0][0].name!r}) of unknown width; at least 2 are needed"
        raise BadFile(path, why)
    width = (edges[-1][1] - edges[0][1]) / (len(edges) - 1)
    if np.abs(np.diff([edge for _, edge in edges]) - width).max() > UNEVEN * width:
        raise BadFile(
            path,
            f"channels {edges[0][0].name!r} .. {edges[-1][0].name!r}: buckets of unequal width; wanted "
            "equally spaced edges",
        )
    return Contents("radiance", [(one, edge + width / 2) for one, edge in edges], unit=1e-9)


def _colors(path, channels, depths, layer):
    """Return the picture of a layer, or of the only layer that can be meant. Raises BadFile."""
    layers: dict[str, dict[str, Channel]] = {}
    for one in channels:
        letter = COLOURS.get(one.letter, one.letter)
        layers.setdefault(one.layer, {}).setdefault(letter, one)
    kinds = {name: kind for name, letters in layers.items() if (kind := _kind(letters))}
    if layer is not None:
        chosen = _named(path, layer, kinds)
    elif "" in kinds:
        chosen = ""  # the others are passes of this one
    else:
        of_depth = {one.layer for one in depths}
        coloured = [
            name
            for name, kind in kinds.items()
            if kind == "rgb" and name not in of_depth and not IDS.fullmatch(name)
        ]
        main = [name for name in coloured if name.rpartition(".")[2].lower() in MAIN] or coloured
        if not main:
            return None
        if len(main) > 1:
            shown = ", ".join(one_line(_base(name) or name, 40) for name in main[:8])
            raise BadFile(
                path, f"{len(main)} pictures ({shown}); choose one by layer= or --layer NAME"
            )
        chosen = main[0]
    kind = kinds[chosen]
    return Contents(kind, [(layers[chosen][letter], None) for letter in KINDS[kind]])


def _kind(letters: Iterable[str]) -> str | None:
    """Return the kind of picture that a layer's channels are, or None."""
    held = set(letters)
    return next((kind for kind, wanted in KINDS.items() if held.issuperset(wanted)), None)


def _named(path, layer, kinds):
    """Return the layer with a name, or with a name that begins so. Raises UnknownName."""
    below = [name for name in kinds if name.startswith(f"{layer}.")]
    main = [name for name in below if _base(name) == layer] or below
    if layer in kinds:
        return layer
    if len(main) != 1:
        raise UnknownName(f"layer of {path}", layer, [name or "(none)" for name in kinds])
    return main[0]


def _ascending(path, channels):
    channels = sorted(channels, key=lambda channel: channel[1])
    for (one, first), (two, second) in pairwise(channels):
        if first == second:
            why = f"channels {one.name!r} and {two.name!r} have the same wavelength, {first:g} nm"
            raise BadFile(path, why)
    for one, nm in channels:
        if not 0 < nm < np.inf:
            why = f"channel {one.name!r}: {nm:g} nm, wanted a positive wavelength"
            raise BadFile(path, why)
    return channels
