"""TIFF files of OpenCV, tifffile and Pillow: photographs, and planes of wavelengths that are given."""

import argparse
import struct
import tracemalloc

import numpy as np
import pytest
import tifffile
from refusals import SMALL, refused, takes

from gpusim.cli.options import _wavelengths
from gpusim.domain.errors import BadFile, DoesNotFit, OutOfRange, UnknownName
from gpusim.io.scene.photo import open_photo
from gpusim.io.scene.scenes import open_scene

RANDOM = np.random.default_rng(6)
RGB16 = RANDOM.integers(0, 65536, (7, 9, 3), np.uint16)
PHOTON = 1.98644586e-25  # [J m] h c, CODATA 2018, nine digits


def stored_samples(path):
    return open_photo(path).samples


# ---- photographs


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
def test_opencvs_files_hold_the_same_samples(tmp_path, suffix, kind, channels):
    import cv2

    codes = RANDOM.integers(0, np.iinfo(kind).max + 1, (7, 9, channels)).astype(kind)
    assert cv2.imwrite(
        str(tmp_path / f"a{suffix}"), codes[..., ::-1] if channels == 3 else codes[..., 0]
    )  # blue first
    samples = stored_samples(tmp_path / f"a{suffix}")
    assert samples.dtype == kind
    np.testing.assert_array_equal(samples, codes)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize(
    "options", [{}, {"compression": "zlib", "predictor": 3}, {"planarconfig": "separate"}]
)
def test_floats_are_linear(tmp_path, kind, options):
    linear = RANDOM.uniform(0, 4, (7, 9, 3)).astype(kind)
    stored = np.moveaxis(linear, -1, 0) if "planarconfig" in options else linear
    if options.get("predictor") and kind is np.float16:
        options = options | {"predictor": None}
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", **options)
    got = open_scene(tmp_path / "a.tif").content.coefficients
    np.testing.assert_array_equal(np.moveaxis(got, 0, -1), linear.astype(np.float32))


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate", "packbits"])
@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA"])
def test_pillows_tiffs_are_read_as_their_pngs_are(tmp_path, mode, compression):
    from PIL import Image

    picture = Image.fromarray(RANDOM.integers(0, 256, (7, 9, 4), np.uint8), "RGBA").convert(mode)
    picture.save(tmp_path / "a.tif", compression=compression)
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(
        stored_samples(tmp_path / "a.tif"), stored_samples(tmp_path / "a.png")
    )


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_pillows(tmp_path, orientation):
    from PIL import Image, ImageOps

    tifffile.imwrite(
        tmp_path / "a.tif",
        RGB16.astype(np.uint8),
        photometric="rgb",
        extratags=[(274, "H", 1, orientation, True)],
    )
    with Image.open(tmp_path / "a.tif") as image:
        seen = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(stored_samples(tmp_path / "a.tif"), seen)


def test_white_is_zero_tiles_thumbnails_and_premultiplied_alpha(tmp_path):
    path, grey = tmp_path / "a.tif", RANDOM.integers(0, 256, (70, 90), np.uint8)
    tifffile.imwrite(path, 255 - grey, photometric="miniswhite", tile=(32, 16))
    np.testing.assert_array_equal(stored_samples(path)[..., 0], grey)
    with tifffile.TiffWriter(path) as file:
        file.write(RGB16, photometric="rgb")
        file.write(RGB16[::2, ::2], photometric="rgb", subfiletype=1)
    np.testing.assert_array_equal(stored_samples(path), RGB16)
    alpha = np.full((7, 9, 1), 30000, np.uint16)
    for extra, channels in (("assocalpha", 3), ("unassalpha", 4)):
        tifffile.imwrite(path, np.dstack([RGB16, alpha]), photometric="rgb", extrasamples=[extra])
        assert stored_samples(path).shape == (7, 9, channels)


# ---- planes


@pytest.mark.parametrize(
    "options",
    [
        {"photometric": "minisblack"},
        {"photometric": "minisblack", "bigtiff": True},
        {"planarconfig": "separate", "photometric": "minisblack"},
        {"photometric": "minisblack", "compression": "lzw"},
        {"imagej": True},
    ],
)
def test_planes_are_a_cube(tmp_path, options):
    planes, waves = RANDOM.integers(0, 65536, (5, 7, 9), np.uint16), [400, 450, 500.5, 600, 700]
    tifffile.imwrite(tmp_path / "a.tif", planes, **options)
    scene = open_scene(tmp_path / "a.tif", wavelengths=waves)
    np.testing.assert_array_equal(scene.wavelengths, waves)
    np.testing.assert_array_equal(
        scene.content.values, planes.astype(np.float32) / np.float32(65535)
    )
    assert scene.light_is_known


