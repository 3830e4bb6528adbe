"""Light that varies over a scene: several lights, each with a map of how strong it is."""

import dataclasses
from functools import reduce

import numpy as np

from gpusim.data.lights import light_of, white_radiance
from gpusim.domain.content import is_seen
from gpusim.domain.errors import BadData
from gpusim.domain.foreign import described
from gpusim.domain.illuminated import Illuminated, spline, surfaces_of
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.spectrum import Spectrum

CLOSE = 1e-4  # error of a light in a channel, relative to the light's largest there, that its spectrum may cause
BAND = 30.0  # [nm] full width at half maximum of a channel: narrow for a camera
HALVINGS = 2  # of the steps between a scene's wavelengths, at most: 10 nm become 2.5
STEP = 0.1  # [nm] of integrals
EDGE = 1e-3  # [nm] in which a table's end becomes zero


def illuminated(scene: Scene, lights: dict) -> Scene:
    """A scene's surfaces in other light, which varies over it.

    scene: of reflectances, in any form; its own light is left out. lights: {light: map}. A light is a name for
    `illuminant` or a Spectrum of relative power in energy units. A map is the luminance of a perfect white diffuser in
    this light alone [cd m-2], an array of the shape of the scene's samples, or one number.
    Returns a scene whose content is Illuminated, and whose illuminant is the mean of all the light. Its wavelengths are
    those of the scene, and more where the lights need them: lines stay as sharp as their tables. Of materials, and
    of pictures, the surfaces become a basis; its light costs as many planes more.
    Raises BadData, UnknownName, OutOfRange.
    """
    scene = checked_scene(scene)
    if not scene.light_is_known:
        raise BadData(
            f"{scene.name}: holds radiance, its own light is not known: there are no surfaces to light"
        )
    if scene.layers:
        raise BadData(
            f"{scene.name}: {len(scene.layers)} layers, which have content of their own; wanted a scene "
            "without"
        )
    if not isinstance(lights, dict) or not lights:
        raise BadData(
            f"lights: {type(lights).__name__}, wanted {{light: map}} of at least one light"
        )
    maps = np.stack([_map(label, values, scene) for label, values in lights.items()])
    # luminance 1 each, so that the maps have their unit
    units = [white_radiance(light_of(light), 1.0) for light in lights]
    surfaces = surfaces_of(scene.content)
    together = _total(units, maps.mean(axis=(1, 2), dtype=np.float64))
    wavelengths, spectra = _spectra(surfaces.wavelengths, units, together)
    basis = spline(surfaces.wavelengths, surfaces.basis, wavelengths)
    content = Illuminated(wavelengths, maps, surfaces.coefficients, basis, spectra)
    return dataclasses.replace(scene, content=content, illuminant=together)


def _map(label, values, scene):
    """A light's map as float32 of the shape of the scene's samples."""
    name = f"{scene.name}: map of {label if isinstance(label, str) else getattr(label, 'name', '') or 'a light'}"
    values = described(values, name) if hasattr(values, "shape") else values
    try:
        values = np.asarray(values, np.float32)
    except (TypeError, ValueError):
        raise BadData(
            f"{name}: {type(values).__name__}, wanted an array of real numbers, or one"
        ) from None
    if values.shape not in ((), scene.content.shape):
        raise BadData(
            f"{name}: shape {values.shape}, wanted {scene.content.shape}, that of the scene's samples, or "
            "one number"
        )
    if is_seen(values) and not (np.isfinite(values).all() and values.min() >= 0):
        raise BadData(
            f"{name}: from {values.min():.3g} to {values.max():.3g}, wanted finite luminance, not negative"
        )
    return np.broadcast_to(values, scene.content.shape)


def _total(units, means):
    """All the light together, as strong as on the scene's mean, on the wavelengths of all tables."""
    if not means.any():
        raise BadData("lights: all maps are dark")
    # a table that ends above zero falls there at once: its end must not become a ramp to the next wavelength
    ends = [
        end for unit in units for end in (unit.wavelengths[0] - EDGE, unit.wavelengths[-1] + EDGE)
    ]
    wavelengths = reduce(np.union1d, [*(unit.wavelengths for unit in units), ends])
    values = sum(mean * unit.at(wavelengths) for unit, mean in zip(units, means, strict=True))
    return Spectrum(wavelengths, values, " + ".join(unit.name for unit in units))


def _spectra(wavelengths, units, together):
    """The fewest wavelengths that hold the lights, the given among them; and the lights relative to all of them.

    Returns shapes (L,) and (K, L).
    """
    for _ in range(HALVINGS):
        ratios, error = _ratios(wavelengths, units, together)
        if error <= CLOSE:
            return wavelengths, ratios
        wavelengths = np.union1d(wavelengths, (wavelengths[1:] + wavelengths[:-1]) / 2)
    return wavelengths, _ratios(wavelengths, units, together)[0]


def _ratios(wavelengths, units, together):
    """Lights relative to all of them, shape (K, L), and the largest relative error of one that a camera's band sees.

    A ratio of lamps with lines is no smooth function, and its values at wavelengths say nothing of what lies between.
    It is projected (Galerkin): the cubic spline through the values, times all the light, has the same integral as the
    light over every cubic spline on these wavelengths, so over what a smooth surface and a channel make of it.
    """
    fine = np.union1d(np.arange(wavelengths[0], wavelengths[-1], STEP), wavelengths)
    steps = np.diff(fine) / 2
    quadrature = np.append(steps, 0) + np.append(0, steps)
    whole, parts = (
        together.at(fine) * quadrature,
        np.stack([unit.at(fine) for unit in units]) * quadrature,
    )
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
