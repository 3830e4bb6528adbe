"""The main job from a scene's name to files: the same on every device, and right against colour science."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest
import rawpy
from devices import ALL, ALL_KINDS, DEVICES
from PIL import Image
from scipy.interpolate import CubicSpline

import gpusim
from gpusim.cli.main import _parser, main
from gpusim.data.charts import chart, colorchecker_patches
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.noise import Noise
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator


def run(capsys, *argv):
    try:
        status = main([str(a) for a in argv])
    except SystemExit as stop:  # argparse ends the program itself
        status = stop.code
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize("camera", ["phone", "machine-vision", "figure8", "mono"])
def test_mean_electrons_agree_with_the_reference(camera):
    """Largest error over the peak below 2.4e-6 + 1e-6: the tolerances of blur and tables, the rest is smaller."""
    for name, size in (
        ("colorchecker", (65, 49)),
        ("points", (40, 33)),
        ("slanted-edge", (31, 64)),
    ):
        scene = chart(name, size=size)
        reference = Simulator(open_camera(camera), device="numpy").expose(scene)
        for device in DEVICES:
            simulator = Simulator(open_camera(camera), device=device)
            mean = simulator.device.numpy(simulator.expose(scene, reference.exposure_time).mean)
            assert np.abs(mean - reference.mean).max() <= 3.4e-6 * reference.mean.max()


def test_scene_forms_agree():
    """The same spectra as cube, basis and materials give the same electrons: three paths through the stages."""
    from gpusim.domain.content import Basis, Cube

    scene = chart("colorchecker", size=(48, 32))
    content = scene.content
    one_hot = (np.arange(len(content.spectra))[:, None, None] == content.ids) * content.shading
    cube = Cube(content.wavelengths, np.tensordot(content.spectra.T, one_hot, 1).astype(np.float32))
    basis = Basis(content.wavelengths, one_hot.astype(np.float32), content.spectra)
    # three left singular vectors more than enough for 8 entries: a low-rank basis takes the path of few entries
    u, s, v = np.linalg.svd(content.spectra, full_matrices=False)
    low = Basis(
        content.wavelengths,
        np.tensordot((u[:, :8] * s[:8]).T, one_hot, 1).astype(np.float32),
        v[:8],
    )
    low_cube = Cube(
        content.wavelengths, np.tensordot(v[:8].T, low.coefficients, 1).astype(np.float32)
    )
    for model in ("diffraction", "none"):
        camera = open_camera("phone")
        camera = replace(camera, optics=replace(camera.optics, model=model))
        for device in ALL:
            simulator = Simulator(camera, device=device)
            means = {
                name: np.array(
                    simulator.device.numpy(
                        simulator.expose(replace(scene, content=form), 0.01).mean
                    )
                )
                for name, form in (
                    ("materials", content),
                    ("cube", cube),
                    ("basis", basis),
                    ("low", low),
                    ("low cube", low_cube),
                )
            }
            # float32 storage of the cube rounds at 6e-8, the transforms err by 2.4e-6 of the peak
            peak = means["cube"].max()
            assert np.abs(means["materials"] - means["cube"]).max() < 3e-6 * peak
            assert np.abs(means["basis"] - means["cube"]).max() < 3e-6 * peak
            assert np.abs(means["low"] - means["low cube"]).max() < 3e-6 * peak


@pytest.mark.parametrize("camera", ["phone", "machine-vision", "mono"])
def test_raw_is_identical_on_all_devices_given_the_same_means(camera):
    scene = chart("colorchecker", size=(61, 43))
    means = Simulator(open_camera(camera), device="numpy").expose(scene)
    mean = np.asarray(means.mean, np.float32)
    raws = {
        device: Simulator(open_camera(camera), device=device).readout.draw_electrons(
            mean, means.exposure_time, seed=3, first=2
        )
        for device in ALL
    }
    assert raws["numpy"].dtype == np.uint16 and len(np.unique(raws["numpy"])) > 10
    for raw in raws.values():
        np.testing.assert_array_equal(raw, raws["numpy"])


def patches_of(frame, size):
    """Mean linear display RGB of the middle of every ColorChecker patch."""
    for rows, cols in colorchecker_patches(size):
        middle = tuple(
            slice((3 * side.start + side.stop) // 4, (side.start + 3 * side.stop) // 4)
            for side in (rows, cols)
        )
        yield middle, frame.linear[middle].mean(axis=(0, 1))


def clean(camera, **optics):
    """The camera without noise."""
    sensor = replace(camera.sensor, noise=Noise(photon="none"))
    return replace(camera, sensor=sensor, optics=replace(camera.optics, **optics))


@pytest.mark.parametrize("light", ["D65", "A", "FL11"])
def test_patches_come_through_the_chain_as_the_matrix_says(light):
    """Rendered patches equal the matrix times the electrons that the integrals predict, to the converter's rounding.

    Without blur and fall-off a patch is flat: one DN of rounding is half of 1 / 959 in each channel, times the row sums
    of the matrix.
    """
    size = (
        192,
        128,
    )  # the middle half of a patch is farther from its edge than demosaicking reaches
    scene = chart("colorchecker", size=size, light=light)
    camera = clean(open_camera("phone"), model="none", relative_illumination="none")
    simulator = Simulator(camera, device="opencl")
    frame = simulator(scene)
    exposure = simulator.expose(scene)
    nodes, qe = scene.wavelengths, camera.sensor.qe
    fine = np.arange(400, 700.001, 0.01)
    power = scene.illuminant.at(fine) * qe.at(fine)
    gain = camera.sensor.gain_dn_per_electron / (
        camera.sensor.white_level - camera.sensor.black_level
    )
    factor = (
        camera.optics.irradiance_factor
        * camera.sensor.pixel_pitch**2
        * exposure.exposure_time
        * gain
    )
    matrix = frame.rendering.display_from_camera
    for middle, shown in patches_of(frame, size):
        reflectance = CubicSpline(
            nodes, scene.content.spectra[scene.content.ids[tuple(middle)][0, 0]]
        )(fine)
        values = factor * np.trapezoid(power * reflectance, fine, axis=1)
        assert (
            np.abs(shown - matrix @ values).max()
            <= 0.5 / 959 * np.abs(matrix).sum(axis=1).max() * 1.01
        )


@pytest.mark.parametrize(("light", "most"), [("D65", 2.2), ("A", 3.8)])
def test_colorchecker_colours(light, most):
    """CIEDE2000 of the rendered patches against colour-science's XYZ of the same reflectances in D65.

    What remains is the sensor's: a 3x3 matrix cannot make it colorimetric. 2.1 (D65) and 3.6 (A) were measured; the
    bound leaves a tenth for another rounding of noise-free values, far below the 10 and more of a wrong white, gamma
    or order of channels. That the chain adds nothing is tested above.
    """
    size = (192, 128)
    scene = chart("colorchecker", size=size, light=light)
    camera = clean(open_camera("phone"))
    camera = replace(camera, processor=replace(camera.processor, scaling="normalised"))
    frame = Simulator(camera, device="opencl")(scene)
    shape = colour.SpectralShape(400, 700, 10)
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    truth, shown = [], []
    for middle, rgb in patches_of(frame, size):
        spectrum = scene.content.spectra[scene.content.ids[tuple(middle)][0, 0]]
        reflectance = colour.SpectralDistribution(spectrum, scene.wavelengths)
        truth.append(colour.sd_to_XYZ(reflectance, cmfs, d65, method="Integration") / 100)
        shown.append(to_xyz @ rgb)
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    errors = colour.delta_E(
        colour.XYZ_to_Lab(np.array(shown), white),
        colour.XYZ_to_Lab(np.array(truth), white),
        method="CIE 2000",
    )
    print(
        f"ColorChecker in {light}: mean CIEDE2000 {errors.mean():.2f}, maximum {errors.max():.2f}"
    )
    assert errors.mean() < most


def test_frames_differ_in_noise_alone_and_can_be_drawn_in_any_order():
    simulator = Simulator(open_camera("phone"), device="opencl")
    scene = chart("flat", size=(33, 21))
    three = list(simulator.frames(scene, 3, seed=5))
    again = simulator(scene, seed=5, first=2)
    np.testing.assert_array_equal(three[2].raw, again.raw)
    assert (three[0].raw != three[1].raw).mean() > 0.5
    np.testing.assert_array_equal(three[0].mean, three[1].mean)


def test_automatic_exposure_reaches_95_percent_of_the_well():
    camera = open_camera("phone")
    frame = Simulator(camera, device="opencl")(chart("ramp", size=(64, 16)))
    dark = camera.sensor.noise.dark_current * frame.exposure_time
    # float32 means and rates of a float64 exposure time: half an ulp each
    assert abs((frame.mean.max() + dark) / (0.95 * camera.sensor.full_well) - 1) < 1e-6


def test_surroundings_take_part_in_the_blur_but_not_in_the_frame():
    """A wider scene with border "scene" gives the same centre as the whole of it, far from the edges of both."""
    whole = chart("deadleaves", size=(240, 200))
    inner = replace(whole, border="scene", margin=60)
    simulator = Simulator(open_camera("phone"), device="numpy")
    simulator_camera = replace(
        open_camera("phone"),
        optics=replace(open_camera("phone").optics, relative_illumination="none"),
    )
    simulator = Simulator(simulator_camera, device="opencl")
    full, cut = (
        np.array(simulator.device.numpy(simulator.expose(s, 0.01).mean)) for s in (whole, inner)
    )
    # only the surroundings of the surroundings differ, beyond 60 pixels: less than the 0.3 % of the energy out there
    np.testing.assert_allclose(cut, full[60:-60, 60:-60], rtol=3e-3)
    assert cut.shape == (80, 120)


def test_simulate_writes_every_format(tmp_path, capsys):
    outs = [tmp_path / f"a{suffix}" for suffix in (".png", ".dng", ".npz", ".exr")]
    report = tmp_path / "a.json"
    status, out, _ = run(
        capsys,
        "simulate",
        "colorchecker",
        "--camera",
        "phone",
        "--size",
        "97x65",
        "--device",
        "opencl",
        *(a for o in outs for a in ("-o", o)),
        "--report",
        report,
        "--verify",
        "--tolerance",
        "video",
    )
    assert status == 0 and out.startswith("tolerance met: true error ")
    stored = np.load(outs[2])
    with rawpy.imread(str(outs[1])) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, stored["dn"])
        pattern = "".join("RGBG"[raw.raw_pattern[i, j]] for i in range(2) for j in range(2))
        assert pattern == "RGGB"
    assert stored["electrons"].shape == (65, 97) and stored["electrons"].dtype == np.float32
    facts = json.loads(report.read_text())
    stages = {stage["stage"] for stage in facts["stages"]}
    assert stages >= {"sensor.noise", "display.encode"} and stages & {
        "optics.mosaic",
        "optics.tiles",
    }
    assert all(stage["ms"] > 0 for stage in facts["stages"])
    assert (
        facts["error"]["p999_sigma"] <= 0.1 and facts["meets_tolerance"] is True
    )  # the preset "video"
    assert 0.4 <= facts["prediction_ratio"] <= 2.5
    assert Image.open(outs[0]).size == (97, 65)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_photograph_on_every_device(shared_data, tmp_path, capsys, device):
    photo = tmp_path / "photo.png"
    Image.open(shared_data / "kodak" / "kodim23.png").crop((200, 100, 360, 220)).save(photo)
    status, _, _ = run(
        capsys,
        "simulate",
        photo,
        "--camera",
        "phone",
        "--device",
        device,
        "-o",
        tmp_path / "a.png",
        "-o",
        tmp_path / "a.dng",
        "-o",
        tmp_path / "a.npz",
        "--report",
        tmp_path / "a.json",
    )
    assert status == 0
    shown = np.asarray(Image.open(tmp_path / "a.png"), float)
    # a picture of the photograph: noise and blur differ, the content does not (another picture correlates below 0.5)
    original = np.asarray(Image.open(photo), float)
    assert np.corrcoef(shown.ravel(), original.ravel())[0, 1] > 0.97


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1/60", 1 / 60),
        ("0.01", 0.01),
        ("10ms", 0.01),
        ("500us", 5e-4),
        ("2 s", 2.0),
        ("1e-3", 1e-3),
        (".5", 0.5),
        ("1/2.5", 0.4),
    ],
)
def test_exposure_times_as_they_are_written(text, seconds):
    arguments = _parser().parse_args(["simulate", "flat", "--camera", "phone", "--exposure", text])
    assert arguments.exposure == pytest.approx(seconds, rel=1e-15)


def test_exposure_speed_lens_and_scaling_from_the_command_line(tmp_path, capsys):
    """The same electrons, numbers and codes as of a camera with these properties; the report has them."""
    scene = ("colorchecker", "--camera", "phone", "--size", "60x40", "--device", "opencl")
    options = (
        "--exposure",
        "1/40",
        "--iso",
        "200",
        "--f-number",
        "2.8",
        "--focus",
        "0.05",
        "--scaling",
        "normalised",
    )
    report = tmp_path / "a.json"
    status, out, _ = run(
        capsys,
        "simulate",
        *scene,
        *options,
        "-o",
        tmp_path / "a.npz",
        "-o",
        tmp_path / "a.png",
        "--report",
        report,
    )
    assert status == 0 and "exposure 25 ms, ISO 200, frame 0" in out
    facts = json.loads(report.read_text())["camera"]
    assert (facts["f_number"], facts["exposure_time_s"]) == (2.8, 0.025)
    assert facts["iso"] == pytest.approx(200, rel=1e-12)
    camera = open_camera("phone")
    camera = replace(
        camera,
        optics=replace(camera.optics, f_number=2.8, object_distance=0.05),
        sensor=replace(camera.sensor, exposure_time=0.025, analog_gain=facts["analog_gain"]),
        processor=replace(camera.processor, scaling="normalised"),
    )
    frame = Simulator(camera, device="opencl")(chart("colorchecker", size=(60, 40)))
    stored = np.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(stored["electrons"], frame.mean)
    np.testing.assert_array_equal(stored["dn"], frame.raw)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), frame.rgb)


def test_a_camera_with_a_time_is_metered_by_exposure_auto(tmp_path, capsys):
    """A camera file's time gives way; with --iso automatic exposure takes more time, not more gain."""
    text = (Path(gpusim.__file__).parent / "data" / "cameras" / "phone.toml").read_text()
    path = tmp_path / "fixed.toml"
    path.write_text(
        text.replace(
            "bits = 10",
            "bits = 10\nexposure_time_ms = 1\nauto_exposure = {longest_ms = 5, most_gain = 64}",
        )
    )
    found = []
    for options in (
        (),
        ("--exposure", "auto"),
        ("--exposure", "auto", "--iso", 104),
        ("--focus", "inf"),
    ):
        assert (
            run(
                capsys,
                "simulate",
                "flat",
                "--camera",
                path,
                "--size",
                "16x8",
                "--device",
                "opencl",
                *options,
                "--report",
                tmp_path / "r.json",
            )[0]
            == 0
        )
        facts = json.loads((tmp_path / "r.json").read_text())["camera"]
        found.append((facts["exposure_time_s"], facts["analog_gain"] > 3, facts["iso"]))
    base = found[0][2]
    assert found[0] == found[3] == (0.001, False, pytest.approx(base))
    assert found[1][:2] == (0.005, True) and found[1][2] > 3 * base
    assert found[2] == (0.005, False, pytest.approx(104, rel=1e-12))


