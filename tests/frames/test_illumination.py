"""Light that varies over a scene: frames are those of the radiance that lights and surfaces make, whatever the form."""

import dataclasses
import functools

import numpy as np
import pytest
from cameras import PHONE
from devices import ALL_KINDS, KINDS
from foreign_arrays import Tensor

import gpusim as gs
from gpusim.cli.main import main
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadData, BadFile, UnknownName
from gpusim.domain.scene import unit_light
from gpusim.io.scene.npz import read_npz, write_npz
from gpusim.pipeline.reading import Reading, store

SHAPE = ROWS, COLS = 24, 36
RAMP = np.linspace(0, 1, COLS, dtype=np.float32) * np.ones((ROWS, 1), np.float32)
NODES, FINE = np.arange(400.0, 701.0, 10.0), np.arange(400.0, 701.0, 1.0)
RANDOM = np.random.default_rng(12)
SURFACES = reflectances("objects")
IDS = RANDOM.integers(0, 24, SHAPE).astype(np.uint8)
LIGHTS = {  # blackbodies of the seed's Figure 4; then what is harder: a fluorescent lamp's lines, and three at once
    "blackbodies": {"blackbody-3500K": 80 * (1 - RAMP), "blackbody-7000K": 80 * RAMP},
    "daylight and tungsten": {"D65": 300 * RAMP**2, "A": 20 * (1 - RAMP)},
    "lines": {"FL11": 50 * (1 - RAMP) + 1, "D65": 200 * RAMP},
    "three": {"FL2": 60 * RAMP, "LED-B1": 60 * RAMP[:, ::-1], "HP1": 25.0},
}


def materials():
    spectra = SURFACES.at(NODES, outside=None)[:24]
    return gs.Materials(NODES, IDS, RANDOM.uniform(0.5, 1, SHAPE).astype(np.float32), spectra)


def forms():
    made = materials()
    bands = made.bands_at(slice(None))
    left, values, right = np.linalg.svd(bands.reshape(len(NODES), -1), full_matrices=False)
    codes = RANDOM.integers(0, 256, (*SHAPE, 3), np.uint8)
    picture = gs.picture(codes).content
    return {
        "materials": made,
        "cube": gs.Cube(NODES, bands.astype(np.float32)),
        "picture": picture,
        "basis": gs.Basis(
            NODES,
            (values[:24, None] * right[:24]).reshape(24, *SHAPE).astype(np.float32),
            left[:, :24].T,
        ),
    }


FORMS = forms()


def lit(content, lights, **options):
    return gs.illuminate(
        gs.Scene(content, white_radiance(illuminant("E"), 100.0), **options), lights
    )


def radiance(content, lights):
    """Radiance of the same on fine wavelengths, by the formula: surfaces between their nodes by the reference's spline.

    Lights are linear between the entries of their tables.
    """
    from scipy.interpolate import CubicSpline

    nodes = content.wavelengths
    fine = FINE[(FINE >= nodes[0]) & (FINE <= nodes[-1])]
    content = content.on_host()
    surfaces = CubicSpline(nodes, content.bands_at(slice(None)), axis=0)(fine)
    total = 0.0
    for light, weights in lights.items():
        unit = white_radiance(illuminant(light), 1.0).at(fine)
        total = total + unit[:, None, None] * np.broadcast_to(weights, SHAPE)
    spectra = (surfaces * total).astype(
        np.float32
    )  # splines of dark surfaces undershoot, which a basis may
    return gs.Scene(gs.Basis(fine, spectra, np.eye(len(fine))), unit_light(fine))


@functools.cache
def true_electrons(form, lights):
    """Mean electrons of the radiance on fine wavelengths."""
    return (
        gs.Simulator(PHONE, device="numpy")
        .expose(radiance(FORMS[form], LIGHTS[lights]), exposure_time=0.01)
        .mean
    )


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("lights", LIGHTS)
def test_electrons_are_those_of_the_radiance(form, lights):
    """The lights' spectra may err by 1e-4 in a channel of 30 nm (CLOSE), of the largest; a phone's have 80 and more.

    Splines of 10 nm through what a light and a reflectance make together err by as much again, and so does the blur,
    whose width is interpolated between 31 to 121 wavelengths in place of 301.
    """
    scene = lit(FORMS[form], LIGHTS[lights])
    found = gs.Simulator(PHONE, device="numpy").expose(scene, exposure_time=0.01).mean
    truth = true_electrons(
        "picture" if form == "picture" else "materials", lights
    )  # cube and basis are theirs
    np.testing.assert_allclose(found, truth, atol=2e-4 * truth.max(), rtol=0)
    assert np.sqrt(np.mean((found - truth) ** 2)) < 1e-4 * truth.mean()
    if form in ("materials", "picture"):
        assert (
            scene.content.surfaces.entry_spectra.shape[0] == {"materials": 24, "picture": 3}[form]
        )


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("tolerance", [None, 1e-3, "preview"])
def test_devices_and_plans_agree(name, tolerance):
    scene = lit(FORMS["cube"], LIGHTS["lines"], border="reflect")
    frame = gs.Simulator(PHONE, device=name, tolerance=tolerance)(scene, seed=3, verify=True)
    assert frame.report.meets_tolerance is not False
    assert frame.report.error.rms < {None: 1e-5, 1e-3: 1e-3, "preview": 1e-2}[tolerance]


