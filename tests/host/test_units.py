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


# ---- headings

ENERGY_NM = 1239.841984  # [eV nm], CODATA 2018
AXES = {
    "wavelength_nm": lambda nm: nm,
    "wavelength": lambda nm: nm,
    "Wavelength (nm)": lambda nm: nm,
    "wavelength_um": lambda nm: nm / 1e3,
    "Wavelength [µm]": lambda nm: nm / 1e3,
    "wavelength_A": lambda nm: nm * 10,
    "Wavelength (Angstroms)": lambda nm: nm * 10,
    "lambda [Å]": lambda nm: nm * 10,
    "wavenumber": lambda nm: 1e7 / nm,
    "Wavenumber (cm^-1)": lambda nm: 1e7 / nm,
    "1/cm": lambda nm: 1e7 / nm,
    "Energy (eV)": lambda nm: ENERGY_NM / nm,
    "frequency_THz": lambda nm: 299792.458 / nm,
}


def write_table(path, heading, numbers, names, values, divider=","):
    """Write a table as a spreadsheet does, ascending in its first column."""
    order = np.argsort(numbers)
    lines = [[heading, *names]]
    lines += [[f"{numbers[i]:.9g}", *(f"{value[i]:.9g}" for value in values)] for i in order]
    if divider == ";":
        lines = [[cell.replace(".", ",") for cell in line] for line in lines]
    path.write_text("\n".join(divider.join(line) for line in lines), "utf-8")


@pytest.mark.parametrize("divider", [",", ";"])
@pytest.mark.parametrize("heading", AXES)
def test_the_unit_of_a_heading_is_read(heading, divider, tmp_path):
    nm = np.linspace(400, 700, 13)
    curves = np.stack([np.linspace(a, b, 13) for a, b in ((0.1, 0.5), (0.4, 0.2), (0.3, 0.1))])
    write_table(tmp_path / "qe.csv", heading, AXES[heading](nm), "RGB", curves, divider)
    (tmp_path / "a.toml").write_text('base = "phone"\n[sensor]\nqe = "qe.csv"\nir_cut = "none"\n')
    qe = gs.open_camera(tmp_path / "a.toml").sensor.qe
    np.testing.assert_allclose(qe.at(nm[1:-1]), curves[:, 1:-1], rtol=1e-6)
    scene = gs.open_scene(tmp_path / "qe.csv", size=(9, 9))
    np.testing.assert_allclose(scene.wavelengths, nm, rtol=1e-6)
    np.testing.assert_allclose(scene.content.spectra[:3], curves, rtol=1e-6)


@pytest.mark.parametrize("key", ["wavelengths_um", "wavelengths_A", "energy_eV", "wavenumber_cm-1"])
def test_a_table_of_a_camera_file_says_its_unit(key, tmp_path):
    nm = np.array([400.0, 500, 700])
    convert = {
        "wavelengths_um": AXES["wavelength_um"],
        "wavelengths_A": AXES["wavelength_A"],
        "energy_eV": AXES["Energy (eV)"],
        "wavenumber_cm-1": AXES["wavenumber"],
    }[key]
    numbers = [float(f"{number:.12g}") for number in convert(nm)]
    (tmp_path / "a.toml").write_text(
        f'base = "mono"\n[sensor]\nqe = {{{key} = {numbers}, "W_%" = [20, 60, 30]}}\n'
    )
    qe = gs.open_camera(tmp_path / "a.toml").sensor.qe
    # 1 nm inside: the base's qe_ends = "zero" begins at the ends
    np.testing.assert_allclose(
        qe.at([401, 500, 699])[0], np.interp([401, 500, 699], nm, [0.2, 0.6, 0.3]), rtol=1e-6
    )


