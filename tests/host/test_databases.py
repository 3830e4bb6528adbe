"""Readers of public data bases of cameras and lenses, on small files of made-up entries."""

import json
import os

import numpy as np
import pytest
from named_databases import (
    CAMCONST,
    LENSFUN,
    MATRICES,
    NOISE,
    TUNING,
    profile_bytes,
    write_databases,
)

from gpusim.domain.errors import BadData, BadFile, GpusimError, OutOfRange, UnknownName
from gpusim.io.databases.camconst import read_camconst
from gpusim.io.databases.catalogue import find_cameras, find_lenses, open_catalogue
from gpusim.io.databases.dcp import read_profile
from gpusim.io.databases.lens_models import (
    Calibration,
    distortion_of,
    interpolate,
    interpolate_vignetting,
)
from gpusim.io.databases.lensfun import read_lensfun
from gpusim.io.databases.libcamera import read_tuning
from gpusim.io.databases.noise_profiles import read_noise_profiles
from gpusim.io.databases.places import VARIABLE, find_places, require
from gpusim.io.databases.words import key_of, nearest, search


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_databases(tmp_path_factory.mktemp("databases"))


def test_every_kind_is_found(folder, monkeypatch):
    places = find_places(folder)
    assert set(places) == {"lensfun", "darktable", "camconst", "dcp", "libcamera"}
    assert all("sha256" in place.label for place in places.values())
    monkeypatch.setenv(VARIABLE, f"{folder / 'darktable'}{os.pathsep}{folder / 'lensfun'}")
    assert find_places()["darktable"].files == (folder / "darktable/noiseprofiles.json",)
    assert find_places([folder])["lensfun"].files == (folder / "lensfun/acme.xml",)
    with pytest.raises(BadFile, match="no such folder"):
        find_places(folder / "none")
    with pytest.raises(BadData, match="wanted a folder"):
        find_places(3)
    with pytest.raises(GpusimError, match="install libcamera-ipa"):
        require({}, "libcamera")
    with pytest.raises(UnknownName):
        require({}, "libcam")


def test_cameras_of_all_data_bases_are_one(folder):
    catalogue = open_catalogue(folder)
    names = [one.name for one in catalogue.cameras]
    assert names == [
        *("Acme Compact 5", "Acme Z1", "Acme Z1 Kit", "Acme Z10"),
        *("Raspberry imx296_mono", "Raspberry imx477"),
    ]
    camera = catalogue.camera("acme z1")
    assert camera.body.crop == 1.5 and camera.noise.settings[0].iso == 100
    assert camera.constants.size == (600, 400) and camera.profile.name == "Acme Z1.dcp"
    assert catalogue.camera("alpha one") is camera and catalogue.camera("Z1") is camera
    assert [one.name for one in find_cameras("z1", databases=folder)] == ["Acme Z1", "Acme Z1 Kit"]
    assert find_cameras("z3", databases=folder) == []
    with pytest.raises(BadData, match=r"near names: .*Acme Z1"):
        catalogue.camera("Akme Z1")
    with pytest.raises(BadData, match="several cameras have the words 'acme': Acme"):
        catalogue.camera("acme")


def test_lenses_fit_their_mount(folder):
    found = [one.name for one in find_lenses("", "Acme Z10", databases=folder)]
    assert found[0] == "Other Prime 40mm f/2" and len(found) == 3  # others are of a smaller frame
    assert [one.name for one in find_lenses("40mm f/2", "Acme Z1", databases=folder)] == found[:1]
    assert find_lenses("2-60 f2", databases=folder) == []
    with pytest.raises(BadData, match=r"no lens for Acme Z1 .*near names: .*Acme Zoom"):
        open_catalogue(folder).lens("Akme Zom 20-60", open_catalogue(folder).camera("Acme Z1"))


def test_words_and_whole_numbers():
    def one(name):
        return (name,)

    names = ["Nikon D750", "Nikon D7500", "Nikon D75 Kit", "Canon EOS 75"]
    assert search("d750", names, one) == ["Nikon D750"]
    assert search("nik 750", names, one) == ["Nikon D750"]
    assert nearest("Nikn D750", names)[0] == "Nikon D750"
    assert key_of("NIKON CORPORATION", "NIKON D750") == key_of("Nikon", "D750") == "nikond750"
    assert key_of("Acme Imaging Company, Ltd.", "Z-1") == key_of("", "Acme Z 1")


def test_a_calibration_between_two_is_a_cubic_of_terms_times_focal():
    """Terms that are a quadratic of the focal length over it: centred slopes are exact inside, 4 even steps."""
    focals = np.array([20.0, 30.0, 40.0, 50.0])
    own = [Calibration("poly3", (float((1 + 0.1 * f + 0.02 * f**2) / f),), f) for f in focals]
    assert interpolate(own, 35.0).terms[0] == pytest.approx((1 + 3.5 + 0.02 * 35**2) / 35)
    assert interpolate(own, 30.0) is own[1]
    assert interpolate(own[::-1], 90.0).terms == own[3].terms
    assert interpolate(own, 1.0).terms == own[0].terms
    linear = [Calibration("linear", (1 + f / 1e4, 1 - f / 1e4), f) for f in focals]
    assert interpolate(linear, 27.0, 2).terms == pytest.approx((1.0027, 0.9973))


