"""Dual pixels through frames: the diodes' sum, disparity over the field, noise, phase-detection pixels, autofocus."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.errors import Conflict

DUAL = {"sensor.dual": {"split": "left-right"}}
PHONE = gs.open_camera("phone").with_(exposure_time_ms=8, defocus_um=5, **DUAL)
SCENE = gs.chart("deadleaves", size=(48, 32), seed=3)
FAST = "opencl:0"
DEPTH = np.where(np.arange(48) < 24, 0.3, 2.0).astype(np.float32) * np.ones((32, 1), np.float32)
CASES = {
    "uniform": (PHONE, SCENE),
    "quad": (PHONE.with_(dual=gs.DualPixels("quad", crosstalk=0.05)), SCENE),
    "stacked": (PHONE.with_(stacked=True), SCENE),
    "finer samples": (PHONE, replace(SCENE, samples_per_pixel=2.0)),
    "no blur": (PHONE.with_(model="none"), SCENE),
    "misaligned": (PHONE.with_(dual=gs.DualPixels(misalignment=0.05)), SCENE),
    "field": (PHONE.with_(seidel_waves=[0.2, 0.3, 0, 0, 0]), SCENE),
    "distortion": (
        PHONE.with_(distortion={"k1": 0.0, "k2": -0.02, "radius_mm": 0.06}),
        SCENE,
    ),
    "depth": (PHONE.with_(object_distance_m=0.6, defocus_um=0), replace(SCENE, depth=DEPTH)),
}
QUICK = ("quad", "no blur")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES]
)
def test_diodes_add_up_to_the_frame(name):
    """Differences in float32 round to 6e-8 of a pixel's largest value."""
    camera, scene = CASES[name]
    exposure = gs.Simulator(camera, device=FAST).expose(scene)
    found, whole = (
        np.asarray(exposure.device.numpy(one)) for one in (exposure.diodes, exposure.mean)
    )
    assert found.shape == (len(camera.sensor.dual.diodes), *whole.shape)
    assert np.abs(found.sum(axis=0) - whole).max() <= 1e-6 * whole.max() and found.min() >= 0
    share = found.reshape(len(found), -1).mean(axis=1) / whole.mean()
    # the frame is symmetric about the axis, its scene is not
    assert share == pytest.approx(1 / len(found), abs=0.02)


def stars(places, shape, samples=2.0):
    """Points of light on a dark ground, two samples to a pixel: finer than the light's waves."""
    rows, cols = (int(samples * n) for n in shape)
    light = np.zeros((rows, cols, 1), np.float32)
    for y, x in places:
        light[y, x] = 1
    cube = np.repeat(light, 2, axis=2)
    return gs.scene_from(
        cube, [549.0, 551.0], light="D65", luminance=1e3, samples_per_pixel=samples, border="zero"
    )


