"""The image processor as a whole: every setting through the simulator, on every kind of device."""

import re
from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS

from gpusim.data.charts import chart
from gpusim.data.displays import open_display
from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.simulator import Simulator

# by default on one device: the stages' own tests run on all, and whole pictures take long to build
FIRST = [
    KINDS[0],
    *(
        kind if hasattr(kind, "marks") else pytest.param(kind, marks=pytest.mark.slow)
        for kind in KINDS[1:]
    ),
]
TONE = ((0, 0), (0.3, 0.2), (0.7, 0.8), (1, 1))
SETTINGS = {
    "malvar": {"demosaic": "malvar"},
    "adaptive": {"demosaic": "adaptive"},
    "best": {"demosaic": "best"},
    "learned": {"demosaic": "learned"},
    "network": {"demosaic": "network"},
    "detected": {"defects": "detect"},
    "known": {"defects": "known"},
    "shaded": {"shading": True},
    "denoised": {"denoise": 1.0},
    "denoised after best": {"denoise": 1.0, "demosaic": "best", "shading": True},
    "mosaic denoised": {"denoise": 1.0, "denoise_by": "mosaic"},
    "all": {
        "defects": "known",
        "shading": True,
        "denoise": 0.5,
        "demosaic": "malvar",
        "tone": TONE,
        "sharpen": 0.5,
    },
    "sharpened": {"sharpen": 1.0, "white_balance": "gray-world"},
    "gray world": {"white_balance": "gray-world"},
    "bayesian": {"white_balance": "bayesian"},
    "red-blue": {"white_balance": "red-blue", "color": "ridge"},
    "uncorrected": {"white_balance": "shades-of-gray", "color": "none"},
    "roots": {"color": "root-polynomial"},
    "sharp roots": {"color": "root-polynomial", "sharpen": 1.0},
    "cube roots": {"color": "root-polynomial-3", "white_balance": "max-rgb"},
    "tone": {"tone": TONE},
    "finished": {"highlights": "rebuild", "local_tone": 1.0, "gamut": "map"},
}


def camera_with(noise=None, sensor=None, name="phone", **settings):
    camera = open_camera(name)
    made = replace(
        camera.sensor, **(sensor or {}), noise=replace(camera.sensor.noise, **(noise or {}))
    )
    return replace(
        camera,
        sensor=made,
        processor=replace(camera.processor, demosaic="bilinear")
        if not settings
        else replace(camera.processor, **({"demosaic": "bilinear"} | settings)),
    )


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=list(SETTINGS))
@pytest.mark.parametrize("device", FIRST)
def test_every_setting_develops_as_the_reference_does(device, settings):
    """The same raw values, developed on a device and by the float64 references.

    Steps that round to whole numbers (denoising and shading: 1 of 61439) may fall on either side, and the matrix's rows
    of absolute sum 3 and the demosaicking filters' of at most 2.5 enlarge that to 1.3e-4; all else is float32 roundings
    times conditions of 20 at most, below 4e-5. Learned filters are chosen by exact comparisons, all others are
    continuous but for defects, which are found by exact ones too. Matrix units of GPUs multiply the network's float16
    numbers: 8.1e-3 of the peak by the stage's own case "half", which the matrix enlarges by 3.
    """
    camera = camera_with({"dead_pixels": 0.002}, **settings)
    scene = chart("colorchecker", size=(72, 48), light="A")
    reference = Simulator(camera, device="numpy")
    exposure = reference.expose(scene)
    raw = np.asarray(exposure.raw(seed=3))
    wanted, wanted_codes = exposure.develop(raw)
    simulator = Simulator(camera, device=device)
    ours = simulator.expose(scene)
    linear, codes = (
        simulator.device.numpy(a) for a in ours.develop(simulator.device.array(raw, np.uint16))
    )
    is_half = settings.get("demosaic") == "network" and simulator.device.has_matrix_units
    error = (3 * 8.1e-3 if is_half else 1.7e-4) * max(1.0, np.abs(wanted).max())
    np.testing.assert_allclose(linear, wanted, atol=error)
    # a code is 3295 codes per unit of light at the steepest (sRGB at black), the tone curve no steeper
    assert np.abs(codes.astype(int) - wanted_codes).max() <= 1 + 3295 * error * is_half
    alone = simulator.device.numpy(ours.codes(simulator.device.array(raw, np.uint16)))
    np.testing.assert_array_equal(alone, codes)


