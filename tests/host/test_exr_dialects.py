"""OpenEXR files of other programs: Indigo, Mitsuba 3, Blender's names, colour-science; depth, primaries."""

import tracemalloc

import numpy as np
import pytest
from refusals import refused
from test_io import plane, write_channels

from gpusim.data.lights import illuminant
from gpusim.data.srgb import SRGB_PRIMARIES
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadFile, OutOfRange, UnknownName
from gpusim.io.exr import read_exr, write_spectral_exr
from gpusim.io.scene.scenes import open_scene

pytestmark = pytest.mark.filterwarnings(
    "ignore:[^$]*Aligning", "ignore:[^$]*Matplotlib"
)  # colour's chatter
RANDOM = np.random.default_rng(5)
PHOTON = 1.98644586e-25  # [J m] h c, CODATA 2018, nine digits
RGB = {name: plane(value) for name, value in zip("RGB", (0.25, 0.5, 0.75), strict=True)}


# ---- spectral layouts


def test_indigos_buckets_are_named_by_their_lower_edge(tmp_path):
    path = tmp_path / "a.exr"
    write_channels(
        path,
        {
            "wavelength400": plane(1e9),
            "wavelength430_25": plane(2e9),
            "wavelength460_5": plane(4e9),
            "R": plane(9),
            "depth": plane(3),
        },
    )
    scene = open_scene(path, depth="none")
    np.testing.assert_allclose(scene.wavelengths, [415.125, 445.375, 475.625], rtol=1e-15)
    # W m-2 sr-1 m-1 are 1e-9 of W m-2 sr-1 nm-1; float32
    wanted = np.array([1, 2, 4]) * scene.wavelengths * 1e-9 / PHOTON
    np.testing.assert_allclose(scene.content.values[:, 2, 3], wanted, rtol=2e-7)
    assert not scene.light_is_known


@pytest.mark.parametrize(
    "channels, problem",
    [
        (["wavelength400", "wavelength430", "wavelength470"], "unequal width"),
        (["wavelength400"], "at least 2"),
        (["wavelength400", "wavelength400_0"], "same wavelength"),
        (["S0.400nm", "S0.500nm", "S1.400nm", "S2.400nm", "S3.400nm"], "'S1.400nm': polarised"),
        (["R", "G", "B", "S1.R"], "polarised"),
        (["T.400nm", "T.500nm", "T.400nm.500nm"], "'T.400nm.500nm': bispectral (fluorescent)"),
        ([f"{layer}.Combined.{c}" for layer in ("near", "far") for c in "RGB"], "(far, near)"),
        (["R", "G", "mask"], "no spectral channels"),
        (["Z", "depth.T"], "no spectral channels"),
    ],
)
def test_refused_in_one_sentence(tmp_path, channels, problem):
    write_channels(tmp_path / "a.exr", {name: plane() for name in channels})
    with refused(tmp_path / "a.exr", problem, error=BadFile):
        open_scene(tmp_path / "a.exr")


def test_the_intensity_of_polarised_light_is_taken_where_it_is_named(tmp_path):
    path = tmp_path / "a.exr"
    write_channels(path, {"S0.400nm": plane(1), "S0.500nm": plane(2), "S1.400nm": plane(-1)})
    scene = open_scene(path, bands={"S0.400nm": 400, "S0.500nm": 500})
    assert scene.content.values[1, 0, 0] == pytest.approx(2 * 500e-9 / PHOTON, rel=2e-7)


# ---- depth


@pytest.mark.parametrize(
    "name", ["Z", "depth", "depth.T", "depth.Y", "Depth.Z", "ViewLayer.Depth.Z"]
)
@pytest.mark.parametrize("layer", ["", "ViewLayer.Combined."])
def test_a_depth_channel_is_the_scenes_depth(tmp_path, name, layer):
    path, stored = tmp_path / "a.exr", RANDOM.uniform(1, 9, (4, 5)).astype(np.float32)
    write_channels(
        path,
        {layer + key: value for key, value in RGB.items()} | {name: stored, "normal.X": plane(-1)},
    )
    scene = open_scene(path)
    np.testing.assert_array_equal(scene.depth, stored)
    np.testing.assert_array_equal(scene.content.coefficients[:, 1, 1], [0.25, 0.5, 0.75])
    assert scene.notes == (
        "channels not used: normal",
        f"depth: channel {name!r}, taken as metres along the optical axis",
    )
    assert open_scene(path, depth="none").depth is None


