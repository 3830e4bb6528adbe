"""Several frames made into one: exposure brackets, bursts, pairs with and without flash."""

import dataclasses
import functools

import numpy as np
import pytest

import gpusim as gs
from gpusim.captures import regression
from gpusim.captures.merge import _display_noise, merge_bracket, merge_burst, merge_flash
from gpusim.data.lights import illuminant
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.kernels.processor.align import align
from gpusim.kernels.processor.average import average
from gpusim.kernels.processor.flash import flash as with_flash
from gpusim.kernels.processor.merge import merge
from gpusim.pipeline.simulator import Simulator

PHONE = gs.open_camera("phone")
COUNT = 8  # frames of a burst


def camera(scaling="exposure", **sensor):
    """The phone without fixed patterns: what is left varies from frame to frame and averages out."""
    noise = dataclasses.replace(PHONE.sensor.noise, prnu=0.0, dsnu=0.0)
    processor = dataclasses.replace(PHONE.processor, demosaic="bilinear", scaling=scaling)
    return dataclasses.replace(
        PHONE, sensor=dataclasses.replace(PHONE.sensor, noise=noise, **sensor), processor=processor
    )


@functools.cache
def simulator():
    return Simulator(camera(), device="opencl:0")


def grey(levels):
    """A grey scene of these reflectances, (rows, cols)."""
    made = gs.chart("flat", size=np.shape(levels)[::-1])
    return dataclasses.replace(
        made, content=dataclasses.replace(made.content, shading=np.float32(levels))
    )


def numbers(exposure, simulate):
    return np.array(simulate.device.numpy(exposure.mean), np.float64)


# --- exposure bracket -------------------------------------------------------------------------------------------------

STOPS, PATCH, SEEDS = (-4, -2, 0), 40, 8


@functools.cache
def patches():
    """Truth and merged rates [e- s-1] of flat patches over the whole range: (patch, pixels), (patch, seeds pixels).

    The patches are dense where the green of one frame is nearly full. Also the times [s] and the merged frame.
    """
    simulate = simulator()
    near = np.array([0.9, 0.94, 0.95, 0.96, 0.97, 0.98, 0.99, 1.0, 1.02, 1.1])
    levels = np.concatenate(
        [[0], np.geomspace(1e-4, 0.8, 25), near, 4 * near, 15 * near[:4]]
    )  # 1: white, the level
    levels = np.sort(levels)[:48].reshape(6, 8)  # of automatic exposure
    scene = grey(np.repeat(np.repeat(levels, PATCH, 0), PATCH, 1))
    # white at saturation in the longest frame
    white = simulate.expose(grey(np.ones((8, 8))))
    time = white.exposure_time / simulate.camera.sensor.auto_exposure.level
    simulate = Simulator(camera(exposure_time=time), device="opencl:0")
    merged = [
        merge_bracket(simulate, gs.bracket(simulate, scene, STOPS, seed=seed))
        for seed in range(SEEDS)
    ]
    truth = numbers(simulate.expose(scene), simulate) / time

    def apart(
        plane,
    ):  # the inner part of each patch, green pixels of the red rows: one colour, one noise
        tiles = plane.reshape(*plane.shape[:-2], 6, PATCH, 8, PATCH).swapaxes(-3, -2)
        return tiles[..., 4:-4:2, 5:-4:2].reshape(*plane.shape[:-2], 48, -1)

    rates = np.array([frame.mean for frame in merged], np.float64) / merged[0].exposure_time
    return apart(truth), apart(rates).swapaxes(0, 1), time * np.exp2(STOPS), merged[0], simulate


def information(rate, times, sensor):
    """Cramer-Rao: the sum over the frames that are not full of 1 / variance of their rates, [s2 e-2]."""
    gain, chip = sensor.gain_dn_per_electron, sensor.noise
    dark = chip.operating_dark_current
    floor = chip.read**2 + 1 / (12 * gain**2)
    return sum(
        time**2 / (rate * time + dark * time + floor) * (rate * time < sensor.full_well)
        for time in times
    )


def test_bracket_is_unbiased_over_the_whole_range():
    truth, rates, *_ = patches()
    error = rates - truth[:, None]
    z = error.mean(axis=(1, 2)) / (error.std(axis=(1, 2)) / np.sqrt(error[0].size))
    # 48 patches of 2048 values: |z| > 4.5 by chance in 3e-4 of all runs; leaving frames out by what the pixel itself
    # has in the shorter ones is wrong by 0.4 % near a full well, z = 10
    assert np.abs(z).max() < 4.5, z.round(1)
    assert 0.6 < z.std() < 1.4  # 48 normal numbers: 1 +- 0.1


@pytest.mark.parametrize("electrons", [0.0, 1.4, 7.5, 40.0])
def test_bracket_is_unbiased_in_the_dark(electrons):
    """Weights from the pixel's own values would be 0.06 e- off at 1.4 and 7.5 e-: a z of 20."""
    random = np.random.default_rng(17)
    times, read, gain = np.array([1.0, 4.0, 16.0]), 3.0, 1.0
    mean = electrons * times / times[-1]
    # uneven rounding is none of the merge's business: 3 e- of noise over steps of 1 leave 1e-70 of it
    raw = np.rint(
        64
        + random.poisson(mean[:, None, None], (3, 1000, 1000))
        + random.normal(0, read, (3, 1000, 1000))
    )
    rate = merge(
        raw.astype(np.uint16),
        dark=[64.0] * 3,
        gain=[gain] * 3,
        time=times,
        floor=[read**2 + 1 / 12] * 3,
        ceiling=[4000.0] * 3,
        device="opencl:0",
    )
    error = rate * times[-1] - electrons
    # neighbours share samples in their weights alone, not in what these weigh: a million independent values
    assert abs(error.mean(dtype=np.float64)) < 4.5 * error.std(dtype=np.float64) / 1000