@pytest.mark.parametrize("device", FIRST)
def test_shading_makes_a_flat_scene_flat(device):
    """cos^4 of a lens and a vignetting sensor, without noise: the corner is at half; after it, flat to 1e-3."""
    camera = camera_with(
        {"photon": "none", "read": 0.0, "prnu": 0.0, "dsnu": 0.0, "dark_current": 0.0},
        {"bits": 16, "vignetting": ((0.5, 0.8), (0.7, 1))},
        shading=True,
    )
    camera = replace(
        camera, optics=replace(camera.optics, focal_length=100 * camera.sensor.pixel_pitch)
    )
    scene = chart("flat", size=(60, 40))
    simulator = Simulator(camera, device=device)
    corrected = simulator(scene).linear
    plain = Simulator(
        replace(camera, processor=replace(camera.processor, shading=False)), device=device
    )(scene).linear
    assert plain[..., 1].min() < 0.6 * plain[..., 1].max()
    # numbers of 16 bits at a fifth of white or more: roundings of 1 / 13000; gains err by 2e-4 of themselves at most
    assert np.ptp(corrected[..., 1]) < 1e-3 * corrected[..., 1].mean()


@pytest.mark.parametrize("device", FIRST)
def test_known_defects_leave_no_trace_in_a_flat_field(device):
    """Without other noise every pixel of a channel has the same number, and so have the replaced ones."""
    noise = {
        "photon": "none",
        "read": 0.0,
        "prnu": 0.0,
        "dsnu": 0.0,
        "dark_current": 0.0,
        "dead_pixels": 0.01,
        "hot_pixels": 0.01,
        "hot_current": 1e5,
    }
    camera = camera_with(noise, {"exposure_time": 0.01, "vignetting": None}, defects="known")
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    scene = chart("flat", size=(60, 40))
    frame = Simulator(camera, device=device)(scene)
    plain = Simulator(
        replace(camera, processor=replace(camera.processor, defects="none")), device=device
    )(scene)
    assert np.ptp(plain.linear[..., 1]) > 0.1
    assert np.ptp(frame.linear[..., 1]) <= 1e-6  # equal numbers, in sums of different order


@pytest.mark.parametrize("method", ["max-rgb", "bayesian"])
@pytest.mark.parametrize("device", FIRST)
def test_estimated_white_finds_the_light(device, method):
    """A ColorChecker in A by its white patch: 0.2 degrees from the truth by max-RGB (measured), 17 away from D65's.

    Without an estimate, as if in D65, white is orange.
    """
    scene = chart("colorchecker", size=(96, 64), light="A")
    truth = Simulator(camera_with(), device=device)(scene).rendering.neutral
    found = Simulator(camera_with(white_balance=method), device=device)(scene).rendering.neutral
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


def test_the_report_names_the_estimate_and_its_confidence():
    camera = camera_with(white_balance="bayesian")
    frame = Simulator(camera, device="opencl")(chart("colorchecker", size=(72, 48)))
    words = {stage.stage: stage.model for stage in frame.report.stages}["processor.color"]
    assert re.search(r"bayesian, \d+ % sure of it to 3 degrees, expected error", words)


def test_report_names_the_steps_in_order():
    simulator = Simulator(camera_with(**SETTINGS["all"]), device="opencl")
    report = simulator(chart("colorchecker", size=(72, 48))).report
    stages = [stage.stage for stage in report.stages]
    assert stages[stages.index("sensor.noise") + 1 :] == [
        "processor.defects",
        "processor.shade",
        "processor.malvar",
        "processor.multiscale",
        "processor.color",
        "processor.sharpen",
        "display.encode",
    ]
    assert "with a tone curve" in report.stages[-1].model


def test_a_display_of_its_own_primaries_shows_the_same_colours():
    """XYZ of the linear picture is the same for any display that can show it, white being the same."""
    scene = chart("colorchecker", size=(72, 48))
    found = []
    for name in ("srgb", "display-p3"):
        camera = replace(camera_with(), display=open_display(name))
        frame = Simulator(camera, device="opencl")(scene)
        found.append(frame.linear.astype(float) @ camera.display.xyz_from_rgb.T)
    np.testing.assert_allclose(
        found[0], found[1], atol=2e-6 * np.abs(found[0]).max()
    )  # float32 matrices and pictures
    gamma = replace(camera_with(), display=replace(open_display("srgb"), curve=1.0))
    codes = Simulator(gamma, device="opencl")(scene)
    np.testing.assert_array_equal(codes.rgb, np.rint(255 * np.clip(codes.linear, 0, 1)))


def test_float_raw_values_keep_noise_below_black():
    """A sensor without a converter: values below the dark level are shown as such, so that the mean stays black."""
    camera = camera_with({"read": 20.0, "dsnu": 0.0}, {"bits": FLOAT_BITS, "exposure_time": 1e-6})
    frame = Simulator(camera, device="opencl")(chart("flat", size=(80, 60), luminance=0.01))
    spread = frame.linear[..., 1].std()
    assert spread > 0 and abs(frame.linear[..., 1].mean()) < 5 * spread / np.sqrt(80 * 60 / 4)


