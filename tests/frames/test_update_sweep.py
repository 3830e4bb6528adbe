"""Every key of camera files: a loop that is updated gives what a new one gives, bit for bit, there and back."""

import tomllib

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.camera_keys import SECTIONS

OUTPUTS = (
    "mean",
    "chip_mean",
    "raw",
    "camera",
    "linear",
    "xyz",
    "codes",
    "electrons",
    "irradiance",
)
BASE = """
base = "phone"
[sensor]
exposure_time_ms = 8
[noise]
prnu = 0.01
dsnu_e = 1.0
hot_pixels = 0.001
hot_current_e_per_s = 500
dead_pixels = 0.001
telegraph_pixels = 0.01
telegraph_e = 5
temperature_c = 30
[processor]
denoise = 0.5
shading = true
defects = "known"
"""
SENSITIVITY = (
    "{wavelengths_nm = [400, 550, 700], R = [0, 0.5, 0.7], G = [0.1, 1, 0], B = [0.8, 0.2, 0]}"
)
VALUES = {  # of every key, and of others that it needs, also in another section
    "optics": {
        "f_number": "2.4",
        "focal_length_mm": "5.0",
        "model": '"none"',
        "transmission": "0.7",
        "relative_illumination": '"none"',
        "object_distance_m": "0.5",
        "defocus_um": "4.0",
        "defocus_diopters": "0.5",
        "pupil": "{blades = 6, obscuration = 0.2, rotation_deg = 10}",
        "mask": "[[1, 0.5], [0, 1]]",
        "zernike_waves": "[0, 0, 0, 0.05]",
        "zernike_heights": "[0.0, 1.0]\nzernike_waves = [[0, 0, 0, 0.05], [0, 0, 0, 0.1]]",
        "seidel_waves": "[0.1, 0, 0, 0, 0]",
        "reference_nm": "600.0\nzernike_waves = [0, 0, 0, 0.05]",
        "birefringence_um": "[0.5, 0.5]",
        "diffuser_um": "0.5",
        "psf": '"lens.npz"\nmodel = "measured"',
        "distortion": "{k1 = 0.0, k2 = -0.02, radius_mm = 0.06}",
        "lateral_color": "1e-3",
        "calibration": "{width = 48, height = 32, fx = 60.0, fy = 60.0, cx = 24.5, cy = 15.0, k1 = -0.02}",
    },
    "sensor": {
        "pixel_pitch_um": "1.6",
        "fill_factor": "0.8",
        "photodetector_size": "[0.9, 0.8]",
        "photodetector_centre": "[0.05, -0.05]\nphotodetector_size = [0.8, 0.8]",
        "offset": "[1.0, 0.0]",
        "microlens": "{angles_deg = [0, 15, 30, 60], response = [1, 0.97, 0.85, 0.5], shift = 0.8}",
        "lenslets": "{pitch_um = 14, focal_length_um = 40}",
        "dual": '{split = "up-down"}',
        "vignetting": "[[0.9, 0.95], [1.0, 0.8]]",
        "qe": '"iset-rgb"',
        "photodetector": '"cmos-photodetector"',
        "ir_cut": '"ir-cut-schott"',
        "qe_ends": '"zero"',
        "sensitivity": SENSITIVITY,
        "sensitivity_peak": f"0.4\nsensitivity = {SENSITIVITY}",
        "stacked": "true",
        "cfa": '["BG", "GR"]',
        "exposure_time_ms": "16.0",
        "auto_exposure": '{method = "mean"}\nexposure_time_ms = "auto"',
        "row_time_us": "10.0",
        "binning": "[2, 2]",
        "binning_mode": '"digital"\nbinning = [2, 2]',
        "full_well_e": "3000",
        "bits": "12",
        "black_level_dn": "100",
        "gain_dn_per_e": "0.1",
        "gain_e_per_dn": "10.0",
        "analog_gain": "2.0",
        "analog_offset_e": "20.0",
        "noise_profile": '"shot.dng"',
        "conversion_gain_uv_per_e": "60\nadc_range_v = 0.4",
        "adc_range_v": "0.5\nconversion_gain_uv_per_e = 60",
    },
    "noise": {
        "photon": '"exact"',
        "dark_current_e_per_s": "500.0",
        "temperature_c": "45.0",
        "reference_temperature_c": "10.0",
        "doubling_k": "4.0",
        "read_e": "9.0",
        "row_e": "3.0",
        "column_e": "3.0",
        "dsnu_e": "4.0",
        "row_dsnu_e": "4.0",
        "column_dsnu_e": "4.0",
        "telegraph_e": "20.0",
        "reset_e": "4.0",
        "adc_dn": "2.0",
        "prnu": "0.05",
        "row_prnu": "0.05",
        "column_prnu": "0.05",
        "hot_pixels": "0.01",
        "dead_pixels": "0.02",
        "telegraph_pixels": "0.1",
        "telegraph_switching": "0.3",
        "hot_current_e_per_s": "9000.0",
        "seed": "5",
    },
    "processor": {
        "defects": '"none"',
        "demosaic": '"malvar"',
        "table": '"bayer.npz"\ndemosaic = "learned"',
        "network": '"network.npz"\ndemosaic = "network"',
        "white_balance": '"gray-world"',
        "white": '[1.5, 1.0, 2.0]\nwhite_balance = "preset"',
        "color": '"none"',
        "training": '"munsell"',
        "target": '"A"',
        "scaling": '"normalised"',
        "shading": "false",
        "denoise": "1.0",
        "denoise_by": '"mosaic"',
        "tone": "[[0, 0], [0.5, 0.7], [1, 1]]",
        "sharpen": "0.7",
        "look": '"phone"',
        "highlights": '"rebuild"\n[sensor]\nexposure_time_ms = 80',
        "lens_corrections": "true\n[optics]\ndistortion = {k1 = 0.0, k2 = -0.02, radius_mm = 0.06}",
        "local_tone": "0.5",
        "gamut": '"map"',
    },
    "display": {
        "name": '"lcd-apple"',
        "primaries": "[[0.68, 0.32], [0.265, 0.69], [0.15, 0.06]]",
        "white": "[0.3457, 0.3585]",
        "curve": "2.2",
        "luminance_cd_per_m2": "200.0",
    },
}
ALONE = {
    "noise_profile": """
[sensor]
pixel_pitch_um = 1.4
cfa = ["RG", "GB"]
qe = "mt9v024"
qe_ends = "zero"
exposure_time_ms = 8
noise_profile = "shot.dng"
[optics]
f_number = 1.8
focal_length_mm = 4.44
"""
}  # keys that stand for so many others that they have files of their own
# Nothing of one frame of a still scene shows these; the base says qe_ends, so that its value is the same
# and lenslets need a light field
SILENT = {
    "name",
    "dual",
    "luminance_cd_per_m2",
    "row_time_us",
    "telegraph_switching",
    "qe_ends",
    "lenslets",
}
PAIRS = [(section, key) for section, keys in SECTIONS.items() for key in keys]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that keys name."""
    from importlib.resources import files

    made = tmp_path_factory.mktemp("cameras")
    at = (np.arange(41) - 20) * 0.4
    spread = np.exp(-0.5 * (at[:, None] / 1.2) ** 2 - 0.5 * (at / 1.6) ** 2)
    np.savez(
        made / "lens.npz", wavelengths_nm=[380.0, 780.0], psf=np.stack([spread] * 2), spacing_um=0.4
    )
    for name in ("bayer.npz", "network.npz"):
        (made / name).write_bytes((files("gpusim.data") / "learned" / name).read_bytes())
    gs.Simulator(gs.open_camera("machine-vision"), device="numpy")(
        gs.chart("flat", size=(32, 32)), seed=1
    ).save(made / "shot.dng")
    return made


def camera_of(folder, section=None, key=None):
    """The base, and a key's own value in place of what it says."""
    tables = tomllib.loads(BASE)
    if section:
        changed = tomllib.loads(f"[{section}]\n{key} = {VALUES[section][key]}")
        for name, fields in changed.items():
            tables.setdefault(name, {}).update(fields)
    path = folder / f"{section}-{key}.toml"
    lines = ['base = "phone"']
    for name, values in tables.items():
        if name != "base":
            lines += [f"[{name}]", *(f"{one} = {_toml(value)}" for one, value in values.items())]
    path.write_text(ALONE.get(key, "\n".join(lines) + "\n"))
    return gs.open_camera(path)