def test_bracket_is_as_precise_as_its_frames_allow():
    truth, rates, times, _, simulate = patches()
    sensor = simulate.camera.sensor
    rate = truth.mean(axis=1)
    ratio = (rates - truth[:, None]).std(axis=(1, 2)) * np.sqrt(information(rate, times, sensor))
    # where a frame is about to be left out, 3.2 sigma of the pixel and 3 of its neighbours' mean below a full well, the
    # others alone count; 5 sigma of reading lower it too
    full, sigma = sensor.full_well, np.sqrt(sensor.full_well + 30)
    switching = np.any(
        [(rate * t > full - 4.5 * sigma - 25) & (rate * t < full + sigma) for t in times], axis=0
    )
    assert 5 < switching.sum() < 16
    # the sampled deviation scatters by 1 / sqrt(2 2048) = 1.6 %, four times that; the rate that the weights use, of 8
    # neighbours, costs less than 1.5 %
    assert ratio[~switching].max() < 1.07 and ratio[~switching].min() > 0.94, ratio.round(3)
    assert abs(ratio[~switching].mean() - 1) < 0.015
    assert (
        ratio[switching].max() < 2.3
    )  # sqrt(1 + 4): the shorter of two frames two stops apart alone


def test_bracket_extends_the_dynamic_range_by_its_ratio():
    *_, times, _, simulate = patches()
    dark = grey(np.full((160, 160), 1e-6))
    frame = merge_bracket(simulate, gs.bracket(simulate, dark, STOPS))
    sensor = simulate.camera.sensor
    alone = np.sqrt(
        1 / information(0.0, times[:1], sensor)
    )  # noise of the shortest, which saturates at the same rate
    gained = alone / (frame.mean / frame.exposure_time).std()
    # of 25600 values the deviation scatters by 0.5 %; the shorter frames help by 3 % (1 + 1/16 + 1/256), uneven
    # rounding of 5 e- of noise to steps of 6 e- costs or helps by 1 %
    assert gained == pytest.approx(times[-1] / times[0], rel=0.05)
    assert frame.rendering.saturation == pytest.approx(1)


def test_bracket_develops_beyond_white_and_far_below():
    exposed = patches()[-1].camera
    simulate = Simulator(
        camera("normalised", exposure_time=exposed.sensor.exposure_time), device="opencl:0"
    )
    levels = np.array([1e-3, 0.02, 0.5, 2.0, 6.0, 12.0])
    scene = grey(np.repeat(levels, 40)[None].repeat(60, 0))
    frame = merge_bracket(simulate, gs.bracket(simulate, scene, STOPS))
    perfect = next(
        Simulator(
            dataclasses.replace(
                simulate.camera,
                sensor=dataclasses.replace(
                    simulate.camera.sensor,
                    bits=16,
                    full_well=1e5,
                    gain=0.6,
                    noise=gs.Noise(photon="none"),
                ),
            ),
            device="opencl:0",
        ).frames(scene, 1)
    )
    for k, level in enumerate(levels):
        cut = np.s_[8:-8, 40 * k + 8 : 40 * k + 32]
        found, wanted = frame.linear[cut].mean(axis=(0, 1)), perfect.linear[cut].mean(axis=(0, 1))
        # 1056 pixels of 6 e- in the dark, which white's 5700 e- make 6 / 5700 / 32; blue counts 2.5 times; photons
        # more; the perfect camera's mean is rounded to steps of 1.7 e-, and a dark electron may be in it or not
        sigma = 2.5 * np.sqrt((6.0**2 + level * 5700) / 5700**2 / 1056)
        assert np.abs(found - wanted).max() < 5 * sigma + 2.5 * 0.83 / 5700 + 2e-3 * level, level
    assert frame.linear.max() > 10
    assert frame.linear.dtype == np.float32 and np.isfinite(frame.linear).all()


def test_bracket_of_eight_stops_keeps_its_dark_parts_in_16_bits():
    """Steps of the raw values are 24 e- of the longest frame: the finer scale keeps rounding out of the dark."""
    time = simulator().expose(grey(np.ones((8, 8)))).exposure_time
    simulate = Simulator(camera(exposure_time=time), device="opencl:0")
    # so dark that photons are none: green would have more of them than red and blue, and all the noise not be green's
    frame = merge_bracket(simulate, gs.bracket(simulate, grey(np.full((96, 96), 1e-6)), (-4, 0, 4)))
    assert (
        frame.camera.sensor.full_well / 64511
    ) ** 2 / 12 > 0.9 * frame.camera.sensor.noise.read**2
    dark = frame.linear[8:-8, 8:-8, 1]
    mosaic = frame.mean[8:-8, 8:-8].std() * frame.camera.sensor.gain_dn_per_electron / 64511
    expected = mosaic * np.sqrt(
        frame.rendering.display_from_camera[1] ** 2 @ [0.5625, 0.625, 0.5625]
    )
    # bilinear leaves 9/16 of the variance of red and blue on average and 5/8 of green's; 1600 independent values
    # scatter by 2 %, four times that. Without the finer scale most of 5.7 e- are rounded to 0: 0.27 less
    assert dark.std() == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("taken", [((1, 1), (1, 16)), ((1, 16), (1, 1)), ((0.25, 16), (1, 1))])