def test_vignetting_is_that_of_near_calibrations():
    own = [
        Calibration("pa", (-0.5, 0.0, 0.0), 20.0, 2.8, 1000.0),
        Calibration("pa", (-0.1, 0.0, 0.0), 20.0, 8.0, 1000.0),
    ]
    assert interpolate_vignetting(own, 20.0, 2.8, 1000.0, 40.0).terms == own[0].terms
    # as far from both: f-number with 4 / N halfway
    middle = 2 / (1 / 2.8 + 1 / 8)
    assert interpolate_vignetting(own, 20.0, middle, 1000.0, 40.0).terms[0] == pytest.approx(-0.3)
    assert interpolate_vignetting(own, 20.0, 1.0, 1000.0, 40.0) is None
    assert interpolate_vignetting([], 20.0, 1.0, 1000.0, 40.0) is None


@pytest.mark.parametrize(
    "model, terms",
    [("poly3", (0.05,)), ("poly5", (0.1, -0.02)), ("ptlens", (0.01, -0.02, 0.03))],
)
def test_scale_of_distortion(model, terms):
    at_one = distortion_of(Calibration(model, terms, 50.0))(np.array([1.0]))[0]
    assert at_one == pytest.approx(1 + sum(terms) if model == "poly5" else 1.0)


def test_noise_profiles(folder):
    (camera,) = read_noise_profiles(folder / "darktable/noiseprofiles.json")
    assert camera.skipped == 1 and [one.iso for one in camera.settings] == [100, 400]
    assert camera.at(100, "R") == (2e-5, 2e-8, True)
    a, b, is_entry = camera.at(250, "G")
    assert (a, is_entry) == (pytest.approx(2.5e-5), False) and b == pytest.approx(0.0, abs=1e-20)
    with pytest.raises(OutOfRange, match=r"100 \.\. 400"):
        camera.at(800)
    with pytest.raises(UnknownName):
        camera.at(100, "W")


def test_levels_by_iso(folder):
    (one,) = read_camconst(folder / "rawtherapee/camconst.json")
    assert one.is_absolute and one.black_at(800) == 66047 - 65535
    assert one.white_at(100) == pytest.approx((16000 + 15800 + 16000) / 3)
    assert one.white_at(3200) == 15000 and one.matrix[0, 0] == 0.902


@pytest.mark.parametrize("order", "<>")
def test_profiles_of_both_byte_orders(tmp_path, order):
    path = tmp_path / "one.dcp"
    path.write_bytes(profile_bytes("Some Camera", order))
    profile = read_profile(path)
    assert profile.model == "Some Camera" and [light for light, _ in profile.matrices] == [
        "A",
        "D65",
    ]
    for (_, matrix), wanted in zip(profile.matrices, MATRICES.values(), strict=True):
        np.testing.assert_allclose(matrix, wanted, atol=1e-12)


def test_tuning_of_libcamera(folder):
    tuning = read_tuning(folder / "libcamera/imx477.json")
    a, b = tuning.slopes()
    assert (a, b) == (pytest.approx(2.8**2 / (65535 - 4096)), 0.0)
    matrix, kelvin = tuning.nearest(6500)
    assert kelvin == 6000
    # white in D65: red and blue over green as the file says at 6000 K
    white = matrix @ np.array([0.9504, 1.0, 1.0888])
    red, blue = (
        np.interp(6000, [2500, 6500], [0.6, 0.31]),
        np.interp(6000, [2500, 6500], [0.3, 0.71]),
    )
    np.testing.assert_allclose(white / white[1], [red, 1, blue], rtol=2e-3)
    assert tuning.shading.shape == (12, 16) and tuning.shading.max() == 1
    assert read_tuning(folder / "libcamera/imx296_mono.json").is_mono


READERS = {
    "acme.xml": (LENSFUN.encode(), lambda path: read_lensfun([path])),
    "noiseprofiles.json": (json.dumps(NOISE).encode(), read_noise_profiles),
    "camconst.json": (CAMCONST.encode(), read_camconst),
    "one.dcp": (profile_bytes(), read_profile),
    "imx477.json": (json.dumps(TUNING).encode(), read_tuning),
}


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_refused_in_one_line(name, tmp_path):
    """Cut, with bytes changed, with values of other kinds: an error names the file, or it still reads."""
    whole, read = READERS[name]
    random, path = np.random.default_rng(5), tmp_path / name
    path.write_bytes(whole)
    read(path)
    refusals = 0
    for number in range(120):
        data = bytearray(whole)
        if number % 3 == 0:
            data = data[: random.integers(0, len(data))]
        elif number % 3 == 1:
            for at in random.integers(0, len(data), 3):
                data[at] = random.integers(0, 256)
        else:
            at, length = random.integers(0, len(data)), random.integers(1, 30)
            data[at : at + length] = random.choice([b"null", b'"x"', b"-1e999", b"{}", b"[]"])
        path.write_bytes(bytes(data))
        try:
            read(path)
        except BadFile as error:
            refusals += 1
            assert str(path.name) in str(error) and "\n" not in str(error)
    assert refusals > 40
    path.unlink()
    with pytest.raises(BadFile, match="no such file"):
        read(path)


@pytest.mark.parametrize(
    "change, words",
    [
        (("1.5</cropfactor>", "-1</cropfactor>"), "cropfactor"),
        (('model="poly3"', 'model="poly9"'), "poly9"),
        (('a="0.01"', 'a="nan"'), "wanted a number"),
        (("4:3", "0:0"), "aspect-ratio"),
        (("<maker>Other</maker>", ""), "without maker"),
        (('version="1"', 'version="9"'), "version"),
        (("lensdatabase", "lenses"), "its root"),
        (
            ('<lensdatabase version="1">', '<!DOCTYPE x [<!ENTITY a "b">]><lensdatabase>'),
            "entities",
        ),
    ],
)
def test_wrong_values_of_lensfun_are_named(change, words, tmp_path):
    path = tmp_path / "x.xml"
    path.write_text(LENSFUN.replace(*change))
    with pytest.raises(BadFile, match=words):
        read_lensfun([path])
