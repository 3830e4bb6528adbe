"""Loops whose frames differ only in scene and frame start the last commands again: bits are those of a new loop."""

from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS

import gpusim as gs
from gpusim.backends.buffers import Command
from gpusim.domain.errors import BadData, OutOfMemory
from gpusim.domain.scene import View

ROWS, COLS, SECONDS = 30, 44, 0.01
# On Warp's processor the blur is SciPy's work on the host, between kernels: no commands make it again
ON_HOST = "warp:cpu"
REPEATING = [kind for kind in KINDS if ON_HOST not in (kind, *getattr(kind, "values", ()))]


def scenes(kind):
    """Five scenes that one plan serves."""
    chart, random = gs.chart("deadleaves", size=(COLS, ROWS)), np.random.default_rng(3)
    if kind == "cube":
        bands = chart.content.bands_at(slice(None)).astype(np.float32)
        made = [gs.Cube(chart.wavelengths, bands * np.float32(1 + 0.1 * k)) for k in range(5)]
        return [replace(chart, content=one) for one in made]
    if kind == "materials":
        content = chart.content
        shading = [np.float32(1 - 0.1 * k) * content.shading for k in range(5)]
        return [replace(chart, content=replace(content, shading=one)) for one in shading]
    if kind == "picture":
        codes = random.integers(0, 256, (5, ROWS, COLS, 3), np.uint8)
        return [gs.picture(one) for one in codes]
    moves = [View(shift=(0.3 * k, 0.7 - 0.2 * k), rotation=0.01 * k) for k in range(5)]
    if kind == "zooms":
        moves = [replace(view, zoom=1 + 0.01 * k) for k, view in enumerate(moves)]
    if kind == "picture views":
        chart = gs.picture(random.integers(0, 256, (ROWS, COLS, 3), np.uint8))
    return [replace(chart, view=view) for view in moves]


def open_phone(device, tolerance=4e-4):
    """Return a simulator whose blur is made by kernels only."""
    return gs.Simulator(gs.open_camera("phone"), device=device, tolerance=tolerance)


def repeat_loop(simulator, given):
    """Return a loop that has made a raw frame of each scene, the last ones by repeated commands, and its plan."""
    plan = simulator.plan(given[0])
    loop = simulator.loop(given[0], SECONDS, plan=plan)
    for number, scene in enumerate(given):
        loop.update(scene=scene).raw(first=number)
    assert loop._repeat is not None and loop._repeat.is_current
    return loop, plan


def host(simulator, array):
    return np.array(simulator.device.numpy(array))


@pytest.mark.parametrize(
    "kind", ["cube", "materials", "picture", "views", "picture views", "zooms"]
)
@pytest.mark.parametrize("output", ["raw", "codes", "mean"])
@pytest.mark.parametrize("device", KINDS)
def test_a_frame_that_repeats_the_last_has_the_bits_of_a_new_loop(kind, output, device):
    simulator, given = open_phone(device), scenes(kind)
    plan = simulator.plan(given[0])
    loop, order = simulator.loop(given[0], SECONDS, plan=plan), (0, 1, 2, 3, 4, 4, 1, 1, 0, 2, 0)
    started = 0
    for number, which in enumerate(order):
        loop.update(scene=given[which])
        found = host(simulator, loop.output(output, seed=7, first=number))
        started += loop._repeat is not None and loop._repeat.is_current
        one = simulator.loop(given[which], SECONDS, plan=plan)
        np.testing.assert_array_equal(
            found, host(simulator, one.output(output, seed=7, first=number)), f"frame {number}"
        )
    if kind == "picture":
        return  # kernels take its codes from its content: what is repeated is another frame of the same scene
    # a zoom is a number
    least = 0 if device == ON_HOST else {"zooms": 1}.get(kind, 8)
    assert least <= started <= (0 if device == ON_HOST else len(order))