def test_bracket_of_any_gains_in_any_order(taken):
    """The frame that holds the largest rate is not always the first or the shortest."""
    simulate = Simulator(camera("normalised"), device="opencl:0")
    scene = grey(np.geomspace(0.005, 0.9, 64)[None].repeat(64, 0))
    time = simulate.expose(scene).exposure_time
    exposures = [simulate.expose(scene, part * time, gain) for part, gain in taken]
    frame = merge_bracket(simulate, [one.frame(seed=k) for k, one in enumerate(exposures)])
    error = (
        frame.mean
        * exposures[0].exposure_time
        / numbers(exposures[0], simulate)
        / frame.exposure_time
        - 1
    )
    for part in (np.s_[:, :16], np.s_[:, 16:48], np.s_[:, 48:]):
        # about 1000 values each; the wrong frame would be used where it is full: up to half too dark
        assert abs(error[part].mean()) < 4.5 * error[part].std() / np.sqrt(error[part].size) < 0.03
    # display white is the frames' own: 1000 pixels of 5 % noise, and the blue of the darker third
    alike = simulate.expose(scene, time).frame(seed=9).linear[:, 32:]
    assert frame.linear[:, 32:].mean() == pytest.approx(alike.mean(), rel=0.01)


@pytest.mark.parametrize(("stops", "middle"), [((-2, 0, 2), 1), ((0, 2, -2), 0), ((-4, -2, 0), 1)])
def test_merged_pictures_are_as_bright_as_one_of_their_frames(stops, middle):
    """A bracket as the frame of middle exposure, what is white in the others included; a burst as its reference.

    No blur, which would take light from patch to patch. The darkest frame has 123 e- of the darkest patch, with noise
    of 12 %, and 1728 values, a third of them independent of their neighbours: 0.5 %; four times that.
    """
    plain = dataclasses.replace(PHONE.optics, model="none", relative_illumination="none")
    simulate = Simulator(dataclasses.replace(camera(), optics=plain), device="opencl:0")
    scene = grey(np.repeat([0.1, 0.24, 1.0], 40)[None].repeat(40, 0))
    frames = gs.bracket(simulate, scene, stops)
    merged = merge_bracket(simulate, frames)
    for column, level in ((0, 0.1), (40, 0.24), (80, 1.0)):
        cut = np.s_[8:-8, column + 8 : column + 32]
        # the metered white at the level of automatic exposure is display white
        wanted = level * 2.0 ** stops[middle]
        assert merged.linear[cut].mean() == pytest.approx(wanted, rel=0.02)
        if wanted <= 1:
            assert frames[middle].linear[cut].mean() == pytest.approx(wanted, rel=0.02)
    burst = merge_burst(simulate, list(simulate.frames(scene, COUNT)))
    assert burst.linear[8:-8, 88:-8].mean() == pytest.approx(1, rel=0.02)
    assert (
        burst.rgb[8:-8, 88:-8].mean() > 252
    )  # white has 0.6 % of noise, 2 codes where it does not clip


def test_single_full_pixels_are_left_out():
    """A full well is read 5 e- below or above itself: of values at exactly the well, half would pass for not full."""
    simulate = Simulator(camera(full_well=3000.0, gain=0.1, exposure_time=0.01), device="opencl:0")
    short, long = gs.bracket(simulate, grey(np.full((64, 64), 1e-6)), (-4, 0))
    electrons = np.zeros((64, 64), np.float32)
    electrons[4::8, 4::8] = 12000
    short, long = (
        dataclasses.replace(
            frame,
            raw=simulate.readout.draw_electrons(
                electrons * frame.exposure_time / 0.01, frame.exposure_time, first=k
            ),
        )
        for k, frame in enumerate((short, long))
    )
    found = merge_bracket(simulate, [short, long]).mean[4::8, 4::8]
    # the short frame's 750 e- have a noise of sqrt(750 + 25 + 8) = 28, 3.7 %: 64 times beyond 5 of it in 4e-5 of runs
    assert np.abs(found / 12000 - 1).max() < 5 * 0.037


# --- what both keep of a frame's processing ---------------------------------------------------------------------------


def processed(sensor=None, noise=None, **processor):
    """A camera with other properties."""
    made = camera(**(sensor or {}))
    chip = dataclasses.replace(made.sensor.noise, **(noise or {}))
    return Simulator(
        dataclasses.replace(
            made,
            sensor=dataclasses.replace(made.sensor, noise=chip),
            processor=dataclasses.replace(made.processor, **processor),
        ),
        device="opencl:0",
    )


def stages(frame):
    return {stage.stage: stage.model for stage in frame.report.stages}


def test_merged_pictures_are_neutral_where_all_is_full():
    simulate = processed({"exposure_time": simulator().expose(grey(np.ones((8, 8)))).exposure_time})
    scene = grey(np.where(np.arange(64) < 32, 0.2, 100.0)[None].repeat(64, 0))
    for frame in (
        merge_bracket(simulate, gs.bracket(simulate, scene, (-2, 0))),
        merge_burst(simulate, list(simulate.frames(scene, COUNT))),
    ):
        light = frame.linear[8:-8, 44:-8].mean(axis=(0, 1))
        # reads below a full well, 5 of 6000 e-, through a matrix of rows up to 3: 0.3 %; unclipped, red is twice blue
        assert light == pytest.approx(np.full(3, light.mean()), rel=0.005)


