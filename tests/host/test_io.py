"""Scenes from files and files from pictures: round trips, units, orientation, and every way a file can be wrong."""

import dataclasses
import os
import struct
import warnings
import zlib

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from gpusim.data.charts import chart
from gpusim.data.colorimetry import cmf, xyz
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries, srgb_to_xyz
from gpusim.domain.content import Basis, Cube, Materials
from gpusim.domain.errors import BadData, BadFile, DoesNotFit, OutOfRange, UnknownName
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.spectrum import Spectrum, energy_from_photons
from gpusim.io.atomic import atomic_path, check_output
from gpusim.io.exr import read_exr, write_rgb_exr, write_spectral_exr
from gpusim.io.frame.dng import write_dng
from gpusim.io.frame.images import write_png
from gpusim.io.scene.npz import write_npz
from gpusim.io.scene.scenes import mean_luminance, open_scene, picture

WAVES = np.array([400.0, 500.0, 650.0])
RANDOM = np.random.default_rng(1)


def fails(error, *parts):
    """Expect one line that holds all `parts`."""

    class Check:
        def __enter__(self):
            self.raises = pytest.raises(error)
            self.info = self.raises.__enter__()

        def __exit__(self, *exception):
            done = self.raises.__exit__(*exception)
            text = str(self.info.value)
            assert "\n" not in text and all(str(part) in text for part in parts), text
            return done

    return Check()


def same(one, two):
    """Whether two scenes are bit for bit the same."""
    for field in dataclasses.fields(one.content):
        np.testing.assert_array_equal(
            getattr(one.content, field.name), getattr(two.content, field.name)
        )
        assert getattr(one.content, field.name).dtype == getattr(two.content, field.name).dtype
    np.testing.assert_array_equal(one.illuminant.wavelengths, two.illuminant.wavelengths)
    np.testing.assert_array_equal(one.illuminant.values, two.illuminant.values)
    if one.depth is None or two.depth is None:
        assert one.depth is two.depth
    else:
        np.testing.assert_array_equal(one.depth, two.depth)
    assert type(one.content) is type(two.content)
    assert (one.border, one.margin, one.fov, one.name) == (
        two.border,
        two.margin,
        two.fov,
        two.name,
    )


def white_luminance(scene):
    return xyz(energy_from_photons(scene.illuminant))[1]


# ---- .npz


def scenes():
    light = white_radiance(illuminant("FL2"), 80.0)
    values = RANDOM.random((3, 4, 5), np.float32)
    yield Scene(
        Cube(WAVES, values),
        light,
        "zero",
        fov=0.3,
        depth=1 + RANDOM.random((4, 5), np.float32),
        name="cube",
    )
    yield Scene(Cube(WAVES, values), unit_light(WAVES), "reflect", name="radiance")
    yield Scene(Basis(WAVES, values - 0.1, np.eye(3)), light, "scene", margin=1, name="basis")
    ids = RANDOM.integers(0, 300, (4, 5)).astype(np.uint16)
    ids[0, 0] = 299
    yield Scene(
        Materials(WAVES, ids, values[0], RANDOM.random((300, 3))), light, name="many materials"
    )
    yield chart("colorchecker", size=(48, 32))


@pytest.mark.parametrize("scene", list(scenes()), ids=lambda scene: scene.name)
def test_npz_gives_back_what_was_written(tmp_path, scene):
    write_npz(tmp_path / "a.npz", scene)
    same(open_scene(tmp_path / "a.npz"), scene)


def test_npz_axes_follow_the_key_not_the_lengths(tmp_path):
    values = RANDOM.random((3, 3, 3), np.float32)  # every order would fit
    np.savez(tmp_path / "own.npz", cube=values, wavelengths_nm=WAVES)
    np.savez(tmp_path / "iset.npz", photons=values, wave=WAVES)
    np.savez(tmp_path / "coef.npz", coef=values, wave=WAVES, basis=np.eye(3))
    np.savez(tmp_path / "coefficients.npz", coefficients=values, wave=WAVES, basis=np.eye(3))
    np.testing.assert_array_equal(open_scene(tmp_path / "own.npz").content.values, values)
    np.testing.assert_array_equal(
        open_scene(tmp_path / "iset.npz").content.values, values.transpose(2, 0, 1)
    )
    np.testing.assert_array_equal(
        open_scene(tmp_path / "coef.npz").content.coefficients, values.transpose(2, 0, 1)
    )
    np.testing.assert_array_equal(
        open_scene(tmp_path / "coefficients.npz").content.coefficients, values
    )


def test_npz_of_isetcam_is_split_into_reflectance_and_light(tmp_path):
    light = np.array([1e15, 2e15, 4e15])
    reflectance = RANDOM.random((4, 5, 3))
    np.savez(
        tmp_path / "a.npz",
        photons=reflectance * light,
        wave=WAVES,
        illuminant_photons=light,
        fov_deg=90.0,
    )
    scene = open_scene(tmp_path / "a.npz")
    # float32 of the product, of the light and of their ratio: 3 times 2^-24.
    np.testing.assert_allclose(
        scene.content.values, reflectance.transpose(2, 0, 1), rtol=3 * 2.0**-24
    )
    np.testing.assert_array_equal(scene.illuminant.values, light)
    assert scene.fov == pytest.approx(np.pi / 2, rel=1e-15) and scene.light_is_known
    # A band without light has no reflectance: the radiance is kept.
    np.savez(
        tmp_path / "b.npz",
        photons=reflectance * light,
        wave=WAVES,
        illuminant_photons=light * [1, 0, 1],
    )
    scene = open_scene(tmp_path / "b.npz")
    assert not scene.light_is_known
    np.testing.assert_array_equal(
        scene.content.values[2], (reflectance * light)[..., 2].astype(np.float32)
    )


