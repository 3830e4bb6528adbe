"""Scenes written to files: what other programs read in them, what comes back, and what no file holds."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.constants import c, h

import gpusim as gs
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.errors import BadData, BadFile, GpusimError, OutOfRange, UnknownName
from gpusim.domain.scene import unit_light

WAVES = np.array([400.0, 450.25, 500.0, 560.0, 650.0])
ULP = 2.0**-24  # half the step of float32, relative
RANDOM = np.random.default_rng(11)
LIGHT = white_radiance(illuminant("FL2"), 80.0)


def scene(content=None, illuminant=LIGHT, **changes):
    content = content or gs.Cube(
        WAVES, RANDOM.random((5, 70, 9), np.float32)
    )  # more rows than are converted at once
    return gs.Scene(
        content,
        illuminant,
        **{"name": "made", "depth": 1 + RANDOM.random((70, 9), np.float32)} | changes,
    )


def forms():
    yield scene(border="reflect", fov=0.3, samples_per_pixel=1.5)
    yield scene(illuminant=unit_light(WAVES), border="zero")
    yield scene(border="scene", margin=2, depth=None)
    yield scene(gs.Basis(WAVES, RANDOM.random((2, 70, 9), np.float32), RANDOM.random((2, 5))))
    yield scene(
        gs.Materials(
            WAVES,
            RANDOM.integers(0, 4, (70, 9)).astype(np.uint8),
            RANDOM.random((70, 9), np.float32),
            RANDOM.random((4, 5)),
        )
    )
    yield gs.picture(RANDOM.integers(0, 256, (70, 9, 3), np.uint8), light="A", border="edge")


def spectra(scene):
    """Of the content, without the light: float64 (L, rows, cols)."""
    return scene.content.on_host().bands_at(slice(None))


@pytest.mark.parametrize("suffix", [".exr", ".npz"])
@pytest.mark.parametrize(
    "made", list(forms()), ids=lambda scene: f"{scene.content.form}-{scene.border}"
)
def test_all_of_a_scene_comes_back(tmp_path, made, suffix):
    gs.save_scene(made, tmp_path / f"a{suffix}")
    back = gs.open_scene(tmp_path / f"a{suffix}")
    # a sum of float64 products is rounded to float32 once; a picture's codes were decoded to float32 before
    np.testing.assert_allclose(spectra(back), spectra(made), rtol=2 * ULP)
    assert back.light_is_known == made.light_is_known
    np.testing.assert_array_equal(back.illuminant.wavelengths, made.illuminant.wavelengths)
    np.testing.assert_array_equal(back.illuminant.values, made.illuminant.values)
    for key in ("border", "margin", "fov", "name", "samples_per_pixel", "depth"):
        np.testing.assert_array_equal(getattr(back, key), getattr(made, key), err_msg=key)


@pytest.mark.parametrize("suffix", [".hdr", ".tif", ".TIFF"])
@pytest.mark.parametrize(
    "made", list(forms()), ids=lambda scene: f"{scene.content.form}-{scene.border}"
)
@pytest.mark.parametrize("radiance", [False, True])
def test_planes_come_back(tmp_path, made, suffix, radiance):
    made = dataclasses.replace(made, depth=None)
    gs.save_scene(made, tmp_path / f"a{suffix}", radiance=radiance)
    back = gs.open_scene(tmp_path / f"a{suffix}")
    is_radiance = radiance or not made.light_is_known
    wanted = spectra(made)
    if radiance and made.light_is_known:
        wanted = wanted * made.illuminant.at(made.wavelengths)[:, None, None]
    # radiance becomes energy and photons again, in float32: two factors and two products each way,
    # and the unit of ENVI
    rounded = 12 if is_radiance else 2
    np.testing.assert_allclose(spectra(back), wanted, rtol=rounded * ULP)
    assert back.light_is_known == (not is_radiance)
    if not is_radiance:
        np.testing.assert_array_equal(back.illuminant.wavelengths, made.illuminant.wavelengths)
        np.testing.assert_array_equal(back.illuminant.values, made.illuminant.values)
    for key in ("border", "margin", "fov", "name", "samples_per_pixel"):
        np.testing.assert_array_equal(getattr(back, key), getattr(made, key), err_msg=key)
    assert back.notes == ()


@pytest.mark.parametrize("is_lit", [True, False])
def test_spectral_python_and_gdals_fields_read_envi(tmp_path, is_lit):
    """Reflectances, or radiance in W m-2 sr-1 um-1 by the gains."""
    import spectral

    made = scene(illuminant=LIGHT if is_lit else unit_light(WAVES), depth=None)
    gs.save_scene(made, tmp_path / "a.hdr")
    found = spectral.open_image(str(tmp_path / "a.hdr"))
    assert (found.nrows, found.ncols, found.nbands) == (70, 9, 5)
    assert found.bands.centers == WAVES.tolist() and found.bands.band_unit == "Nanometers"
    wanted = made.content.values
    if not is_lit:
        assert found.metadata["data gain values"] == ["1"] * 5
        wanted = wanted * (h * c / (WAVES * 1e-9))[:, None, None] * 1e3
    theirs = np.moveaxis(np.asarray(found.load()), -1, 0)
    np.testing.assert_allclose(theirs, wanted, rtol=4 * ULP)  # energy, two products
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.hdr", "a.img"]


@pytest.mark.parametrize("is_lit", [True, False])
def test_tifffile_and_openimageio_read_spectral_tiff(tmp_path, is_lit):
    import OpenImageIO as oiio
    import tifffile

    made = scene(illuminant=LIGHT if is_lit else unit_light(WAVES), depth=None)
    gs.save_scene(made, tmp_path / "a.tif")
    wanted = made.content.values
    if not is_lit:
        wanted = wanted * (h * c / (WAVES * 1e-9))[:, None, None]
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        np.testing.assert_allclose(file.asarray(), wanted, rtol=3 * ULP)
        said = json.loads(file.pages[0].description)
        names = [page.tags["PageName"].value for page in file.pages]
    assert said["wavelengths_nm"] == WAVES.tolist()
    assert said["quantity"] == ("reflectance" if is_lit else "radiance")
    assert said["unit"] == ("1" if is_lit else "W m-2 sr-1 nm-1")
    assert names == [f"{nm:g} nm" for nm in WAVES]
    for number in range(5):
        page = oiio.ImageBuf(str(tmp_path / "a.tif"), number, 0)
        assert page.spec().nchannels == 1 and str(page.spec().format) == "float"
        pixels = page.get_pixels(oiio.FLOAT)[..., 0]
        np.testing.assert_allclose(pixels, wanted[number], rtol=3 * ULP)


def test_envi_next_to_other_data(tmp_path):
    made = scene(depth=None)
    gs.save_scene(made, tmp_path / "a.hdr")
    gs.save_scene(made, tmp_path / "a.hdr")  # its own are replaced
    (tmp_path / "a.raw").write_bytes(b"x")
    with pytest.raises(BadFile, match=r"a\.raw would count as its data"):
        gs.save_scene(made, tmp_path / "a.hdr")


@pytest.mark.parametrize("suffix", [".hdr", ".tif"])
def test_nothing_is_left_of_planes_that_cannot_be_written(tmp_path, monkeypatch, suffix):
    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(BadFile, match="No space left"):
        gs.save_scene(scene(depth=None), tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_colour_science_reads_reflectance_and_radiance(tmp_path):
    """By its reader of the layout of Fichet et al. (2021), through OpenImageIO: names, wavelengths, units, order."""
    import colour

    made = scene()
    for radiance, kind in ((False, "T"), (True, "S0")):
        gs.save_scene(made, tmp_path / "a.exr", radiance=radiance)
        found, said = colour.read_spectral_image_Fichet2021(
            str(tmp_path / "a.exr"), additional_data=True
        )
        waves, values = found[kind]
        assert list(found) == [kind] and said.is_emissive == radiance and not said.is_polarised
        np.testing.assert_array_equal(waves, WAVES)
        wanted = made.content.values.astype(float)
        if radiance:  # [W m-2 sr-1 nm-1] from photons
            watts = LIGHT.at(WAVES) * h * c / (WAVES * 1e-9)
            wanted = wanted * watts[:, None, None]
        # radiance is rounded to float32 as photons and as energy; OpenImageIO gives half or float as they are
        np.testing.assert_allclose(np.moveaxis(values, -1, 0), wanted, rtol=2.1 * ULP)


def test_luminance_by_colour_science(tmp_path):
    """Of white in D65 at 100 cd m-2, by its tables of the observer and 683 lm/W, from the file's radiance alone.

    Its sum over every nanometre is that of trapezoids; our 100 is the integral of two broken lines' product. They
    differ by a sixth of the product of their changes within a nanometre: at most 2 % of the observer's peak and 2 % of
    D65, so 7e-5. The file's 380 to 780 nm leave out 2e-6.
    """
    import colour

    waves = np.arange(380.0, 781.0)
    white = gs.Scene(
        gs.Cube(waves, np.ones((401, 2, 2), np.float32)), white_radiance(illuminant("D65"), 100.0)
    )
    gs.save_scene(white, tmp_path / "a.exr", radiance=True)
    found, values = colour.read_spectral_image_Fichet2021(str(tmp_path / "a.exr"))["S0"]
    observer = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
        .copy()
        .align(colour.SpectralShape(380, 780, 1))
    )
    np.testing.assert_array_equal(found, observer.wavelengths)
    assert 683 * values[0, 0] @ observer.values[:, 1] == pytest.approx(100, rel=7e-5)


def test_depth_and_description_are_plain_channels_and_text(tmp_path):
    import OpenEXR

    made = scene()
    gs.save_scene(made, tmp_path / "a.exr", half=True)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(
            file.channels()["Z"].pixels, made.depth
        )  # distances stay 32-bit
        assert file.channels()["T.450,250000nm"].pixels.dtype == np.float16
        said = json.loads(file.header()["gpusimScene"])
    assert said["illuminant"]["values"] == LIGHT.values.tolist() and said["border"] == "edge"


def test_undershoot_of_a_basis_is_dark(tmp_path):
    low = gs.Basis(
        WAVES, np.array([[[1.0, -0.05]]], np.float32), np.array([[1.0, 0.5, 0.25, 0, 1]])
    )
    gs.save_scene(scene(low, depth=None), tmp_path / "a.exr")
    np.testing.assert_array_equal(
        spectra(gs.open_scene(tmp_path / "a.exr"))[:, 0],
        [[1, 0], [0.5, 0], [0.25, 0], [0, 0], [1, 0]],
    )


def test_light_that_varies(tmp_path):
    smooth = gs.Basis(WAVES, RANDOM.random((1, 70, 9), np.float32), np.ones((1, 5)))
    lamps = gs.illuminate(scene(smooth), {"A": np.linspace(1, 50, 630).reshape(70, 9), "D65": 20.0})
    gs.save_scene(lamps, tmp_path / "a.npz")
    np.testing.assert_array_equal(
        gs.open_scene(tmp_path / "a.npz").content.maps, lamps.content.maps
    )
    with pytest.raises(
        BadFile, match=r"a\.exr: the light of made varies over the scene.*radiance=True"
    ):
        gs.save_scene(lamps, tmp_path / "a.exr")
    gs.save_scene(lamps, tmp_path / "a.exr", radiance=True)
    shown = spectra(lamps) * lamps.illuminant.at(lamps.wavelengths)[:, None, None]
    # as energy in the file and back: a product each in float32
    np.testing.assert_allclose(spectra(gs.open_scene(tmp_path / "a.exr")), shown, rtol=4 * ULP)


@pytest.mark.parametrize(
    ("change", "name", "options", "error", "words"),
    [
        (
            {"depth": None, "view": gs.View(shift=(1.0, 0.0))},
            "a.exr",
            {},
            BadFile,
            "made has a view",
        ),
        ({"layers": "one"}, "a.exr", {}, BadFile, "made has 1 layers"),
        ({}, "a.bil", {}, UnknownName, r"format of a scene's file '\.bil'; .*\.exr"),
        ({}, "a.tif", {}, BadFile, "made has depth, which only"),
        ({}, "a.hdr", {}, BadFile, "made has depth, which only"),
        ({}, "a.hdr", {"half": True}, OutOfRange, r"for \.exr only"),
        ({}, "a.npz", {"radiance": True}, OutOfRange, r"not for \.npz"),
        ({}, "scene", {}, UnknownName, "format of a scene's file"),
        ({}, "a.npz", {"half": True}, OutOfRange, r"for \.exr only"),
        (
            {"illuminant": LIGHT.scale(1e30)},
            "a.exr",
            {"radiance": True},
            GpusimError,
            "NaN or infinite",
        ),
    ],
)
def test_what_no_file_holds(tmp_path, change, name, options, error, words):
    made = scene()
    if "layers" in change:
        change = {"layers": (gs.Layer(made.content, np.zeros((70, 9), np.float32), 0.5),)}
    with pytest.raises(error, match=words), np.errstate(over="ignore"):
        gs.save_scene(dataclasses.replace(made, **change), tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(BadData, match="wanted a Scene"):
        gs.save_scene(made.content, tmp_path / "a.exr")


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "null",
        '"border"',
        '{"border": []}',
        '{"margin": 1e999}',
        '{"margin": 3}',
        '{"fov": "wide"}',
        '{"illuminant": {}}',
        '{"illuminant": {"name": "", "wavelengths_nm": [500, 400], "values": [1, 2]}}',
        '{"illuminant": {"name": "", "wavelengths_nm": [400, 500], "values": [-1, 2]}}',
        '{"illuminant": {"name": "", "wavelengths_nm": [400, 500], "values": [NaN, 2]}}',
        '{"samples_per_pixel": 0.5}',
        "[" * 5000,
    ],
)
def test_descriptions_that_others_wrote(tmp_path, text):
    from gpusim.io.exr import write_spectral_exr

    write_spectral_exr(
        tmp_path / "a.exr", WAVES, np.ones((5, 4, 6)), reflectance=True, gpusimScene=text
    )
    with pytest.raises(BadFile, match=r"a\.exr: ") as error:
        gs.open_scene(tmp_path / "a.exr")
    assert "\n" not in str(error.value)