def test_merged_pictures_have_no_lens_shading():
    edge = (0.3, 0.3, 1.0, 0.3, 0.3)
    scene = grey(np.full((160, 40), 0.12))
    time = simulator().expose(grey(np.ones((8, 8)))).exposure_time
    simulate = processed(
        {"vignetting": tuple((a,) * 5 for a in edge), "exposure_time": time}, shading=True
    )
    for frame in (
        merge_bracket(simulate, gs.bracket(simulate, scene, (-4, 0, 4))),
        merge_bracket(simulate, gs.bracket(simulate, scene, (-1, 0))),
        merge_burst(simulate, list(simulate.frames(scene, COUNT))),
    ):
        rows = frame.linear.mean(axis=(1, 2))
        # 20 x 40 pixels of at most 5 % noise: 0.2 %, correlated 0.4 %; the gains follow the map at nodes to 1 %
        assert rows[:20].mean() == pytest.approx(rows[70:90].mean(), rel=0.03)
        assert stages(frame)["processor.shade"] and frame.shading is not None


def test_merged_pictures_have_no_dead_pixels_and_say_how():
    simulate = processed(
        {"exposure_time": 0.5 * simulator().expose(grey(np.ones((8, 8)))).exposure_time},
        {"dead_pixels": 0.002, "seed": 3},
        defects="known",
    )
    scene = grey(np.full((96, 96), 0.5))
    assert simulate.readout.defects((96, 96)).sum() > 5
    for frame in (
        merge_bracket(simulate, gs.bracket(simulate, scene, (-2, 0))),
        merge_burst(simulate, list(simulate.frames(scene, COUNT))),
    ):
        middle = np.stack(
            [
                frame.mean[y::2, x::2] / np.median(frame.mean[y::2, x::2])
                for y in (0, 1)
                for x in (0, 1)
            ]
        )
        assert middle.min() > 0.7  # the noise of some 500 e- is 5 %
        assert (
            stages(frame)["processor.defects"]
            == "the chip's known defects replaced, frame by frame"
        )
        assert "processor.merge" in stages(frame) or "processor.average" in stages(frame)
    other = processed(
        {"exposure_time": 0.01}, {"dead_pixels": 0.002, "seed": 4}, defects="known"
    )  # not of this chip
    told = stages(merge_bracket(other, gs.bracket(simulate, scene, (-2, 0))))["processor.defects"]
    assert told == "pixels 6 sigma beyond their neighbours replaced, frame by frame"


def test_bracket_has_no_seam_where_frames_take_over():
    simulate = simulator()
    scene = gs.chart("ramp", size=(640, 128), decades=2.5, high=4.0)
    time = simulate.expose(grey(np.ones((8, 8)))).exposure_time
    total, simulate = 0, Simulator(camera(exposure_time=time), device="opencl:0")
    truth = numbers(simulate.expose(scene), simulate) / time
    for seed in range(4):
        frame = merge_bracket(simulate, gs.bracket(simulate, scene, (-4, -2, 0), seed=seed))
        total = total + frame.mean / frame.exposure_time / truth - 1
    green = total[::2, 1::2] / 4
    z = green.mean(axis=0) / (green.std(axis=0) / np.sqrt(len(green)))
    windows = np.convolve(z, np.ones(10) / np.sqrt(10), "valid")
    # 320 columns of 64 values: Student's t of 63 degrees beyond 5.2, or windows beyond 5, in 1e-3 of all runs
    assert np.abs(z).max() < 5.2 and np.abs(windows).max() < 5


@pytest.mark.parametrize("cfa", [("W",), ("GRG", "BGB"), "stacked"])
def test_bracket_of_any_mosaic(cfa):
    if cfa == "stacked":
        made = camera(stacked=True)
    elif cfa == ("W",):
        made = next(
            one for one in map(gs.open_camera, gs.camera_names()) if one.sensor.is_monochrome
        )
        noise = dataclasses.replace(made.sensor.noise, prnu=0.0, dsnu=0.0)
        made = dataclasses.replace(made, sensor=dataclasses.replace(made.sensor, noise=noise))
    else:
        made = camera(cfa=cfa)
    simulate = Simulator(made, device="opencl:0")
    scene = grey(np.full((48, 48), 0.2))
    frame = merge_bracket(simulate, gs.bracket(simulate, scene, (-3, 0, 1)))
    truth = numbers(simulate.expose(scene), simulate) / simulate.expose(scene).exposure_time
    error = frame.mean / frame.exposure_time / truth - 1
    assert frame.mean.shape == truth.shape
    assert abs(error.mean()) < 4.5 * error.std() / np.sqrt(error.size)  # 2304 values or more
    assert frame.linear.shape == (48, 48, 3)


def test_bracket_as_files(tmp_path):
    *_, frame, _ = patches()
    for suffix in (".exr", ".npz", ".png", ".dng"):
        frame.save(tmp_path / f"merged{suffix}")
    assert np.load(tmp_path / "merged.npz")["electrons"].dtype == np.float32


# --- burst ------------------------------------------------------------------------------------------------------------

FINE, MARGIN = 2, 16


@functools.cache
def leaves():
    return gs.chart("deadleaves", size=((192 + 2 * MARGIN) * FINE, (128 + 2 * MARGIN) * FINE))


