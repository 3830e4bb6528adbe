"""A scene of an array, in one call."""

import numpy as np

from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.content import NUMBERS, Cube
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, UnknownName
from gpusim.domain.foreign import described, to_host, type_of
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.scene.photo import lift
from gpusim.io.scene.scenes import LIGHT, LUMINANCE, picture

UNITS = ("photon", "energy")


def scene_from(
    array,
    wavelengths=None,
    *,
    light: str | None = None,
    luminance: float = LUMINANCE,
    linear: bool = False,
    axis: int | None = None,
    unit: str = "photon",
    name: str = "scene",
    **options,
) -> Scene:
    """A scene of an array: a cube of reflectances or radiances, or an sRGB picture.

    array: with `wavelengths` [nm], shape (L,), a cube (L, rows, cols) or (rows, cols, L): the axis of L samples is that
        of the spectra; say `axis` 0 or -1 where both have L. Without them a picture in sRGB, (rows, cols, 3), or grey,
        (rows, cols): codes of uint8 or uint16, or numbers of which white is 1.
    light: name for `illuminant`. A cube with it is reflectance [1], and white in it has `luminance` [cd m-2]; a cube
        without it is radiance. A picture is reflectance in any case, in D65 by default.
    unit: of radiance: "photon" [photon s-1 m-2 sr-1 nm-1] or "energy" [W m-2 sr-1 nm-1].
    linear: whether the numbers of a picture are linear light; by default they are encoded, as in a file.
    options: as in Scene, such as border, depth or samples_per_pixel. An array of a device, or of another library, stays
        there where it is a cube by bands, (L, rows, cols), of reflectances or photons, or a picture of codes.
    Raises BadData, UnknownName, OutOfRange.
    """
    array = described(array if hasattr(array, "shape") else np.asarray(array), name)
    kind = type_of(array)
    if kind is None or kind.kind not in NUMBERS:
        raise BadData(f"{name}: array of type {kind or array.dtype}, wanted real numbers")
    if wavelengths is None:
        return _picture(array, kind, light or LIGHT, luminance, linear, name, options)
    if unit not in UNITS:
        raise UnknownName("unit", unit, UNITS)
    if linear:
        raise BadData(f"{name}: linear = True of a cube; it is for pictures: spectra are linear")
    wavelengths = np.asarray(wavelengths, np.float64)
    values = _by_bands(array, wavelengths, axis, name)
    if light is not None:
        return Scene(
            Cube(wavelengths, values),
            white_radiance(illuminant(light), luminance),
            name=name,
            **options,
        )
    if unit == "energy":
        values = (to_host(values, name) / energy_per_photon(wavelengths)[:, None, None]).astype(
            np.float32
        )
    return Scene(Cube(wavelengths, values), unit_light(wavelengths), name=name, **options)


def _by_bands(array, wavelengths, axis, name):
    """The array as (L, rows, cols), float32 where it was float64 or turned."""
    shape, count = tuple(array.shape), wavelengths.size
    if len(shape) != 3 or count not in (shape[0], shape[-1]):
        raise BadData(
            f"{name}: array of shape {shape} for {count} wavelengths, wanted ({count}, rows, cols) or (rows, "
            f"cols, {count})"
        )
    if axis is None:
        if shape[0] == shape[-1]:
            raise BadData(
                f"{name}: array of shape {shape}: both ends have {count} samples; say axis = 0 or axis = -1"
            )
        axis = 0 if shape[0] == count else -1
    if axis not in (0, -1, 2) or shape[axis] != count:
        raise BadData(
            f"{name}: axis = {axis!r} of shape {shape}, wanted 0 or -1, that of {count} wavelengths"
        )
    if axis == 0:
        return (
            array.astype(np.float32)
            if isinstance(array, np.ndarray) and array.dtype == np.float64
            else array
        )
    return np.ascontiguousarray(np.moveaxis(to_host(array, name), -1, 0), np.float32)


def _picture(array, kind, light, luminance, linear, name, options):
    if kind.kind == "u" and kind.itemsize <= 2:
        curve = np.linspace(0, 1, 256**kind.itemsize, dtype=np.float32) if linear else None
        return picture(array, light=light, luminance=luminance, curve=curve, name=name, **options)
    if kind.kind != "f":
        raise BadData(
            f"{name}: a picture of {kind}, wanted uint8, uint16 or numbers of which white is 1; or say the "
            "wavelengths of a cube"
        )
    values = to_host(array, name)
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    if values.ndim != 3 or values.shape[-1] != 3:
        raise BadData(
            f"{name}: array of shape {tuple(array.shape)}, wanted (rows, cols, 3) or (rows, cols) of a "
            "picture; or say the wavelengths of a cube"
        )
    if not (np.isfinite(values).all() and values.min(initial=0) >= 0):
        raise BadData(
            f"{name}: picture from {values.min():.3g} to {values.max():.3g}, wanted finite numbers, not "
            "negative"
        )
    if not linear and values.max(initial=0) > 1:
        raise BadData(
            f"{name}: encoded picture up to {values.max():.3g}, wanted 0 .. 1; or linear = True"
        )
    values = np.moveaxis(values if linear else DISPLAYS["srgb"].decode(values), -1, 0)
    return Scene(lift(values), white_radiance(illuminant(light), luminance), name=name, **options)
