"""Every file that gpusim writes and reads, as another program reads it; the table is in docs/files.md.

Other figures of the table are in test_save_scene, test_picture_files, test_frames_out, test_dng and test_video.
"""

import io
import re
import tarfile
import tomllib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import rawpy
import tifffile
from PIL import Image
from scipy.constants import c, h

import gpusim as gs
from gpusim.apps.l3.layout import layout
from gpusim.apps.pairs.shards import npy, write_shard
from gpusim.apps.preview.state import State
from gpusim.domain.learned import FilterTable
from gpusim.io.camera.learned import read_table, write_table
from gpusim.io.frame.frames import FORMATS
from gpusim.io.scene.tiff import SUFFIXES as TIFF

WAVES = np.array([400.0, 450.25, 500.0, 560.0, 650.0])
RANDOM = np.random.default_rng(5)
CUBE = RANDOM.random((5, 8, 9), np.float32)
ULP = 2.0**-24
NOISE_PROFILE = 51041  # tag of DNG


@pytest.fixture(scope="module")
def frame():
    scene = gs.open_scene("colorchecker", size=(48, 32))
    return gs.Simulator(gs.open_camera("phone"), device="numpy")(scene)


def test_scene_archive_by_numpy(tmp_path):
    scene = gs.scene_from(CUBE, WAVES, light="D65", depth=1 + CUBE[0], fov=0.4, border="zero")
    gs.save_scene(scene, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as held:
        np.testing.assert_array_equal(held["cube"], CUBE)
        np.testing.assert_array_equal(held["wavelengths_nm"], WAVES)
        np.testing.assert_array_equal(held["depth_m"], 1 + CUBE[0])
        np.testing.assert_array_equal(held["illuminant"], scene.illuminant.values)
        np.testing.assert_array_equal(
            held["illuminant_wavelengths_nm"], scene.illuminant.wavelengths
        )
        assert (held["fov_rad"].item(), held["border"].item()) == (0.4, "zero")


@pytest.mark.parametrize("half, rounded", [(False, 2 * ULP), (True, 2.0**-11)])
def test_spectral_openexr_by_openimageio(tmp_path, half, rounded):
    """Radiance in W m-2 sr-1 nm-1 by photons of h c / wavelength."""
    photons = CUBE * np.float32(1e16)
    scene = gs.scene_from(photons, WAVES, depth=1 + CUBE[0])
    gs.save_scene(scene, tmp_path / "a.exr", half=half)
    image = oiio.ImageBuf(str(tmp_path / "a.exr"))
    names, pixels = list(image.spec().channelnames), image.get_pixels(oiio.FLOAT)
    for nm, plane in zip(WAVES, photons.astype(float) * h * c / 1e-9, strict=True):
        found = pixels[..., names.index(f"S0.{nm:.6f}nm".replace(".", ",").replace(",", ".", 1))]
        np.testing.assert_allclose(found, plane / nm, rtol=rounded, atol=2.0**-25 if half else 0)
    np.testing.assert_array_equal(pixels[..., names.index("Z")], 1 + CUBE[0])
    assert image.spec().getattribute("emissiveUnits") == "W.m^-2.sr^-1.nm^-1"


@pytest.mark.parametrize("form", ["one", "heights", "grid", "distances"])
def test_point_spreads_by_numpy(tmp_path, form):
    values = RANDOM.random((5, 7, 7)) + 0.1
    values /= values.sum((1, 2), keepdims=True)
    more = {
        "one": {},
        "heights": {"heights": np.array([0.0, 1.0])},
        "grid": {"grid": (np.array([-1.0, 1.0]), np.array([-1.0, 0.0, 1.0]))},
        "distances": {"distances": np.array([0.5, 2.0])},
    }[form]
    shape = {"one": (), "heights": (2,), "grid": (2, 3), "distances": (2,)}[form]
    values = np.broadcast_to(values, (*shape, *values.shape)).copy()
    spread = gs.PointSpread(WAVES, values, 1.5e-6, **more)
    gs.write_psf(tmp_path / "a.npz", spread)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as held:
        np.testing.assert_array_equal(held["psf"], spread.values)
        np.testing.assert_array_equal(held["wavelengths_nm"], WAVES)
        assert held["spacing_um"] == pytest.approx(1.5, rel=1e-15)
        keys = {"heights": ["heights"], "grid": ["grid_y", "grid_x"], "distances": ["distances_m"]}
        wanted = more.get("grid", tuple(more.values()))
        for key, axis in zip(keys.get(form, []), wanted, strict=True):
            np.testing.assert_array_equal(held[key], axis)
    # spreads are divided by their sum: two rounded quotients of a rounded sum
    np.testing.assert_allclose(gs.read_psf(tmp_path / "a.npz").values, values, rtol=1e-15)


def test_filter_tables_by_numpy(tmp_path):
    made = layout(("RG", "GB"), "RGB", noise=(0.0, 0.1), radius=1)
    filters = RANDOM.random(made.shape).astype(np.float32)
    write_table(tmp_path / "a.npz", FilterTable(made, filters, None, "a test"))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as held:
        np.testing.assert_array_equal(held["filters"], filters)
        assert (held["mosaic"].tolist(), held["provenance"].item()) == (["RG", "GB"], "a test")
    np.testing.assert_array_equal(read_table(tmp_path / "a.npz").filters, filters)


def test_camera_files_by_tomllib(tmp_path):
    state = State(camera="phone", changes={"optics.f_number": 4.5})
    (tmp_path / "a.toml").write_text(state.toml())
    found = tomllib.loads((tmp_path / "a.toml").read_text())
    own = Path(gs.__file__).parent / "data" / "cameras" / "phone.toml"
    wanted = tomllib.loads(own.read_text())
    assert found["optics"]["f_number"] == 4.5
    for section, values in wanted.items():
        for key, value in values.items():
            if (section, key) != ("optics", "f_number") and not isinstance(value, str):
                assert found[section][key] == value, key
    assert gs.open_camera(tmp_path / "a.toml").optics.f_number == 4.5


def test_frame_archive_by_numpy(frame, tmp_path):
    frame.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as held:
        np.testing.assert_array_equal(held["dn"], frame.raw)
        np.testing.assert_array_equal(held["electrons"], frame.mean)


def test_raw_frame_and_its_noise_by_libraw_and_tifffile(frame, tmp_path):
    """A x + B of the file is the variance that the sensor says, both as shares of white - black."""
    frame.save(tmp_path / "a.dng")
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, frame.raw)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        slope, read = file.pages[0].tags[NOISE_PROFILE].value[:2]
    held = gs.read_noise_profile(tmp_path / "a.dng")
    sensor = frame.camera.sensor
    white = min(
        sensor.white_level,
        round(sensor.dark_level + sensor.gain_dn_per_electron * sensor.saturation),
    )
    electrons = (white - sensor.dark_level) / sensor.gain_dn_per_electron
    assert slope == pytest.approx(1 / electrons, rel=1e-6)
    assert read > 0 and held is not None


