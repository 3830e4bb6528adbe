"""The sensor end to end: mosaics, stacked pixels, binning, gains, exposure control, reads, bursts; and what is refused.

What the kernels' random numbers are worth is judged elsewhere (test_noise.py, test_poisson.py, test_pattern.py); here a
sample's mean and variance have to agree with theory to Z standard errors: below one false alarm in 1e4 tests.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS

import gpusim as gs
from gpusim.data.charts import chart
from gpusim.domain.camera import Camera
from gpusim.domain.content import Cube
from gpusim.domain.errors import BadData, GpusimError, OutOfRange
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.mosaics import mosaic
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.measure import merge_inputs
from gpusim.pipeline import light
from gpusim.pipeline.simulator import Simulator

Z = 4.5
ULP = 2.0**-23  # of float32, relative: twice the largest rounding error
OPTICS = Optics(4.0, 12e-3, "none", relative_illumination="none")
QUIET = Noise(photon="none")
# Electrons per photon at 400, 550 and 700 nm; no two channels have the same sum in daylight
CURVES = {
    "R": (0.05, 0.2, 0.6),
    "G": (0.1, 0.5, 0.1),
    "B": (0.5, 0.15, 0.02),
    "W": (0.55, 0.8, 0.65),
    "N": (0.01, 0.02, 0.3),
    "Y": (0.3, 0.6, 0.5),
    "C": (0.4, 0.45, 0.05),
    "M": (0.35, 0.1, 0.4),
}
RANDOM = np.random.default_rng(3)
MOSAICS = {
    name: mosaic(name)
    for name in (
        "bayer-rggb",
        "bayer-grbg",
        "bayer-gbrg",
        "bayer-bggr",
        "quad-bayer",
        "rgbw",
        "rgbn",
        "rccc",
        "x-trans",
        "mono",
        "cygm",
    )
}
MOSAICS |= {
    f"random {n}x{n}": tuple(
        "".join(row) for row in RANDOM.permuted(np.resize(list("RGBWNYCM"), (n, n)))
    )
    for n in (4, 8)
}


def camera(cfa=("Y",), noise=QUIET, optics=OPTICS, name="bench", scaling="exposure", **sensor):
    letters = sorted(set("".join(cfa)), key=("RGB" + "".join(CURVES)).index)
    qe = Spectrum([400, 550, 700], [CURVES[letter] for letter in letters])
    made = Sensor(
        **{
            "pixel_pitch": 3e-6,
            "qe": qe,
            "full_well": 10000.0,
            "bits": 12,
            "channels": letters,
            "cfa": cfa,
            "noise": noise,
            "exposure_time": 0.01,
        }
        | sensor
    )
    return Camera(name, optics, made, Processor(demosaic="bilinear", color="none", scaling=scaling))


def simulator(*arguments, device="opencl", **sensor):
    return Simulator(camera(*arguments, **sensor), device=device)


def electrons(simulate, level, shape=(256, 256), time=0.01, **options):
    """Raw values around a uniform mean [e-], in float64."""
    return np.asarray(
        simulate.readout.draw_electrons(np.full(shape, level, np.float32), time, **options),
        np.float64,
    )


def is_sample_of(values, mean, variance, fourth=3.0):
    """Whether mean and variance are within Z standard errors; fourth: central moment over the variance squared.

    The variance of a sample variance is (fourth - 1) variance^2 / n for many values, 2 variance^2 / n of normal ones.
    """
    n = np.size(values)
    errors = (
        (np.mean(values) - mean) / np.sqrt(variance / n),
        (np.var(values) - variance) / (variance * np.sqrt((fourth - 1) / n)),
    )
    assert max(map(abs, errors)) < Z, (
        f"mean {np.mean(values):.6g} for {mean:.6g}, variance {np.var(values):.6g} for "
        f"{variance:.6g}: {errors[0]:.2f} and {errors[1]:.2f} standard errors"
    )


# ------------------------------------------------------------------------------------------------- mosaics and pixels


@pytest.mark.parametrize("name", MOSAICS)
def test_each_pixel_sees_its_own_channel(name):
    """A flat grey: every pixel has what the integral of its letter's curve predicts."""
    cfa = MOSAICS[name]
    scene = chart("flat", size=(37, 29))
    simulate = simulator(cfa)
    exposure = simulate.expose(scene)
    mean, raw = (
        np.array(simulate.device.numpy(array)) for array in (exposure.mean, exposure.raw())
    )
    nm = np.linspace(400, 700, 3001)
    light = 0.18 * scene.illuminant.at(nm) * OPTICS.irradiance_factor * 3e-6**2 * 0.01
    expected = {
        c: np.trapezoid(light * np.interp(nm, [400, 550, 700], CURVES[c]), nm)
        for c in set("".join(cfa))
    }
    assert (
        len({round(value) for value in expected.values()}) == len(expected)
        and min(expected.values()) > 50
    )
    letters = np.array([list(cfa[y % len(cfa)]) for y in range(29)])
    letters = letters[:, np.arange(37) % len(cfa[0])]
    wanted = np.vectorize(expected.get)(letters)
    # steps of 0.1 nm leave h^2 / 12 of the product's second derivative, some 1e-7; the float32 of weights and values
    # four roundings of 6e-8
    np.testing.assert_allclose(mean, wanted, rtol=1e-6)
    gain = 4095 / 10000
    # rounding is half a DN, and the means' error up to 4095e-6
    assert raw.dtype == np.uint16 and np.abs(raw - gain * wanted).max() <= 0.5 + 4.1e-3


@pytest.mark.parametrize("name", ["mono", "bayer-gbrg", "x-trans", "rgbw", "rccc"])
def test_grey_comes_out_neutral(name):
    """Two, three and four channels, in colour or grey, as far as half a DN allows."""
    frame = simulator(MOSAICS[name], scaling="normalised")(chart("flat", size=(37, 29)))
    assert frame.linear.shape == (29, 37, 3) and frame.rgb.shape == (29, 37, 3)
    # each channel of white is 1 after balance, and grey 0.18; interpolation rounds in float32, far below 1e-4
    assert np.abs(frame.linear / 0.18 - 1).max() <= 0.5 / (4095 / 10000 * frame.mean.min()) + 1e-4


