"""Frames in files that other programs read: JPEG by Pillow and OpenImageIO, arrays by NumPy."""

import io
import os

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageCms
from refusals import refused

import gpusim as gs
from gpusim.apps.video.segments import numbered_path
from gpusim.cli.main import main
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.io.frame.images import write_jpeg

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


def test_quality(frame, tmp_path):
    sizes = {}
    for quality in (20, 95, 100):
        frame.save(tmp_path / "a.jpg", quality=quality)
        sizes[quality] = os.path.getsize(tmp_path / "a.jpg")
    assert sizes[20] < sizes[95] < sizes[100]
    frame.save(tmp_path / "b.JPEG")
    assert os.path.getsize(tmp_path / "b.JPEG") == sizes[95]
    for name, quality in (("a.jpg", 0), ("a.jpg", 101), ("a.png", 90)):
        with refused("quality", error=OutOfRange):
            frame.save(tmp_path / name, quality=quality)
    with refused("bits of a .jpg", error=OutOfRange):
        frame.save(tmp_path / "a.jpg", bits=16)


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
    monkeypatch.setattr("os.replace", fail)
    for name in ("a.jpg", "a.npy", "a.raw.npy"):
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
