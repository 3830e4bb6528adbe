"""Folders of band pictures, as the data base CAVE and instruments have them."""

import numpy as np
import pytest
import tifffile
from PIL import Image
from refusals import refused

import gpusim as gs
from gpusim.apps.video.scenes import numbered_files
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.io.scene.readers import scene_files

RANDOM = np.random.default_rng(4)
CODES = RANDOM.integers(0, 65536, (31, 7, 9)).astype(np.uint16)
NM = np.arange(400, 701, 10.0)
SINGLE = 2.0**-24


def fill(folder, name, numbers, codes=CODES):
    folder.mkdir(parents=True, exist_ok=True)
    for number, plane in zip(numbers, codes, strict=False):
        path = folder / name.format(number)
        if path.suffix == ".png":
            Image.fromarray(plane).save(path)
        else:
            tifffile.imwrite(path, plane)
    return folder


def check(scene, nm=NM, wanted=CODES / 65535, roundings=2):
    np.testing.assert_array_equal(scene.wavelengths, nm)
    np.testing.assert_allclose(
        scene.content.values, wanted, rtol=roundings * SINGLE
    )  # code and quotient


@pytest.mark.parametrize("inside", ["", "balloons_ms"])
def test_the_data_base_cave(tmp_path, inside):
    folder = fill(tmp_path / "balloons_ms" / inside, "balloons_ms_{:02d}.png", range(1, 32))
    Image.fromarray(np.zeros((7, 9, 3), np.uint8)).save(folder / "balloons_RGB.bmp")
    (folder / "Thumbs.db").write_bytes(b"x")
    scene = gs.open_scene(tmp_path / "balloons_ms")
    check(scene)
    assert "files that are no bands: Thumbs.db, balloons_RGB.bmp" in scene.notes
    assert "wavelengths from the data base CAVE: 31 of 400 .. 700 nm" in scene.notes
    check(gs.open_scene(tmp_path / "balloons_ms", wavelengths=NM + 5), NM + 5)


def test_bands_in_colours_that_are_equal(tmp_path):
    """One scene of CAVE has RGBA pictures of 8 bits."""
    grey = (CODES[:3] >> 8).astype(np.uint8)
    rgba = np.stack([grey, grey, grey, np.full_like(grey, 255)], -1)
    folder = fill(tmp_path / "a", "a_{}nm.png", (400, 500, 600), rgba)
    check(gs.open_scene(folder), [400, 500, 600], grey / 255)
    rgba[1, 2, 3, 0] ^= 1
    with refused("a_500nm.png", "in colour", error=BadFile):
        gs.open_scene(fill(folder, "a_{}nm.png", (400, 500, 600), rgba))
    rgba[..., -1] = 7
    with refused("a_400nm.png", "transparent", error=BadFile):
        gs.open_scene(fill(folder, "a_{}nm.png", (400, 500, 600), rgba))


@pytest.mark.parametrize(
    "name, factor",
    [
        ("scene_{:g}nm.png", 1),
        ("band_{:g}.tif", 1),
        ("{:g}.tiff", 1),
        ("scene01_{:g} nm_v2.png", 1),
        ("B3-{:.4f}um.tif", 1e-3),
        ("{:g}NM.PNG", 1),
        ("wl{:.1f}_5ms.tif", 1),
    ],
)
def test_wavelengths_in_names(tmp_path, name, factor):
    nm = np.array([1000.0, 450, 520, 997.5, 2500])
    folder = fill(tmp_path / "scene", name.replace(".PNG", ".png"), nm * factor)
    scene = gs.open_scene(folder)
    order = np.argsort(nm)
    check(scene, nm[order], CODES[:5][order] / 65535)
    assert scene.name == "scene"
    assert "wavelengths from the names of the files: 5 of 450 .. 2500 nm" in scene.notes


def test_numbers_that_are_no_wavelengths(tmp_path):
    for name, numbers in (("b_{}.png", (2, 10, 1)), ("f_{:05d}.png", (400, 401, 399))):
        folder = fill(tmp_path / name[0], name, numbers)
        with refused("3 bands", "without wavelengths", error=BadFile):
            gs.open_scene(folder)
        order = np.argsort(numbers)
        check(gs.open_scene(folder, wavelengths=NM[:3]), NM[:3], CODES[:3][order] / 65535)
        with refused("wavelengths", "3, one for each", error=OutOfRange):
            gs.open_scene(folder, wavelengths=NM)


def test_scales_and_kinds(tmp_path):
    folder = fill(tmp_path / "a", "{}nm.tif", NM)
    check(gs.open_scene(folder, scale=10000), NM, CODES / 1e4)
    scene = gs.open_scene(folder, kind="radiance", scale=10000)
    photons = CODES / 1e4 * NM[:, None, None] * 1e-9 / (6.62607015e-34 * 299792458.0)
    check(scene, NM, photons, 4)  # also an energy, and a product
    floats = CODES.astype(np.float32) / 65536
    check(gs.open_scene(fill(tmp_path / "b", "{}nm.tif", NM, floats)), NM, floats)


def test_folders_that_are_no_bands(tmp_path):
    (tmp_path / "empty").mkdir()
    with refused("no bands", error=BadFile):
        gs.open_scene(tmp_path / "empty")
    two = fill(tmp_path / "two", "a_{}nm.png", NM)
    with refused("2 scenes: a_#nm, b_#nm", error=BadFile):
        gs.open_scene(fill(two, "b_{}nm.png", NM))
    sizes = fill(tmp_path / "sizes", "a_{}nm.png", NM[:4])
    Image.fromarray(CODES[0, :5]).save(sizes / "a_500nm.png")
    with refused("a_500nm.png", "9 x 5", "9 x 7", error=BadFile):
        gs.open_scene(sizes)
    with refused("bands", error=OutOfRange):
        gs.open_scene(two, bands={"R": 600})


def test_folders_of_scenes_stay_what_they_were(tmp_path):
    """A video or pairs of a folder take a scene from each file."""
    folder = fill(tmp_path / "a", "a_ms_{:02d}.png", range(1, 32))
    assert len(numbered_files(folder)) == len(scene_files(folder)) == 31


def test_command_line(tmp_path, capsys):
    folder = fill(tmp_path / "a", "b_{}.png", (1, 2, 3))
    asked = ["plan", str(folder), "--camera", "phone", "--device", "numpy"]
    assert main(asked) == 2 and "--wavelengths" in capsys.readouterr().err
    assert main([*asked, "--wavelengths", "450,550,650"]) == 0
