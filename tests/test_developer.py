"""The image processor as a whole: every setting through the simulator, on every kind of device."""

from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS

from gpusim.data.cameras import open_camera
from gpusim.data.charts import chart
from gpusim.data.displays import open_display
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.scheduler import Simulator

TONE = ((0, 0), (0.3, 0.2), (0.7, 0.8), (1, 1))
SETTINGS = {
    "malvar": {"demosaic": "malvar"}, "adaptive": {"demosaic": "adaptive"}, "best": {"demosaic": "best"},
    "learned": {"demosaic": "learned"}, "detected": {"defects": "detect"}, "known": {"defects": "known"},
    "shaded": {"shading": True}, "denoised": {"denoise": 1.0},
    "all": {"defects": "known", "shading": True, "denoise": 0.5, "demosaic": "malvar", "tone": TONE},
    "gray world": {"white_balance": "gray-world"}, "red-blue": {"white_balance": "red-blue", "color": "ridge"},
    "uncorrected": {"white_balance": "shades-of-gray", "color": "none"}, "tone": {"tone": TONE},
}


def camera_with(noise=None, sensor=None, name="phone", **settings):
    camera = open_camera(name)
    made = replace(camera.sensor, **(sensor or {}), noise=replace(camera.sensor.noise, **(noise or {})))
    return replace(camera, sensor=made, processor=replace(camera.processor, demosaic="bilinear") if not settings else
                   replace(camera.processor, **({"demosaic": "bilinear"} | settings)))


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=list(SETTINGS))
@pytest.mark.parametrize("device", [kind for kind in KINDS if kind != "numpy"])
def test_every_setting_develops_as_the_reference_does(device, settings):
    """The same raw values, developed on a device and by the float64 references.

    Steps that round to whole numbers (denoising and shading: 1 of 61439) may fall on either side, and the matrix's rows
    of absolute sum 3 and the demosaicking filters' of at most 2.5 enlarge that to 1.3e-4; all else is float32 roundings
    times conditions of 20 at most, below 4e-5. Learned filters are chosen by exact comparisons, all others are
    continuous but for defects, which are found by exact ones too.
    """
    camera = camera_with({"dead_pixels": 0.002}, **settings)
    scene = chart("colorchecker", size=(72, 48), light="A")
    reference = Simulator(camera, device="numpy")
    exposure = reference.expose(scene)
    raw = np.asarray(reference.draw(exposure, seed=3))
    wanted, wanted_codes = reference.develop(raw, exposure)
    simulator = Simulator(camera, device=device)
    ours = simulator.expose(scene)
    linear, codes = (simulator.device.numpy(a) for a in simulator.develop(simulator.device.array(raw, np.uint16), ours))
    np.testing.assert_allclose(linear, wanted, atol=1.7e-4 * max(1.0, np.abs(wanted).max()))
    # a code is 3295 codes per unit of light at the steepest (sRGB at black), the tone curve no steeper
    assert np.abs(codes.astype(int) - wanted_codes).max() <= 1
    alone = simulator.device.numpy(simulator.codes(simulator.device.array(raw, np.uint16), ours))
    np.testing.assert_array_equal(alone, codes)


@pytest.mark.parametrize("device", KINDS)
def test_shading_makes_a_flat_scene_flat(device):
    """cos^4 of a lens and a vignetting sensor, without noise: the corner is at half; after it, flat to 1e-3."""
    camera = camera_with({"photon": "none", "read": 0.0, "prnu": 0.0, "dsnu": 0.0, "dark_current": 0.0},
                         {"bits": 16, "vignetting": ((0.5, 0.8), (0.7, 1))}, shading=True)
    camera = replace(camera, optics=replace(camera.optics, focal_length=100 * camera.sensor.pixel_pitch))
    scene = chart("flat", size=(60, 40))
    simulator = Simulator(camera, device=device)
    corrected = simulator(scene).linear
    plain = Simulator(replace(camera, processor=replace(camera.processor, shading=False)), device=device)(scene).linear
    assert plain[1].min() < 0.6 * plain[1].max()
    # numbers of 16 bits at a fifth of white or more: roundings of 1 / 13000; gains err by 2e-4 of themselves at most
    assert np.ptp(corrected[1]) < 1e-3 * corrected[1].mean()


