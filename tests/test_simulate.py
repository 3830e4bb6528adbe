"""The main job from a scene's name to files: the same on every device, and right against colour science."""

import json
import subprocess
import sys

import numpy as np
import pytest
from devices import ALL, DEVICES

import gpusim
from gpusim.cli import main
from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart, colorchecker_patches
from gpusim.scheduler import Simulator


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
    for name, size in (("colorchecker", (65, 49)), ("points", (40, 33)), ("slanted-edge", (31, 64))):
        scene = chart(name, size=size)
        reference = Simulator(open_camera(camera), device="numpy").expose(scene)
        for device in DEVICES:
            simulator = Simulator(open_camera(camera), device=device)
            mean = simulator.device.numpy(simulator.expose(scene, reference.exposure_time).mean)
            assert np.abs(mean - reference.mean).max() <= 3.4e-6 * reference.mean.max()


def test_scene_forms_agree():
    """The same spectra as cube, basis and materials give the same electrons: three paths through the stages."""
    from dataclasses import replace

    from gpusim.domain.scene import Basis, Cube

    scene = chart("colorchecker", size=(48, 32))
    content = scene.content
    one_hot = (np.arange(len(content.spectra))[:, None, None] == content.ids) * content.shading
    cube = Cube(content.wavelengths, np.tensordot(content.spectra.T, one_hot, 1).astype(np.float32))
    basis = Basis(content.wavelengths, one_hot.astype(np.float32), content.spectra)
    # three left singular vectors more than enough for 8 entries: a low-rank basis takes the path of few entries
    u, s, v = np.linalg.svd(content.spectra, full_matrices=False)
    low = Basis(content.wavelengths, np.tensordot((u[:, :8] * s[:8]).T, one_hot, 1).astype(np.float32), v[:8])
    low_cube = Cube(content.wavelengths, np.tensordot(v[:8].T, low.coefficients, 1).astype(np.float32))
    for model in ("diffraction", "none"):
        camera = open_camera("phone")
        camera = replace(camera, optics=replace(camera.optics, model=model))
        for device in ALL:
            simulator = Simulator(camera, device=device)
            means = {name: np.array(simulator.device.numpy(simulator.expose(replace(scene, content=form), 0.01).mean))
                     for name, form in (("materials", content), ("cube", cube), ("basis", basis), ("low", low),
                                        ("low cube", low_cube))}
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
    raws = {device: Simulator(open_camera(camera), device=device).draw(mean, means.exposure_time, seed=3, frame=2)
            for device in ALL}
    assert raws["numpy"].dtype == np.uint16 and len(np.unique(raws["numpy"])) > 10
    for raw in raws.values():
        np.testing.assert_array_equal(raw, raws["numpy"])