@pytest.mark.parametrize("name", ["bayer-grbg", "x-trans"])
@pytest.mark.parametrize("device", KINDS)
def test_raw_of_any_mosaic_is_the_same_on_every_device(device, name):
    """Full noise, the same means: bit for bit."""
    noise = Noise(
        dark_current=50.0,
        read=3.0,
        reset=2.0,
        adc=0.5,
        row=0.7,
        column=0.4,
        prnu=0.01,
        row_prnu=1e-3,
        column_prnu=1e-3,
        dsnu=1.0,
        row_dsnu=0.3,
        column_dsnu=0.2,
        hot_pixels=0.01,
        hot_current=300.0,
        dead_pixels=0.005,
        telegraph_pixels=0.02,
        telegraph=20.0,
        telegraph_switching=0.25,
        seed=11,
    )
    mean = np.random.default_rng(4).uniform(0, 11000, (48, 41)).astype(np.float32)
    for changes in ({}, {"binning": (2, 2)}, {"binning": (2, 1), "binning_mode": "digital"}):
        raws = [
            Simulator(camera(MOSAICS[name], noise, **changes), device=one).readout.draw_electrons(
                mean, 0.02, seed=5, first=3, frames=2
            )
            for one in ("numpy", device)
        ]
        assert raws[0].dtype == np.uint16
        assert len(np.unique(raws[0])) > 100 and (raws[0][0] != raws[0][1]).mean() > 0.5
        np.testing.assert_array_equal(raws[1], raws[0])


@pytest.mark.parametrize("model", ["none", "diffraction"])
def test_stacked_pixels_are_as_many_captures_as_channels(model):
    optics = dataclasses.replace(OPTICS, model=model)
    scene = chart("colorchecker", size=(60, 44))
    frame = simulator(("RG", "GB"), optics=optics, stacked=True)(scene)
    assert frame.mean.shape == frame.raw.shape == (3, 44, 60) and frame.linear.shape == (44, 60, 3)
    for layer, letter in enumerate("RGB"):
        one = simulator((letter,), optics=optics)(scene)
        # blurred and not fused: both err by at most the transforms' 2.4e-6 of the peak
        assert np.abs(frame.mean[layer] - one.mean).max() <= 5e-6 * one.mean.max()
        wrong = np.abs(frame.raw[layer].astype(int) - one.raw)
        assert (
            wrong.max() <= 1 and (wrong > 0).mean() < 0.02
        )  # only where the rounding is a near tie


def test_stacked_pixels_have_noise_of_their_own():
    simulate = simulator(("RG", "GB"), Noise(), stacked=True, gain=1.0, bits=14)
    mean = np.full((3, 128, 128), 900, np.float32)
    layers = simulate.readout.draw_electrons(mean, 0.01).reshape(3, -1)
    for layer in layers:
        is_sample_of(layer, 900, 900 + 1 / 12)
    # a correlation of n independent pairs has the standard error 1 / sqrt(n)
    assert np.abs(np.corrcoef(layers)[np.triu_indices(3, 1)]).max() < Z / np.sqrt(layers.shape[1])


# ------------------------------------------------------------------------------------------------------------- binning


def test_charge_is_added_before_one_read():
    """50 e- a pixel, 2 x 2 of them, 30 e- rms once: SNR 200 / sqrt(200 + 900), not 200 / sqrt(200 + 4 900)."""
    simulate = simulator(noise=Noise(read=30.0), binning=(2, 2), gain=1.0, bits=14, black_level=500)
    raw = electrons(simulate, 50.0)
    assert raw.shape == (128, 128)
    is_sample_of(raw, 500 + 200, 200 + 900 + 1 / 12)


def test_dark_current_is_binned_with_the_charge():
    simulate = simulator(noise=Noise(dark_current=100.0), binning=(2, 3), gain=1.0, bits=14)
    is_sample_of(electrons(simulate, 0.0, time=0.5), 300, 300 + 1 / 12)  # 6 pixels x 50 e-


def test_digital_binning_averages_numbers_and_keeps_the_levels():
    simulate = simulator(
        noise=Noise(read=6.0), binning=(2, 2), binning_mode="digital", gain=1.0, black_level=100
    )
    raw = electrons(simulate, 400.0)
    # each number has photon, read and rounding variance; the mean of four is rounded once more: to whole from quarters,
    # -1/4, 0, 1/4 and, to even, +-1/2 in equal parts, hence (2/16 + 1/4) / 4 = 3/32
    is_sample_of(raw, 500, (400 + 36 + 1 / 12) / 4 + 3 / 32)
    assert (
        simulate.readout.output.white_level == 4095 and simulate.readout.output.full_well == 10000
    )


def test_the_mean_is_binned_too():
    scene = chart("ramp", size=(48, 32))
    whole = simulator(MOSAICS["bayer-rggb"])(scene).mean.astype(np.float64)
    # neighbours of one colour are two apart: columns 0 and 2, 1 and 3, and so on
    pairs = whole.reshape(8, 2, 2, 12, 2, 2).transpose(0, 2, 3, 5, 1, 4)
    for mode, expected in (
        ("charge", pairs.sum(axis=(4, 5))),
        ("digital", pairs.mean(axis=(4, 5))),
    ):
        frame = simulator(MOSAICS["bayer-rggb"], binning=(2, 2), binning_mode=mode)(scene)
        np.testing.assert_allclose(
            frame.mean, expected.reshape(16, 24), rtol=4 * ULP
        )  # three additions, a division
        assert frame.raw.shape == frame.mean.shape and frame.linear.shape == (16, 24, 3)
        assert frame.camera.sensor.bayer_phase == (0, 0)