def test_samples_by_tarfile(tmp_path):
    array = RANDOM.random((3, 4), np.float32)
    write_shard(tmp_path / "a.tar", [("000", {"raw.npy": npy(array)})])
    with tarfile.open(tmp_path / "a.tar") as file:
        assert file.getnames() == ["000.raw.npy"]
        found = np.load(io.BytesIO(file.extractfile("000.raw.npy").read()))
        np.testing.assert_array_equal(found, array)


def test_arrays_of_frames_are_planes_again(frame, tmp_path):
    """Three channels by other wavelengths: the numbers that NumPy reads are the scene's."""
    frame.save(tmp_path / "a.npy")
    held = np.maximum(np.load(tmp_path / "a.npy"), 0)
    scene = gs.open_scene(tmp_path / "a.npy", wavelengths=[450, 550, 650], kind="radiance")
    photons = np.moveaxis(held, -1, 0) * np.array([450, 550, 650])[:, None, None] * 1e-9 / (h * c)
    np.testing.assert_allclose(scene.content.values, photons, rtol=4 * ULP)


def test_a_jpeg_is_a_photograph_again(frame, tmp_path):
    """Both decode by libjpeg, so the codes agree; the display's curve is of IEC 61966-2-1."""
    frame.save(tmp_path / "a.jpg")
    with Image.open(tmp_path / "a.jpg") as image:
        codes = np.asarray(image) / 255
    light = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    found = np.moveaxis(gs.open_scene(tmp_path / "a.jpg").content.on_host().coefficients, 0, -1)
    np.testing.assert_allclose(found, light, rtol=1e-4, atol=1e-4)  # ICC curves have 1/65536


def test_the_table_has_every_kind():
    text = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    table = text[text.index("### Judged by other programs") :]
    kinds = " ".join(line.split("|")[1] for line in table.splitlines() if line.startswith("| `"))
    named = set(re.findall(r"`([^`]*)`", kinds))
    scenes = {".npz", ".exr", ".hdr", *TIFF}
    others = {"lens.npz", ".toml", ".mp4", ".mkv", ".tar"}
    assert named >= {*FORMATS, *scenes, *others} - {".jpeg", ".tiff"}
