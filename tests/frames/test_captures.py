"""Captures as values: the same frames by every path, in motion as their own geometry says."""

import io
import json
import tarfile
from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE
from devices import ALL_KINDS
from PIL import Image

import gpusim as gs
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.video import captured_frames
from gpusim.cli.main import main
from gpusim.domain.errors import BadData, Conflict, OutOfRange

LEAVES = gs.chart("deadleaves", size=(64, 48)).content
SCENE = replace(  # a plan of it also serves its smear, which has no materials
    gs.chart("deadleaves", size=(64, 48)),
    content=gs.Cube(LEAVES.wavelengths, LEAVES.bands_at(slice(None)).astype(np.float32)),
)
PAN = gs.Motion(pan=(100, 300))
CAPTURES = {
    "one": gs.Capture(),
    "moving": gs.Capture(motion=PAN, period=0.04),
    "flicker": gs.Capture(flicker=gs.Flicker(120, 0.7), period=0.004),
    "burst": gs.Burst(3),
    "moving burst": gs.Burst(2, motion=PAN, period=0.1),
    "merged burst": gs.Burst(3, merged=True),
    "bracket": gs.Bracket((-2, 0, 1)),
    "moving bracket": gs.Bracket((-1, 0), motion=PAN),
    "merged bracket": gs.Bracket((-2, 0), merged=True),
    "reads": gs.Reads((0.002, 0.004, 0.01)),
    "moving reads": gs.Reads((0.002, 0.01), motion=PAN),
    "merged reads": gs.Reads((0.002, 0.004, 0.01), merged=True),
}


def camera(**sensor):
    return replace(PHONE, sensor=replace(PHONE.sensor, exposure_time=0.01, **sensor))


def taken(capture, simulator, scene, plan, first):
    """Raw values as `take` makes them, those of several frames on a first axis."""
    frames = capture.take(simulator, scene, seed=3, first=first, plan=plan)
    raw = np.stack([frame.raw for frame in frames])
    return raw if capture.has_frames else raw[0]


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name == "moving reads" else name
        for name in CAPTURES
    ],
)
def test_every_path_makes_the_same_bits(name, device):
    """Stream, batch and call, with one plan."""
    capture, content = CAPTURES[name], SCENE.content
    other = replace(SCENE, content=content.with_samples(lambda array: np.roll(array, 9, -1)))
    simulator = gs.Simulator(camera(), device=device, tolerance="video")
    plan = simulator.plan(SCENE)
    scenes, first = [SCENE, other], 2 * capture.count
    numbers = first + capture.count * np.arange(2)
    expected = [
        taken(capture, simulator, one, plan, n) for one, n in zip(scenes, numbers, strict=True)
    ]
    assert not np.array_equal(*expected)
    settings = {"seed": 3, "first": first}
    stream = simulator.stream(scenes, "raw", capture=capture, plan=plan, **settings)
    for one, raw in zip(stream, expected, strict=True):
        assert np.array_equal(simulator.device.numpy(one), raw)
    batch = simulator.batch(2, "raw", capture=capture, plan=plan)
    join = np.concatenate if capture.has_frames else np.stack
    assert np.array_equal(simulator.device.numpy(batch(scenes, **settings)), join(expected))
    codes = simulator.batch(1, "codes", capture=capture, plan=plan)(SCENE, **settings)
    frames = capture.take(simulator, SCENE, plan=plan, **settings)
    shown = np.stack([frame.rgb for frame in frames])
    assert np.array_equal(simulator.device.numpy(codes), shown)


def test_functions_and_values_are_one():
    simulator = gs.Simulator(PHONE, device="opencl:0")
    for frames, capture in (
        (gs.bracket(simulator, SCENE, (-1, 0), seed=2, first=5), gs.Bracket((-1, 0))),
        (gs.burst(simulator, SCENE, 2, seed=2, first=5), gs.Burst(2)),
    ):
        for one, other in zip(frames, capture.take(simulator, SCENE, seed=2, first=5), strict=True):
            assert np.array_equal(one.raw, other.raw) and np.array_equal(one.rgb, other.rgb)
    times = (0.002, 0.01)
    raw = gs.read_nondestructively(simulator, SCENE, times, seed=2, first=5)
    frames = gs.Reads(times).take(simulator, SCENE, seed=2, first=5)
    assert np.array_equal(raw, [frame.raw for frame in frames])
    assert [frame.exposure_time for frame in frames] == list(times)