@pytest.mark.parametrize(
    "name, form",
    [
        ("scene_eagle_rgb2spectral_basis3", Basis),
        ("scene_hats_rgb2spectral_basis3", Basis),
        ("scene_reflectance_chart_full31", Cube),
    ],
)
def test_npz_measured_isetcam_scenes(shared_data, name, form):
    path = shared_data / "isetcam" / f"{name}.npz"
    scene = open_scene(path)
    stored = np.load(path)
    assert isinstance(scene.content, form) and scene.light_is_known
    assert scene.fov == pytest.approx(np.deg2rad(stored["fov_deg"]), rel=1e-15)
    # ISETCam scaled them to 100 cd m-2, summing over 400, 410 .. 700 nm; the integral differs by 1.2e-3 at most.
    assert mean_luminance(scene) == pytest.approx(100, rel=2e-3)
    photons = stored["coef"] @ stored["basis"] if form is Basis else stored["photons"]
    spot = photons[17, 40]
    content = scene.content
    ours = (
        content.coefficients[:, 17, 40] @ content.basis
        if form is Basis
        else content.values[:, 17, 40]
    )
    # Products and ratios of float32 values.
    np.testing.assert_allclose(ours * scene.illuminant.at(scene.wavelengths), spot, rtol=1e-6)


def test_npz_measured_cubes(shared_data):
    lego = open_scene(shared_data / "cubes" / "lego_duke_24.npz", luminance=100)
    assert lego.shape == (256, 256) and len(lego.wavelengths) == 24 and not lego.light_is_known
    assert mean_luminance(lego) == pytest.approx(100, rel=1e-6)  # float32 values scaled once
    jasper = open_scene(
        shared_data / "cubes" / "jasper_aviris_vis.npz", light="D50", luminance=1000
    )
    assert jasper.shape == (100, 100) and jasper.light_is_known
    assert white_luminance(jasper) == pytest.approx(1000, rel=1e-13)
    stored = np.load(shared_data / "cubes" / "jasper_aviris_vis.npz")["cube"]
    np.testing.assert_array_equal(jasper.content.values, stored.astype(np.float32))


GOOD = {"cube": np.ones((3, 4, 5), np.float32), "wavelengths_nm": WAVES}
GOOD_MATERIALS = {
    "ids": np.zeros((4, 5), np.uint8),
    "shading": np.ones((4, 5)),
    "spectra": np.ones((1, 3)),
    "wavelengths_nm": WAVES,
}


def spoiled(value):
    cube = np.ones((3, 4, 5), np.float32)
    cube[1, 2, 3] = value
    return cube


@pytest.mark.parametrize(
    "changes, key, problem",
    [
        ({"cube": spoiled(np.nan)}, "cube", "NaN"),
        ({"cube": spoiled(np.inf)}, "cube", "infinite"),
        ({"cube": spoiled(-0.5)}, "cube", "negative values (lowest -0.5)"),
        ({"cube": spoiled(1) + 0j}, "cube", "complex64"),
        ({"cube": np.full((3, 4, 5), "x")}, "cube", "<U1"),
        ({"cube": np.ones((3, 4))}, "cube", "shape (3, 4), wanted (3, any, any)"),
        ({"cube": np.ones((4, 5, 3))}, "cube", "shape (4, 5, 3), wanted (3, any, any)"),
        ({"cube": np.ones((3, 0, 5))}, "cube", "shape (3, 0, 5)"),
        ({"cube": np.float32(1)}, "cube", "shape ()"),
        ({"cube": None}, "cube", "needs exactly one of the keys"),
        ({"photons": np.ones((4, 5, 3))}, "photons", "needs exactly one of the keys"),
        ({"wavelengths_nm": None}, "wavelengths_nm", "is missing"),
        ({"wavelengths_nm": WAVES[::-1]}, "wavelengths_nm", "increase strictly"),
        ({"wavelengths_nm": np.array([400, 500, 500])}, "wavelengths_nm", "increase strictly"),
        ({"wavelengths_nm": np.array([400, np.nan, 500])}, "wavelengths_nm", "NaN"),
        ({"wavelengths_nm": np.array([-400, 0, 500])}, "wavelengths_nm", "negative"),
        ({"wavelengths_nm": WAVES[:2]}, "cube", "shape (3, 4, 5), wanted (2, any, any)"),
        ({"kind": "reflection"}, "kind", 'wanted "radiance" or "reflectance"'),
        ({"illuminant": np.ones(3)}, "illuminant_wavelengths_nm", "is missing"),
        (
            {"illuminant": np.ones(3), "illuminant_wavelengths_nm": WAVES[:2]},
            "illuminant",
            "wanted (2)",
        ),
        (
            {"illuminant": np.ones(3), "illuminant_wavelengths_nm": WAVES[::-1]},
            "illuminant",
            "increase strictly",
        ),
        ({"illuminant_photons": -np.ones(3)}, "illuminant_photons", "negative"),
        ({"border": "mirror"}, "border", "mirror"),
        ({"margin": 1}, "margin", "border"),
        ({"margin": 9, "border": "scene"}, "margin", "nothing left"),
        ({"fov_rad": 4.0}, "fov", "fov < pi"),
        ({"depth_m": np.ones((4, 4))}, "depth", "(4, 4)"),
        ({"depth_m": np.zeros((4, 5))}, "depth", "positive"),
    ],
)
def test_npz_refusals(tmp_path, changes, key, problem):
    path = tmp_path / "bad.npz"
    np.savez(path, **{name: value for name, value in (GOOD | changes).items() if value is not None})
    with fails(BadFile, path, key, problem):
        open_scene(path)


