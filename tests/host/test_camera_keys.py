"""Keys of camera files: a file and `with_` do the same with every one, and mosaics have their curves."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cameras import LIBRARY
from test_noise_profile import dng

import gpusim as gs
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadData, GpusimError
from gpusim.domain.guided import BUILT_IN
from gpusim.domain.mosaics import MOSAICS

CURVE = {"wavelengths_nm": [400, 700], "values": [0.9, 0.8]}
SENSITIVITY = {
    "wavelengths_nm": [400, 550, 700],
    "R": [0, 0.2, 1],
    "G": [0.1, 0.8, 0.1],
    "B": [0.7, 0.1, 0],
}
INFO = """image_width: 640
image_height: 480
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0, 0, 0]}
camera_matrix: {rows: 3, cols: 3, data: [600, 0, 320, 0, 600, 240, 0, 0, 1]}
"""
# a value of every key, and further keys that it needs
VALUES = {
    "optics": {
        "f_number": 2.8,
        "focal_length_mm": 5.5,
        "model": "none",
        "transmission": CURVE,
        "relative_illumination": [1.0, -0.2],
        "object_distance_m": 3.0,
        "pupil": {"blades": 6, "rotation_deg": 10},
        "mask": "mask.npy",
        "defocus_um": 3.0,
        "birefringence_um": [1.0, 0.5],
        "diffuser_um": 0.7,
        "psf": "lens.npz",
        "distortion": {"k1": -0.1, "k2": 0.01, "radius_mm": 2.0},
        "lateral_color": {"wavelengths_nm": [450, 650], "excess": [-1e-3, 1e-3]},
        "defocus_diopters": 0.1,
        "zernike_waves": [0.0, 0.1, 0.1, 0.05],
        "zernike_heights": ([0.0, 2.0], {"zernike_waves": [[0.0, 0.1], [0.0, 0.2]]}),
        "seidel_waves": [0.1, 0, 0, 0, 0],
        "reference_nm": ([560][0], {"seidel_waves": [0.1, 0, 0, 0, 0]}),
        "calibration": "info.yaml",
    },
    "sensor": {
        "pixel_pitch_um": 2.2,
        "qe": "iset-rgb",
        "full_well_e": 9000,
        "bits": 12,
        "cfa": "rgbw",
        "stacked": True,
        "fill_factor": 0.5,
        "photodetector_size": [0.9, 0.5],
        "photodetector_centre": ([0.1, 0.0], {"fill_factor": 0.5}),
        "offset": [0.5, 0.25],
        "microlens": {"angles_deg": [0, 20], "response": [1, 0.8], "shift": 0.5},
        "lenslets": {
            "pitch_um": 14,
            "focal_length_um": 40,
            "layout": "hexagonal",
            "gap_um": "auto",
        },
        "dual": {
            "split": "up-down",
            "transition": 0.1,
            "reference_f_number": 1.8,
            "crosstalk": {"wavelengths_nm": [400, 700], "values": [0.01, 0.1]},
            "misalignment_deg": 2,
            "follows_chief_ray": False,
            "sparse": "masked",
            "cell": [8, 8],
            "places": [[0, 1, "top"]],
        },
        "vignetting": [[0.8, 1.0], [1.0, 0.9]],
        "exposure_time_ms": 7,
        "auto_exposure": {"method": "mean", "level": 0.2},
        "row_time_us": 10,
        "binning": [2, 2],
        "binning_mode": "digital",
        "gain_e_per_dn": 6.0,
        "conversion_gain_uv_per_e": (100, {"adc_range_v": 1}),
        "adc_range_v": (1, {"conversion_gain_uv_per_e": 100}),
        "analog_gain": 2,
        "analog_offset_e": 10,
        "black_level_dn": 32,
        "sensitivity": SENSITIVITY,
        "sensitivity_peak": (0.4, {"sensitivity": SENSITIVITY}),
        "photodetector": CURVE,
        "ir_cut": "none",
        "qe_ends": "zero",
        "noise_profile": "a.dng",
        "gain_dn_per_e": 0.2,
    },
    "noise": {
        "photon": "none",
        "reset_e": 2.0,
        "seed": 5,
        "hot_pixels": 1e-3,
        "dead_pixels": 1e-3,
        "telegraph_pixels": 1e-3,
        "telegraph_switching": 0.4,
    },
    "processor": {
        "defects": "known",
        "shading": True,
        "denoise": 1.0,
        "denoise_by": "mosaic",
        "demosaic": "malvar",
        "table": None,
        "network": None,
        "white_balance": "gray-world",
        "color": "ridge",
        "training": "macbeth",
        "target": "A",
        "scaling": "normalised",
        "tone": [[0, 0], [1, 1]],
        "sharpen": 0.5,
        "look": "camera",
        "highlights": "rebuild",
        "lens_corrections": True,
        "local_tone": 0.5,
        "gamut": "map",
        "white": ([2, 1, 1.5], {"white_balance": "preset"}),
    },
    "display": {
        "name": "display-p3",
        "primaries": [[0.6, 0.3], [0.3, 0.6], [0.15, 0.06]],
        "white": [0.31, 0.33],
        "curve": 2.2,
        "luminance_cd_per_m2": 200,
    },
}
KEYS = [(section, key) for section, keys in SECTIONS.items() for key in keys]


def in_toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {in_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(in_toml, value))}]"
    return json.dumps(value)


def changes_of(section, key):
    value = VALUES[section].get(key, 0.5)
    value, more = value if isinstance(value, tuple) else (value, {})
    return {key: value, **more}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "info.yaml").write_text(INFO)
    (tmp_path / "a.dng").write_bytes(dng(profile=(1e-3, 2e-5)))
    spread = np.zeros((2, 9, 9))
    spread[:, 4, 4] = 1
    np.save(tmp_path / "mask.npy", [[1, 0.5j], [0, 1]])
    np.savez(tmp_path / "lens.npz", wavelengths_nm=[400.0, 700.0], psf=spread, spacing_um=1.0)
    return tmp_path


def same(one, two):
    """Whether cameras are the same but for their names, and those of their curves."""
    plain = gs.Spectrum([400, 700], np.ones((len(one.sensor.channels), 2)))
    for pair in (one, two):
        assert pair.sensor.qe.values.shape[0] == len(pair.sensor.channels)
    np.testing.assert_array_equal(one.sensor.qe.wavelengths, two.sensor.qe.wavelengths)
    np.testing.assert_array_equal(one.sensor.qe.values, two.sensor.qe.values)
    through = [pair.optics.transmission for pair in (one, two)]
    if isinstance(through[0], gs.Spectrum):
        np.testing.assert_array_equal(through[0].values, through[1].values)
    cameras = [
        replace(
            pair,
            name="",
            sensor=replace(pair.sensor, qe=plain),
            optics=replace(pair.optics, transmission=1.0, lateral_color=0.0),
            display=replace(pair.display, name=""),
        )
        for pair in (one, two)
    ]
    for part in ("optics", "sensor", "processor", "display"):
        assert digest(getattr(cameras[0], part)) == digest(getattr(cameras[1], part)), part


@pytest.mark.parametrize(("section", "key"), KEYS, ids=[".".join(pair) for pair in KEYS])
def test_a_file_and_with_do_the_same(section, key, folder):
    if VALUES[section].get(key, 0) is None:
        pytest.skip("a table of filters is learned, see the tests of its reader")
    changes = changes_of(section, key)
    lines = [f"{name} = {in_toml(value)}" for name, value in changes.items()]
    (folder / "a.toml").write_text("\n".join(['base = "phone"', f"[{section}]", *lines]))
    try:
        by_file = gs.open_camera(folder / "a.toml")
    except GpusimError as error:  # then `with_` refuses it, too
        with pytest.raises(GpusimError) as refused:
            gs.open_camera("phone").with_(**{f"{section}.{k}": v for k, v in changes.items()})
        assert str(refused.value).split(":")[-1] == str(error).split(":")[-1]
        return
    by_with = gs.open_camera("phone").with_(**{f"{section}.{k}": v for k, v in changes.items()})
    same(by_file, by_with)
    assert digest(by_file) != digest(gs.open_camera("phone")) or key in ("qe_ends",)
    assert by_file.notes == by_with.notes


# ---- named mosaics


@pytest.mark.parametrize("base", LIBRARY)
@pytest.mark.parametrize("name", MOSAICS)
def test_named_mosaics_run_on_every_built_in_camera(name, base, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f'base = "{base}"\n[sensor]\ncfa = "{name}"\n')
    camera = gs.open_camera(path)
    same(camera, gs.open_camera(base).with_(cfa=name))
    assert set(camera.sensor.channels) == set("".join(MOSAICS[name]))
    qe = camera.sensor.qe.at(np.arange(400.0, 701.0, 10))
    assert (qe.max(axis=1) > 0.01).all() and qe.max() <= 1
    own = dict(zip(camera.sensor.channels, qe, strict=True))
    if "W" in own:  # no filter passes more than none
        assert all(own["W"].mean() >= curve.mean() for curve in own.values())


def test_curves_that_follow_from_others_by_hand():
    nodes = np.array([400.0, 550.0, 700.0])
    table = gs.Spectrum(nodes, np.array([[0.1, 0.3, 0.6], [0.1, 0.5, 0.1], [0.4, 0.2, 0.0]]))
    from gpusim.domain.filters import Filters

    filters = Filters(table, ("R", "G", "B"))
    wanted = {
        "W": [0.4, 0.5, 0.6],
        "Y": [0.2, 0.5, 0.6],
        "C": [0.4, 0.5, 0.1],
        "M": [0.4, 0.5, 0.6],
        "E": [0.2, 0.1**0.5, 0.0],
    }
    for letter, curve in wanted.items():
        qe, channels = filters.of(("R" + letter,))
        assert channels == ("R", letter)
        np.testing.assert_allclose(qe.at(nodes)[1], curve, rtol=1e-12)
        assert len(filters.notes(channels)) == 1
    near, channels = filters.of(("RN",))
    # half of the clear pixel's 0.6 at 700 nm; all of it at 750 nm, which falls to 0 at 1100 nm
    np.testing.assert_allclose(
        near.at([600, 700, 750, 1100])[1], [0, 0.3, 0.6 * 0.875, 0], rtol=1e-9
    )


def test_a_frame_of_every_mosaic_says_how_it_is_demosaicked():
    scene = gs.chart("colorchecker", size=(24, 16))
    for name in ("x-trans", "quad-bayer", "rgbw", "rccb", "rccc", "ryyb", "rgbn", "cyym"):
        report = gs.Simulator(gs.open_camera("phone").with_(cfa=name), device="numpy")(scene).report
        stage = "processor.guided" if name in BUILT_IN else "processor.best"
        assert any(found.stage == stage for found in report.stages), name
        derived = set("".join(MOSAICS[name])) - {*"RGBW"}
        assert all(f"curve of {letter}" in str(report) for letter in derived)


# ---- whole sensitivities


def test_a_whole_sensitivity_replaces_qe_and_filters(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f'base = "phone"\n[sensor]\nsensitivity = {in_toml(SENSITIVITY)}\n')
    camera = gs.open_camera(path)
    np.testing.assert_allclose(camera.sensor.qe.at([550])[:, 0], [0.2, 0.8, 0.1])
    assert "relative sensitivities" in camera.sensor.notes[0]
    path.write_text(path.read_text() + "sensitivity_peak = 0.5\n")
    camera = gs.open_camera(path)
    np.testing.assert_allclose(camera.sensor.qe.at([550])[:, 0], [0.1, 0.4, 0.05])
    assert not camera.sensor.notes
    report = gs.Simulator(camera, device="numpy")(gs.chart("flat", size=(24, 24))).report
    assert not any("sensitivit" in note for note in report.notes)
    for line in ('ir_cut = "ir-cut-phone"', 'qe = "mt9v024"'):
        path.write_text(f'base = "phone"\n[sensor]\nsensitivity = {in_toml(SENSITIVITY)}\n{line}\n')
        with pytest.raises(GpusimError, match=r"sensitivity.*wanted one of them"):
            gs.open_camera(path)


def test_relative_sensitivities_have_any_scale(tmp_path):
    table = {key: [100 * x for x in values] for key, values in SENSITIVITY.items()}
    table["wavelengths_nm"] = SENSITIVITY["wavelengths_nm"]
    path = tmp_path / "a.toml"
    path.write_text(f'base = "phone"\n[sensor]\nsensitivity = {in_toml(table)}\n')
    camera = gs.open_camera(path)
    np.testing.assert_allclose(camera.sensor.qe.at([550])[:, 0], [0.2, 0.8, 0.1])
    assert "highest is taken as 1 e-/photon" in camera.sensor.notes[0]


# ---- gains


@pytest.mark.parametrize(
    ("changes", "is_warned"),
    [
        ({"gain_dn_per_e": 0.16}, False),
        ({"gain_e_per_dn": 6.25}, False),
        ({"gain_dn_per_e": 6.25}, True),  # e-/DN written as DN/e-: 39 times the range
        ({"gain_e_per_dn": 0.16}, True),
        ({"gain_dn_per_e": 0.01, "full_well_e": 2400, "bits": 12, "black_level_dn": 0}, True),
        ({"gain_dn_per_e": 2.0}, False),  # ISO 1250
    ],
)
def test_a_gain_that_cannot_be_is_reported(changes, is_warned):
    camera = gs.open_camera("phone").with_(**changes)
    key, value = next(iter(changes.items()))
    assert camera.sensor.gain == pytest.approx(value if key == "gain_dn_per_e" else 1 / value)
    report = gs.Simulator(camera, device="numpy")(gs.chart("flat", size=(24, 24))).report
    assert any("gain_e_per_dn" in note for note in report.notes) == is_warned


def test_one_gain_is_given_once(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('base = "phone"\n[sensor]\ngain_dn_per_e = 0.2\ngain_e_per_dn = 5\n')
    with pytest.raises(GpusimError, match="gain_dn_per_e and gain_e_per_dn: wanted one"):
        gs.open_camera(path)
    with pytest.raises(BadData, match="wanted one"):
        gs.open_camera("phone").with_(gain_dn_per_e=0.2, gain_e_per_dn=5)
