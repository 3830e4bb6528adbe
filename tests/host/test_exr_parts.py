"""OpenEXR files with windows, parts, views, layers and attributes, as other programs write them.

Files are written by OpenEXR's module and by OpenImageIO, with the names that Blender, Nuke, Arnold,
V-Ray, PBRT, Mitsuba and Houdini give to parts and channels.
"""

import struct

import numpy as np
import OpenEXR
import pytest
from refusals import refused

import gpusim as gs
from gpusim.data.colorimetry import xyz
from gpusim.domain.errors import BadFile, OutOfRange, UnknownName
from gpusim.domain.spectrum import energy_from_photons
from gpusim.io.exr import read_exr

RANDOM = np.random.default_rng(11)
ROWS, COLS = 6, 8


def plane(value=None, shape=(ROWS, COLS)):
    """A plane of random numbers, or of one."""
    if value is None:
        return RANDOM.uniform(0.1, 0.9, shape).astype(np.float32)
    return np.full(shape, value, np.float32)


def rgb(prefix="", value=None, letters="RGB", shape=(ROWS, COLS)):
    return {prefix + letter: plane(value, shape) for letter in letters}


def window(left, top, cols, rows):
    return (
        np.array([left, top], np.int32),
        np.array([left + cols - 1, top + rows - 1], np.int32),
    )


def write(path, *parts, **attributes):
    """Write parts (header, channels), or the channels of one part, by OpenEXR's module."""
    made = []
    for number, part in enumerate(parts):
        header, channels = part if isinstance(part, tuple) else ({}, part)
        channels = dict(channels)  # OpenEXR puts its own objects into it
        header = {"type": OpenEXR.scanlineimage, **attributes, **header}
        if len(parts) > 1:
            header.setdefault("name", f"part{number}")
        made.append(OpenEXR.Part(header, channels, header.get("name", "")))
    if len(made) == 1:
        OpenEXR.File(made[0].header, made[0].channels).write(str(path))
    else:
        OpenEXR.File(made).write(str(path))
    return path


def colours(scene):
    """Linear sRGB of a scene's picture, (rows, cols, 3)."""
    return np.moveaxis(scene.content.coefficients, 0, -1)


def white_of(scene):
    return xyz(energy_from_photons(scene.illuminant))[1]


def said(scene, *words):
    """Whether a note has all these words."""
    return any(all(word in note for word in words) for note in scene.notes)


# ---- windows


@pytest.mark.parametrize(
    "data, display, notes",
    [
        ((60, 40, COLS, ROWS), (0, 0, 96, 64), ["black outside"]),  # border render
        ((-2, -1, COLS, ROWS), (0, 0, 4, 4), ["cut at the frame"]),  # overscan on all sides
        ((-2, 2, COLS, ROWS), (0, 0, 20, 5), ["black outside", "cut at the frame"]),
        ((10, 5, COLS, ROWS), (10, 5, COLS, ROWS), []),  # a crop of Nuke's, which is its own frame
        ((100, 50, COLS, ROWS), (98, 48, 12, 12), ["black outside"]),
    ],
)
def test_the_display_window_is_the_frame(tmp_path, data, display, notes):
    """Colours, depth and labels of each pixel, by its column and row in the file's coordinates."""
    stored, far = rgb(), plane()
    ids = RANDOM.integers(1, 99, (ROWS, COLS)).astype(np.uint32)
    write(
        tmp_path / "a.exr",
        stored | {"Z": far, "label.instance": ids},
        dataWindow=window(*data),
        displayWindow=window(*display),
    )
    scene = gs.open_scene(tmp_path / "a.exr")
    assert scene.shape == (display[3], display[2])
    found = colours(scene)
    for row in range(display[3]):
        for col in range(display[2]):
            y, x = row + display[1] - data[1], col + display[0] - data[0]
            is_inside = 0 <= y < ROWS and 0 <= x < COLS
            wanted = [stored[key][y, x] for key in "RGB"] if is_inside else [0, 0, 0]
            np.testing.assert_array_equal(found[row, col], wanted)
            assert scene.depth[row, col] == (far[y, x] if is_inside else 1e6)
            assert scene.labels["instance"][row, col] == (ids[y, x] if is_inside else 0)
    assert [word for word in ("black outside", "cut at the frame") if said(scene, word)] == notes