def test_channels_of_a_page_are_planes(tmp_path):
    values = RANDOM.random((7, 9, 4), np.float32)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="minisblack", planarconfig="contig")
    waves = np.array([400.0, 500, 600, 700])
    scene = open_scene(tmp_path / "a.tif", wavelengths=waves, kind="radiance")
    # W m-2 sr-1 nm-1 to photons: a factor of float32 and its product
    np.testing.assert_allclose(
        np.moveaxis(scene.content.values, 0, -1), values * waves * 1e-9 / PHOTON, rtol=2e-7
    )
    assert not scene.light_is_known


def test_opencvs_pages_are_planes(tmp_path):
    import cv2

    planes = RANDOM.random((3, 7, 9), np.float32)
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), list(planes))
    got = open_scene(tmp_path / "a.tif", wavelengths=(400, 500, 600)).content.values
    np.testing.assert_array_equal(got, planes)


@pytest.mark.parametrize(
    "text, wanted", [("400:700:100", [400, 500, 600, 700]), ("450,550.5", [450, 550.5])]
)
def test_wavelengths_on_a_command_line(text, wanted):
    assert _wavelengths(text) == wanted


@pytest.mark.parametrize(
    "text", ["", "a", "400:700", "400:700:0", "400:700:7", "700:400:10", "1:1e9:1e-9", "nan:1:1"]
)
def test_wavelengths_that_are_none(text):
    with pytest.raises(argparse.ArgumentTypeError, match="400:700:10"):
        _wavelengths(text)


def test_the_command_line_takes_wavelengths(tmp_path, capsys):
    from gpusim.cli.main import main

    tifffile.imwrite(
        tmp_path / "a.tif", np.full((4, 8, 8), 0.5, np.float32), photometric="minisblack"
    )
    asked = ["simulate", str(tmp_path / "a.tif"), "--camera", "mono", "--device", "numpy"]
    assert main([*asked, "--wavelengths", "400:700:100"]) == 0
    assert main(asked) == 2 and "--wavelengths" in capsys.readouterr().err


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_the_number_that_stands_for_1(tmp_path, kind):
    planes = RANDOM.integers(0, 10000, (3, 7, 9)).astype(kind)
    tifffile.imwrite(tmp_path / "a.tif", planes, photometric="minisblack")
    scene = open_scene(tmp_path / "a.tif", wavelengths=(400, 500, 600), scale=1e4)
    np.testing.assert_array_equal(scene.content.values, planes.astype(np.float32) / np.float32(1e4))
    with refused("scale", "with wavelengths only", error=OutOfRange):
        open_scene(tmp_path / "a.tif", scale=1e4)


# ---- refusals


def test_refusals(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((3, 7, 9), np.uint8), photometric="minisblack")
    with refused(path, "3 pages", "--wavelengths", error=BadFile):
        open_scene(path)
    with refused(path, "3 planes for 2 wavelengths", error=BadFile):
        open_scene(path, wavelengths=[400, 500])
    for waves in (
        [],
        [500, 400, 600],
        [400, 400, 500],
        [0, 1, 2],
        [1, 2, np.nan],
        "red",
        [[1, 2]],
        [1, 2, np.inf],
    ):
        with refused("wavelengths", "ascending", error=OutOfRange):
            open_scene(path, wavelengths=waves)
    with refused("'light'", "radiance", error=UnknownName):
        open_scene(path, wavelengths=[1, 2, 3], kind="light")
    with refused("kind", error=OutOfRange):
        open_scene(path, kind="radiance")
    with refused(".tif", error=OutOfRange):
        open_scene("flat", wavelengths=[1, 2, 3])


@pytest.mark.parametrize(
    "array, options, said",
    [
        (np.zeros((7, 9), np.int32), {}, "int32: numbers with a sign"),
        (np.zeros((7, 9), np.uint64), {}, "wanted 8, 16 or 32 bit"),
        (np.zeros((7, 9), bool), {}, "wanted 8, 16 or 32 bit"),
        (np.zeros((7, 9, 4), np.uint8), {"photometric": "separated"}, "4 channels"),
        (
            np.zeros((7, 9), np.uint8),
            {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)},
            "1 channels",
        ),
        (
            np.zeros((7, 9, 3), np.uint8),
            {"photometric": "rgb", "compression": "webp"},
            "compressed by",
        ),
        (np.full((7, 9), np.nan, np.float32), {}, "NaN"),
        (np.full((7, 9), 1e300), {}, "more than float32 holds"),
        (np.full((7, 9), -1, np.float32), {}, "negative values (lowest -1)"),
    ],
)
def test_kinds_that_are_not_read(tmp_path, array, options, said):
    tifffile.imwrite(tmp_path / "a.tif", array, **{"photometric": "minisblack"} | options)
    with refused(tmp_path / "a.tif", said, error=BadFile):
        open_scene(tmp_path / "a.tif")