def test_quad_bayer_bins_to_bayer(tmp_path):
    scene = chart("colorchecker", size=(64, 48))
    frame = simulator(MOSAICS["quad-bayer"], binning=(2, 2))(scene)
    whole = simulator(MOSAICS["quad-bayer"])(scene)
    assert frame.camera.sensor.cfa == ("RG", "GB") and frame.camera.sensor.full_well == 40000
    sums = whole.mean.astype(np.float64).reshape(24, 2, 32, 2).sum(axis=(1, 3))
    np.testing.assert_allclose(frame.mean, sums, rtol=3 * ULP)
    # the gain follows the well, so white and grey look the same; half a DN of 4095 at grey levels above 3 %
    assert frame.linear.mean() == pytest.approx(whole.linear.mean(), rel=0.01)
    dng = Simulator(
        dataclasses.replace(camera(MOSAICS["quad-bayer"], binning=(2, 2)), processor=Processor()),
        device="opencl",
    )(scene)
    dng.save(tmp_path / "binned.dng")
    import rawpy

    with rawpy.imread(str(tmp_path / "binned.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, dng.raw)


# ------------------------------------------------------------------------------------------------- converter and gains


@pytest.mark.parametrize("bits", range(1, 17))
def test_bits(bits):
    """Every level of the converter is reached, a full well is the highest, and rounding is to the nearest."""
    simulate = simulator(bits=bits)
    mean = np.linspace(0, 12000, 512 * 256, dtype=np.float32).reshape(256, 512)
    raw = simulate.readout.draw_electrons(mean, 0.01)
    white = 2**bits - 1
    assert raw.max() == white and len(np.unique(raw)) == 2**bits
    # nearest: half a DN, and the rounding of gain, product and mean, 1.5 ulp of at most 65535
    assert (
        np.abs(raw - np.minimum(mean.astype(np.float64), 10000) * white / 10000).max()
        <= 0.5 + 65535 * 1.5 * ULP
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_without_a_converter_values_are_not_rounded(device):
    simulate = simulator(device=device, bits=32, gain=0.37, black_level=10, scaling="normalised")
    mean = np.linspace(0, 12000, 1000, dtype=np.float32).reshape(20, 50)
    raw = simulate.readout.draw_electrons(mean, 0.01)
    assert raw.dtype == np.float32
    np.testing.assert_array_equal(
        raw, np.float32(0.37) * np.minimum(mean, np.float32(10000)) + np.float32(10)
    )
    frame = simulate(chart("ramp", size=(64, 8)))
    assert frame.raw.dtype == np.float32 and frame.rgb.max() > 200


def test_gains_and_offset_by_hand():
    level = np.full((2, 2), 1000.0, np.float32)
    for changes, expected in (
        ({}, 410),  # 4095 / 10000 x 1000 = 409.5, to even
        ({"black_level": 95}, 495),  # 4000 / 10000 x 1000 + 95
        ({"gain": 0.25}, 250),
        ({"gain": 0.25, "analog_gain": 8.0}, 2000),
        ({"gain": 8.0}, 4095),
        ({"gain": 0.25, "analog_offset": 400.0}, 350),
        ({"gain": 0.25, "analog_offset": -2000.0}, 0),
        ({"conversion_gain": 40e-6, "adc_range": 1.0}, 164),  # 40 mV of 1 V: 0.04 x 4095 = 163.8
        ({"conversion_gain": 40e-6, "adc_range": 1.0, "analog_gain": 2.0}, 328),
    ):  # 327.6
        assert np.unique(simulator(**changes).readout.draw_electrons(level, 0.01)).tolist() == [
            expected
        ], changes


def test_dark_current_doubles_with_temperature():
    for temperature, rate in ((25.0, 400.0), (33.0, 800.0), (9.0, 100.0)):
        simulate = simulator(noise=Noise(dark_current=400.0, temperature=temperature), gain=1.0)
        is_sample_of(electrons(simulate, 0.0, time=0.5), rate / 2, rate / 2 + 1 / 12)


def test_hot_pixels_grow_with_time_and_temperature_and_are_the_same_in_every_frame():
    noise = Noise(photon="none", hot_pixels=0.1, hot_current=1000.0, seed=4)
    cold, warm = (
        simulator(noise=dataclasses.replace(noise, temperature=t), bits=32) for t in (25.0, 33.0)
    )
    first = electrons(cold, 0.0, time=0.1, first=0)
    np.testing.assert_array_equal(electrons(cold, 0.0, time=0.1, first=9, seed=5), first)
    np.testing.assert_allclose(electrons(warm, 0.0, time=0.1), 2 * first, rtol=ULP)
    np.testing.assert_allclose(electrons(cold, 0.0, time=0.3), 3 * first, rtol=2 * ULP)
    is_sample_of((first > 0).ravel(), 0.1, 0.09, fourth=(1 - 3 * 0.09) / 0.09)  # Bernoulli
    hot = first[first > 0]
    is_sample_of(hot, 100, 100**2, fourth=9)  # exponential


def test_reset_noise_of_a_capacitor_reaches_the_raw_values():
    noise = Noise(photon="none", reset=22.7442)  # kTC at 50 uV/e- and 27 deg C, see test_camera.py
    is_sample_of(
        electrons(simulator(noise=noise, gain=1.0, black_level=500), 0.0), 500, 22.7442**2 + 1 / 12
    )


def test_noise_off_is_the_mean_rounded():
    scene = chart("deadleaves", size=(64, 48))
    frame = simulator(MOSAICS["bayer-rggb"], black_level=64)(scene, seed=8)
    sensor = frame.camera.sensor
    wanted = np.rint(
        np.float32(sensor.gain_dn_per_electron) * np.minimum(frame.mean, np.float32(10000))
        + np.float32(64)
    )
    np.testing.assert_array_equal(frame.raw, np.minimum(wanted, 4095))


# ------------------------------------------------------------------------------------------- mean kept, exposure, EV


def counting(monkeypatch):
    """List that grows by one each time the optics is computed."""
    calls, planes = [], light.planes
    monkeypatch.setattr(light, "planes", lambda *given: calls.append(1) or planes(*given))
    return calls


def test_the_mean_is_computed_once(monkeypatch):
    calls = counting(monkeypatch)
    simulate = simulator(
        MOSAICS["bayer-rggb"], Noise(), optics=dataclasses.replace(OPTICS, model="diffraction")
    )
    scene = chart("flat", size=(24, 16))
    frames = list(simulate.frames(scene, 4))
    assert len(calls) == 1
    optics = [
        sum(stage.ms for stage in frame.report.stages if stage.stage.startswith("optics."))
        for frame in frames
    ]
    assert optics[0] > 0 and optics[1:] == [0, 0, 0]
    gs.burst(simulate, scene, 5)
    assert len(calls) == 2
    gs.bracket(simulate, scene, (-1, 0, 1))
    assert len(calls) == 3
    gs.read_nondestructively(simulate, scene, [0.001, 0.002, 0.003])
    assert len(calls) == 4


def test_lengthened_is_exposed_anew():
    scene = chart("deadleaves", size=(40, 32))
    noise = Noise(prnu=0.02, hot_pixels=0.01, hot_current=1e4)
    simulate = simulator(
        MOSAICS["rgbw"], noise, optics=dataclasses.replace(OPTICS, model="diffraction")
    )
    longer = gs.change_exposure_time(simulate, simulate.expose(scene, 0.01), 0.04)
    anew = simulate.expose(scene, 0.04)
    assert longer.exposure_time == anew.exposure_time == 0.04
    for name in ("mean", "chip_mean"):
        one, other = (
            np.asarray(simulate.device.numpy(getattr(e, name)), np.float64) for e in (longer, anew)
        )
        # a time, a factor and two products are rounded to float32, and the patterns' product and sum on either side
        np.testing.assert_allclose(one, other, rtol=4 * ULP)
    assert longer.rendering.display_from_camera == pytest.approx(
        anew.rendering.display_from_camera, rel=1e-12
    )


def test_bracket_has_times_numbers_and_frames_of_its_own():
    scene = chart("ramp", size=(64, 48))
    simulate = simulator(noise=Noise(read=2.0))
    frames = gs.bracket(simulate, scene, (-2, 0, 1.5), seed=3, first=7)
    assert [frame.exposure_time for frame in frames] == pytest.approx(
        [0.0025, 0.01, 0.01 * 2**1.5], rel=1e-15
    )
    assert [frame.report.frame for frame in frames] == [7, 8, 9]
    once = simulate.expose(scene)
    for number, frame in enumerate(frames):
        again = gs.change_exposure_time(simulate, once, frame.exposure_time).frame(
            seed=3, first=7 + number
        )
        np.testing.assert_array_equal(frame.raw, again.raw)
    # all are rendered alike: brighter by the exposure, so in equal display values but for noise and saturation
    ratio = frames[1].mean / frames[0].mean
    np.testing.assert_allclose(ratio, 4, rtol=2 * ULP)


def test_burst_has_the_exposure_of_its_first_frame():
    """Each frame is that of its scene, exposed for the time and gain that the first was metered for."""
    bright, dim = (chart("ramp", size=(40, 24), luminance=luminance) for luminance in (100.0, 30.0))
    for changes in ({}, {"binning": (2, 2), "binning_mode": "digital"}, {"bits": 32}):
        simulate = simulator(MOSAICS["bayer-rggb"], Noise(read=2.0), exposure_time=None, **changes)
        once = simulate.expose(bright)
        frames = gs.burst(simulate, iter([bright, dim]), 2, seed=2, first=5)
        assert len({frame.exposure_time for frame in frames}) == 1 and len({*map(id, frames)}) == 4
        for number, (frame, scene) in enumerate(
            zip(frames, (bright, bright, dim, dim), strict=True), 5
        ):
            again = simulate.expose(scene, once.exposure_time, once.gain).frame(
                seed=2, first=number
            )
            np.testing.assert_array_equal(frame.raw, again.raw)
        assert (frames[0].raw != frames[1].raw).mean() > 0.3
        # 0.3 of the light of the same ramp; float32 rates, times and products
        np.testing.assert_allclose(frames[2].mean, 0.3 * frames[0].mean, rtol=8 * ULP)
    with pytest.raises(GpusimError, match="burst: no scenes"):
        gs.burst(simulate, [])


@pytest.mark.parametrize(
    "changes", [{}, {"bits": 32}, {"binning": (2, 1), "binning_mode": "digital"}]
)
def test_average_is_the_mean_of_the_frames(changes):
    simulate = simulator(MOSAICS["bayer-rggb"], Noise(read=2.0), **changes)
    exposure = simulate.expose(chart("ramp", size=(40, 24)))
    frames = np.asarray(simulate.device.numpy(exposure.raw(seed=2, first=4, frames=9)), np.float64)
    mean = gs.average(simulate, exposure, 9, seed=2, first=4)
    np.testing.assert_allclose(mean, frames.mean(axis=0), rtol=1e-14)  # float64, nine additions
    for count in (0, -1, 2.5):
        with pytest.raises(OutOfRange, match="count of averaged frames"):
            gs.average(simulate, exposure, count)


def saturations(frame):
    return frame.mean.astype(np.float64) / 10000


@pytest.mark.parametrize(
    ("method", "level", "measured"),
    [
        ("full", 0.9, lambda x: x.max()),
        ("mean", 0.2, lambda x: x.mean()),
        ("percentile", 0.6, lambda x: np.percentile(x, 75)),
        (
            "centre",
            0.3,
            lambda x: (
                (
                    x
                    * np.exp(
                        -0.5
                        * sum(
                            (((i + 0.5) / n - 0.5) / 0.2) ** 2
                            for i, n in zip(np.ogrid[:48, :64], (48, 64), strict=True)
                        )
                    )
                ).sum()
                / np.exp(
                    -0.5
                    * sum(
                        (((i + 0.5) / n - 0.5) / 0.2) ** 2
                        for i, n in zip(np.ogrid[:48, :64], (48, 64), strict=True)
                    )
                ).sum()
            ),
        ),
    ],
)
def test_automatic_exposure_brings_its_measure_to_the_level(method, level, measured):
    scene = chart("deadleaves", size=(64, 48))
    simulate = simulator(
        MOSAICS["bayer-rggb"], exposure_time=None, auto_exposure=AutoExposure(method, level, 75.0)
    )
    frame = simulate(scene)
    # rates and means are float32: two ulp
    assert measured(saturations(frame)) == pytest.approx(level, rel=2 * ULP)
    assert frame.report.camera["exposure_time_s"] == frame.exposure_time


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize(("glints", "times"), [(1, 20), (1, 3), (2, 90)])
def test_glints_leave_the_pictures_exposure(glints, times, device):
    """In 10,000 pixels, 3 to 90 times as bright as white: at most 1.5 times the light of the rest (PLAIN) is counted.

    The phone's lens spreads each over few enough pixels. No more than the thousandth that may, and noise, clips.
    """
    plain = chart("deadleaves", size=(100, 100))
    bands = np.array(plain.content.bands_at(slice(None)), np.float32)
    bands[:, 50, 20 : 20 + 40 * glints : 40] = times
    glinting = dataclasses.replace(plain, content=Cube(plain.wavelengths, bands))
    simulate = Simulator(gs.open_camera("phone"), device=device)
    without, frame = simulate(plain), simulate(glinting)
    assert without.exposure_time / 1.5 < frame.exposure_time < 1.1 * without.exposure_time
    assert (frame.raw >= frame.camera.sensor.white_level).mean() <= 0.0015
    assert frame.rgb.mean() > 0.9 * without.rgb.mean()


def test_binned_pixels_are_exposed_for_their_own_well():
    frame = simulator(binning=(2, 2), exposure_time=None)(chart("flat", size=(32, 32)))
    assert frame.mean.max() == pytest.approx(0.95 * 40000, rel=4 * ULP)


def test_gain_is_raised_where_the_time_is_too_short():
    scene = chart("ramp", size=(64, 16))
    free = simulator(exposure_time=None)(scene)
    for most, gain in ((16.0, 4.0), (2.0, 2.0)):
        automatic = AutoExposure(longest=free.exposure_time / 4, most_gain=most)
        frame, normalised = (
            simulator(exposure_time=None, auto_exposure=automatic, scaling=scaling)(scene)
            for scaling in ("exposure", "normalised")
        )
        assert frame.exposure_time == free.exposure_time / 4
        assert frame.camera.sensor.analog_gain == pytest.approx(gain, rel=1e-12)
        assert frame.report.camera["analog_gain"] == frame.camera.sensor.analog_gain
        # 95 % of the converter, or of what the gain is short of it; half a DN
        assert abs(int(frame.raw.max()) - 0.95 * 4095 * gain / 4) <= 0.51
        # the picture is as dark as the gain falls short, within the rounding of the darker numbers, unless normalised:
        # the gain is not part of the scene
        assert frame.linear.max() == pytest.approx(free.linear.max() * gain / 4, rel=1e-3)
        assert normalised.linear.max() == pytest.approx(
            simulator(exposure_time=None, scaling="normalised")(scene).linear.max(), rel=1e-3
        )


def test_exposure_value_is_reported():
    frame = simulator(exposure_time=1 / 125)(chart("flat", size=(8, 8)))
    assert frame.report.camera["exposure_value"] == pytest.approx(
        10.965784284662087, rel=1e-14
    )  # log2(16 x 125)


# ------------------------------------------------------------------------------------------------ non-destructive reads

TIMES = np.array([0.01, 0.02, 0.05])


def reads_of(level, noise, **changes):
    """Reads of a flat field of `level` [e- s-1], in electrons."""
    simulate = simulator(noise=noise, **{"bits": 32, "black_level": 1000, "gain": 1.0} | changes)
    mean = simulate.device.array(np.full((256, 256), level * TIMES[-1], np.float32))
    reads = simulate.readout.nondestructive(mean, TIMES[-1], TIMES, seed=6)
    return reads.astype(np.float64) - simulate.camera.sensor.black_level


def test_reads_differ_by_the_photons_that_came_between():
    reads = reads_of(4e4, Noise())
    for increment, step in zip(
        np.diff(reads, axis=0, prepend=0), np.diff(TIMES, prepend=0), strict=True
    ):
        expected = 4e4 * step
        np.testing.assert_array_equal(
            increment, np.rint(increment)
        )  # whole photons, never taken back
        assert increment.min() >= 0
        is_sample_of(increment, expected, expected, fourth=3 + 1 / expected)
    steps = np.diff(reads, axis=0, prepend=0).reshape(3, -1)
    assert np.abs(np.corrcoef(steps)[np.triu_indices(3, 1)]).max() < Z / 256  # independent


def test_reset_noise_is_common_to_all_reads_and_read_noise_is_not():
    dark = reads_of(0.0, Noise(read=5.0, reset=20.0)).reshape(3, -1)
    for read in dark:
        is_sample_of(read, 0, 25 + 400)
    for one, other in ((0, 1), (1, 2), (0, 2)):
        is_sample_of(
            dark[other] - dark[one], 0, 50
        )  # correlated double sampling: the reset is gone
    common = np.cov(dark)[np.triu_indices(3, 1)]
    # of a covariance c of normal variables of variance v: sqrt((v^2 + c^2) / n)
    assert np.abs(common - 400).max() < Z * np.sqrt((425**2 + 400**2) / dark.shape[1])


def test_a_single_read_is_a_normal_frame():
    noise = Noise(read=5.0, reset=12.0, dark_current=1e4, row=0.0, prnu=0.01, dsnu=2.0)
    simulate = simulator(noise=noise, bits=14, gain=1.0, black_level=500)
    mean = simulate.device.array(np.full((256, 256), 1600, np.float32))
    read = simulate.readout.nondestructive(mean, 0.04, [0.04], seed=6)[0].astype(np.float64)
    frame = electrons(simulate, 1600.0, time=0.04, seed=7)
    variance = 1600 + 400 + 25 + 144 + 1 / 12 + (0.01 * 1600) ** 2 + 4
    for raw in (read, frame):
        is_sample_of(raw, 500 + 2000, variance)
    # the chip is the same one: patterns of response and offset are common to both
    pattern = np.cov(read.ravel(), frame.ravel())[0, 1]
    assert abs(pattern - (16.0**2 + 4)) < Z * np.sqrt((variance**2 + 260**2) / read.size)


def test_reads_saturate_at_the_well():
    reads = reads_of(4e5, Noise(), full_well=5000.0)
    assert reads[0].max() < 5000 and reads[0].mean() == pytest.approx(
        4000, rel=0.01
    )  # 64 e- rms in 65536 pixels
    assert (reads[1:] == 5000).all()


def test_reads_of_a_scene():
    simulate = simulator(noise=Noise())
    reads = gs.read_nondestructively(simulate, chart("flat", size=(64, 64)), TIMES)
    assert reads.shape == (3, 64, 64) and reads.dtype == np.uint16
    assert (np.diff(reads.astype(int), axis=0) >= 0).all()
    for times in ([], [0.0], [-1.0, 1.0], [0.2, 0.1], [0.1, 0.1], [np.nan], [0.1, np.inf], [[0.1]]):
        with pytest.raises(OutOfRange, match=r"exposure_time = |times of the reads = "):
            gs.read_nondestructively(simulate, chart("flat", size=(8, 8)), times)


def test_reads_are_binned_after_each_of_them():
    """Digital binning rounds the mean of the same pixels' own numbers; a mosaic of one channel has neighbours."""
    scene, how = chart("deadleaves", size=(16, 8)), {"noise": Noise(read=5.0), "bits": 14}
    single = gs.read_nondestructively(simulator(**how), scene, TIMES, seed=3)
    binned = gs.read_nondestructively(
        simulator(**how, binning=(2, 2), binning_mode="digital"), scene, TIMES, seed=3
    )
    means = single.reshape(len(TIMES), 4, 2, 8, 2).mean(axis=(2, 4))
    np.testing.assert_array_equal(binned, np.rint(means))


# ------------------------------------------------------------------------------------------------------ rolling shutter


def edge(column, shape=(20, 60)):
    """Dark left of `column`, bright from there on."""
    values = np.zeros((2, *shape), np.float32)
    values[:, :, column:] = 1
    return Scene(Cube(np.array([450.0, 650.0]), values), Spectrum([450, 650], [1e17, 1e17]), "edge")


def test_a_moving_edge_leans_by_its_speed_times_the_row_time():
    """2000 pixel/s to the right, rows 0.4 ms apart: each row sees it 0.8 pixel farther on than the one above.

    Pictures of whole steps of a pixel: the light of a row grows linearly between them, so its place is exact.
    """
    speed, row_time, exposure = 2000.0, 4e-4, 5e-3
    instants = np.arange(28) / speed  # 13.5 ms for 5 + 19 x 0.4 = 12.6 ms
    simulate = simulator(row_time=row_time, full_well=1e9)
    scenes = [edge(5 + step) for step in range(28)]
    moving = gs.expose_moving(simulate, scenes, instants, exposure)
    mean = np.asarray(simulate.device.numpy(moving.mean), np.float64)
    bright = mean[:, -1:]
    np.testing.assert_allclose(bright, bright[0, 0], rtol=28 * ULP)  # all rows are open as long
    place = 60 - (mean / bright).sum(axis=1)
    # the middle of each row's exposure; 28 float32 terms a pixel, 60 pixels
    np.testing.assert_allclose(
        place, 5 + speed * (np.arange(20) * row_time + exposure / 2), rtol=0, atol=60 * 28 * ULP
    )
    frame = moving.frame()
    assert "sensor.shutter" in {stage.stage for stage in frame.report.stages}


def test_a_scene_at_rest_is_exposed_as_always():
    scene = edge(17)
    simulate = simulator(row_time=3e-4)
    still = np.asarray(simulate.device.numpy(simulate.expose(scene, 0.004).mean), np.float64)
    for scenes, times in (([scene], [0.0]), ([scene] * 5, np.arange(5) * 2.5e-3)):
        mean = simulate.device.numpy(gs.expose_moving(simulate, scenes, times, 0.004).mean)
        np.testing.assert_allclose(mean, still, rtol=6 * ULP)  # five products and sums
    with pytest.raises(OutOfRange, match="times = "):
        gs.expose_moving(
            simulate, [scene] * 2, [0.0, 0.009], 0.004
        )  # the last row closes at 9.7 ms
    for scenes, times in (([], []), ([scene], [0.0, 1.0]), ([scene, edge(3, (8, 8))], [0.0, 1.0])):
        with pytest.raises(BadData, match="moving scene"):
            gs.expose_moving(simulate, scenes, times, 0.004)


# -------------------------------------------------------------------------------------------------------------- report


def test_the_report_names_what_is_on_and_nothing_that_is_off():
    scene = chart("flat", size=(16, 16))

    def stages(noise=QUIET, **changes):
        simulate = simulator(MOSAICS["bayer-rggb"], noise, device="numpy", **changes)
        found = {stage.stage: stage.model for stage in simulate(scene).report.stages}
        return {
            name: model
            for name, model in found.items()
            if name.startswith("sensor.") and name != "sensor.collect"
        }

    assert stages() == {"sensor.noise": "no noise; full well, 12 bit"}
    assert stages(bits=32) == {"sensor.noise": "no noise; full well, no converter"}
    for changes, stage, words in (
        ({"photon": "exact"}, "noise", "photon (exact)"),
        ({"read": 1.0}, "noise", "read"),
        ({"reset": 1.0}, "noise", "reset"),
        ({"adc": 1.0}, "noise", "converter"),
        ({"row": 1.0}, "noise", "rows"),
        ({"column": 1.0}, "noise", "columns"),
        ({"dark_current": 1.0}, "noise", "dark current"),
    ):
        found = stages(Noise(**{"photon": "none"} | changes))
        assert list(found) == [f"sensor.{stage}"] and words in found[f"sensor.{stage}"]
    for changes, words, more in (
        ({"prnu": 0.1}, "PRNU", {"sensor.chip"}),
        ({"dsnu": 1.0}, "DSNU", set()),
        ({"dead_pixels": 0.1}, "dead pixels", {"sensor.chip"}),
        ({"row_dsnu": 1.0}, "DSNU", set()),
        ({"hot_pixels": 0.1, "hot_current": 1.0}, "hot pixels", {"sensor.chip"}),
        ({"telegraph_pixels": 0.1, "telegraph": 1.0}, "traps", set()),
    ):
        found = stages(Noise(photon="none", seed=42, **changes))
        assert set(found) == {"sensor.pattern", "sensor.noise"} | more
        assert words in found["sensor.pattern"] and "chip 42" in found["sensor.pattern"]
    assert "2x1 pixels by digital" in stages(binning=(2, 1), binning_mode="digital")["sensor.bin"]


# ------------------------------------------------------------------------------------------------------- merge inputs


def bracket_of(noise, stops=(-3, -1, 1, 3), **changes):
    """Flat field of 2000 e- in the middle of the bracket, and a bracket of it."""
    simulate = simulator(noise=noise, **{"black_level": 200, "exposure_time": 0.01} | changes)
    flat = chart("flat", size=(128, 96))
    rate = simulate.device.numpy(simulate.expose(flat).mean).max() / 0.01
    simulate = simulator(
        noise=noise, **{"black_level": 200, "exposure_time": 2000 / float(rate)} | changes
    )
    return float(rate), gs.bracket(simulate, flat, stops, seed=9)


@pytest.mark.parametrize(
    "changes", [{}, {"bits": 32, "analog_offset": 30.0}, {"gain": 0.9, "bits": 14}]
)
def test_merged_rates_are_unbiased_and_as_good_as_theory(changes):
    noise = Noise(read=8.0, reset=3.0, row=1.0, column=1.0, dark_current=2e4)
    rate, frames = bracket_of(noise, **changes)
    inputs = merge_inputs(frames)
    assert inputs.rates.shape == inputs.variances.shape == inputs.valid.shape == (4, 96, 128)
    assert inputs.rates.dtype == inputs.variances.dtype == np.float64
    # 16000 e- in the longest are beyond the well of 10000 (or of its numbers); the others far below
    assert not inputs.valid[3].any() and inputs.valid[:3].all()
    rounding = (
        0
        if changes.get("bits") == 32
        else 1 / 12 / frames[0].camera.sensor.gain_dn_per_electron ** 2
    )
    theory = []
    for values, variance, frame in zip(
        inputs.rates[:3], inputs.variances[:3], frames, strict=False
    ):
        t = frame.exposure_time
        theory.append((rate * t + 2e4 * t + 64 + 9 + 1 + 1 + rounding) / t**2)
        # the light's part is taken from the values, three frames of 1 + 4 + 16 parts: below 2 % each, 0.02 % on average
        assert variance.mean() == pytest.approx(theory[-1], rel=1e-3)
        # of 12288 pixels; rows and columns share 2 e-^2 of 300 and more: they add at most sqrt(12288 / 96 / 150)
        assert np.var(values) == pytest.approx(theory[-1], rel=Z * np.sqrt(2 / values.size))
    weights = inputs.valid / inputs.variances
    merged = (weights * inputs.rates).sum(axis=0) / weights.sum(axis=0)
    best = 1 / np.sum(1 / np.array(theory))
    assert np.var(merged) == pytest.approx(best, rel=Z * np.sqrt(2 / merged.size))
    # rows and columns of a frame have 1 e-^2 each in common, which 96 and 128 lines leave in the mean
    lines = (
        1
        / np.sum(np.array([frame.exposure_time for frame in frames[:3]]) ** 2)
        * (1 / 96 + 1 / 128)
    )
    assert abs(merged.mean() - rate) < Z * np.sqrt(best / merged.size + lines)


def test_own_variances_would_bias_what_merge_inputs_does_not():
    """Ten frames of 100 e-: weights by each value's own variance lose 1 e-, equal ones nothing."""
    simulate = simulator(noise=Noise(), gain=1.0)
    raws = simulate.readout.draw_electrons(np.full((96, 128), 100, np.float32), 0.01, frames=10)
    frames = [SimpleNamespace(camera=simulate.camera, exposure_time=0.01, raw=raw) for raw in raws]
    inputs = merge_inputs(frames)
    weights = 1 / inputs.variances
    error = 0.01 * ((weights * inputs.rates).sum(axis=0) / weights.sum(axis=0)).mean() - 100
    sigma = np.sqrt(100 / raws.size)
    assert abs(error) < Z * sigma
    own = 10 / (1 / np.maximum(raws, 1)).sum(axis=0)
    assert own.mean() - 100 < -Z * sigma


def test_saturated_values_are_masked():
    for changes in (
        {},
        {"bits": 32},
        {"gain": 4.0},
        {"gain": 0.1},
    ):  # the converter saturates first, and the well
        simulate = simulator(noise=Noise(read=10.0), **changes)
        sensor = simulate.camera.sensor
        mean = np.repeat(
            np.float32([0.5, 0.8, 1.2, 3.0])[:, None] * np.float32(sensor.saturation), 4000, axis=1
        )
        raw = simulate.readout.draw_electrons(mean, 1.0)
        frame = SimpleNamespace(camera=simulate.camera, exposure_time=1.0, raw=raw)
        valid = merge_inputs([frame]).valid[0]
        assert valid[:2].all()
        # 5 standard deviations of a read below the well: 3e-7 of 8000 values
        assert not valid[2:].any()


def test_merge_inputs_refuses():
    simulate = simulator()
    good = SimpleNamespace(
        camera=simulate.camera, exposure_time=0.01, raw=np.ones((4, 6), np.uint16)
    )

    def but(**changes):
        return [good, SimpleNamespace(**vars(good) | changes)]

    for frames, error, words in (
        ([], BadData, "no frames"),
        (but(exposure_time=0.0), OutOfRange, "exposure_time of frame 1 = 0.0 s"),
        (but(exposure_time=np.nan), OutOfRange, "exposure_time"),
        (but(raw=np.ones((4, 5))), BadData, r"\(4, 5\)"),
        (but(raw=np.full((4, 6), np.nan)), BadData, "frame 1 has NaN"),
    ):
        with pytest.raises(error, match=words) as caught:
            merge_inputs(frames)
        assert "\n" not in str(caught.value)
    with pytest.raises(OutOfRange, match="averaged = 0"):
        merge_inputs([good], averaged=0)


# ---------------------------------------------------------------------------------------------------- files, bad input


@pytest.mark.parametrize(
    ("changes", "shape", "kind"),
    [
        ({"stacked": True}, (3, 16, 24), np.uint16),
        ({"bits": 32}, (16, 24), np.float32),
        ({}, (16, 24), np.uint16),
    ],
)
def test_npz_holds_whatever_there_is(tmp_path, changes, shape, kind):
    frame = simulator(MOSAICS["x-trans"], Noise(), **changes)(chart("flat", size=(24, 16)))
    frame.save(tmp_path / "a.npz")
    stored = np.load(tmp_path / "a.npz")
    assert stored["dn"].dtype == kind and stored["dn"].shape == stored["electrons"].shape == shape
    np.testing.assert_array_equal(stored["dn"], frame.raw)
    assert stored["channels"].tolist() == ["R", "G", "B"]
    assert changes.get("stacked") or stored["cfa"].tolist() == list(MOSAICS["x-trans"])
    with pytest.raises(OutOfRange, match=r"bits of a \.png output = 32: allowed is 8 or 16"):
        frame.save(tmp_path / "a.png", bits=32)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 1e39])
@pytest.mark.filterwarnings("ignore:overflow")
def test_electrons_that_cannot_be_drawn_are_refused(value):
    mean = np.full((6, 8), 10.0)
    mean[2, 5] = value
    with pytest.raises(
        OutOfRange, match=r"mean electrons at \(2, 5\) = (nan|inf|-inf|-1) e-: allowed is 0 <= elec"
    ) as caught:
        simulator().readout.draw_electrons(mean, 0.01)
    assert "1 of 48 pixels" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("time", [0, 0.0, -1.0, np.nan, np.inf])
def test_exposures_of_zero_or_less_are_refused_before_any_work(monkeypatch, time):
    calls = counting(monkeypatch)
    scene, simulate = chart("flat", size=(8, 8)), simulator()
    for expose in (
        lambda: simulate.expose(scene, time),
        lambda: gs.expose_moving(simulate, [scene], [0.0], time),
        lambda: simulate.readout.draw_electrons(np.ones((4, 4)), time),
    ):
        with pytest.raises(OutOfRange, match=r"exposure_time = .*allowed is 0 < exposure_time"):
            expose()
    assert not calls
    with pytest.raises(OutOfRange, match="exposure_time"):
        gs.change_exposure_time(simulate, simulate.expose(scene), time)


def test_other_shapes_and_stops_are_refused():
    for mean in (np.ones(4), np.ones((0, 4)), np.ones((2, 2, 2, 2))):
        with pytest.raises(BadData, match="mean electrons: shape"):
            simulator().readout.draw_electrons(mean, 0.01)
    for stops in ([np.nan], [0, np.inf], [-2000], [[1, 2]]):
        with pytest.raises(OutOfRange, match="stops of a bracket"):
            gs.bracket(simulator(), chart("flat", size=(8, 8)), stops)


def test_a_frame_smaller_than_a_binned_pixel_is_refused():
    with pytest.raises(GpusimError, match="one block of binning"):
        simulator(MOSAICS["bayer-rggb"], binning=(8, 8))(chart("flat", size=(15, 40)))


# ------------------------------------------------------------------------------------------------- extremes and kinds


@pytest.mark.parametrize("device", ALL_KINDS)
def test_any_overexposure_is_white(device):
    hot = Noise(
        hot_pixels=0.5,
        hot_current=1e12,
        dark_current=1e12,
        temperature=85,
        reference_temperature=25,
        doubling=1.0,
    )
    simulate = Simulator(camera(noise=hot), device=device)
    assert (simulate.readout.draw_electrons(np.full((5, 7), 1.0), 1e12) == 4095).all()
    (frame,) = gs.bracket(
        simulator(device=device), chart("flat", size=(7, 5)), (46,)
    )  # 0.01 s 2^46 = 7e11 s
    assert (frame.raw == 4095).all()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_whole_numbers_of_any_kind_name_the_noise(device):
    simulate = Simulator(camera(noise=Noise(read=3.0)), device=device)
    mean = np.full((5, 7), 100.0)
    for kind, value in ((np.int32, 3), (np.uint32, 2**32 - 2), (np.uint64, 2**32 - 1)):
        plain, same = (
            simulate.readout.draw_electrons(mean, 0.01, seed=number, first=number)
            for number in (value, kind(value))
        )
        np.testing.assert_array_equal(same, plain)
    for wrong in (
        {"seed": -1},
        {"seed": 1.5},
        {"first": 2**32},
        {"frames": 0},
        {"frames": -1},
        {"frames": 70000},
    ):
        with pytest.raises(OutOfRange, match=f"{next(iter(wrong)).replace('first', 'frame')} = "):
            simulate.readout.draw_electrons(mean, 0.01, **wrong)


def test_what_was_metered_can_be_kept():
    dim = AutoExposure(longest=1e-4, most_gain=16.0)
    simulate = simulator(exposure_time=None, auto_exposure=dim, noise=Noise(read=3.0))
    scene = chart("ramp", size=(32, 16))
    first = simulate.expose(scene)
    assert first.gain > 1
    again = simulate.expose(scene, first.exposure_time, first.gain)
    np.testing.assert_array_equal(
        *(np.array(simulate.device.numpy(one.raw())) for one in (first, again))
    )
    mean = np.array(simulate.device.numpy(first.mean))
    np.testing.assert_array_equal(
        simulate.readout.draw_electrons(mean, first.exposure_time, gain=first.gain),
        np.array(simulate.device.numpy(first.raw())),
    )
    for gain in (0.0, -1.0, np.nan):
        with pytest.raises(OutOfRange, match="gain"):
            simulate.expose(scene, 1e-4, gain)


def test_automatic_exposure_counts_the_dark_current():
    simulate = simulator(exposure_time=None, noise=Noise(photon="none", dark_current=1e6))
    exposure = simulate.expose(chart("ramp", size=(32, 16)))
    brightest = float(np.max(simulate.device.numpy(exposure.mean))) + 1e6 * exposure.exposure_time
    assert brightest == pytest.approx(
        0.95 * 10000, rel=1e-6
    )  # float32 rates and means: a few roundings of 2^-24


def test_an_analog_offset_is_black_in_the_picture():
    scene = chart("ramp", size=(32, 16))
    # normalised: the offset takes 500 e- of the range, and so of what the camera's exposure makes white
    plain, raised = (
        simulator(analog_offset=offset, scaling="normalised")(scene) for offset in (0.0, 500.0)
    )
    assert raised.raw.astype(int).min() - plain.raw.astype(int).min() >= 200  # 500 e- are 204.75 DN
    # either picture is rounded by half a DN; a DN of raw is `step` of the picture, in float32
    step = np.ptp(plain.linear) / np.ptp(plain.raw.astype(float))
    assert np.abs(raised.linear - plain.linear).max() <= 1.001 * step


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        ({"hot_pixels": 0.1}, "hot_current"),
        ({"telegraph_pixels": 0.1}, "noise.telegraph"),
        ({"temperature": 1000.0, "doubling": 0.1}, "doubling"),
        ({"read": "a"}, "noise.read"),
        ({"read": None}, "noise.read"),
        ({"photon": 1}, "photon"),
    ],
)
def test_noise_that_cannot_be_is_refused(noise, text):
    with pytest.raises(GpusimError, match=text):
        Noise(**noise)