def test_what_is_nowhere_is_far_and_z_comes_first(tmp_path):
    path, stored = tmp_path / "a.exr", plane(3)
    stored[0, :3] = 0, np.inf, 1e10
    write_channels(path, RGB | {"Z": stored, "depth.T": plane(7)})
    scene = open_scene(path)
    np.testing.assert_array_equal(scene.depth[0], [1e6, 1e6, 1e10, 3, 3])
    assert scene.notes[0] == "depth is channel 'Z'; not read: depth.T"


def test_distances_along_rays_become_depth(tmp_path):
    """Of a wall across the axis, 4 m away: the ray's length is by Pythagoras."""
    path, rows, cols, fov = tmp_path / "a.exr", 6, 8, np.radians(70)
    y, x = (np.indices((rows, cols)) + 0.5 - [[[rows / 2]], [[cols / 2]]]) * (
        4 * np.tan(fov / 2) / (cols / 2)
    )
    write_channels(
        path,
        {key: plane(0.5, shape=(rows, cols)) for key in "RGB"}
        | {"depth.T": np.sqrt(x**2 + y**2 + 16).astype(np.float32)},
    )
    scene = open_scene(path, depth="ray", fov=fov)
    # the ray and its cosine, each rounded to float32, and a quotient: 3 times 2^-24
    np.testing.assert_allclose(scene.depth, 4, rtol=3 * 2.0**-24)
    assert scene.fov == fov and "along each pixel's ray" in scene.notes[0]


def test_depth_refusals(tmp_path):
    path = tmp_path / "a.exr"
    for value, said in ((-1, "negative"), (np.nan, "NaN")):
        write_channels(path, RGB | {"Z": plane(value)})
        with refused(path, "'Z'", said, 'depth = "none"', error=BadFile):
            open_scene(path)
        assert open_scene(path, depth="none").depth is None
    with refused("fov", "field of view", error=OutOfRange):
        open_scene(path, depth="ray")
    with refused("depth", "'rays'", "'ray'", error=UnknownName):
        open_scene(path, depth="rays")
    with refused("for .exr, .mat only", error=OutOfRange):
        open_scene("flat", depth="ray", fov=1.0)
    write_channels(path, RGB)
    with refused(path, "no channel of depth", error=BadFile):
        open_scene(path, depth="ray", fov=1.0)


def test_the_command_line_takes_depth_along_rays(tmp_path, capsys):
    from gpusim.cli.main import main

    path = tmp_path / "a.exr"
    write_channels(
        path, {key: plane(0.5, shape=(8, 8)) for key in "RGB"} | {"depth.T": plane(4, shape=(8, 8))}
    )
    asked = ["simulate", str(path), "--camera", "mono", "--device", "numpy", "--depth", "ray"]
    assert main(asked) == 2 and "field of view" in capsys.readouterr().err
    assert (
        main([*asked, "--fov", "40"]) == 0 and "along each pixel's ray" in capsys.readouterr().out
    )


# ---- primaries


def rgb_file(path, rgb, chromaticities):
    write_channels(
        path,
        {
            name: np.ascontiguousarray(values, np.float32)
            for name, values in zip("RGB", rgb, strict=True)
        },
        chromaticities=tuple(np.ravel(chromaticities).tolist()),
    )


@pytest.mark.parametrize(
    "name", ["ACES2065-1", "ACEScg", "ITU-R BT.2020", "Display P3", "Adobe RGB (1998)"]
)
def test_other_primaries_become_srgb_as_in_colour_science(tmp_path, name):
    import colour

    space = colour.RGB_COLOURSPACES[name]
    d65 = illuminant("D65")
    white = colour.XYZ_to_xy(
        colour.sd_to_XYZ(colour.SpectralDistribution(d65.values, d65.wavelengths))
    )
    srgb = colour.RGB_Colourspace("sRGB", SRGB_PRIMARIES, white)
    wanted = RANDOM.uniform(0.02, 1, (4, 5, 3))
    theirs = wanted @ np.linalg.inv(colour.matrix_RGB_to_RGB(space, srgb, "Bradford")).T
    rgb_file(tmp_path / "a.exr", np.moveaxis(theirs, -1, 0), [*space.primaries, space.whitepoint])
    held = read_exr(tmp_path / "a.exr")
    # The white of D65's table by two rules of integration: 2e-5 apart in x and y, 5e-5 in X / Y, of which sRGB's matrix
    # makes up to 3.24 times as much. Rounding to float32 is 10 times smaller.
    np.testing.assert_allclose(np.moveaxis(held.values, 0, -1), wanted, atol=1.6e-4)
    assert held.kind == "rgb" and not held.notes
    rgb_file(tmp_path / "a.exr", np.ones((3, 4, 5)), [*space.primaries, space.whitepoint])
    np.testing.assert_allclose(
        read_exr(tmp_path / "a.exr").values, 1, atol=2e-6
    )  # float32, likewise


