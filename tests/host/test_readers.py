"""Files that are damaged, enormous, endless or no files at all: refused in one line, in bounded time and memory."""

import io
import itertools
import os
import socket
import struct
import tracemalloc
import zipfile
import zlib

import fuzz
import mat_mutations
import numpy as np
import pytest
from lights import as_photons
from picture_mutations import png_of
from refusals import SMALL, WAVES, archive, refused, takes

import gpusim as gs
from gpusim.domain import memory
from gpusim.domain.errors import BadFile, DoesNotFit, UnknownName
from gpusim.io.camera.cameras import open_camera
from gpusim.io.camera.learned import read_table
from gpusim.io.camera.psf import read_psf
from gpusim.io.camera.zemax import read_zemax_psf
from gpusim.io.exr import write_rgb_exr
from gpusim.io.scene.scenes import open_scene

# ---- every reader on damaged files


@pytest.mark.filterwarnings("error::RuntimeWarning")  # a second line
@pytest.mark.parametrize("reader", fuzz.READERS)
def test_damaged_files_are_refused(reader):
    """About a thousand of the slow test's."""
    count = 6 if reader == "fields" else 125
    row = fuzz.fuzz(reader, fuzz.SEEDS[0], 0, count)
    assert (
        row["mutated"] == count == row["accepted"] + row["refused"] + row["wrong"]
        and not row["wrong"]
    ), row
    assert row["refused"] > count / 5, "files are hardly damaged"


@pytest.mark.slow
@pytest.mark.parametrize("seed", fuzz.SEEDS)
@pytest.mark.parametrize("reader", fuzz.READERS)
def test_many_damaged_files_are_refused(reader, seed):
    """315,000 files, in a process with little memory; at most LONGEST seconds and twice the estimate for any."""
    count = 100 if reader == "fields" else 5000
    row = fuzz.in_a_process(reader, seed, count)
    assert (
        row["mutated"] == count and not row["wrong"] and row["peak_mib"] <= fuzz.LARGEST / 2**20
    ), row


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "text", ["nm,a\n400,1\ninf,1\n-inf,2\n", "Wavelength (um),1\n0.4,0.1\n1e308,0.2\n"]
)
def test_numbers_that_are_none_make_no_second_line(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with refused("a.csv", error=BadFile):
        open_scene(tmp_path / "a.csv")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_weights_that_are_no_numbers_make_no_second_line(tmp_path):
    arrays = fuzz.good_archives("table")[0]
    path = archive(tmp_path / "a.npz", **arrays | {"contrast_0": np.full(7, np.nan)})
    with refused("a.npz", error=BadFile):
        read_table(path)


def large(folder, name):
    """A whole file of 750,000 to 3,000,000 pixels, and options of `open_scene` for it."""
    import cv2
    import tifffile

    random, path = np.random.default_rng(4), folder / name
    codes = random.integers(0, 65536, (1500, 2000, 3), np.uint16)
    waves, planes = np.linspace(400, 700, 31), random.random((31, 750, 1000), np.float32)
    cube = gs.Scene(gs.Cube(waves, planes), as_photons("D65"))
    if name in ("8.png", "8.jpg"):
        cv2.imwrite(str(path), (codes >> 8).astype(np.uint8))
    elif name == "16.png":
        cv2.imwrite(str(path), codes)
    elif name == "16.tif":
        tifffile.imwrite(path, codes, photometric="rgb", compression="zlib")
    elif name == "planes.tif":
        tifffile.imwrite(path, planes, photometric="minisblack")
    elif name == "rgb.exr":
        write_rgb_exr(path, np.moveaxis(planes[:3], 0, -1))
    elif path.suffix == ".mat":
        variables = {
            "scene": {
                "data": {"photons": np.moveaxis(planes, 0, -1)},
                "spectrum": {"wave": waves},
                "illuminant": {"data": {"photons": np.ones(31)}},
            }
        }
        path.write_bytes(
            (mat_mutations.saved_73 if name == "7.3.mat" else mat_mutations.saved_5)(variables)
        )
    else:
        gs.save_scene(cube, path, half=name == "half.exr")
    return path, {"wavelengths": waves} if name == "planes.tif" else {}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "8.png",
        "16.png",
        "8.jpg",
        "16.tif",
        "planes.tif",
        "rgb.exr",
        "cube.exr",
        "half.exr",
        "cube.npz",
        "5.mat",
        "7.3.mat",
    ],
)
def test_whole_files_take_the_memory_that_was_estimated(name, tmp_path):
    """Or less: what is estimated to fit does fit."""
    path, options = large(tmp_path, name)
    with fuzz.estimates() as asked:
        fuzz.PEAK.write_text("5")
        held = fuzz.memory("VmRSS")
        scene = gs.open_scene(path, **options)
        taken = fuzz.memory("VmHWM") - held
    assert scene.content.shape and taken < sum(asked) + fuzz.UNACCOUNTED


