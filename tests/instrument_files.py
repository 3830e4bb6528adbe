"""Files of instruments and lens programs, good and damaged: ENVI, stacks of planes, tables, listings of Zemax."""

import io
import re

import numpy as np
from mutations import CELLS, WORDS, damaged, pick, reheaded, revalued

MARK = b"\n%%data%%\n"  # between a header and its raw file, which are one input
WAVES = "{ 400.0 , 500.0 , 650.0 }"
HEADER = """ENVI
description = {{ a cube,
  of random numbers }}
samples = 5
lines = 6
bands = {bands}
header offset = {offset}
file type = {kind}
data type = {code}
interleave = {interleave}
byte order = {order}
wavelength units = {unit}
wavelength = {waves}
{more}
"""


def envi_files():
    """Headers and their raw files in one."""
    random = np.random.default_rng(7)
    base = {
        "bands": 3,
        "offset": 0,
        "kind": "ENVI Standard",
        "code": 4,
        "interleave": "bsq",
        "order": 0,
        "unit": "Nanometers",
        "waves": WAVES,
        "more": "",
    }
    made = []
    for code, kind, more in (
        (4, "<f4", {}),
        (12, ">u2", {"order": 1, "interleave": "bil", "more": "reflectance scale factor = 100"}),
        (
            2,
            "<i2",
            {
                "interleave": "bip",
                "more": "data gain values = {1, 2, 3}\ndata offset values = {0, 1, 2}\n"
                "data ignore value = -9999\nbbl = {1, 0, 1}",
            },
        ),
        (
            5,
            "<f8",
            {
                "offset": 9,
                "unit": "um",
                "waves": "{0.4, 0.5, 0.65}",
                "more": "data ignore value = nan",
            },
        ),
        (
            4,
            "<f4",
            {
                "bands": 1,
                "kind": "ENVI Spectral Library",
                "waves": "{400, 450, 500, 550, 600}",
                "more": "spectra names = {a, b, c, d, e, f}",
            },
        ),
    ):
        said = base | {"code": code} | more
        cube = (random.random((said["bands"], 6, 5)) * (1 if kind[1] == "f" else 90)).astype(kind)
        made.append(HEADER.format(**said).encode() + MARK + bytes(said["offset"]) + cube.tobytes())
    return made


WORDS_OF_ENVI = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1",
    "2",
    "3",
    "6",
    "9",
    "12",
    "14",
    "15",
    "99",
    "1e308",
    "1e-320",
    "1e40",
    "2.5",
    "9" * 15,
    "9" * 5000,
    "-9999",
    "65535",
    str(2**31),
    str(2**63),
    str(2**64),
    "{",
    "}",
    "{}",
    "{{1}}",
    "{1, 2}",
    "{1, 2, 3}",
    "{0, 0, 1}",
    "{nan, 1, 2}",
    "{3, 1, 2}",
    "{400, 400, 500}",
    "{1e300, 1, 2}",
    "{" + "1, " * 3000 + "1}",
    "{" * 3000,
    "bsq",
    "bil",
    "BIP",
    "um",
    "nm",
    "Unknown",
    "Wavenumber",
    "Micrometers",
    "Angstroms",
    "ENVI Spectral Library",
    "ENVI Classification",
    "ENVI Standard",
    "\0",
    "\u00b5m",
    "x" * 5000,
    "",
    " ",
    "=",
    ";",
    "# 1",
    "1_0",
    "0x10",
    "+3",
    "3 ",
)
FIELDS = (
    "samples",
    "lines",
    "bands",
    "header offset",
    "file type",
    "data type",
    "interleave",
    "byte order",
    "wavelength",
    "wavelength units",
    "reflectance scale factor",
    "data ignore value",
    "bbl",
    "data gain values",
    "data offset values",
    "data reflectance gain values",
    "data reflectance offset values",
    "file compression",
    "major frame offsets",
    "fwhm",
    "description",
    "Samples",
    "x" * 3000,
    "",
)


def envi(data: bytes, random) -> bytes:
    """A header with other fields, and a raw file with other numbers or of another length."""
    head, _, raw = data.partition(MARK)
    lines = head.decode().split("\n")
    for _ in range(int(random.integers(1, 4))):
        where, kind = int(random.integers(len(lines))), int(random.integers(9))
        if kind <= 2 and "=" in lines[where]:
            lines[where] = lines[where].split("=")[0] + "= " + pick(random, WORDS_OF_ENVI)
        elif kind == 3:
            lines.insert(where + 1, f"{pick(random, FIELDS)} = {pick(random, WORDS_OF_ENVI)}")
        elif kind == 4:
            lines.insert(where, pick(random, lines))
        elif kind == 5 and len(lines) > 1:
            del lines[where]
        elif kind == 6:
            numbers = re.findall(r"-?\d+\.?\d*", lines[where]) or [" "]
            lines[where] = lines[where].replace(
                pick(random, numbers), pick(random, WORDS_OF_ENVI), 1
            )
        elif kind == 7:
            raw = pick(
                random,
                (
                    damaged(raw, b"", random),
                    raw[: int(random.integers(len(raw) + 1))],
                    raw + bytes(int(10 ** random.uniform(0, 6))),
                    b"",
                ),
            )
        else:
            lines[where] = lines[where].swapcase()
    whole = "\n".join(lines)
    head = whole.encode(pick(random, ("utf-8",) * 5 + ("utf-16", "utf-8-sig")), "surrogatepass")
    return (
        pick(random, (head,) * 5 + (head.replace(b"\n", b"\r\n"), head.replace(b"\n", b"\r")))
        + MARK
        + raw
    )