@pytest.mark.parametrize(
    "names", ["XYZ", "RGB"]
)  # Mitsuba's; and RGB whose primaries are those of XYZ
def test_xyz_is_taken_as_it_is(tmp_path, names):
    """A colour by the matrix of IEC 61966-2-1, from which ours differs by up to 3e-4; Z is no depth."""
    wanted = np.array([0.2, 0.5, 0.7])
    xyz = (
        np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
        @ wanted
    )
    channels = {name: plane(value) for name, value in zip(names, xyz, strict=True)}
    write_channels(
        tmp_path / "a.exr", channels, chromaticities=(1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
    )
    held = read_exr(tmp_path / "a.exr")
    # 3e-4 of each of the three, which add up to 1.4, by a row of the inverse, whose entries add up to 5.3
    np.testing.assert_allclose(held.values[:, 1, 1], wanted, atol=3e-4 * 1.4 * 5.3)
    assert held.kind == "rgb" and held.depth is None


def test_srgb_is_left_as_it_is(tmp_path):
    rgb = RANDOM.random((3, 4, 5), np.float32)
    rgb_file(tmp_path / "a.exr", rgb, [*DISPLAYS["srgb"].primaries, DISPLAYS["srgb"].white])
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr").values, rgb)


def test_colors_outside_srgb_keep_their_luminance_and_the_report_says_so(tmp_path):
    from gpusim.io.camera.cameras import open_camera
    from gpusim.pipeline.simulator import Simulator

    rgb = np.full((3, 8, 8), 0.5, np.float32)
    rgb[:, 0, 0] = 0, 1, 0  # green of BT.2020
    rgb[:, 0, 1] = -1, -1, -1  # no colour at all
    primaries = [(0.708, 0.292), (0.170, 0.797), (0.131, 0.046), (0.3127, 0.3290)]
    rgb_file(tmp_path / "a.exr", rgb, primaries)
    scene = open_scene(tmp_path / "a.exr")
    got = scene.content.coefficients
    assert got.min() == 0
    np.testing.assert_array_equal(got[:, 0, 1], 0)
    # luminance of BT.2020's green, ITU-R BT.2020 table 4, and weights of sRGB, IEC 61966-2-1, each of four digits
    assert np.dot([0.2126, 0.7152, 0.0722], got[:, 0, 0]) == pytest.approx(0.6780, abs=2e-4)
    np.testing.assert_allclose(got[:, 2:], 0.5, atol=1e-6)
    report = Simulator(open_camera("mono"), device="numpy")(scene).report
    assert any(
        "colours outside sRGB" in note and "3.1 %" in note for note in report.notes
    )  # 2 of 64


def test_no_more_memory_is_taken_than_was_asked_for(tmp_path, monkeypatch):
    """NumPy's own, while colours of other primaries are drawn into sRGB; a depth beside them."""
    path, asked = tmp_path / "a.exr", []
    rgb = RANDOM.random((3, 400, 500), np.float32)
    write_channels(
        path,
        dict(zip("RGB", rgb, strict=True)) | {"Z": rgb[0] + 1},
        chromaticities=(0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    )
    read_exr(path)  # modules and tables of the program are loaded
    monkeypatch.setattr("gpusim.io.exr.require_memory", lambda what, needed: asked.append(needed))
    tracemalloc.start()
    try:
        held = read_exr(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert held.notes and held.depth is not None
    assert peak <= sum(asked) + 2**18, (
        f"{peak / 2**20:.1f} MiB of {sum(asked) / 2**20:.1f}"
    )  # names, headers


@pytest.mark.parametrize(
    "chromaticities", [np.zeros(8), np.full(8, np.nan), np.full(8, 1e30), np.full(8, 0.3)]
)
def test_chromaticities_that_are_none(tmp_path, chromaticities):
    rgb_file(tmp_path / "a.exr", np.ones((3, 4, 5)), chromaticities)
    with refused(tmp_path / "a.exr", "chromaticities", error=BadFile):
        open_scene(tmp_path / "a.exr")


# ---- other programs


def test_mitsubas_bands_and_depth(tmp_path):
    """A diffuse wall across the axis in even light of 2 W m-2 sr-1 nm-1: radiance is reflectance times that light."""
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed: pip install mitsuba")
    mi.set_variant("scalar_spectral")
    path, bands, step, near, fov, size = (
        tmp_path / "a.exr",
        (450, 500, 550, 600),
        50,
        0.001,
        60.0,
        (32, 24),
    )
    # a triangle of area 1 for each band: the film then holds means of the radiance
    film = {
        f"band{nm}": {
            "type": "irregular",
            "wavelengths": f"{nm - step}, {nm}, {nm + step}",
            "values": f"0, {1 / step}, 0",
        }
        for nm in bands
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "aov", "aovs": "depth:depth", "image": {"type": "path"}},
            "sensor": {
                "type": "perspective",
                "fov": fov,
                "near_clip": near,
                "sampler": {"type": "independent", "sample_count": 64},
                "film": {
                    "type": "specfilm",
                    "width": size[0],
                    "height": size[1],
                    "rfilter": {"type": "box"},
                    "component_format": "float32",
                }
                | film,
            },
            "light": {"type": "constant", "radiance": {"type": "uniform", "value": 2.0}},
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f()
                .translate([0, 0, 5])
                .rotate([0, 1, 0], 180)
                .scale(9),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {
                        "type": "irregular",
                        "wavelengths": "400, 700",
                        "values": ".2, .8",
                    },
                },
            },
        }
    )
    mi.render(scene)
    scene.sensors()[0].film().write(str(path))
    found = open_scene(
        path, bands={f"band{nm}": nm for nm in bands}, depth="ray", fov=np.radians(fov)
    )
    radiance = found.content.values * PHOTON / (np.array(bands) * 1e-9)[:, None, None]
    wanted = 2 * (0.2 + 0.6 * (np.array(bands) - 400) / 300)
    error = radiance.std(axis=(1, 2)) / np.sqrt(
        radiance[0].size
    )  # of the mean of independent pixels
    assert (np.abs(radiance.mean(axis=(1, 2)) - wanted) < 4 * error).all() and (
        error < 0.01 * wanted
    ).all()
    # Mitsuba's rays begin at near_clip. A mean of 64 places in a pixel: each is up to half a pixel from its middle, in
    # x and y, and the ray's length changes by tan / (1 + tan^2) <= 1/2 of that.
    step = np.tan(np.radians(fov / 2)) / (size[0] / 2)
    np.testing.assert_allclose(found.depth, 5 - near, rtol=0.5 * np.hypot(step, step) / 2)
    assert found.depth.mean() == pytest.approx(
        5 - near, rel=1e-3
    )  # that mean over all pixels cancels