@pytest.mark.parametrize(
    "changes, key, problem",
    [
        ({"ids": np.ones((4, 5), np.uint8)}, "material id", "0 .. 0"),
        ({"ids": -np.ones((4, 5), np.int8)}, "ids", "negative"),
        ({"ids": np.zeros((4, 5))}, "ids", "float64"),
        ({"ids": np.full((4, 5), 70000)}, "ids", "65535"),
        ({"shading": np.ones((5, 4))}, "shading", "wanted (4, 5)"),
        ({"shading": -np.ones((4, 5))}, "shading", "negative"),
        ({"spectra": np.ones((1, 4))}, "spectra", "wanted (any, 3)"),
        ({"spectra": -np.ones((1, 3))}, "spectra", "negative"),
        ({"shading": None}, "shading", "is missing"),
    ],
)
def test_npz_refusals_of_materials(tmp_path, changes, key, problem):
    path = tmp_path / "bad.npz"
    np.savez(
        path,
        **{name: value for name, value in (GOOD_MATERIALS | changes).items() if value is not None},
    )
    with fails(BadFile, path, key, problem):
        open_scene(path)


def test_npz_truncated_or_something_else(tmp_path):
    path = tmp_path / "a.npz"
    write_npz(path, chart("flat", size=(64, 48)))
    whole = path.read_bytes()
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with fails(BadFile, path, "truncated"):
            open_scene(path)
    damaged = bytearray(whole)
    damaged[200:260] = bytes(60)
    path.write_bytes(damaged)
    with fails(BadFile, path):
        open_scene(path)
    with open(path, "wb") as file:
        np.save(file, np.ones(3))
    with fails(BadFile, path, "not an .npz archive"):
        open_scene(path)
    np.savez(
        path, cube=np.array([{}], object), wavelengths_nm=WAVES
    )  # would run code when unpickled
    with fails(BadFile, path, "not an .npz archive of plain arrays"):
        open_scene(path)


# ---- names, light and luminance


@pytest.mark.parametrize("suffix", [".npz", ".exr", ".png", ".jpg"])
def test_missing_file(tmp_path, suffix):
    with fails(BadFile, tmp_path / f"none{suffix}", "no such file"):
        open_scene(tmp_path / f"none{suffix}")


@pytest.mark.parametrize("name", ["colourchequer", "scene.bmp", "", "flat.txt"])
def test_unknown_scene(name):
    with fails(UnknownName, f"unknown scene {name!r}"):
        open_scene(name)


def test_unknown_scene_lists_charts_and_suffixes_or_the_nearest():
    with fails(UnknownName, "did you mean 'colorchecker'"):
        open_scene("colourchecker")
    with fails(UnknownName, "slanted-edge", "deadleaves", ".exr", ".npz", ".png"):
        open_scene("qqqq")


def test_charts_by_name():
    scene = open_scene("flat", size=(8, 6), light="A", luminance=50, border="zero", fov=0.5)
    assert scene.shape == (6, 8) and (scene.border, scene.fov) == ("zero", 0.5)
    assert white_luminance(scene) == pytest.approx(50, rel=1e-13)
    assert white_luminance(open_scene("flat")) == pytest.approx(100, rel=1e-13)  # rounding
    assert open_scene("points").border == "zero"


def test_arguments_that_do_not_apply(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **GOOD)
    with fails(OutOfRange, "size", "for charts, .hdr, .csv only"):
        open_scene(path, size=(4, 4))
    with fails(OutOfRange, "bands", ".exr"):
        open_scene(path, bands={"a": 500})
    with fails(BadFile, path, "light 'A'", "whose light is unknown"):
        open_scene(path, light="A")
    with fails(UnknownName, "border", "edge"):
        open_scene(path, border="edges")
    with fails(OutOfRange, "luminance"):
        open_scene(path, luminance=-1)
    with fails(OutOfRange, "luminance"):
        open_scene("flat", luminance=0)
    with fails(UnknownName, "light", "D65"):
        open_scene(path, light="D66")


def test_light_and_luminance_of_files(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **GOOD, kind="reflectance")
    scene = open_scene(path)
    np.testing.assert_array_equal(
        scene.illuminant.values, white_radiance(illuminant("D65"), 100.0).values
    )
    write_npz(path, dataclasses.replace(scene, illuminant=white_radiance(illuminant("A"), 30.0)))
    assert white_luminance(open_scene(path)) == pytest.approx(30, rel=1e-13)
    assert white_luminance(open_scene(path, luminance=60)) == pytest.approx(60, rel=1e-13)
    relit = open_scene(path, light="E")  # another light, as bright
    np.testing.assert_allclose(
        relit.illuminant.values, white_radiance(illuminant("E"), 30.0).values, rtol=1e-13
    )
    np.savez(path, **GOOD)  # radiance alone
    scene = open_scene(path, luminance=7.0)
    assert (
        mean_luminance(scene) == pytest.approx(7, rel=1e-6) and not scene.light_is_known
    )  # float32 samples
    np.savez(path, **(GOOD | {"cube": np.zeros((3, 4, 5))}))
    with fails(BadFile, path, "cannot be scaled"):
        open_scene(path, luminance=7.0)


