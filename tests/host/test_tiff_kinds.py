"""TIFF files of satellites, microscopes and cameras: integers of any size, packings, pages, GDAL's tags."""

import numpy as np
import pytest
import tifffile
from PIL import Image
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadFile, OutOfRange

RANDOM = np.random.default_rng(9)
WAVES = [450.0, 550.0, 650.0]
SHAPE = (3, 32, 48)


def reflectances():
    return RANDOM.uniform(0.05, 0.9, SHAPE)


def stored_as(values, dtype, scale):
    return np.round(values * scale).astype(dtype)


def gdal(scales=(), offsets=(), nodata=None):
    """GDAL's private tags, as its GTiff driver writes them."""
    items = [
        f'  <Item name="{name}" sample="{at}" role="{role}">{value}</Item>\n'
        for name, role, list_ in (("SCALE", "scale", scales), ("OFFSET", "offset", offsets))
        for at, value in enumerate(list_)
    ]
    tags = []
    if items:
        text = "<GDALMetadata>\n" + "".join(items) + "</GDALMetadata>\n"
        tags.append((42112, "s", 0, text, True))
    if nodata is not None:
        tags.append((42113, "s", 0, str(nodata), True))
    return tags


def said(scene, *words):
    return any(all(word in note for word in words) for note in scene.notes)


@pytest.mark.parametrize(
    "dtype, scale",
    [
        ("int16", 10000),
        ("uint16", 10000),
        ("uint32", 1e6),
        ("int32", 1e6),
        ("uint8", 200),
        ("int8", 127),
    ],
)
@pytest.mark.parametrize("layout", ["pages", "contig", "separate"])
def test_whole_numbers_times_a_scale(tmp_path, dtype, scale, layout):
    stored = stored_as(reflectances(), dtype, scale)
    planes = np.moveaxis(stored, 0, -1) if layout == "contig" else stored
    options = {} if layout == "pages" else {"planarconfig": layout}
    tifffile.imwrite(tmp_path / "a.tif", planes, photometric="minisblack", metadata=None, **options)
    scene = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=scale)
    # rounded to float32 before and after the quotient
    np.testing.assert_allclose(scene.content.values, stored / scale, rtol=2e-7)
    assert scene.notes == ()


@pytest.mark.parametrize("dtype", ["int8", "int16", "int32", "uint32"])
def test_whole_numbers_without_a_scale_are_refused(tmp_path, dtype):
    tifffile.imwrite(tmp_path / "a.tif", np.ones(SHAPE, dtype), photometric="minisblack")
    with refused("a.tif", dtype, "scale=10000", error=BadFile):
        gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES)


def test_reflectances_far_above_1_need_a_scale(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.full(SHAPE, 5000, np.float32), photometric="minisblack")
    with refused("a.tif", "mean 5e+03", "scale", error=BadFile):
        gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES)
    assert (
        gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=10000).content.values[0, 0, 0]
        == 0.5
    )
    assert gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, kind="radiance").shape == SHAPE[1:]


@pytest.mark.parametrize(
    "options",
    [
        {"compression": "zlib", "predictor": 2},
        {"compression": "lzw", "predictor": 2},
        {"compression": "zstd"},
        {"bigtiff": True},
        {"byteorder": ">"},
        {"tile": (16, 16), "compression": "zlib"},
        {"rowsperstrip": 7},
    ],
    ids=str,
)
@pytest.mark.parametrize("dtype, scale", [("int16", 10000), ("uint32", 1e6)])
def test_packings(tmp_path, dtype, scale, options):
    stored = stored_as(reflectances(), dtype, scale)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", metadata=None, **options)
    scene = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=scale)
    np.testing.assert_allclose(scene.content.values, stored / scale, rtol=2e-7)


def test_openimageio_writes_int16(tmp_path):
    import OpenImageIO as oiio

    stored = np.moveaxis(stored_as(reflectances(), "int16", 10000), 0, -1)
    for config in ("contig", "separate"):
        spec = oiio.ImageSpec(SHAPE[2], SHAPE[1], 3, "int16")
        spec.attribute("planarconfig", config)
        spec.attribute("tiff:PhotometricInterpretation", 1)
        out = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
        assert out.open(str(tmp_path / "a.tif"), spec)
        out.write_image(np.ascontiguousarray(stored))
        out.close()
        scene = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=10000)
        found = np.moveaxis(scene.content.values, 0, -1)
        np.testing.assert_allclose(found, stored / 10000, rtol=2e-7)


