"""Photons, energy, radiance and luminance: judged by colour-science's tables and own trapezoids."""

import warnings

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import gpusim as gs
from gpusim.data.lights import white_radiance
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import (
    ENERGY,
    PHOTONS,
    RELATIVE,
    energy_from_photons,
    photons_from_energy,
)

JOULE = 6.62607015e-34 * 299792458 * 1e9  # of a photon, times its wavelength [J nm]
RANDOM = np.random.default_rng(5)
GRIDS = [np.arange(*ends, step) for ends in ((400.0, 701.0), (360.0, 831.0)) for step in (1, 5, 10)]
GRIDS += [np.arange(400.0, 701.0, 20), np.arange(360.0, 841.0, 20)]
ids = [f"{grid[0]:g}-{grid[-1]:g}-{grid[1] - grid[0]:g}" for grid in GRIDS]
SCENE = 1e-3  # "within 0.1 %"


@pytest.fixture(scope="module")
def eye():
    """V(lambda) of colour-science, as a function."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about optional packages
        import colour
    table = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return lambda at: np.interp(at, table.wavelengths, table.values[:, 1], 0, 0)


def luminance(scene, eye):
    """Mean luminance of a scene [cd m-2]: its samples joined by splines of degree 5, times its light."""
    nodes = scene.wavelengths
    content = scene.content.on_host()
    samples = np.tensordot(content.entry_spectra, content.planes, (0, 0)).mean(axis=(1, 2))
    at = np.arange(nodes[0], nodes[-1] + 0.05, 0.1)
    light = make_interp_spline(nodes, samples, k=5)(at) * scene.illuminant.at(at)
    return 683 * np.trapezoid(light * JOULE / at * eye(at), at)


def smooth(nodes):
    """A cube of smooth spectra, shape (L, 4, 5)."""
    middle = RANDOM.uniform(480, 620, (4, 5))
    return 0.2 + np.exp(-(((nodes[:, None, None] - middle) / 90) ** 2))


@pytest.mark.parametrize("nodes", GRIDS, ids=ids)
@pytest.mark.parametrize("unit", ["photon", "energy"])
def test_a_cube_of_radiance_gets_the_luminance_that_is_asked(nodes, unit, eye, tmp_path):
    values = smooth(nodes)
    scene = gs.scene_from(values, nodes, unit=unit, luminance=37.0)
    assert luminance(scene, eye) == pytest.approx(37, rel=SCENE)
    if unit == "energy":
        path = tmp_path / "cube.npy"
        np.save(path, values)
        scene = gs.open_scene(path, wavelengths=nodes, kind="radiance", luminance=37.0)
        assert luminance(scene, eye) == pytest.approx(37, rel=SCENE)
    path = tmp_path / "scene.npz"
    gs.save_scene(scene, path)
    assert luminance(gs.open_scene(path, luminance=5.0), eye) == pytest.approx(5, rel=SCENE)


@pytest.mark.parametrize("nodes", GRIDS, ids=ids)
def test_energy_stays_the_energy_of_the_file(nodes, eye):
    values = smooth(nodes).astype(np.float32)  # W m-2 sr-1 nm-1
    at = np.arange(nodes[0], nodes[-1] + 0.05, 0.1)
    wanted = make_interp_spline(nodes, values.mean(axis=(1, 2)), k=5)(at)
    wanted = 683 * np.trapezoid(wanted * eye(at), at)
    assert luminance(gs.scene_from(values, nodes, unit="energy"), eye) == pytest.approx(
        wanted, rel=SCENE
    )


@pytest.mark.parametrize("nodes", GRIDS, ids=ids)
def test_a_basis_of_radiance_gets_the_luminance_that_is_asked(nodes, eye, tmp_path):
    basis = np.stack([np.ones(len(nodes)), (nodes - 300) / 500])
    content = gs.Basis(nodes, RANDOM.uniform(0.1, 1, (2, 4, 5)).astype(np.float32), basis)
    light = gs.Spectrum(nodes[[0, -1]], np.ones(2))
    path = tmp_path / "basis.npz"
    gs.save_scene(gs.Scene(content, light), path)
    assert luminance(gs.open_scene(path, luminance=12.0), eye) == pytest.approx(12, rel=SCENE)


@pytest.mark.parametrize("nodes", GRIDS, ids=ids)
@pytest.mark.parametrize("light", ["D65", "E", "FL2", "LED-B3"])
def test_white_has_the_luminance_that_is_asked(nodes, light, eye):
    # D65 and E have 0.04 and 0.06 % of their luminance outside 400 .. 700 nm
    scene = gs.scene_from(np.ones((len(nodes), 3, 4)), nodes, light=light, luminance=250)
    assert luminance(scene, eye) == pytest.approx(250, rel=SCENE)
    chart = gs.chart("flat", light=light, luminance=250, wavelengths=nodes, size=(24, 24))
    white = gs.Scene(gs.Cube(nodes, np.ones((len(nodes), 1, 1), np.float32)), chart.illuminant)
    assert luminance(white, eye) == pytest.approx(250, rel=SCENE)


def test_a_photograph_has_the_luminance_that_is_asked(eye, tmp_path):
    from PIL import Image

    path = tmp_path / "white.png"
    Image.fromarray(np.full((4, 5, 3), 255, np.uint8)).save(path)
    assert luminance(gs.open_scene(path, luminance=80.0), eye) == pytest.approx(80, rel=SCENE)
    assert luminance(gs.scene_from(np.ones((4, 5, 3)), luminance=80.0), eye) == pytest.approx(
        80, rel=SCENE
    )


@pytest.mark.parametrize("step", [1, 5, 10, 20, 50, 300])
def test_a_light_has_its_luminance_however_coarse_its_table(step, eye):
    nodes = np.arange(400.0, 701.0, step)
    table = gs.Spectrum(nodes, 1 + (nodes - 400) / 100, "ramp")  # in energy
    white = white_radiance(table, 100.0)
    at = np.linspace(400, 700, 3001)
    found = 683 * np.trapezoid(white.at(at) * JOULE / at * eye(at), at)
    # light that is linear in energy stays linear in energy: within the conversion's 10 nm steps the
    # luminance differs by less than (10 / 400)^2 / 4 = 1.6e-4
    assert found == pytest.approx(100, rel=1.6e-4)
    back = energy_from_photons(white).at(at)
    # (10 / 400)^2 / 4: the largest difference of 1 / wavelength from its chord of 10 nm
    np.testing.assert_allclose(back / back[0], 1 + (at - 400) / 100, rtol=2e-4)


def test_a_spectrum_knows_its_quantity():
    assert gs.illuminant("D65").quantity == RELATIVE
    white = white_radiance(gs.illuminant("D65"), 100.0)
    assert white.quantity == PHOTONS and white.unit == "photon s-1 m-2 sr-1 nm-1"
    assert energy_from_photons(white).quantity == ENERGY
    assert photons_from_energy(energy_from_photons(white)).quantity == PHOTONS
    for convert, wrong in ((photons_from_energy, white), (energy_from_photons, gs.illuminant("A"))):
        with pytest.raises(BadData, match="to convert to"):
            convert(wrong)
    with pytest.raises(gs.GpusimError, match="quantity of a spectrum"):
        gs.Spectrum([400, 700], [1, 1], quantity="lux")


def test_relative_light_is_no_light_of_a_scene(eye):
    nodes = np.arange(400.0, 701.0, 10)
    cube = gs.Cube(nodes, np.ones((31, 4, 4), np.float32))
    remedy = r'gs.scene_from\(cube, wavelengths, light="D65", luminance=100\)'
    for light in (gs.illuminant("D65"), gs.illuminant("A", nodes), gs.illuminant("E").scale(3)):
        with pytest.raises(BadData, match=remedy):
            gs.Scene(cube, light)
    # photons, with and without their quantity, and energy are lights
    photons = white_radiance(gs.illuminant("D65"), 100.0)
    plain = gs.Spectrum(photons.wavelengths, photons.values)
    for light in (photons, plain, energy_from_photons(photons)):
        assert luminance(gs.Scene(cube, light), eye) == pytest.approx(100, rel=SCENE)
    # a scene's own light may light a chart
    chart = gs.chart("flat", light=photons, luminance=40, size=(24, 24))
    np.testing.assert_allclose(chart.illuminant.values, 0.4 * photons.values, rtol=1e-4)


def test_a_spectrum_of_another_quantity_is_no_light(eye):
    share = gs.Spectrum([400, 700], [1, 1], "filter", "share")
    with pytest.raises(BadData, match="wanted a light's"):
        gs.chart("flat", light=share)


def test_dark_radiance_cannot_be_scaled():
    nodes = np.arange(400.0, 701.0, 10)
    with pytest.raises(BadData, match="cannot be scaled"):
        gs.scene_from(np.zeros((31, 4, 4)), nodes, luminance=5)
    with pytest.raises(BadData, match="cannot be scaled"):  # no eye sees it
        gs.scene_from(np.ones((31, 4, 4)), nodes + 600, luminance=5)
