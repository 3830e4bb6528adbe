"""The image processor: from the mosaic of digital numbers to display codes."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData, Interval, Limits, OutOfRange, check_fields, check_known
from gpusim.domain.learned import FilterTable
from gpusim.domain.mosaics import bayer_phase
from gpusim.domain.network import Network, is_served
from gpusim.domain.short_repr import short_repr
from gpusim.domain.tone import NO_TONE, TONES

DEFECTS = ("none", "known", "detect")
DENOISERS = ("multiscale", "mosaic")
DEMOSAICS = ("auto", "bilinear", "malvar", "adaptive", "best", "learned", "network")
WHITE_BALANCES = (
    "illuminant",
    "bayesian",
    "gray-world",
    "max-rgb",
    "shades-of-gray",
    "red-blue",
    "preset",
    "none",
)
SCALINGS = ("exposure", "normalised")
COLORS = (
    "white-preserving",
    "pseudo-inverse",
    "ridge",
    "cielab",
    "diagonal",
    "fixed-diagonal",
    "root-polynomial",
    "root-polynomial-3",
    "none",
)
ROOT_POLYNOMIALS = ("root-polynomial", "root-polynomial-3")  # for three channels
HIGHLIGHTS = ("clip", "rebuild")
GAMUTS = ("clip", "map")


@dataclass(frozen=True)
class Look:
    """Settings of a processor that a look chooses: see `Processor`."""

    denoise: float = 0.0
    tone: str = NO_TONE
    sharpen: float = 0.0
    shading: bool = False
    highlights: str = "clip"
    lens_corrections: bool = False
    local_tone: float = 0.0
    gamut: str = "clip"


_CAMERA = Look(
    denoise=1.0,
    tone="sigmoid",
    sharpen=0.5,
    shading=True,
    highlights="rebuild",
    lens_corrections=True,
    gamut="map",
)
# linear light as it is, as training and metrology need it; a camera's picture; a phone's
LOOKS = {
    "linear": Look(),
    "camera": _CAMERA,
    "phone": replace(_CAMERA, denoise=1.5, tone="reinhard", sharpen=1.0, local_tone=0.5),
}
METHODS = {
    "defects": DEFECTS,
    "denoise_by": DENOISERS,
    "demosaic": DEMOSAICS,
    "white_balance": WHITE_BALANCES,
    "color": COLORS,
    "scaling": SCALINGS,
    "look": tuple(LOOKS),
}
CHOICES = {"highlights": HIGHLIGHTS, "gamut": GAMUTS}  # None: the look's
LIMITS = {
    "shading": Limits("True or False", kind=bool),
    "lens_corrections": Limits("True or False", kind=bool),
    "table": Limits("a FilterTable, see `gpusim.io.camera.learned.read_table`", kind=FilterTable),
    "network": Limits("a Network, see `gpusim.io.camera.network.read_network`", kind=Network),
    "denoise": Limits("0 (none) .. 4", Interval(0, 4)),
    "sharpen": Limits("0 (none) .. 2", Interval(0, 2)),
    "local_tone": Limits("0 (none) .. 1", Interval(0, 1)),
}
BRIGHTEST = 1e3  # largest input of a tone curve, encoded


def fit_to_mosaic(cfa, before, is_stacked: bool, known: dict, free: set) -> dict:
    """Return settings of the processor that must change for a mosaic that replaces another.

    Args:
        cfa: Rows of the mosaic.
        before: Rows of the mosaic that it replaces.
        is_stacked: Whether every pixel has all channels.
        known: Settings demosaic, color, white_balance and table, as far as they are not the default.
        free: Names of those that may change.

    Returns:
        New settings by name.
    """
    letters, old = set("".join(cfa)), set("".join(before))
    changes = {}
    demosaic, color = known.get("demosaic", "auto"), known.get("color", "white-preserving")
    is_bayer = bayer_phase(cfa) is not None
    suits = demosaic in ("auto", "learned") or (demosaic == "network" and is_served(cfa))
    if not (is_bayer or is_stacked or len(letters) < 2 or suits):
        changes["demosaic"] = "auto"
    if len(letters) < 3 and color != "none":
        changes["color"] = "none"
    elif len(letters) >= 3 > len(old) and color == "none":
        changes["color"] = "white-preserving"
    elif len(letters) > 3 and color in ROOT_POLYNOMIALS:
        changes["color"] = "white-preserving"
    if known.get("white_balance") == "red-blue" and not {*"RB"} <= letters:
        changes["white_balance"] = "illuminant"
    return {key: value for key, value in changes.items() if key in free}


@dataclass(frozen=True)
class Processor:
    """Processing of the raw image, in the order of these fields.

    Scaling and white balance come before the tone curve. If the light of the scene is known and
    used, or estimated, white surfaces are neutral.

    Args:
        defects: Replacement of dead and hot pixels: "known" (the list of this chip, as from a
            factory), "detect" (pixels that differ from their neighbours) or "none".
        shading: Divide out the fall-off of lens and pixels towards the corners. None: the look's.
        denoise: Strength of denoising: 1 follows the noise model, 0 is off; None: the look's, but 0
            before demosaic "network".
        demosaic: Method for a Bayer mosaic, from fast to good: "bilinear", "malvar"
            (gradient-corrected), "adaptive" (along edges), "best" (regressed gains, uses noise and
            blur), "learned" (local linear filters from a table), "network" (a small network that also
            removes noise, for any mosaic of red, green and blue). All but "learned" also serve
            RCCB, RYYB, CYYM and others of three channels with the doubled one on a diagonal. Further
            mosaics take "bilinear" (weighted means), "learned" or "network". "auto" takes what suits
            the mosaic: "best" for those like Bayer's, "learned" for those with built-in filters,
            else "bilinear", as for Bayer's (see `Camera.demosaic_method`).
        table: Filters of "learned"; None: the built-in ones, for Bayer mosaics and those of
            `gpusim.domain.guided.BUILT_IN`.
        white_balance: "illuminant" (the light of the scene is known; a perfect diffuser becomes
            neutral), an estimate from the picture ("bayesian", which errs least, "gray-world",
            "max-rgb", "shades-of-gray", "red-blue"), "preset" (the light in which white has the
            values `white`), or "none" (as if the light were `target`).
        color: Method that finds the 3 x C matrix to CIE XYZ, or, for three channels, the 3 x 6 or 3
            x 13 matrix of their root-polynomial terms (see `gpusim.color.color.color_matrix`); or
            "none" (channels are displayed as they are).
        training: Name of the reflectance set that the transform is trained on.
        target: Light in which the picture shows the surfaces of the scene.
        scaling: Definition of display white: "exposure" (the signal at which automatic exposure
            puts white, `AutoExposure.white`; longer exposures are brighter and clip) or
            "normalised" (a perfect white diffuser at any exposure; saturation if the light of the
            scene is not known).
        tone: Tone curve: a name of `gpusim.domain.tone.TONES`, () or "none" for none, or (x, y) of
            two or more nodes, both increasing. x is a linear value (white = 1) encoded as sRGB; y
            is the displayed value, encoded the same way, from 0 to 1. Between nodes it is a
            monotone cubic. None: the look's.
        sharpen: Strength of sharpening by the camera's own blur, 0 (none) .. 2, where luminance stands
            out of the noise; 1 takes contrast H to H (2 - H), see `processor.sharpen`. None: the
            look's.
        look: Name of LOOKS: choices of the settings that are None. "linear" has none of them.
        network: Weights of demosaic "network"; None: the built-in ones.
        white: Camera values of white for white balance "preset", one per channel, any scale.
        denoise_by: "multiscale" (after demosaicking, luminance and chroma apart, at several scales) or
            "mosaic" (before demosaicking, by means of similar pixels).
        highlights: "clip" (a channel that clips pulls the others to white) or "rebuild" (clipped
            channels follow from the others and the colour of the light around them, see
            `processor.highlights`), in linear camera values before the colour transform. None: the
            look's.
        lens_corrections: Undo distortion and lateral colour of the camera's own optics, by cubic
            interpolation: the picture is that of a pinhole with the nominal focal length, magnified
            if its corners would be empty. None: the look's.
        local_tone: Strength of local tone mapping after sharpening, 0 (none) .. 1: dark regions
            become up to 1 + 2 x strength times as bright, see `processor.local_tone`. None: the
            look's.
        gamut: Colours outside of the display's gamut: "clip" (each channel to 0 .. 1) or "map" (to
            the neutral of the same lightness until they are inside, hue kept, see
            `processor.gamut`). None: the look's.

    Raises:
        BadData: The tone curve or `white` has the wrong form.
        OutOfRange: A number is outside its range, or two settings exclude each other.
        UnknownName: The name of a method is not known.
    """

    defects: str = "none"
    shading: bool | None = None
    denoise: float | None = None
    demosaic: str = "auto"
    table: FilterTable | None = None
    white_balance: str = "illuminant"
    color: str = "white-preserving"
    training: str = "objects"
    target: str = "D65"
    scaling: str = "exposure"
    tone: tuple | str | None = None
    sharpen: float | None = None
    look: str = "linear"
    network: Network | None = None
    white: tuple[float, ...] = ()
    denoise_by: str = "multiscale"
    highlights: str | None = None
    lens_corrections: bool | None = None
    local_tone: float | None = None
    gamut: str | None = None

    __repr__ = short_repr

    def __post_init__(self):
        for key, known in METHODS.items():
            check_known(f"processor.{key}", getattr(self, key), known)
        for key, known in CHOICES.items():
            if getattr(self, key) is not None:
                check_known(f"processor.{key}", getattr(self, key), known)
        check_fields("processor", self, LIMITS)
        if self.table is not None and self.demosaic != "learned":
            raise OutOfRange(
                "processor.table", "given", f'only with demosaic = "learned", not "{self.demosaic}"'
            )
        if self.network is not None and self.demosaic != "network":
            raise OutOfRange(
                "processor.network",
                "given",
                f'only with demosaic = "network", not "{self.demosaic}"',
            )
        self._check_white()
        self._check_tone()

    def _check_tone(self):
        if isinstance(self.tone, str):
            check_known("processor.tone", self.tone, (NO_TONE, *TONES))
        elif self.tone:
            try:
                nodes = np.asarray(self.tone, np.float64)
            except (TypeError, ValueError):
                raise BadData(
                    f"processor.tone = {self.tone!r}: wanted (x, y) of two or more nodes"
                ) from None
            if (
                nodes.ndim != 2
                or nodes.shape[1] != 2
                or len(nodes) < 2
                or not np.isfinite(nodes).all()
            ):
                raise BadData(
                    f"processor.tone: shape {nodes.shape}, wanted (x, y) of two or more nodes, finite"
                )
            if (
                not (np.diff(nodes, axis=0) > 0).all()
                or nodes[0, 0] < 0
                or nodes[-1, 0] > BRIGHTEST
                or (nodes[0, 1], nodes[-1, 1]) != (0, 1)
            ):
                raise BadData(
                    "processor.tone: wanted x and y that increase from node to node, x from 0 on, at most "
                    f"{BRIGHTEST:g}, y from 0 to 1"
                )
            object.__setattr__(self, "tone", tuple(map(tuple, nodes.tolist())))

    def _check_white(self):
        try:
            white = tuple(map(float, self.white))
        except (TypeError, ValueError):
            raise BadData(
                f"processor.white = {self.white!r}: wanted a number for each channel"
            ) from None
        if not all(0 < value < np.inf for value in white):
            raise OutOfRange("processor.white", list(white), "numbers above 0")
        if bool(white) != (self.white_balance == "preset"):
            raise OutOfRange(
                "processor.white",
                list(white),
                'camera values of white with white_balance = "preset", none without',
            )
        object.__setattr__(self, "white", white)

    @property
    def denoising(self) -> float:
        """Strength of denoising, set or by the look. The network needs a mosaic with all its noise."""
        if self.denoise is not None:
            return self.denoise
        is_spoilt = self.demosaic == "network" and self.denoise_by == "mosaic"
        return 0.0 if is_spoilt else LOOKS[self.look].denoise

    def chosen(self, key: str) -> Any:
        """Return a setting that a look may choose: the processor's own, or that of its look.

        Args:
            key: Name of a field of `Look`.

        Returns:
            The setting.
        """
        own = getattr(self, key)
        return getattr(LOOKS[self.look], key) if own is None else own

    @property
    def tone_curve(self) -> tuple | str:
        """Tone curve, set or by the look."""
        return self.chosen("tone")

    @property
    def sharpening(self) -> float:
        """Strength of sharpening, set or by the look."""
        return self.chosen("sharpen")

    @property
    def corrects_shading(self) -> bool:
        """True if the fall-off towards the corners is divided out, set or by the look."""
        return self.chosen("shading")

    @property
    def corrects_lens(self) -> bool:
        """True if distortion and lateral colour are undone, set or by the look."""
        return self.chosen("lens_corrections")

    @property
    def rebuilds_highlights(self) -> bool:
        """True if clipped channels are rebuilt, set or by the look."""
        return self.chosen("highlights") == "rebuild"

    @property
    def local_toning(self) -> float:
        """Strength of local tone mapping, set or by the look."""
        return self.chosen("local_tone")

    @property
    def maps_gamut(self) -> bool:
        """True if colours outside of the display's gamut keep their hue, set or by the look."""
        return self.chosen("gamut") == "map"

    @property
    def estimates_white(self) -> bool:
        """True if white balance is estimated from the picture."""
        return self.white_balance not in ("illuminant", "preset", "none")