@pytest.mark.slow
def test_frames_in_motion_follow_one_another():
    """Each opens when the last row of the one before has closed: exposures of their own times."""
    sensor = camera(row_time=2e-5)
    simulator, readout = gs.Simulator(sensor, device="opencl:0"), 2e-5 * 47
    capture = gs.Bracket((-1, 0, 1), motion=PAN, period=0.5)
    frames = capture.take(simulator, SCENE, first=6)
    start = 1.0  # two captures before
    for frame, seconds in zip(frames, (0.005, 0.01, 0.02), strict=True):
        expected = gs.expose_motion(simulator, SCENE, PAN, seconds, start)
        np.testing.assert_array_equal(frame.mean, np.asarray(expected.mean))
        start += seconds + readout


@pytest.mark.slow
def test_reads_in_motion_grow_by_what_each_interval_collects():
    """Differences of reads scatter about the light of their intervals: means over many frames."""
    still = camera(noise=replace(PHONE.sensor.noise, prnu=0.0, dsnu=0.0), row_time=0.0)
    simulator = gs.Simulator(still, device="opencl:0")
    motion, times = gs.Motion(pan=(0, 4000)), (0.002, 0.01)
    capture, count = gs.Reads(times, motion=motion), 24
    found = np.mean(
        [[f.raw for f in capture.take(simulator, SCENE, seed=s)] for s in range(count)], axis=0
    )
    electrons = np.diff(found, axis=0)[0] / still.sensor.gain_dn_per_electron
    expected = np.asarray(gs.expose_motion(simulator, SCENE, motion, 0.008, 0.002).mean, np.float64)
    dark = still.sensor.noise.operating_dark_current * 0.008
    # photons, two reads and two roundings; 3072 pixels: the mean square is 1 within 4.5 sigma of 2.6 %
    noise = still.sensor.noise.read**2 + 1 / (12 * still.sensor.gain_dn_per_electron**2)
    z = (electrons - expected - dark) / np.sqrt((expected + dark + 2 * noise) / count)
    assert abs(z.mean()) * z.size**0.5 < 4.5 and z.std() == pytest.approx(1, abs=0.12)
    whole = np.asarray(gs.expose_motion(simulator, SCENE, motion, 0.01, 0.0).mean, np.float64)
    last = np.asarray(capture.take(simulator, SCENE)[-1].mean, np.float64)
    # the sum of two intervals is the whole path, up to what instants err
    assert np.sqrt(np.mean((last - whole) ** 2) / np.mean(whole**2)) < 2e-3


@pytest.mark.parametrize(
    "times", [(0.002, 0.01), (0.001, 0.002, 0.004, 0.008, 0.016), (0.04, 0.08, 0.12)]
)
def test_merged_reads_are_unbiased_and_as_precise_as_they_can_be(times):
    """Slopes of flat light at three levels, against the information in all differences."""
    base = camera(noise=replace(PHONE.sensor.noise, prnu=0.0, dsnu=0.0, dead_pixels=0.0))
    sensor = replace(base.sensor, cfa=base.sensor.cfa)
    simulator = gs.Simulator(
        replace(base, sensor=sensor, processor=replace(base.processor, defects="none")),
        device="opencl:0",
    )
    levels = np.repeat([0.02, 0.2, 0.9], 32)
    flat = gs.chart("flat", size=(96, 64))
    scene = replace(
        flat, content=replace(flat.content, shading=(levels * np.ones((64, 1))).astype(np.float32))
    )
    truth = np.asarray(simulator.expose(scene, times[-1]).mean, np.float64)
    capture = gs.Reads(times, merged=True)
    error = [capture.take(simulator, scene, seed=s)[0].mean - truth for s in range(12)]
    noise = sensor.noise.read**2 + 1 / (12 * sensor.gain_dn_per_electron**2)
    for part in (np.s_[:, 4:28], np.s_[:, 36:60], np.s_[:, 68:92]):
        own = np.array(error)[:, part[0], part[1]]
        z = own.mean() / (own.std() / own.size**0.5)
        assert abs(z) < 4.5
        rate = truth[part].mean() / times[-1]
        usable = [t for t in times if truth[part].max() / times[-1] * t < 0.9 * sensor.full_well]
        if len(usable) < 2 or truth[part].max() > 0.8 * sensor.full_well:
            continue
        steps = np.diff(usable)
        covariance = np.diag(rate * steps + 2 * noise) - noise * (
            np.eye(len(steps), k=1) + np.eye(len(steps), k=-1)
        )
        least = (steps @ np.linalg.solve(covariance, steps)) ** -0.5 * times[-1]
        # the mosaic's colours differ in their rates, so the mean rate is off by some of the noise
        assert own.std() < 1.12 * least