# ---- what is no file, or none that can be read


READERS = {
    ".toml": open_camera,
    ".exr": open_scene,
    ".png": open_scene,
    ".jpg": open_scene,
    ".npz": open_scene,
    "psf.npz": read_psf,
    "table.npz": read_table,
    ".hdr": open_scene,
    ".csv": open_scene,
    ".txt": read_zemax_psf,
    ".npy": lambda path: open_scene(path, wavelengths=WAVES),
}


def special_files(folder, suffix):
    os.mkfifo(folder / f"pipe{suffix}")
    yield folder / f"pipe{suffix}", "a pipe"
    (folder / f"zero{suffix}").symlink_to("/dev/zero")
    yield folder / f"zero{suffix}", "a device"
    (folder / f"folder{suffix}").mkdir()
    yield folder / f"folder{suffix}", "a folder"
    with socket.socket(socket.AF_UNIX) as endpoint:
        endpoint.bind(str(folder / f"s{suffix}"))
        yield folder / f"s{suffix}", "a socket"


@pytest.mark.parametrize("suffix", READERS)
def test_pipes_devices_folders_and_sockets_are_refused(tmp_path, monkeypatch, suffix):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    for path, what in special_files(tmp_path.relative_to(tmp_path), suffix):
        with refused(path.name, f"is {what}; wanted a file", error=BadFile):
            READERS[suffix](path)


def test_files_that_a_camera_names_are_opened_as_carefully(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    os.mkfifo(tmp_path / "pipe.npz")
    for old, new in (
        ('"curves.csv"', '"pipe.csv"'),
        ("f_number = 2", 'f_number = 2\npsf = "pipe.npz"'),
        ("bits = 10", 'bits = 10\n[processor]\ndemosaic = "learned"\ntable = "pipe.npz"'),
        ('"curves.csv"', '"/dev/zero.csv"'),
        ('"curves.csv"', f'"{"x" * 5000}.csv"'),
    ):
        (tmp_path / "curves.csv").write_bytes(fuzz.good_texts("curves")[0][0])
        (tmp_path / "own.toml").write_text(fuzz.CAMERA.replace(old, new))
        with refused(error=BadFile):
            open_camera(tmp_path / "own.toml")


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("name", ["x" * 5000, "\0", "none", "a\nb\x1b[31m", "\udcff"])
def test_names_that_no_file_has(tmp_path, suffix, name):
    with refused(error=BadFile):
        READERS[suffix](tmp_path / f"{name}{suffix}")


@pytest.mark.parametrize("name", ["x" * 5000, "\0", "a\nb"])
def test_names_of_nothing(name):
    for read in (open_camera, open_scene):
        with refused(error=UnknownName):
            read(name)


# ---- truncated pictures


def png(rows, present, bits=8, colour=2, cols=11, interlaced=0):
    """A PNG of `rows` lines whose pixel data, whole in themselves, end after `present` of them."""
    samples = {0: 1, 2: 3, 6: 4}[colour]
    lines = bytes(present * (1 + cols * samples * bits // 8))
    return png_of(
        [
            (b"IHDR", struct.pack(">IIBBBBB", cols, rows, bits, colour, 0, 0, interlaced)),
            (b"IDAT", zlib.compress(lines)),
            (b"IEND", b""),
        ]
    )


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("colour", [0, 2, 6])
def test_a_png_with_rows_missing_is_refused(tmp_path, bits, colour):
    path = tmp_path / "a.png"
    path.write_bytes(png(700, 7, bits, colour))
    with refused(path, "truncated", error=BadFile):
        open_scene(path)
    path.write_bytes(png(700, 700, bits, colour))
    assert open_scene(path).shape == (700, 11)
    path.write_bytes(png(700, 701, bits, colour))
    with refused(path, "more than the lines", error=BadFile):
        open_scene(path)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "LA"])
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (5, 9), (17, 33)])
def test_whole_pngs_are_read(tmp_path, mode, size):
    """Also such as Pillow interlaced: the lines of the seven passes are counted as the specification has them."""
    from PIL import Image

    path, random = tmp_path / "a.png", np.random.default_rng(3)
    pixels = Image.fromarray(random.integers(0, 256, (size[1], size[0], 3), np.uint8)).convert(mode)
    pixels.save(path)
    assert open_scene(path).shape == size[::-1]
    whole = path.read_bytes()
    for length in (len(whole) - 1, len(whole) - 12, len(whole) - 13, len(whole) // 2):
        path.write_bytes(whole[:length])
        with refused(path, "truncated", error=BadFile):
            open_scene(path)


@pytest.mark.parametrize("cols, rows", list(itertools.product((1, 2, 5, 8, 13), repeat=2)))
def test_interlaced_pngs_are_read(tmp_path, cols, rows):
    """Seven passes, each the pixels that its number marks in the specification's 8 x 8 pattern."""
    pattern = np.array(
        [
            list(line)
            for line in (
                "16462646",
                "77777777",
                "56565656",
                "77777777",
                "36463646",
                "77777777",
                "56565656",
                "77777777",
            )
        ]
    )
    pixels = np.random.default_rng(3).integers(0, 256, (rows, cols), np.uint8)
    number = np.tile(pattern, (2, 2))[:rows, :cols]
    lines = b""
    for one in "1234567":
        for line, marks in zip(pixels, number == one, strict=True):
            if marks.any():
                lines += b"\0" + line[marks].tobytes()
    path = tmp_path / "a.png"
    for shift, good in ((0, True), (-1, False)):
        path.write_bytes(
            png_of(
                [
                    (b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 1)),
                    (b"IDAT", zlib.compress(lines[: len(lines) + shift])),
                    (b"IEND", b""),
                ]
            )
        )
        if good:
            shading = open_scene(path).content.shading
            np.testing.assert_array_equal(
                np.argsort(shading.ravel(), kind="stable"),
                np.argsort(pixels.ravel(), kind="stable"),
            )
        else:
            with refused("truncated", error=BadFile):
                open_scene(path)