@pytest.mark.parametrize("light", ["D65", "A"])
def test_colorchecker_colours(light):
    """CIEDE2000 of the rendered patches against XYZ of the same reflectances in D65, the display's white.

    A 3x3 matrix cannot do better than a few units for this sensor (it is not a linear transform of the eye's): the
    literature's good cameras have 2 to 3 on average; a wrong white, gamma or channel order gives more than 10.
    """
    colour = pytest.importorskip("colour", reason="the judge of colours is colour-science")
    size = (192, 128)
    scene = chart("colorchecker", size=size, light=light)
    from dataclasses import replace

    camera = open_camera("phone")
    clean = replace(camera, sensor=replace(camera.sensor, read_noise=0.0, prnu=0.0, dsnu=0.0, photon_noise=False))
    frame = Simulator(clean, device="opencl")(scene)
    spectra = scene.content.spectra
    truth, shown = [], []
    to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(400, 700, 10))
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(400, 700, 10))
    for rows, cols in colorchecker_patches(size):
        inner = slice((3 * rows.start + rows.stop) // 4, (rows.start + 3 * rows.stop) // 4), \
            slice((3 * cols.start + cols.stop) // 4, (cols.start + 3 * cols.stop) // 4)
        material = scene.content.ids[inner][0, 0]
        reflectance = colour.SpectralDistribution(spectra[material], scene.wavelengths)
        truth.append(colour.sd_to_XYZ(reflectance, cmfs, d65, method="Integration") / 100)
        shown.append(to_xyz @ frame.linear[(slice(None), *inner)].mean(axis=(1, 2)))
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    errors = colour.delta_E(colour.XYZ_to_Lab(np.array(shown), white), colour.XYZ_to_Lab(np.array(truth), white),
                            method="CIE 2000")
    print(f"ColorChecker in {light}: mean CIEDE2000 {errors.mean():.2f}, maximum {errors.max():.2f}")
    assert errors.mean() < 4 and errors.max() < 12


def test_frames_differ_in_noise_alone_and_can_be_drawn_in_any_order():
    simulator = Simulator(open_camera("phone"), device="opencl")
    scene = chart("flat", size=(33, 21))
    three = list(simulator.frames(scene, 3, seed=5))
    again = simulator(scene, seed=5, frame=2)
    np.testing.assert_array_equal(three[2].raw, again.raw)
    assert (three[0].raw != three[1].raw).mean() > 0.5
    np.testing.assert_array_equal(three[0].mean, three[1].mean)


def test_automatic_exposure_reaches_95_percent_of_the_well():
    camera = open_camera("phone")
    frame = Simulator(camera, device="opencl")(chart("ramp", size=(64, 16)))
    # float32 means of a float64 exposure time: half an ulp each
    assert abs(frame.mean.max() / (0.95 * camera.sensor.full_well) - 1) < 1e-6


def test_surroundings_take_part_in_the_blur_but_not_in_the_frame():
    """A wider scene with border "scene" gives the same centre as the whole of it, far from the edges of both."""
    from dataclasses import replace

    whole = chart("deadleaves", size=(240, 200))
    inner = replace(whole, border="scene", margin=60)
    simulator = Simulator(open_camera("phone"), device="numpy")
    simulator_camera = replace(open_camera("phone"), optics=replace(open_camera("phone").optics,
                                                                    relative_illumination="none"))
    simulator = Simulator(simulator_camera, device="opencl")
    full, cut = (np.array(simulator.device.numpy(simulator.expose(s, 0.01).mean)) for s in (whole, inner))
    # only the surroundings of the surroundings differ, beyond 60 pixels: less than the 0.3 % of the energy out there
    np.testing.assert_allclose(cut, full[60:-60, 60:-60], rtol=3e-3)
    assert cut.shape == (80, 120)


def test_simulate_writes_every_format(tmp_path, capsys):
    rawpy = pytest.importorskip("rawpy", reason="the judge of DNG files is LibRaw")
    outs = [tmp_path / f"a{suffix}" for suffix in (".png", ".dng", ".npz", ".exr")]
    report = tmp_path / "a.json"
    status, out, _ = run(capsys, "simulate", "colorchecker", "--camera", "phone", "--size", "97x65", "--device",
                         "opencl", *(a for o in outs for a in ("-o", o)), "--report", report, "--verify",
                         "--tolerance", "video")
    assert status == 0 and "tolerance: met" in out
    stored = np.load(outs[2])
    with rawpy.imread(str(outs[1])) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, stored["dn"])
        pattern = "".join("RGBG"[raw.raw_pattern[i, j]] for i in range(2) for j in range(2))
        assert pattern == "RGGB"
    assert stored["electrons"].shape == (65, 97) and stored["electrons"].dtype == np.float32
    facts = json.loads(report.read_text())
    assert {stage["stage"] for stage in facts["stages"]} >= {"optics.blur", "sensor.noise", "display.srgb"}
    assert all(stage["ms"] > 0 for stage in facts["stages"])
    assert facts["error"]["rms"] < 1e-6 and facts["meets_tolerance"] is True  # float32 transforms: 2.5e-7
    from PIL import Image

    assert Image.open(outs[0]).size == (97, 65)


@pytest.mark.parametrize("device", ALL)
def test_photograph_on_every_device(shared_data, tmp_path, capsys, device):
    from PIL import Image

    photo = tmp_path / "photo.png"
    Image.open(shared_data / "kodak" / "kodim23.png").crop((200, 100, 360, 220)).save(photo)
    status, _, _ = run(capsys, "simulate", photo, "--camera", "phone", "--device", device, "-o", tmp_path / "a.png",
                       "-o", tmp_path / "a.dng", "-o", tmp_path / "a.npz", "--report", tmp_path / "a.json")
    assert status == 0
    shown = np.asarray(Image.open(tmp_path / "a.png"), float)
    # a picture of the photograph: noise and blur differ, the content does not (another picture correlates below 0.5)
    original = np.asarray(Image.open(photo), float)
    assert np.corrcoef(shown.ravel(), original.ravel())[0, 1] > 0.97


def test_numbered_frames(tmp_path, capsys):
    report = tmp_path / "r.json"
    status, _, _ = run(capsys, "simulate", "flat", "--camera", "mono", "--size", "16x8", "--frames", 3, "-o",
                       tmp_path / "f.npz", "--report", report, "--device", "opencl")
    assert status == 0
    assert sorted(path.name for path in tmp_path.glob("f*")) == ["f_0000.npz", "f_0001.npz", "f_0002.npz"]
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
    (["flat", "-o", "no/such/folder/a.png"], "does not exist"),
    (["flat", "--size", "40000x40000"], "40000"),
    (["flat", "--size", "0x10"], "0"),
    (["flat", "--band", "red"], "--band"),
    (["flat", "--frames", "0"], "--frames: '0': wanted a whole number"),
    (["flat", "--colour"], "unrecognized arguments: --colour"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD)
def test_bad_input_is_one_line_and_status_2(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera = [] if "--camera" in arguments else ["--camera", "phone"]
    device = [] if "--device" in arguments else ["--device", "opencl"]
    status, out, err = run(capsys, "simulate", *arguments, *camera, *device)
    assert (status, out) == (2, "")
    assert words in err and err.count("\n") == 1 and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []  # nothing half-written


def test_existing_output_survives_a_failure(tmp_path, capsys):
    target = tmp_path / "a.png"
    target.write_bytes(b"precious")
    status, _, _ = run(capsys, "simulate", tmp_path / "missing.npz", "--camera", "phone", "-o", target)
    assert status == 2 and target.read_bytes() == b"precious"


def test_verify_command_counts_failures(tmp_path, capsys, monkeypatch):
    rows = tmp_path / "v.json"
    status, out, _ = run(capsys, "verify", "--device", "opencl", "--stage", "spectral.materials", "--json", rows)
    assert status == 0 and "0 failed" in out
    assert set(json.loads(rows.read_text())[0]) >= {"stage", "device", "case", "max_error", "tolerance", "ok"}
    import gpusim.kernels.spectral.materials as stage

    right = stage.materials
    monkeypatch.setattr(stage, "materials", lambda *a, **k: right(*a, **k) * 1.001)
    assert run(capsys, "verify", "--device", "opencl", "--stage", "spectral.materials")[0] == 1

    def broken(*_, **__):
        raise RuntimeError("the device is gone")

    monkeypatch.setattr(stage, "materials", broken)
    status, out, _ = run(capsys, "verify", "--device", "opencl", "--stage", "spectral.materials", "--json", rows)
    assert status == 1 and "the device is gone" in out
    assert json.loads(rows.read_text())[0]["max_error"] is None


def test_bench_refuses_a_stage_that_fails(capsys, monkeypatch, tmp_path):
    rows = tmp_path / "b.json"
    arguments = ("bench", "--device", "opencl", "--stage", "processor.linear", "--size", "64x48", "--json", rows)
    assert run(capsys, *arguments)[0] == 0
    row, = json.loads(rows.read_text())
    assert {"stage", "device", "size", "ms_p20", "ms_p50", "ms_p80", "bytes", "gbps", "floor_ms", "ratio_to_floor",
            "build_ms", "rel_rms_error", "max_error"} <= set(row)
    import gpusim.kernels.processor.linear as stage

    right = stage.linear
    monkeypatch.setattr(stage, "linear", lambda *a, **k: right(*a, **k) + 1)
    status, out, _ = run(capsys, *arguments)
    assert status == 1 and "no speed" in out
    assert "ms_p50" not in json.loads(rows.read_text())[0]


def test_devices_command(capsys):
    status, out, _ = run(capsys, "devices", "--json")
    entries = json.loads(out)
    assert status == 0 and {"numpy", "warp:cpu"} <= {entry["name"] for entry in entries}
    assert all(entry["copy_gbps"] > 0 for entry in entries if not entry["error"])


def test_a_driver_that_aborts_is_reported_not_fatal(monkeypatch):
    from gpusim.backends import probe

    def aborting(argument):
        return subprocess.run([sys.executable, "-c", "import os; os.abort()"], capture_output=True, text=True)

    monkeypatch.setattr(probe, "_run", aborting)
    assert "ended the process" in probe._try("opencl:0")["error"]


def test_version():
    assert gpusim.__version__ == __import__("importlib.metadata", fromlist=["version"]).version("gpusim")