@pytest.mark.parametrize("name", ALL_KINDS)
def test_what_the_host_reads_of_a_device(name):
    """Windows, rows and brightness are those of the products; float16 surfaces stay exact, whoever's array it is."""
    content = lit(FORMS["basis"], LIGHTS["three"]).content
    content = dataclasses.replace(content, coefficients=content.coefficients.astype(np.float16))
    wanted = np.einsum(
        "kyx,jyx->kjyx", content.maps, content.coefficients.astype(np.float32)
    ).reshape(-1, *SHAPE)
    np.testing.assert_array_equal(content.planes, wanted)
    device = gs.open_device(name)
    total = RANDOM.uniform(0.5, 1, len(content.wavelengths))
    bright = np.tensordot(content.entry_spectra @ total, wanted.astype(float), 1)
    for given in (content, content.with_samples(Tensor), content.with_samples(device.array)):
        for reading in (Reading(device, given), Reading(device, given, store(device, given))):
            rows, cols = np.array([[3, 4], [0, 23]]), np.array([[5, 6], [35, 9]])
            read = reading.windows(rows, cols)
            windows = np.stack(
                [wanted[:, y[:, None], x] for y, x in zip(rows, cols, strict=True)], axis=1
            )
            np.testing.assert_array_equal(read.planes, windows)
            np.testing.assert_array_equal(reading.rows(np.array([2, 9])).planes, wanted[:, [2, 9]])
            # sums of 72 float32 products, each of positive ones and of negative: n units of 2^-24 of the magnitudes
            magnitude = np.tensordot(
                np.abs(content.entry_spectra @ total), np.abs(wanted.astype(float)), 1
            )
            assert (
                np.abs(reading.brightness(total) - bright) <= 2 * 74 * 2.0**-24 * magnitude
            ).all()


def test_one_light_everywhere_is_that_light():
    chart = gs.chart("colorchecker", size=(64, 48), light="A", luminance=70.0)
    scene = gs.illuminate(chart, {"A": 70.0})
    assert len(scene.content.lights) == 1
    simulator = gs.Simulator(PHONE, device="numpy")
    one, other = (simulator(each, seed=1) for each in (chart, scene))
    # products of float32 planes round; D65's tables are not of one length with the chart's wavelengths
    np.testing.assert_allclose(other.mean, one.mean, rtol=1e-5)
    np.testing.assert_allclose(scene.illuminant.at(NODES), chart.illuminant.at(NODES), rtol=1e-12)


def test_halves_of_a_scene_have_their_own_white():
    """A grey of 18 % in two lights: ratios of its channels are those of the lights alone."""
    flat = gs.chart("flat", size=(COLS, ROWS))
    halves = (RAMP < 0.5).astype(np.float32)
    simulator = gs.Simulator(
        dataclasses.replace(PHONE, optics=dataclasses.replace(PHONE.optics, model="none")),
        device="numpy",
    )
    found = simulator.expose(
        gs.illuminate(flat, {"A": 100 * halves, "D65": 40 * (1 - halves)}), exposure_time=0.01
    )
    for name, luminance, columns in (("A", 100.0, slice(2, 16)), ("D65", 40.0, slice(20, 34))):
        own = simulator.expose(
            gs.chart("flat", size=(COLS, ROWS), light=name, luminance=luminance), exposure_time=0.01
        )
        np.testing.assert_allclose(
            found.mean[..., columns], own.mean[..., columns], rtol=2e-4
        )  # CLOSE, twice