def test_mosaics_that_a_method_does_not_know():
    with pytest.raises(
        OutOfRange, match=r'"best" of the mosaic .* "bilinear", "learned" with a table'
    ):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="best")
    with pytest.raises(OutOfRange, match=r'"learned" of the mosaic'):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="learned")


def test_table_of_another_mosaic():
    from gpusim.io.camera.learned import bayer_table

    with pytest.raises(UnknownName, match="mosaic"):
        camera_with(sensor={"cfa": ("RGB", "GBR", "BRG")}, demosaic="learned", table=bayer_table())


# ------------------------------------------------------------------------------- what the processor knows of the noise


@pytest.mark.parametrize(
    ("noise", "sensor"),
    [
        ({}, {}),
        ({"photon": "none"}, {}),
        ({"dsnu": 0.0, "row": 4.0, "read": 9.0}, {}),
        ({}, {"bits": FLOAT_BITS}),
        ({}, {"binning": (2, 2)}),
        ({}, {"binning": (2, 2), "binning_mode": "digital"}),
        ({}, {"analog_gain": 4.0}),
    ],
    ids=["plain", "no photons", "rows", "float", "charge", "digital", "gain"],
)
def test_noise_model_is_that_of_the_raw_values(noise, sensor):
    """Variance of 24 frames of a flat field against gain (DN - dark) + read^2.

    No PRNU, which the model leaves out; DSNU does not vary from frame to frame and is left out here as well. 24 frames
    of 1200 pixels or more scatter by sqrt(2 / 28800) = 0.8 %, rows' noise of 40 rows by sqrt(2 / 960) = 4.6 % of its
    part, a fifth here.
    """
    camera = camera_with(
        {"prnu": 0.0, "dsnu": 0.0, "read": 4.0} | noise, sensor, demosaic="bilinear"
    )
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    simulator = Simulator(camera, device="opencl")
    exposure = simulator.expose(chart("flat", size=(120, 80)))
    raws = simulator.device.numpy(exposure.raw(seed=5, frames=24)).astype(float)[
        :, ::2, ::2
    ]  # one colour
    developer = Developer(exposure.camera, simulator.device, simulator.readout.averaged)
    gain, read = developer.noise
    measured = raws.var(axis=0, ddof=1).mean()
    predicted = gain * (raws.mean() - exposure.camera.sensor.dark_level) + read**2
    assert measured == pytest.approx(predicted, rel=0.05)


def test_denoising_without_photon_noise_sees_the_read_noise():
    camera = camera_with({"photon": "none", "read": 60.0, "prnu": 0.0, "dsnu": 0.0})
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    plain, denoised = (
        Simulator(
            replace(camera, processor=replace(camera.processor, denoise=strength)), device="opencl"
        )(chart("flat", size=(96, 64))).linear
        for strength in (0.0, 1.0)
    )
    assert (
        denoised[..., 1].std() < 0.5 * plain[..., 1].std()
    )  # its variance falls 16 times and more on flat fields


@pytest.mark.parametrize("sigma", [0.45, 0.9, 1.6])
def test_blur_of_a_gaussian_lens(sigma):
    """A measured Gaussian point spread of known width: its transfer at 1/4 cycle is exp(-2 (pi sigma / 4)^2).

    The table's samples are a fifth of a pixel apart and interpolated linearly: variance larger by 1 / 150 pixel^2, at
    most 1.7 % of sigma.
    """
    from gpusim.domain.psf import PointSpread

    camera = camera_with(name="machine-vision")
    pitch = camera.sensor.pixel_pitch
    spacing, half = pitch / 5, 60
    place = np.arange(-half, half + 1) / 5
    spread = np.exp(-np.add.outer(place**2, place**2) / (2 * sigma**2))
    psf = PointSpread(np.array([400.0, 700.0]), np.stack([spread, spread]), spacing)
    camera = replace(camera, optics=replace(camera.optics, psf=psf, model="measured"))
    simulator = Simulator(camera, device="numpy")
    plan = simulator.plan(chart("flat", size=(64, 48)))
    assert simulator.imaging.tables.deviation(plan) == pytest.approx(sigma, rel=0.02)


