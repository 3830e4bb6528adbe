"""Learned filters trained on simulated frames: what they are trained on, what they reach, and what is refused."""

import argparse
import dataclasses
import json
from importlib.resources import files

import numpy as np
import pytest

from gpusim.apps.l3.layout import layout
from gpusim.apps.l3.scenes import training_scenes
from gpusim.apps.l3.train import ideal_colors, train, training_camera
from gpusim.cli.main import _parser
from gpusim.cli.train_l3 import luminances
from gpusim.data.charts import chart, colorchecker_patches
from gpusim.data.colorimetry import cmf, xyz
from gpusim.data.curves import curve
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.camera import Camera
from gpusim.domain.content import Basis, Cube, Materials
from gpusim.domain.errors import BadData, GpusimError, OutOfRange, UnknownName
from gpusim.domain.learned import FilterTable
from gpusim.domain.mosaics import mosaic
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera
from gpusim.io.camera.learned import read_table, write_table
from gpusim.io.frame.images import write_png
from gpusim.io.scene.photo import lift
from gpusim.io.scene.scenes import mean_luminance
from gpusim.pipeline.simulator import Simulator

NODES = np.concatenate(
    [[40, 399], np.arange(400, 701, 10), [701, 7000]]
)  # curves are zero outside 400 .. 700 nm


def rgbw_camera(cfa=("RG", "WB"), **sensor):
    """2.2 um pixels at f/4, 100 ms; red, green, blue and clear of the MT9V024 behind an infrared cut."""
    values = curve("mt9v024").values * curve("ir-cut-phone").values
    letters = tuple(letter for letter in "RGBW" if letter in "".join(cfa))
    qe = Spectrum(
        NODES, np.pad(values[["RGBW".index(letter) for letter in letters]], ((0, 0), (2, 2)))
    )
    settings = {
        "full_well": 9000,
        "bits": 12,
        "fill_factor": 0.45,
        "exposure_time": 0.1,
        "black_level": 64,
        "noise": Noise(read=6.7, dsnu=7.05),
    }
    return Camera(
        "rgbw",
        Optics(4, 3e-3),
        Sensor(2.2e-6, qe, channels=letters, cfa=cfa, **settings | sensor),
        Processor(scaling="normalised"),
    )


def using(camera, table):
    """The camera with these filters."""
    return dataclasses.replace(
        camera, processor=Processor(demosaic="learned", table=table, scaling="normalised")
    )


def at_luminance(scene, mean):
    """The scene with this mean luminance [cd m-2]."""
    return dataclasses.replace(
        scene, illuminant=scene.illuminant.scale(mean / mean_luminance(scene))
    )


def cpsnr(shown, wanted, border=8):
    """Of square roots, which are near display codes [dB]."""
    shown, wanted = (
        np.sqrt(np.clip(image[border:-border, border:-border], 0, 1)) for image in (shown, wanted)
    )
    return -10 * np.log10(np.mean((shown - wanted) ** 2))


@pytest.fixture(scope="module")
def rgbw_table():
    """Filters of the RGBW camera from a few scenes."""
    return train(rgbw_camera(), generated=3, seed=1)


def test_wanted_colors_are_those_of_the_target_light():
    # The nodes' weights integrate a smooth reflectance times light and observer: for a constant one they are exact to
    # rounding. White in D65 within 400 .. 700 nm: the weights' own white, Y = 1.
    grey = chart("flat", size=(8, 6), light="A", reflectance=0.3)
    white = ideal_colors(chart("flat", size=(8, 6), light="FL11", reflectance=1.0))[:, 0, 0]
    assert white[1] == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(
        ideal_colors(grey), np.broadcast_to(0.3 * white[:, None, None], (3, 6, 8)), rtol=1e-6
    )
    # of the table over all wavelengths: 3 parts in 1e3 of D65's XYZ lie beyond 400 .. 700 nm
    true = xyz(illuminant("D65"))
    np.testing.assert_allclose(white, true / true[1], rtol=6e-3)


