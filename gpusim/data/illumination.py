"""Light that varies over a scene: several lights, each with a map of its strength."""

import dataclasses
from functools import reduce
from typing import Any

import numpy as np

from gpusim.data.lights import light_of, white_radiance
from gpusim.domain.content import check_not_negative, is_seen
from gpusim.domain.errors import BadData
from gpusim.domain.illuminated import Illuminated, spline, surfaces_of
from gpusim.domain.memory import describe_array
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.spectrum import Spectrum

CLOSE = 1e-4  # accepted error of a light in a channel, relative to its largest channel value
BAND = 30.0  # [nm] full width at half maximum of a channel: narrow for a camera
HALVINGS = 2  # largest number of halvings of the wavelength steps: 10 nm become 2.5
STEP = 0.1  # [nm] step of integrals
EDGE = 1e-3  # [nm] distance in which the end of a table falls to zero


def illuminate(scene: Scene, lights: dict[Any, Any]) -> Scene:
    """Return the surfaces of a scene in other light, which varies over the scene.

    The result keeps the wavelengths of the scene and adds more if the lights need them: spectral
    lines stay as sharp as their tables. The surfaces of materials and pictures become a basis; each
    light multiplies the number of planes.

    Args:
        scene: Scene of reflectances in any form. Its own light is not used.
        lights: {light: map}. A light is a name for `illuminant`, or a Spectrum of relative power in
            energy units. A map is the luminance of a perfect white diffuser in only this light [cd
            m-2], an array of the shape of the scene's samples, or one number.

    Returns:
        A scene with Illuminated content, whose illuminant is the mean of all light.

    Raises:
        BadData: The scene has layers or unknown light, or a map has the wrong shape or values.
        OutOfRange: A light has no visible power.
        UnknownName: A light is not known.
    """
    scene = checked_scene(scene, True)
    if not scene.light_is_known:
        raise BadData(
            f"{scene.name}: holds radiance, its own light is not known: there are no surfaces to light"
        )
    if scene.layers:
        raise BadData(
            f"{scene.name}: {len(scene.layers)} layers, which have their own content; wanted a scene "
            "without"
        )
    if not isinstance(lights, dict) or not lights:
        raise BadData(
            f"lights: {type(lights).__name__}, wanted {{light: map}} of at least one light"
        )
    maps = np.stack([_map(label, values, scene) for label, values in lights.items()])
    # with luminance 1 each, the maps keep their unit
    units = [white_radiance(light_of(light), 1.0) for light in lights]
    surfaces = surfaces_of(scene.content)
    together = _total(units, maps.mean(axis=(1, 2), dtype=np.float64))
    wavelengths, spectra = _spectra(surfaces.wavelengths, units, together)
    basis = spline(surfaces.wavelengths, surfaces.basis, wavelengths)
    content = Illuminated(wavelengths, maps, surfaces.coefficients, basis, spectra)
    return dataclasses.replace(scene, content=content, illuminant=together)


def _map(label, values, scene):
    """Return the map of a light as float32 in the shape of the scene's samples."""
    name = f"{scene.name}: map of {label if isinstance(label, str) else getattr(label, 'name', '') or 'a light'}"
    values = describe_array(values, name) if hasattr(values, "shape") else values
    try:
        values = np.asarray(values, np.float32)
    except (TypeError, ValueError):
        raise BadData(
            f"{name}: {type(values).__name__}, wanted an array of real numbers, or one"
        ) from None
    if values.shape not in ((), scene.content.shape):
        raise BadData(
            f"{name}: shape {values.shape}, wanted {scene.content.shape} as the scene's samples, or "
            "one number"
        )
    if is_seen(values):
        check_not_negative(f"{name}:", values, "luminance")
    return np.broadcast_to(values, scene.content.shape)


def _total(units, means):
    """Return the sum of all light at its mean strength, on the wavelengths of all tables."""
    if not means.any():
        raise BadData("lights: all maps are dark")
    # A table that ends above zero falls to zero at once: no ramp to the next wavelength.
    ends = [
        end for unit in units for end in (unit.wavelengths[0] - EDGE, unit.wavelengths[-1] + EDGE)
    ]
    wavelengths = reduce(np.union1d, [*(unit.wavelengths for unit in units), ends])
    values = sum(mean * unit.at(wavelengths) for unit, mean in zip(units, means, strict=True))
    return Spectrum(wavelengths, values, " + ".join(unit.name for unit in units))


def _spectra(wavelengths, units, together):
    """Return the fewest wavelengths, including the given ones, that hold the lights.

    Also returns the lights relative to their sum. Shapes (L,) and (K, L).
    """
    for _ in range(HALVINGS):
        ratios, error = _ratios(wavelengths, units, together)
        if error <= CLOSE:
            return wavelengths, ratios
        wavelengths = np.union1d(wavelengths, (wavelengths[1:] + wavelengths[:-1]) / 2)
    return wavelengths, _ratios(wavelengths, units, together)[0]


def _ratios(wavelengths, units, together):
    """Return lights relative to their sum, (K, L), and the largest relative error in a band.

    The ratio of lamps with spectral lines is not smooth, and its values at wavelengths say nothing
    about the range between them. It is projected (Galerkin): the cubic spline through the values,
    times the sum of light, has the same integral as the light over every cubic spline on these
    wavelengths. This also holds for the product of a smooth surface and a channel. The bands
    belong to a camera with narrow channels.
    """
    fine = np.union1d(np.arange(wavelengths[0], wavelengths[-1], STEP), wavelengths)
    steps = np.diff(fine) / 2
    quadrature = np.append(steps, 0) + np.append(0, steps)
    whole = together.at(fine) * quadrature
    parts = np.stack([unit.at(fine) for unit in units]) * quadrature
    splines = spline(wavelengths, np.eye(len(wavelengths)), fine)
    ratios = np.linalg.lstsq((splines * whole) @ splines.T, splines @ parts.T, rcond=1e-12)[0].T
    centers = np.arange(wavelengths[0], wavelengths[-1] + STEP, BAND / 8)
    bands = np.exp(-4 * np.log(2) * ((fine - centers[:, None]) / BAND) ** 2)
    surface = (wavelengths - wavelengths[0]) / (wavelengths[-1] - wavelengths[0])
    wrong, seen = [], []
    for reflectance in (np.ones(len(wavelengths)), 1 - surface, surface):
        wrong.append(
            (
                (ratios * reflectance) @ splines * whole
                - parts * np.interp(fine, wavelengths, reflectance)
            )
            @ bands.T
        )
        seen.append(parts @ bands.T)
    return ratios, float(np.abs(wrong).max() / np.max(seen)) if len(units) > 1 else 0.0