@pytest.mark.parametrize("scene", list(scenes()), ids=lambda scene: scene.name)
def test_mean_luminance_of_all_forms(scene):
    content = scene.content
    if isinstance(content, Cube):
        radiance = content.values.astype(float)
    elif isinstance(content, Basis):
        radiance = np.einsum("kl,kyx->lyx", content.basis, content.coefficients.astype(float))
    else:
        radiance = np.moveaxis(
            content.spectra[content.ids] * content.shading[..., None].astype(float), -1, 0
        )
    # A frame integrates the spline through the samples, from the first to the last, in the light.
    nodes = content.wavelengths
    fine = np.unique(np.concatenate([np.arange(nodes[0], nodes[-1] + 0.01, 0.02), nodes]))
    ends = "not-a-knot" if len(nodes) > 3 else "natural"
    between = CubicSpline(nodes, radiance.mean(axis=(1, 2)), bc_type=ends)(fine)
    eye = 683 * np.interp(fine, *(cmf().wavelengths, cmf().values[1]))
    joule = 6.62607015e-34 * 299792458 / (fine * 1e-9)
    wanted = np.trapezoid(between * scene.illuminant.at(fine) * eye * joule, fine)
    # Trapezoids of 0.02 and 0.1 nm, and energy that is linear within the observer's 1 nm: each errs
    # by less than (step / 50 nm)^2 / 12, for nothing here bends within 50 nm.
    assert mean_luminance(scene) == pytest.approx(wanted, rel=1e-4)


# ---- spectral .exr


def write_channels(path, channels, **header):
    import OpenEXR

    OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, channels
    ).write(str(path))


def plane(value=1.0, dtype=np.float32, shape=(4, 5)):
    return np.full(shape, value, dtype)


def test_exr_radiance_becomes_photons(tmp_path):
    path = tmp_path / "a.exr"
    write_channels(path, {"S0.500,000000nm": plane(2.0), "S0.1000,000000nm": plane(1.0)})
    scene = open_scene(path)
    # h c = 1.98644586e-25 J m (CODATA 2018, nine digits); float32.
    np.testing.assert_allclose(
        scene.content.values[:, 0, 0],
        [2 * 500e-9 / 1.98644586e-25, 1000e-9 / 1.98644586e-25],
        rtol=1e-7,
    )
    assert not scene.light_is_known and scene.name == "a" and scene.shape == (4, 5)


def test_exr_channels_are_sorted_by_number_and_read_in_every_spelling(tmp_path):
    path = tmp_path / "a.exr"
    names = [
        "T.1000nm",
        "T.400,5nm",
        "T.4.8E2nm",
        "T.95,nm",
    ]  # by name 1000 is first, by number last
    write_channels(
        path,
        {
            name: plane(value, dtype)
            for name, value, dtype in zip(
                names, (0.75, 0.25, 0.5, 0.125), (np.float16, np.float32) * 2, strict=True
            )
        }
        | {"R": plane(9), "depth.Z": plane(3)},
    )
    scene = open_scene(path, light="A", luminance=10)
    np.testing.assert_array_equal(scene.wavelengths, [95, 400.5, 480, 1000])
    np.testing.assert_array_equal(scene.content.values[:, 1, 2], [0.125, 0.25, 0.5, 0.75])
    assert scene.content.values.dtype == np.float32
    assert scene.light_is_known and white_luminance(scene) == pytest.approx(10, rel=1e-13)


def test_exr_round_trip(tmp_path):
    values = RANDOM.random((3, 6, 7), np.float32)
    path = tmp_path / "a.exr"
    write_spectral_exr(path, WAVES, values, reflectance=True)
    held = read_exr(path)
    assert held.kind == "reflectance" and held.notes == () and held.depth is None
    np.testing.assert_array_equal(held.wavelengths, WAVES)
    np.testing.assert_array_equal(held.values, values)
    write_spectral_exr(path, WAVES, values * np.float32(1e16))
    held = read_exr(path)
    assert held.kind == "radiance"
    # To W and back, each rounded to float32, and a float32 product: 3 times 2^-24.
    np.testing.assert_allclose(held.values, values * np.float32(1e16), rtol=3 * 2.0**-24)
    write_spectral_exr(path, WAVES, values, reflectance=True, half=True)
    np.testing.assert_array_equal(
        read_exr(path).values, values.astype(np.float16).astype(np.float32)
    )


def test_exr_names_and_attributes_are_those_of_the_layout(tmp_path):
    import OpenEXR

    write_spectral_exr(tmp_path / "a.exr", WAVES, np.ones((3, 2, 2)))
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    assert set(file.channels()) == {"S0.400,000000nm", "S0.500,000000nm", "S0.650,000000nm"}
    assert file.header()["spectralLayoutVersion"] == "1.0"
    assert file.header()["emissiveUnits"] == "W.m^-2.sr^-1.nm^-1"


