"""Colours of photographs by profiles, chunks and tags, by LittleCMS, colour-science and closed forms."""

import io
import struct
import zlib

import colour
import imagecodecs
import numpy as np
import pytest
from picture_mutations import png_of
from PIL import Image
from refusals import refused

import gpusim as gs
from gpusim.data.colorimetry import xyz
from gpusim.domain.errors import BadFile
from gpusim.domain.spectrum import energy_from_photons
from gpusim.io.frame.icc import icc_profile

pytestmark = pytest.mark.filterwarnings("ignore:[^$]*Aligning", "ignore:[^$]*Matplotlib")
RANDOM = np.random.default_rng(3)
# muted colours, which are inside sRGB however they are encoded
CODES = RANDOM.integers(110, 150, (6, 8, 3)).astype(np.uint8)
LINEAR_SRGB = icc_profile(gs.open_display("srgb"), linear=True)
PROPHOTO = {
    "whitepoint": [0.3457, 0.3585, 1],
    "primaries": [0.7347, 0.2653, 1, 0.1596, 0.8404, 1, 0.0366, 0.0001, 1],
    "gamma": 1.8,
}


def profiles():
    """Profiles that LittleCMS writes, and gpusim's own."""
    return {
        "adobe": imagecodecs.cms_profile("adobergb"),
        "prophoto": imagecodecs.cms_profile("rgb", **PROPHOTO),
        "srgb": imagecodecs.cms_profile("srgb"),
        "p3": icc_profile(gs.open_display("display-p3")),
        "p3 linear": icc_profile(gs.open_display("display-p3"), linear=True),
        "curve": imagecodecs.cms_profile(
            "rgb",
            whitepoint=[0.3127, 0.329, 1],
            primaries=[0.67, 0.33, 1, 0.21, 0.71, 1, 0.14, 0.08, 1],
            transferfunction=np.float32(np.linspace(0, 1, 33) ** 2.4),
        ),
    }


def colours(scene):
    return np.moveaxis(scene.content.on_host().coefficients, 0, -1)


def by_littlecms(samples, profile, space="rgb"):
    """Linear sRGB in floats, relative colorimetric."""
    found = imagecodecs.cms_transform(
        np.ascontiguousarray(samples),
        profile,
        LINEAR_SRGB,
        colorspace=space,
        outcolorspace="rgb",
        outdtype=np.float32,
        intent=1,
    )
    return np.asarray(found)


def png(codes, *chunks, bits=None):
    """A PNG with chunks before its lines, by the specification."""
    rows, cols, channels = (*codes.shape, 1)[:3]
    deep = codes.dtype == np.uint16
    colour_type = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    lines = codes.astype(">u2" if deep else np.uint8).view(np.uint8).reshape(rows, -1)
    packed = zlib.compress(np.pad(lines, ((0, 0), (1, 0))).tobytes())
    head = struct.pack(">IIBBBBB", cols, rows, bits or 8 * codes.itemsize, colour_type, 0, 0, 0)
    return png_of([(b"IHDR", head), *chunks, (b"IDAT", packed), (b"IEND", b"")])


def gama(exponent):
    return b"gAMA", struct.pack(">I", round(1e5 / exponent))


def chrm(white, *primaries):
    return b"cHRM", struct.pack(">8I", *(round(1e5 * x) for x in np.ravel((white, *primaries))))


def iccp(profile):
    return b"iCCP", b"a profile\0\0" + zlib.compress(profile)


def opened(tmp_path, data, name="a.png"):
    (tmp_path / name).write_bytes(data)
    return gs.open_scene(tmp_path / name)


def linear_in(space, light):
    """Linear sRGB of linear RGB of another space, by colour-science, white adapted (Bradford)."""
    rgb = colour.RGB_COLOURSPACES
    return light @ colour.matrix_RGB_to_RGB(rgb[space], rgb["sRGB"], "Bradford").T


# ---- ICC profiles