def test_colour_science_reads_and_writes_what_we_write_and_read(tmp_path):
    import colour

    values, waves = RANDOM.random((7, 6, 5), np.float32), np.arange(400.0, 701, 50)
    write_spectral_exr(tmp_path / "a.exr", waves, values, reflectance=True)
    theirs = colour.read_spectral_image_Fichet2021(str(tmp_path / "a.exr"))["T"]
    np.testing.assert_array_equal(theirs[0], waves)
    np.testing.assert_array_equal(np.moveaxis(theirs[1], -1, 0), values)
    cube = (waves, np.moveaxis(values, 0, -1))
    colour.write_spectral_image_Fichet2021(
        {"S0": cube}, str(tmp_path / "b.exr"), bit_depth="float32"
    )
    held = read_exr(tmp_path / "b.exr")
    assert held.kind == "radiance"
    np.testing.assert_array_equal(held.wavelengths, waves)
    np.testing.assert_allclose(
        held.values, values * (waves * 1e-9 / PHOTON)[:, None, None], rtol=2e-7
    )  # float32
    colour.write_spectral_image_Fichet2021(
        {f"S{n}": cube for n in range(4)}, str(tmp_path / "c.exr")
    )
    with refused("polarised", error=BadFile):
        read_exr(tmp_path / "c.exr")