def seen(shift):
    """192 x 128 pixels of dead leaves from a camera moved by `shift` pixels, to half of one."""
    content = leaves().content
    top, left = (round((MARGIN + d) * FINE) for d in shift)
    cut = np.s_[top : top + 128 * FINE, left : left + 192 * FINE]
    return dataclasses.replace(
        leaves(),
        samples_per_pixel=FINE,
        content=dataclasses.replace(content, ids=content.ids[cut], shading=content.shading[cut]),
    )


@functools.cache
def exposures(kind):
    """Shifts [pixel], and the exposures of dead leaves from there."""
    random = np.random.default_rng(4)
    shifts = {
        "still": np.zeros((1, 2)),
        "whole": 2.0 * random.integers(-6, 7, (COUNT, 2)),
        "broken": random.integers(-20, 21, (COUNT, 2)) / FINE,
    }[kind]
    shifts[0] = 0
    time = simulator().expose(seen((0, 0))).exposure_time
    return shifts, [simulator().expose(seen(shift), time) for shift in shifts]


@functools.cache
def burst(kind, level):
    """Shifts [pixel] and frames of one exposure time, in parts of that of automatic exposure."""
    shifts, full = exposures(kind)
    simulate = simulator()
    shorter = [
        gs.change_exposure_time(simulate, exposure, level * exposure.exposure_time)
        for exposure in full
    ]
    if kind == "still":
        return shifts, list(shorter[0].frames(COUNT, seed=7))
    return shifts, [exposure.frame(seed=7, first=number) for number, exposure in enumerate(shorter)]


def gain_of(level, kind):
    """How many times less noise the merged picture has than its first frame, away from what was seen once."""
    _, frames = burst(kind, level)
    frame = merge_burst(simulator(), frames)
    sensor, time = frames[0].camera.sensor, frames[0].exposure_time
    single = (frames[0].raw - sensor.dark_level) / sensor.gain_dn_per_electron
    dark = sensor.noise.dark_current * time
    inner = np.s_[24:-24, 24:-24]
    before = (single - dark - frames[0].mean)[inner]
    after = (frame.mean / COUNT - frames[0].mean)[inner]
    return np.sqrt((before**2).mean() / (after**2).mean())


@pytest.mark.parametrize("shape", [(20, 12), (32, 21), (4, 6)])
def test_a_burst_smaller_than_a_tile_is_merged(shape):
    """At rest the sum of 8 frames has 8 times the light, and an eighth of the relative variance."""
    plain = dataclasses.replace(PHONE.optics, model="none", relative_illumination="none")
    simulate = Simulator(dataclasses.replace(camera(), optics=plain), device="opencl:0")
    exposure = simulate.expose(grey(np.full(shape, 0.5)))
    one, true = exposure.frame(), np.array(simulate.device.numpy(exposure.mean), float)
    off, single = [], []
    for first in range(0, 10 * COUNT, COUNT):
        merged = merge_burst(simulate, list(exposure.frames(COUNT, first=first)))
        off.append(merged.mean / COUNT - true)
        sensor = one.camera.sensor
        raw = exposure.frame(first=first).raw
        single.append((raw - sensor.dark_level) / sensor.gain_dn_per_electron - true)
    # 240 values or more of each: the ratio of variances has a standard error of 13 %
    ratio = np.var(single) / np.var(off)
    assert 0.6 * COUNT < ratio < 1.5 * COUNT


def test_burst_at_rest_has_an_nth_of_the_variance():
    # 80 x 144 values: each deviation scatters by 0.7 %, together 1 %; 2 % for frames that look different by chance, and
    # for displacements chosen by their noise
    assert gain_of(0.02, "still") == pytest.approx(np.sqrt(COUNT), rel=0.05)
    assert gain_of(0.2, "still") == pytest.approx(np.sqrt(COUNT), rel=0.05)


def test_burst_keeps_most_of_it_under_shake():
    """Whole periods are averaged; fractions are fitted to all samples, smoothed where noise hides what changes."""
    # as at rest: the deviations scatter by 1 % together, 2 % for what is left out, 2 % for displacements of few details
    assert gain_of(0.02, "whole") > 0.95 * np.sqrt(COUNT)
    assert gain_of(0.2, "whole") > 0.95 * np.sqrt(COUNT)
    # no theory for these: 1.2 and .7 measured, less a tenth; half a pixel is not sharper than the noise allows
    assert gain_of(0.02, "broken") > 1.05 * np.sqrt(COUNT)
    assert gain_of(0.2, "broken") > 0.6 * np.sqrt(COUNT)


@pytest.mark.parametrize(("kind", "level"), [("whole", 0.2), ("broken", 0.2), ("whole", 0.02)])
def test_displacements_are_found(kind, level):
    shifts, frames = burst(kind, level)
    found = align(np.stack([frame.raw for frame in frames]), device="opencl:0")[1:, 1:-1, 1:-1]
    error = found + shifts[1:, None, None] / 2
    if kind == "whole":
        assert (np.abs(error) < 0.5).all()  # each tile's whole displacement
    # of 26 e- a tile's 256 blocks of 4 pixels, a deviation of 13 of 104, tell contours of some 20 e- per block apart to
    # 13 sqrt(2) / (20 16) = 0.06 period, the paraboloid by half as much again; of 258 e- it is a third of that, and
    # sharp edges between samples add to broken shifts; measured 0.031, 0.008 and 0.031
    assert np.sqrt((error**2).mean()) < (0.09 if level == 0.02 or kind == "broken" else 0.03)


