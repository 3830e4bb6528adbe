"""ICC profiles of displays, for programs with colour management.

Source: ICC.1:2010 (profile version 4.3.0.0; ISO 15076-1:2010): header 7.2, tags 9.2, their types
10.
"""

import struct

import numpy as np

from gpusim.data.colorimetry import adaptation
from gpusim.domain.display import Display

VERSION = 0x04300000
# XYZ of the profile connection space's white, 7.2.16
D50 = np.array([0xF6D6, 0x10000, 0xD32D]) / 65536
DATE = (2026, 1, 1, 0, 0, 0)  # fixed: a display always has the same profile


def icc_profile(display: Display, linear: bool = False) -> bytes:
    """Return the profile of a display with three primaries and one curve.

    linear: for numbers proportional to light.
    """
    white = display.xyz_from_rgb.sum(axis=1)
    adapt = adaptation(white, D50)
    colorants = adapt @ display.xyz_from_rgb
    name = f"gpusim {display.name}" + (", linear" if linear else "")
    curve = _curve(1.0 if linear else display.curve)
    tags = {
        b"desc": _text(name),
        b"cprt": _text("No copyright, use freely"),
        b"wtpt": _xyz(D50),
        b"chad": b"sf32\0\0\0\0" + _fixed_point(adapt.ravel()),
        b"lumi": _xyz((0, display.luminance, 0)),
    }
    tags |= {
        letter + b"XYZ": _xyz(column)
        for letter, column in zip((b"r", b"g", b"b"), colorants.T, strict=True)
    }
    tags |= {letter + b"TRC": curve for letter in (b"r", b"g", b"b")}
    table, data = [], b""
    for kind, body in tags.items():
        table.append(struct.pack(">4sII", kind, 132 + 12 * len(tags) + len(data), len(body)))
        data += body + bytes(-len(body) % 4)
    data = struct.pack(">I", len(tags)) + b"".join(table) + data
    return _header(128 + len(data)) + data


def _header(size):
    """Return the header of a display's profile, relative colorimetric intent, no maker named."""
    start = struct.pack(
        ">III4s4s4s6H4s24xI", size, 0, VERSION, b"mntr", b"RGB ", b"XYZ ", *DATE, b"acsp", 1
    )
    return start + _fixed_point(D50) + bytes(48)


def _fixed_point(values):
    return b"".join(struct.pack(">i", round(65536 * float(value))) for value in values)


def _xyz(values):
    return b"XYZ \0\0\0\0" + _fixed_point(values)


def _text(words):
    encoded = words.encode("utf-16-be")
    return struct.pack(">4sIII2s2sII", b"mluc", 0, 1, 12, b"en", b"US", len(encoded), 28) + encoded


def _curve(curve):
    """Return a parametric curve: type 3 with IEC 61966-2-1's numbers, or type 0, an exponent."""
    if curve == "srgb":
        return struct.pack(">4sIHH", b"para", 0, 3, 0) + _fixed_point(
            (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
        )
    return struct.pack(">4sIHH", b"para", 0, 0, 0) + _fixed_point((curve,))
