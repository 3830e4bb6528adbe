"""What stands in front of the camera: spectral reflectance (or radiance) apart from the light."""

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from gpusim.domain.content import Content
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.foreign import is_array
from gpusim.domain.labels import Pictured
from gpusim.domain.short_repr import brief, shortened
from gpusim.domain.spectrum import Spectrum, seen_band
from gpusim.domain.view import View

BORDERS = ("zero", "edge", "reflect", "scene")


@dataclass(frozen=True, eq=False)
class Layer:
    """A thing in front of a scene's content, which goes on behind it.

    content: of the scene's kind, wavelengths, basis or materials, and shape. alpha: share of every sample that it
    covers, 0 .. 1, shape (rows, cols). depth: its distance [m], one number or shape (rows, cols).
    """

    content: Content
    alpha: np.ndarray
    depth: np.ndarray | float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Scene(Pictured):
    """Radiance of every scene point, L(x, lambda) = content(x, lambda) * illuminant(lambda).

    content: Cube, Basis, Materials, Picture or Illuminated, the scene as samples on a square grid. It is the
        reflectance [1] when the light is known; when only the radiance was measured it is that radiance and the
        illuminant is 1.
    illuminant: radiance of a perfect white diffuser in the scene's light [photon s-1 m-2 sr-1 nm-1].
    border: what lies outside the frame: "zero" (dark), "edge" (the outermost samples go on), "reflect" (mirrored),
        "scene" (the outermost `margin` samples of `content` are the surroundings and are not in the frame).
    margin: width of the surroundings [sample], with border = "scene" only.
    fov: horizontal field of view [rad], or None: follows from the camera's pixels and focal length.
    depth: distance of every sample [m], shape (rows, cols), or None.
    samples_per_pixel: scene samples along a pixel's pitch, any number from 1 on. The frame is the middle of the
        samples, as many whole pixels as fit; what is left over around it takes part in the blur.
    layers: things in front of `content`, the nearest first, for a scene that knows what they hide; it needs `depth`.
    view: where the camera looks; what it shows takes the place of the scene, and goes on outside the frame as `border`
        says. Not with `depth`.
    notes: what a file could not give as it is; reports repeat it.
    Raises BadData, OutOfRange, UnknownName.
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

    def __post_init__(self):
        if not isinstance(self.content, Content):
            raise BadData(
                f"{self.name}: content {type(self.content).__name__}, wanted a Cube, Basis, Materials, "
                "Picture or Illuminated"
            )
        self.content.check(self.name)
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
                f"{self.name}: nothing left of the {self.content.shape} samples inside margin {self.margin}"
            )
        if not 1 <= self.samples_per_pixel <= min(self.samples):  # NaN is refused as well
            rows, cols = self.samples
            raise OutOfRange(
                "scene.samples_per_pixel",
                self.samples_per_pixel,
                f"1 .. {min(self.samples)}: the frame of {cols} x {rows} samples has at least one pixel",
            )
        if (self.illuminant.values < 0).any():
            raise BadData(
                f"{self.name}: the illuminant is negative (lowest {self.illuminant.values.min():.3g})"
            )
        if self.depth is not None:
            if self.depth.shape != self.content.shape:
                raise BadData(
                    f"{self.name}: depth {self.depth.shape} does not match the scene {self.content.shape}"
                )
            if not (self.depth > 0).all():
                raise BadData(f"{self.name}: depth must be positive everywhere [m]")
        self._check_view()
        self._check_layers()

    def _check_view(self):
        if not isinstance(self.view, View):
            raise BadData(f"{self.name}: view {type(self.view).__name__}, wanted a View")
        if self.depth is not None and not self.view.is_plain:
            raise BadData(
                f"{self.name}: a view of a scene with depth, which is not moved with it; wanted either"
            )

    def _check_layers(self):
        object.__setattr__(self, "layers", tuple(self.layers))
        if self.layers and self.depth is None:
            raise BadData(f"{self.name}: layers need the depth of what is behind them")
        farther = -np.inf
        for number, layer in enumerate(self.layers):
            name, content, shape = f"{self.name}: layer {number}", layer.content, self.content.shape
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
        if self.samples_per_pixel != 1:
            more += [f"{self.samples_per_pixel:g} samples per pixel"]
        return shortened(
            f"Scene({', '.join([repr(self.name), repr(self.content), *more, f'border {self.border!r}'])})"
        )

    def stored(self, **arrays) -> "Scene":
        """The same with its samples, by their names in `content`, kept elsewhere: on a device; nothing is looked at."""
        content, scene = copy(self.content), copy(self)
        for name, array in arrays.items():
            object.__setattr__(content, name, array)
        object.__setattr__(scene, "content", content)
        return scene

    def viewed(self, view: View) -> "Scene":
        """The same by another view; its samples are not looked at again. Raises BadData."""
        scene = copy(self)
        object.__setattr__(scene, "view", view)
        scene._check_view()
        return scene

    def brightened(self, factor: float) -> "Scene":
        """The same in so many times the light; its samples are not looked at again."""
        scene = copy(self)
        object.__setattr__(
            scene, "illuminant", replace(self.illuminant, values=factor * self.illuminant.values)
        )
        return scene

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame [pixel]."""
        # a ratio such as 1.1 is no binary fraction: 11 samples are 10 pixels of it, not 9.999...
        rows, cols = (int(n / self.samples_per_pixel * (1 + 1e-12)) for n in self.samples)
        return rows, cols

    @property
    def samples(self) -> tuple[int, int]:
        """Rows and columns of the scene's samples without the margin."""
        rows, cols = self.content.shape
        return rows - 2 * self.margin, cols - 2 * self.margin

    @property
    def wavelengths(self) -> np.ndarray:
        """The nodes [nm] at which the content is tabulated, shape (L,)."""
        return self.content.wavelengths

    @property
    def light_is_known(self) -> bool:
        """Whether the content is reflectance; else it is radiance [photon s-1 m-2 sr-1 nm-1], the illuminant 1."""
        return bool((self.illuminant.values != 1).any())


def checked_scene(scene) -> Scene:
    """Return a scene as it is. Raises BadData for anything else."""
    if not isinstance(scene, Scene):
        raise BadData(
            f"scene: {type(scene).__name__}, wanted a Scene, such as of "
            + ("gs.scene_from, which takes arrays" if is_array(scene) else "open_scene or chart")
        )
    return scene


def unit_light(wavelengths) -> Spectrum:
    """Return the illuminant 1 of a scene of which only the radiance was measured, at `wavelengths` [nm]."""
    return Spectrum(np.array(seen_band(wavelengths)), np.ones(2), "unknown light")
