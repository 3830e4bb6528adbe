"""Frames in files that other programs read: JPEG and WebP by Pillow, OpenImageIO and OpenCV, arrays by NumPy."""

import io
import os

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageCms
from refusals import refused

import gpusim as gs
from gpusim.apps.video.segments import numbered_path
from gpusim.cli.main import main
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.io.frame.images import write_jpeg, write_webp

PATCHES = np.random.default_rng(6).integers(0, 256, (4, 5, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def frame():
    scene = gs.open_scene("colorchecker", size=(48, 32))
    return gs.Simulator(gs.open_camera("phone"), device="numpy")(scene)


@pytest.mark.parametrize("display", ["srgb", "display-p3"])
def test_jpegs_hold_their_codes_and_their_profile(tmp_path, display):
    """Patches of two blocks have only means: a step of 1/8 in YCbCr, and rounding.

    Half a code in Y, Cb and Cr is up to (0.5 + 1.772 x 0.5) codes of RGB, and each way rounds again.
    """
    codes, display = PATCHES.repeat(16, 0).repeat(16, 1), gs.open_display(display)
    write_jpeg(tmp_path / "a.jpg", codes, display, quality=100)
    found = oiio.ImageBuf(str(tmp_path / "a.jpg")).get_pixels(oiio.UINT8)
    with Image.open(tmp_path / "a.jpg") as image:
        np.testing.assert_array_equal(np.asarray(image), found)
        profile = ImageCms.getOpenProfile(io.BytesIO(image.info["icc_profile"]))
    assert np.abs(found.astype(int) - codes).max() <= 2
    assert ImageCms.getProfileDescription(profile).strip() == f"gpusim {display.name}"


@pytest.mark.parametrize("display", ["srgb", "display-p3"])
def test_webps_hold_their_codes_and_their_profile(tmp_path, display):
    """Without loss every code; with loss, flat patches of a block have steps of the luma and chroma.

    Y is 219/255 and Cb, Cr 224/255 of the full range, rounded to whole numbers: up to 0.5 x 255/219 + 0.5 x 2.018 =
    1.6 codes, and libwebp's quantiser of quality 99 adds about as much at means of 16 x 16; 6 is below the
    difference of neighbouring patches, which is what a wrong order or range of channels would show.
    """
    codes, display = PATCHES.repeat(32, 0).repeat(32, 1), gs.open_display(display)
    for quality, most in ((100, 0), (99, 6)):
        write_webp(tmp_path / "a.webp", codes, display, quality=quality)
        found = cv2.imread(str(tmp_path / "a.webp"), cv2.IMREAD_COLOR)[..., ::-1]
        read = oiio.ImageBuf(str(tmp_path / "a.webp")).get_pixels(oiio.UINT8)
        inner = np.s_[8:-8:32, 8:-8:32]  # chroma is blurred at the edges of patches
        for one in (found, read):
            assert np.abs(one[inner].astype(int) - codes[inner]).max() <= most
        if not most:
            np.testing.assert_array_equal(found, codes)
        with Image.open(tmp_path / "a.webp") as image:
            assert image.format == "WEBP"
            profile = ImageCms.getOpenProfile(io.BytesIO(image.info["icc_profile"]))
        assert ImageCms.getProfileDescription(profile).strip() == f"gpusim {display.name}"


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_quality(frame, tmp_path, suffix):
    sizes, name = {}, f"a{suffix}"
    for quality in (20, 95, 100):
        frame.save(tmp_path / name, quality=quality)
        sizes[quality] = os.path.getsize(tmp_path / name)
    assert sizes[20] < sizes[95] < sizes[100]
    other = {".jpg": "b.JPEG", ".webp": "b.WebP"}[suffix]
    frame.save(tmp_path / other)
    assert os.path.getsize(tmp_path / other) == sizes[95]
    for wrong, quality in ((name, 0), (name, 101), ("a.png", 90)):
        with refused("quality", error=OutOfRange):
            frame.save(tmp_path / wrong, quality=quality)
    for bits in (16, 32):
        with refused(f"bits of a {suffix}", error=OutOfRange):
            frame.save(tmp_path / name, bits=bits)


def test_numbered_files_have_a_quality(tmp_path, capsys):
    asked = "video ramp --size 48x32 --frames 2 --camera phone --device numpy".split()
    sizes = {}
    for suffix in ("jpg", "webp"):
        for quality in ("10", "90"):
            out = tmp_path / quality / f"a.{suffix}"
            assert main([*asked, "-o", str(out), "--quality", quality]) == 0
            sizes[quality] = sum(map(os.path.getsize, out.parent.glob(f"a_*.{suffix}")))
        assert sizes["10"] < sizes["90"]
    capsys.readouterr()
    for name, quality, words in (
        ("a.jpg", "0", "quality of a .jpg output = 0.0: allowed is 1 .. 100"),
        ("a.webp", "33.5", "allowed is 1 .. 100"),
        ("a.png", "90", "--quality: only .mp4, .mkv, .y4m, .jpg, .jpeg, .webp files have one"),
        ("a.mkv", "60", "--quality of an encoded video = 60.0: allowed is 0 .. 51"),
    ):
        assert main([*asked, "-o", str(tmp_path / "new" / name), "--quality", quality]) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_arrays(frame, tmp_path):
    for name, bits, wanted in (
        ("a.npy", None, frame.linear),
        ("a.npy", 32, frame.linear),
        ("a.npy", 16, frame.codes(16)),
        ("a.npy", 8, frame.rgb),
        ("a.raw.npy", None, frame.raw),
        ("A.RAW.NPY", None, frame.raw),
    ):
        frame.save(tmp_path / name, bits=bits)
        found = np.load(tmp_path / name)
        assert found.dtype == wanted.dtype and found.flags.c_contiguous
        np.testing.assert_array_equal(found, wanted)


def test_numbered_arrays_keep_their_format(tmp_path):
    assert numbered_path(tmp_path / "a.raw.npy", 3, 9).name == "a_0003.raw.npy"
    assert numbered_path(tmp_path / "a.b.npy", 3, 9).name == "a.b_0003.npy"


def test_nothing_is_left_of_files_that_cannot_be_written(frame, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    with pytest.raises(BadData, match="a JPEG needs uint8"):
        write_jpeg(tmp_path / "a.jpg", np.zeros((3, 4)))
    with pytest.raises(BadData, match=r"a WebP needs uint8.* up to 16383 pixels"):
        write_webp(tmp_path / "a.webp", np.zeros((1, 16384, 3), np.uint8))
    monkeypatch.setattr("os.replace", fail)
    for name in ("a.jpg", "a.webp", "a.npy", "a.raw.npy"):
        with refused(name, "No space left", error=BadFile):
            frame.save(tmp_path / "new" / "folder" / name)
    assert list(tmp_path.iterdir()) == []


def test_command_line(tmp_path, capsys):
    asked = ["simulate", "ramp", "--size", "48x32", "--camera", "phone", "--device", "numpy"]
    outs = [tmp_path / name for name in ("a.jpg", "a.npy", "a.raw.npy", "a.npz")]
    given = [word for path in outs for word in ("-o", str(path))]
    assert main([*asked, *given, "--quality", "80"]) == 0
    with Image.open(outs[0]) as image:
        assert image.size == (48, 32)
    assert np.load(outs[1]).shape == (32, 48, 3)
    np.testing.assert_array_equal(np.load(outs[2]), np.load(outs[3])["dn"])
    capsys.readouterr()
    assert main([*asked, "-o", str(outs[1]), "--quality", "80"]) == 2
    assert "--quality" in capsys.readouterr().err
    assert main([*asked, "-o", str(outs[2]), "--bits", "16"]) == 2
    assert "--bits" in capsys.readouterr().err
    frames = [*asked, "--frames", "2", "-o", str(tmp_path / "b.raw.npy")]
    assert main(frames) == 0 and np.load(tmp_path / "b_0001.raw.npy").shape == (32, 48)
