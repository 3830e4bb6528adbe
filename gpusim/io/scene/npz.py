"""Scenes as NumPy archives.

gpusim's own keys, all arrays band-major:

    wavelengths_nm             (L,)             nodes of the spectra
    cube                       (L, rows, cols)  form 1: samples
    coefficients, basis        (K, rows, cols), (K, L): form 2: linear model
    ids, shading, spectra      (rows, cols) integer, (rows, cols), (M, L): form 3: materials
    maps, lights               (K, rows, cols), (K, L): form 2 in light that varies
    illuminant_wavelengths_nm  (N,) [nm]
    illuminant                 (N,) [photon s-1 m-2 sr-1 nm-1], radiance of white: the content is
                               reflectance; without these two it is radiance, in the same unit
    kind                       "reflectance" of `cube` with an unknown light; else "radiance"
    border, margin, fov_rad, depth_m, name, samples_per_pixel  as in Scene
    projection                 "plane" or "equirectangular"
    label_NAME                 labels of Scene, for example label_instance, label_flow, label_boxes

Also read are archives made from ISETCam's scenes, whose arrays are pixel-major: `photons` (rows,
cols, L), or `coef` (rows, cols, K) with `basis` (K, L); `wave` (L,); `illuminant_photons` (L,) if
known; `fov_deg`. Only the key determines the order of the axes, never their lengths.
"""

from pathlib import Path
from typing import NoReturn

import numpy as np

from gpusim.domain.content import Basis, Cube, Materials
from gpusim.domain.errors import BadFile, format_value
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.scene import IMAGE, PLANE, Scene, unit_light
from gpusim.domain.spectrum import Spectrum
from gpusim.io.archive import NUMBERS, TEXT, Archive, ArchivePart, open_archive, write_archive
from gpusim.io.files import name_in_errors

COPIES = 1.0  # of the numbers: as float32, and divided by the light
LABEL = "label_"  # begins the keys of labels
LIGHT_FIELD = "radius_m"  # key that only light fields have
LABEL_NUMBERS = "buif"  # NumPy's letters for kinds of types
# keys that determine the form of an archive
FORMS = ("cube", "coefficients", "ids", "photons", "coef")


def write_npz(path, scene: Scene):
    """Write a complete scene for `read_npz`. Raises BadFile."""
    check_whole(path, scene)
    write_archive(path, scene_arrays(scene))


def scene_arrays(scene: Scene) -> dict:
    """Return the arrays of a scene by their keys, without layers and view."""
    content = scene.content.on_host()
    arrays: dict = {"wavelengths_nm": content.wavelengths}
    arrays |= {
        "cube" if name == "values" else name: getattr(content, name)
        for name in (*content.samples, *content.shared)
    }
    arrays |= {
        "illuminant_wavelengths_nm": scene.illuminant.wavelengths,
        "illuminant": scene.illuminant.values,
        "border": scene.border,
        "margin": scene.margin,
        "name": scene.name,
        "samples_per_pixel": scene.samples_per_pixel,
    }
    if scene.fov is not None:
        arrays["fov_rad"] = scene.fov
    if scene.projection != PLANE:
        arrays["projection"] = scene.projection
    if scene.depth is not None:
        arrays["depth_m"] = scene.depth
    return arrays | {f"{LABEL}{name}": label for name, label in scene.labels.items()}


def check_whole(path, scene: Scene):
    """Raise BadFile if a scene has a view or layers: files hold one picture and its depth."""
    if not scene.view.is_plain:
        why = f"{scene.name} has a view, which files cannot hold: write it without view"
        raise BadFile(path, why)
    if scene.projection == IMAGE:
        raise BadFile(path, f"{scene.name} is the image of a lens: write the panorama instead")
    if scene.layers:
        why = f"{scene.name} has {len(scene.layers)} layers; a file holds one picture and its depth"
        raise BadFile(path, why)


def read_npz(path, white: Spectrum) -> Scene:
    """Read a scene.

    white: radiance of white [photon s-1 m-2 sr-1 nm-1] for an archive of reflectances with unknown
    light. Raises BadFile, naming file and key, and DoesNotFit.
    """
    with open_archive(path) as stored, name_in_errors(path):
        stored.require_memory(COPIES)
        return SceneArchive(Path(path), stored).scene(white)


