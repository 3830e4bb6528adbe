"""Raw files are read with their settings; what is no raw value is refused, and owners stay out."""

import numpy as np
import pytest
import tifffile
from PIL import Image
from PIL.ExifTags import GPS, Base

import gpusim as gs
from gpusim.io.frame.dng import write_dng
from gpusim.io.raw.raw_files import count_frames, read_raw

VALUES = np.arange(30 * 44, dtype=np.uint16).reshape(30, 44)
MATRICES = {"D65": (np.eye(3), None)}


def dng(path, **more):
    write_dng(path, VALUES, ("GR", "BG"), 64, 4000, MATRICES, np.ones(3), **more)
    return path


def raw_tiff(path, values=VALUES, **tags):
    """A DNG by tifffile, with more tags."""
    known = {"reduction": (50935, "2I", 1, (1, 2)), "serial": (50735, "s", 0, "SN123456")}
    extra = [
        (50706, "B", 4, (1, 4, 0, 0), True),
        (271, "s", 0, "Maker", True),
        (272, "s", 0, "Model 7", True),
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, (0, 1, 1, 2), True),
        *((*known[name], True) for name in tags),
    ]
    tifffile.imwrite(path, values, photometric=tags.pop("photometric", "cfa"), extratags=extra)
    return path


def test_a_dng_of_gpusim_comes_back_with_its_settings(tmp_path):
    path = dng(tmp_path / "a.dng", exposure_time=1 / 60, noise=(1e-4, 1e-6))
    frame = read_raw(path)
    np.testing.assert_array_equal(frame.values, VALUES)
    assert frame.cfa == ("GR", "BG") and frame.camera == "gpusim"
    assert frame.exposure_time == pytest.approx(1 / 60, rel=1e-8)
    assert frame.black_level == 64 and frame.white_level == 4000
    np.testing.assert_allclose(frame.noise_profile, [[1e-4, 1e-6]])


def test_libraw_reads_the_same(tmp_path):
    pytest.importorskip("rawpy")
    from gpusim.io.raw.raw_files import _read_by_libraw
    from gpusim.io.raw.raw_tags import read_raw_tags

    path = dng(tmp_path / "a.dng", exposure_time=0.5)
    ours, libraw = read_raw(path), _read_by_libraw(path, read_raw_tags(path))
    np.testing.assert_array_equal(ours.values, libraw.values)
    assert (ours.cfa, ours.exposure_time) == (libraw.cfa, libraw.exposure_time)


def test_processed_files_are_refused_with_the_remedy(tmp_path):
    for name, words, values, tags in (
        ("denoised", "NoiseReductionApplied 0.5", VALUES, {"reduction": 1}),
        ("linear", "demosaicked", None, {}),
    ):
        path = tmp_path / f"{name}.dng"
        if values is None:
            colours = np.repeat(VALUES[..., None], 3, axis=2)
            write_dng(path, np.moveaxis(colours, 2, 0), (), 0, 4000, MATRICES, np.ones(3))
        else:
            raw_tiff(path, values, **tags)
        with pytest.raises(gs.GpusimError, match=words) as caught:
            read_raw(path)
        assert "shoot raw" in str(caught.value)
    picture = Image.fromarray(np.zeros((8, 8, 3), np.uint8))
    for suffix in ("jpg", "png", "webp"):
        picture.save(tmp_path / f"a.{suffix}")
        with pytest.raises(gs.GpusimError, match=r"developed picture.*shoot raw"):
            read_raw(tmp_path / f"a.{suffix}")


def test_owner_serial_number_and_position_stay_out(tmp_path):
    path = raw_tiff(tmp_path / "a.dng", serial=1)
    frame = read_raw(path)
    assert frame.camera == "Maker Model 7"
    assert "SN123456" not in repr(vars(frame))
    exif = Image.Exif()
    exif[Base.Artist.value], exif[Base.BodySerialNumber.value] = "A Person", "SN123456"
    exif.get_ifd(Base.GPSInfo.value)[GPS.GPSLatitude.value] = (48.0, 1.0, 2.0)
    Image.fromarray(VALUES.astype(np.int32).astype(np.uint16)).save(tmp_path / "b.tif", exif=exif)
    shown = repr(vars(read_raw(tmp_path / "b.tif")))
    assert not any(words in shown for words in ("Person", "SN123456", "48.0"))


def test_arrays_have_settings_and_stacks_have_frames(tmp_path):
    np.savez(
        tmp_path / "a.npz", dn=VALUES, cfa=np.array(["RG", "GB"]), iso=800.0, focal_length_mm=50.0
    )
    frame = read_raw(tmp_path / "a.npz", exposure_time=0.1)
    assert (frame.iso, frame.focal_length, frame.exposure_time) == (800, 0.05, 0.1)
    np.save(tmp_path / "b.npy", np.stack([VALUES, VALUES + 1]))
    assert count_frames(tmp_path / "b.npy") == 2
    second = read_raw(tmp_path / "b.npy", 1, cfa="bayer-bggr")
    np.testing.assert_array_equal(second.values, VALUES + 1)
    assert second.name == "b.npy[1]" and second.cfa == ("BG", "GR")
    with pytest.raises(gs.GpusimError, match=r"allowed is 0 \.\. 1"):
        read_raw(tmp_path / "b.npy", 2)
    np.save(tmp_path / "c.npy", np.zeros(5))
    with pytest.raises(gs.GpusimError, match="wanted raw values"):
        read_raw(tmp_path / "c.npy")
    (tmp_path / "d.dng").write_bytes(b"II*\0" + bytes(20))
    with pytest.raises(gs.GpusimError):
        read_raw(tmp_path / "d.dng")


@pytest.mark.parametrize(
    "wrong, right", [("black", "black_level"), ("exposure_time", "exposure_time_s")]
)
def test_a_key_that_is_written_wrongly_is_refused(wrong, right, tmp_path):
    """Arrays of other programs are left: those of photodiodes, for example."""
    np.savez(tmp_path / "a.npz", dn=VALUES, **{wrong: 1.0})
    with pytest.raises(gs.GpusimError, match=f"{wrong}: no key .* nearest is {right}"):
        read_raw(tmp_path / "a.npz", cfa="bayer-rggb")
    np.savez(tmp_path / "b.npz", dn=VALUES, electrons=VALUES, mean=VALUES, names=np.array(["left"]))
    assert read_raw(tmp_path / "b.npz", cfa="bayer-rggb").values.shape == VALUES.shape