@pytest.mark.parametrize(
    ("heading", "numbers", "words"),
    [
        ("wavelength_furlong", [400, 700], "unit of wavelengths 'furlong' is not known"),
        ("Wavelength (parsec)", [400, 700], "unit of wavelengths 'parsec' is not known"),
        ("wavelength", [0.4, 0.7], "name their unit"),
        ("frequency", [400, 700], "no unit"),
    ],
)
def test_an_unknown_unit_is_refused(heading, numbers, words, tmp_path):
    write_table(tmp_path / "qe.csv", heading, np.array(numbers), "RGB", np.full((3, 2), 0.2))
    (tmp_path / "a.toml").write_text('base = "phone"\n[sensor]\nqe = "qe.csv"\n')
    for read in (
        lambda: gs.open_camera(tmp_path / "a.toml"),
        lambda: gs.open_scene(tmp_path / "qe.csv"),
    ):
        with pytest.raises(gs.GpusimError, match=words) as raised:
            read()
        assert "\n" not in str(raised.value) and "qe.csv" in str(raised.value)


@pytest.mark.parametrize("names", [["R_%", "G_%", "B_%"], ["red (%)", "green (%)", "blue (%)"]])
def test_percent_are_shares_if_the_heading_says_so(names, tmp_path):
    nm, percent = np.array([400.0, 550, 700]), np.array([[1.0, 20, 50], [5, 40, 9], [30, 8, 1]])
    path = tmp_path / "qe.csv"
    (tmp_path / "a.toml").write_text('base = "phone"\n[sensor]\nqe = "qe.csv"\nir_cut = "none"\n')
    write_table(path, "wavelength_nm", nm, names, percent)
    camera = gs.open_camera(tmp_path / "a.toml")
    assert camera.sensor.channels == ("R", "G", "B")
    np.testing.assert_allclose(camera.sensor.qe.at([550])[:, 0], [0.2, 0.4, 0.08])
    write_table(path, "wavelength_nm", nm, "RGB", percent)
    with pytest.raises(gs.GpusimError, match='if they are percent, say so in the heading: "R_%"'):
        gs.open_camera(tmp_path / "a.toml")


def test_an_efficiency_below_one_percent_makes_a_frame(tmp_path):
    (tmp_path / "a.toml").write_text(
        'base = "mono"\n[sensor]\nqe = {wavelengths_nm = [400, 700], Y = [0.008, 0.006]}\ncfa = ["Y"]\n'
    )
    camera = gs.open_camera(tmp_path / "a.toml").with_(exposure_time_ms=100, model="none")
    scene = gs.scene_from(np.ones((31, 8, 8)), np.arange(400.0, 701.0, 10), unit="photon")
    scene = gs.Scene(scene.content.scale(1e16), scene.illuminant)
    mean = np.asarray(gs.Simulator(camera, device="numpy")(scene).mean)
    optics, pitch = camera.optics, camera.sensor.pixel_pitch
    # mean efficiency 0.7 % over 300 nm of 1e16 photons, through the lens's cone; the last pixels
    # see the fall-off of cos^4
    wanted = 1e16 * 300 * 0.007 * 0.1 * pitch**2 * np.pi / (1 + 4 * optics.f_number**2)
    assert mean.max() == pytest.approx(wanted * optics.transmission, rel=2e-3)


def test_lights_are_no_filters():
    for key in ("qe", "transmission"):
        light = gs.illuminant("D65").scale(1e-3)
        with pytest.raises(BadData, match="relative power, wanted shares"):
            gs.open_camera("mono").with_(**{key: light})


def test_light_without_a_scale_is_noted():
    nodes = np.arange(400.0, 701.0, 10)
    watts = gs.Spectrum(nodes, gs.illuminant("D65", nodes).values)  # as other programs tabulate it
    scene = gs.Scene(gs.Cube(nodes, np.ones((31, 8, 8), np.float32)), watts)
    report = gs.Simulator(gs.open_camera("mono"), device="numpy")(scene).report
    assert any("is relative, gs.scene_from" in note for note in report.notes)
    bright = gs.Scene(scene.content, white_radiance(gs.illuminant("D65"), 1e-3))
    report = gs.Simulator(gs.open_camera("mono"), device="numpy")(bright).report
    assert not any("relative" in note for note in report.notes)
