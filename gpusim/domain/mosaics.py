"""Colour filter arrays: well-known ones by name, and the mosaic of binned pixels.

R, G, B: red, green, blue; C, M, Y: cyan, magenta, yellow; W: no filter (panchromatic); N: near
infrared; E: emerald. In "rccc" and "rccb" the makers' C is a clear pixel, W here. A camera needs a
curve for each letter.
"""

import numpy as np

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


def bayer_phase(cfa) -> tuple[int, int] | None:
    """Return row and column of the red pixel in a Bayer period; None if the rows are not Bayer's."""
    if len(cfa) != 2 or sorted("".join(cfa)) != ["B", "G", "G", "R"]:
        return None
    row, col = divmod("".join(cfa).index("R"), 2)
    return (row, col) if cfa[1 - row][1 - col] == "B" else None


def bayer_roles(cfa) -> tuple[str, str] | None:
    """Return how a mosaic of three channels corresponds to a Bayer mosaic, or None if it does not.

    Three channels over 2 x 2 pixels correspond if the one with two pixels is on a diagonal.

    Returns:
        The Bayer phase, such as "RGGB", and the letters in the places of R, G and B. In ("RY",
        "YB") these are "RYB". R comes first and B last; without them the order is that of the mosaic.
    """
    letters = "".join(cfa)
    if len(cfa) != 2 or len(letters) != 4 or len(set(letters)) != 3:
        return None
    twice = max(letters, key=letters.count)
    if letters.index(twice) + letters.rindex(twice) != 3:
        return None
    others = [letter for letter in letters if letter != twice]
    red, blue = sorted(others, key=lambda letter: (letter == "B") - (letter == "R"))
    roles = red + twice + blue
    return "".join("RGB"[roles.index(letter)] for letter in letters), roles


def bin_mosaic(
    cfa_indices: np.ndarray, binning: tuple[int, int]
) -> tuple[tuple[int, int], np.ndarray]:
    """Find the distance between pixels that are combined, and the mosaic of the binned frame.

    If the mosaic consists of cells of one colour with the size of `binning` (quad-Bayer with 2 x 2,
    monochrome with any size), adjacent pixels are combined, and each cell becomes one pixel of the
    new mosaic. Otherwise the pixels of one colour are a period apart, and the mosaic stays as it
    is.

    Args:
        cfa_indices: Channel indices of one period, shape (period_y, period_x).
        binning: Rows and columns that become one.

    Returns:
        The stride along rows and columns [pixel], and the shortest period of the new mosaic, int32,
        shape (period_y, period_x).
    """
    cfa = shortest_period(cfa_indices)
    by, bx = binning
    rows, cols = np.lcm(cfa.shape, binning)
    cells = np.tile(cfa, (rows // cfa.shape[0], cols // cfa.shape[1])).reshape(
        rows // by, by, cols // bx, bx
    )
    coarse = cells[:, 0, :, 0]
    if (cells == coarse[:, None, :, None]).all():
        return (1, 1), shortest_period(coarse)
    return cfa.shape, cfa


def shortest_period(mosaic) -> np.ndarray:
    """Return the smallest corner of `mosaic` (rows, cols) that repeats to the whole, int32."""
    mosaic = np.asarray(mosaic, np.int32)
    for axis in (0, 1):
        size = mosaic.shape[axis]
        period = next(
            n
            for n in range(1, size + 1)
            if size % n == 0 and (mosaic == np.roll(mosaic, n, axis=axis)).all()
        )
        mosaic = mosaic.take(range(period), axis=axis)
    return mosaic


def symmetries(mosaic, exchanges=({},)):
    """Yield mirror images, transposes and shifts that map a mosaic to itself.

    Args:
        mosaic: Rows of one period.
        exchanges: Letters that take each other's place, a dict for each way; {} for none.

    Yields:
        The new position of each position, shape (P,); whether rows and columns are exchanged; signs
        of rows and columns after that, shape (2,); the letters that take each other's place.
    """
    letters = np.array([list(text) for text in mosaic])
    rows, cols = letters.shape
    for transpose in (False, True) if rows == cols else (False,):
        for signs in np.array(((1, 1), (1, -1), (-1, 1), (-1, -1))):
            for exchange in exchanges:
                swapped = [exchange.get(letter, letter) for letter in letters.ravel()]
                places = np.indices((rows, cols)).reshape(2, -1)
                places = (places[::-1] if transpose else places) * signs[:, None]
                for down, right in np.ndindex(rows, cols):
                    y, x = (places[0] + down) % rows, (places[1] + right) % cols
                    if swapped == letters[y, x].tolist():
                        yield y * cols + x, transpose, signs, exchange