@pytest.mark.slow
def test_hdr_video_is_the_merged_bracket_of_each_frame():
    simulator = gs.Simulator(camera(), device="opencl:0")
    capture = gs.Bracket((-2, 0), merged=True)
    scenes = Moving(Still(SCENE, 3), PAN, 25)
    made = list(captured_frames(simulator, scenes, [[0, 0, 2]], capture=capture, seed=1))
    own = replace(capture, motion=PAN, period=1 / 25)
    for one in made:
        (expected,) = own.take(simulator, SCENE, seed=1, first=2 * one.number)
        assert np.array_equal(one.values.raw, expected.raw)
    with pytest.raises(Conflict, match="one frame of each scene"):
        next(captured_frames(simulator, scenes, [[0, 0]], capture=gs.Burst(2)))


def test_the_preview_shows_a_merged_capture():
    device = gs.open_device("opencl:0")
    capture = gs.Bracket((-2, 0), merged=True)
    producer = Producer(Still(SCENE, 1), device, capture=capture)
    state = State("phone", tolerance="exact")
    for view in ("raw", "electrons", "noise", "rendered"):
        shown = producer.picture(replace(state, view=view), 0)
        assert shown.codes.shape == (48, 64, 3)
    simulator = gs.Simulator(state.build(), device=device)
    (expected,) = capture.take(simulator, SCENE, seed=state.seed)
    assert np.array_equal(shown.codes, expected.rgb)
    assert np.array_equal(producer.frame(state, 0).raw, expected.raw)


