"""Scenes from arrays."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.content import NUMBERS, Cube
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile, UnknownName
from gpusim.domain.memory import describe_array, to_host, type_of
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.scene.photo import lift
from gpusim.io.scene.scenes import LIGHT, LUMINANCE, picture, relight

UNITS = ("photon", "energy")


def scene_from(
    array: Any,
    wavelengths: ArrayLike | None = None,
    *,
    light: str | None = None,
    luminance: float | None = None,
    linear: bool = False,
    axis: int | None = None,
    unit: str = "photon",
    name: str = "scene",
    **options: Any,
) -> Scene:
    """Return a scene from an array: a cube of reflectances or radiances, or an sRGB picture.

    A device array, or one of another library, stays on its device if it is a band-major cube (L,
    rows, cols) of reflectances or photons, or a picture of codes.

    Args:
        array: with `wavelengths` a cube, (L, rows, cols) or (rows, cols, L). Without them a picture
            in sRGB, (rows, cols, 3) or grey (rows, cols): codes of uint8 or uint16, or numbers with
            white 1.
        wavelengths: wavelengths of the cube, shape (L,) [nm]; None for a picture.
        light: name of an `illuminant`. A cube with it is reflectance [1], a cube without it is
            radiance. A picture is always reflectance, in D65 by default.
        luminance: luminance of white in that light [cd m-2], 100 by default; of a cube of radiance
            its mean luminance, None keeps its own.
        linear: a picture's numbers are proportional to light; otherwise they are sRGB-encoded.
        axis: axis of the spectra, 0 or -1; needed if both ends of the array have L samples.
        unit: unit of radiance: "photon" [photon s-1 m-2 sr-1 nm-1] or "energy" [W m-2 sr-1 nm-1].
        name: name of the scene.
        options: further fields of Scene: border, depth, samples_per_pixel ...

    Returns:
        The scene.

    Raises:
        BadData: if the array's type, shape or values do not fit.
        UnknownName: if the unit or the light is unknown.
        OutOfRange: if an option is out of range.
    """
    array = describe_array(array if hasattr(array, "shape") else np.asarray(array), name)
    kind = type_of(array)
    if kind is None or kind.kind not in NUMBERS:
        raise BadData(f"{name}: array of type {kind or array.dtype}, wanted real numbers")
    if wavelengths is None:
        level = LUMINANCE if luminance is None else luminance
        return _picture(array, kind, light or LIGHT, level, linear, name, options)
    if unit not in UNITS:
        raise UnknownName("unit", unit, UNITS)
    if linear:
        raise BadData(f"{name}: linear = True is for pictures only; spectra are always linear")
    wavelengths = np.asarray(wavelengths, np.float64)
    values = _by_bands(array, wavelengths, axis, name)
    if light is not None:
        white = white_radiance(illuminant(light), LUMINANCE if luminance is None else luminance)
        return Scene(Cube(wavelengths, values), white, name=name, **options)
    if unit == "energy":
        energy = energy_per_photon(wavelengths)[:, None, None]
        values = (to_host(values, name) / energy).astype(np.float32)
    scene = Scene(Cube(wavelengths, values), unit_light(wavelengths), name=name, **options)
    try:
        return relight(name, scene, None, luminance)
    except BadFile as error:
        raise BadData(str(error)) from None


def _by_bands(array, wavelengths, axis, name):
    """Return the array as (L, rows, cols), as float32 if it was float64 or turned."""
    shape, count = tuple(array.shape), wavelengths.size
    if len(shape) != 3 or count not in (shape[0], shape[-1]):
        raise BadData(
            f"{name}: array of shape {shape} for {count} wavelengths, wanted ({count}, rows, cols) or "
            f"(rows, cols, {count})"
        )
    if axis is None:
        if shape[0] == shape[-1]:
            raise BadData(
                f"{name}: array of shape {shape}: both ends have {count} samples; give axis = 0 or "
                "axis = -1"
            )
        axis = 0 if shape[0] == count else -1
    if axis not in (0, -1, 2) or shape[axis] != count:
        raise BadData(
            f"{name}: axis = {axis!r} of shape {shape}, wanted 0 or -1, the axis of {count} "
            "wavelengths"
        )
    if axis == 0:
        is_double = isinstance(array, np.ndarray) and array.dtype == np.float64
        return array.astype(np.float32) if is_double else array
    return np.ascontiguousarray(np.moveaxis(to_host(array, name), -1, 0), np.float32)


def _picture(array, kind, light, luminance, linear, name, options):
    """Return a scene from a picture of codes or numbers."""
    if kind.kind == "u" and kind.itemsize <= 2:
        curve = np.linspace(0, 1, 256**kind.itemsize, dtype=np.float32) if linear else None
        return picture(array, light=light, luminance=luminance, curve=curve, name=name, **options)
    if kind.kind != "f":
        raise BadData(
            f"{name}: a picture of {kind}, wanted uint8, uint16 or floats with white 1; or give the "
            "wavelengths of a cube"
        )
    values = to_host(array, name)
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    if values.ndim != 3 or values.shape[-1] != 3:
        raise BadData(
            f"{name}: array of shape {tuple(array.shape)}, wanted (rows, cols, 3) or (rows, cols) of a "
            "picture; or give the wavelengths of a cube"
        )
    if not (np.isfinite(values).all() and values.min(initial=0) >= 0):
        raise BadData(
            f"{name}: picture from {values.min():.3g} to {values.max():.3g}, wanted finite numbers, "
            "not negative"
        )
    if not linear and values.max(initial=0) > 1:
        why = f"{name}: encoded picture up to {values.max():.3g}, wanted 0 .. 1; or linear = True"
        raise BadData(why)
    values = np.moveaxis(values if linear else DISPLAYS["srgb"].decode(values), -1, 0)
    return Scene(lift(values), white_radiance(illuminant(light), luminance), name=name, **options)