def test_numbered_frames(tmp_path, capsys):
    report = tmp_path / "r.json"
    status, _, _ = run(
        capsys,
        "simulate",
        "flat",
        "--camera",
        "mono",
        "--size",
        "16x8",
        "--frames",
        3,
        "-o",
        tmp_path / "f.npz",
        "--report",
        report,
        "--device",
        "opencl",
    )
    assert status == 0
    assert sorted(path.name for path in tmp_path.glob("f*")) == [
        "f_0000.npz",
        "f_0001.npz",
        "f_0002.npz",
    ]
    assert [facts["frame"] for facts in json.loads(report.read_text())] == [0, 1, 2]


BAD = [
    (["nosuchchart"], "unknown scene 'nosuchchart'"),
    (["colorchekcer"], "did you mean 'colorchecker'"),
    (["missing.exr"], "missing.exr"),
    (["flat", "--camera", "fone"], "did you mean 'phone'"),
    (["flat", "--device", "opencl:99"], "no OpenCL device '99'"),
    (["flat", "--device", "metal"], "unknown device 'metal'"),
    (["flat", "--light", "D66"], "unknown light 'D66'"),
    (["flat", "--luminance", "-3"], "luminance"),
    (["flat", "--tolerance", "sloppy"], "tolerance"),
    (["flat", "--tolerance", "1e-9"], "rms >= 1e-6"),
    (["flat", "-o", "a.bmp"], "unknown output format '.bmp'"),
    (["flat", "-o", "rccc.toml/a.png"], "cannot be written"),
    (["flat", "--size", "40000x40000"], "40000"),
    (["flat", "--size", "0x10"], "0"),
    (["flat", "--band", "red"], "--band"),
    (["flat", "--frames", "0"], "--frames: '0': wanted a whole number"),
    *(
        (
            ["flat", "--exposure", text],
            f"--exposure: '{text}': wanted seconds such as 1/60 or 0.01, 10ms, 500us, above 0",
        )
        for text in ("0", "-1", "1/0", "5min", "nan", "1e13", "1/60/2", "")
    ),
    (["flat", "--iso", "fast"], "--iso: 'fast': wanted a number above 0"),
    (["flat", "--iso", "25"], "iso = 25: allowed is 51.95, this sensor's base speed, or more"),
    (
        ["flat", "--iso", "1e9"],
        "iso = 1e+09: allowed is 51.95, this sensor's base speed, or more, up to",
    ),
    (["flat", "--f-number", "0"], "--f-number: '0': wanted 0.1 .. 1000"),
    (["flat", "--f-number", "0.05"], "optics.f_number = 0.05: allowed is 0.1 <= f_number <= 1000"),
    (["flat", "--focus", "-1"], "--focus: '-1': wanted metres above 0, or inf"),
    (["flat", "--focus", "nan"], "--focus: 'nan': wanted metres above 0, or inf"),
    (
        ["flat", "--focus", "0.004"],
        "optics.object_distance = 0.004 m: allowed is object_distance > focal_length",
    ),
    (["flat", "--scaling", "auto"], "--scaling: invalid choice: 'auto'"),
    (
        ["flat", "--camera", "scaled.toml"],
        "unknown processor.scaling 'automatic'; known: exposure, normalised",
    ),
    (
        ["flat", "--camera", "psf.toml", "--focus", "2"],
        "--f-number, --focus: the camera's point spreads are measured",
    ),
    (["flat", "--colour"], "unrecognized arguments: --colour"),
    (["flat", "--luminance", "1e300"], "luminance"),
    (["flat", "-o", "."], "unknown output format"),
    (["flat", "--report", "rccc.toml/r.json"], "cannot be written"),
    (
        ["flat", "--camera", "rccc.toml", "-o", "a.npz", "-o", "a.DNG"],
        "channels of a DNG = 2 (R, W): allowed is 1, 3",
    ),
    (["flat", "-o", "a.png", "--bits", "32"], "bits of a .png output = 32: allowed is 8 or 16"),
    (["flat", "-o", "a.png", "--bits", "12"], "--bits: invalid choice: 12"),
    (
        ["flat", "--camera", "blue.toml"],
        "sensor.qe of blue = 400 .. 600 nm: allowed is as far as the light",
    ),
    (
        ["flat", "--camera", "well.toml"],
        "sensor.full_well = 600 e- = 60 DN above black: allowed is at least the black",
    ),
    (
        ["flat", "--camera", "bits0.toml"],
        "sensor.bits = 0: allowed is a whole number, 1 <= bits <= 16, or 32",
    ),
    (
        ["flat", "--camera", "bits17.toml"],
        "sensor.bits = 17: allowed is a whole number, 1 <= bits <= 16, or 32",
    ),
    (
        ["flat", "--camera", "bits33.toml"],
        "sensor.bits = 33: allowed is a whole number, 1 <= bits <= 16, or 32",
    ),
    (["flat", "--camera", "qe.toml"], "sensor.qe = -0.1 .. 1.2 e-/photon: allowed is 0 <= qe <= 1"),
    (["flat", "--camera", "letter.toml"], "[sensor] qe has no curve for X; it has R, G, B, W"),
    (
        ["flat", "--camera", "exposure0.toml"],
        "sensor.exposure_time = 0 s: allowed is 0 < exposure_time",
    ),
    (
        ["flat", "--camera", "exposure-5.toml"],
        "sensor.exposure_time = -0.005 s: allowed is 0 < exposure_time",
    ),
    (
        ["flat", "--size", "64x49", "--camera", "binned.toml"],
        "frame size = 64x49: allowed is rows in multiples of 2",
    ),
    (
        ["flat", "--camera", "counting.toml"],
        "unknown noise.photon 'counting'; known: exact, fast, none",
    ),
    (
        ["flat", "--camera", "dead.toml"],
        "noise.dead_pixels = 1.01: allowed is 0 <= dead_pixels <= 1",
    ),
    (
        ["flat", "--camera", "misspelt.toml"],
        "unknown key 'raed_e' in [noise]; did you mean 'read_e'?",
    ),
    (
        ["flat", "--camera", "moved.toml"],
        "unknown key 'read_noise_e' in [sensor]; did you mean 'read_e' in [noise]?",
    ),
    (
        ["flat", "--camera", "ktc.toml"],
        'reset_e = "kTC" needs [sensor] conversion_gain_uv_per_e and adc_range_v',
    ),
    (
        ["flat", "--camera", "large.toml", "--size", "7x9"],
        "at least 8x8, one block of binning 4x4 in this mosaic",
    ),
    (["light0.npz"], "allowed are 10 .."),
    (["negative.npz"], "radiance cannot be negative"),
    (["margin.npz"], "scene.margin = -5"),
    (["huge.npz"], "more than float32 holds"),
    (["elsewhere.npz"], "sees none of its light"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD)
def test_bad_input_is_one_line_and_status_2(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_bad_files()
    there = set(tmp_path.iterdir())
    camera = [] if "--camera" in arguments else ["--camera", "phone"]
    device = [] if "--device" in arguments else ["--device", "opencl"]
    status, out, err = run(capsys, "simulate", *arguments, *camera, *device)
    assert (status, out) == (2, "")
    assert words in err and err.count("\n") == 1 and "Traceback" not in err
    assert set(tmp_path.iterdir()) == there  # nothing half-written


def make_bad_files():
    """Files that are well-formed and wrong, in the current folder."""

    def camera(
        name,
        sensor="",
        noise="",
        n=2,
        pitch=1.4,
        bits=10,
        qe="'mt9v024'",
        color="white-preserving",
        optics="",
        processor="",
    ):
        Path(f"{name}.toml").write_text(
            f"base = 'none'\n[optics]\nf_number = {n}\nfocal_length_mm = 4\n{optics}\n"
            f"[sensor]\npixel_pitch_um = {pitch}\n"
            f"full_well_e = 600\nbits = {bits}\nqe = {qe}\n{sensor}\n[noise]\n{noise}\n[processor]\ncolor = '{color}'\n"
            f"{processor}\n"
        )

    camera(
        "rccc",
        "cfa = 'rccc'",
        qe="{wavelengths_nm = [400, 700], R = [0.1, 0.5], W = [0.6, 0.7]}",
        color="none",
    )
    camera("scaled", processor="scaling = 'automatic'")
    camera("psf", optics="psf = 'lens.npz'")
    np.savez("lens.npz", wavelengths_nm=[400.0, 700.0], psf=np.ones((2, 5, 5)), spacing_um=0.7)
    for name, high, values in (("blue", 600, "0.5, 0.5"), ("qe", 700, "-0.1, 1.2")):
        camera(
            name,
            qe=f"{{wavelengths_nm = [400, {high}], R = [0, 0.3], G = [{values}], B = [0.3, 0]}}",
        )
    camera("well", "black_level_dn = 64\ngain_dn_per_e = 0.1")
    for bits in (0, 17, 33):
        camera(f"bits{bits}", bits=bits)
    camera("letter", "cfa = ['RG', 'XB']")
    for time in (0, -5):
        camera(f"exposure{time}", f"exposure_time_ms = {time}")
    camera("binned", "stacked = true\nbinning = [2, 2]")
    camera("large", "binning = [4, 4]")
    camera("moved", "read_noise_e = 3")
    camera("counting", noise="photon = 'counting'")
    camera("dead", noise="dead_pixels = 1.01")
    camera("misspelt", noise="raed_e = 3")
    camera("ktc", noise="reset_e = 'kTC'")
    nodes, cube = np.array([400.0, 500.0, 600.0, 700.0]), np.ones((4, 6, 8), np.float32)
    np.savez("light0.npz", cube=cube, wavelengths_nm=[0.0, 500, 600, 700])
    np.savez("negative.npz", coefficients=-cube[:2], basis=np.ones((2, 4)), wavelengths_nm=nodes)
    np.savez("margin.npz", cube=cube, wavelengths_nm=nodes, margin=-5)
    np.savez("huge.npz", cube=np.full((4, 6, 8), 1e300), wavelengths_nm=nodes)
    np.savez("elsewhere.npz", cube=cube, wavelengths_nm=nodes + 1000)


def test_existing_output_survives_a_failure(tmp_path, capsys, monkeypatch):
    """The writer breaks off in the middle of the file."""

    def broken(self, data):
        with self.open("wb") as file:
            file.write(data[:10])
        raise OSError("disk full")

    target = tmp_path / "a.png"
    target.write_bytes(b"precious")
    monkeypatch.setattr(Path, "write_bytes", broken)
    status, _, err = run(
        capsys,
        "simulate",
        "flat",
        "--camera",
        "phone",
        "--size",
        "8x8",
        "--device",
        "numpy",
        "-o",
        target,
    )
    assert status == 2 and "disk full" in err
    assert target.read_bytes() == b"precious" and list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(("chart_name", "border"), [("points", "zero"), ("deadleaves", "edge")])
def test_true_error_includes_the_border(chart_name, border):
    """The error that `verify` reports is that against surroundings ten times the frame, not against the same plan."""
    scene = chart(chart_name, size=(48, 40))
    assert scene.border == border
    camera = open_camera("machine-vision")
    camera = replace(camera, optics=replace(camera.optics, f_number=16.0))
    frame = Simulator(camera, device="opencl", reach=8)(scene, verify=True)
    far = Simulator(camera, device="numpy", reach=500).expose(
        scene, frame.report.camera["exposure_time_s"]
    )
    true = np.sqrt(np.mean((frame.mean - far.mean) ** 2)) / np.sqrt(np.mean(far.mean**2))
    # what is beyond 500 pixels is a small part of the error
    assert true / 2 < frame.report.error.rms < 2 * true
    assert (
        border == "zero" or true > 1e-5
    )  # far above float32's rounding: it is the border that is seen


def test_verify_fails_for_a_device_that_cannot_be_opened(capsys, monkeypatch):
    from gpusim.backends import probe

    broken = probe.EMPTY | {"name": "opencl:7", "error": "its driver ended the process"}
    monkeypatch.setattr("gpusim.judge.verify.devices", lambda refresh=False: [broken])
    status, out, _ = run(capsys, "verify", "--stage", "processor.linear")
    assert status == 1 and "opencl:7" in out and "its driver ended the process" in out
    monkeypatch.setattr("gpusim.judge.verify.devices", lambda refresh=False: [])
    assert run(capsys, "verify", "--stage", "processor.linear")[0] == 1


@pytest.mark.parametrize("size", ["0x5", "9999999x9999999"])
def test_bench_refuses_sizes_before_allocating(size, capsys):
    status, _, err = run(
        capsys, "bench", "--device", "opencl", "--stage", "processor.linear", "--size", size
    )
    assert status == 2 and err.count("\n") == 1


def test_devices_command(capsys):
    status, out, _ = run(capsys, "devices", "--json")
    entries = json.loads(out)
    assert status == 0 and {"numpy", "warp:cpu"} <= {entry["name"] for entry in entries}
    assert all(entry["copy_gbps"] > 0 for entry in entries if not entry["error"])


def test_a_driver_that_aborts_is_reported_not_fatal(monkeypatch):
    from gpusim.backends import probe

    def aborting(argument):
        return subprocess.run(
            [sys.executable, "-c", "import os; os.abort()"], capture_output=True, text=True
        )

    monkeypatch.setattr(probe, "_run", aborting)
    assert "ended the process" in probe._try("opencl:0")["error"]


def test_version():
    assert gpusim.__version__ == __import__("importlib.metadata", fromlist=["version"]).version(
        "gpusim"
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("noise", [{}, {"row": 1.0, "prnu": 0.01}])
def test_draws_follow_each_other_each_in_an_array_of_its_own(device, noise):
    """Those after the first start the kernels of the first again: bit for bit what one draw gives."""
    camera = open_camera("phone")
    camera = replace(
        camera, sensor=replace(camera.sensor, noise=replace(camera.sensor.noise, **noise))
    )
    simulator, scene = Simulator(camera, device=device), chart("ramp", size=(70, 40))
    exposures = [simulator.expose(scene, 0.01), simulator.expose(scene, 0.02, 2.0)]
    asked = [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 2**63, 2), (0, 1, 1), (0, 7, 2**32 - 1)]
    drawn = [exposures[k].raw(seed=seed, first=frame) for k, seed, frame in asked]
    for raw, (k, seed, frame) in zip(drawn, asked, strict=True):
        other = replace(exposures[k], simulator=Simulator(camera, device=simulator.device))
        fresh = other.raw(seed=seed, first=frame)
        np.testing.assert_array_equal(simulator.device.numpy(raw), simulator.device.numpy(fresh))
    with pytest.raises(OutOfRange, match="frame"):
        exposures[0].raw(first=-1)
    np.testing.assert_array_equal(
        simulator.device.numpy(exposures[0].raw(seed=7, first=2**32 - 1)),
        simulator.device.numpy(drawn[-1]),
    )


def test_several_scenes_give_a_frame_each():
    """Of a list and of a generator, one by one: those of each scene and number by themselves."""
    simulate = Simulator(open_camera("phone"), device="opencl", tolerance="video")
    scenes = [
        chart("colorchecker", size=(48, 32)),
        chart("ramp", size=(60, 40)),
        chart("flat", size=(24, 16)),
    ]
    alone = [simulate(scene, seed=3, first=number) for number, scene in enumerate(scenes, 7)]
    for given in (scenes, tuple(scenes), iter(scenes)):
        for found, own in zip(simulate(given, seed=3, first=7), alone, strict=True):
            assert found.report.frame == own.report.frame
            np.testing.assert_array_equal(found.raw, own.raw)
            np.testing.assert_array_equal(found.rgb, own.rgb)
    asked = []
    frames = simulate(asked.append(number) or scenes[number] for number in range(3))
    assert (
        asked == [] and next(frames).raw.shape == (32, 48) and asked == [0]
    )  # made when asked for
    for wrong in ("colorchecker", 3, None):
        with pytest.raises(BadData, match="wanted a Scene, for example from open_scene or chart"):
            simulate(wrong)
    with pytest.raises(BadData, match="scene: str, wanted a Scene"):
        list(simulate(["colorchecker"]))
