"""Pictures of 8, 16 and 32 bits as other programs read them: Pillow, LittleCMS, OpenImageIO, exiftool, tifffile."""

import io

import numpy as np
import pytest
from exif import exiftool
from PIL import Image, ImageCms

import gpusim as gs
from gpusim.domain.errors import BadData
from gpusim.io.exr import write_rgb_exr
from gpusim.io.frame.icc import icc_profile
from gpusim.io.frame.images import write_png, write_tiff

RANDOM = np.random.default_rng(31)
CODES = RANDOM.integers(0, 65536, (13, 17, 3)).astype(np.uint16)
GAMMA = gs.Display("mine", ((0.7, 0.29), (0.2, 0.7), (0.14, 0.05)), (0.3457, 0.3585), 1.8)
DISPLAYS = [*map(gs.open_display, ("srgb", "display-p3", "oled-sony")), GAMMA]
BY_NAME = pytest.mark.parametrize("display", DISPLAYS, ids=lambda display: display.name)


def by_openimageio(path, kind):
    import OpenImageIO

    file = OpenImageIO.ImageInput.open(str(path))
    try:
        return file.read_image(kind), file.spec()
    finally:
        file.close()


def adapted(xyz, white):
    """To D50, as colour-science does by Bradford."""
    import colour

    return colour.adaptation.chromatic_adaptation_VonKries(
        xyz, white, [0.9642, 1, 0.82491], transform="Bradford"
    )


@BY_NAME
@pytest.mark.parametrize("linear", [False, True])
def test_littlecms_reads_the_profile(display, linear):
    """Colours of codes by LittleCMS against the display's own light, adapted to D50 by colour-science.

    Pillow gives CIELAB in steps of 100 / 255 of L and 1 of a and b, rounded: half a step. The profile's numbers, whole
    ones of 2^-16, add a hundredth. Without the flag LittleCMS computes in tables, coarse near black. a and b beyond
    -128 and 127 are clipped.
    """
    import colour

    codes = np.concatenate(
        [RANDOM.integers(0, 256, (200, 3)), [[255] * 3, [0] * 3, [128] * 3], 255 * np.eye(3)]
    )
    codes = codes.astype(np.uint8)[None]
    profile = ImageCms.ImageCmsProfile(io.BytesIO(icc_profile(display, linear)))
    convert = ImageCms.buildTransform(
        profile,
        ImageCms.createProfile("LAB"),
        "RGB",
        "LAB",
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
        flags=ImageCms.Flags.NOOPTIMIZE,
    )
    found = np.asarray(ImageCms.applyTransform(Image.fromarray(codes), convert)).astype(float)[0]
    found = np.stack(
        [
            found[:, 0] * 100 / 255,
            *(np.where(found[:, 1:] > 127, found[:, 1:] - 256, found[:, 1:])).T,
        ],
        1,
    )
    light = codes[0] / 255 if linear else display.decode(codes[0] / 255)
    xyz = adapted(light @ display.xyz_from_rgb.T, display.xyz_from_rgb.sum(axis=1))
    wanted = colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy([0.9642, 1, 0.82491])).clip(
        [0, -128, -128], [100, 127, 127]
    )
    assert (np.abs(found - wanted) <= [0.51 * 100 / 255, 0.51, 0.51]).all()
    assert ImageCms.getProfileDescription(profile).startswith(f"gpusim {display.name}")