@pytest.mark.parametrize("name", profiles())
@pytest.mark.parametrize("kind", ["png8", "png16", "jpeg", "tiff8", "tiff16"])
def test_profiles_as_littlecms_applies_them(tmp_path, name, kind):
    profile, codes, path = profiles()[name], CODES, tmp_path / f"a.{kind[:3]}"
    if kind == "png8":
        path = tmp_path / "a.png"
        Image.fromarray(codes).save(path, icc_profile=profile)
    elif kind == "png16":
        codes = codes.astype(np.uint16) * 257 + 100
        path.write_bytes(png(codes, iccp(profile)))
    elif kind == "jpeg":
        path = tmp_path / "a.jpg"
        Image.fromarray(codes).save(path, quality=95, icc_profile=profile)
        codes = np.asarray(Image.open(path))
    else:
        import tifffile

        codes = codes if kind == "tiff8" else codes.astype(np.uint16) * 257 + 100
        tifffile.imwrite(path, codes, photometric="rgb", iccprofile=profile)
    scene = gs.open_scene(path)
    # profiles have 16 bits; the white of D65's table differs from LittleCMS's D50 and back by 2e-4
    np.testing.assert_allclose(colours(scene), by_littlecms(codes, profile), atol=6e-4, rtol=6e-4)
    assert not [note for note in scene.notes if "colours outside" not in note]


def test_a_large_profile(tmp_path):
    """Of 3 MB, as of printers and scanners; Pillow refuses one of more than 1 MiB."""
    profile = profiles()["adobe"] + bytes(3 * 10**6)
    found = colours(opened(tmp_path, png(CODES, iccp(profile))))
    np.testing.assert_allclose(found, by_littlecms(CODES, profiles()["adobe"]), atol=6e-4)


def test_white_and_black_of_a_profile_stay(tmp_path):
    for name, profile in profiles().items():
        codes = np.zeros((2, 4, 3), np.uint8)
        codes[0] = 255
        Image.fromarray(codes).save(tmp_path / "a.png", icc_profile=profile)
        found = colours(gs.open_scene(tmp_path / "a.png"))
        np.testing.assert_allclose(found[0], 1, atol=1e-4, err_msg=name)  # primaries of 16 bits
        np.testing.assert_allclose(found[1], 0, atol=1e-6)


def test_a_profile_of_srgb_changes_nothing(tmp_path):
    from PIL import ImageCms

    pillows = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(CODES).save(tmp_path / "plain.png")
    plain = colours(gs.open_scene(tmp_path / "plain.png"))
    for profile in (pillows, profiles()["srgb"], icc_profile(gs.open_display("srgb"))):
        Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=profile)
        np.testing.assert_array_equal(colours(gs.open_scene(tmp_path / "a.png")), plain)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2])
def test_grey_profiles(tmp_path, gamma):
    profile = imagecodecs.cms_profile("gray", gamma=gamma)
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    for name in ("a.png", "a.jpg"):
        Image.fromarray(codes).save(
            tmp_path / name, icc_profile=profile, **({"quality": 100} if name == "a.jpg" else {})
        )
        stored = np.asarray(Image.open(tmp_path / name)) / 255
        scene = gs.open_scene(tmp_path / name)
        # the exponent is stored in 1/256 or 1/65536: ln(255) x 1/512 at most
        np.testing.assert_allclose(scene.content.shading, stored**gamma, atol=2e-3)


def test_a_grey_picture_with_a_colour_profile_and_the_reverse(tmp_path):
    grey = CODES[..., 0]
    Image.fromarray(grey).save(tmp_path / "a.jpg", icc_profile=profiles()["adobe"], quality=100)
    stored = np.asarray(Image.open(tmp_path / "a.jpg")) / 255
    scene = gs.open_scene(tmp_path / "a.jpg")
    np.testing.assert_allclose(scene.content.shading, stored ** (563 / 256), rtol=1e-4)
    Image.fromarray(CODES).save(
        tmp_path / "a.png", icc_profile=imagecodecs.cms_profile("gray", gamma=2.2)
    )
    (note,) = gs.open_scene(tmp_path / "a.png").notes
    assert note.startswith("colour profile not used") and "GRAY" in note


@pytest.mark.parametrize(
    "damage", [lambda p: p[:200], lambda p: b"junk", lambda p: p[:128] + bytes(len(p) - 128)]
)
def test_a_damaged_profile_is_a_note(tmp_path, damage):
    Image.fromarray(CODES).save(tmp_path / "a.jpg", icc_profile=damage(profiles()["adobe"]))
    scene = gs.open_scene(tmp_path / "a.jpg")
    assert any(note.startswith("colour profile not used") for note in scene.notes)