def test_wanted_colors_of_all_forms_of_a_scene():
    random = np.random.default_rng(0)
    basis = lift(random.random((3, 10, 12)))
    light = white_radiance(illuminant("D65"), 100.0)
    cube = Cube(
        basis.wavelengths, np.tensordot(basis.basis.T, basis.coefficients, 1).astype(np.float32)
    )
    colors = ideal_colors(Scene(basis, light))
    # float32 of the cube: 6e-8 of values below 1, summed over some 30 bands
    np.testing.assert_allclose(ideal_colors(Scene(cube, light)), colors, atol=1e-6)
    materials = Materials(
        basis.wavelengths,
        np.arange(120, dtype=np.uint8).reshape(10, 12),
        np.ones((10, 12), np.float32),
        cube.values.reshape(len(basis.wavelengths), -1).T,
    )
    np.testing.assert_allclose(ideal_colors(Scene(materials, light)), colors, atol=1e-6)


@pytest.mark.parametrize("samples_per_pixel", [1, 2, 2.5])
def test_wanted_colors_lie_where_the_pixels_are(samples_per_pixel):
    """Without a lens's blur, a pixel that is all aperture sees just what is wanted."""
    random = np.random.default_rng(1)
    shading = random.random((60, 75)).astype(np.float32)
    nodes = np.array([400.0, 700.0])
    scene = Scene(
        Materials(nodes, np.zeros(shading.shape, np.uint8), shading, np.ones((1, 2))),
        white_radiance(illuminant("D65"), 100.0),
        samples_per_pixel=samples_per_pixel,
    )
    camera = training_camera(rgbw_camera(fill_factor=1.0))
    simulator = Simulator(
        dataclasses.replace(camera, optics=dataclasses.replace(camera.optics, model="none")),
        device="numpy",
    )
    exposure = simulator.expose(scene)
    white = exposure.plan.white_rate[exposure.camera.sensor.cfa_indices] * exposure.exposure_time
    rows, cols = exposure.mean.shape
    seen = exposure.mean / np.tile(white, (rows // 2 + 1, cols // 2 + 1))[:rows, :cols]
    np.testing.assert_allclose(
        ideal_colors(scene)[1], seen, rtol=1e-6
    )  # float32 samples, float64 sums


def test_scenes_are_the_seeds():
    one, other = training_scenes(2, seed=5, size=32), training_scenes(2, seed=6, size=32)
    again = training_scenes(1, seed=5, size=32)[0]
    assert np.array_equal(one[0].content.shading, again.content.shading)
    assert np.array_equal(one[0].content.ids, again.content.ids)
    assert not np.array_equal(one[0].content.shading, other[0].content.shading)
    assert one[0].shape == (32, 32)
    for scene in one + other:
        assert 0 < scene.content.shading.min() and scene.content.shading.max() <= 1


def colorimetric_camera():
    """Sensitivities that are mixtures of the colour matching functions, with much overlap; no noise, no blur."""
    mixture = np.array([[0.9, 0.1, 0.0], [0.35, 0.65, 0.0], [0.0, 0.15, 0.85]])
    nodes = np.arange(400.0, 701.0, 5.0)
    values = (
        mixture @ cmf().at(nodes) / nodes
    )  # colour matching is for energy, efficiency for photons
    values = np.pad(values / (2 * values.max()), ((0, 0), (2, 2)))
    qe = Spectrum(np.concatenate([[40, 399], nodes, [701, 7000]]), values)
    sensor = Sensor(
        3e-6,
        qe,
        full_well=20000,
        bits=16,
        cfa=("RG", "GB"),
        exposure_time=0.02,
        noise=Noise(photon="none"),
    )
    return Camera("colorimetric", Optics(4, 6e-3, model="none"), sensor)


def patch_differences(camera, table):
    """CIEDE2000 in the middle of the 24 patches of a ColorChecker."""
    import colour

    size = (240, 160)
    frame = Simulator(using(camera, table))(chart("colorchecker", size=size, luminance=300.0))
    middles = np.array(
        [[(part.start + part.stop) // 2 for part in patch] for patch in colorchecker_patches(size)]
    ).T
    wanted = ideal_colors(chart("colorchecker", size=size))[:, *middles].T
    shown = np.linalg.solve(camera.display.rgb_from_xyz, frame.linear[*middles].T).T
    return colour.delta_E(
        *(colour.XYZ_to_Lab(one, [0.3127, 0.3290]) for one in (shown, wanted)), method="CIE 2000"
    )


@pytest.mark.slow
def test_a_colorimetric_camera_without_noise_is_recovered():
    """Even from ten scenes, flat fields have their true colours: a difference of 1 is at the limit of sight."""
    camera = colorimetric_camera()
    differences = patch_differences(
        camera, train(camera, generated=8, seed=2, luminances=(100, 250, 600))
    )
    assert (
        differences.mean() < 1 and differences.max() < 2.3
    )  # 2.3: just noticeable (Mahy et al. 1994)


@pytest.mark.slow
def test_more_scenes_and_channels_come_nearer():
    """Errors of colour fall with the number of scenes; a table to XYZ has to take the root of a mixture."""
    camera = colorimetric_camera()
    few, many, direct = (
        patch_differences(camera, train(camera, seed=2, **options)).mean()
        for options in ({"generated": 4}, {"generated": 20}, {"generated": 20, "outputs": "xyz"})
    )
    assert many < few and many < direct


def column_means(table):
    """Luminance over that wanted in columns of a ramp along which the clear pixels saturate, and the mean's error."""
    camera = rgbw_camera()
    ramp = chart(
        "ramp", size=(192, 96), luminance=390.0, low=0.05, high=1.0
    )  # the others saturate at its end
    frame = Simulator(using(camera, table))(ramp, seed=4)
    saturated = (frame.mean[1::2, ::2] >= camera.sensor.saturation).mean(axis=0)
    assert saturated[20] == 0 and saturated[-20] == 1
    luminance = (frame.linear @ [0.2126, 0.7152, 0.0722])[8:-8, 8:-8] / ideal_colors(ramp)[
        1, 8:-8, 8:-8
    ]
    # neighbouring rows share noise: those as far apart as the filters reach count as independent
    return luminance.mean(axis=0), luminance.std(axis=0) / np.sqrt(luminance.shape[0] / 7)


def test_no_step_where_clear_pixels_saturate(rgbw_table):
    ratio, error = column_means(rgbw_table)
    assert (np.abs(ratio - 1) < 0.05 + 4 * error).all()
    steps = np.abs(ratio[6:] - ratio[:-6])
    assert (steps < 0.03 + 4 * np.hypot(error[6:], error[:-6])).all()
    # filters of the middle of the range alone, as if nothing saturated
    layout = rgbw_table.layout
    middle = int(np.searchsorted(layout.levels, 0.5))
    one = dataclasses.replace(layout, levels=layout.levels[[middle]])
    alone = dataclasses.replace(
        rgbw_table,
        layout=one,
        filters=rgbw_table.filters[:, [middle]],
        offsets=rgbw_table.offsets[:, [middle]],
    )
    assert np.abs(column_means(alone)[0] - 1).max() > 0.15


@pytest.mark.parametrize(
    "name",
    ["rgbw", "rgbw-kodak", "rgbn", "rgbe", "cygm", "rccb", "ryyb", "cyym", "x-trans", "quad-bayer"],
)
@pytest.mark.parametrize("light", ["D65", "A"])
def test_filters_leave_white_where_interpolation_has_it(name, light):
    """Exposure is metered on all pixels: white is at .95 of saturation in the strongest, which filters may not show."""
    letters = tuple(dict.fromkeys("".join(mosaic(name))))
    nodes = np.linspace(400, 700, 31)
    bumps = {
        "R": (620, 40),
        "G": (540, 40),
        "B": (460, 40),
        "E": (500, 30),
        "N": (690, 60),
        "C": (500, 80),
        "Y": (590, 80),
        "M": (550, 30),
        "W": (550, 150),
    }
    qe = Spectrum(
        nodes,
        np.array(
            [
                0.6 * np.exp(-(((nodes - bumps[letter][0]) / bumps[letter][1]) ** 2))
                for letter in letters
            ]
        ),
    )
    camera = dataclasses.replace(
        rgbw_camera(),
        sensor=dataclasses.replace(
            rgbw_camera().sensor, qe=qe, channels=letters, cfa=mosaic(name), exposure_time=None
        ),
    )
    shown = tuple("RGB") if {*"RGB"} <= {*letters} else letters[:3]
    made = layout(mosaic(name), shown)
    table = FilterTable(made, np.zeros(made.shape, np.float32))
    scene = chart("flat", size=(16, 16), reflectance=1.0, light=light)
    for processor in (Processor(), Processor(demosaic="learned", table=table)):
        exposure = Simulator(
            dataclasses.replace(camera, processor=processor), device="numpy"
        ).expose(scene)
        assert exposure.rendering.diffuser == pytest.approx(1, rel=1e-5)  # float32 rates


def test_trained_filters_show_white_as_interpolation_does(rgbw_table):
    """At the camera's own exposure; the mean over 48 x 48 pixels of filters of a few scenes: 5 %."""
    camera = replaced(rgbw_camera(), exposure_time=None)
    scene = chart("flat", size=(48, 48), reflectance=1.0)
    for processor in (Processor(), Processor(demosaic="learned", table=rgbw_table)):
        linear = Simulator(dataclasses.replace(camera, processor=processor))(scene).linear
        np.testing.assert_allclose(linear.mean(axis=(0, 1)), 1, atol=0.05)


def test_better_than_interpolation_in_the_dark(rgbw_table):
    camera = dataclasses.replace(rgbw_camera(), processor=Processor(demosaic="bilinear"))
    scene = at_luminance(
        chart("deadleaves", size=(128, 96), surfaces="colorchecker-sg", smallest=6, seed=3), 1.0
    )
    wanted = np.moveaxis(ideal_colors(scene), 0, -1) @ camera.display.rgb_from_xyz.T
    plain, learned = (
        cpsnr(Simulator(one)(scene, seed=8).linear, wanted)
        for one in (camera, using(camera, rgbw_table))
    )
    # Filters over 85 pixels against means over at most 9: of white noise alone a factor of 85 / 9 in variance, 9.7 dB;
    # detail and colour cost most of it.
    assert learned > plain + 4


def test_table_file_and_provenance(rgbw_table, tmp_path):
    write_table(tmp_path / "table.npz", rgbw_table)
    again = read_table(tmp_path / "table.npz")
    assert np.array_equal(again.filters, rgbw_table.filters) and np.array_equal(
        again.offsets, rgbw_table.offsets
    )
    assert again.layout.mosaic == ("RG", "WB") and again.layout.outputs == ("R", "G", "B")
    said = json.loads(again.provenance)
    assert (
        said["camera"] == "rgbw"
        and said["light"] == "D65"
        and said["seed"] == 1
        and said["frames"] == 24
    )
    assert said["scenes"] == ["3 generated"]


def stacked(camera):
    return dataclasses.replace(camera, sensor=dataclasses.replace(camera.sensor, stacked=True))


def replaced(camera, **sensor):
    return dataclasses.replace(camera, sensor=dataclasses.replace(camera.sensor, **sensor))


def radiance():
    return Scene(
        Cube(np.array([400.0, 700.0]), np.ones((2, 64, 64), np.float32)),
        unit_light([400, 700]),
        name="cube",
    )


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            lambda: (stacked(rgbw_camera()),),
            OutOfRange,
            "stacked pixels: allowed is a mosaic of 3 channels",
        ),
        (lambda: (open_camera("mono"),), OutOfRange, r"mono, 1 channel\(s\)"),
        (lambda: (replaced(rgbw_camera(), binning=(2, 2)),), OutOfRange, "sensor.binning"),
        (
            lambda: (rgbw_camera(), [chart("flat", size=(64, 31))]),
            OutOfRange,
            "flat = 64x31 pixels: allowed is at least",
        ),
        (lambda: (rgbw_camera(), [radiance()]), BadData, "cube: radiance in an unknown light"),
        (lambda: (rgbw_camera(),), BadData, "no scenes"),
    ],
)
def test_what_cannot_be_trained_is_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        train(*arguments(), generated=0)


def test_a_singular_training_set_is_refused():
    camera = replaced(rgbw_camera(), noise=Noise(photon="none"))
    with pytest.raises(BadData, match="singular"):
        train(camera, [chart("flat", size=(64, 64))], generated=0)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"luminances": (1, -2)}, OutOfRange, "luminances"),
        ({"luminances": (np.nan, 1)}, OutOfRange, "luminances"),
        ({"outputs": "srgb"}, UnknownName, "outputs"),
        ({"light": "D66"}, UnknownName, "light"),
    ],
)
def test_wrong_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        train(rgbw_camera(), [chart("deadleaves", size=(64, 64))], generated=0, **options)


