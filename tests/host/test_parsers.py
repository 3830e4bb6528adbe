"""What parsers raise on files that people or damage have made, and what errors say: one short line."""

import io
import struct
import zipfile

import fuzz
import numpy as np
import pytest
from refusals import archive, refused

from gpusim.domain.errors import BadData, BadFile, DeviceError, DoesNotFit, OutOfRange, UnknownName
from gpusim.io.camera.cameras import open_camera
from gpusim.io.camera.learned import read_table
from gpusim.io.camera.psf import read_psf
from gpusim.io.files import reading
from gpusim.io.scene.scenes import open_scene

# ---- what libraries raise


@pytest.mark.parametrize(
    "change", ["encrypted", "bzip2", "lzma", "unknown method", "twice", "objects", "version"]
)
@pytest.mark.parametrize("read", [read_psf, read_table, open_scene])
def test_archives_that_numpy_does_not_write(tmp_path, change, read):
    path = tmp_path / "a.npz"
    buffer = io.BytesIO()
    np.save(buffer, np.array([{}], object) if change == "objects" else np.ones(3))
    member = bytearray(buffer.getvalue())
    if change == "version":
        member[6] = 9
    method = {"bzip2": zipfile.ZIP_BZIP2, "lzma": zipfile.ZIP_LZMA}.get(
        change, zipfile.ZIP_DEFLATED
    )
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("psf.npy", bytes(member))
        if change == "twice":
            file.writestr("psf", bytes(member))
    data = bytearray(path.read_bytes())
    at = data.index(b"PK\x01\x02")
    if change == "encrypted":
        data[at + 8] |= 1
    elif change == "unknown method":
        data[at + 10] = 93
    path.write_bytes(data)
    with refused(path, error=BadFile):
        read(path)


HEADERS = [
    "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999,), }",
    "((((" * 60,
    "'''",
    "-" * 4000,
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3L,), ",
    "[" * 5000,
    "{'descr': 'zz', 'fortran_order': False, 'shape': ()}",
    "{'descr': '(1000000,1000000)f8', 'fortran_order': False, 'shape': (1000000,)}",
]


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("read", [read_psf, read_table, open_scene])
def test_headers_of_arrays_that_python_cannot_read(tmp_path, header, read):
    path, raw = tmp_path / "a.npz", header.encode() + b"\n"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(
            "psf.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(raw)) + raw + bytes(24)
        )
    with refused(path, error=BadFile):
        read(path)


@pytest.mark.parametrize(
    "reader, key, value",
    [
        ("psf", "wavelengths_nm", 500.0),
        ("psf", "heights", "x"),
        ("psf", "spacing_um", "x"),
        ("psf", "integrated", [1, 2]),
        ("table", "box", np.nan),
        ("table", "box", np.inf),
        ("table", "offsets", "a\nb"),
        ("table", "groups", "x"),
        ("table", "provenance", 3),
        ("table", "mosaic", "RG"),
        ("table", "taps", 1j),
        ("scene", "margin", np.inf),
        ("scene", "margin", "x"),
        ("scene", "name", 3.0),
        ("scene", "fov_rad", [[0.5]]),
        ("scene", "depth_m", "x"),
    ],
)
def test_arrays_of_another_kind(tmp_path, reader, key, value):
    """What the damaged files of the slow test have found, and their like."""
    path = archive(tmp_path / "a.npz", **fuzz.good_archives(reader)[0] | {key: np.array(value)})
    with refused(path, key.split("_")[0], error=BadFile):
        fuzz.reading(reader, tmp_path)[1](path)


