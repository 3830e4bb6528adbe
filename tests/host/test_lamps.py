"""Lamps and reflectances from files, written by colour-science and as spreadsheets write them."""

import warnings

import numpy as np
import pytest

import gpusim as gs
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadFile, GpusimError

NM = np.arange(380.0, 781, 5)
POWER = 5 + 90 * np.exp(-(((NM - 452) / 11) ** 2)) + 60 * np.exp(-(((NM - 560) / 55) ** 2))


@pytest.fixture(scope="module")
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about optional packages
        import colour
    return colour


def write_tm27(colour, path, values=POWER, quantity="radiance"):
    """Write an IES TM-27-14 file by colour-science."""
    made = colour.SpectralDistribution_IESTM2714(
        str(path), data=values, domain=NM, spectral_quantity=quantity, header=header(colour)
    )
    assert made.write()
    return path


def header(colour):
    return colour.io.tm2714.Header_IESTM2714(
        manufacturer="a", catalog_number="1", description="LED", unique_identifier="x"
    )


TABLES = {
    "plain.csv": (",", "wavelength,power", lambda nm: nm),
    "units.csv": (",", "Wavelength (nm),W/m^2/nm", lambda nm: nm),
    "um.csv": (",", "wavelength_um,irradiance", lambda nm: nm / 1e3),
    "angstrom.csv": ("\t", "Wavelength [A]\tpower", lambda nm: nm * 10),
    "bare.csv": (",", "", lambda nm: nm),
    "commas.csv": (";", "nm;power", lambda nm: nm),
}


def write_lamp(path, values=POWER):
    divider, heading, convert = TABLES[path.name]
    lines = [heading] * bool(heading)
    for nm, value in zip(convert(NM), values, strict=True):
        line = f"{nm:.9g}{divider}{value:.12g}"
        lines.append(line.replace(".", ",") if divider == ";" else line)
    path.write_text("\n".join(lines))
    return path


def is_lamp(light):
    np.testing.assert_allclose(light.wavelengths, NM, rtol=1e-9)
    np.testing.assert_allclose(light.values, POWER, rtol=1e-9)
    assert light.quantity == "relative power"


@pytest.mark.parametrize("name", TABLES)
def test_a_lamp_from_a_table(name, tmp_path):
    is_lamp(gs.illuminant(str(write_lamp(tmp_path / name))))


@pytest.mark.parametrize("name", ["lamp.spdx", "lamp.xml"])
def test_a_lamp_from_tm27(name, colour, tmp_path):
    path = write_tm27(colour, tmp_path / name)
    is_lamp(gs.illuminant(path))
    np.testing.assert_allclose(
        gs.illuminant(str(path), [400, 500]).values, np.interp([400, 500], NM, POWER), rtol=1e-9
    )


def test_photons_of_a_lamp_are_converted(tmp_path):
    photons = POWER * NM  # up to a factor
    path = tmp_path / "lamp.csv"
    path.write_text(
        "wavelength_nm,photon flux\n"
        + "\n".join(f"{nm},{value:.12g}" for nm, value in zip(NM, photons, strict=True))
    )
    found = gs.illuminant(str(path))
    np.testing.assert_allclose(found.values / found.values[0], POWER / POWER[0], rtol=1e-9)


def test_lamps_light_whatever_takes_a_light(colour, tmp_path, monkeypatch):
    path = str(write_tm27(colour, tmp_path / "lamp.spdx"))
    wanted = gs.chart("flat", size=(24, 24), light=gs.Spectrum(NM, POWER), luminance=50).illuminant
    nodes = np.arange(400.0, 701.0, 10)
    np.save(tmp_path / "cube.npy", np.full((31, 4, 4), 0.5, np.float32))
    scenes = [
        gs.chart("flat", size=(24, 24), light=path, luminance=50),
        gs.open_scene("colorchecker", size=(24, 24), light=path, luminance=50),
        gs.open_scene(tmp_path / "cube.npy", wavelengths=nodes, light=path, luminance=50),
        gs.scene_from(np.full((31, 4, 4), 0.5), nodes, light=path, luminance=50),
        gs.scene_from(np.full((4, 4, 3), 0.5), light=path, luminance=50),
    ]
    for scene in scenes:
        np.testing.assert_allclose(scene.illuminant.values, wanted.values, rtol=1e-9)
    (tmp_path / "a.toml").write_text('base = "phone"\n[processor]\ntarget = "lamp.spdx"\n')
    monkeypatch.chdir("/")
    camera = gs.open_camera(tmp_path / "a.toml")
    gs.Simulator(camera, device="numpy")(scenes[0])


