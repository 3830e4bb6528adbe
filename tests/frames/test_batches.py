"""Items of a batch are the frames of loops of their own; what they have in common is computed once."""

from dataclasses import replace

import cameras
import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import ALL_KINDS, KINDS

import gpusim as gs
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange, UnknownName

SIZE, COUNT = (96, 64), 3


def cubes(count=COUNT, size=SIZE):
    return cameras.cubes(count, size)


def host(device, array):
    return np.array(device.numpy(array))


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("output", ["irradiance", "electrons", "mean", "raw", "linear", "codes"])
def test_items_of_several_scenes(device, output):
    """Cubes in a known light have one operator, so that every scene's own plan is the batch's."""
    simulator, scenes = gs.Simulator(PHONE, device=device, tolerance=4e-4), cubes()
    batch, loops = (
        simulator.batch(COUNT, output),
        [simulator.loop(scene, 0.01) for scene in scenes],
    )
    for first in (0, 5, 9):
        order = [(first + item) % COUNT for item in range(COUNT)]
        found = host(
            simulator.device,
            batch([scenes[n] for n in order], seed=3, first=first, exposure_time=0.01),
        )
        for item, n in enumerate(order):
            own = loops[n].output(output, seed=3, first=first + item)
            np.testing.assert_array_equal(found[item], host(simulator.device, own))


CAMERAS = {
    "noise": [
        camera_with(noise={"read": read, "prnu": 0.01, "seed": chip})
        for read, chip in ((1, 0), (9, 0), (1, 3))
    ],
    "white point": [
        camera_with(processor={"white_balance": way})
        for way in ("illuminant", "gray-world", "none")
    ],
    "sharpening": [camera_with(processor={"sharpen": s}) for s in (1.0, 0.0, 2.0)],
    "lens": [camera_with(optics={"f_number": n}) for n in (2.0, 4.0, 2.0)],
    "pixels": [
        camera_with(sensor={"binning": (2, 2), "binning_mode": mode})
        for mode in ("charge", "digital", "charge")
    ],
    "tone": [
        camera_with(processor={"tone": ((0, 0), (0.4, top), (1, 1))}) for top in (0.4, 0.5, 0.6)
    ],
}


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("what", CAMERAS)
def test_items_of_several_settings(device, what):
    """Of scenes that change between the calls, and of settings that go to other items."""
    cameras, scenes = CAMERAS[what], cubes(2)
    count = len(cameras)
    simulator = gs.Simulator(PHONE, device=device, tolerance=4e-4)
    batch = simulator.batch(count, "codes")
    times, gains, seeds = [0.01, 0.03, 0.005][:count], [1.0, 1.0, 2.0][:count], [4, 4, 7][:count]
    for turn, scene in enumerate([scenes[0], scenes[1], scenes[1], scenes[0]]):
        found = host(
            simulator.device,
            batch(
                scene,
                camera=cameras,
                exposure_time=times,
                gain=gains,
                seed=seeds,
                first=[turn] * count,
            ),
        )
        for item, camera in enumerate(cameras):
            own = gs.Simulator(camera, device=device, tolerance=4e-4).loop(
                scene, times[item], gains[item]
            )
            np.testing.assert_array_equal(
                found[item], host(own.simulator.device, own.codes(seed=seeds[item], first=turn))
            )
        if turn == 2:
            cameras, times = cameras[::-1], times[::-1]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_item_is_exposed_by_its_own_light(device):
    simulator, scenes = gs.Simulator(PHONE, device=device), cubes()
    assert PHONE.sensor.exposure_time is None
    found = host(simulator.device, simulator.batch(COUNT, "raw")(scenes, seed=2, first=[0, 1, 2]))
    for item, scene in enumerate(scenes):
        np.testing.assert_array_equal(found[item], simulator(scene, seed=2, first=item).raw)


@pytest.mark.parametrize("device", KINDS)
def test_common_steps_run_once_and_the_host_reads_nothing(device):
    simulator, scenes = gs.Simulator(PHONE, device=device, tolerance=4e-4), cubes(4)
    batch = simulator.batch(4, "codes")
    seconds = [0.01, 0.02, 0.03, 0.04]
    for scene in scenes:
        batch(scene, exposure_time=seconds)

    def stages(what, seed):
        with simulator.device.timed() as ms:
            batch(what, exposure_time=seconds, seed=seed)
        return {*ms}

    anew, blurs = (
        replace(scenes[0], name="again"),
        {"optics.mosaic", "optics.tiles"},
    )  # by what devices are fast at
    made = stages(anew, seed=9)
    assert {"spectral.integrate", "sensor.noise"} <= made and len(blurs & made) == 1
    assert stages(anew, seed=9) == set()
    drawn = stages(anew, seed=10)
    assert "sensor.noise" in drawn
    assert not {"spectral.integrate", *blurs, "sensor.collect", "sensor.chip"} & drawn
    assert batch._cache.host_accesses() == []
    assert all(loop.values.unexpected_host_accesses() == [] for loop in batch._items)
    assert len({id(loop.before) for loop in batch._items}) == 1


@pytest.mark.parametrize("device", ALL_KINDS)
def test_light_that_is_not_finite_is_named(device):
    simulator, scenes = gs.Simulator(PHONE, device=device), cubes()
    values = scenes[1].content.values.view(gs.domain.memory.Pinned)
    values[3, 20, 30] = np.nan
    scenes[1] = replace(
        scenes[1], content=gs.Cube(scenes[1].wavelengths, values), name="the second"
    )
    batch = simulator.batch(COUNT, "raw")
    batch(scenes, exposure_time=0.01)
    with pytest.raises(BadData, match=r"the second: .* NaN or infinite light"):
        batch.judge()
    good = batch(cubes(), exposure_time=0.01, seed=1)
    own = simulator.loop(cubes()[0], 0.01).raw(seed=1)
    np.testing.assert_array_equal(host(simulator.device, good)[0], host(simulator.device, own))


