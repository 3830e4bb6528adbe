"""Displays, and what they show as a scene."""

import functools

import numpy as np

from gpusim.data.colorimetry import tables, xyz
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.domain.content import Picture
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, UnknownName, is_known
from gpusim.domain.foreign import described, type_of
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum, photons_from_energy


def display_names() -> list[str]:
    """Every name that `open_display` knows."""
    return [
        *DISPLAYS,
        *(key.removesuffix(" spectra") for key in tables("displays") if key.endswith(" spectra")),
    ]


def open_display(name: str) -> Display:
    """A display by name: "srgb", "display-p3", or a measured one: "lcd-apple", "lcd-dell", "crt-dell", "oled-sony".

    The measured ones have the spectra of their primaries (ISETCam, see README.md in this folder); primaries, white and
    luminance follow from these, and the curve is the power law nearest to the measured one. Raises UnknownName.
    """
    if is_known(name, DISPLAYS):
        return DISPLAYS[name]
    if not is_known(name, display_names()):
        raise UnknownName("display", name, display_names())
    return _measured(name)


@functools.cache
def _measured(name):
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


def displayed(codes, display: Display) -> Scene:
    """The screen as a scene: the radiance of a picture on a display whose spectra are known, one sample per pixel.

    codes: uint8 or uint16, shape (rows, cols, 3), such as `Frame.rgb`, or an array of a device, which decodes them. The
    scene's light is the display's white: radiance = linear light of the three primaries times their spectra (Farrell &
    Wandell, section 3). For "srgb" the primaries are those of `srgb_primaries` in D65. Raises BadData for another shape
    and for a display without spectra.
    """
    codes = described(codes, "displayed picture")
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