@pytest.mark.parametrize("device", KINDS)
def test_what_is_asked_for_after_a_repeated_frame_is_that_scene_s(device):
    """Other outputs, exposures and frames between repeated outputs; each is compared with a new loop."""
    simulator, given = open_phone(device), scenes("cube")
    plan = simulator.plan(given[0])
    loop = simulator.loop(given[0], SECONDS, plan=plan)
    for number, which in enumerate((0, 1, 2, 3, 4, 0, 3, 1, 2)):
        scene = given[which]
        loop.update(scene=scene).raw(first=number)
        if number < 4:
            continue
        one = simulator.loop(scene, SECONDS, plan=plan)
        if number % 2:
            mean, wanted = loop.exposure.mean, one.exposure.mean
        else:
            mean, wanted = loop.codes(first=number), one.codes(first=number)
        np.testing.assert_array_equal(host(simulator, mean), host(simulator, wanted))
        found, wanted = (host(simulator, each.raw(first=number)) for each in (loop, one))
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("device", REPEATING)
def test_a_first_scene_again_is_not_taken_for_the_last(device):
    """The caches hold keys of the frames before the repeated ones: these must not count as equal."""
    simulator, given = open_phone(device), scenes("cube")
    # the third is collected, two are repeated
    loop, plan = repeat_loop(simulator, [given[which] for which in (1, 2, 0, 3, 4)])
    found = host(simulator, loop.update(scene=given[0]).codes(first=9))
    wanted = simulator.loop(given[0], SECONDS, plan=plan).codes(first=9)
    np.testing.assert_array_equal(found, host(simulator, wanted))


@pytest.mark.parametrize("device", REPEATING)
def test_another_picture_is_not_drawn_by_the_commands_of_the_last(device):
    """Views of a picture repeat its commands, which have its codes: another one is computed by its steps."""
    simulator, views = open_phone(device), scenes("picture views")
    loop, plan = repeat_loop(simulator, views)
    others = [replace(one, view=views[3].view) for one in scenes("picture")]
    for number, scene in enumerate([others[1], views[1], others[2], others[3]]):
        found = host(simulator, loop.update(scene=scene).raw(first=number))
        wanted = simulator.loop(scene, SECONDS, plan=plan).raw(first=number)
        np.testing.assert_array_equal(found, host(simulator, wanted))


@pytest.mark.parametrize("device", REPEATING)
def test_repeated_scenes_are_measured(device):
    """Light that is not finite is found in the next frame, and a scene that needs more planes gets them."""
    simulator, given = open_phone(device, 1e-4), scenes("cube")
    loop = simulator.loop(given[0], SECONDS)
    for number in range(12):
        loop.update(scene=given[number % 5]).raw(first=number)
    assert loop._repeat is not None and loop._repeat.is_current
    bands = np.array(given[0].content.planes)
    bands[3, 5, 6] = np.nan
    pinned = simulator.device.pinned(bands.shape)  # its values are checked by the device only
    pinned[...] = bands
    loop.update(scene=replace(given[0], content=gs.Cube(given[0].wavelengths, pinned))).raw()
    with pytest.raises(BadData, match="NaN or infinite"):
        loop.update(scene=given[1]).raw()
    found = host(simulator, loop.update(scene=given[2]).raw(first=3))
    assert np.isfinite(found).all()


@pytest.mark.parametrize("device", KINDS)
def test_each_fixed_exposure_has_its_own_commands(device):
    simulator, given = open_phone(device), scenes("cube")
    plan = simulator.plan(given[0])
    loop = simulator.loop(given[0], SECONDS, plan=plan)
    for number in range(14):
        seconds = SECONDS if number < 7 else 2 * SECONDS
        scene = given[number % 5]
        found = loop.update(scene=scene, exposure_time=seconds).raw(first=number)
        wanted = simulator.loop(scene, seconds, plan=plan).raw(first=number)
        np.testing.assert_array_equal(host(simulator, found), host(simulator, wanted))


