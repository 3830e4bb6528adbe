"""Scenes and optical images of ISETCam (https://github.com/iset/isetcam, MIT) in MATLAB files.

Read are the structs `scene` and `opticalimage` by any name, and the variables of multispectral
files:

    scene.data.photons            (rows, cols, L)  radiance [photon s-1 m-2 sr-1 nm-1], or codes
                                  from dmin to dmax
    scene.spectrum.wave           (L,) [nm]
    scene.illuminant.data.photons (L,), or (rows, cols, L) if it varies: radiance of white
    scene.wAngular, depthMap      horizontal field of view [deg]; distances (rows, cols) [m]
    opticalimage                  likewise, photons is the irradiance at the sensor
                                  [photon s-1 m-2 nm-1]; optics.fNumber
    mcCOEF, basis.basis           (rows, cols, K), (L, K): radiance as a linear model; basis.wave,
                                  imgMean (L,)
    photons (or data), wave       (rows, cols, L), (L,): radiance
    illuminant.data, .wavelength  (L,) radiance of white in energy [W m-2 sr-1 nm-1], the older form
    fov, name                     of multispectral files
"""

import math
from pathlib import Path
from typing import NoReturn

import numpy as np

from gpusim.domain.content import Basis, Cube
from gpusim.domain.errors import BadFile, one_line
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.io.account import note_of
from gpusim.io.files import name_in_errors
from gpusim.io.scene.depth import axial_depth
from gpusim.io.scene.values import Value

SCENE, OPTICAL_IMAGE = "scene", "opticalimage"
NAMES = (SCENE, "oi", OPTICAL_IMAGE)  # structs; the first one present is read
# fields that say nothing about light or geometry, or the same in other words
IGNORED = {"type", "metadata", "comment", "consistency", "bitDepth", "filename", "date", "history"}
SAVE = "save('scene.mat', 'scene')"
LONGEST_NAME = 80
LEAST_PHOTONS = 1e6  # [photon s-1 m-2 sr-1 nm-1] 1e-7 cd m-2: less in `data` is in another unit
MOST_LIGHTS = 4  # most lights of a mix; each needs one plane per wavelength on the device
LIGHT_ERROR = 1e-3  # relative error of such light and of the surfaces; radiance is exact
LEAST_LIGHT = 1e-7  # relative to its mean; less counts as none


def read_iset(
    path,
    root: Value,
    key: str | None = None,
    ray: float | None = None,
    no_depth: bool = False,
) -> Scene | None:
    """Read a scene of ISETCam, see this module; return None if the file has none.

    Surfaces and light are separated if the file has the light; light that varies over the scene as
    a mix of up to 4 (`Illuminated`). A linear model is kept. An optical image becomes the radiance
    that gives its irradiance behind a lens of its f-number without blur; `notes` report this and
    other changes.

    root: from `open_mat`. key: name of the struct, if there are several. ray: horizontal field of
    view [rad] if distances are along each pixel's ray; None: they are along the axis. no_depth:
    leave distances out. Raises BadFile, DoesNotFit.
    """
    with name_in_errors(path):
        scene = _File(Path(path), root).scene(key, ray, no_depth)
    if scene is None:
        return None
    if ray and scene.depth is None:
        raise BadFile(path, 'depth = "ray", but there is no depthMap of a scene')
    return scene


def is_iset(path, root: Value) -> bool:
    """Return whether an open file has a scene of ISETCam. Raises BadFile."""
    file = _File(Path(path), root)
    return bool("mcCOEF" in root.names or file.own_cube() or file.only_object(None))