def test_openimageio_sees_the_same_frame(tmp_path):
    import OpenImageIO as oiio

    write(
        tmp_path / "a.exr",
        rgb(),
        dataWindow=window(-3, 2, COLS, ROWS),
        displayWindow=window(0, 0, 9, 7),
    )
    seen = oiio.ImageBufAlgo.crop(oiio.ImageBuf(str(tmp_path / "a.exr")), oiio.ROI(0, 9, 0, 7))
    found = colours(gs.open_scene(tmp_path / "a.exr"))
    np.testing.assert_array_equal(found, seen.get_pixels(oiio.FLOAT))


def test_bands_of_a_spectral_file_have_a_frame_too(tmp_path):
    write(
        tmp_path / "a.exr",
        {"T.500nm": plane(0.5), "T.600nm": plane(0.25)},
        dataWindow=window(1, 0, COLS, ROWS),
        displayWindow=window(0, 0, COLS + 1, ROWS),
    )
    values = gs.open_scene(tmp_path / "a.exr").content.values
    np.testing.assert_array_equal(values[:, 0, :2], [[0, 0.5], [0, 0.25]])


def test_nothing_in_the_frame_is_refused(tmp_path):
    write(
        tmp_path / "a.exr",
        rgb(),
        dataWindow=window(50, 0, COLS, ROWS),
        displayWindow=window(0, 0, 20, 20),
    )
    with refused("a.exr", "data window", "display window", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")


def test_pixels_that_are_not_square_are_refused(tmp_path):
    for aspect, remedy in ((2.0, "more columns"), (0.5, "fewer columns"), (1.001, "more columns")):
        write(tmp_path / "a.exr", rgb(), pixelAspectRatio=aspect)
        with refused("a.exr", f"pixelAspectRatio = {aspect:g}", remedy, error=BadFile):
            gs.open_scene(tmp_path / "a.exr")
    write(tmp_path / "a.exr", rgb(), pixelAspectRatio=0.99999)  # rounded by some writers
    gs.open_scene(tmp_path / "a.exr")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_openimageios_orientation_turns_the_frame(tmp_path, orientation):
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(COLS, ROWS, 3, "float")
    spec.attribute("Orientation", orientation)
    stored = RANDOM.random((ROWS, COLS, 3), np.float32)
    out = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    out.open(str(tmp_path / "a.exr"), spec)
    out.write_image(stored)
    out.close()
    turned = oiio.ImageBufAlgo.reorient(oiio.ImageBuf(str(tmp_path / "a.exr")))
    found = colours(gs.open_scene(tmp_path / "a.exr"))
    np.testing.assert_array_equal(found, turned.get_pixels(oiio.FLOAT))


# ---- parts


def test_depth_in_another_part_is_the_scenes(tmp_path):
    for name in ("depth", "Z", "rgba_depth"):
        stored, far = rgb(), plane()
        write(tmp_path / "a.exr", ({"name": "rgba"}, stored), ({"name": name}, {"Z": far}))
        scene = gs.open_scene(tmp_path / "a.exr")
        np.testing.assert_array_equal(scene.depth, far)
        np.testing.assert_array_equal(colours(scene)[..., 1], stored["G"])
        assert not said(scene, "not used")


def test_openimageios_subimages(tmp_path):
    """Beauty, then an albedo, then a depth of one channel, which OpenImageIO calls Y by default."""
    import OpenImageIO as oiio

    path = str(tmp_path / "a.exr")
    beauty, albedo, far = plane(shape=(ROWS, COLS, 3)), plane(shape=(ROWS, COLS, 3)), plane()
    specs = []
    for name, image, channels in (
        ("beauty", beauty, "RGB"),
        ("albedo", albedo, "RGB"),
        ("depth", far[..., None], "Y"),
    ):
        spec = oiio.ImageSpec(COLS, ROWS, image.shape[2], "float")
        spec.channelnames = tuple(channels)
        spec.attribute("oiio:subimagename", name)
        specs.append((spec, image))
    out = oiio.ImageOutput.create(path)
    assert out.open(path, tuple(spec for spec, _ in specs)), out.geterror()
    for number, (spec, image) in enumerate(specs):
        if number:
            assert out.open(path, spec, "AppendSubimage"), out.geterror()
        out.write_image(image)
    out.close()
    scene = gs.open_scene(path)
    np.testing.assert_array_equal(colours(scene), beauty)
    np.testing.assert_array_equal(scene.depth, far)
    assert said(scene, "not used", "albedo")
    np.testing.assert_array_equal(colours(gs.open_scene(path, layer="albedo")), albedo)
    for part in (1, "1", "albedo"):
        scene = gs.open_scene(path, part=part)
        np.testing.assert_array_equal(colours(scene), albedo)
        assert scene.depth is None and said(scene, "parts not used: beauty, depth")
    with refused("part of", "'albdo'", "albedo", error=UnknownName):
        gs.open_scene(path, part="albdo")
    with refused("part of", "'3'", error=UnknownName):
        gs.open_scene(path, part=3)


def test_the_picture_may_be_in_any_part(tmp_path):
    """Passes in alphabetic order, as Houdini's and Blender's: the part's name says which it is."""
    stored = rgb()
    write(
        tmp_path / "a.exr",
        ({"name": "N"}, {"X": plane(-1), "Y": plane(-1), "Z": plane(-1)}),
        ({"name": "albedo"}, rgb()),
        ({"name": "rgba"}, stored),
        ({"name": "depth"}, {"Z": plane(3)}),
    )
    scene = gs.open_scene(tmp_path / "a.exr")
    np.testing.assert_array_equal(colours(scene)[..., 0], stored["R"])
    assert (scene.depth == 3).all() and said(scene, "channels not used: N, albedo")


def test_parts_of_different_data_windows_share_the_frame(tmp_path):
    far, display = plane(2.0, (3, 4)), window(0, 0, COLS, ROWS)
    write(
        tmp_path / "a.exr",
        ({"name": "rgba", "dataWindow": window(0, 0, COLS, ROWS)}, rgb()),
        ({"name": "depth", "dataWindow": window(2, 1, 4, 3)}, {"Z": far}),
        displayWindow=display,
    )
    depth = gs.open_scene(tmp_path / "a.exr").depth
    wanted = np.full((ROWS, COLS), 1e6)
    wanted[1:4, 2:6] = 2
    np.testing.assert_array_equal(depth, wanted)


def test_spectral_bands_in_a_part_of_their_own(tmp_path):
    write(
        tmp_path / "a.exr",
        ({"name": "preview"}, rgb()),
        ({"name": "spectra"}, {"S0.500,0nm": plane(1), "S0.600,0nm": plane(2)}),
        emissiveUnits="W.m^-2.sr^-1.nm^-1",
    )
    scene = gs.open_scene(tmp_path / "a.exr")
    np.testing.assert_array_equal(scene.wavelengths, [500, 600])
    assert said(scene, "not used", "R")


# ---- views


def stereo(style):
    """Header and channels, and the picture of left and right."""
    left, right = rgb(), rgb()
    at = {"left": left, "right": right}
    if style == "multiView":  # the first view has no prefix
        channels = left | {f"right.{key}": value for key, value in right.items()}
        return [
            ({"multiView": ["left", "right"]}, channels | {"Z": plane(1), "right.Z": plane(2)})
        ], at
    if style == "prefixes":
        both = {f"{view}.{key}": at[view][key] for view in at for key in "RGB"}
        return [({}, both | {"left.Z": plane(1), "right.Z": plane(2)})], at
    if style == "blender":  # ViewLayer.Combined.left.R
        both = {f"ViewLayer.Combined.{view}.{key}": at[view][key] for view in at for key in "RGB"}
        return [
            (
                {"multiView": ["left", "right"]},
                both | {"ViewLayer.Depth.left.Z": plane(1), "ViewLayer.Depth.right.Z": plane(2)},
            )
        ], at
    if style == "names of parts":
        return [({"name": view}, at[view] | {"Z": plane(n)}) for n, view in enumerate(at, 1)], at
    return [
        ({"name": f"{name}.{view}", "view": view}, channels)
        for view, distance in (("left", 1), ("right", 2))
        for name, channels in (("rgba", at[view]), ("depth", {"Z": plane(distance)}))
    ], at


@pytest.mark.parametrize("style", ["multiView", "prefixes", "blender", "parts", "names of parts"])
def test_views(tmp_path, style):
    parts, at = stereo(style)
    write(tmp_path / "a.exr", *parts)
    for view, wanted, distance, other in (
        (None, "left", 1, "right"),
        ("left", "left", 1, "right"),
        ("right", "right", 2, "left"),
    ):
        scene = gs.open_scene(tmp_path / "a.exr", view=view)
        for index, key in enumerate("RGB"):
            np.testing.assert_array_equal(colours(scene)[..., index], at[wanted][key])
        assert (scene.depth == distance).all()
        assert said(scene, f"view {wanted!r}", f"not used: {other}")
        assert not said(scene, "parts not used") and not said(scene, "channels not used")
    with refused("view of", "'centre'", "left", "right", error=UnknownName):
        gs.open_scene(tmp_path / "a.exr", view="centre")


def test_a_file_without_views_refuses_one(tmp_path):
    write(tmp_path / "a.exr", rgb())
    with refused("a.exr", "view = 'left'", "no views", error=BadFile):
        gs.open_scene(tmp_path / "a.exr", view="left")


def test_views_of_other_names(tmp_path):
    """Three cameras; one has a dot in its layer."""
    at = {view: rgb() for view in ("main", "top", "side")}
    channels = at["main"] | {
        f"{view}.{key}": at[view][key] for view in ("top", "side") for key in "RGB"
    }
    channels |= {f"diffuse.{view}.{key}": plane(0.5) for view in at for key in "RGB"}
    write(tmp_path / "a.exr", ({"multiView": ["main", "top", "side"]}, channels))
    scene = gs.open_scene(tmp_path / "a.exr", view="side")
    np.testing.assert_array_equal(colours(scene)[..., 2], at["side"]["B"])
    assert said(scene, "not used: main, top") and said(scene, "channels not used: diffuse")
    scene = gs.open_scene(tmp_path / "a.exr", view="top", layer="diffuse")
    assert (colours(scene) == 0.5).all()


# ---- layers


@pytest.mark.parametrize(
    "passes, chosen",
    [
        (["R", "diffuse.R", "albedo.R"], "R"),  # the picture itself
        (
            ["ViewLayer.Combined.R", "ViewLayer.DiffCol.R", "ViewLayer.Env.R"],
            "ViewLayer.Combined.R",
        ),
        (["Beauty.R", "Beauty_Diffuse.R"], "Beauty.R"),
        (["rgba.red", "specular.red"], "rgba.red"),  # Nuke
        (["C.r", "Ci.r"], "C.r"),  # Houdini
        (["image.R"], "image.R"),  # Mitsuba's nested integrator
    ],
)
def test_the_picture_among_passes(tmp_path, passes, chosen):
    channels = {}
    for name in passes:
        layer, _, first = name.rpartition(".")
        words = {"R": "RGB", "r": "rgb"}.get(first, ("red", "green", "blue"))
        value = 0.25 if name == chosen else 0.75
        channels |= {f"{layer}.{word}".lstrip("."): plane(value) for word in words}
    write(tmp_path / "a.exr", channels | {"N.X": plane(-1), "N.Y": plane(-1), "N.Z": plane(-1)})
    scene = gs.open_scene(tmp_path / "a.exr")
    assert (colours(scene) == 0.25).all()
    others = [name.rpartition(".")[0] for name in passes if name != chosen]
    assert said(scene, "channels not used", "N", *others)


def blender():
    """A multilayer of two view layers; the second was rendered with other objects."""
    channels = {}
    for layer, value in (("fog", 0.25), ("near", 0.5)):
        channels |= rgb(f"{layer}.Combined.", value) | {f"{layer}.Combined.A": plane(1)}
        channels |= {f"{layer}.Depth.Z": plane(8 * value), f"{layer}.IndexOB.X": plane(16 * value)}
        channels |= rgb(f"{layer}.DiffCol.", 0.9)
    return channels


def test_two_view_layers_are_a_choice(tmp_path):
    write(tmp_path / "a.exr", blender())
    with refused("a.exr", "2 pictures", "fog", "near", "layer=", "--layer", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")
    for layer, value, other in (("fog", 0.25, "near"), ("near.Combined", 0.5, "fog")):
        scene = gs.open_scene(tmp_path / "a.exr", layer=layer)
        assert (colours(scene) == value).all() and (scene.depth == 8 * value).all()
        assert (scene.labels["instance"] == 16 * value).all()
        assert said(scene, "channels not used", f"{other}.Combined", f"{other}.Depth", "DiffCol")
    with refused("layer of", "'fgo'", "fog", error=UnknownName):
        gs.open_scene(tmp_path / "a.exr", layer="fgo")
    scene = gs.open_scene(tmp_path / "a.exr", layer="near.DiffCol")
    assert (colours(scene) == np.float32(0.9)).all() and (scene.depth == 4).all()


def test_two_view_layers_in_parts(tmp_path):
    channels = blender()
    parts = [
        (
            {"name": place},
            {
                key.rpartition(".")[2]: value
                for key, value in channels.items()
                if key.startswith(place)
            },
        )
        for place in dict.fromkeys(key.rpartition(".")[0] for key in channels)
    ]
    write(tmp_path / "a.exr", *parts)
    with refused("2 pictures", "fog", "near", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")
    scene = gs.open_scene(tmp_path / "a.exr", layer="near")
    assert (colours(scene) == 0.5).all() and (scene.depth == 4).all()


def test_the_command_line_chooses(tmp_path, capsys):
    from gpusim.cli.main import main

    write(tmp_path / "a.exr", {key: np.tile(value, (2, 2)) for key, value in blender().items()})
    asked = ["simulate", str(tmp_path / "a.exr"), "--camera", "mono", "--device", "numpy"]
    assert main(asked) == 2 and "--layer" in capsys.readouterr().err
    assert main([*asked, "--layer", "near"]) == 0
    assert "note: channels not used: fog.Combined" in capsys.readouterr().out
    assert main([*asked, "--layer", "near", "--part", "1"]) == 2
    assert "unknown part" in capsys.readouterr().err
    assert main([*asked, "--layer", "near", "--view", "left"]) == 2


def test_ids_alpha_and_passes_are_noted(tmp_path):
    coverage = plane(1.0)
    names = [f"CryptoObject{number:02d}.{key}" for number in range(3) for key in "rgba"]
    names += [f"ViewLayer.CryptoMaterial00.{key}" for key in "RGBA"]
    channels = (
        rgb() | {name: plane() for name in names} | {"A": coverage, "u": plane(), "noise": plane()}
    )
    header = {
        "cryptomatte/d593dd7/name": "CryptoObject",
        "cryptomatte/d593dd7/hash": "MurmurHash3_32",
        "cryptomatte/d593dd7/manifest": "{}",
    }
    write(tmp_path / "a.exr", (header, channels))
    scene = gs.open_scene(tmp_path / "a.exr")
    assert said(scene, "object ids (Cryptomatte)", "CryptoObject00", "ViewLayer.CryptoMaterial00")
    assert said(scene, "channels not used: noise, u")
    assert not said(scene, "transparent")
    coverage[2, 3] = 0.5
    write(tmp_path / "a.exr", (header, channels))
    assert said(gs.open_scene(tmp_path / "a.exr"), "'A'", "transparent")


def test_choices_are_for_exr_only(tmp_path):
    for option in ("part", "layer", "view"):
        with refused(option, "for .exr", error=OutOfRange):
            gs.open_scene("flat", **{option: "left"})


# ---- grey, luminance and chroma


@pytest.mark.parametrize("channels", [("Y",), ("Y", "A"), ("Y", "Z")])
def test_luminance_only_is_grey(tmp_path, channels):
    stored = {name: plane() for name in channels}
    write(tmp_path / "a.exr", stored)
    scene = gs.open_scene(tmp_path / "a.exr")
    np.testing.assert_array_equal(scene.content.shading, stored["Y"])
    assert (scene.content.spectra == 1).all()  # as light as it says at every wavelength
    if "Z" in channels:
        np.testing.assert_array_equal(scene.depth, stored["Z"])


def write_chroma(path, luminance, red, blue, header=b""):
    """Write an uncompressed file of Y, and RY and BY of every second pixel, by the file layout."""
    rows, cols = luminance.shape
    channels = b"".join(
        name + b"\0" + struct.pack("<iB3xii", 2, 0, step, step)
        for name, step in ((b"BY", 2), (b"RY", 2), (b"Y", 1))
    )
    box = struct.pack("<4i", 0, 0, cols - 1, rows - 1)
    attributes = [
        (b"channels", b"chlist", channels + b"\0"),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", box),
        (b"displayWindow", b"box2i", box),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", bytes(8)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    head = struct.pack("<ii", 20000630, 2) + header
    head += b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(body)) + body
        for name, kind, body in attributes
    )
    head += b"\0"
    lines, places, at = [], [], len(head) + 8 * rows
    for row in range(rows):
        data = b"".join(plane[row // 2].tobytes() for plane in (blue, red) if row % 2 == 0)
        data += luminance[row].tobytes()
        places.append(at)
        lines.append(struct.pack("<ii", row, len(data)) + data)
        at += len(lines[-1])
    path.write_bytes(head + struct.pack(f"<{rows}Q", *places) + b"".join(lines))


# luminance of the primaries of Rec. 709, by ITU-R BT.709-6, of four digits; and of BT.2020
@pytest.mark.parametrize(
    "weights, primaries",
    [
        ((0.2126, 0.7152, 0.0722), None),
        ((0.2627, 0.6780, 0.0593), (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)),
    ],
)
def test_luminance_and_chroma_are_decoded(tmp_path, weights, primaries):
    """Y of all pixels, chroma that changes linearly over the middle: interpolation keeps it.

    A symmetric filter whose weights add up to 1 returns a line as it is; near the edges, where the
    outermost samples are repeated, it does not. OpenEXR's weights have six digits.
    """
    rows, cols = 44, 48
    y, x = np.indices((rows, cols))
    chroma = {
        "R": 0.3 * x / cols - 0.1 * y / rows,
        "B": 0.2 - 0.3 * x / cols,
    }  # (R - Y) / Y, (B - Y) / Y
    luminance = RANDOM.uniform(0.2, 0.6, (rows, cols)).astype(np.float32)
    wanted = {key: (1 + part) * luminance for key, part in chroma.items()}
    wanted["G"] = (luminance - weights[0] * wanted["R"] - weights[2] * wanted["B"]) / weights[1]
    halved = [chroma[key][::2, ::2].astype(np.float32) for key in "RB"]
    header = b""
    if primaries:
        header = b"chromaticities\0chromaticities\0" + struct.pack("<i8f", 32, *primaries)
    write_chroma(tmp_path / "a.exr", luminance, *halved, header)
    found = read_exr(tmp_path / "a.exr")
    linear = np.stack([wanted[key] for key in "RGB"])
    if primaries:
        import colour

        space = colour.RGB_COLOURSPACES["ITU-R BT.2020"]
        to_srgb = colour.matrix_RGB_to_RGB(space, colour.RGB_COLOURSPACES["sRGB"], "Bradford")
        linear = np.einsum("ij,jkl->ikl", to_srgb, linear)
    # weights of four digits, of which green takes up to (R + B) / weight; white point of D65's table
    inner = np.s_[:, 14:-15, 14:-15]
    np.testing.assert_allclose(found.values[inner], linear[inner], atol=4e-4)
    assert found.kind == "rgb" and not found.notes
    # near the edges: half of the largest step of the chroma, and the filter's overshoot
    np.testing.assert_allclose(found.values, linear, atol=0.02)


def test_chroma_of_all_pixels(tmp_path):
    """Not subsampled: exact."""
    red, green, blue = 0.2, 0.5, 0.3
    luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    write(
        tmp_path / "a.exr",
        {
            "Y": plane(luminance),
            "RY": plane((red - luminance) / luminance),
            "BY": plane((blue - luminance) / luminance),
        },
    )
    # four digits of the weights
    np.testing.assert_allclose(
        colours(gs.open_scene(tmp_path / "a.exr"))[0, 0], [red, green, blue], atol=1e-4
    )


# ---- attributes


def test_white_luminance_is_the_luminance_of_white(tmp_path):
    for channels in (rgb(), {"Y": plane()}):
        write(tmp_path / "a.exr", channels, whiteLuminance=621.0)
        assert white_of(gs.open_scene(tmp_path / "a.exr")) == pytest.approx(621, rel=1e-9)
        assert white_of(gs.open_scene(tmp_path / "a.exr", light="A")) == pytest.approx(
            621, rel=1e-9
        )
        asked = gs.open_scene(tmp_path / "a.exr", luminance=50)
        assert white_of(asked) == pytest.approx(50, rel=1e-9)
        # white (1, 1, 1) reflects all light
        lift = np.ones(3) @ asked.content.basis if "R" in channels else asked.content.spectra[0]
        np.testing.assert_allclose(lift, 1, atol=1e-6)
    for wrong in (0.0, -1.0, float("inf"), float("nan")):
        write(tmp_path / "a.exr", rgb(), whiteLuminance=wrong)
        with refused("whiteLuminance", error=BadFile):
            gs.open_scene(tmp_path / "a.exr")
    write(tmp_path / "a.exr", {"T.500nm": plane(), "T.600nm": plane()}, whiteLuminance=621.0)
    assert said(gs.open_scene(tmp_path / "a.exr"), "attributes not used: whiteLuminance")


def test_environments(tmp_path):
    import OpenImageIO as oiio

    values = RANDOM.random((16, 32, 3), np.float32)
    buffer = oiio.ImageBuf(oiio.ImageSpec(32, 16, 3, "float"))
    buffer.set_pixels(oiio.ROI(0, 32, 0, 16, 0, 1, 0, 3), values)
    path = str(tmp_path / "latlong.exr")  # tiled, with a pyramid of smaller ones
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxEnvLatl, buffer, path), oiio.geterror()
    scene = gs.open_scene(path)
    assert scene.projection == "equirectangular" and scene.shape == (16, 32)
    assert gs.open_scene(path, projection="plane").projection == "plane"
    assert not said(scene, "not used")
    write(tmp_path / "a.exr", rgb() | {"Z": plane(1)}, envmap=OpenEXR.ENVMAP_LATLONG)
    scene = gs.open_scene(tmp_path / "a.exr")
    assert scene.depth is None and said(scene, "'Z'", "panorama")
    write(tmp_path / "a.exr", rgb(), envmap=OpenEXR.ENVMAP_CUBE)
    with refused("a.exr", "cube", "latlong", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")


@pytest.mark.parametrize("mode", ["mip", "tiles"])
def test_tiles_and_pyramids(tmp_path, mode):
    import OpenImageIO as oiio

    values = RANDOM.random((40, 72, 3), np.float32)
    buffer = oiio.ImageBuf(oiio.ImageSpec(72, 40, 3, "float"))
    buffer.set_pixels(oiio.ROI(0, 72, 0, 40, 0, 1, 0, 3), values)
    path = str(tmp_path / "a.exr")
    if mode == "mip":
        assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, buffer, path), oiio.geterror()
    else:
        buffer.set_write_tiles(16, 16)
        assert buffer.write(path)
    np.testing.assert_array_equal(colours(gs.open_scene(path)), values)


@pytest.mark.parametrize(
    "space, name",
    [
        ("lin_ap1_scene", "ACEScg"),
        ("lin_ap0_scene", "ACES2065-1"),
        ("lin_rec2020_scene", "ITU-R BT.2020"),
        ("lin_p3d65_scene", "Display P3"),
        ("lin_adobergb_scene", "Adobe RGB (1998)"),
        ("lin_rec709_scene", "sRGB"),
    ],
)
def test_a_colour_space_that_is_named(tmp_path, space, name):
    """As OpenImageIO names it, without chromaticities: by colour-science's matrix."""
    import colour

    srgb = colour.RGB_COLOURSPACES["sRGB"]
    wanted = RANDOM.uniform(0.05, 1, (ROWS, COLS, 3))
    to = colour.matrix_RGB_to_RGB(srgb, colour.RGB_COLOURSPACES[name], "Bradford")
    theirs = np.einsum("ij,klj->kli", to, wanted).astype(np.float32)
    channels = {key: np.ascontiguousarray(theirs[..., at]) for at, key in enumerate("RGB")}
    write(tmp_path / "a.exr", channels, colorInteropID=space)
    # the white of D65's table differs by 2e-5 in x and y, see test_exr_dialects; digits of primaries
    np.testing.assert_allclose(colours(gs.open_scene(tmp_path / "a.exr")), wanted, atol=4e-4)


def test_a_colour_space_that_is_encoded_is_refused_and_an_unknown_one_noted(tmp_path):
    write(tmp_path / "a.exr", rgb(), colorInteropID="srgb_rec709_scene")
    with refused("colorInteropID", "proportional to light", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")
    write(tmp_path / "a.exr", rgb(), colorInteropID="lin_mine_scene")
    assert said(gs.open_scene(tmp_path / "a.exr"), "attributes not used: colorInteropID")


def test_attributes_without_a_use_are_noted_and_the_idle_ones_are_not(tmp_path):
    write(
        tmp_path / "a.exr",
        rgb(),
        owner="me",
        comments="a test",
        capDate="2026:01:01 00:00:00",
        adoptedNeutral=np.array([0.3127, 0.3290], np.float32),
        screenWindowWidth=1.0,
    )
    assert gs.open_scene(tmp_path / "a.exr").notes == ()
    write(
        tmp_path / "a.exr",
        rgb(),
        adoptedNeutral=np.array([0.4476, 0.4074], np.float32),
        screenWindowWidth=0.7,
        exposureBias=1.5,
    )
    (note,) = gs.open_scene(tmp_path / "a.exr").notes
    head, names = note.split(": ")
    assert head == "attributes not used"
    assert set(names.split(", ")) == {"adoptedNeutral", "screenWindowWidth", "exposureBias"}


@pytest.mark.parametrize("unit", ["W.m^-2.sr^-1.nm^-1", "W.m^-2.sr^-1", "W m^-2 sr^-1 nm^-1"])
def test_units_of_radiance(tmp_path, unit):
    channels = {"S0.500nm": plane(1), "S0.600nm": plane(1)}
    write(tmp_path / "a.exr", channels, emissiveUnits=unit)
    assert not said(gs.open_scene(tmp_path / "a.exr"), "emissiveUnits")
    write(tmp_path / "a.exr", channels, emissiveUnits="cd.m^-2")
    with refused("emissiveUnits", "cd.m^-2", error=BadFile):
        gs.open_scene(tmp_path / "a.exr")
