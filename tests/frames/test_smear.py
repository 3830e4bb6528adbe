"""Long paths during an exposure: against means over 64 times as many instants of a scene in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS

import gpusim as gs
from gpusim.backends import open_device
from gpusim.captures.capture import Light
from gpusim.captures.reads import Reads
from gpusim.captures.smear import Path, convolve
from gpusim.domain.account import SAFETY, Bound
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.scene import Scene
from gpusim.pipeline.planning import probes_for

SHAPE, MARGIN, SECONDS, START = (24, 36), 280, 0.01, 0.002
# amplitude, cycles per sample along rows and columns, phase: of two wavelengths each
WAVES = ((0.35, 0.011, 0.023, 0.3), (0.3, -0.03, 0.008, 1.1), (0.2, 0.05, -0.06, 2.0))
WAVELENGTHS = np.array([520.0, 560.0, 600.0])
COLOR = np.array([1.0, 0.7, 0.4])
LIGHT = gs.chart("flat").illuminant


def camera(row_time):
    return replace(PHONE, sensor=replace(PHONE.sensor, row_time=row_time))


def places():
    """Samples of the scene with its margin, relative to the middle."""
    return np.meshgrid(
        *(np.arange(n + 2 * MARGIN) - (n - 1) / 2 - MARGIN for n in SHAPE), indexing="ij"
    )


def light(y, x):
    """The scene in closed form, 0 .. 2."""
    return 1 + sum(a * np.cos(2 * np.pi * (f * y + g * x) + p) for a, f, g, p in WAVES)


def scene_of(values, margin=MARGIN):
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    return Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border="scene", margin=margin)


def truth(simulator, motion, row_time, flicker=None, count=4096, margin=80):
    """Mean electrons: of each row an own scene, the mean over its exposure.

    The margin is as wide as the lens reaches. A wave's mean over a translation is the mean of its phases at `count`
    instants; of other views each instant is evaluated.
    """
    y, x = (
        part[MARGIN - margin : -(MARGIN - margin), MARGIN - margin : -(MARGIN - margin)]
        for part in places()
    )
    parts, shares = (np.arange(count) + 0.5) / count, np.full(count, 1 / count)
    if (
        motion.roll or motion.shake
    ):  # 48 points of Gauss for up to four cycles of a wave: exact to 1e-12
        parts, shares = np.polynomial.legendre.leggauss(48)
        parts, shares = (parts + 1) / 2, shares / 2
    rows = []
    for row in range(SHAPE[0]):
        opened = START + row * row_time
        times = opened + parts * SECONDS
        weights = np.ones(len(parts))
        if flicker is not None:
            weights = 1 + flicker.depth * np.cos(
                2 * np.pi * (flicker.frequency * times + flicker.phase)
            )
        weights = weights * shares
        views = [motion.at(time) for time in times]
        if len({(view.zoom, view.rotation) for view in views}) == 1:
            shifts = np.array([view.shift for view in views])
            total = np.full(y.shape, weights.sum())
            for a, f, g, p in WAVES:
                turned = (weights * np.exp(2j * np.pi * shifts @ (f, g))).sum()
                total += a * (turned * np.exp(1j * (2 * np.pi * (f * y + g * x) + p))).real
        else:
            total = sum(
                w * light(*view.place(y, x)) for w, view in zip(weights, views, strict=True)
            )
        rows.append(np.asarray(simulator.expose(scene_of(total, margin), SECONDS).mean)[row])
    return np.array(rows, np.float64)


def check(exposure, expected):
    """The error stays below what is stated. Returns it."""
    error = np.asarray(exposure.mean, np.float64) - expected
    rms = np.sqrt(np.mean(error**2) / np.mean(expected**2))
    bounds = exposure.plan.account.bounds
    # 2e-5: float32 transforms of both frames, and the light from beyond the truth's margin
    assert rms < bounds["shutter"].rms + bounds["view"].rms + 2e-5, (rms, bounds)
    return rms


@pytest.mark.parametrize("device", KINDS)
def test_two_hundred_pixels_in_an_exposure(device):
    """A pan of 200 pixels is one picture, behind a global shutter without error."""
    motion = gs.Motion(pan=(6000, -19000))  # 199 samples in 10 ms
    simulator = gs.Simulator(camera(0.0), device=device)
    exposure = gs.expose_motion(simulator, scene_of(light(*places())), motion, SECONDS, START)
    assert "199 samples: one transfer function" in exposure.plan.models["sensor.shutter"]
    assert exposure.plan.account.bounds["shutter"].rms < 1e-6
    check(exposure, truth(simulator, motion, 0.0))


CASES = {
    "pan": (gs.Motion(pan=(1500, 4000)), None, "one transfer function"),
    "flicker": (gs.Motion(pan=(0, 6000)), gs.Flicker(100, 0.9, phase=0.2), None),
    "shake": (gs.Motion(shake=60, seed=4), None, None),
    "turn": (gs.Motion(pan=(0, 3000), roll=8.0), None, "views"),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("row_time", [0.0, 4e-5])
def test_a_smear_errs_no_more_than_it_says(case, row_time):
    motion, flicker, words = CASES[case]
    simulator = gs.Simulator(camera(row_time), device="opencl:0")
    scene = scene_of(light(*places()))
    exposure = gs.expose_motion(simulator, scene, motion, SECONDS, START, flicker=flicker)
    found = exposure.plan.models["sensor.shutter"]
    assert words is None or words in found
    check(exposure, truth(simulator, motion, row_time, flicker))
    assert exposure.plan.account.bounds["shutter"].rms < 0.02


def test_rows_of_a_distorted_picture_see_their_own_time():
    """The lens moves the picture by rows, which open at other times than the smear takes: said, and no more."""
    motion, own = gs.Motion(pan=(0, 6000)), camera(4e-5)
    # 3 % at the corner of the frame: half a row of this small one, 0.12 samples of the path
    lens = RadialPolynomial(0.03, 0.0, 0.5 * np.hypot(*SHAPE) * own.sensor.pixel_pitch)
    own = replace(own, optics=replace(own.optics, distortion=lens))
    simulator = gs.Simulator(own, device="opencl:0")
    exposure = gs.expose_motion(simulator, scene_of(light(*places())), motion, SECONDS, START)
    assert "one transfer function" in exposure.plan.models["sensor.shutter"]
    rms = check(exposure, truth(simulator, motion, 4e-5))
    assert 1e-5 < rms and exposure.plan.account.bounds["shutter"].rms < 30 * rms


@pytest.mark.parametrize("axis", [0, 1])
def test_a_smear_does_not_ring_from_one_end_of_the_scene_to_the_other(axis):
    """A smooth step from 0.4 to 1.6 in the middle: far from it the light is even, for fractions of a sample too.

    Transforms repeat a scene: from its last sample back to the first is a jump, which rings by (-1)^n
    times 1 / (pi n) of it at n samples if it is moved by a fraction.
    """
    shape = (24, 64) if axis else (64, 24)
    at = np.arange(64) - 31.5
    ramp = 1 - 0.6 * np.cos(np.pi * np.clip(at / 16 + 0.5, 0, 1))
    values = np.broadcast_to(ramp if axis else ramp[:, None], shape)
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border="edge")
    path = Path(scene, gs.Motion(pan=(145.0, 83.0)), 0.0, SECONDS, 0.0)  # 1.45 and 0.83 samples
    smeared = convolve(open_device("numpy"), path).content.on_host().planes
    ends = (smeared[:, :, 2:14], smeared[:, :, -14:-2])
    if axis == 0:
        ends = (smeared[:, 2:14], smeared[:, -14:-2])
    for end, level in zip(ends, (0.4, 1.6), strict=True):
        # the step's own waves at half a cycle a sample: 1e-5 of it
        assert np.abs(end / COLOR[:, None, None] - level).max() < 5e-5


def test_a_bright_border_does_not_ring_from_afar():
    """The first column, and all beyond it, is bright: its band-limited waves fall as 1 over the distance.

    The truth is a row of 8192 samples beyond each side that fades over half of them.
    """
    low, high, n, far = 300.0, 1000.0, 64, 8192
    values = np.full((24, n), low)
    values[:, 0] = high
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border="edge")
    path = Path(scene, gs.Motion(pan=(83.0, 145.0)), 0.0, SECONDS, 0.0)
    found = convolve(open_device("numpy"), path).content.on_host().planes / COLOR[:, None, None]
    wide = np.pad(values[0], far, mode="edge")
    fade = np.clip(np.minimum(np.arange(wide.size), np.arange(wide.size)[::-1]) / (far / 2), 0, 1)
    f = np.fft.rfftfreq(wide.size)
    # the mean of exp(2 pi i f x) over x from 0 to 1.45
    moved = np.exp(1j * np.pi * f * 1.45) * np.sinc(f * 1.45)
    wave = np.fft.irfft(np.fft.rfft(wide * (1 - np.cos(np.pi * fade)) / 2) * moved, wide.size)
    error = np.abs(found - wave[far : far + n])
    # float32 light and transforms: 3e-7 of the brightest, and a margin
    assert error.max() < 1e-6 * high


def world(place, n, border, far=3000):
    """Light at places of each of n samples' band-limited light, shape (*place.shape, n), by sums over what goes on.

    Samples that go on fade over half of `far`.
    """
    found = np.zeros((*place.shape, n))
    copies = {"zero": 0, "edge": far, "reflect": 2 * (far // (2 * n))}[border]
    for sample in range(n):
        at, ends = np.array([sample]), sample in (0, n - 1)
        if border == "reflect":
            images = 2 * n * np.arange(-copies // 2, copies // 2 + 1)
            at = np.concatenate([sample + images, -1 - sample + images])
        elif border == "edge" and ends:
            at = np.arange(-copies, 1) if sample == 0 else np.arange(sample, sample + copies)
        away = np.maximum(np.maximum(-at, at - n), 0)
        fade = (1 - np.cos(np.pi * np.clip(2 - 2 * away / far, 0, 1))) / 2
        found[..., sample] = np.sinc(place[..., None] - at) @ fade
    return found


@pytest.mark.parametrize("border", ["zero", "edge", "reflect"])
@pytest.mark.parametrize(
    "shape", [(36, 50), (35, 47)]
)  # mirrored: a period of transforms, and none
def test_ripples_of_stars_count_however_far_they_come_from(shape, border):
    """Stars by the border and within: band-limited light, whose waves fall as 1 over the distance, of a pan.

    The mean over a path of 5 samples by 24 points of Gauss: waves of half a cycle a sample to 1e-15.
    """
    values = np.zeros(shape)
    values[shape[0] - 3, 26], values[17, 20], values[0, 5] = 3e4, 1e4, 2e4
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border=border)
    pan = -430.0, 318.0
    path = Path(scene, gs.Motion(pan=pan), 0.0, SECONDS, 0.0)
    parts, weights = np.polynomial.legendre.leggauss(24)
    times = (parts + 1) / 2 * SECONDS
    down, right = (
        world(np.arange(n)[:, None] + speed * times, n, border)
        for n, speed in zip(shape, pan, strict=True)
    )
    expected = np.einsum("ytr,rc,xtc,t->yx", down, values, right, weights / 2, optimize=True)
    for device in ("numpy", "opencl:0"):
        found = convolve(open_device(device), path).content.on_host().planes[0]
        # float32 samples and transfer functions, 6e-8 each, transforms, and the truth's fades
        assert np.abs(found - expected).max() < 2e-7 * values.max()


@pytest.mark.parametrize("border", ["edge", "reflect"])
def test_rows_at_their_own_times_see_the_world_beyond_the_border(border):
    """A wide spot by the border, each row displaced by its own time: cubics add 1e-3 of it (4 samples wide)."""
    shape, row_time, pan = (35, 47), 2e-5, np.array((-900.0, 1500.0))
    y, x = np.indices(shape)
    values = np.exp(-((y - 2) ** 2 + (x - 40) ** 2) / 32)
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border=border)
    path = Path(scene, gs.Motion(pan=tuple(pan)), 0.0, SECONDS, row_time)
    assert not path.is_common
    found = convolve(open_device("numpy"), path).content.on_host().planes[0]
    parts, weights = np.polynomial.legendre.leggauss(24)
    times = row_time * y[:, :1] + (parts + 1) / 2 * SECONDS  # (rows, 24)
    expected = np.empty(shape)
    for row in range(shape[0]):
        down = world(row + pan[0] * times[row], shape[0], border, 200)
        right = world(x[:1].T + pan[1] * times[row], shape[1], border, 200)
        expected[row] = np.einsum("tr,rc,xtc,t->x", down, values, right, weights / 2, optimize=True)
    assert np.abs(found - expected).max() < 1e-3 and expected.max() > 0.3


def error_of(simulator, mean, true):
    """Relative root mean square, 99.9 % quantile and maximum in sigmas of the error of mean electrons."""
    sigma = np.sqrt(np.maximum(true, 1) + simulator.camera.sensor.read_sigma**2)
    part = np.abs(mean - true) / sigma
    rms = np.sqrt(np.mean((mean - true) ** 2) / np.mean(true**2))
    return np.array([rms, np.quantile(part, 0.999), part.max()])


@pytest.mark.parametrize("kind", ["star", "noise"])
@pytest.mark.parametrize("border", ["edge", "reflect"])
def test_ripples_that_are_cut_are_in_the_account(kind, border):
    """A wide frame, whose transform is cut: the error against one that counts all, which the tests above judge."""
    shape, random = (24, 900), np.random.default_rng(3)
    values = np.ones(shape) if kind == "star" else random.random(shape)
    if kind == "star":
        values[12, 897] = 3e4
    cube = (COLOR[:, None, None] * values).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border=border)
    path = Path(scene, gs.Motion(pan=(-430.0, 318.0)), 0.0, SECONDS, 0.0)
    simulator = gs.Simulator(camera(0.0), device="opencl:0")
    probes = probes_for(simulator, scene, path.motion.at(0.0), SECONDS)
    cut, true = (
        np.asarray(simulator.expose(convolve(simulator.device, path, whole), SECONDS).mean, float)
        for whole in (False, True)
    )
    found = error_of(simulator, cut, true)
    said = np.array(path.cut_error(probes, False).figures)
    assert (found < SAFETY * said).all() and (said < 12 * found).all() and found[0] > 5e-5
    assert path.cut_error(probes, True).rms < 1e-6


def test_ripples_of_a_star_reach_all_along_a_view_between_samples():
    """Its window is too small a part of the frame to count for 99.9 % of the pixels; rows and columns are not."""
    shape, star = (300, 400), (150, 210)
    values = np.ones(shape)
    values[star] = 1000
    view, simulator = gs.View(shift=(0.37, 0.21)), gs.Simulator(camera(0.0), device="opencl:0")

    def scene(light):
        cube = (COLOR[:, None, None] * light).astype(np.float32)
        return Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border="edge")

    def mean(of):
        return np.asarray(simulator.expose(of, SECONDS).mean, np.float64)

    waves = (
        np.sinc(np.arange(n) + move - at)
        for n, move, at in zip(shape, view.shift, star, strict=True)
    )
    light = 1 + 999 * np.outer(*waves)
    true = np.maximum(mean(scene(np.maximum(light, 0))) - mean(scene(np.maximum(-light, 0))), 0)
    found = error_of(simulator, mean(scene(values).viewed(view)), true)
    plan = gs.Simulator(camera(0.0), device="opencl:0", tolerance="video").plan(
        scene(values).viewed(view)
    )
    account = plan.account.at(SECONDS)
    assert 1 < found[1] < SAFETY * account.bounds["view"].p999_sigma
    # behind a lens that displaces pixels by up to 5, a mirrored star is interpolated at places of all kinds, too
    lens = RadialPolynomial(0.02, 0.0, 0.5 * np.hypot(*shape) * PHONE.sensor.pixel_pitch)
    own = replace(camera(0.0), optics=replace(PHONE.optics, distortion=lens))
    mirrored = replace(scene(values), border="reflect")
    plan = gs.Simulator(own, device="opencl:0", tolerance="video").plan(mirrored)
    assert found[1] / 2 < SAFETY * plan.account.at(SECONDS).bounds["distortion"].p999_sigma


def test_reads_in_motion_say_how_much_light_below_0_there_is():
    """Next to a star that moves, band-limited light is below 0: 0 up to each read, but not in one exposure up to it."""
    motion, simulator = gs.Motion(pan=(-430.0, 318.0)), gs.Simulator(camera(0.0), device="opencl:0")
    capture = Reads(times=(SECONDS / 2, SECONDS), motion=motion)
    for star in (1, 3e4):
        values = np.ones(SHAPE)
        values[12, 20] = star
        cube = (COLOR[:, None, None] * values).astype(np.float32)
        scene = Scene(gs.Cube(WAVELENGTHS, cube), LIGHT, border="reflect")
        last = capture.shots(Light(capture, simulator, scene), 1, 0)[-1].exposure
        whole = gs.expose_motion(simulator, scene, motion, SECONDS)
        found = error_of(simulator, *(np.asarray(one.mean, np.float64) for one in (last, whole)))
        said = last.plan.account.bounds.get("light below 0 between reads", Bound())
        assert found[2] < said.max_sigma + 0.01 and (found[2] > 1) == (star > 1)