@pytest.mark.parametrize("device", KINDS)
def test_known_defects_leave_no_trace_in_a_flat_field(device):
    """Without other noise every pixel of a channel has the same number, and so have the replaced ones."""
    noise = {"photon": "none", "read": 0.0, "prnu": 0.0, "dsnu": 0.0, "dark_current": 0.0, "dead_pixels": 0.01,
             "hot_pixels": 0.01, "hot_current": 1e5}
    camera = camera_with(noise, {"exposure_time": 0.01, "vignetting": None}, defects="known")
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    scene = chart("flat", size=(60, 40))
    frame = Simulator(camera, device=device)(scene)
    plain = Simulator(replace(camera, processor=replace(camera.processor, defects="none")), device=device)(scene)
    assert np.ptp(plain.linear[1]) > 0.1
    assert np.ptp(frame.linear[1]) <= 1e-6  # equal numbers, in sums of different order


@pytest.mark.parametrize("device", KINDS)
def test_estimated_white_finds_the_light(device):
    """A ColorChecker in A by its white patch: 0.2 degrees from the truth by max-RGB (measured), 17 away from D65's.

    Without an estimate, as if in D65, white is orange.
    """
    scene = chart("colorchecker", size=(96, 64), light="A")
    truth = Simulator(camera_with(), device=device)(scene).rendering.neutral
    found = Simulator(camera_with(white_balance="max-rgb"), device=device)(scene).rendering.neutral
    assumed = Simulator(camera_with(white_balance="none"), device=device)(scene).rendering.neutral

    def degrees(a, b):
        return np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))

    # block means over 2 pixels of a patch of 12: noise of 2 % in the brightest of 30 blocks
    assert degrees(found, truth) < 2.5
    assert degrees(assumed, truth) > 10


def test_a_frame_is_balanced_by_itself():
    """The estimate is each frame's own, and the frame says so."""
    simulator = Simulator(camera_with(white_balance="gray-world"), device="opencl")
    one, two = simulator.frames(chart("colorchecker", size=(72, 48)), 2)
    assert not np.array_equal(one.rendering.neutral, two.rendering.neutral)  # the noise differs
    assert "gray-world" in one.rendering.model
    assert any(stage.stage == "processor.thumbnail" for stage in one.report.stages)


def test_report_names_the_steps_in_order():
    simulator = Simulator(camera_with(**SETTINGS["all"]), device="opencl")
    report = simulator(chart("colorchecker", size=(72, 48))).report
    stages = [stage.stage for stage in report.stages]
    assert stages[stages.index("sensor.noise") + 1:] == [
        "processor.defects", "processor.denoise", "processor.shade", "processor.malvar", "processor.color",
        "display.encode"]
    assert "with a tone curve" in report.stages[-1].model


def test_a_display_of_its_own_primaries_shows_the_same_colours():
    """XYZ of the linear picture is the same for any display that can show it, white being the same."""
    scene = chart("colorchecker", size=(72, 48))
    found = []
    for name in ("srgb", "display-p3"):
        camera = replace(camera_with(), display=open_display(name))
        frame = Simulator(camera, device="opencl")(scene)
        found.append(np.tensordot(camera.display.xyz_from_rgb, frame.linear.astype(float), 1))
    np.testing.assert_allclose(found[0], found[1], atol=2e-6 * np.abs(found[0]).max())  # float32 matrices and pictures
    gamma = replace(camera_with(), display=replace(open_display("srgb"), curve=1.0))
    codes = Simulator(gamma, device="opencl")(scene)
    np.testing.assert_array_equal(codes.rgb, np.rint(255 * np.clip(np.moveaxis(codes.linear, 0, 2), 0, 1)))


def test_float_raw_values_keep_noise_below_black():
    """A sensor without a converter: values below the dark level are shown as such, so that the mean stays black."""
    camera = camera_with({"read": 20.0, "dsnu": 0.0}, {"bits": FLOAT_BITS, "exposure_time": 1e-6})
    frame = Simulator(camera, device="opencl")(chart("flat", size=(80, 60), luminance=0.01))
    spread = frame.linear[1].std()
    assert spread > 0 and abs(frame.linear[1].mean()) < 5 * spread / np.sqrt(80 * 60 / 4)


def test_mosaics_that_a_method_does_not_know():
    with pytest.raises(OutOfRange, match=r'"best" of the mosaic .* "bilinear", or "learned" with a table'):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="best")
    with pytest.raises(OutOfRange, match=r'"learned" of the mosaic'):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="learned")


def test_table_of_another_mosaic():
    from gpusim.data.learned import bayer_table

    with pytest.raises(UnknownName, match="mosaic"):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="learned", table=bayer_table())