class _File:
    """An open file; its values are checked when they are read."""

    def __init__(self, path, root):
        self.path, self.root, self.notes = path, root, []

    def refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def scene(self, key, ray, no_depth):
        """Return the scene, or None if there is none of ISETCam."""
        names = self.root.names
        if key is None and "mcCOEF" in names:
            content = self.linear_model()
        elif key is None and (cube := self.own_cube()):
            content = self.cube(self.root, cube, self.waves(self.root))
        else:
            found = self.only_object(key)
            return found and self.scene_of_object(found, ray, no_depth)
        content, light = self.split_light(content, self.root.get("illuminant"))
        return self.make_scene(content, light, self.root, self.root.get("fov"))

    def own_cube(self) -> str | None:
        """Return the name of the radiance of a multispectral file, or None."""
        if "photons" in self.root.names:
            return "photons"
        waves = self.root.get("wave") or self.root.get("wavelength")
        data = self.root.get("data")
        if waves is None or data is None or data.kind != "numbers":
            return None
        # the name alone does not say the unit
        is_radiance = self.root.get("dmax") or data.numbers().max(initial=0) > LEAST_PHOTONS
        return "data" if is_radiance else None

    def only_object(self, key) -> Value | None:
        """Return the only struct with photons, or a scene by its usual name; None without one."""
        names = self.root.names if key is None else [key]
        held = {name: value for name in names if (value := self.root.get(name)) is not None}
        own = [held[name] for name in NAMES if name in held and held[name].kind == "struct"]
        found = [value for value in held.values() if value.get("data", "photons") is not None]
        if not own and len(found) > 1:
            names = ", ".join(value.label for value in found)
            self.refuse(
                f"several structs with data.photons ({names}); choose one by "
                f'key="{found[0].label}" or --key'
            )
        usual = [value for value in own if value.get("type") or value.get("data")]
        return next(iter(usual or found), None)

    def scene_of_object(self, value, ray, no_depth):
        """Return the scene from ISETCam's scene or optical image."""
        kind = self.text(value, "type", SCENE).lower()
        if kind not in (SCENE, OPTICAL_IMAGE):
            why = f"{value.label}: of type {kind!r}; wanted {SCENE!r} or {OPTICAL_IMAGE!r}, {SAVE}"
            self.refuse(why)
        data = value.get("data")
        if data is None or data.get("photons") is None:
            self.refuse(f"{value.label}: no data.photons; compute it before saving")
        content = self.cube(data, "photons", self.waves(value.get("spectrum") or value))
        distances = None
        if kind == OPTICAL_IMAGE:
            content = content.scale(self.per_irradiance(value))
            light = unit_light(content.wavelengths)
        else:
            content, light = self.split_light(content, value.get("illuminant"))
            distances = value.get("depthMap") if not no_depth else None
        if distances is not None:
            distances = axial_depth(
                self.path, "depthMap", distances.numbers(), "ray" if ray else "axis", ray
            )
        return self.make_scene(content, light, value, value.get("wAngular"), distances)

    def per_irradiance(self, value):
        """Return radiance over irradiance of an optical image's lens at infinity focus [sr-1]."""
        number = value.get("optics", "fNumber") or value.get("optics", "rayTrace", "fNumber")
        if number is None:
            self.refuse(
                f"{value.label}: an optical image without optics.fNumber, which converts its "
                "irradiance to radiance; set it, or save the scene"
            )
        number = self.single(number)
        if not 0 < number < 1e6:
            self.refuse(f"{value.label}: optics.fNumber = {number:.4g}, wanted a positive number")
        self.notes.append(
            f"optical image: its irradiance as the radiance that gives it behind a lens of f/{number:.4g}; "
            f'to avoid further blur and shading: [optics] f_number = {number:.4g}, model = "none", '
            'relative_illumination = "none"'
        )
        return (1 + 4 * number**2) / math.pi  # see Optics.irradiance_factor

    # ---- the parts

    def single(self, value) -> float:
        numbers = value.numbers()
        if numbers.size != 1 or not np.isfinite(numbers).all():
            self.refuse(f"{value.label}: shape {value.shape}, wanted one finite number")
        return float(numbers.item())

    def vector(self, value) -> np.ndarray:
        numbers = value.numbers()
        if numbers.size != max(numbers.shape):
            self.refuse(f"{value.label}: shape {value.shape}, wanted a vector")
        return numbers.ravel().astype(np.float64)

    def waves(self, owner) -> np.ndarray:
        """Return the wavelengths of a struct [nm]."""
        value = owner.get("wave") or owner.get("wavelength")
        if value is None:
            self.refuse(f"{owner.label}: no wavelengths (spectrum.wave, wave or wavelength)")
        wavelengths = self.vector(value)
        if not len(wavelengths) or not (np.diff(wavelengths) > 0).all():
            self.refuse(f"{value.label}: wanted wavelengths [nm] that increase strictly")
        return wavelengths

    def text(self, owner, key, other: str) -> str:
        """Return a text of a struct, or `other` if it has none."""
        value = owner.get(key)
        return one_line((value and value.text()) or "", LONGEST_NAME) or other

    def make_scene(self, content, light, owner, degrees, depth=None):
        fov = None if degrees is None else math.radians(self.single(degrees))
        name = self.text(owner, "name", self.path.stem)
        left = [one for one in self.root.unused() if not IGNORED.intersection(one.split("."))]
        notes = (*self.notes, *note_of("not used", left))
        return Scene(content, light, fov=fov, depth=depth, name=name, notes=notes)

    def cube(self, owner, key, wavelengths):
        return Cube(wavelengths, self.planes(owner, key, len(wavelengths)))

    def planes(self, owner, key, count) -> np.ndarray:
        """Return numbers (rows, cols, count) of a struct as float32, band-major, codes decoded."""
        value = owner.get(key)
        if value is None:
            self.refuse(f"{owner.label}: no {key}")
        shape = (*value.shape, 1)[:3] if len(value.shape) == 2 else value.shape
        if len(shape) != 3 or shape[2] != count:
            self.refuse(
                f"{value.label}: shape {value.shape}, wanted (rows, cols, {count}), one plane per "
                "wavelength or basis function"
            )
        array = value.numbers().reshape(shape)
        require_memory(f"{self.path}: {value.label}", 4 * array.size)
        low, step = 0.0, 1.0
        if array.dtype.kind != "f":
            low, step = self.codes(owner, value, array.dtype)
        planes = np.empty((count, *shape[:2]), np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite values are refused
            for number in range(count):
                plane = array[..., number]
                planes[number] = plane if step == 1 else plane * step + low
        if not np.isfinite([planes.min(initial=0), planes.max(initial=0)]).all():
            self.refuse(f"{value.label}: NaN or infinite numbers, or more than float32 holds")
        return planes

    def codes(self, owner, value, dtype):
        """Return least value and step of integer codes from 0 to the largest of their type."""
        low, high = owner.get("dmin") or owner.get("min"), owner.get("dmax") or owner.get("max")
        if dtype.kind != "u" or low is None or high is None:
            self.refuse(f"{value.label}: {dtype}, wanted floats, or uint16 with dmin and dmax")
        low, high = self.single(low), self.single(high)
        if not high >= low:
            self.refuse(f"{owner.label}: dmin = {low:.4g}, dmax = {high:.4g}; wanted dmin <= dmax")
        return low, (high - low) / np.iinfo(dtype).max

    def linear_model(self):
        basis = self.root.get("basis")
        if basis is None:
            self.refuse("mcCOEF without basis")
        wavelengths = self.waves(basis if basis.kind == "struct" else self.root)
        table = basis.get("basis") if basis.kind == "struct" else basis
        spectra = np.zeros((0, 0)) if table is None else table.numbers().astype(np.float64)
        if spectra.ndim != 2 or len(spectra) != len(wavelengths):
            self.refuse(
                f"basis: shape {spectra.shape}, wanted ({len(wavelengths)}, functions), one row for "
                "each wavelength"
            )
        planes, mean = self.planes(self.root, "mcCOEF", spectra.shape[1]), self.root.get("imgMean")
        if mean is not None:
            mean = self.vector(mean)
            if len(mean) != len(wavelengths):
                self.refuse(f"imgMean: {len(mean)} numbers, wanted {len(wavelengths)}")
            require_memory(f"{self.path}: mcCOEF", planes.nbytes)
            planes = np.concatenate([planes, np.ones((1, *planes.shape[1:]), np.float32)])
            spectra = np.column_stack([spectra, mean])
        return Basis(wavelengths, planes, np.ascontiguousarray(spectra.T))

    # ---- light and surfaces

    def split_light(self, content, illuminant):
        """Return surfaces and light if the light is known, else radiance and an illuminant of 1."""
        data = illuminant and illuminant.get("data")
        photons = data and (data.get("photons") if data.kind == "struct" else data)
        if photons is None:
            return content, unit_light(content.wavelengths)
        own = illuminant.get("spectrum", "wave") or illuminant.get("wavelength")
        own = own or illuminant.get("wave")
        own = content.wavelengths if own is None else self.vector(own)
        if math.prod(photons.shape) > max(photons.shape):
            found = self.split_light_map(content, data, own)
        else:
            found = self.split_one_light(content, illuminant, own)
        if found is None:
            self.notes.append("radiance is kept; its light is unknown")
            return content, unit_light(content.wavelengths)
        if (most := found[0].mean_spectrum().max()) > 1:
            note = f"the illuminant has another scale: mean reflectance up to {most:.3g}"
            self.notes.append(note)
        return found

    def split_one_light(self, content, illuminant, own):
        """Return surfaces in one light; None if it is dark."""
        data = illuminant.get("data")
        name = self.text(illuminant, "name", self.text(illuminant, "comment", "light"))
        in_energy = data.kind != "struct"
        photons = data if in_energy else data.get("photons")
        values, kind = self.vector(photons), photons.numbers().dtype
        if len(values) != len(own):
            self.refuse(f"{photons.label}: {len(values)} numbers for {len(own)} wavelengths")
        if kind.kind != "f" and not in_energy:
            low, step = self.codes(data, photons, kind)
            values = low + step * values
        light = Spectrum(own, values, name)
        light = photons_from_energy(light) if in_energy else light
        at = light.at(content.wavelengths)
        if (at > 0).all() and (light.values >= 0).all():
            return content.divide_by(at), light
        self.notes.append(f"the illuminant is dark at {(at <= 0).sum()} of {len(at)} wavelengths")
        return None

    def split_light_map(self, content, data, own):
        """Return surfaces in light that varies over the scene; None if a few lights do not fit."""
        is_cube = isinstance(content, Cube) and np.array_equal(own, content.wavelengths)
        if not is_cube or data.kind != "struct":
            self.refuse(
                "an illuminant that varies over the scene: wanted photons at the scene's wavelengths"
            )
        light = self.planes(data, "photons", len(own))
        if light.shape != content.values.shape:
            self.refuse(
                f"{data.label}: {light.shape[1:]} samples of light for {content.shape} of the scene"
            )
        require_memory(f"{self.path}: light that varies", 12 * light.nbytes)
        found = _separate_lights(light)
        if found is not None:
            mean, maps, lights = found
            mixed = np.tensordot((lights * mean).T.astype(np.float32), maps, 1)
            lit = (light > 0) & (mixed > 0)
            if not content.values[~lit].any():  # else unlit samples emit light
                surfaces = np.divide(content.values, mixed, out=np.zeros_like(mixed), where=lit)
                seen = Illuminated(own, maps, surfaces, np.eye(len(own)), lights)
                return seen, Spectrum(own, mean, "light that varies")
        self.notes.append(f"light varies over the scene and is no mix of {MOST_LIGHTS} lights")
        return None


def _separate_lights(light):
    """Return light (L, rows, cols) as a mix of the fewest lights, or None.

    Returns mean (L,), maps (K, ...) and lights (K, L) relative to the mean. Maps are not negative:
    spectra of sum 1 are points of a plane, and the lights are the corners of a simplex around all
    of them, in which a point has weights from 0 to 1.
    """
    flat = light.reshape(len(light), -1).astype(np.float64)
    mean = flat.mean(axis=1)
    if not (np.isfinite(mean).all() and flat.min() >= 0 and mean.min() > 0):
        return None
    flat /= mean[:, None]
    lit = flat.any(axis=0)
    axes = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    for count in range(1, min(MOST_LIGHTS, len(mean)) + 1):
        axis = axes[:, :count]
        parts, sums = axis.T @ flat, axis.sum(axis=0)
        total = sums @ parts
        if not (total[lit] > 0).all():
            continue
        plane = np.linalg.svd(sums[None])[2][1:].T  # directions with constant sum
        places = plane.T @ np.divide(parts, total, out=np.zeros_like(parts), where=lit)
        low = places[:, lit].min(axis=1)
        size = (places[:, lit].sum(axis=0) - low.sum()).max() or 1.0
        weights = np.maximum((places - low[:, None]) / size, 0)
        maps = np.concatenate([np.maximum(1 - weights.sum(axis=0), 0)[None], weights])
        maps *= np.where(lit, total, 0)
        ends = np.column_stack([low, low[:, None] + size * np.eye(count - 1)])
        corners = sums / (sums @ sums) + (plane @ ends).T
        lights = corners @ axis.T
        if (np.abs(lights.T @ maps - flat) <= LIGHT_ERROR * flat + LEAST_LIGHT).all():
            return mean, maps.reshape(count, *light.shape[1:]).astype(np.float32), lights
    return None