def test_pairs_and_the_command_line_take_captures(tmp_path, capsys):
    picture = tmp_path / "a.png"
    Image.fromarray(np.random.default_rng(1).integers(0, 255, (40, 60, 3), np.uint8)).save(picture)
    common = [str(picture), "--camera", "phone", "--device", "opencl:0"]
    pairs = ["pairs", *common, "--exposure", "5ms", "--capture", "burst=3,pan=0:400"]
    assert main([*pairs, "-o", str(tmp_path / "p")]) == 0
    with tarfile.open(tmp_path / "p" / "000000.tar") as file:
        raw, clean = (
            np.load(io.BytesIO(file.extractfile(f"00000000.{name}.npy").read()))
            for name in ("raw", "clean")
        )
        record = json.load(file.extractfile("00000000.json"))
    assert raw.shape == clean.shape == (3, 40, 60) and len(record["exposure_time_s"]) == 3
    assert not np.array_equal(clean[0], clean[1])  # the camera moves
    assert np.abs(raw - clean).mean() < 0.2 * clean.mean()
    out = tmp_path / "hdr.exr"
    assert main(["simulate", *common, "--capture", "bracket=-2:0:2,merged", "-o", str(out)]) == 0
    assert out.exists()
    video = ["video", *common, "--frames", "2", "--pan", "0,50", "--blur"]
    assert main([*video, "--capture", "bracket=-2:0", "-o", str(tmp_path / "v.dng")]) == 0
    assert (tmp_path / "v_0001.dng").exists()
    for text in (
        "burst=0",
        "burst=2,bracket=1",
        "burst=2,burst=3",
        "one",
        "burst",
        "pan=1:2:3",
        "merged",
    ):
        with pytest.raises(SystemExit):
            main(["simulate", *common, "--capture", text])
    capsys.readouterr()


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("mode", ["charge", "digital"])
@pytest.mark.parametrize("binning", [(2, 2), (3, 1)])
def test_stacked_pixels_are_binned_layer_by_layer(binning, mode, device):
    """Sums or means of the electrons of each layer, and noise as of so many pixels."""
    own = camera(stacked=True, binning=binning, binning_mode=mode)
    simulator = gs.Simulator(own, device=device)
    plain = gs.Simulator(camera(stacked=True), device=device)
    whole = np.asarray(plain.expose(SCENE).mean, np.float64)
    down, across = binning
    blocks = whole.reshape(3, 48 // down, down, 64 // across, across)
    expected = blocks.sum(axis=(2, 4)) if mode == "charge" else blocks.mean(axis=(2, 4))
    frame = simulator(SCENE, seed=5)
    np.testing.assert_allclose(frame.mean, expected, rtol=1e-6)
    assert frame.raw.shape == expected.shape and frame.rgb.shape == (*expected.shape[1:], 3)
    sensor = frame.camera.sensor
    electrons = (frame.raw - np.float64(sensor.dark_level)) / sensor.gain_dn_per_electron
    # the standard error of a mean of thousands of pixels with 1 % of fixed pattern and 5 % of photon noise: 0.1 %
    assert electrons.mean() == pytest.approx(expected.mean(), rel=5e-3)


@pytest.mark.slow
def test_a_burst_of_stacked_pixels_is_merged_layer_by_layer():
    """Eight frames at rest have an eighth of the variance in every layer; moved ones are aligned."""
    noise = replace(PHONE.sensor.noise, prnu=0.0, dsnu=0.0, dead_pixels=0.0)
    own = camera(stacked=True, noise=noise)
    simulator = gs.Simulator(
        replace(own, processor=replace(own.processor, defects="none")), device="opencl:0"
    )
    scene = gs.chart("deadleaves", size=(96, 80))
    frames = gs.Burst(8).take(simulator, scene)
    merged = gs.merge_burst(simulator, frames)
    assert merged.raw.shape == frames[0].raw.shape == (3, 80, 96)
    gain = frames[0].camera.sensor.gain_dn_per_electron
    for layer in range(3):
        error = merged.mean[layer] / 8 - frames[0].mean[layer]
        variance = np.mean(frames[0].mean[layer]) + noise.read**2 + 1 / (12 * gain**2)
        # 2 % as `merge_burst` says, and 2.3 % of a variance of 7680 values at 1.4 sigma
        assert np.mean(error**2) * 8 / variance == pytest.approx(1, abs=0.06)
    views = [scene.viewed(gs.View(shift=(0, 2 * k))) for k in range(4)]
    moved = gs.merge_burst(simulator, gs.burst(simulator, views))
    error = moved.mean[:, 8:-8, 8:-16] / 4 - frames[0].mean[:, 8:-8, 8:-16]
    alone = frames[0].raw[:, 8:-8, 8:-16] - np.float32(frames[0].camera.sensor.dark_level)
    alone = alone / gain - frames[0].mean[:, 8:-8, 8:-16]
    assert np.mean(error**2) < 0.5 * np.mean(alone**2)


def test_captures_that_cannot_be():
    simulator = gs.Simulator(camera(), device="opencl:0")
    with pytest.raises(Conflict, match="nothing to merge"):
        gs.Capture(merged=True)
    with pytest.raises(OutOfRange, match="frames of a burst"):
        gs.Burst(0)
    with pytest.raises(BadData, match="times of reads"):
        gs.Reads(("a",))
    with pytest.raises(BadData, match="wanted one or more"):
        gs.Reads(())
    for take in (
        lambda: simulator.stream([SCENE], "raw", capture=3),
        lambda: simulator.batch(2, "raw", capture="burst"),
        lambda: simulator.loop(SCENE, capture=gs.Motion()),
    ):
        with pytest.raises(BadData, match="wanted a Capture"):
            take()
    with pytest.raises(BadData, match=r"capture\.motion"):
        gs.Capture(motion=3)
    with pytest.raises(OutOfRange, match=r"capture\.period"):
        gs.Capture(period=-1)
    with pytest.raises(OutOfRange, match="times of the reads"):
        gs.Reads((0.02, 0.01)).take(simulator, SCENE)
    with pytest.raises(Conflict, match="own channel"):
        next(simulator.stream([SCENE], "electrons", capture=gs.Capture(motion=PAN)))
