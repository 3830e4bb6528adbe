"""Cameras composed by name from small data bases: values, sources, guesses and refusals."""

import tomllib

import numpy as np
import pytest
from named_databases import MATRICES, write_databases

import gpusim as gs
from gpusim.apps.named.colour_keys import spread_to_edges
from gpusim.apps.named.lens_keys import channel_curve
from gpusim.apps.named.response import NODES, Matrix, fit_response, typical_response
from gpusim.cli.main import main
from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadData, BadFile, Conflict, OutOfRange
from gpusim.domain.spectrum import Spectrum, photons_from_energy

ZOOM = "zoom 20-60"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_databases(tmp_path_factory.mktemp("databases"))


@pytest.fixture(scope="module")
def composed(folder):
    return gs.compose_camera("Acme Z1", iso=100, lens=ZOOM, focal_length=30e-3, databases=folder)


def test_values_and_their_sources(composed, tmp_path):
    composed.save(tmp_path / "camera.toml")
    camera = gs.open_camera(tmp_path / "camera.toml")
    assert digest(camera) == digest(composed.camera) and not camera.notes
    sensor = camera.sensor
    white, black = (16000 + 15800 + 16000) / 3, 512
    assert (sensor.bits, sensor.black_level) == (14, black)
    assert sensor.full_well == pytest.approx(1e5) and composed.size == (600, 400)
    assert sensor.gain == pytest.approx(1e-5 * (white - black))
    rounding = 1 / 12 / (white - black) ** 2
    assert sensor.noise.read == pytest.approx(np.sqrt(1e-8 - rounding) / 1e-5)
    assert sensor.pixel_pitch == pytest.approx(36e-3 / 1.5 / 600, rel=1e-4)
    assert camera.optics.focal_length == pytest.approx(30e-3) and camera.optics.f_number == 2.8
    for key in composed.keys:
        assert key.source, key.name
    words = composed.text.replace("\n#  ", "").replace("\n# ", "\n")
    for part in ("noiseprofiles.json", "Acme Z1.dcp", "camconst.json", "acme.xml", "guess"):
        assert part in words


def test_distortion_by_hand(composed):
    """Acme's 30 mm calibration at a point: r is 1 at half the short side of the frame."""
    pitch, (columns, rows) = composed.camera.sensor.pixel_pitch, composed.size
    unit = np.hypot(columns - 1, rows - 1) / 2 / np.hypot(1.5, 1) * pitch
    model = composed.camera.optics.distortion
    for r in (0.3, 1.0, 1.6):
        wanted = r * (0.004 * r**3 - 0.01 * r**2 + 0.005 * r + 1 - 0.004 + 0.01 - 0.005)
        found = model.distort(r * unit / model.radius, 0.0)[0] * model.radius / unit
        assert found == pytest.approx(wanted, abs=1e-5)


def test_vignetting_by_hand(folder):
    camera = gs.compose_camera("Acme Z1", lens=ZOOM, databases=folder).camera
    terms = camera.optics.relative_illumination
    # lensfun's corner is the middle of a pixel: (1 + 1 / 400)^6 = 1.015
    assert terms == pytest.approx((0, -0.5, 0, 0.1, 0, -0.05), rel=0.015)
    far = gs.compose_camera("Acme Z1", lens=ZOOM, f_number=22, databases=folder)
    assert far.camera.optics.relative_illumination != "cos4"
    prime = gs.compose_camera("Acme Z1", lens="40mm f/2", databases=folder)
    assert prime.camera.optics.relative_illumination == "cos4" and prime.camera.optics.f_number == 2
    assert any(key.is_guess and "vignetting" in key.source for key in prime.keys)


def test_channels_see_the_lateral_colour_of_the_lens(folder):
    camera = gs.compose_camera("Acme Z1", lens="40mm f/2", databases=folder).camera
    photons = photons_from_energy(illuminant("D65")).at(NODES)
    weights = camera.sensor.qe.at(NODES) * photons
    mean = weights @ camera.optics.lateral_color_at(NODES) / weights.sum(axis=1)
    np.testing.assert_allclose(mean, [2e-4, 0, -2e-4], atol=1e-8)
    values = channel_curve((NODES, typical_response()), (1e-3, 0.0, -1e-3))
    assert values[0] < 0 < values[2]


def test_responses_agree_with_the_matrices():
    """The ColorChecker, which none was fitted to, as the matrices see it."""
    names = {17: "A", 21: "D65"}
    found = fit_response([Matrix(names[key], own, names[key]) for key, own in MATRICES.items()])
    assert found.qe.min() >= 0 and found.qe.max() == pytest.approx(0.55)
    patches = np.vstack([np.ones(len(NODES)), reflectances("colorchecker").at(NODES)])
    for key, matrix in MATRICES.items():
        light = illuminant(names[key])
        seen = patches * photons_from_energy(light).at(NODES) @ found.qe.T
        wanted = xyz(Spectrum(NODES, patches), light) @ matrix.T
        error = seen / seen[0, 1] - wanted / wanted[0, 1]
        assert np.sqrt(np.mean(error**2)) < 0.02


def test_noise_of_iso_channel_and_full_well(folder):
    def sensor(**more):
        return gs.compose_camera("Acme Z1", databases=folder, **more).camera.sensor

    assert sensor().full_well == pytest.approx(1e5)  # the lowest ISO that is not skipped
    assert sensor(iso=100, channel="R").full_well == pytest.approx(5e4)
    assert sensor(iso=400).noise.read == 0  # b < 0
    scaled = sensor(iso=100, full_well=2e4)
    assert scaled.full_well == pytest.approx(2e4)
    assert scaled.noise.read == pytest.approx(
        np.sqrt(5e-8 - 1 / 12 / (15933.3 - 512) ** 2) * 2e4, rel=1e-3
    )
    text = gs.compose_camera("Acme Z1", iso=400, databases=folder).text.replace("\n#  ", "")
    assert "b = -1e-08 <= 0" in text and "read noise 0" in text