@pytest.mark.parametrize("photometric", ["rgb", "minisblack", "ycbcr"])
def test_jpeg_inside(tmp_path, photometric):
    """As Pillow decodes the same blocks, of a smooth picture; half a code in each of its roundings."""
    y, x = np.indices((32, 48))
    rgb = np.stack([4 * x, 6 * y, 100 + x + y], -1).astype(np.uint8)
    codes = rgb[..., 0] if photometric == "minisblack" else rgb
    stored = np.asarray(Image.fromarray(rgb).convert("YCbCr")) if photometric == "ycbcr" else codes
    tifffile.imwrite(
        tmp_path / "a.tif",
        stored,
        photometric=photometric,
        compression="jpeg",
        compressionargs={"level": 95},
    )
    scene = gs.open_scene(tmp_path / "a.tif")
    light = gs.open_display("srgb").decode(codes / 255)
    content = scene.content
    found = (
        content.shading if photometric == "minisblack" else np.moveaxis(content.coefficients, 0, -1)
    )
    # quality 95: quantisation of a few codes, where the slope of the curve is up to 2.3 / 255
    np.testing.assert_allclose(found, light, atol=8 * 2.3 / 255)
    assert np.abs(found - light).mean() < 0.01


def test_satellite_products_by_gdals_tags(tmp_path):
    """Scale 0.0001 and offset -0.1 as of Sentinel-2's later products; -9999 is no data."""
    values = reflectances()
    stored = np.round((values + 0.1) * 1e4).astype(np.int16)
    stored[:, 3, 5] = -9999
    for layout in ("contig", "separate"):
        planes = np.moveaxis(stored, 0, -1) if layout == "contig" else stored
        tifffile.imwrite(
            tmp_path / "a.tif",
            planes,
            photometric="minisblack",
            planarconfig=layout,
            metadata=None,
            extratags=gdal([0.0001] * 3, [-0.1] * 3, -9999),
        )
        for scale in (None, 10000):  # asked for, too: the offset stays
            scene = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=scale)
            wanted = stored * 1e-4 - 0.1
            wanted[:, 3, 5] = 0
            np.testing.assert_allclose(scene.content.values, wanted, atol=2e-7)
            assert said(scene, "no data in 0.065 %", "dark")  # 1 of 32 x 48


def test_gains_of_each_band_and_pages(tmp_path):
    """One file of three pages, each with its own scale; NaN for no data in floats."""
    stored = reflectances().astype(np.float32)
    stored[1, 0, 0] = np.nan
    with tifffile.TiffWriter(tmp_path / "a.tif") as out:
        for number, plane in enumerate(stored):
            out.write(
                plane,
                photometric="minisblack",
                metadata=None,
                extratags=gdal([0.5 + number / 4], nodata="nan"),
            )
    values = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES).content.values
    wanted = np.nan_to_num(stored * np.array([0.5, 0.75, 1.0])[:, None, None])
    np.testing.assert_allclose(values, wanted, rtol=3e-7)


@pytest.mark.parametrize("scale", ["nan", "0", "x", "1e999"])
def test_a_scale_that_is_none(tmp_path, scale):
    tifffile.imwrite(
        tmp_path / "a.tif",
        np.ones(SHAPE, np.int16),
        photometric="minisblack",
        extratags=gdal([scale]),
    )
    with refused("a.tif", error=BadFile):
        gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES)


def test_negative_noise_is_taken_as_0(tmp_path):
    stored = stored_as(reflectances(), np.int16, 10000)
    stored[0, 0, :5] = -3
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack")
    scene = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES, scale=10000)
    assert scene.content.values.min() == 0 and said(scene, "negative values", "taken as 0")


# ---- pages


def test_pages_are_chosen(tmp_path, capsys):
    from gpusim.cli.main import main

    pages = RANDOM.integers(0, 255, (3, 32, 48, 3)).astype(np.uint8)
    with tifffile.TiffWriter(tmp_path / "a.tif") as out:
        for page in pages:
            out.write(page, photometric="rgb", metadata=None)
        out.write(pages[0][::4, ::4], photometric="rgb", subfiletype=1)  # a preview
    with refused("a.tif", "3 pages", "part=", error=BadFile):
        gs.open_scene(tmp_path / "a.tif")
    for part in (1, "1"):
        scene = gs.open_scene(tmp_path / "a.tif", part=part)
        light = gs.open_display("srgb").decode(pages[1] / 255)
        np.testing.assert_allclose(np.moveaxis(scene.content.coefficients, 0, -1), light, rtol=1e-6)
        assert said(scene, "3 pages: only page 1 is used") and said(scene, "previews", "1 of them")
    with refused("a.tif", "part = 3", "0 .. 2", error=BadFile):
        gs.open_scene(tmp_path / "a.tif", part=3)
    with refused("part", "without wavelengths", error=OutOfRange):
        gs.open_scene(tmp_path / "a.tif", part=1, wavelengths=WAVES)
    asked = [
        "simulate",
        str(tmp_path / "a.tif"),
        "--camera",
        "mono",
        "--device",
        "numpy",
        "--part",
        "2",
    ]
    assert main(asked) == 0 and "only page 2" in capsys.readouterr().out