@BY_NAME
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("grey", [False, True])
def test_png_holds_its_codes_and_says_its_colours(tmp_path, display, bits, grey):
    """Pixels by OpenImageIO, which does not go by Pillow; chunks by exiftool and Pillow."""
    codes = (CODES if bits == 16 else (CODES // 256).astype(np.uint8))[
        ..., 0 if grey else slice(None)
    ]
    write_png(tmp_path / "a.png", codes, display)
    found, _ = by_openimageio(tmp_path / "a.png", "uint16" if bits == 16 else "uint8")
    np.testing.assert_array_equal(found[..., 0] if grey else found, codes)
    tags = exiftool(tmp_path / "a.png")
    assert tags["BitDepth"] == bits and tags["ColorType"] == (0 if grey else 2)
    assert tags["Gamma"] == pytest.approx(
        2.2 if display.curve == "srgb" else display.curve, rel=1e-4
    )
    for name, xy in zip(
        ("WhitePoint", "Red", "Green", "Blue"), (display.white, *display.primaries), strict=True
    ):
        assert (tags[f"{name}X"], tags[f"{name}Y"]) == pytest.approx(
            xy, abs=5.1e-6
        )  # rounded to 1e-5
    assert ("SRGBRendering" in tags) == (display.name == "srgb")
    with Image.open(tmp_path / "a.png") as image:
        image.load()
        assert ("icc_profile" in image.info) == (display.name != "srgb" and not grey)
        if "icc_profile" in image.info:
            assert image.info["icc_profile"] == icc_profile(display)
            assert tags["ProfileDescription"] == f"gpusim {display.name}"
    data = (tmp_path / "a.png").read_bytes()
    assert (b"cICP" + bytes([12, 13, 0, 1]) in data) == (display.name == "display-p3")


def test_png_of_16_bits_is_read_again(tmp_path):
    write_png(tmp_path / "a.png", CODES)
    scene = gs.open_scene(tmp_path / "a.png")
    light = np.moveaxis(gs.open_display("srgb").decode(CODES / 65535), -1, 0)
    np.testing.assert_allclose(scene.content.on_host().coefficients, light, rtol=1e-6)  # float32


@BY_NAME
def test_tiff_holds_its_numbers_and_its_profile(tmp_path, display):
    linear = RANDOM.uniform(-0.1, 30, (13, 17, 3)).astype(np.float32)
    for values, kind in (
        (CODES, "uint16"),
        ((CODES // 256).astype(np.uint8), "uint8"),
        (linear, "float"),
    ):
        write_tiff(tmp_path / "a.tif", values, display)
        found, spec = by_openimageio(tmp_path / "a.tif", kind)
        np.testing.assert_array_equal(found, values)
        assert str(spec.format) == kind and spec.nchannels == 3
        tags = exiftool(tmp_path / "a.tif")
        assert tags["BitsPerSample"] == [8 * values.dtype.itemsize] * 3
        if kind == "uint8":  # Pillow has no pictures of three larger numbers
            with Image.open(tmp_path / "a.tif") as image:
                assert image.info["icc_profile"] == icc_profile(display)
        assert tags["ProfileDescription"] == f"gpusim {display.name}" + (
            ", linear" if kind == "float" else ""
        )


@BY_NAME
def test_exr_says_its_primaries(tmp_path, display):
    """Read by OpenImageIO; the attribute is of OpenEXR's standard ones: red, green, blue, white."""
    linear = RANDOM.uniform(-0.1, 30, (13, 17, 3)).astype(np.float32)
    for half, kind, rounding in ((False, "float", 0), (True, "half", 2.0**-11)):
        write_rgb_exr(tmp_path / "a.exr", linear, half=half, display=display)
        found, spec = by_openimageio(tmp_path / "a.exr", "float")
        np.testing.assert_allclose(found, linear, rtol=rounding, atol=2.0**-25 if half else 0)
        assert str(spec.format) == kind
        np.testing.assert_allclose(
            spec.getattribute("chromaticities"),
            np.ravel((*display.primaries, display.white)),
            rtol=1e-6,
        )


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 5, 3)),
        np.zeros((4, 5), np.uint8),
        np.zeros((0, 5, 3), np.uint16),
        np.full((4, 5, 3), np.nan, np.float32),
        np.full((4, 5, 3), np.inf, np.float32),
    ],
)
def test_tiff_refusals(tmp_path, image):
    with pytest.raises(
        BadData, match=r"a\.tif: (a TIFF needs uint8, uint16 or float32|NaN or infinite)"
    ):
        write_tiff(tmp_path / "a.tif", image)
    assert list(tmp_path.iterdir()) == []