def test_a_png_with_a_wrong_checksum_is_refused(tmp_path):
    path = tmp_path / "a.png"
    whole = bytearray(png(5, 5))
    whole[-20] ^= 1  # of the pixel data's checksum
    path.write_bytes(whole)
    with refused("damaged: wrong checksum", error=BadFile):
        open_scene(path)


# ---- memory is asked for before it is taken


def test_a_16_bit_png_takes_what_its_size_says(tmp_path):
    path = tmp_path / "a.png"
    lines = zlib.compress(bytes(100 * 2**20), 9)  # 100 MiB of lines in 100 kB, for 9 x 7 pixels
    header = struct.pack(">IIBBBBB", 9, 7, 16, 2, 0, 0, 0)
    path.write_bytes(png_of([(b"IHDR", header), (b"IDAT", lines), (b"IEND", b"")]))
    with refused("more than the lines of 9 x 7 pixels", error=BadFile), takes(SMALL):
        open_scene(path)


@pytest.mark.parametrize("number", range(3))  # with EXIF, progressive, grey
def test_a_jpeg_whose_bytes_cannot_hold_its_size_is_refused(tmp_path, number):
    """libjpeg fills with grey what is missing; flat pictures, the smallest there are, are read."""
    from PIL import Image

    data = bytearray(fuzz.good_pictures("jpg", tmp_path)[number])
    frame = data.index(b"\xff\xc2" if number == 1 else b"\xff\xc0")
    data[frame + 5 : frame + 9] = struct.pack(">HH", 9000, 12000)
    path = tmp_path / "a.jpg"
    path.write_bytes(data)
    with refused("truncated", "12000 x 9000", error=BadFile), takes(SMALL):
        open_scene(path)
    flat = Image.new("L" if number == 2 else "RGB", (1200, 900))
    for options in ({}, {"progressive": True, "optimize": True, "quality": 1}):
        flat.save(path, **options)
        assert open_scene(path).shape == (900, 1200)


def test_point_spreads_ask_for_memory(tmp_path, monkeypatch):
    path = archive(
        tmp_path / "a.npz",
        psf=np.zeros((3, 2048, 2048), np.uint8),
        wavelengths_nm=WAVES,
        spacing_um=1.0,
    )
    monkeypatch.setattr(memory, "host_memory", lambda: 100 * 2**20)
    with refused(path, "GiB", error=DoesNotFit), takes(SMALL):
        read_psf(path)


def test_tables_ask_for_memory(tmp_path, monkeypatch):
    arrays = fuzz.good_archives("table")[0]
    path = archive(tmp_path / "a.npz", **arrays | {"filters": np.zeros(2 * 10**7, np.uint8)})
    monkeypatch.setattr(memory, "host_memory", lambda: 100 * 2**20)
    with refused(path, "GiB", error=DoesNotFit), takes(SMALL):
        read_table(path)


def test_the_groups_of_a_table_are_checked_before_they_are_counted(tmp_path):
    arrays = fuzz.good_archives("table")[0]
    for groups in ([0, 2**31 - 1], [0, 50_000_000], [-1, 0], [1, 1]):
        many = np.resize(groups, len(arrays["groups"]))
        path = archive(tmp_path / "a.npz", **arrays | {"groups": many})
        with (
            refused(path, "groups: wanted every number from 0 to the largest", error=BadFile),
            takes(SMALL),
        ):
            read_table(path)