def test_exr_bands_are_named_by_the_user(tmp_path):
    path = tmp_path / "a.exr"
    write_channels(path, {"long": plane(1), "short": plane(2), "R": plane(5)})
    scene = open_scene(path, bands={"long": 700, "short": 400.0})
    np.testing.assert_array_equal(scene.wavelengths, [400, 700])
    assert scene.content.values[0, 0, 0] == pytest.approx(
        2 * 400e-9 / 1.98644586e-25, rel=1e-7
    )  # float32
    with fails(UnknownName, f"channel of {path}", "'lang'", "did you mean 'long'"):
        open_scene(path, bands={"lang": 700, "short": 400})
    with fails(BadFile, path, "'long'", "'short'", "same wavelength"):
        open_scene(path, bands={"long": 700, "short": 700})
    np.testing.assert_array_equal(open_scene(path, bands={"long": 700}).wavelengths, [700])
    with fails(BadFile, path, "positive"):
        open_scene(path, bands={"long": 700, "short": -1})


def test_exr_rgb_is_lifted_and_written(tmp_path):
    path = tmp_path / "a.exr"
    rgb = RANDOM.random((4, 5, 3), np.float32)
    write_rgb_exr(path, rgb)
    scene = open_scene(path)
    np.testing.assert_array_equal(scene.content.coefficients, np.moveaxis(rgb, -1, 0))
    np.testing.assert_array_equal(scene.content.basis, srgb_primaries().values)


@pytest.mark.parametrize(
    "channels, problem",
    [
        ({"U": plane(), "Z": plane()}, "no spectral channels"),
        ({"R": plane(), "G": plane(), "mask": plane()}, "no spectral channels"),
        ({"S0.400nm": plane(), "S0.500THz": plane()}, "'S0.500THz'"),
        ({"T.400nm": plane(), "T.400nm.500nm": plane()}, "'T.400nm.500nm'"),
        ({"S0.400nm": plane(), "S0.400,00nm": plane()}, "same wavelength, 400 nm"),
        ({"S0.400nm": plane(), "T.500nm": plane()}, "both"),
        ({"S0.400nm": plane(), "S0.500nm": plane(np.nan)}, "'S0.500nm': NaN"),
        ({"S0.400nm": plane(), "S0.500nm": plane(np.inf)}, "'S0.500nm': NaN or infinite"),
        ({"S0.400nm": plane(), "S0.500nm": plane(-2)}, "'S0.500nm': negative values (lowest -2)"),
        ({"S0.400nm": plane(), "S0.500nm": plane(1, np.uint32)}, "'S0.500nm': uint32"),
    ],
)
def test_exr_refusals(tmp_path, channels, problem):
    path = tmp_path / "bad.exr"
    write_channels(path, channels)
    with fails(BadFile, path, problem):
        open_scene(path)


def test_exr_truncated_or_something_else(tmp_path):
    path = tmp_path / "a.exr"
    write_spectral_exr(path, WAVES, RANDOM.random((3, 40, 50)), reflectance=True)
    whole = path.read_bytes()
    for length in (0, 3, 50, 300, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:length])
        with fails(BadFile, path, "truncated"):
            open_scene(path)
    path.write_text("no picture")
    with fails(BadFile, path, "not an OpenEXR file"):
        open_scene(path)