def test_luminance_needs_an_exposure_time():
    with pytest.raises(OutOfRange, match="exposes automatically"):
        train(
            replaced(rgbw_camera(), exposure_time=None),
            [chart("flat", size=(64, 64))],
            generated=0,
            luminances=(1, 10),
        )


def command(*arguments):
    chosen = _parser().parse_args(["train-l3", *map(str, arguments)])
    return chosen.run(chosen)


def test_command(tmp_path, capsys):
    """A table from a photograph, for a camera file that uses it then."""
    out, photo = tmp_path / "phone.npz", tmp_path / "photo.png"
    write_png(photo, np.random.default_rng(0).integers(256, size=(64, 64, 3), dtype=np.uint8))
    assert (
        command(
            photo, "--camera", "phone", "--generated", 0, "-o", out, "--light", "A", "--seed", 7
        )
        == 0
    )
    said = json.loads(read_table(out).provenance)
    assert said["light"] == "A" and said["scenes"] == ["photo"] and said["camera"] == "phone"
    text = (files("gpusim.data") / "cameras" / "phone.toml").read_text()
    learned = tmp_path / "learned.toml"
    learned.write_text(
        text.replace('demosaic = "adaptive"', 'demosaic = "learned"\ntable = "phone.npz"')
    )
    assert open_camera(str(learned)).processor.table.provenance == read_table(out).provenance
    assert "RG/GB to RGB" in capsys.readouterr().out
    for wrong in (
        ("--camera", "phone", "-o", "a.txt"),
        ("--camera", "mono", "-o", out),
        ("--camera", "fone", "-o", out),
    ):
        with pytest.raises(GpusimError):
            command(*wrong)


