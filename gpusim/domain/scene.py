"""The scene: spectral reflectance (or radiance) of surfaces, the light on them, and the part shown."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from math import cos, isfinite, pi, sin
from typing import Any

import numpy as np

from gpusim.domain.content import Content
from gpusim.domain.errors import BadData, OutOfRange, UnknownName, one_line
from gpusim.domain.labels import Pictured
from gpusim.domain.memory import is_array, to_host
from gpusim.domain.short_repr import short_repr, shorten_repr
from gpusim.domain.spectrum import ENERGY, PHOTONS, Spectrum, photons_from_energy, seen_band

FARTHEST = 1e5  # [pixel]
MOST_ZOOM = 100.0


@dataclass(frozen=True)
class View:
    """Mapping from the frame to the scene: frame position p shows shift + R(rotation) p / zoom.

    Both positions are relative to the centre [pixel].

    Args:
        shift: Rows and columns of the scene point at the centre of the frame [pixel].
        rotation: Rotation of the camera about its axis, in the plane of the frame, from the columns
            to the rows [rad].
        zoom: Magnification, 1 or more. A smaller one would make samples finer than the scene's
            `samples_per_pixel` says.

    Raises:
        BadData: A value is no number.
        OutOfRange: A number is outside its range.
    """

    shift: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    zoom: float = 1.0

    def __post_init__(self):
        try:
            down, right = (float(part) for part in self.shift)
            rotation, zoom = float(self.rotation), float(self.zoom)
        except (TypeError, ValueError):
            raise BadData(
                f"view = {self!r}: wanted a shift of two numbers, a rotation and a zoom"
            ) from None
        if not all(map(isfinite, (down, right, rotation))) or max(abs(down), abs(right)) > FARTHEST:
            raise OutOfRange("view", self, f"finite numbers, the shift up to {FARTHEST:g} pixels")
        if not 1 <= zoom <= MOST_ZOOM:
            raise OutOfRange(
                "view.zoom", zoom, f"1 .. {MOST_ZOOM:g}; a wider view needs a larger scene"
            )
        object.__setattr__(self, "shift", (down, right))
        object.__setattr__(self, "rotation", rotation % (2 * pi))
        object.__setattr__(self, "zoom", zoom)

    @property
    def is_plain(self) -> bool:
        """True if the frame shows the centre of the scene, unrotated and at magnification 1."""
        return self.zoom == 1 and not (self.rotation or any(self.shift))

    def is_whole(self, ratio: float = 1.0) -> bool:
        """Return True if pixels fall on samples: the shift is a whole number of samples.

        Args:
            ratio: Scene samples per pixel.

        Returns:
            True if no interpolation is needed.
        """
        return (
            not self.rotation
            and self.zoom == 1
            and all((ratio * move).is_integer() for move in self.shift)
        )

    def place(self, y: Any, x: Any, ratio: float = 1.0) -> tuple[Any, Any]:
        """Return the scene positions that frame positions show, both relative to the centre.

        Args:
            y: Rows of the frame [sample], a number or an array.
            x: Columns of the frame [sample].
            ratio: Scene samples per pixel.

        Returns:
            Rows and columns of the scene [sample].
        """
        c, s = cos(self.rotation) / self.zoom, sin(self.rotation) / self.zoom
        return c * y + s * x + ratio * self.shift[0], c * x - s * y + ratio * self.shift[1]

    def compose(self, inner: "View") -> "View":
        """Return the view that shows through this view what `inner` shows.

        Args:
            inner: View of the frame that this view makes.

        Returns:
            The view of both.
        """
        down, right = self.place(*inner.shift)
        return View((down, right), self.rotation + inner.rotation, self.zoom * inner.zoom)

    def locate(self, y: Any, x: Any, ratio: float = 1.0) -> tuple[Any, Any]:
        """Return the frame positions that show scene positions: the inverse of `place`.

        Args:
            y: Rows of the scene relative to the centre [sample], a number or an array.
            x: Columns of the scene [sample].
            ratio: Scene samples per pixel.

        Returns:
            Rows and columns of the frame [sample].
        """
        c, s = cos(self.rotation) * self.zoom, sin(self.rotation) * self.zoom
        y, x = y - ratio * self.shift[0], x - ratio * self.shift[1]
        return c * y - s * x, s * y + c * x


BOXES, FLOW = "boxes", "flow"  # labels that are no maps of whole numbers
# samples on the plane of a pinhole's picture; directions; places in a lens's image
PLANE, PANORAMA, IMAGE = "plane", "equirectangular", "image"
BORDERS = ("zero", "edge", "reflect", "scene")


@dataclass(frozen=True, eq=False)
class Layer:
    """An object in front of the content of a scene, which continues behind it.

    Args:
        content: Samples of the same form, wavelengths, basis or materials and shape as the scene's.
        alpha: Coverage of each sample, 0 .. 1, shape (rows, cols).
        depth: Distance [m], a number or shape (rows, cols).
    """

    content: Content
    alpha: np.ndarray
    depth: np.ndarray | float

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Scene(Pictured):
    """Spectral radiance of a scene, L(x, lambda) = content(x, lambda) * illuminant(lambda).

    Args:
        content: Cube, Basis, Materials, Picture or Illuminated: samples on a square grid. It is the
            reflectance [1] if the light is known. If only the radiance was measured, it is that
            radiance, and the illuminant is 1.
        illuminant: Radiance of a perfect white diffuser in the light of the scene [photon s-1 m-2
            sr-1 nm-1]; energy radiance is converted if the spectrum's quantity says so. Relative
            power, as from `illuminant`, is refused: `scene_from` gives it a luminance.
        border: Surroundings of the frame: "zero" (dark), "edge" (the outermost samples continue),
            "reflect" (mirrored), "scene" (the outermost `margin` samples of `content`, which are
            outside the frame).
        margin: Width of the surroundings [sample], only for border "scene".
        fov: Horizontal field of view [rad]; None: from the camera's pixels and focal length.
        depth: Distance of every sample [m], shape (rows, cols), or None.
        name: Name in messages and reports.
        samples_per_pixel: Scene samples along the pitch of a pixel, any number from 1 on. The frame
            is the centre of the samples, with as many whole pixels as fit. Samples outside it
            contribute to the blur.
        layers: Objects in front of `content`, nearest first, for a scene that knows hidden
            surfaces. They need `depth`.
        view: Part of the scene that the frame shows. It replaces the scene, and continues outside
            the frame according to `border`. Not with `depth`.
        labels: Labels by name, which `gpusim.carry_labels` brings to the pixels: maps of whole
            numbers, shape (rows, cols), for example "instance" or "semantic"; "flow", where each
            sample's point goes until the next frame, (rows, cols, 2) [sample] down and across;
            "boxes", (n, 4), top, left, bottom and right edges [sample]. They include the margin.
        projection: "plane": samples are places in a pinhole's picture. "equirectangular": they are
            directions, longitudes along the columns (all 360 degrees) and latitudes along the rows
            (180 degrees from above to below); a camera sees it by `gpusim.view_panorama`. "image": places in
            the image of a lens, see `image_of`; `gpusim.view_panorama` makes such scenes.
        image_of: Settings of the lens whose image the samples are.
        notes: Deviations from the file it was read from; reports repeat them.

    Raises:
        BadData: Content, depth, layers or view do not fit together.
        OutOfRange: A number is outside its range.
        UnknownName: The border is not known.
    """

    content: Content
    illuminant: Spectrum
    border: str = "edge"
    margin: int = 0
    fov: float | None = None
    depth: np.ndarray | None = None
    name: str = "scene"
    samples_per_pixel: float = 1.0
    layers: tuple[Layer, ...] = ()
    view: View = field(default_factory=View)
    notes: tuple[str, ...] = ()
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)
    projection: str = PLANE
    image_of: Any = None

    def __post_init__(self):
        if not isinstance(self.content, Content):
            raise BadData(
                f"{self._label}: content {type(self.content).__name__}, wanted a Cube, Basis, Materials, "
                "Picture or Illuminated"
            )
        self.content.check(self._label)
        if self.border not in BORDERS:
            raise UnknownName("border", self.border, BORDERS)
        if self.fov is not None and not 0 < self.fov < np.pi:
            raise OutOfRange("scene.fov", f"{self.fov:.4g} rad", "0 < fov < pi rad")
        if self.margin < 0 or (self.margin > 0) != (self.border == "scene"):
            raise OutOfRange(
                "scene.margin", self.margin, 'margin >= 1 with border = "scene", 0 otherwise'
            )
        if min(self.samples) < 1:
            raise BadData(
                f"{self._label}: nothing left of the {self.content.shape} samples inside margin {self.margin}"
            )
        if not 1 <= self.samples_per_pixel <= min(self.samples):  # NaN is refused as well
            rows, cols = self.samples
            raise OutOfRange(
                "scene.samples_per_pixel",
                self.samples_per_pixel,
                f"1 .. {min(self.samples)}: the frame of {cols} x {rows} samples has at least one pixel",
            )
        self._check_quantity()
        if (self.illuminant.values < 0).any():
            raise BadData(
                f"{self._label}: the illuminant is negative (lowest {self.illuminant.values.min():.3g})"
            )
        if self.depth is not None:
            if self.depth.shape != self.content.shape:
                raise BadData(
                    f"{self._label}: depth {self.depth.shape} does not match the scene {self.content.shape}"
                )
            if not (self.depth > 0).all():
                raise BadData(f"{self._label}: depth must be positive everywhere [m]")
        self._check_view()
        self._check_layers()
        self._check_labels()
        self._check_projection()

    def _check_quantity(self):
        """Refuse light that has no scale; convert energy to photons."""
        light = self.illuminant
        if not isinstance(light, Spectrum) or light.values.ndim != 1:
            raise BadData(
                f"{self._label}: illuminant {type(light).__name__}, wanted a Spectrum of one function"
            )
        if light.quantity == ENERGY:
            object.__setattr__(self, "illuminant", photons_from_energy(light))
        elif light.quantity not in ("", PHOTONS):
            raise BadData(
                f"{self._label}: the illuminant {light.name} is {light.quantity}, wanted the radiance of white "
                '[photon s-1 m-2 sr-1 nm-1]; gs.scene_from(cube, wavelengths, light="D65", luminance=100) '
                "makes it from a light's name"
            )

    def _host_label(self, name, label):
        """Return a label as a NumPy array."""
        try:
            return to_host(label, name) if hasattr(label, "shape") else np.asarray(label)
        except (ValueError, TypeError):
            raise BadData(f"{self._label}: label {name}: wanted an array of numbers") from None

    def _check_projection(self):
        if self.projection not in (PLANE, PANORAMA, IMAGE):
            raise UnknownName("projection", self.projection, (PLANE, PANORAMA))
        if (self.projection == IMAGE) != (self.image_of is not None):
            raise BadData(
                f'{self._label}: projection "{IMAGE}" is of scenes that gs.view_panorama makes; wanted "{PLANE}" '
                f'or "{PANORAMA}"'
            )
        if self.projection != PANORAMA:
            return
        for name, is_set in (
            ("depth", self.depth is not None),
            ("a margin", self.margin > 0),
            ("a view", not self.view.is_plain),
            ("label flow", FLOW in self.labels),
            ("label boxes", BOXES in self.labels),
        ):
            if is_set:
                raise BadData(
                    f"{self._label}: a panorama with {name}, wanted without; see gs.view_panorama"
                )

    def _check_labels(self):
        if not isinstance(self.labels, Mapping):
            raise BadData(
                f"{self._label}: labels {type(self.labels).__name__}, wanted a dict of names and arrays"
            )
        checked = {}
        for name, label in self.labels.items():
            if not (isinstance(name, str) and name.isidentifier()) or name == "depth":
                raise BadData(
                    f"{self._label}: label {one_line(str(name))!r}, wanted a name of letters, digits and _; "
                    "depth is an argument of its own"
                )
            array, shape = self._host_label(name, label), self.content.shape
            wanted, kinds, words = shape, "biu", "whole numbers"
            if name == FLOW:
                wanted, kinds, words = (*shape, 2), "f", "finite numbers"
            elif name == BOXES:
                count = len(array) if array.ndim else 0
                wanted, kinds, words = (count, 4), "fiu", "finite numbers"
            if array.shape != wanted or array.dtype.kind not in kinds:
                raise BadData(
                    f"{self._label}: label {name}, {array.dtype} {array.shape}, wanted {words}, shape {wanted}"
                )
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise BadData(f"{self._label}: label {name} is not finite everywhere")
            if name == BOXES and (array[:, 2:] < array[:, :2]).any():
                raise BadData(
                    f"{self._label}: label {name}: wanted top, left, bottom, right with top <= bottom, left <= right"
                )
            checked[name] = array
        object.__setattr__(self, "labels", checked)

    def _check_view(self):
        if not isinstance(self.view, View):
            raise BadData(f"{self._label}: view {type(self.view).__name__}, wanted a View")
        if self.image_of is not None and not self.view.is_plain:
            raise BadData(
                f"{self._label}: a view of the image of a panorama; turn the camera instead, by yaw, pitch and roll "
                "of gs.view_panorama"
            )

    def _check_layers(self):
        object.__setattr__(self, "layers", tuple(self.layers))
        if self.layers and self.depth is None:
            raise BadData(f"{self._label}: layers need the depth of the scene behind them")
        farther = -np.inf
        for number, layer in enumerate(self.layers):
            name, content, shape = (
                f"{self._label}: layer {number}",
                layer.content,
                self.content.shape,
            )
            content.check(name)
            if not content.is_like(self.content):
                raise BadData(
                    f"{name}: wanted the scene's kind of content, its wavelengths and its basis or materials"
                )
            if (
                content.shape != shape
                or np.shape(layer.alpha) != shape
                or np.shape(layer.depth) not in ((), shape)
            ):
                raise BadData(
                    f"{name}: content {content.shape}, alpha {np.shape(layer.alpha)} and depth "
                    f"{np.shape(layer.depth)} do not match the scene {shape}"
                )
            if not (np.min(layer.alpha) >= 0 and np.max(layer.alpha) <= 1):
                raise OutOfRange(
                    f"{name}: alpha",
                    f"{np.min(layer.alpha):.4g} .. {np.max(layer.alpha):.4g}",
                    "0 .. 1",
                )
            if not np.min(layer.depth) > 0:
                raise BadData(f"{name}: depth must be positive everywhere [m]")
            if np.max(layer.depth) < farther:
                raise BadData(f"{name}: nearer than the layer before it; the nearest comes first")
            farther = np.min(layer.depth)

    def __repr__(self):
        more = ["light unknown"] * (not self.light_is_known) + ["with depth"] * (
            self.depth is not None
        )
        more += [f"{len(self.layers)} layers"] * bool(self.layers) + [repr(self.view)] * (
            not self.view.is_plain
        )
        if self.projection != PLANE:
            more += ["a panorama" if self.projection == PANORAMA else "a lens's image"]
        if self.samples_per_pixel != 1:
            more += [f"{self.samples_per_pixel:g} samples per pixel"]
        return shorten_repr(
            f"Scene({', '.join([repr(self.name), repr(self.content), *more, f'border {self.border!r}'])})"
        )

    def stored(self, **arrays: Any) -> "Scene":
        """Return the scene with its samples in other memory, for example on a device.

        The samples are not checked.

        Args:
            arrays: New arrays, with their names in `content`.

        Returns:
            The scene with these arrays.
        """
        return _copy_with(self, content=_copy_with(self.content, **arrays))

    def viewed(self, view: View) -> "Scene":
        """Return the scene from another view. Its samples are not checked again.

        Args:
            view: The view.

        Returns:
            The scene with this view.

        Raises:
            BadData: The scene has depth, or `view` is no View.
        """
        scene = _copy_with(self, view=view)
        scene._check_view()
        return scene

    def brighten(self, factor: float) -> "Scene":
        """Return the scene in brighter light. Its samples are not checked again.

        Args:
            factor: Factor on the light [1].

        Returns:
            The scene with this light.
        """
        return _copy_with(self, illuminant=self.illuminant.scale(factor))

    @property
    def _label(self):
        """The name in messages, whatever it is."""
        return self.name if isinstance(self.name, str) else one_line(self.name)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame [pixel]."""
        # 1.1 is no binary fraction: 11 samples are 10 pixels of that size, not 9.999...
        rows, cols = (int(n / self.samples_per_pixel * (1 + 1e-12)) for n in self.samples)
        return rows, cols

    @property
    def samples(self) -> tuple[int, int]:
        """Rows and columns of the scene's samples without the margin."""
        rows, cols = self.content.shape
        return rows - 2 * self.margin, cols - 2 * self.margin

    @property
    def wavelengths(self) -> np.ndarray:
        """Wavelengths at which the content is tabulated [nm], shape (L,)."""
        return self.content.wavelengths

    @property
    def light_is_known(self) -> bool:
        """True if the content is reflectance.

        Otherwise it is radiance [photon s-1 m-2 sr-1 nm-1], and the illuminant is 1.
        """
        return bool((self.illuminant.values != 1).any())


def _copy_with(part, /, **fields):
    """Return a copy with other fields, which are not checked."""
    other = copy(part)
    for name, value in fields.items():
        object.__setattr__(other, name, value)
    return other


def checked_scene(scene, is_panorama_allowed: bool = False) -> Scene:
    """Return `scene`. Raise BadData if it is not a Scene, or is a panorama if those are not allowed."""
    if not isinstance(scene, Scene):
        raise BadData(
            f"scene: {type(scene).__name__}, wanted a Scene, for example from "
            + ("gs.scene_from, which takes arrays" if is_array(scene) else "open_scene or chart")
        )
    if scene.projection == PANORAMA and not is_panorama_allowed:
        raise BadData(
            f"{scene.name} is a panorama: gs.view_panorama(scene, camera, size=(columns, rows)) is what a camera "
            "sees of it"
        )
    return scene


def unit_light(wavelengths) -> Spectrum:
    """Return the illuminant 1 of a scene whose radiance was measured at `wavelengths` [nm]."""
    return Spectrum(np.array(seen_band(wavelengths)), np.ones(2), "unknown light")