def good_and_damaged():
    """A scene, and one like it with light that is not finite and not looked at on the host."""
    good = cubes(1)[0]
    values = good.content.values.copy().view(gs.domain.memory.Pinned)
    values[3, 20, 30] = np.nan
    return good, replace(good, content=gs.Cube(good.wavelengths, values), name="the damaged one")


@pytest.mark.parametrize("device", ALL_KINDS)
def test_light_that_is_not_finite_is_refused_again(device):
    good, damaged = good_and_damaged()
    loop = gs.Simulator(PHONE, device=device).loop(good, 0.01)
    loop.codes()
    loop.update(scene=damaged)
    for _ in range(3):
        with pytest.raises(BadData, match="the damaged one"):
            loop.codes()
            loop.judge()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_an_item_saw_is_judged_where_its_lens_changes(device):
    good, damaged = good_and_damaged()
    wide, narrow = (camera_with(optics={"f_number": n}) for n in (2.0, 4.0))
    batch = gs.Simulator(PHONE, device=device).batch(2, "raw")
    batch(good, camera=wide, exposure_time=0.01)
    batch([damaged, good], camera=wide, exposure_time=0.01)
    with pytest.raises(BadData, match="the damaged one"):
        batch(good, camera=[narrow, wide], exposure_time=0.01)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("place", range(COUNT))
def test_each_item_is_judged_by_its_own_statistics(device, place):
    """Items share the array of their surveys: each is read before the next item writes to it."""
    scenes = cubes()
    batch = gs.Simulator(PHONE, device=device, tolerance=1e-3).batch(COUNT, "raw")
    batch(scenes, exposure_time=0.01)
    values = np.zeros_like(scenes[0].content.values)
    values[24] = scenes[0].content.values.sum(axis=0)
    scenes[place] = replace(scenes[0], content=gs.Cube(scenes[0].wavelengths, values))
    batch(scenes, exposure_time=0.01)
    batch.judge()
    drifts = [loop._drift for loop in batch._items]  # None: of the scene that was planned for
    assert [drift is not None and drift > 1e-3 for drift in drifts] == [
        item == place for item in range(COUNT)
    ]


def test_refuses(monkeypatch):
    simulator, scenes = gs.Simulator(PHONE, device="numpy"), cubes()
    with pytest.raises(UnknownName, match="output"):
        simulator.batch(2, "film")
    for count in (0, -1, 2.5, "3", 10**9):
        with pytest.raises(OutOfRange, match="count of a batch"):
            simulator.batch(count)
    batch = simulator.batch(COUNT, "raw")
    with pytest.raises(BadData, match="2 of scenes, wanted one for all items or 3"):
        batch(scenes[:2])
    with pytest.raises(BadData, match="2 of seed, wanted one"):
        batch(scenes, seed=[1, 2])
    with pytest.raises(OutOfRange, match="exposure_time = long s"):
        batch(scenes, exposure_time=["long"] * COUNT)
    with pytest.raises(BadData, match="wanted a Scene"):
        batch([1, 2, 3])
    with pytest.raises(BadData, match="scenes of 60x40, 96x64 pixels; wanted one size"):
        batch([*scenes[:2], *cubes(1, (60, 40))])
    with pytest.raises(UnknownName, match="output"):
        simulator.batch(2, ["raw"])
    with pytest.raises(BadData, match="camera: str, wanted a Camera"):
        batch(scenes, camera="phone")
    with pytest.raises(OutOfRange, match="frame = None"):
        batch(scenes, first=None, exposure_time=0.01)
    binned = camera_with(sensor={"binning": (2, 2), "binning_mode": "charge"})
    with pytest.raises(BadData, match="wanted cameras whose frames have one shape"):
        batch(scenes, camera=[PHONE, binned, PHONE], exposure_time=0.01)
    monkeypatch.setattr(
        type(simulator.device), "memory", simulator.loop(scenes[0]).plan.bytes_needed + 1000
    )
    with pytest.raises(DoesNotFit, match="a batch of 1000 frames of 96x64"):
        simulator.batch(1000, "raw")(scenes[0], exposure_time=0.01)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("output", ["raw", "codes", "linear", "irradiance", "electrons"])
def test_batches_of_captures_have_four_axes_at_most(output, device):
    """Arrays of Warp have no more. The frames of an item follow each other; pictures have an axis of frames."""
    scene, burst = gs.chart("deadleaves", size=(64, 48)), gs.Burst(2)
    other = scene.content.with_samples(lambda array: np.roll(array, 9, -1))
    scenes, camera = (
        [scene, replace(scene, content=other)],
        camera_with(sensor={"exposure_time": 0.01}),
    )
    simulator = gs.Simulator(camera, device=device, tolerance="video")
    plan = simulator.plan(scene)
    joined = host(
        simulator.device, simulator.batch(2, output, capture=burst, plan=plan)(scenes, seed=3)
    )
    one = simulator.batch(1, output, plan=plan)
    for number, frame in enumerate(joined):
        own = host(simulator.device, one(scenes[number // 2], seed=3, first=number))
        assert np.array_equal(frame, own[0])
    assert joined.ndim <= 4 and len(joined) == 4
    light = np.random.default_rng(1).random((2, 1, 24, 32), np.float32)
    pictures = gs.PictureBatch(camera, device=device, output=output, capture=burst)(light)
    assert pictures.shape[:2] == (2, 2) and pictures.shape[-2:] == (24, 32)
    second = gs.PictureBatch(camera, device=device, output=output)(light[1:], first=2)
    assert np.array_equal(pictures[1, 0], second[0])