def test_exr_that_claims_to_be_huge_is_refused_before_reading(tmp_path):
    path = tmp_path / "a.exr"
    write_spectral_exr(path, WAVES, np.ones((3, 4, 5)), reflectance=True)
    data = bytearray(path.read_bytes())
    start = data.find(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    data[start : start + 16] = struct.pack("<4i", 0, 0, 999_999, 999_999)
    path.write_bytes(data)
    with fails(DoesNotFit, path, "1000000 x 1000000"):
        open_scene(path)


def test_exr_writer_refusals(tmp_path):
    path = tmp_path / "a.exr"
    with fails(BadData, path, "S0.500,000000nm", "NaN"):
        write_spectral_exr(path, WAVES, np.stack([plane(), plane(np.nan), plane()]))
    with fails(BadData, path, "do not match 3 wavelengths"):
        write_spectral_exr(path, WAVES, np.ones((2, 4, 5)))
    with fails(BadData, path, "'G'", "does not fit 16-bit"):
        write_rgb_exr(path, np.stack([plane(), plane(70000), plane()], axis=-1), half=True)
    with fails(BadData, path, "shape (rows, cols, 3)"):
        write_rgb_exr(path, np.ones((3, 4, 5)))
    assert list(tmp_path.iterdir()) == []


# ---- photographs


def png(pixels, depth, colour_type, filters=(0,), interlaced=0):
    """Encode a PNG by the specification (ISO/IEC 15948), one filter after the other, row by row."""
    rows, cols = pixels.shape[:2]
    data = pixels.reshape(rows, -1).astype(">u2" if depth == 16 else np.uint8)
    lines = data.view(np.uint8).reshape(rows, -1).astype(int)
    step = lines.shape[1] // cols
    stream = b""
    before = np.zeros(lines.shape[1], int)
    for row, line in enumerate(lines):
        left = np.concatenate([np.zeros(step, int), line[:-step]])
        corner = np.concatenate([np.zeros(step, int), before[:-step]])
        guess = left + before - corner
        distance = np.abs(np.stack([guess - left, guess - before, guess - corner]))
        paeth = np.choose(distance.argmin(0), [left, before, corner])
        kind = filters[row % len(filters)]
        predicted = [np.zeros_like(line), left, before, (left + before) // 2, paeth][kind]
        stream += bytes([kind]) + ((line - predicted) % 256).astype(np.uint8).tobytes()
        before = line
    parts = [(b"IHDR", struct.pack(">IIBBBBB", cols, rows, depth, colour_type, 0, 0, interlaced))]
    parts += [(b"IDAT", zlib.compress(stream)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


def decoded(values):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about optional packages
        import colour
    return colour.cctf_decoding(values, "sRGB")


def test_photo_is_linear_srgb_on_three_primaries(tmp_path):
    pixels = RANDOM.integers(0, 256, (6, 7, 3), dtype=np.uint8)
    pixels[0, 0] = 255
    write_png(tmp_path / "a.png", pixels)
    scene = open_scene(tmp_path / "a.png")
    # float32 of the standard's formula.
    np.testing.assert_allclose(
        scene.content.coefficients, decoded(pixels / 255).transpose(2, 0, 1), rtol=1e-7
    )
    white = scene.content.coefficients[:, 0, 0] @ scene.content.basis
    np.testing.assert_allclose(
        white, 1, rtol=0, atol=1e-15
    )  # the radiance of white is that of the light
    np.testing.assert_array_equal(
        scene.illuminant.values, white_radiance(illuminant("D65"), 100.0).values
    )


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_picture_is_the_photograph_of_its_codes(tmp_path, kind):
    """Every code by the standard's formula, rounded to float32 once: 2^-24, and the formula's own float64."""
    count = np.iinfo(kind).max + 1
    every = np.stack(
        [np.arange(count), np.arange(count)[::-1], np.roll(np.arange(count), 7)], -1
    ).astype(kind)
    pixels = every.reshape(16, -1, 3)
    (tmp_path / "a.png").write_bytes(png(pixels, 8 * pixels.itemsize, 2))
    photo, scene = open_scene(tmp_path / "a.png"), picture(pixels)
    np.testing.assert_array_equal(scene.content.planes, photo.content.coefficients)
    wanted = decoded(pixels / (count - 1)).transpose(2, 0, 1)
    np.testing.assert_allclose(scene.content.planes, wanted, rtol=2.0**-24 + 1e-14)
    assert scene.content.is_like(picture(pixels[:1]).content)
    np.testing.assert_array_equal(scene.content.basis, photo.content.basis)
    for name in ("values", "wavelengths"):
        np.testing.assert_array_equal(
            getattr(scene.illuminant, name), getattr(photo.illuminant, name)
        )
    relit = open_scene(tmp_path / "a.png", light="A", luminance=20)
    np.testing.assert_array_equal(
        picture(pixels, light="A", luminance=20).illuminant.values, relit.illuminant.values
    )
    write_npz(tmp_path / "a.npz", scene)  # as the basis that it stands for
    np.testing.assert_array_equal(
        open_scene(tmp_path / "a.npz").content.coefficients, photo.content.coefficients
    )


def test_photo_reproduces_its_colours_in_d65(tmp_path):
    from scipy.interpolate import CubicSpline

    pixels = RANDOM.integers(0, 256, (5, 5, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", pixels)
    scene = open_scene(tmp_path / "a.png", luminance=100)
    spectra = np.einsum(
        "kl,kyx->yxl", scene.content.basis, scene.content.coefficients.astype(float)
    ).reshape(25, -1)
    fine = np.arange(360.0, 780.01, 0.1)
    between = CubicSpline(scene.wavelengths, spectra.T)(
        fine
    ).T  # as the simulation interpolates reflectances
    found = xyz(Spectrum(fine, between), energy_from_photons(scene.illuminant)) / 100
    wanted = decoded(pixels / 255).reshape(25, 3) @ srgb_to_xyz().T
    # Coefficients are float32, 6e-8. (White is energy there and photons here, the same integral but for the
    # interpolation of lambda times the light between nodes of 5 nm: 1e-5 of the light's slope.)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6)


@pytest.mark.parametrize("colour_type, channels", [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_png_of_16_bits_keeps_all_of_them(tmp_path, colour_type, channels):
    pixels = RANDOM.integers(0, 65536, (11, 9, channels))
    (tmp_path / "a.png").write_bytes(png(pixels, 16, colour_type, filters=(0, 1, 2, 3, 4)))
    content = open_scene(tmp_path / "a.png").content
    found = content.shading[None] if isinstance(content, Materials) else content.coefficients
    wanted = decoded(pixels[..., : channels - (channels in (2, 4))] / 65535)
    if channels in (2, 4):
        wanted = wanted * pixels[..., -1:] / 65535
    np.testing.assert_allclose(found, np.moveaxis(wanted, -1, 0), rtol=1e-6, atol=1e-9)  # float32


def test_grey_transparent_palette_bilevel_and_rotated(tmp_path):
    from PIL import Image

    path = tmp_path / "a.png"
    grey = RANDOM.integers(0, 256, (4, 6), dtype=np.uint8)
    write_png(path, grey)
    content = open_scene(path).content
    assert isinstance(content, Materials) and (content.spectra == 1).all()
    np.testing.assert_allclose(content.shading, decoded(grey / 255), rtol=1e-7)  # float32
    colour = RANDOM.integers(0, 256, (4, 6, 4), dtype=np.uint8)
    Image.fromarray(colour).save(path)
    wanted = decoded(colour[..., :3] / 255) * colour[..., 3:] / 255
    np.testing.assert_allclose(
        open_scene(path).content.coefficients, wanted.transpose(2, 0, 1), rtol=2e-7
    )
    palette = Image.fromarray(grey).quantize(8)
    palette.save(path)
    wanted = decoded(np.asarray(palette.convert("RGB")) / 255).transpose(2, 0, 1)
    np.testing.assert_allclose(open_scene(path).content.coefficients, wanted, rtol=1e-7)
    Image.fromarray(grey > 127).save(path)
    np.testing.assert_array_equal(open_scene(path).content.shading, grey > 127)
    exif = Image.Exif()
    exif[274] = 6  # turned by 90 degrees
    Image.fromarray(colour[..., :3]).save(path, exif=exif)
    assert open_scene(path).shape == (6, 4)


def test_jpeg(tmp_path):
    from PIL import Image

    pixels = np.full((16, 24, 3), (200, 100, 50), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.jpg", quality=100)
    scene = open_scene(tmp_path / "a.jpg")
    # JPEG's colour transform rounds to 8 bits: 2 levels of 255 in each channel, slope at most 2.4.
    wanted = decoded(pixels[5, 5] / 255)
    np.testing.assert_allclose(
        scene.content.coefficients[:, 5, 5], wanted, rtol=0, atol=2.4 * 2 / 255
    )


def test_photo_refusals(tmp_path):
    from PIL import Image

    path = tmp_path / "a.png"
    for depth in (8, 16):
        whole = png(RANDOM.integers(0, 2**depth, (40, 50, 3)), depth, 2)
        for length in (0, 10, 30, 60, len(whole) // 2):
            path.write_bytes(whole[:length])
            with fails(BadFile, path, "truncated"):
                open_scene(path)
    path.write_text("no picture")
    with fails(BadFile, path, "not a PNG or JPEG"):
        open_scene(path)
    path.write_bytes(png(np.zeros((4, 4, 3), int), 16, 2, interlaced=1))
    with fails(BadFile, path, "interlaced"):
        open_scene(path)
    Image.fromarray(np.zeros((4, 4, 4), np.uint8), mode="CMYK").save(tmp_path / "a.jpg")
    with fails(BadFile, tmp_path / "a.jpg", "CMYK"):
        open_scene(tmp_path / "a.jpg")
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13)
    body = b"IHDR" + struct.pack(">IIBBBBB", 2_000_000, 1_000_000, 8, 2, 0, 0, 0)
    path.write_bytes(
        header
        + body
        + struct.pack(">I", zlib.crc32(body))
        + png(np.zeros((1, 1, 3), int), 8, 2)[33:]
    )
    with pytest.raises(
        (BadFile, DoesNotFit)
    ) as error:  # by Pillow's limit or by this computer's memory
        open_scene(path)
    assert str(path) in str(error.value)


def test_real_photographs(shared_data):
    from PIL import Image

    path = shared_data / "kodak" / "kodim23.png"
    scene = open_scene(path)
    assert scene.shape == (512, 768)
    pixels = np.asarray(Image.open(path)).transpose(2, 0, 1)
    np.testing.assert_allclose(
        scene.content.coefficients, decoded(pixels / 255), rtol=1e-6
    )  # float32


# ---- pictures and raw data out


def test_png_holds_what_was_written(tmp_path):
    from PIL import Image

    for pixels in (
        RANDOM.integers(0, 256, (5, 7, 3), dtype=np.uint8),
        RANDOM.integers(0, 256, (5, 7), dtype=np.uint8),
    ):
        write_png(tmp_path / "a.png", pixels)
        back = np.asarray(Image.open(tmp_path / "a.png"))
        np.testing.assert_array_equal(back, pixels)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 5, 3)),
        np.zeros((3, 4, 5), np.uint8),
        np.zeros((0, 5, 3), np.uint8),
        np.zeros(3, np.uint8),
        np.zeros((4, 5, 3), np.int16),
    ],
)
def test_png_refusals(tmp_path, image):
    with fails(
        BadData, tmp_path / "a.png", "uint8 or uint16 of shape (rows, cols, 3)", str(image.shape)
    ):
        write_png(tmp_path / "a.png", image)
    assert list(tmp_path.iterdir()) == []


MATRIX = np.array([[0.9, -0.3, -0.1], [-0.4, 1.2, 0.2], [-0.05, 0.2, 0.6]])
NEUTRAL = np.array([0.5, 1.0, 0.6])


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("shape", [(22, 22), (63, 65), (64, 97)])
def test_dng_is_read_exactly_by_libraw(tmp_path, pattern, shape):
    import rawpy

    raw = RANDOM.integers(0, 4096, shape).astype(np.uint16)
    write_dng(
        tmp_path / "a.dng",
        raw,
        (pattern[:2], pattern[2:]),
        64,
        4095,
        {"D65": (MATRIX, None)},
        NEUTRAL,
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        np.testing.assert_array_equal(file.raw_image_visible, raw)
        letters = np.array(list(file.color_desc.decode()))[file.raw_pattern]
        assert "".join(letters.ravel()) == pattern
        assert file.black_level_per_channel == [64] * 4 and file.white_level == 4095
        # Rational numbers to 1e-9, LibRaw's own float32.
        np.testing.assert_allclose(file.camera_whitebalance[:3], 1 / NEUTRAL, rtol=1e-6)
        # LibRaw keeps the matrix from camera to sRGB: that of camera from sRGB, rows scaled to white = 1, inverted. Its
        # sRGB has five digits, and white differs by 1e-4.
        camera_from_srgb = MATRIX @ srgb_to_xyz()
        wanted = np.linalg.inv(camera_from_srgb / camera_from_srgb.sum(1, keepdims=True))
        np.testing.assert_allclose(file.color_matrix[:, :3], wanted, rtol=0, atol=1e-3)


@pytest.mark.parametrize("shape", [(22, 22), (63, 65)])
def test_dng_monochrome(tmp_path, shape):
    import rawpy

    raw = RANDOM.integers(0, 65536, shape).astype(np.uint16)
    write_dng(tmp_path / "a.dng", raw, (), 0, 65535)
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        np.testing.assert_array_equal(file.raw_image_visible, raw)
        assert file.num_colors == 1


def test_dng_of_one_pixel_holds_it(tmp_path):
    import tifffile

    write_dng(
        tmp_path / "a.dng",
        np.array([[77]], np.uint16),
        ("GR", "BG"),
        0,
        100,
        {"A": (MATRIX, None)},
        NEUTRAL,
    )
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        assert (
            file.pages[0].asarray() == 77
            and file.pages[0].tags["DNGVersion"].value == b"\x01\x04\x00\x00"
        )


@pytest.mark.parametrize(
    "changes, error, part",
    [
        ({"raw": np.zeros((4, 4))}, BadData, "uint16"),
        ({"raw": np.zeros((0, 4), np.uint16)}, BadData, "(0, 4)"),
        ({"cfa": ("RG", "BW")}, BadData, "letters R, G, B"),
        ({"cfa": ("RG", "B")}, BadData, "equal length"),
        (
            {"cfa": ("RG", "NB"), "channels": "RGNB"},
            OutOfRange,
            "filters of a DNG = N: allowed is R, G, B, C, M, Y, W",
        ),
        (
            {"cfa": ("RC", "CC"), "channels": "RC"},
            OutOfRange,
            "channels of a DNG = 2 (R, C): allowed is 1, 3 or 4",
        ),
        (
            {"raw": np.zeros((4, 4, 4), np.uint16), "cfa": ()},
            BadData,
            "4 layers of raw values for 3 channels",
        ),
        ({"black_level": 4095}, OutOfRange, "black < white"),
        ({"black_level": [64, 65]}, BadData, "(2, 2)"),
        ({"black_level": -1}, OutOfRange, "black < white"),
        ({"matrices": {"D65": (np.eye(2), None)}}, BadData, "color matrix of D65"),
        ({"matrices": {"D65": (MATRIX, np.eye(2))}}, BadData, "forward matrix of D65"),
        ({"matrices": None}, OutOfRange, "one or two of A, B"),
        ({"matrices": {"FL2": (MATRIX, None)}}, OutOfRange, "FL2"),
        ({"matrices": {"A": (MATRIX * np.nan, None)}}, BadData, "color matrix of A: wanted finite"),
        ({"noise": (0.0, 1.0)}, OutOfRange, "S > 0"),
        ({"noise": (1e-3, -1.0)}, OutOfRange, "O >= 0"),
        ({"as_shot_neutral": [1, 0, 1]}, OutOfRange, "as_shot_neutral"),
        ({"as_shot_neutral": [1, 1]}, BadData, "as_shot_neutral"),
    ],
)
def test_dng_refusals(tmp_path, changes, error, part):
    arguments = {
        "raw": np.zeros((4, 4), np.uint16),
        "cfa": ("RG", "GB"),
        "black_level": 64,
        "white_level": 4095,
        "matrices": {"D65": (MATRIX, None)},
        "as_shot_neutral": NEUTRAL,
    } | changes
    with fails(error, part):
        write_dng(tmp_path / "a.dng", **arguments)
    assert list(tmp_path.iterdir()) == []


# ---- files are complete or not there


def test_atomic_path_keeps_the_old_file_when_writing_fails(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        assert path.read_text() == "old" and temporary.suffix == ".txt"
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
    with atomic_path(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_missing_folders_stay_only_with_a_file(tmp_path):
    path = tmp_path / "new" / "folder" / "a.txt"
    check_output(path)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert path.read_text() == "whole"


def test_atomic_path_refusals(tmp_path):
    (tmp_path / "file").touch()
    with fails(BadFile, tmp_path / "file" / "a.png", "cannot be written"):
        write_png(tmp_path / "file" / "a.png", np.zeros((2, 2), np.uint8))
    (tmp_path / "folder.png").mkdir()
    with fails(BadFile, "folder.png", "is a folder"):
        write_png(tmp_path / "folder.png", np.zeros((2, 2), np.uint8))
    with fails(BadFile, tmp_path / "a.txt", "cannot be written"), atomic_path(tmp_path / "a.txt"):
        raise OSError(28, os.strerror(28))


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_npz(path, chart("flat", size=(4, 3))),
        lambda path: write_spectral_exr(path, WAVES, np.ones((3, 2, 2))),
        lambda path: write_rgb_exr(path, np.ones((2, 2, 3))),
        lambda path: write_png(path, np.zeros((2, 2), np.uint8)),
        lambda path: write_dng(path, np.zeros((2, 2), np.uint16), (), 0, 1),
    ],
    ids=["npz", "spectral-exr", "rgb-exr", "png", "dng"],
)
def test_every_writer_makes_a_missing_folder(tmp_path, write):
    write(tmp_path / "new" / "folder" / "a.out")
    assert [path.name for path in (tmp_path / "new" / "folder").iterdir()] == ["a.out"]