def _toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return (
        {True: "true", False: "false"}.get(value, f'"{value}"')
        if isinstance(value, bool | str)
        else repr(value)
    )


def outputs_of(loop):
    """Every output as an array, or the words in which it is refused."""
    found = {}
    for name in OUTPUTS:
        try:
            found[name] = np.array(loop.simulator.device.numpy(loop.output(name, seed=1)))
        except gs.GpusimError as refusal:
            found[name] = str(refusal)
    return found


@pytest.fixture(scope="module")
def seen():
    """Outputs of new loops, by camera."""
    return {}


def test_every_key_has_a_value():
    assert {section: set(values) for section, values in VALUES.items()} == {
        section: set(keys) for section, keys in SECTIONS.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(("section", "key"), PAIRS, ids=lambda one: one)
def test_an_updated_loop_gives_what_a_new_one_gives(folder, section, key):
    scene = gs.chart("deadleaves", size=(48, 32), seed=3)
    first, second = camera_of(folder), camera_of(folder, section, key)
    for start, end in ((first, second), (second, first)):
        loop = gs.Simulator(start, device="opencl").loop(scene)
        before = outputs_of(loop)
        after = outputs_of(loop.update(camera=end))
        fresh = outputs_of(gs.Simulator(end, device="opencl").loop(scene))
        for name in OUTPUTS:
            np.testing.assert_array_equal(
                after[name], fresh[name], err_msg=f"{section}.{key}: {name}"
            )
    assert key in SILENT or any(
        not np.array_equal(before[name], fresh[name]) for name in OUTPUTS
    ), "nothing changed"
