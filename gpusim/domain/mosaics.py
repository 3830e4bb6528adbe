"""Well-known colour filter arrays by name, each as one period in rows of letters.

R, G, B: red, green, blue; C, M, Y: cyan, magenta, yellow; W: no filter (panchromatic); N: near
infrared; E: emerald. In "rccc" and "rccb" the makers' C is a clear pixel, W here. A camera needs a
curve for each letter.
"""

from gpusim.domain.errors import UnknownName


def _repeat_pixels(rows, times):
    """Return the mosaic with each pixel repeated as a block of times x times pixels."""
    return tuple("".join(letter * times for letter in row) for row in rows for _ in range(times))


_BAYER = ("RG", "GB")

MOSAICS: dict[str, tuple[str, ...]] = {
    # Bayer, US patent 3971065 (1976), and its shifts by a pixel
    "bayer-rggb": _BAYER,
    "bayer-grbg": ("GR", "BG"),
    "bayer-gbrg": ("GB", "RG"),
    "bayer-bggr": ("BG", "GR"),
    # Bayer filters over 2 x 2, 3 x 3 and 4 x 4 pixels, read singly or together (Quad Bayer,
    # Tetracell; Nonacell; Tetra2pixel)
    "quad-bayer": _repeat_pixels(_BAYER, 2),
    "nona-bayer": _repeat_pixels(_BAYER, 3),
    "hexadeca-bayer": _repeat_pixels(_BAYER, 4),
    # Fujifilm's X-Trans: every row and column has all three colours (US patent 8531563, 2013)
    "x-trans": ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
    # one green of Bayer's left clear: Gindele & Gallagher, US patent 6476865 (2002)
    "rgbw": ("RG", "WB"),
    # half of the pixels clear, colours in pairs on diagonals: Compton & Hamilton, US patent 8139130
    # (2012), TrueSense
    "rgbw-kodak": ("WBWG", "BWGW", "WGWR", "GWRW"),
    # one green pixel of Bayer's sees the near infrared; in the second, green stays as dense as in
    # Bayer's and every fourth pixel sees the near infrared
    "rgbn": ("RG", "NB"),
    "rgbn-4x4": ("BGRG", "GNGN", "RGBG", "GNGN"),
    # driver assistance: clear pixels with one red of four, with red and blue, with yellow
    "rccc": ("RW", "WW"),
    "rccb": ("RW", "WB"),
    "ryyb": ("RY", "YB"),
    # complementary filters, and Sony's fourth colour of 2003 (DSC-F828)
    "cygm": ("CY", "GM"),
    "cyym": ("CY", "YM"),
    "rgbe": ("RG", "EB"),
    "mono": ("Y",),
}


def mosaic(name: str) -> tuple[str, ...]:
    """Return one period of the colour filter array `name`, a string per row. Raise UnknownName."""
    if name not in MOSAICS:
        raise UnknownName("mosaic", name, MOSAICS)
    return MOSAICS[name]