@pytest.mark.parametrize("device", REPEATING)
def test_a_scene_that_was_begun_but_not_exposed_is_measured_with_the_next(device):
    """The view after it changes less than it did: what only the content changes must not be left out."""
    simulator, given = open_phone(device), scenes("materials")
    moved = [replace(scene, view=View(shift=(0.4, 0.1 * k))) for k, scene in enumerate(given)]
    loop, plan = repeat_loop(simulator, moved)
    loop.update(scene=moved[1]).begin(first=7)
    last = replace(moved[1], view=View(shift=(0.3, 0.2)))
    found = host(simulator, loop.update(scene=last).raw(first=5))
    wanted = simulator.loop(last, SECONDS, plan=plan).raw(first=5)
    np.testing.assert_array_equal(found, host(simulator, wanted))


def test_what_is_kept_of_a_repeated_frame_is_made_again_for_the_next():
    """A batch keeps its array while its frames are the same: a rewritten frame is another one."""
    simulator, given = open_phone("opencl"), scenes("cube")
    plan = simulator.plan(given[0], exposure_time=SECONDS)
    batch = simulator.batch(1, "raw", plan=plan)
    for number, which in enumerate((0, 1, 2, 3, 4, 1)):
        found = host(simulator, batch(given[which], exposure_time=SECONDS, first=number))
        one = simulator.loop(given[which], SECONDS, plan=plan).raw(first=number)
        np.testing.assert_array_equal(found[0], host(simulator, one))
    assert batch._items[0]._repeat.is_current


@pytest.mark.parametrize("other", [None, "seed", "output", "scene"])
def test_a_frame_that_was_begun_is_the_one_that_is_asked_for(other):
    """Or is made again: with another seed, for another output, or of another scene."""
    simulator, given = open_phone("opencl"), scenes("cube")
    loop, plan = repeat_loop(simulator, given)
    loop.update(scene=given[1]).begin(seed=4, first=7)
    scene, seed = given[2 if other == "scene" else 1], 5 if other == "seed" else 4
    output = "codes" if other == "output" else "raw"
    found = host(simulator, loop.update(scene=scene).output(output, seed=seed, first=7))
    one = simulator.loop(scene, SECONDS, plan=plan).output(output, seed=seed, first=7)
    np.testing.assert_array_equal(found, host(simulator, one))


@pytest.mark.parametrize("stage", ["spectral.", "optics.", "sensor."])
def test_what_fails_while_it_is_begun_is_made_again(stage, monkeypatch):
    """Memory that is refused once: nothing of the frame that was half written is used."""
    simulator, given = open_phone("opencl"), scenes("cube")
    loop, plan = repeat_loop(simulator, given)
    start = Command.start

    def fails_once(self):
        if self.stage.startswith(stage):
            monkeypatch.setattr(Command, "start", start)
            raise MemoryError
        start(self)

    monkeypatch.setattr(Command, "start", fails_once)
    with pytest.raises(OutOfMemory):
        loop.update(scene=given[1]).begin(first=7)
    found = host(simulator, loop.raw(first=7))
    wanted = simulator.loop(given[1], SECONDS, plan=plan).raw(first=7)
    np.testing.assert_array_equal(found, host(simulator, wanted))


@pytest.mark.parametrize("device", REPEATING)
def test_values_by_name_after_a_repeated_exposure_are_that_scene_s(device):
    simulator, given = open_phone(device), scenes("cube")
    loop, plan = repeat_loop(simulator, given)
    exposure = loop.update(scene=given[1]).expose()
    one = simulator.loop(given[1], SECONDS, plan=plan)
    for found, wanted in (
        (exposure.mean, one.exposure.mean),
        (loop.values["electrons"], one.output("electrons")),
        (loop.frame(first=3).rgb, one.frame(first=3).rgb),
    ):
        np.testing.assert_array_equal(host(simulator, found), host(simulator, wanted))