def test_luminances_of_the_command():
    assert luminances("1..400") == (1, 400) and luminances("1,10,100") == (1, 10, 100)
    with pytest.raises(argparse.ArgumentTypeError, match=r"LOW\.\.HIGH"):
        luminances("dark")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rgbw", "x-trans"])
def test_full_training(name):
    """Learned filters are better than interpolation: by far in the dark, where they average more samples."""
    camera = rgbw_camera(mosaic(name))
    table = train(camera)
    for mean, better in ((1.0, 2.0), (40.0, 0.0)):
        gains = []
        for seed, surfaces in ((3, "colorchecker-sg"), (4, "macbeth")):
            scene = at_luminance(
                chart("deadleaves", size=(192, 160), surfaces=surfaces, smallest=3, seed=seed), mean
            )
            wanted = np.moveaxis(ideal_colors(scene), 0, -1) @ camera.display.rgb_from_xyz.T
            plain, learned = (
                cpsnr(Simulator(one)(scene, seed=8).linear, wanted)
                for one in (camera, using(camera, table))
            )
            gains.append(learned - plain)
        assert min(gains) > better, gains


def test_basis_is_known_here():
    """The generated scenes are materials; photographs come as a basis."""
    assert isinstance(training_scenes(1, size=32)[0].content, Materials) and isinstance(
        lift(np.ones((3, 2, 2))), Basis
    )