@pytest.mark.parametrize(
    ("sensor", "text"),
    [
        ({"full_well": "a"}, "full_well"),
        ({"binning": 2}, "binning"),
        ({"offset": 1}, "offset"),
        ({"photodetector": 0.5}, "photodetector"),
        ({"vignetting": [[1, 1], [1]]}, "vignetting"),
        ({"vignetting": [[2, 2], [2, 2]]}, "vignetting"),
        ({"binning_mode": 3}, "binning_mode"),
        ({"qe": None}, "qe"),
        ({"noise": None}, "noise"),
        ({"auto_exposure": "mean"}, "auto_exposure"),
        ({"bits": 8, "black_level": 200}, "black level"),
    ],
)
def test_sensors_that_cannot_be_are_refused(sensor, text):
    with pytest.raises(GpusimError, match=text):
        camera(**sensor)


def test_layers_must_be_those_of_the_sensor():
    stacked = simulator(("RGB",), stacked=True)
    assert stacked.readout.draw_electrons(np.full((3, 4, 5), 9.0), 0.01).shape == (3, 4, 5)
    assert stacked.readout.draw_electrons(np.full((3, 4, 5), 9.0), 0.01, frames=2).shape == (
        2,
        3,
        4,
        5,
    )
    for simulate, shape in ((stacked, (4, 5)), (stacked, (2, 4, 5)), (simulator(), (3, 4, 5))):
        with pytest.raises(BadData, match="shape"):
            simulate.readout.draw_electrons(np.full(shape, 9.0), 0.01)