def test_pictures_inside_pages_are_noted(tmp_path):
    """A pyramid as of OME-TIFF: smaller levels in SubIFDs."""
    page = RANDOM.integers(0, 255, (32, 48, 3)).astype(np.uint8)
    with tifffile.TiffWriter(tmp_path / "a.tif") as out:
        out.write(page, photometric="rgb", subifds=2, metadata=None)
        out.write(page[::2, ::2], photometric="rgb", subfiletype=1)
        out.write(page[::4, ::4], photometric="rgb", subfiletype=1)
    assert said(gs.open_scene(tmp_path / "a.tif"), "inside pages", "2 of them")


def test_tags_without_a_use_are_noted(tmp_path):
    page = RANDOM.integers(0, 255, (32, 48, 3)).astype(np.uint8)
    tifffile.imwrite(
        tmp_path / "a.tif",
        page,
        photometric="rgb",
        resolution=(300, 150),
        software="me",
        extratags=[
            (301, "H", 3 * 256, tuple(range(0, 768 * 85, 85)), True),
            (65000, "H", 1, 7, True),
            *gdal([0.1], nodata=0),
        ],
    )
    scene = gs.open_scene(tmp_path / "a.tif")
    (note,) = [note for note in scene.notes if note.startswith("tags not used")]
    names = set(note.split(": ")[1].split(", "))
    assert names == {"TransferFunction", "65000", "GDAL_METADATA", "GDAL_NODATA"}
    assert said(scene, "resolution 300 x 150", "square")
    tifffile.imwrite(
        tmp_path / "b.tif", page, photometric="rgb", resolution=(300, 300), software="me"
    )
    assert gs.open_scene(tmp_path / "b.tif").notes == ()


def test_primaries_of_a_tag(tmp_path):
    import colour

    page = RANDOM.integers(110, 150, (32, 48, 3)).astype(np.uint8)
    space = colour.RGB_COLOURSPACES["Display P3"]

    def fractions(pairs):
        return [part for x in np.ravel(pairs) for part in (round(1e6 * x), 1_000_000)]

    tifffile.imwrite(
        tmp_path / "a.tif",
        page,
        photometric="rgb",
        metadata=None,
        extratags=[
            (318, "2I", 2, fractions(space.whitepoint), True),
            (319, "2I", 6, fractions(space.primaries), True),
        ],
    )
    matrix = colour.matrix_RGB_to_RGB(space, colour.RGB_COLOURSPACES["sRGB"], "Bradford")
    wanted = colour.models.eotf_sRGB(page / 255) @ matrix.T
    scene = gs.open_scene(tmp_path / "a.tif")
    # matrices of the standards of four digits
    np.testing.assert_allclose(np.moveaxis(scene.content.coefficients, 0, -1), wanted, atol=1e-3)
    assert scene.notes == ()


def test_uint32_photographs(tmp_path):
    codes = RANDOM.integers(0, 2**32, (8, 9, 3), np.uint32)
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb")
    scene = gs.open_scene(tmp_path / "a.tif")
    light = gs.open_display("srgb").decode(codes / (2**32 - 1))
    # a code of 16 bits, where the slope of the curve is at most 2.3
    np.testing.assert_allclose(
        np.moveaxis(scene.content.coefficients, 0, -1), light, atol=2.3 / 65535
    )
    assert said(scene, "upper 16")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_planes_are_turned(tmp_path, orientation):
    """As OpenImageIO turns the same page."""
    import OpenImageIO as oiio

    stored = RANDOM.random((8, 9, 3), np.float32)
    tifffile.imwrite(
        tmp_path / "a.tif",
        stored,
        photometric="minisblack",
        planarconfig="contig",
        metadata=None,
        extratags=[(274, "H", 1, orientation, True)],
    )
    turned = oiio.ImageBufAlgo.reorient(oiio.ImageBuf(str(tmp_path / "a.tif")))
    values = gs.open_scene(tmp_path / "a.tif", wavelengths=WAVES).content.values
    np.testing.assert_array_equal(np.moveaxis(values, 0, -1), turned.get_pixels(oiio.FLOAT))


def test_planes_where_0_is_white_and_planes_of_no_light(tmp_path):
    stored = RANDOM.integers(0, 255, (8, 9), np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="miniswhite", metadata=None)
    values = gs.open_scene(tmp_path / "a.tif", wavelengths=[550]).content.values
    np.testing.assert_allclose(values[0], (255 - stored) / 255, rtol=2e-7)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="cfa", metadata=None)
    with refused("a.tif", "wanted planes of light", error=BadFile):
        gs.open_scene(tmp_path / "a.tif", wavelengths=[550])