def test_archives_hold_light_and_surfaces(tmp_path):
    scene = lit(FORMS["materials"], LIGHTS["lines"])
    write_npz(tmp_path / "a.npz", scene)
    again = read_npz(tmp_path / "a.npz", scene.illuminant)
    assert again.content.is_like(scene.content)
    for name in scene.content.samples:
        np.testing.assert_array_equal(getattr(again.content, name), getattr(scene.content, name))
    np.testing.assert_array_equal(again.illuminant.values, scene.illuminant.values)
    brighter = gs.open_scene(tmp_path / "a.npz", luminance=500.0)
    ratio = brighter.illuminant.values.max() / scene.illuminant.values.max()
    simulator = gs.Simulator(PHONE, device="numpy")
    one, other = (simulator.expose(each, exposure_time=0.01).mean for each in (scene, brighter))
    np.testing.assert_allclose(other, ratio * one, rtol=1e-6)
    with pytest.raises(BadFile, match="light 'A': the file's light varies over the scene"):
        gs.open_scene(tmp_path / "a.npz", light="A")
    command = ["simulate", str(tmp_path / "a.npz"), "--camera", "phone", "--device", "numpy"]
    assert main([*command, "-o", str(tmp_path / "a.png")]) == 0
    arrays = dict(np.load(tmp_path / "a.npz"))
    for key, wrong, words in (
        ("maps", arrays["maps"][:1], "maps"),
        ("maps", -arrays["maps"], "negative"),
        ("lights", arrays["lights"][:, :-1], "lights"),
    ):
        np.savez(tmp_path / "b.npz", **arrays | {key: wrong})
        with pytest.raises(BadFile, match=words):
            gs.open_scene(tmp_path / "b.npz")


def test_things_move_in_the_light_of_their_place():
    scene = lit(FORMS["basis"], {"A": 100 * RAMP, "D65": 100 * (1 - RAMP)})
    surfaces = scene.content.surfaces
    patch = dataclasses.replace(surfaces, coefficients=surfaces.coefficients[:, :5, :5])
    still = gs.Animation(
        scene, [gs.Actor(patch, np.ones((5, 5), np.float32), (0.5, -10.5), gs.Motion(pan=(0, 20)))]
    )
    for time, middle in ((0.0, 7), (1.0, 27)):
        found = still.at(time).content
        np.testing.assert_array_equal(found.maps, scene.content.maps)
        np.testing.assert_allclose(
            found.coefficients[:, 10:15, middle - 2 : middle + 3], patch.coefficients, atol=1e-5
        )
    with pytest.raises(BadData, match="actor 0 is a cube, the scene a basis"):
        gs.Animation(scene, [gs.Actor(FORMS["cube"], np.ones(SHAPE, np.float32))])


def test_views_turn_the_light_with_the_scene():
    """What a view shows is interpolated after the light: of planes that are alike, alike. Bounds as of plain frames."""
    lights, view = LIGHTS["blackbodies"], gs.View(shift=(1.3, 5.7), rotation=0.2, zoom=1.1)
    simulator = gs.Simulator(PHONE, device="numpy")
    found, truth = (
        simulator.expose(each.viewed(view), exposure_time=0.01).mean
        for each in (lit(FORMS["cube"], lights), radiance(FORMS["cube"], lights))
    )
    np.testing.assert_allclose(found, truth, atol=2e-4 * truth.max(), rtol=0)


@pytest.mark.parametrize(
    "change, error, words",
    [
        (lambda scene: (scene, {}), BadData, "wanted {light: map}"),
        (lambda scene: (scene, {"D66": 1.0}), UnknownName, "D66"),
        (
            lambda scene: (scene, {"A": RAMP[:-1]}),
            BadData,
            r"map of A: shape \(23, 36\), wanted \(24, 36\)",
        ),
        (
            lambda scene: (scene, {"A": -RAMP}),
            BadData,
            "map of A: from -1 to -?0, wanted finite luminance",
        ),
        (
            lambda scene: (scene, {"A": "bright"}),
            BadData,
            "map of A: str, wanted an array of real numbers",
        ),
        (lambda scene: (scene, {"A": 0.0 * RAMP}), BadData, "all maps are dark"),
        (lambda scene: (scene, {3: RAMP}), BadData, "light of int: wanted a name, or a Spectrum"),
        (
            lambda scene: (dataclasses.replace(scene, illuminant=unit_light(NODES)), {"A": RAMP}),
            BadData,
            "holds radiance",
        ),
        (lambda scene: ("chart", {"A": RAMP}), BadData, "scene: str, wanted a Scene"),
    ],
)
def test_bad_light_is_refused_in_one_line(change, error, words):
    with pytest.raises(error, match=words) as refused:
        gs.illuminate(*change(gs.Scene(FORMS["cube"], white_radiance(illuminant("E"), 100.0))))
    assert "\n" not in str(refused.value)