@pytest.mark.parametrize("color", ["white-preserving", "none"])
def test_estimated_white_keeps_the_brightness(color):
    """A grey scene in A, by gray world: neutral, and as bright as its reflectance, which is white's share.

    4800 pixels of 1000 electrons or more: 0.05 %, times 3 by the matrix; the strongest channel of the estimate is that
    of the light's own white, whose noise is 0.1 %.
    """
    # half a well: where values scatter about the clipping level, leaving out clipped ones would bias the means
    camera = camera_with(
        sensor={"auto_exposure": AutoExposure(level=0.5)},
        white_balance="gray-world",
        color=color,
        scaling="normalised",
    )
    camera = replace(camera, optics=replace(camera.optics, relative_illumination="none"))
    frame = Simulator(camera, device="opencl")(
        chart("flat", size=(80, 60), light="A", reflectance=0.4)
    )
    np.testing.assert_allclose(frame.linear.mean(axis=(0, 1)), 0.4, rtol=5e-3)


def test_one_simulator_is_as_good_as_new_ones():
    """What is kept from frame to frame follows field of view, time and gain."""
    noise = {"hot_pixels": 0.02, "hot_current": 2e4}
    camera = camera_with(
        noise, {"exposure_time": 0.02}, shading=True, defects="known", demosaic="best"
    )
    one = Simulator(camera, device="opencl")
    small, large = (replace(chart("colorchecker", size=(72, 48)), fov=fov) for fov in (0.3, 1.4))
    for scene, time, gain in (
        (small, 0.02, 1.0),
        (large, 0.02, 1.0),
        (large, 0.2, 1.0),
        (large, 0.02, 8.0),
    ):
        pictures = []
        for simulator in (one, Simulator(camera, device="opencl")):
            exposure = simulator.expose(scene, time, gain)
            raw = exposure.raw(seed=2)
            pictures.append(np.array(simulator.device.numpy(exposure.develop(raw)[0])))
        np.testing.assert_array_equal(*pictures)


# ------------------------------------------------------------------------------------------- stacked and binned pixels


def test_layers_of_stacked_pixels_do_not_meet():
    """Every layer is corrected as if it were alone: the other layers' values change nothing in it."""
    letters = ("R", "G", "B")
    camera = camera_with(
        {"dead_pixels": 0.02},
        {"stacked": True},
        shading=True,
        denoise=1.0,
        denoise_by="mosaic",
        defects="known",
    )
    simulator = Simulator(camera, device="opencl")
    exposure = simulator.expose(chart("colorchecker", size=(60, 40)))
    raw = np.array(simulator.device.numpy(exposure.raw(seed=1)))
    changed = raw.copy()
    changed[40:] = 1000 - changed[40:] // 2  # all but the first layer
    developer = Developer(exposure.camera, simulator.device, simulator.readout.averaged)
    known = exposure.values()["defects"]
    planes = [
        np.array(
            simulator.device.numpy(
                developer.demosaic(
                    simulator.device.array(values, np.uint16), known=known, shading=exposure.shading
                )
            )
        )
        for values in (raw, changed)
    ]
    assert planes[0].shape == (len(letters), 40, 60)
    np.testing.assert_array_equal(planes[0][0], planes[1][0])
    assert not np.array_equal(planes[0][1], planes[1][1])


@pytest.mark.parametrize("binning", [(1, 1), (2, 2)])
def test_shading_of_binned_pixels(binning):
    """Flat after the correction, whatever the binned colours' places: 243 x 179 pixels, 70 degrees, no noise.

    Gains err by 2e-4 between their nodes, or by what a node per pixel leaves: steps of 4 pixels of cos^4 over 120, (4 /
    120)^2 / 8 times second derivatives up to 8, 1e-3, both ways and twice that in the range. The smallest of 16-bit
    numbers are a quarter of white. The matrix's rows, of absolute sum 3, may triple it where channels differ.
    """
    camera = camera_with(
        {"photon": "none", "read": 0.0, "prnu": 0.0, "dsnu": 0.0, "dark_current": 0.0},
        {"bits": 16, "binning": binning},
        shading=True,
    )
    scene = replace(chart("flat", size=(243, 179)), fov=np.radians(70))
    linear = Simulator(camera, device="opencl")(scene).linear
    assert max(np.ptp(plane) / plane.mean() for plane in np.moveaxis(linear, -1, 0)) < 6e-3


def test_xyz_tables_balance_white_themselves():
    from gpusim.apps.l3.layout import layout
    from gpusim.domain.learned import FilterTable

    made = layout(("RG", "GB"), ("X", "Y", "Z"))
    table = FilterTable(made, np.zeros(made.shape))
    assert camera_with(demosaic="learned", table=table).processor.table is table
    with pytest.raises(OutOfRange, match=r"filters that give XYZ.*balance white already"):
        camera_with(demosaic="learned", table=table, white_balance="gray-world")