def test_what_moves_leaves_no_ghost():
    simulate = simulator()
    y, x = np.mgrid[:160, :160]
    wall = np.kron(np.random.default_rng(5).uniform(0.1, 0.4, (20, 20)), np.ones((8, 8)))
    scenes = [
        grey(np.where((y - 60) ** 2 + (x - 40 - 12 * k) ** 2 < 14**2, 0.9, wall))
        for k in range(COUNT)
    ]
    time = 0.1 * simulate.expose(scenes[0]).exposure_time
    frames = [simulate.expose(scene, time).frame(seed=3, first=k) for k, scene in enumerate(scenes)]
    sensor = frames[0].camera.sensor
    sigma = np.sqrt(
        frames[0].mean + sensor.read_sigma**2 + 1 / (12 * sensor.gain_dn_per_electron**2)
    )
    error = (merge_burst(simulate, frames).mean / COUNT - frames[0].mean) / sigma
    plain = np.mean(
        [(frame.raw - sensor.dark_level) / sensor.gain_dn_per_electron for frame in frames], axis=0
    )
    path = np.s_[44:76, 24:140]  # where the disc is, in one frame or another
    assert (
        np.abs(((plain - frames[0].mean) / sigma)[path]).mean() > 3
    )  # the ghosts that are not wanted
    # the reference's own noise is 1; weights fall to 0 at a squared difference of 2.5 - 1 of two variances, which pulls
    # by at most 0.25 sqrt(2 (1.5 + 0.25)) = 0.5 sigma near the disc's edges
    assert np.sqrt((error[path] ** 2).mean()) < 1.1
    # blocks of 16 x 16: noise averages to 1/16, so that a ghost of a third of a sigma is seen
    blocks = error[44:76, 24:136].reshape(2, 16, 7, 16).mean(axis=(1, 3))
    assert np.abs(blocks).max() < 0.33
    away = error[100:150, 10:150]
    assert away.std() == pytest.approx(1 / np.sqrt(COUNT), rel=0.07)  # 7000 values; as at rest


@pytest.mark.parametrize("count", [2, 4, 8])
def test_a_burst_goes_into_its_merge(count):
    """An n-th of the variance of one frame, which is that of photons, reading and rounding.

    11520 values tell it to sqrt(2 / 11520) = 1.3 %, 4.5 of these; and 4 % for frames that look different by chance, and
    for displacements chosen by their noise, 2 % of a deviation as above.
    """
    simulate, scene = simulator(), seen((0, 0))
    merged = gs.merge_burst(simulate, gs.burst(simulate, scene, count, seed=1))
    truth, sensor = numbers(simulate.expose(scene), simulate), simulate.camera.sensor
    known = truth + sensor.read_sigma**2 + 1 / (12 * sensor.gain_dn_per_electron**2)
    error = ((merged.mean / count - truth) / np.sqrt(known / count))[24:-24, 24:-24]
    assert (error**2).mean() == pytest.approx(1, rel=4.5 * np.sqrt(2 / error.size) + 0.04)


@pytest.mark.parametrize("kind", ["flat", "blocks"])
@pytest.mark.parametrize(
    ("period", "level", "count"),
    [((1, 1), 250, 16), ((1, 1), 20, 2), ((2, 2), 250, 16), ((4, 4), 250, 4), ((6, 6), 20, 16)],
)
def test_noise_moves_nothing_at_rest(kind, period, level, count):
    """An n-th of the variance, with sharp edges and without, for any mosaic.

    192^2 values tell it to sqrt(2 / 36864) = .7 %, 4 of these; frames that look different by chance cost less than 1 %.
    """
    random = np.random.default_rng(3)
    light = np.full((224, 224), float(level))
    if kind == "blocks":  # edges in all places of the period
        light = np.kron(random.uniform(0.2, 2, (32, 32)), np.ones((7, 7))) * level
    electrons = random.poisson(light, (count, 224, 224)) + 2.5 * random.standard_normal(
        (count, 224, 224)
    )
    raw = np.rint(64 + 4 * electrons).astype(np.uint16)
    made = average(
        raw,
        align(raw, period=period, device="opencl"),
        period=period,
        black_level=64.0,
        noise=(4.0, np.hypot(10, 12**-0.5)),
        device="opencl",
    )
    error = (made - 64 - 4 * light) / np.sqrt((16 * (light + 2.5**2) + 1 / 12) / count)
    assert (error[16:-16, 16:-16] ** 2).mean() == pytest.approx(1, abs=0.04)


@pytest.mark.parametrize("level", [20, 250])
def test_faint_tiles_follow_their_surroundings(level):
    """A shaken frame of texture as strong as a few deviations of noise: every tile inside is found to half a period."""
    random = np.random.default_rng(5)
    wide = np.kron(random.uniform(0.3, 1.7, (36, 36)), np.ones((8, 8))) * level
    shifts = [(0, 0), (6, -10), (-8, 4), (12, 12)]
    light = np.array([wide[16 + y : 272 + y, 16 + x : 272 + x] for y, x in shifts])
    raw = np.rint(
        64 + 4 * (random.poisson(light) + 2.5 * random.standard_normal(light.shape))
    ).astype(np.uint16)
    found = align(raw, device="opencl")[1:, 1:-1, 1:-1]
    assert np.abs(found + np.array(shifts[1:])[:, None, None] / 2).max() < 0.5


