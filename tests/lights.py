"""Scenes whose light spans all that there is, and lenses of every kind: what tests of the range go through."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

import gpusim as gs
from gpusim.domain.content import Basis, Cube, Materials, Picture
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import Spectrum

PHONE = gs.open_camera("phone")
WAVELENGTHS = np.linspace(400, 700, 13)
ONE = np.array([532.0])  # [nm] of a laser
FORMS = ("cube", "basis", "materials", "picture", "illuminated")
BORDERS = ("edge", "zero", "reflect", "scene")


def leaves(shape, seed=1):
    """Patches with edges, 0.05 .. 0.95."""
    smooth = gaussian_filter(np.random.default_rng(seed).random(shape), 1.5)
    return 0.05 + 0.9 * np.round((smooth - smooth.min()) / np.ptp(smooth) * 6) / 6


def _set(values, at, light):
    values[at] = light
    return values


def radiance(name: str, shape=(32, 48)) -> np.ndarray:
    """Radiance of a kind of light [photon s-1 m-2 sr-1 nm-1], shape (rows, cols)."""
    (rows, cols), even = shape, np.ones(shape)
    plain, star = 1e15 * leaves(shape), (rows // 3, cols // 3)
    lamp = np.s_[rows // 2 : rows // 2 + 5, 3:9]
    y, x = np.indices(shape)
    return {
        "plain": lambda: plain,
        "filament": lambda: _set(plain, np.s_[rows // 2, 5:-5], 7e20),
        "sun": lambda: _set(plain, np.hypot(y - star[0], x - star[1]) < 3, 7e22),
        "bright": lambda: 9e6 * plain,
        "lamp of 9e19": lambda: _set(plain, lamp, 9e19),
        "lamp of 9e21": lambda: _set(plain, lamp, 9e21),
        "star": lambda: _set(0 * even, star, 1e15),
        "star on 1e-7": lambda: _set(1e8 * even, star, 1e15),
        "dark": lambda: 0 * even,
        "denormal": lambda: 1e-40 * plain / 1e15,
        "half plane of 1e12:1": lambda: _set(1e5 * even, np.s_[:, cols // 2 :], 1e17),
        "point of 1e12:1": lambda: _set(1e5 * even, star, 1e17),
    }[name]()


LIGHTS = (
    "plain",
    "filament",
    "sun",
    "bright",
    "lamp of 9e19",
    "lamp of 9e21",
    "star",
    "star on 1e-7",
    "dark",
    "denormal",
    "half plane of 1e12:1",
    "point of 1e12:1",
)


def scene_of(values, form="cube", border="edge", wavelengths=WAVELENGTHS) -> Scene:
    """A scene of radiance (rows, cols) in three colours, side by side."""
    spectra = np.exp(-0.5 * ((wavelengths - np.array([[620.0], [450.0], [540.0]])) / 60) ** 2)
    y, x = np.indices(values.shape)
    kind = (x // 7 + y // 5) % 3
    each = (kind == np.arange(3)[:, None, None]).astype(np.float32)
    if form == "cube":
        content = Cube(
            wavelengths, np.moveaxis(spectra[kind] * values[..., None], -1, 0).astype(np.float32)
        )
    elif form == "basis":
        content = Basis(wavelengths, (each * values).astype(np.float32), spectra)
    elif form == "materials":
        content = Materials(wavelengths, kind.astype(np.uint8), values.astype(np.float32), spectra)
    elif form == "picture":
        levels, codes = np.unique(values.astype(np.float32), return_inverse=True)
        curve = np.zeros(256, np.float32)
        curve[: len(levels)] = levels
        codes = np.repeat(codes.reshape(*values.shape, 1), 3, 2).astype(np.uint8)
        content = Picture(wavelengths, codes, spectra, curve)
    else:
        maps = np.stack([values, values[::-1]]).astype(np.float32)
        content = Illuminated(wavelengths, maps, each, spectra, spectra[:2] + 0.2)
    return Scene(content, unit_light(wavelengths), border, margin=4 if border == "scene" else 0)


def _gaussian(width):
    """Samples 0.25 um apart of a Gaussian spread [um]."""
    x = 0.25 * np.arange(-20, 21)
    values = np.exp(-0.5 * (x[:, None] ** 2 + x**2) / width**2)
    return values / values.sum()


def _measured(**more):
    ends, heights = np.array([400.0, 700.0]), more.get("heights", np.zeros(1))
    values = np.stack(
        [np.stack([_gaussian(0.9 + 0.3 * h), _gaussian(1.1 + 0.3 * h)]) for h in heights]
    )
    return {
        "model": "measured",
        "psf": PointSpread(ends, values if more else values[0], 0.25e-6, **more),
    }


LENSES = {
    "ideal": {},
    "defocused": {"defocus": 12e-6},
    "Zernike": {"wavefront": Wavefront(zernike=(0, 0, 0, 0, 0, 0, 0.2, 0.1))},
    "blades": {"pupil": Pupil(blades=6)},
    "obscured": {"pupil": Pupil(obscuration=0.4)},
    "measured": _measured(),
    "none": {"model": "none"},
    "distorted": {"distortion": RadialPolynomial(0.05, 0.0, 30e-6)},
    "f/1000": {"f_number": 1000.0},
    "coma": {"wavefront": Wavefront(seidel=(0, 0.5, 0, 0, 0))},
    "lateral colour": {
        "lateral_color": Spectrum(np.array([400.0, 700.0]), np.array([-0.02, 0.02]))
    },
    "measured over heights": _measured(heights=np.array([0.0, 0.5, 1.0])),
}
VARYING = ("coma", "lateral colour", "measured over heights")


def camera_with_lens(name: str, **sensor):
    """The phone behind a lens of LENSES."""
    return replace(
        PHONE, optics=replace(PHONE.optics, **LENSES[name]), sensor=replace(PHONE.sensor, **sensor)
    )


def as_photons(name: str) -> Spectrum:
    """Return the numbers of a relative light as photons: for tests of ratios only."""
    return replace(gs.illuminant(name), quantity="")