class SceneArchive:
    """An open archive, or a part of one; its arrays are checked when they are read."""

    def __init__(self, path, stored: Archive | ArchivePart):
        self.path, self.stored = path, stored

    def refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def array(self, key, *shape, negative=False):
        """Return finite numbers under `key`; None in `shape` is any length."""
        self.stored.shape(key, wanted=shape)
        array = self.stored[key]
        low, high = float(array.min()), float(array.max())
        if not np.isfinite([low, high]).all():
            self.refuse(f"{key}: NaN or infinite values")
        if low < 0 and not negative:
            self.refuse(f"{key}: negative values (lowest {low:.3g})")
        return array

    def planes(self, key, *shape, pixel_major=False, negative=False):
        """Return an image stack under `key` as float32, band-major."""
        array = self.array(key, *shape, negative=negative)
        largest = max(float(array.max()), -float(array.min()))
        if largest > float(np.finfo(np.float32).max):
            self.refuse(f"{key}: values up to {largest:.3g}, more than float32 holds")
        return np.ascontiguousarray(np.moveaxis(array, -1, 0) if pixel_major else array, np.float32)

    def single(self, key, default):
        """Return one value under `key`, of the type of `default`."""
        if key not in self.stored:
            return default
        self.stored.shape(key, TEXT if type(default) is str else NUMBERS, wanted=())
        value = self.stored[key].item()
        try:
            return type(default)(value)
        except (ValueError, OverflowError):  # not a number, or infinite for a whole number
            why = f"{key}: wanted one {type(default).__name__}, got {format_value(value)}"
            raise BadFile(self.path, why) from None

    def scene(self, white):
        """Return the scene in the archive."""
        if LIGHT_FIELD in self.stored and isinstance(self.stored, Archive):
            self.refuse("a light field: open it with gs.open_light_field")
        forms = [key for key in FORMS if key in self.stored]
        if len(forms) != 1:
            why = f"needs exactly one of the keys {', '.join(FORMS)}; it has {sorted(self.stored)}"
            self.refuse(why)
        key = "wavelengths_nm"
        if key not in self.stored and "wave" in self.stored:
            key = "wave"
        wavelengths = self.array(key, None).astype(np.float64)
        if not len(wavelengths) or not (np.diff(wavelengths) > 0).all():
            self.refuse(f"{key}: needs wavelengths that increase strictly")
        content = self.content(forms[0], wavelengths)
        content, illuminant = self.split_light(content, white)
        depth = self.planes("depth_m", None, None) if "depth_m" in self.stored else None
        fov = self.single("fov_rad", 0.0) or np.deg2rad(self.single("fov_deg", 0.0)) or None
        return Scene(
            content,
            illuminant,
            border=self.single("border", "edge"),
            margin=self.single("margin", 0),
            fov=fov,
            depth=depth,
            name=self.single("name", self.path.stem),
            samples_per_pixel=self.single("samples_per_pixel", 1.0),
            projection=self.single("projection", PLANE),
            labels={
                key.removeprefix(LABEL): self.label(key)
                for key in sorted(self.stored)
                if key.startswith(LABEL)
            },
            notes=self.stored.notes(),  # of what was not read before
        )

    def label(self, key):
        """Return a label, in the type of the file."""
        self.stored.shape(key, LABEL_NUMBERS)
        return self.stored[key]

    def content(self, form, wavelengths):
        """Return the pixels, still in the unit of the file."""
        bands = len(wavelengths)
        if form == "cube":
            return Cube(wavelengths, self.planes("cube", bands, None, None))
        if form == "photons":
            return Cube(wavelengths, self.planes("photons", None, None, bands, pixel_major=True))
        if form == "ids":
            ids, spectra = self.array("ids", None, None), self.array("spectra", None, bands)
            if ids.dtype.kind == "f" or ids.max() > 65535:
                self.refuse(f"ids: {ids.dtype} up to {ids.max()}, wanted integers up to 65535")
            return Materials(
                wavelengths,
                ids.astype(np.uint8 if ids.max() < 256 else np.uint16),
                self.planes("shading", *ids.shape),
                spectra.astype(np.float64),
            )
        basis = self.array("basis", None, bands, negative=True).astype(np.float64)
        shape = (None, None, len(basis)) if form == "coef" else (len(basis), None, None)
        planes = self.planes(form, *shape, pixel_major=form == "coef", negative=True)
        if "maps" not in self.stored:
            return Basis(wavelengths, planes, basis)
        lights = self.array("lights", None, bands, negative=True).astype(np.float64)
        return Illuminated(
            wavelengths, self.planes("maps", len(lights), *planes.shape[1:]), planes, basis, lights
        )

    def split_light(self, content, white):
        """Return reflectance and light if the light is known, else radiance and a light of 1."""
        wavelengths = content.wavelengths
        if "illuminant" in self.stored:
            nodes = self.array("illuminant_wavelengths_nm", None)
            return content, Spectrum(nodes, self.array("illuminant", len(nodes)), "illuminant")
        if "illuminant_photons" in self.stored:
            light = self.array("illuminant_photons", len(wavelengths)).astype(np.float64)
            if (light > 0).all():  # else the radiance is kept: a dark band has no reflectance
                return content.divide_by(light), Spectrum(wavelengths, light, "illuminant")
        kind = self.single("kind", "radiance")
        if kind not in ("radiance", "reflectance"):
            self.refuse(f'kind: {kind!r}, wanted "radiance" or "reflectance"')
        return content, white if kind == "reflectance" else unit_light(wavelengths)