def array_files():
    """Stacks of three planes of several types and orders."""
    random, made = np.random.default_rng(7), []
    for array in (
        random.random((3, 6, 5), np.float32),
        random.random((6, 5, 3)).astype(">f8"),
        random.integers(0, 99, (3, 6, 5)).astype(np.uint8),
        np.asfortranarray(random.integers(0, 99, (6, 5, 3)).astype(np.uint16)),
    ):
        buffer = io.BytesIO()
        np.save(buffer, array)
        made.append(buffer.getvalue())
    return made


def array(data: bytes, random) -> bytes:
    """A NumPy array with another header, other values, another type, or more numbers."""
    kind = int(random.integers(8))
    if kind <= 4:
        return reheaded(data, random)
    if kind <= 6:
        return revalued(np.load(io.BytesIO(data)), random)
    return data + bytes(int(10 ** random.uniform(0, 7)))


TABLES = [
    text.encode()
    for text in (
        "wavelength_nm,a,b,c\n400,0.1,0.2,0.3\n550,0.1,0.5,0.3\n700,0.4,0.2,0.1\n",
        "name,400nm,500nm,600nm\na,0.1,0.2,0.3\nb,0.3,0.2,0.1\n",
        "400,0.1\n500,0.2\n600,0.3\n",
        "Wavelength (um),1\n0.4,0.1\n0.5,0.2\n",
        "nm;a;b\n400;0,1;0,2\n500;0,3;0,4\n",
        "nm\ta\n400\t0.5\n500\t0.6\n",
    )
]

LISTING = """Listing of {kind} PSF Data

File : C:\\lenses\\triplet.zmx
Title: A TRIPLET

{kind} PSF
{um:.4f} \u00b5m at {field}.
Data spacing is 0.500000 \u00b5m.
Data area is 4.000 \u00b5m wide.
Surface: Image
{centre}: {x:.4E}, {y:.4E}
Image grid size: 8 by 7
Center point is: {middle}
Values are {values}.

"""


def listings():
    """Zemax's listings: on axis and at a field point, the old letters and the new ones."""
    random, made = np.random.default_rng(7), []
    for kind, field, x, y, encoding in (
        ("FFT", "0.00 deg", 0, 0, "cp1252"),
        ("FFT", "10.00 (deg)", 0, 2.5, "utf-16"),
        ("Huygens", "7.00 mm", 2.5, 0, "utf-8-sig"),
    ):
        said = {
            "centre": "Reference Coordinates",
            "middle": "row 5, column 4",
            "values": "normalized to the peak",
        }
        if kind == "Huygens":
            said = {
                "centre": "Center coordinates",
                "middle": "5, 4",
                "values": "relative intensity",
            }
        text = LISTING.format(kind=kind, um=0.55, field=field, x=x, y=y, **said) + "\n".join(
            "\t".join(f"{value:.3E}" for value in line) for line in random.random((8, 7))
        )
        made.append(text.replace("\n", "\r\n").encode(encoding))
    return made


# listings that a damaged one may go with: of another wavelength on axis, and of the same
NEIGHBOURS = [
    LISTING.format(
        kind="FFT",
        um=um,
        field="0.00 deg",
        centre="Reference Coordinates",
        x=0,
        y=0,
        middle="row 5, column 4",
        values="normalized to the peak",
    )
    + "1 2 3 4 5 6 7\n" * 8
    for um in (0.45, 0.55)
]
CORNER = 2.5e-3  # [m] where the field points lie
WORDS_OF_LISTINGS = (
    *CELLS,
    "inf",
    "1e-300",
    "1e300",
    "1E+5",
    "-0.5",
    "9" * 300,
    "99999",
    "m",
    "mm",
    "nm",
    "in",
    "furlong",
    "row 1, column 1",
    "0.4 to 0.7",
    "8 by 8",
    "0 by 0",
    "99999 by 99999",
    "Values are x",
    "PSF",
)


def listing(data: bytes, random) -> bytes:
    """A listing with other words and numbers, with lines more and fewer, in other letters."""
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "cp1252"
    lines = data.decode(encoding, "replace").split("\n")
    for _ in range(int(random.integers(1, 4))):
        where, kind = (
            int(random.integers(min(len(lines), pick(random, (14, 14, 99))))),
            int(random.integers(7)),
        )
        if kind <= 2:
            words = re.findall(r"[^\s:,]+", lines[where]) or [" "]
            lines[where] = lines[where].replace(
                pick(random, words), pick(random, WORDS_OF_LISTINGS), 1
            )
        elif kind == 3:
            lines.insert(where, pick(random, lines))
        elif kind == 4 and len(lines) > 1:
            del lines[where]
        elif kind == 5:
            lines[where] += pick(random, (" ", "\t", ":")) + pick(random, WORDS_OF_LISTINGS)
        else:
            lines[where] = str(pick(random, WORDS)).join(lines[where].split(" ", 1))
    return "\n".join(lines).encode(pick(random, (encoding, encoding, "utf-8", "utf-16")), "replace")
