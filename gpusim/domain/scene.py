"""What stands in front of the camera: spectral reflectance (or radiance) apart from the light."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum

BORDERS = ("zero", "edge", "reflect", "scene")
NEGATIVE = 0.25  # undershoot of a truncated basis that is let pass, relative to the brightest sample


@dataclass(frozen=True, eq=False)
class Cube:
    """Spectral samples of every pixel: values (L, rows, cols) float32 at wavelengths (L,) [nm]."""

    wavelengths: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Basis:
    """A linear model: pixel spectrum = sum_k coefficients[k] basis[k].

    coefficients (K, rows, cols) float32; basis (K, L) at wavelengths (L,) [nm].
    """

    wavelengths: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray


@dataclass(frozen=True, eq=False)
class Materials:
    """One material per pixel: pixel spectrum = shading * spectra[ids].

    ids (rows, cols) uint8 or uint16; shading (rows, cols) float32; spectra (M, L) at wavelengths (L,) [nm].
    """

    wavelengths: np.ndarray
    ids: np.ndarray
    shading: np.ndarray
    spectra: np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """Radiance of every scene point, L(x, lambda) = content(x, lambda) * illuminant(lambda).

    content: Cube, Basis or Materials, one sample per sensor pixel. It is the reflectance [1] when the light is known;
        when only the radiance was measured it is that radiance and the illuminant is 1.
    illuminant: radiance of a perfect white diffuser in the scene's light [photon s-1 m-2 sr-1 nm-1].
    border: what lies outside the frame: "zero" (dark), "edge" (the outermost pixels go on), "reflect" (mirrored),
        "scene" (the outermost `margin` pixels of `content` are the surroundings and are not in the frame).
    margin: width of the surroundings [pixel], with border = "scene" only.
    fov: horizontal field of view [rad], or None: follows from the camera's pixels and focal length.
    depth: distance of every pixel [m], shape (rows, cols), or None.
    Raises BadData, OutOfRange, UnknownName.
    """

    content: Cube | Basis | Materials
    illuminant: Spectrum
    border: str = "edge"
    margin: int = 0
    fov: float | None = None
    depth: np.ndarray | None = None
    name: str = "scene"

    def __post_init__(self):
        _check_content(self.content, self.name)
        if self.border not in BORDERS:
            raise UnknownName("border", self.border, BORDERS)
        if self.fov is not None and not 0 < self.fov < np.pi:
            raise OutOfRange("scene.fov", f"{self.fov:.4g} rad", "0 < fov < pi rad")
        if self.margin < 0 or (self.margin > 0) != (self.border == "scene"):
            raise OutOfRange("scene.margin", self.margin, 'margin >= 1 with border = "scene", 0 otherwise')
        rows, cols = self.shape
        if rows < 1 or cols < 1:
            raise BadData(f"{self.name}: nothing left of the {self._full_shape()} samples inside margin {self.margin}")
        if (self.illuminant.values < 0).any():
            raise BadData(f"{self.name}: the illuminant is negative (lowest {self.illuminant.values.min():.3g})")
        if self.depth is not None:
            if self.depth.shape != self._full_shape():
                raise BadData(f"{self.name}: depth {self.depth.shape} does not match the scene {self._full_shape()}")
            if not (self.depth > 0).all():
                raise BadData(f"{self.name}: depth must be positive everywhere [m]")

    def _full_shape(self):
        content = self.content
        if isinstance(content, Cube):
            return content.values.shape[1:]
        return content.coefficients.shape[1:] if isinstance(content, Basis) else content.ids.shape

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame (without the margin)."""
        rows, cols = self._full_shape()
        return rows - 2 * self.margin, cols - 2 * self.margin

    @property
    def wavelengths(self) -> np.ndarray:
        """The nodes [nm] at which the content is tabulated, shape (L,)."""
        return self.content.wavelengths

    @property
    def light_is_known(self) -> bool:
        """Whether the content is reflectance; else it is radiance [photon s-1 m-2 sr-1 nm-1], the illuminant 1."""
        return bool((self.illuminant.values != 1).any())


def unit_light(wavelengths) -> Spectrum:
    """Return the illuminant 1 of a scene of which only the radiance was measured, at `wavelengths` [nm]."""
    return Spectrum(np.asarray(wavelengths)[[0, -1]], np.ones(2), "unknown light")


def _check_content(content, name):
    """Refuse what no camera could see: wrong shapes, NaN, negative light, unsorted wavelengths."""
    if isinstance(content, Cube):
        planes, spectra = content.values, None
        if planes.ndim != 3 or len(planes) != len(content.wavelengths):
            raise BadData(f"{name}: cube of shape {planes.shape}, wanted ({len(content.wavelengths)}, rows, cols)")
    elif isinstance(content, Basis):
        planes, spectra = content.coefficients, content.basis
        if planes.ndim != 3 or spectra.shape != (len(planes), len(content.wavelengths)):
            raise BadData(f"{name}: basis {spectra.shape} does not match coefficients {planes.shape} and "
                          f"{len(content.wavelengths)} wavelengths")
    else:
        planes, spectra = content.shading, content.spectra
        if content.ids.ndim != 2 or planes.shape != content.ids.shape:
            raise BadData(f"{name}: ids {content.ids.shape} and shading {planes.shape} must be one (rows, cols)")
        if spectra.ndim != 2 or spectra.shape[1] != len(content.wavelengths):
            raise BadData(f"{name}: spectra {spectra.shape} do not match {len(content.wavelengths)} wavelengths")
    if planes.size == 0:
        raise BadData(f"{name}: zero-size scene {planes.shape}")
    if isinstance(content, Materials) and (content.ids.min() < 0 or content.ids.max() >= len(spectra)):
        raise OutOfRange(f"{name}: material id", int(content.ids.max()), f"0 .. {len(spectra) - 1}")
    Spectrum(content.wavelengths, np.zeros(len(content.wavelengths)), name)  # checks the wavelengths
    for label, values in (("samples", planes), ("spectra", spectra)):
        if values is None:
            continue
        low, high = float(values.min()), float(values.max())
        if not np.isfinite([low, high]).all():  # min and max carry NaN and infinities
            raise BadData(f"{name}: NaN or infinite {label}")
        if low < 0 and not isinstance(content, Basis):
            raise BadData(f"{name}: negative {label} (lowest {low:.3g}); radiance cannot be negative")
    if isinstance(content, Basis):  # coefficients may be negative, the spectra that they make may not
        lowest, highest = 0.0, 0.0
        for row in np.moveaxis(content.coefficients, 1, 0):  # row by row: the whole would be a cube
            spectra = content.basis.T @ row
            lowest, highest = min(lowest, float(spectra.min())), max(highest, float(spectra.max()))
        if lowest < -NEGATIVE * highest or highest == 0 > lowest:
            raise BadData(f"{name}: negative spectra (lowest {lowest:.3g}, highest {highest:.3g}); radiance cannot be "
                          "negative")
