"""Displays, and the scenes that they show."""

import functools
from typing import Any

import numpy as np

from gpusim.data.colorimetry import tables, xyz
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.domain.content import Picture
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, UnknownName, is_known
from gpusim.domain.memory import describe_array, type_of
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum, photons_from_energy


def display_names() -> list[str]:
    """Return the names that `open_display` knows.

    Returns:
        The names.
    """
    return [
        *DISPLAYS,
        *(key.removesuffix(" spectra") for key in tables("displays") if key.endswith(" spectra")),
    ]


def open_display(name: str) -> Display:
    """Return the display with a given name.

    Measured displays have the spectra of their primaries (ISETCam, see README.md in this folder).
    Their primaries, white and luminance follow from the spectra; the curve is the power law nearest
    to the measured one.

    Args:
        name: "srgb", "display-p3", or a measured one: "lcd-apple", "lcd-dell", "crt-dell",
            "oled-sony".

    Returns:
        The display.

    Raises:
        UnknownName: The name is not known.
    """
    if is_known(name, DISPLAYS):
        return DISPLAYS[name]
    if not is_known(name, display_names()):
        raise UnknownName("display", name, display_names())
    return _load_display(name)


@functools.cache
def _load_display(name):
    table = tables("displays")
    spectra = Spectrum(table["wavelengths"], table[f"{name} spectra"], name)
    colors = xyz(spectra)
    white = colors.sum(axis=0)
    chromaticities = np.vstack([colors, white])[:, :2] / np.vstack([colors, white]).sum(
        axis=1, keepdims=True
    )
    return Display(
        name,
        tuple(map(tuple, chromaticities[:3].tolist())),
        tuple(chromaticities[3].tolist()),
        float(table[f"{name} exponent"]),
        float(white[1]),
        spectra,
    )


def display_picture(codes: Any, display: Display) -> Scene:
    """Return the screen of a display with a picture as a scene, with one sample per pixel.

    The scene's light is the display's white. Radiance = linear light of the three primaries times
    their spectra. For "srgb" the primaries are `srgb_primaries` in D65.

    Args:
        codes: Picture, uint8 or uint16, shape (rows, cols, 3), for example `Frame.rgb`; or an array
            of a device, which then decodes it.
        display: A display with known spectra.

    Returns:
        The scene.

    Raises:
        BadData: The picture has another shape, or the display has no spectra.

    Source:
        Farrell & Wandell, section 3.
    """
    codes = describe_array(codes, "displayed picture")
    if display.spectra is not None:
        spectra = photons_from_energy(display.spectra)
        white = Spectrum(
            spectra.wavelengths, spectra.values.sum(axis=0), f"white of {display.name}"
        )
        shares = np.divide(
            spectra.values, white.values, out=np.zeros_like(spectra.values), where=white.values > 0
        )
        wavelengths = spectra.wavelengths
    elif display.encodes_like(DISPLAYS["srgb"]):
        primaries = srgb_primaries()
        wavelengths, shares = primaries.wavelengths, primaries.values
        white = white_radiance(illuminant("D65"), display.luminance)
    else:
        raise BadData(
            f"display {display.name!r} has no spectra of its primaries; give Display(spectra=...), or use "
            f"one of {', '.join(name for name in display_names() if name != 'display-p3')}"
        )
    content = Picture(wavelengths, codes, shares, display.table(type_of(codes)))
    return Scene(content, white, name=f"picture on {display.name}")