def test_without_its_library_a_compressed_file_says_what_to_install(tmp_path, monkeypatch):
    import importlib.util

    tifffile.imwrite(tmp_path / "a.tif", RGB16, photometric="rgb", compression="lzw")
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "imagecodecs" else find(name)
    )
    with refused("LZW", "pip install 'gpusim[tiff]'", error=BadFile):
        open_scene(tmp_path / "a.tif")


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
def test_truncated(tmp_path, compression):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, RGB16, photometric="rgb", compression=compression, rowsperstrip=2)
    whole = path.read_bytes()
    for length in (0, 3, 7, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with refused(path, error=BadFile):
            open_scene(path)


def test_pages_that_go_in_a_circle(tmp_path):
    """The last of three pages says that the first comes next; each page's link stands behind its tags (TIFF 6, 2)."""
    tifffile.imwrite(
        tmp_path / "a.tif",
        RANDOM.integers(0, 65536, (3, 7, 9), np.uint16),
        photometric="minisblack",
        metadata=None,
    )
    data = bytearray((tmp_path / "a.tif").read_bytes())
    first = at = struct.unpack_from("<I", data, 4)[0]
    while True:
        link = at + 2 + 12 * struct.unpack_from("<H", data, at)[0]
        if not (at := struct.unpack_from("<I", data, link)[0]):
            break
    struct.pack_into("<I", data, link, first)
    (tmp_path / "a.tif").write_bytes(data)
    with refused("a.tif", "page 3 repeats an earlier one", error=BadFile):
        open_scene(tmp_path / "a.tif", wavelengths=[500, 550, 600])


def test_a_file_that_says_it_is_huge_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, np.zeros((7, 9), np.uint16), photometric="minisblack", compression="zlib"
    )
    data = bytearray(path.read_bytes())
    for tag in (256, 257, 278):  # columns, rows, rows of a strip
        at = next(
            i
            for i in range(len(data))
            if data[i : i + 2] == struct.pack("<H", tag)
            and data[i + 2] in (3, 4)
            and data[i + 4 : i + 8] == b"\1\0\0\0"
        )
        data[at + 2 : at + 12] = struct.pack("<HII", 4, 1, 2**20)
    path.write_bytes(data)
    with refused(path, "1048576 x 1048576", "cannot come from", error=BadFile), takes(SMALL):
        open_scene(path)


def test_memory_is_asked_for(tmp_path, monkeypatch):
    from gpusim.domain import memory

    path = tmp_path / "a.tif"
    monkeypatch.setattr(memory, "host_memory", lambda: 10 * 2**20)
    for shape, options, waves in (((3000, 2000), {}, None), ((3, 1000, 2000), {}, [400, 500, 600])):
        tifffile.imwrite(path, np.zeros(shape, np.uint8), photometric="minisblack", **options)
        with refused(path, "GiB", error=DoesNotFit), takes(SMALL):
            open_scene(path, wavelengths=waves)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize(
    "options", [{}, {"compression": "zlib"}, {"tile": (64, 64)}, {"planarconfig": "separate"}]
)
@pytest.mark.parametrize("stack", [False, True])
def test_no_more_memory_is_taken_than_was_asked_for(tmp_path, monkeypatch, kind, options, stack):
    """NumPy's and Python's own, as they read; twice the estimate would be a fault already."""
    planes, asked, path = np.ones((3, 300, 400), kind), [], tmp_path / "a.tif"
    apart = "planarconfig" in options
    tifffile.imwrite(
        path,
        planes if stack or apart else np.moveaxis(planes, 0, -1),
        photometric="minisblack" if stack else "rgb",
        **options,
    )
    waves = [400, 500, 600] if stack else None
    open_scene(path, wavelengths=waves)  # modules and tables of the program are loaded
    monkeypatch.setattr(
        "gpusim.io.scene.tiff.require_memory", lambda what, needed: asked.append(needed)
    )
    tracemalloc.start()
    try:
        open_scene(path, wavelengths=waves)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= sum(asked) + 2**20, (
        f"{peak / 2**20:.1f} MiB of {sum(asked) / 2**20:.1f}"
    )  # 1 MiB: spectra, names