def test_reflectances_from_files(colour, tmp_path):
    wanted = reflectances("macbeth")
    lines = [["nm", *(f"patch {n + 1}" for n in range(24))]]
    rows = zip(wanted.wavelengths, wanted.values.T, strict=True)
    lines += [[f"{nm:g}", *(f"{value:.9g}" for value in row)] for nm, row in rows]
    path = tmp_path / "macbeth.csv"
    path.write_text("\n".join(",".join(line) for line in lines))
    np.testing.assert_allclose(reflectances(path).values, wanted.values, rtol=1e-8)
    scene = gs.chart("flat", size=(24, 24))
    pictures = []
    for training in ("macbeth", str(path)):
        camera = gs.open_camera("phone").with_(training=training)
        pictures.append(np.asarray(gs.Simulator(camera, device="numpy")(scene).rgb))
    np.testing.assert_array_equal(*pictures)
    spdx = write_tm27(colour, tmp_path / "r.spdx", POWER / 200, "reflectance")
    np.testing.assert_allclose(reflectances(spdx).values, POWER[None] / 200, rtol=1e-9)


def test_percent_reflectances_are_shares(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("wavelength_nm,R (%)\n400,10\n500,50\n700,90\n")
    np.testing.assert_allclose(reflectances(path).values, [[0.1, 0.5, 0.9]])
    np.testing.assert_allclose(gs.open_scene(path, size=(9, 9)).content.spectra[0], [0.1, 0.5, 0.9])
    # the user's scale stands for 1
    scene = gs.open_scene(path, size=(9, 9), scale=100)
    np.testing.assert_allclose(scene.content.spectra[0], [0.1, 0.5, 0.9])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "wavelength_nm,a,b\n400,1,2\n500,2,3\n", "2 spectra; wanted the one of a lamp"),
        ("a.csv", "wavenumber,power\n14000,1\n25000,2\n", "may be per nm or per their unit"),
        ("a.csv", "wavelength_nm,power\n400,-1\n500,2\n", "wanted none below 0"),
        ("a.csv", "wavelength_stone,power\n400,1\n500,2\n", "'stone' is not known"),
        ("a.spdx", "<IESTM2714>", "not an IES TM-27 spectrum"),
        ("a.xml", "<?xml version='1.0'?><svg/>", "0 SpectralData"),
        ("a.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "declares entities"),
        ("a.spdx", "", "not an IES TM-27 spectrum"),
        ("missing.spdx", None, "no such file"),
    ],
)
def test_other_files_are_refused_in_a_line(name, text, words, tmp_path):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadFile, match=words) as refused:
        gs.illuminant(str(path))
    assert "\n" not in str(refused.value) and name in str(refused.value)


def test_a_filter_is_no_lamp(colour, tmp_path):
    path = write_tm27(colour, tmp_path / "f.spdx", POWER / 200, "transmittance")
    with pytest.raises(GpusimError, match="SpectralQuantity 'transmittance'"):
        gs.illuminant(path)


def test_radiance_over_wave_numbers_is_refused(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("wavenumber,a\n14000,0.1\n25000,0.2\n")
    with pytest.raises(BadFile, match="may be per nm or per their unit"):
        gs.open_scene(path, size=(9, 9), kind="radiance")
    np.testing.assert_allclose(gs.open_scene(path, size=(9, 9)).wavelengths, [400, 1e7 / 14000])