def test_an_array_is_read_once_and_only_if_it_is_asked_for(tmp_path, monkeypatch):
    from gpusim.io.archive import Archive, open_archive

    path, read = (
        archive(
            tmp_path / "a.npz", cube=np.ones((3, 4, 5)), wavelengths_nm=WAVES, other=np.ones(9)
        ),
        [],
    )
    take = Archive.__getitem__
    monkeypatch.setattr(
        Archive, "__getitem__", lambda self, name: read.append(name) or take(self, name)
    )
    open_scene(path)
    assert sorted(read) == ["cube", "wavelengths_nm"]
    with open_archive(path) as stored:
        assert "cube" in stored and "none" not in stored and stored.shape("cube") == (3, 4, 5)
    assert len(read) == 2


KINDS = [np.uint8, np.float16, np.float32, np.float64]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "reader", ["psf", "cube", "photons", "coefficients", "coef", "ids", "table", "png8", "png16"]
)
def test_no_more_memory_is_taken_than_was_asked_for(tmp_path, monkeypatch, reader, kind):
    """NumPy's and Python's own; Pillow's (4 bytes a pixel and the coded file) is not seen here."""
    planes, asked = np.ones((3, 300, 400), kind), []
    monkeypatch.setattr(memory, "host_memory", lambda: 2**62)
    monkeypatch.setattr(memory, "DoesNotFit", DoesNotFit)
    arrays = {
        "psf": {"psf": planes, "spacing_um": 1.0},
        "cube": {"cube": planes},
        "photons": {"photons": planes.T, "illuminant_photons": np.full(3, 2.0)},
        "coefficients": {"coefficients": planes, "basis": np.eye(3), "kind": "reflectance"},
        "coef": {"coef": planes.T, "basis": np.eye(3), "illuminant_photons": np.full(3, 2.0)},
        "ids": {
            "ids": np.zeros((300, 400), np.int64),
            "shading": planes[0],
            "spectra": np.ones((1, 3)),
        },
    }
    path = tmp_path / ("a.png" if reader.startswith("png") else "a.npz")
    if reader == "table":
        good = fuzz.good_archives("table")[0]
        wide = {
            name: np.resize(good[name], (2, 60, *good[name].shape[2:])).astype(kind)
            for name in ("filters", "offsets")
        }
        archive(path, **good | wide | {"levels": np.linspace(0, 1, 60)})
    elif reader.startswith("png"):
        path.write_bytes(png(300, 300, int(reader[3:]), 6, 400))
    else:
        archive(path, wavelengths_nm=WAVES, **arrays[reader])
    read = {"psf": read_psf, "table": read_table}.get(reader, open_scene)
    read(path)  # modules and tables of the program are loaded

    def spy(what, needed):
        asked.append(needed)
        memory.require_memory(what, needed)

    for module in ("gpusim.io.archive", "gpusim.io.scene.photo", "gpusim.io.files"):
        monkeypatch.setattr(f"{module}.require_memory", spy)
    tracemalloc.start()
    try:
        read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # what is not of the arrays: 256 kB pieces of them, zlib's window, spectra, names
    assert peak <= sum(asked) + 2**20, f"{peak / 2**20:.1f} MiB of {sum(asked) / 2**20:.1f}"


def test_letters_that_are_none(tmp_path):
    for kind in ("<u4", ">u4"):
        buffer = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            buffer, {"descr": kind.replace("u4", "U2"), "fortran_order": False, "shape": ()}
        )
        data = np.array([65, 0x110000], kind).tobytes()
        path = archive(tmp_path / "a.npz", cube=np.ones((3, 4, 5)), wavelengths_nm=WAVES)
        with zipfile.ZipFile(path, "a") as file:
            file.writestr("name.npy", buffer.getvalue() + data)
        with refused(path, "invalid characters", error=BadFile):
            open_scene(path)


def test_an_array_that_says_more_than_its_file_holds_is_refused(tmp_path):
    """Sizes of the directory, of the array's header, and of the header itself."""
    path = tmp_path / "a.npz"
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "<f8", "fortran_order": False, "shape": (10**8,)}
    )
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("psf.npy", buffer.getvalue() + bytes(80))
    with (
        refused("truncated or damaged: shape (100000000,) of float64", error=BadFile),
        takes(SMALL),
    ):
        read_psf(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:  # a header of 50 MiB in 50 kB
        file.writestr(
            "psf.npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 50 * 2**20) + b" " * 50 * 2**20
        )
    with refused(path, error=BadFile), takes(SMALL):
        read_psf(path)
    data = bytearray(archive(path, psf=np.ones(3)).read_bytes())
    at = data.index(b"PK\x01\x02") + 24
    data[at : at + 4] = struct.pack("<I", 2**31)
    path.write_bytes(data)
    with refused("cannot come from", error=BadFile), takes(SMALL):
        read_psf(path)
