"""Frames saved as pictures of more than 8 bits: the same light as `rgb` shows, with finer steps."""

import numpy as np
import pytest
import tifffile
from cameras import camera_with

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import OutOfRange
from gpusim.io.frame.frames import BITS


def openimageio(path, kind):
    import OpenImageIO

    file = OpenImageIO.ImageInput.open(str(path))
    try:
        return file.read_image(kind)
    finally:
        file.close()


@pytest.mark.parametrize("display", ["srgb", "display-p3", "crt-dell"])
@pytest.mark.parametrize(
    "tone",
    [(), ((0, 0), (0.25, 0.2), (0.75, 0.85), (1, 1)), "sigmoid"],
    ids=["plain", "tone", "named"],
)
def test_16_bits_are_the_8_bits_and_what_lies_between(tmp_path, display, tone):
    """Both round to the nearest: a code of 8 bits is at most half its step, and half a fine one, from that of 16."""
    camera = camera_with(display=vars(gs.open_display(display)), processor={"tone": tone})
    frame = gs.Simulator(camera, device="opencl")(gs.chart("colorchecker", size=(96, 64)))
    frame.save(tmp_path / "a.png", bits=16)
    frame.save(tmp_path / "a.tif")
    fine = openimageio(tmp_path / "a.png", "uint16")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), fine)
    assert np.abs(fine / 257 - frame.rgb).max() <= 0.5 + 0.5 / 257 + 1e-9
    assert len(np.unique(fine)) > 4 * len(np.unique(frame.rgb))
    if not tone:  # the display's own curve, float64, of float32 light
        wanted = 65535 * frame.camera.display.encode(np.clip(frame.linear.astype(float), 0, 1))
        assert np.abs(fine - wanted).max() <= 0.5 + 1e-6


def test_linear_light_as_floats(tmp_path):
    frame = gs.Simulator(gs.open_camera("phone"), device="opencl")(gs.chart("ramp", size=(64, 32)))
    linear = frame.linear
    frame.save(tmp_path / "a.tiff", bits=32)
    np.testing.assert_array_equal(openimageio(tmp_path / "a.tiff", "float"), linear)
    for bits, kind in ((32, np.float32), (16, np.float16), (None, np.float32)):
        frame.save(tmp_path / "a.exr", bits=bits)
        np.testing.assert_array_equal(
            openimageio(tmp_path / "a.exr", "float"), linear.astype(kind).astype(np.float32)
        )


def test_not_finite_light_has_a_code():
    frame = gs.Simulator(gs.open_camera("phone"), device="opencl")(
        gs.chart("flat", size=(16, 16))
    ).complete()
    frame.linear[0, :4] = np.array([np.nan, -np.inf, np.inf, 1.0])[:, None]
    assert frame.codes(16)[0, :4, 0].tolist() == [0, 0, 65535, 65535]
    assert frame.codes() is frame.rgb
    with pytest.raises(OutOfRange, match="bits of display codes = 10: allowed is 8 or 16"):
        frame.codes(10)


@pytest.mark.parametrize(
    ("suffix", "bits"), [(".png", 32), (".png", 10), (".tif", 12), (".exr", 8)]
)
def test_bits_that_a_format_has_not(tmp_path, suffix, bits):
    frame = gs.Simulator(gs.open_camera("phone"), device="opencl")(gs.chart("flat", size=(16, 16)))
    with pytest.raises(OutOfRange, match=rf"bits of a \{suffix} output = {bits}: allowed is "):
        frame.save(tmp_path / f"a{suffix}", bits=bits)
    assert list(tmp_path.iterdir()) == []


def test_bits_from_the_command_line(tmp_path, capsys):
    outs = [tmp_path / f"a{suffix}" for suffix in (".png", ".tif", ".exr", ".npz")]
    status = main(
        [
            "simulate",
            "flat",
            "--camera",
            "phone",
            "--size",
            "32x24",
            "--device",
            "opencl",
            "--bits",
            "16",
            *(part for out in outs for part in ("-o", str(out))),
        ]
    )
    assert status == 0, capsys.readouterr().err
    assert (
        openimageio(outs[0], "uint16").max() > 255 and tifffile.imread(outs[1]).dtype == np.uint16
    )
    assert set(BITS) >= {".png", ".tif", ".exr"}