def table_profile():
    """A profile of tables, mft2, by ICC.1: red and blue exchanged, otherwise XYZ = D50-adapted sRGB-like."""
    grid = 2
    places = np.stack(np.meshgrid(*[np.linspace(0, 1, grid)] * 3, indexing="ij"), -1).reshape(-1, 3)
    to_xyz = np.array(
        [
            [0.4360747, 0.3850649, 0.1430804],
            [0.2225045, 0.7168786, 0.0606169],
            [0.0139322, 0.0971045, 0.7141733],
        ]
    )
    clut = np.clip(places[:, ::-1] @ to_xyz.T / (1 + 32767 / 32768), 0, 1)
    ramp = np.array([0, 65535], ">u2").tobytes()
    body = b"mft2" + bytes(4) + bytes([3, 3, grid, 0])
    body += struct.pack(">9i", *(65536 * np.eye(3, dtype=int).ravel())) + struct.pack(">HH", 2, 2)
    body += 3 * ramp + np.round(65535 * clut).astype(">u2").tobytes() + 3 * ramp
    start = icc_profile(gs.open_display("srgb"))
    count = struct.unpack_from(">I", start, 128)[0]
    tags = {}
    for number in range(count):
        name, at, size = struct.unpack_from(">4sII", start, 132 + 12 * number)
        if name in (b"desc", b"cprt", b"wtpt"):
            tags[name] = start[at : at + size]
    tags[b"A2B0"] = body
    table, data = b"", b""
    for name, tag in tags.items():
        table += struct.pack(">4sII", name, 132 + 12 * len(tags) + len(data), len(tag))
        data += tag + bytes(-len(tag) % 4)
    data = struct.pack(">I", len(tags)) + table + data
    return struct.pack(">I", 128 + len(data)) + start[4:8] + b"\x02\x40\0\0" + start[12:128] + data


def test_a_profile_of_tables_goes_through_littlecms(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=table_profile())
    scene = gs.open_scene(tmp_path / "a.png")
    # linear light with red and blue exchanged; sRGB of 8 bits: half a code of slope up to 2.4/255 at white
    np.testing.assert_allclose(colours(scene), CODES[..., ::-1] / 255, atol=6e-3)
    assert any("8 bits" in note for note in scene.notes)


def test_cmyk_is_refused_in_a_line(tmp_path):
    Image.fromarray(CODES).convert("CMYK").save(tmp_path / "a.jpg")
    with refused("a.jpg", "CMYK", "convert it to RGB", error=BadFile):
        gs.open_scene(tmp_path / "a.jpg")


# ---- chunks of PNG


def test_linear_gamma_in_16_bits(tmp_path):
    """The grey of 18 %: 11796 of 65535."""
    scene = opened(tmp_path, png(np.full((8, 8), 11796, np.uint16), gama(1.0)))
    np.testing.assert_allclose(scene.content.shading, 11796 / 65535, rtol=1e-6)
    assert scene.notes == ()


@pytest.mark.parametrize("exponent", [1.0, 1.8, 2.2, 2.6])
@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_gamma(tmp_path, exponent, deep, channels):
    codes = RANDOM.integers(0, 256, (6, 8, channels)).astype(np.uint16 if deep else np.uint8)
    if deep:
        codes = codes * 257
    if channels in (2, 4):
        codes[..., -1] = 65535 if deep else 255
    scene = opened(tmp_path, png(codes, gama(exponent)))
    own = 3 if channels > 2 else 1
    # gAMA has five decimals: 1e5 / gamma is rounded
    wanted = (codes[..., :own] / (65535 if deep else 255)) ** (1e5 / round(1e5 / exponent))
    found = colours(scene) if own == 3 else scene.content.shading[..., None]
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("space, gamma", [("Adobe RGB (1998)", 563 / 256), ("ITU-R BT.2020", 2.4)])
def test_gamma_and_primaries(tmp_path, space, gamma):
    held = colour.RGB_COLOURSPACES[space]
    scene = opened(tmp_path, png(CODES, gama(gamma), chrm(held.whitepoint, *held.primaries)))
    wanted = linear_in(space, (CODES / 255) ** gamma)
    # white of D65's table (2e-5 in x, y), matrices of the standards of four digits, five of gAMA
    np.testing.assert_allclose(colours(scene), wanted, atol=1e-3)