@pytest.mark.parametrize(
    "text, part",
    [
        ("a=" + "[" * 100_000, "not TOML"),
        ("a=" + "{b=" * 50_000, "not TOML"),
        (".".join(["a"] * 20_000) + "=1", "line 1 has a key of more than 16 parts"),
        ("\n[" + ".".join(['"\\""'] * 10_000) + "]", "line 2 has a key of more than 16 parts"),
        (" . ".join(["'a'"] * 10_000) + "=1", "16 parts"),
        ("x" * 2**21, "more than 1 MiB"),
        ("[sensor]\nbits = 0x" + "f" * 6000, "more than 64 bits"),
        ("[optics]\nf_number = " + "9" * 5000, "not TOML"),
        ("a" * 300_000 + " = 1", "unknown section"),
        ('"a\\nb" = 1', "unknown section"),
        ("name = 3", "wanted a text"),
        (fuzz.CAMERA.replace('"curves.csv"', "[" * 90 + "1" + "]" * 90), "[sensor] qe = [[["),
        (fuzz.CAMERA + "cfa = '" + "RG" * 90_000 + "'", "[sensor] cfa: unknown mosaic 'RGRG"),
        (
            fuzz.CAMERA.replace('"curves.csv"', '"mt9v024"') + "cfa = []\nir_cut = 'ir-cut-phone'",
            "[sensor] cfa = []: wan",
        ),
        (
            fuzz.CAMERA.replace('"curves.csv"', '"mt9v024"')
            + "cfa = ['']\nir_cut = 'ir-cut-phone'",
            "[sensor] cfa = ['']",
        ),
        (
            fuzz.CAMERA.replace('"curves.csv"', '"mt9v024"')
            + "binning = [1, 18_000_000_000_000_000_000]",
            "binning",
        ),
    ],
)
def test_camera_files_that_stop_a_parser(tmp_path, text, part):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with refused(path, part, error=BadFile):
        open_camera(path)


def test_a_byte_order_mark_is_read_over(tmp_path):
    for mark in (b"", b"\xef\xbb\xbf"):
        (tmp_path / "curves.csv").write_bytes(mark + fuzz.good_texts("curves")[0][0])
        (tmp_path / "own.toml").write_bytes(mark + fuzz.CAMERA.encode())
        assert open_camera(tmp_path / "own.toml").sensor.channels == ("R", "G", "B")


def test_the_own_mistakes_of_a_reader_are_not_taken_for_the_file_s():
    with pytest.raises(NameError), reading("a.png", "a PNG"):
        raise NameError("name 'FLAT' is not defined")
    with (
        refused("a.png: not a PNG, or truncated (KeyError)", error=BadFile),
        reading("a.png", "a PNG"),
    ):
        raise KeyError


# ---- messages


LOG = "\n".join(
    [
        "Build failed:",
        *(f"kernel.cl:{n}:3: error: undeclared identifier" for n in range(5000)),
        "the end",
    ]
)


@pytest.mark.parametrize(
    "error, parts",
    [
        (DeviceError(LOG), ("Build failed: kernel.cl:0:3", "the end")),
        (BadData(f"ratios: {np.arange(900)}, wanted"), ("ratios: [ 0 1 2", "wanted")),
        (OutOfRange("key", "x" * 9000, "0 .. 1"), ("key = xx", "allowed is 0 .. 1")),
        (OutOfRange("key", 10**9000, "0 .. 1"), ("a int too long to show", "allowed is 0 .. 1")),
        (UnknownName("light", "y" * 9000, ["D65", "A"]), ("unknown light 'yy", "known: A, D65")),
        (UnknownName("light", "D66\n\x1b", ["D65"]), (r"unknown light 'D66\n\x1b'",)),
        (BadFile("/a" * 3000 + ".png", "truncated"), (".png: truncated",)),
        (BadFile("a\nb\udcff", "c"), ("a b: c",)),
        (DoesNotFit("a" * 900, 2**40, 2**30, "this computer"), ("use a smaller scene",)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_messages_are_one_short_line(error, parts):
    with refused(*parts):
        raise error


def test_the_whole_of_a_long_message_is_kept():
    assert DeviceError(LOG).details == LOG