def test_burst_collects_what_its_exposures_add_up_to():
    _, frames = burst("still", 0.02)
    frame = merge_burst(simulator(), frames)
    assert frame.exposure_time == pytest.approx(COUNT * frames[0].exposure_time)
    total, one = float(frame.mean.mean()), float(frames[0].mean.mean())
    # 24576 pixels of sqrt(8 (27 + 30)) e-: 0.14 e- of 213
    assert total == pytest.approx(
        COUNT * one, abs=4.5 * np.sqrt(COUNT * (one + 30) / frame.mean.size)
    )
    back = (frame.raw - 1024.0) / frame.camera.sensor.gain_dn_per_electron
    assert (
        np.abs(back - frame.mean).max() <= 0.51 * frame.camera.sensor.full_well / 64511
    )  # half a step
    # the same picture as one frame's, in the mean
    assert frame.linear.mean() == pytest.approx(frames[0].linear.mean(), rel=0.02)


def test_burst_of_the_dark_is_dark():
    simulate = processed({"exposure_time": 0.05}, {"dark_current": 2000.0})
    frame = merge_burst(simulate, list(simulate.frames(grey(np.full((64, 64), 1e-6)), COUNT)))
    # 8 x 100 e- of dark current off; 4096 pixels of sqrt(8 (100 + 28)) e- of noise
    assert abs(frame.mean.mean()) < 4.5 * np.sqrt(8 * 128) / 64 + 0.1  # and the light of 1e-6


def test_burst_knows_all_noise(monkeypatch):
    """Rows, columns and offsets are not at rest when a frame is moved."""
    told = {}
    monkeypatch.setattr(
        regression, "average", lambda *args, **known: told.update(known) or average(*args, **known)
    )
    simulate = processed({"exposure_time": 1e-4}, {"row": 6.0, "column": 8.0, "dsnu": 10.0})
    frames = list(simulate.frames(grey(np.full((128, 128), 1e-6)), COUNT))
    merge_burst(simulate, frames)
    variance = np.mean([frame.raw.var() for frame in frames])
    # of 225 e-2: 36 by 1024 rows, 64 by as many columns, 100 by 16384 pixels scatter by 1.6, 2.8 and 1.1: 1.5 %;
    # without rows it is 16 % less
    assert told["noise"][1] ** 2 == pytest.approx(variance, rel=0.07)
    assert told["noise"][0] == pytest.approx(simulate.camera.sensor.gain_dn_per_electron)


def test_burst_of_binned_numbers_averages_the_dark_current_s_noise():
    """Means of 4 digital numbers have a quarter of it: what is said of the dark is the scatter of the dark's electrons.

    Of 100 e- of dark current and 30 of reading, 8 frames: 32 x 32 values scatter by sqrt(2 / 1024) = 4.4 % of the
    variance, and 2 % more is left where displacements follow the noise (as at rest). With all of the dark current's
    noise it would be 3.3 times as large.
    """
    simulate = processed(
        {"exposure_time": 0.05, "binning": (2, 2), "binning_mode": "digital"},
        {"dark_current": 2000.0, "dsnu": 0.0},
    )
    frame = merge_burst(simulate, list(simulate.frames(grey(np.full((128, 128), 1e-6)), COUNT)))
    assert simulate.readout.averaged == 4
    said = frame.camera.sensor.noise.read**2 / 4
    assert frame.mean.var() == pytest.approx(said, rel=4.5 * np.sqrt(2 / frame.mean.size) + 0.02)


# --- flash ------------------------------------------------------------------------------------------------------------


def dim_and_lit(name="colorchecker", shadow=None, level=0.05):
    """Simulator, frames without and with flash, and the noise-free picture of the former.

    The room has incandescent light, the flash fifty times as much daylight; shadow: pixels that the flash misses.
    """
    scene = gs.chart(name, size=(240, 160))
    nodes, warm = scene.illuminant.wavelengths, photons_from_energy(illuminant("A"))
    warm = Spectrum(nodes, warm.at(nodes) / warm.at(nodes).max() * scene.illuminant.values.max())
    dim = dataclasses.replace(scene, illuminant=warm)
    lit = dataclasses.replace(
        scene, illuminant=Spectrum(nodes, warm.values + 50 * scene.illuminant.values)
    )
    if shadow is not None:
        shading = scene.content.shading * np.float32(np.where(shadow, 1.0, 51.0))
        lit = dataclasses.replace(dim, content=dataclasses.replace(scene.content, shading=shading))
    simulate = simulator()
    time = level * simulate.expose(dim).exposure_time
    ambient = simulate.expose(dim, time).frame(seed=1)
    flash = simulate.expose(lit).frame(seed=2)
    clean = Simulator(
        dataclasses.replace(
            simulate.camera,
            sensor=dataclasses.replace(
                simulate.camera.sensor, bits=16, noise=gs.Noise(photon="none")
            ),
        ),
        device="opencl:0",
    )
    return simulate, ambient, flash, clean.expose(dim, time).frame().linear


def psnr(picture, truth):
    return -10 * np.log10(np.mean((picture - truth)[8:-8, 8:-8] ** 2))