def test_built_in_lenses_and_cameras_without_data(folder):
    compact = gs.compose_camera("Compact 5", columns=400, databases=folder)
    assert compact.camera.optics.focal_length == pytest.approx(6e-3) and compact.size == (400, 300)
    assert any(key.is_guess and "no noise data" in key.source for key in compact.keys)
    plain = gs.compose_camera("Z10", databases=folder)
    assert plain.camera.optics.distortion is None and any("ideal" in note for note in plain.notes)


def test_a_fisheye_is_a_table(folder):
    """Equidistant: the image height is the angle times the focal length."""
    found = gs.compose_camera("Acme Z1", lens="fish", databases=folder)
    model = found.camera.optics.distortion
    angle = 0.8
    image = model.distort(10e-3 * np.tan(angle) / model.radius, 0.0)[0] * model.radius
    assert image == pytest.approx(10e-3 * angle, rel=1e-5)


def test_raspberry_pi(folder):
    found = gs.compose_camera("imx477", iso=200, databases=folder)
    sensor = found.camera.sensor
    assert (sensor.bits, sensor.black_level, found.size) == (12, 256, (4056, 3040))
    assert sensor.full_well == pytest.approx((65535 - 4096) / 2.8**2 / 2)
    assert sensor.vignetting is not None and found.camera.optics.relative_illumination == "none"
    mono = gs.compose_camera("imx296 mono", databases=folder).camera
    assert mono.sensor.is_monochrome
    cells = np.array([[1.0, 0.8], [0.6, 0.4]])
    np.testing.assert_allclose(spread_to_edges(cells), [[1.0, 0.9], [0.5, 0.2]], atol=0.11)


def test_own_sensitivities_and_profiles(folder, tmp_path):
    path = tmp_path / "own.csv"
    rows = [
        f"{at:g},{r:.4f},{g:.4f},{b:.4f}"
        for at, r, g, b in zip(NODES, *typical_response(), strict=True)
    ]
    path.write_text("\n".join(["wavelength_nm,R,G,B", *rows]))
    found = gs.compose_camera("Acme Z1", sensitivity=path, databases=folder)
    assert found.camera.sensor.qe.values.max() == pytest.approx(0.55)
    profile = folder / "rawtherapee/dcpprofiles/Acme Z1.dcp"
    assert gs.compose_camera("Z10", profile=profile, databases=folder).camera.sensor.qe is not None
    with pytest.raises(Conflict, match="one of them"):
        gs.compose_camera("Z1", profile=profile, sensitivity=path, databases=folder)
    path.write_text("wavelength_nm,Y\n400,1\n700,1\n")
    with pytest.raises(BadData, match="wanted R, G, B"):
        gs.compose_camera("Z1", sensitivity=path, databases=folder)


@pytest.mark.parametrize(
    "more, words",
    [
        ({"iso": 25600}, r"iso = 25600.*100 \.\. 400"),
        ({"iso": "high"}, "iso = 'high'"),
        ({"f_number": -1}, "f_number"),
        ({"distance": 0}, "distance"),
        ({"columns": 3.5}, "columns"),
        ({"lens": ZOOM, "focal_length": 0.2}, r"20 \.\. 60 mm"),
        ({"channel": "Y"}, "channel"),
        ({"lens": "Zom 20-60"}, "near names"),
        ({"lens": 3}, "lens: 3"),
        ({"profile": "none.dcp"}, "no such file"),
        ({"full_well": float("nan")}, "full_well"),
    ],
)
def test_refusals(folder, more, words):
    with pytest.raises(gs.GpusimError, match=words) as error:
        gs.compose_camera("Acme Z1", databases=folder, **more)
    assert "\n" not in str(error.value)


def test_a_distortion_that_turns_back_is_refused(folder, tmp_path):
    text = (folder / "lensfun/acme.xml").read_text().replace('k1="-0.02"', 'k1="-0.4"')
    (tmp_path / "acme.xml").write_text(text)
    with pytest.raises(OutOfRange, match="turns back"):
        gs.compose_camera("Z10", lens="40mm f/2", databases=tmp_path)


def test_command(folder, tmp_path, capsys):
    at = ["--databases", str(folder)]

    def run(*words, status=0):
        assert main(["cameras", *words, *at]) == status
        said = capsys.readouterr()
        return said.out if status == 0 else said.err

    assert "4 lenses" in run() and "Acme Z1 Kit" in run("acme z1")
    assert "3 ptlens" in run("Acme Z1", "--lens", "zoom")
    out = tmp_path / "camera.toml"
    assert "noise.read_e" in run("Acme Z1", "--iso", "100", "--lens", "zoom", "-o", str(out))
    table = tomllib.loads(out.read_text())
    assert table["base"] == "none" and gs.open_camera(out).name == "Acme Z1"
    assert "near names: Acme Z1" in run("Acmee Z1", status=2)
    assert "no name is given" in run("--iso", "100", status=2)
    assert "is no .toml file" in run("Acme Z1", "-o", str(tmp_path / "x.png"), status=2)
    assert (
        run("Acme Z1", "--iso", "9e9", "-o", str(tmp_path / "no.toml"), status=2).count("\n") == 1
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camera.toml"]


def test_damaged_data_bases_are_named(tmp_path):
    (tmp_path / "noiseprofiles.json").write_text('{"noiseprofiles": 3}')
    with pytest.raises(BadFile, match=r"noiseprofiles\.json: noiseprofiles = 3"):
        gs.find_cameras("x", databases=tmp_path)