@pytest.mark.parametrize(
    "dual",
    [
        gs.DualPixels(),
        gs.DualPixels(misalignment=0.06, crosstalk=0.05),
        gs.DualPixels(misalignment=-0.04, crosstalk=0.15),
        gs.DualPixels(misalignment=0.1, transition=0.1),
    ],
    ids=["aligned", "misaligned", "misaligned inward", "wide border"],
)
@pytest.mark.slow
def test_disparity_is_linear_in_defocus_over_the_field(dual):
    """Centroids of points' images in both halves, less in focus, over the sensor's displacement.

    Light beyond r pixels falls as r^-4 and leaves 1 / r of a centroid: two windows give the rest. They are smooth:
    a sharp one adds the light at its edge times the difference of the shares there, 1 % if borders move over the field.
    Shares within a point's image then differ, too: by 0.0035 a pixel for 0.06 rad, which displaces the two centroids by
    this times the image's variance, 0.06 pixel at the largest defocus, on both sides of the focus alike.
    """
    shape, places = (96, 144), [(60, 228), (130, 60), (95, 150)]
    scene = stars(places, shape)
    base = gs.open_camera("mono").with_(
        pixel_pitch_um=2.0, f_number=2.0, focal_length_mm=5.0, exposure_time_ms=5, dual=dual
    )
    found = []
    moves = (-24.0, -12.0, 12.0, 24.0)
    bent = abs(dual.misalignment)  # [pixel], see above
    for moved in moves:
        exposure = gs.Simulator(base.with_(defocus_um=moved), device=FAST).expose(scene)
        pictures = np.asarray(exposure.device.numpy(exposure.diodes), np.float64)
        found.append([_apart(pictures, y // 2, x // 2) for y, x in places])
    found = np.array(found)
    corner = np.hypot(*shape) / 2
    for number, (y, x) in enumerate(places):
        place = ((y / 2 - shape[0] / 2) / corner, (x / 2 - shape[1] / 2) / corner)
        slope = gs.disparity_slope(base, place, shape=shape) * 1e-6
        fit = np.polyfit(moves, found[:, number], 1)
        assert fit[0] == pytest.approx(slope, rel=0.01), place
        assert (
            np.abs(np.polyval(fit, moves) - found[:, number]).max() < 0.01 * abs(slope) * 24 + bent
        )


@pytest.mark.parametrize("samples", [1.0, 2.0])
def test_in_focus_both_pictures_are_the_same(samples):
    """The field of a lens in focus is real. Kernels end 12 lambda N beyond the rays: their light is equal too."""
    camera = gs.open_camera("mono").with_(
        pixel_pitch_um=2.0, f_number=2.0, exposure_time_ms=5, dual=gs.DualPixels()
    )
    scene = stars([(15, 40)], (32, 48), samples)
    exposure = gs.Simulator(camera, device=FAST).expose(scene)
    left, right = np.asarray(exposure.device.numpy(exposure.diodes))
    assert np.abs(left - right).max() < 1e-4 * left.max()


def _apart(pictures, row, col):
    """Distance of the centroids of both pictures of a point [pixel]."""
    sums = []
    for reach in (11, 22):
        at = np.arange(-reach, reach + 1)
        part = pictures[:, row - reach : row + reach + 1, col - reach : col + reach + 1]
        slope = np.clip(2 - 2 * np.hypot(at[:, None], at) / reach, 0, 1)  # flat up to half of it
        part = part * np.sin(np.pi / 2 * slope) ** 2
        centres = [(one.sum(axis=0) @ at) / one.sum() for one in part]
        sums.append(reach * (centres[1] - centres[0]))
    return (sums[1] - sums[0]) / 11


def test_each_diode_is_read_with_its_own_noise():
    """Variances within 5 standard errors, sqrt(2 / n) of 6144 pixels: 9 %; correlation within 5 / sqrt(n)."""
    camera = PHONE.with_(prnu=0, dsnu_e=0, model="none", exposure_time_ms=4, read_e=3.0)
    exposure = gs.Simulator(camera, device=FAST).expose(gs.chart("flat", size=(96, 64)))
    means = np.asarray(exposure.device.numpy(exposure.diodes), np.float64)
    raw = np.asarray(exposure.device.numpy(exposure.raw_dual(seed=4)), np.float64)
    again = exposure.device.numpy(exposure.raw_dual(seed=4, frames=2))
    assert raw.shape == (2, 64, 96) and np.array_equal(again[0], raw)
    sensor = exposure.camera.sensor
    noise = (raw - sensor.dark_level) / sensor.gain_dn_per_electron - means
    variance = (
        means.mean(axis=(1, 2)) + sensor.read_sigma**2 + 1 / 12 / sensor.gain_dn_per_electron**2
    )
    assert noise.var(axis=(1, 2)) == pytest.approx(variance, rel=0.09)
    whole = np.asarray(exposure.device.numpy(exposure.raw(seed=4)), np.float64)
    for one, other in ((raw[0], raw[1]), (raw[0], whole)):
        assert abs(_correlation(one, other, means[0])) < 5 / np.sqrt(6144)


def _correlation(one, other, mean):
    """Correlation of noise within one colour of the mosaic."""
    found = [
        np.corrcoef((one / mean)[y::2, x::2].ravel(), (other / mean)[y::2, x::2].ravel())[0, 1]
        for y in (0, 1)
        for x in (0, 1)
    ]
    return np.mean(found)


@pytest.mark.slow
def test_a_loop_makes_the_same_diodes():
    simulator = gs.Simulator(PHONE, device=FAST)
    loop = simulator.loop(SCENE)
    exposure = simulator.expose(SCENE)
    for camera in (PHONE, PHONE.with_(defocus_um=-4), PHONE):
        exposure = gs.Simulator(camera, device=FAST).expose(SCENE)
        raw = loop.update(camera=camera).raw_dual(seed=2)
        np.testing.assert_array_equal(
            simulator.device.numpy(raw), exposure.device.numpy(exposure.raw_dual(seed=2))
        )


PLACES = {"sparse": "masked", "cell": [8, 8], "places": [[1, 2, "left"], [5, 6, "right"]]}


def test_phase_detection_pixels_see_half_and_are_replaced():
    camera = PHONE.with_(**{"sensor.dual": PLACES})
    frame = gs.Simulator(camera, device=FAST)(SCENE, seed=1)
    exposure = gs.Simulator(PHONE, device=FAST).expose(SCENE)
    halves, whole = (
        np.asarray(exposure.device.numpy(one)) for one in (exposure.diodes, exposure.mean)
    )
    expected = whole.copy()
    for (row, col), half in (((1, 2), 0), ((5, 6), 1)):
        expected[row::8, col::8] = halves[half][row::8, col::8]
    np.testing.assert_allclose(frame.mean, expected, rtol=1e-5)  # sums in float32
    quiet, flat = (
        {"photon": "none", "read_e": 0, "prnu": 0, "dsnu_e": 0},
        gs.chart("flat", size=(48, 32)),
    )
    shown, plain = (
        gs.Simulator(one.with_(**quiet), device=FAST)(flat).linear
        for one in (camera, PHONE.with_(dual=None))
    )
    # a pixel whose half of the light was shown would be off by half; rounding to digital numbers is a percent
    assert np.abs(shown / plain - 1).max() < 0.03


@pytest.mark.slow
def test_a_shared_microlens_collects_the_light_of_two_pixels():
    places = {"sparse": "shared", "cell": [8, 8], "places": [[1, 2, "left"], [1, 3, "right"]]}
    camera = PHONE.with_(model="diffraction", **{"sensor.dual": places})
    flat = gs.chart("flat", size=(48, 32))
    shared, plain = (gs.Simulator(one, device=FAST).expose(flat) for one in (camera, PHONE))
    ratio = np.asarray(shared.device.numpy(shared.mean)) / np.asarray(
        plain.device.numpy(plain.mean)
    )
    # half of the light of twice the area; channels of a pixel are its own letter's
    assert ratio[1::8, 2:4] == pytest.approx(1.0, abs=0.01)


def test_what_does_not_fit_is_refused_in_a_line():
    sparse = gs.Simulator(PHONE.with_(**{"sensor.dual": PLACES}), device=FAST)
    plain = gs.Simulator(PHONE.with_(dual=None), device=FAST)
    for use in (
        lambda: sparse.loop(SCENE),
        lambda: sparse.batch(2),
        lambda: sparse.stream([SCENE]),
        lambda: plain.expose(SCENE).raw_dual(),
        lambda: plain.loop(SCENE).raw_dual(),
        lambda: sparse.expose(SCENE).diodes,
        lambda: gs.phase_focus(plain, SCENE),
        lambda: PHONE.with_(binning=[2, 2], **{"sensor.dual": PLACES}),
    ):
        with pytest.raises(Conflict) as refused:
            use()
        assert "\n" not in str(refused.value)


def texture(random, kind, shape):
    """Textures with powers of f^-2 and f^-3, and of two values."""
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1]))
    f[0, 0] = 1
    size = (1 / f, f**-1.5, 1 / np.sqrt(f**2 + 0.05**2))[kind]
    found = np.fft.ifft2(np.fft.fft2(random.normal(size=shape)) * size).real
    found = 1 + 0.25 * found / found.std()
    return np.clip(np.where(found > 1, 1.4, 0.6) if kind == 2 else found, 0.05, None)


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_phase_autofocus_lands_within_the_depth_of_focus(count):
    """In one step, for 95 % of scenes: three textures, 20 to 200 electrons, 1 to 10 depths of focus on both sides.

    Of 60 scenes that is 95 % within two standard errors of 2.8 %.
    """
    base = gs.open_camera("mono").with_(
        pixel_pitch_um=2.0,
        f_number=2.0,
        focal_length_mm=5.0,
        full_well_e=8000,
        read_e=2.0,
        dsnu_e=0.5,
        object_distance_m=1.5,
        **DUAL,
    )
    per_diopter = base.optics.displacement(1.0)
    rate, depth, landed = None, 0.0, []
    for number in range(count):
        random = np.random.default_rng(number)
        surface = texture(random, number % 3, (480, 720)).astype(np.float32)
        cube = np.repeat(surface[:, :, None], 4, axis=2)
        scene = gs.scene_from(
            cube, [420.0, 500, 580, 660], light="D65", luminance=100.0, samples_per_pixel=2
        )
        level, sign = random.choice([20, 50, 200]), random.choice([-1, 1])
        simulator = gs.Simulator(base.with_(exposure_time_ms=10), device=FAST)
        if rate is None:
            mean = simulator.device.numpy(simulator.expose(scene).mean)
            rate = mean.mean() / surface.mean() / 10  # [e-/ms]
            depth = gs.phase_focus(simulator, scene).depth_of_focus
        defocus = random.uniform(1, 10) * sign * depth
        camera = base.with_(
            exposure_time_ms=float(level / rate), defocus_um=defocus * per_diopter * 1e6
        )
        whole = slice(0, 240), slice(0, 360)
        found = gs.phase_focus(gs.Simulator(camera, device=FAST), scene, region=whole, seed=number)
        landed.append(abs(found.defocus - defocus) <= depth)
    assert np.mean(landed) >= 0.95 - 2 * 0.028