@pytest.mark.parametrize(("name", "gained"), [("colorchecker", 1.5), ("deadleaves", 0.7)])
def test_flash_picture_denoises_better_than_the_picture_itself(name, gained):
    simulate, ambient, flash, truth = dim_and_lit(name)
    denoised = merge_flash(simulate, ambient, flash)
    noise = _display_noise(ambient)
    # the same filter led by the ambient picture alone is a bilateral filter: the mask takes its own means
    planes = np.moveaxis(ambient.linear, -1, 0)
    plain = max(
        psnr(
            np.moveaxis(
                with_flash(
                    planes,
                    planes,
                    ambient_noise=noise,
                    flash_noise=noise,
                    radius=8,
                    reach=reach,
                    device="opencl:0",
                ),
                0,
                -1,
            ),
            truth,
        )
        for reach in (3, 6, 12)
    )
    assert psnr(denoised.linear, truth) > plain + gained
    assert psnr(denoised.linear, truth) > psnr(ambient.linear, truth) + 5
    assert denoised.rgb.shape == ambient.rgb.shape and denoised.raw is ambient.raw


def test_shadows_of_the_flash_are_not_in_the_picture():
    shadow = np.zeros((160, 240), bool)
    shadow[40:120, 60:140] = True
    simulate, ambient, flash, truth = dim_and_lit(shadow=shadow)
    error = merge_flash(simulate, ambient, flash).linear - truth
    before = (ambient.linear - truth)[35:125, 55:145].std()
    rim = np.zeros_like(shadow)
    rim[37:123, 57:143] = True
    rim[43:117, 63:137] = False
    assert error[rim].std() < 0.7 * before  # less noise there, too, and no outline:
    # 996 pixels of correlated noise, as if of 100: its mean is known to a tenth
    assert np.abs(error[rim].mean(axis=0)).max() < 0.3 * before
    assert error[50:110, 70:130].std() < 0.6 * before


# --- bad input --------------------------------------------------------------------------------------------------------


def test_bad_input_is_refused():
    simulate = simulator()
    frames = gs.bracket(simulate, grey(np.full((40, 40), 0.5)), (0, 1))
    small = next(simulate.frames(grey(np.full((20, 40), 0.5)), 1))
    for together in (merge_bracket, merge_burst):
        for wrong, text in (
            (frames[:1], "1 frame"),
            ([], "0 frame"),
            ([frames[0], small], "of the shape of frame 0"),
        ):
            with pytest.raises(BadData, match=text):
                together(simulate, wrong)
        other = dataclasses.replace(frames[1], camera=camera(black_level=60))
        with pytest.raises(BadData, match=r"another camera.*black_level"):
            together(simulate, [frames[0], other])
        for time in (0.0, np.nan, np.inf):
            with pytest.raises(OutOfRange, match="exposure_time of frame 1"):
                together(simulate, [frames[0], dataclasses.replace(frames[1], exposure_time=time)])
        floats = dataclasses.replace(frames[1], raw=np.full((40, 40), np.nan, np.float32))
        with pytest.raises(BadData, match="float32"):
            together(simulate, [frames[0], floats])
    with pytest.raises(BadData, match="converter"):
        analog = Simulator(camera(bits=32), device="opencl:0")
        merge_bracket(analog, gs.bracket(analog, grey(np.full((8, 8), 0.5)), (0, 1)))
    full = [dataclasses.replace(frame, raw=np.full((40, 40), 1023, np.uint16)) for frame in frames]
    with pytest.raises(BadData, match="every pixel is full"):
        merge_bracket(simulate, full)
    for wrong in (0, "x", np.nan):
        with pytest.raises(OutOfRange, match="full_scale"):
            merge_bracket(simulate, frames, full_scale=wrong)
    for wrong, text in (([1, 2], "frame 0 is of type int"), (5, "wanted a list")):
        for together in (merge_bracket, merge_burst):
            with pytest.raises(BadData, match=text):
                together(simulate, wrong)
    with pytest.raises(BadData, match="frame 1 is of type str"):
        merge_flash(simulate, frames[0], "flash")
    binned = processed({"binning": (2, 2), "binning_mode": "digital"})
    blind = gs.bracket(binned, grey(np.full((80, 80), 0.5)), (0, 1))
    with pytest.raises(BadData, match=r'digital binning.*"charge"'):
        merge_bracket(binned, [dataclasses.replace(frame, full=None) for frame in blind])
    with pytest.raises(OutOfRange, match="falling from frame to frame"):
        merge(
            np.zeros((2, 4, 4), np.uint16),
            dark=[0, 0],
            gain=[16, 1],
            time=[1, 1],
            floor=[9, 9],
            ceiling=[1000, 1000],
            device="opencl:0",
        )
    with pytest.raises(BadData, match="exposure time or gain"):
        merge_burst(simulate, frames)
    same = [frames[0], frames[0]]
    for wrong in (2, "a", 0.5):
        with pytest.raises(OutOfRange, match="reference"):
            merge_burst(simulate, same, reference=wrong)
    with pytest.raises(BadData, match="NaN"):
        broken = dataclasses.replace(frames[1], linear=np.full((3, 40, 40), np.nan, np.float32))
        merge_flash(simulate, frames[0], broken)
    with pytest.raises(BadData, match="of the shape of frame 0"):
        merge_flash(simulate, frames[0], small)
    for wrong in (
        {"radius": 0},
        {"radius": 13},
        {"radius": 2.5},
        {"radius": "x"},
        {"reach": 0},
        {"reach": np.nan},
    ):
        with pytest.raises(OutOfRange, match=next(iter(wrong))):
            merge_flash(simulate, *frames, **wrong)