@pytest.mark.parametrize(
    "chunks, wanted",
    [
        (
            [(b"cICP", bytes([1, 8, 0, 1])), iccp(LINEAR_SRGB), (b"sRGB", b"\0"), gama(1.8)],
            "linear",
        ),
        ([iccp(LINEAR_SRGB), (b"sRGB", b"\0"), gama(1.8)], "linear"),
        ([(b"sRGB", b"\0"), gama(1.8)], "srgb"),
        ([gama(1.8)], 1.8),
        ([], "srgb"),
        ([(b"cICP", bytes([1, 8, 1, 1])), (b"sRGB", b"\0")], "srgb"),  # YCbCr: not allowed in PNG
        ([(b"cICP", bytes([99, 8, 0, 1])), gama(1.8)], 1.8),
        ([iccp(b"junk"), gama(1.8)], 1.8),
        ([(b"gAMA", bytes(4))], "srgb"),
    ],
)
def test_precedence(tmp_path, chunks, wanted):
    scene = opened(tmp_path, png(CODES, *chunks))
    code = CODES / 255
    light = {"linear": code, "srgb": gs.open_display("srgb").decode(code), 1.8: code**1.8}[wanted]
    np.testing.assert_allclose(colours(scene), light, atol=1e-4)
    has_wrong = any(bad in chunks for bad in ((b"gAMA", bytes(4)), iccp(b"junk"))) or (
        any(
            (kind == b"cICP" and body[1:] != bytes([8, 0, 1])) or body[:1] == b"c"
            for kind, body in chunks
        )
    )
    assert any("not used" in note for note in scene.notes) == (
        has_wrong or (b"cICP", bytes([99, 8, 0, 1])) in chunks
    )


@pytest.mark.parametrize(
    "points, space, curve",
    [
        ((12, 13, 0, 1), "Display P3", colour.models.eotf_sRGB),
        ((9, 1, 0, 1), "ITU-R BT.2020", colour.models.oetf_inverse_BT709),
        ((1, 4, 0, 1), "sRGB", lambda code: code**2.2),
        ((9, 16, 0, 1), "ITU-R BT.2020", lambda code: colour.models.eotf_ST2084(code) / 203),
        (
            (9, 18, 0, 1),
            "ITU-R BT.2020",
            lambda code: (
                colour.models.oetf_inverse_BT2100_HLG(code)
                / colour.models.oetf_inverse_BT2100_HLG(0.75)
            ),
        ),
    ],
)
def test_code_points_as_colour_science_decodes_them(tmp_path, points, space, curve):
    codes = (120 + CODES // 16).astype(np.uint8)  # near grey: steep curves
    scene = opened(tmp_path, png(codes, (b"cICP", bytes(points))))
    wanted = linear_in(space, curve(codes / 255))
    # four digits of constants and matrices; HLG's c and BT.709's 0.099 are rounded by either
    np.testing.assert_allclose(colours(scene), wanted, atol=2e-3, rtol=2e-3)
    white = xyz(energy_from_photons(scene.illuminant))[1]
    assert white == pytest.approx(203 if points[1] == 16 else 100, rel=1e-9)


def test_limited_range(tmp_path):
    """Black is code 16 and white 235 of 8 bits; 256 times that of 16."""
    for codes in (np.uint8([[16, 235, 126]]), np.uint16([[16 * 256, 235 * 256, 126 * 256]])):
        scene = opened(tmp_path, png(codes, (b"cICP", bytes([1, 8, 0, 0]))))
        np.testing.assert_allclose(scene.content.shading[0], [0, 1, 110 / 219], atol=1e-6)


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_transparent_grey(tmp_path, bits):
    """tRNS has the stored number; the first column has it."""
    most, clear = 2**bits - 1, 1 if bits < 16 else 30_000
    codes = np.array([[clear, 0, most, 0], [clear, most, 0, 0]], np.uint16)
    if bits == 16:
        data = codes.astype(">u2").view(np.uint8).reshape(2, -1)
    else:
        spread = np.stack([codes >> shift & 1 for shift in range(bits - 1, -1, -1)], -1)
        data = np.packbits(spread.reshape(2, -1).astype(np.uint8), axis=1)
    lines = zlib.compress(np.pad(data, ((0, 0), (1, 0))).tobytes())
    head = struct.pack(">IIBBBBB", 4, 2, bits, 0, 0, 0, 0)
    scene = opened(
        tmp_path,
        png_of(
            [(b"IHDR", head), (b"tRNS", struct.pack(">H", clear)), (b"IDAT", lines), (b"IEND", b"")]
        ),
    )
    found = scene.content.shading
    wanted = gs.open_display("srgb").decode(codes / most)
    wanted[codes == clear] = 0
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert any("transparent" in note for note in scene.notes)


@pytest.mark.parametrize("deep", [False, True])
def test_transparent_colour(tmp_path, deep):
    codes = CODES.astype(np.uint16) * 200 if deep else CODES
    clear = struct.pack(">3H", *codes[2, 3].tolist())
    scene = opened(tmp_path, png(codes, (b"tRNS", clear)))
    found = colours(scene)
    assert (found[2, 3] == 0).all() and (found > 0).all(axis=-1).sum() == found.shape[
        0
    ] * found.shape[1] - 1


def test_other_chunks_are_noted_and_the_idle_ones_are_not(tmp_path):
    idle = [
        (b"tEXt", b"Software\0me"),
        (b"pHYs", struct.pack(">IIB", 2835, 2834, 1)),
        (b"tIME", bytes(7)),
    ]
    assert opened(tmp_path, png(CODES, *idle)).notes == ()
    scene = opened(
        tmp_path,
        png(
            CODES,
            (b"mDCV", bytes(24)),
            (b"cLLI", bytes(8)),
            (b"pHYs", struct.pack(">IIB", 200, 100, 0)),
        ),
    )
    assert "chunks not used: mDCV, cLLI" in scene.notes
    assert any("200 x 100" in note and "square" in note for note in scene.notes)
    animated = io.BytesIO()
    Image.fromarray(CODES).save(
        animated, "PNG", save_all=True, append_images=[Image.fromarray(255 - CODES)]
    )
    scene = opened(tmp_path, animated.getvalue())
    assert scene.notes == ("an animation: its first picture is used",)


# ---- EXIF


@pytest.mark.parametrize(
    "space, index, is_adobe, has_note",
    [
        (0xFFFF, "R03", True, False),
        (2, None, True, False),
        (1, "R98", False, False),
        (0xFFFF, None, False, True),
    ],
)
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_adobe_rgb_by_exif(tmp_path, space, index, is_adobe, has_note, name):
    if name == "a.tif" and index == "R03":
        pytest.skip("Pillow writes no directory of interoperability into a TIFF")
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = space
    if index:
        exif.get_ifd(0x8769)[0xA005] = {1: index}
    written = Image.Exif()
    written.load(exif.tobytes())  # with the directories inside
    options = {"quality": 95} if name == "a.jpg" else {}
    Image.fromarray(CODES).save(tmp_path / name, exif=written, **options)
    stored = np.asarray(Image.open(tmp_path / name))
    scene = gs.open_scene(tmp_path / name)
    wanted = gs.open_display("srgb").decode(stored / 255)
    if is_adobe:
        wanted = linear_in("Adobe RGB (1998)", (stored / 255) ** (563 / 256))
    np.testing.assert_allclose(colours(scene), wanted, atol=1e-3)
    assert any("EXIF" in note for note in scene.notes) == has_note


def test_further_pictures_of_a_phone_are_noted(tmp_path):
    """Two pictures in one JPEG (MPF), as Pillow writes them."""
    first, second = Image.fromarray(CODES), Image.fromarray(255 - CODES)
    first.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[second])
    scene = gs.open_scene(tmp_path / "a.jpg")
    assert any("further pictures" in note and "1 of them" in note for note in scene.notes)


def test_what_gpusim_writes_for_a_display_is_read_in_its_colours(tmp_path):
    """Codes of Display P3, of 8 and 16 bits, by the display's own matrix of colour-science."""
    from gpusim.io.frame.images import write_png

    for codes in (CODES, CODES.astype(np.uint16) * 257):
        write_png(tmp_path / "a.png", codes, gs.open_display("display-p3"))
        wanted = linear_in("Display P3", colour.models.eotf_sRGB(CODES / 255))
        np.testing.assert_allclose(colours(gs.open_scene(tmp_path / "a.png")), wanted, atol=1e-3)
