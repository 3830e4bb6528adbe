"""One Simulator on several devices: frames in order, with the bits of one device, whatever ends their work.

Queues of PoCL are the devices: each has arrays, kernels and an order of its own, as GPUs have.
"""

import gc
import pickle
import re
import threading
import weakref
from dataclasses import replace
from itertools import count, pairwise

import cameras
import devices
import numpy as np
import pytest
from devices import KINDS
from PIL import Image

import gpusim as gs
from gpusim.apps.devices import run_together
from gpusim.backends import open_device, open_devices, probe
from gpusim.backends.buffers import Command
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.warp import WarpDevice
from gpusim.cli.main import main
from gpusim.domain.errors import BadData, DeviceError, GpusimError
from gpusim.pipeline import planning
from gpusim.planner.given import account_given

SIZE = (96, 64)
CAMERA = cameras.camera_with(noise={"prnu": 0.01})
QUEUES = pytest.mark.parametrize("queues", [2, 3])


@pytest.fixture(scope="module")
def name():
    """Name of PoCL's first device."""
    return open_device("opencl:pocl").name


def together(name, queues):
    return ",".join([name] * queues)


def pair_of_gpus():
    """Two of PoCL's queues as GPUs: memory apart from the host's, other groups, transfers on queues of their own."""
    return [devices.apart(), devices.apart()]


def taken(frames):
    return [np.array(frame) for frame in frames]


def odd(scene, band=24):
    """The scene with light of one band, for which a plan for likely spectra does not fit."""
    values = np.zeros_like(scene.content.values)
    values[band] = scene.content.values.sum(axis=0)
    return replace(scene, content=gs.Cube(scene.wavelengths, values), name="one band")


def course():
    """Scenes of a course with all that changes a stream: light, a misfit, a highlight, other kinds, a repetition."""
    leaves = cameras.cubes(4, SIZE)
    bright = cameras.cubes(1, SIZE)[0]
    bright.content.values[:, 30, 40] *= 1e6
    still = gs.chart("deadleaves", size=SIZE)
    return [
        *leaves,
        odd(leaves[0]),
        *leaves[:2],
        bright,
        gs.chart("colorchecker", size=(64, 48)),
        *leaves[2:],
        leaves[3],
        leaves[3],
        *(still.viewed(replace(still.view, shift=(0.3 * k, 0.1 * k))) for k in range(4)),
        leaves[0],
    ]


# ---- names


@pytest.mark.parametrize(
    "names, wanted",
    [
        ("{0},{0}", ["{0}", "{0}#2"]),
        ("{0}, {0} ,{0}", ["{0}", "{0}#2", "{0}#3"]),
        (["{0}", "{0}#2"], ["{0}", "{0}#2"]),
        ("{0}#2,{0}", ["{0}#2", "{0}"]),
        ("warp:cpu", ["warp:cpu"]),
        (["numpy"], ["numpy"]),
    ],
)
def test_names(names, wanted, name):
    if isinstance(names, str):
        names = names.format(name)
    else:
        names = [one.format(name) for one in names]
    found = open_devices(names)
    assert [device.name for device in found] == [one.format(name) for one in wanted]
    assert len({*map(id, found)}) == len(found)
    assert all(one is other for one, other in zip(found, open_devices(names), strict=True))
    assert gs.Simulator(CAMERA, device=names).devices == found
    assert open_devices(tuple(found)) == found
    assert open_devices(found[0]) == [found[0]]


@pytest.mark.parametrize(
    "names, words",
    [
        ("{0},warp:cpu", "{0} and warp:cpu are of different kinds, which give different bits"),
        ("numpy,{0}", "numpy and {0} are of different kinds"),
        ("warp:cpu,warp:cpu", "warp:cpu twice: only OpenCL devices have several queues"),
        ("numpy,numpy", "numpy twice"),
        ("{0},opencl:nothing", "no OpenCL device 'nothing'"),
        ("{0},cuda", "unknown device 'cuda'"),
        ("{0},", "unknown device ''"),
        ("", "unknown device ''"),
        ([], "wanted at least one name"),
        (["{0}", 3], "device: int, wanted a name"),
        ("{0}#1,{0}", "wanted the number of another queue"),
        ("{0}#,{0}", "wanted the number of another queue"),
        ("{0},gpus", "gpus: several devices, wanted one"),
    ],
)
def test_names_that_are_refused(names, words, name):
    if isinstance(names, str):
        names = names.format(name)
    else:
        names = [one.format(name) if isinstance(one, str) else one for one in names]
    with pytest.raises(DeviceError, match=re.escape(words.format(name))) as failure:
        gs.Simulator(CAMERA, device=names)
    assert "\n" not in str(failure.value)


def test_a_device_is_not_given_twice(name):
    device = open_device(name)
    with pytest.raises(DeviceError, match=f"{name} twice"):
        open_devices([device, device])


def entry(name, gpu=True, device="card A", driver="1", error=""):
    return probe.EMPTY | {
        "name": name,
        "gpu": gpu,
        "device": device,
        "driver": driver,
        "error": error,
    }


def test_gpus_are_the_best_one_and_all_of_its_make(monkeypatch):
    entries = [
        entry("numpy", gpu=False),
        entry("opencl:0", gpu=False, driver="9"),
        entry("opencl:1"),
        entry("opencl:2", device="card B"),
        entry("opencl:3"),
        entry("warp:cuda:0", driver="2"),
        entry("opencl:4", error="it fell off the bus"),
    ]
    monkeypatch.setattr(probe, "devices", lambda refresh=False: entries)
    monkeypatch.setattr("gpusim.backends.select.open_device", lambda name: name)
    assert open_devices("gpus") == ["opencl:1", "opencl:3"]
    entries[:] = [*entries[:2], *entries[-1:]]
    with pytest.raises(DeviceError) as failure:
        open_devices("gpus")
    assert str(failure.value) == "gpus: no GPU works here (opencl:4: it fell off the bus)"


def test_one_device_is_wanted_elsewhere(name):
    for names in (f"{name},{name}", "gpus"):
        with pytest.raises(DeviceError, match=f"{names}: several devices, wanted one"):
            open_device(names)


def test_a_simulator_is_pickled_with_its_devices(name):
    made = gs.Simulator(CAMERA, device=together(name, 2))
    assert pickle.loads(pickle.dumps(made)).devices == made.devices


# ---- streams


@QUEUES
@pytest.mark.parametrize("tolerance", [None, 1e-3])
@pytest.mark.parametrize("meters_late", [True, False])
def test_a_stream_has_the_bits_and_plans_of_one_device(name, queues, tolerance, meters_late):
    def made(device):
        simulator = gs.Simulator(CAMERA, device=device, tolerance=tolerance)
        stream = simulator.stream(course(), "codes", seed=3, first=7, meters_late=meters_late)
        found = []
        for frame in stream:
            plan = stream.plan
            found.append((frame.device.name, np.array(frame), plan.scene.name, plan.count))
        return found

    one, several = made(name), made(together(name, queues))
    assert len(one) == len(several) == len(course())
    for number, ((_, frame, *plan), (_, other, *its)) in enumerate(zip(one, several, strict=True)):
        np.testing.assert_array_equal(frame, other, err_msg=str(number))
        assert plan == its, number
    names = [device.name for device in open_devices(together(name, queues))]
    assert [where for where, *_ in several] == [
        names[number % queues] for number in range(len(several))
    ]


@pytest.mark.parametrize("output", ["mean", "raw", "irradiance", "linear"])
def test_outputs(name, output):
    one, two = (
        taken(
            gs.Simulator(CAMERA, device=device).stream(
                cameras.cubes(5, SIZE), output, seed=1, exposure_time=0.01
            )
        )
        for device in (name, together(name, 2))
    )
    for frame, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(frame, other)


@pytest.mark.parametrize("capture", [gs.Burst(2), gs.Burst(2, merged=True)])
def test_captures(name, capture):
    one, two = (
        taken(
            gs.Simulator(CAMERA, device=device).stream(
                cameras.cubes(5, SIZE), "raw", seed=1, capture=capture
            )
        )
        for device in (name, together(name, 2))
    )
    for frame, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(frame, other)


def test_a_given_plan_makes_all_frames(name):
    scenes = cameras.cubes(5, SIZE)
    plan = gs.Simulator(CAMERA, device=name, tolerance=1e-3).plan(scenes[0], exposure_time=0.01)
    one, two = (
        gs.Simulator(CAMERA, device=device, tolerance=1e-3).stream(
            [*scenes, odd(scenes[0])], "raw", exposure_time=0.01, plan=plan
        )
        for device in (name, together(name, 2))
    )
    for frame, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(np.array(frame), np.array(other))
    assert two.plan is plan


def test_a_device_has_work_while_the_one_before_is_at_work(monkeypatch):
    """The next scene is begun before the host waits for the statistics of the scene before.

    Its blur at first; the whole frame as soon as commands repeat, which is after three frames of each device.
    """
    log, fetch, start = [], OpenCLDevice.fetch, Command.start

    def fetched(self, array):
        wait = fetch(self, array)
        return lambda: (log.append(("wait", self)), wait())[1]

    def started(self):
        log.append((self.stage, self.device))
        start(self)

    monkeypatch.setattr(OpenCLDevice, "fetch", fetched)
    monkeypatch.setattr(Command, "start", started)
    simulator = gs.Simulator(CAMERA, device=pair_of_gpus())
    for _ in simulator.stream(cameras.cubes(14, SIZE), "raw", exposure_time=0.01):
        log.append(("frame", None))
    frames = [place for place, (what, _) in enumerate(log) if what == "frame"]
    for number, (begin, end) in enumerate(pairwise(frames[:-1]), 1):
        before, own = (simulator.devices[(number + k) % 2] for k in (1, 0))
        steps = log[begin + 1 : end]
        waits = [place for place, (what, _) in enumerate(steps) if what == "wait"]
        drawn = [device for what, device in steps if what == "sensor.noise"]
        if number == 1:  # the plan was made for the scene before: it needs no statistics
            assert not waits and drawn[-1] is own
            continue
        (wait,) = waits
        assert steps[wait][1] is before
        # this frame's blur was launched before the frame before was made: now that of the next is
        blurs = [place for place, (what, _) in enumerate(steps) if what.startswith("optics.")]
        assert blurs and max(blurs) < wait
        assert {steps[place][1] for place in blurs} == {before}
        if number < 6:
            assert drawn[-1] is own
        else:
            assert drawn == [before] and wait == len(steps) - 1


def test_devices_work_while_a_scene_is_probed(monkeypatch):
    """The frame of that scene and those on the other devices have been launched."""
    drawn, probed, start = [], [], Command.start

    def started(self):
        drawn.extend([self.device] * (self.stage == "sensor.noise"))
        start(self)

    def judged(plan, question, *args):
        probed.append((question.scene.name, len(drawn)))
        return account_given(plan, question, *args)

    monkeypatch.setattr(Command, "start", started)
    monkeypatch.setattr(planning, "account_given", judged)
    scenes = [cameras.again(one, str(k)) for k, one in enumerate(cameras.cubes(1, SIZE) * 20)]
    simulator = gs.Simulator(CAMERA, device=pair_of_gpus(), tolerance=1e-3)
    for _ in simulator.stream(scenes, "raw", exposure_time=0.01):
        pass
    assert [name for name, _ in probed] == ["1", "5", "18"]
    assert probed[-1][1] == 18 + 2  # before, nothing repeats yet


@QUEUES
@pytest.mark.parametrize("at", [18, 13])  # a scene that is probed, and one that is surveyed
@pytest.mark.parametrize("device", KINDS)
def test_a_scene_that_a_plan_misses_is_made_again(device, queues, at):
    """Also if its frame, or those behind it, had been launched by the plan that was dropped."""
    (usual,) = cameras.cubes(1, SIZE)
    strange = odd(usual)
    if device.startswith(
        "warp"
    ):  # on processors a blur is no command that repeats: here it is left out
        mean = usual.content.values.mean((1, 2), keepdims=True)
        flat = np.ascontiguousarray(np.broadcast_to(mean, usual.content.values.shape))
        content = gs.Cube(usual.wavelengths, flat)
        usual, strange = replace(usual, content=content), replace(usual, name="edges")
    scenes = [strange if k == at else cameras.again(usual, str(k)) for k in range(28)]
    found = []
    for several in (1, queues):
        simulator = gs.Simulator(gs.open_camera("phone"), device=device, tolerance=1e-3)
        if device.startswith("warp"):  # its processor has one name
            more = [WarpDevice("cpu", device) for _ in range(several - 1)]
            simulator.devices = [simulator.device, *more]
        else:
            simulator.devices = open_devices(together(device, several))
        stream = simulator.stream(scenes, "raw", seed=2, exposure_time=0.01)
        found.append([(np.array(frame), stream.plan.scene.name) for frame in stream])
    one, several = found
    plans = [name for _, name in one]
    replaced = at if at == 18 else at + 1  # the frame itself, or the one after it
    assert plans == ["0"] * replaced + [scenes[replaced].name] * (28 - replaced)
    assert [name for _, name in several] == plans
    for number, ((frame, _), (other, _)) in enumerate(zip(one, several, strict=True)):
        np.testing.assert_array_equal(frame, other, err_msg=str(number))


# ---- what ends a stream


class Fails(Exception):
    pass


@pytest.mark.parametrize("is_gpu", [False, True])
def test_an_error_of_the_iterator_comes_after_the_frames_before(name, is_gpu):
    scenes = cameras.cubes(5, SIZE)

    def coming():
        yield from scenes
        raise Fails

    simulator = gs.Simulator(CAMERA, device=pair_of_gpus() if is_gpu else together(name, 2))
    expected = taken(simulator.stream(scenes, "raw", exposure_time=0.01))
    stream, found = simulator.stream(coming(), "raw", exposure_time=0.01), []
    with pytest.raises(Fails):
        for frame in stream:
            found.append(np.array(frame))
    for frame, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(frame, other)
    with pytest.raises(StopIteration):
        next(stream)


@pytest.mark.parametrize("is_gpu", [False, True])
@pytest.mark.parametrize("wrong", ["light", "scene"])
def test_a_wrong_scene_is_found_as_on_one_device(name, wrong, is_gpu):
    scenes = cameras.cubes(6, SIZE)
    if wrong == "light":
        values = scenes[3].content.values.view(gs.domain.memory.Pinned)
        values[3, 20, 30] = np.nan
        content = gs.Cube(scenes[3].wavelengths, values)
        scenes[3] = replace(scenes[3], content=content, name="the fourth")
    else:
        scenes[3] = "no scene"
    found = {}
    for which in (name, pair_of_gpus() if is_gpu else together(name, 2)):
        simulator = gs.Simulator(CAMERA, device=which)
        frames = found.setdefault(str(which), [])
        with pytest.raises(BadData) as failure:
            for frame in simulator.stream(scenes, "raw", exposure_time=0.01):
                frames.append(np.array(frame))
        assert "\n" not in str(failure.value)
        frames.append(str(failure.value))
    one, two = found.values()
    assert len(one) == len(two) == (5 if wrong == "light" else 4)
    if not is_gpu:  # these have kernels of their own
        for frame, other in zip(one, two, strict=True):
            np.testing.assert_array_equal(frame, other)


@pytest.mark.parametrize("at", [0, 1])
def test_an_error_of_one_device_ends_the_stream_in_one_line(name, at, monkeypatch):
    """Whether the blur or the noise fails: the frames before have come."""
    simulator, asked = gs.Simulator(CAMERA, device=together(name, 2)), []
    scenes = cameras.cubes(10, SIZE)
    start, broken = Command.start, simulator.devices[at]

    def coming():
        for scene in scenes:
            asked.append(scene.name)
            yield scene

    for stage in ("optics.", "sensor.noise"):
        expected = taken(simulator.stream(scenes, "raw", exposure_time=0.01))
        asked.clear()

        def started(self, stage=stage):
            if self.device is broken and len(asked) > 5 and self.stage.startswith(stage):
                raise DeviceError(f"{broken.name}: it fell off the bus")
            start(self)

        monkeypatch.setattr(Command, "start", started)
        found, stream = [], simulator.stream(coming(), "raw", exposure_time=0.01)
        with pytest.raises(DeviceError, match="it fell off the bus") as failure:
            for frame in stream:
                found.append(np.array(frame))
        assert "\n" not in str(failure.value)
        assert len(found) % 2 == at and 4 <= len(found) <= 6
        for frame, other in zip(found, expected, strict=False):
            np.testing.assert_array_equal(frame, other)
        assert len(asked) < len(scenes)
        with pytest.raises(StopIteration):
            next(stream)
        monkeypatch.setattr(Command, "start", start)
    np.testing.assert_array_equal(
        taken(simulator.stream(scenes, "raw", exposure_time=0.01))[-1], expected[-1]
    )


@pytest.mark.parametrize("is_gpu, ahead", [(False, 1), (True, 3)])
def test_scenes_are_asked_for_as_far_ahead_as_devices_need(name, is_gpu, ahead):
    """In a stream without end: one scene begun beside the current one; on GPUs two more on their way."""
    simulator = gs.Simulator(CAMERA, device=pair_of_gpus() if is_gpu else together(name, 2))
    scenes, asked, alive = cameras.cubes(2, SIZE), [], weakref.WeakSet()

    def coming():
        for number in count():
            scene = replace(scenes[number % 2], name=str(number))
            alive.add(scene)
            asked.append(number)
            yield scene

    stream = simulator.stream(coming(), "raw", exposure_time=0.01)
    for number in range(20):
        next(stream)
        assert len(asked) == number + 1 + ahead
    del stream.plan
    gc.collect()
    # those ahead, the planned, the last of each loop and its check, and one in the generator
    assert len(alive) <= ahead + 1 + 2 + 2 + 1
    stream.close()
    with pytest.raises(StopIteration):
        next(stream)
    assert asked[-1] == 19 + ahead
    assert len(taken(simulator.stream(scenes, "raw", exposure_time=0.01))) == 2


def test_arrays_may_be_rewritten_three_scenes_later():
    """As `Simulator.stream` says: n + 1 scenes later, with n = 2 devices whose memory is apart from the host's."""
    simulator, scenes = gs.Simulator(CAMERA, device=pair_of_gpus()), cameras.cubes(9, SIZE)
    buffers = [simulator.device.pinned(scenes[0].content.values.shape) for _ in range(3)]

    def coming():
        for number, scene in enumerate(scenes):
            values = buffers[number % 3]
            values[...] = scene.content.values
            yield replace(scene, content=gs.Cube(scene.wavelengths, values))

    found = taken(simulator.stream(coming(), "raw", seed=5, exposure_time=0.01))
    expected = taken(simulator.stream(scenes, "raw", seed=5, exposure_time=0.01))
    for frame, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(frame, other)
    assert all((frame != expected[0]).any() for frame in expected[1:])


def test_uploads_to_two_devices_run_at_the_same_time(monkeypatch):
    """Each device has a thread that sends large samples: the first two scenes meet there."""
    monkeypatch.setattr("gpusim.pipeline.stream.STAGED", 0)
    threads = threading.active_count()
    simulator, meet, begun = gs.Simulator(CAMERA, device=pair_of_gpus()), threading.Barrier(2), []
    send = OpenCLDevice.send

    def sent(self, *args):
        begun.append((self, threading.get_ident()))
        if len(begun) <= 2:
            meet.wait(20)
        return send(self, *args)

    monkeypatch.setattr(OpenCLDevice, "send", sent)
    scenes = cameras.cubes(6, SIZE)
    found = taken(simulator.stream(scenes, "raw", exposure_time=0.01))
    assert len({*begun}) == 2 and len(begun) == 6
    assert not any(thread == threading.get_ident() for _, thread in begun)
    assert threading.active_count() <= threads
    one = gs.Simulator(CAMERA, device=simulator.device)
    expected = taken(one.stream(scenes, "raw", exposure_time=0.01))
    for frame, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(frame, other)


def test_an_upload_that_fails_ends_the_stream_after_the_frames_before(monkeypatch):
    threads = threading.active_count()
    simulator, scenes = gs.Simulator(CAMERA, device=pair_of_gpus()), cameras.cubes(6, SIZE)
    send = OpenCLDevice.send

    def sent(self, values, *args):  # threads send: which of them is first is not known
        if np.array_equal(values, scenes[3].content.values):
            raise DeviceError("no room")
        return send(self, values, *args)

    monkeypatch.setattr(OpenCLDevice, "send", sent)
    found = []
    with pytest.raises(DeviceError, match="no room"):
        for frame in simulator.stream(scenes, "raw", exposure_time=0.01):
            found.append(np.array(frame))
    assert len(found) == 3
    assert threading.active_count() <= threads


def test_no_scenes_and_fewer_scenes_than_devices(name):
    simulator = gs.Simulator(CAMERA, device=together(name, 3))
    assert [*simulator.stream([])] == []
    (scene,) = cameras.cubes(1, SIZE)
    (frame,) = taken(simulator.stream([scene], "raw", exposure_time=0.01))
    fresh = gs.Simulator(CAMERA, device=name).loop(scene, 0.01).raw()
    np.testing.assert_array_equal(frame, np.array(fresh))


# ---- batches


@QUEUES
@pytest.mark.parametrize("is_planned", [False, True])
@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_a_batch_has_the_bits_and_plans_of_one_device(name, queues, is_planned, tolerance):
    leaves = cameras.cubes(5, SIZE)
    wide = replace(CAMERA, optics=replace(CAMERA.optics, f_number=4.0))
    noisy = cameras.camera_with(CAMERA, noise={"read": 9.0})
    calls = [
        ({}, leaves),
        ({"seed": 2, "first": 30}, [*leaves[1:], odd(leaves[0])]),
        ({"exposure_time": [0.01, 0.02, 0.01, 0.005, 0.01]}, leaves[0]),
        ({"camera": [CAMERA, wide, noisy, CAMERA, wide], "gain": 2.0}, leaves),
        ({}, [*leaves[2:], *leaves[:2]]),
    ]

    def made(device):
        simulator = gs.Simulator(CAMERA, device=device, tolerance=tolerance)
        batch = simulator.batch(5, "codes", planned_for=leaves[0] if is_planned else None)
        found = []
        for settings, scenes in calls:
            frames = batch(scenes, **settings)
            assert frames.device is simulator.device
            plans = [(plan.scene.name, plan.count) for plan in batch.plans]
            found.append((np.array(frames), plans))
        return found

    for call, (one, several) in enumerate(
        zip(made(name), made(together(name, queues)), strict=True)
    ):
        np.testing.assert_array_equal(one[0], several[0], err_msg=str(call))
        assert one[1] == several[1], call


def test_a_batch_of_bursts_and_its_labels(name):
    leaves = cameras.cubes(3, SIZE)
    one, two = (
        gs.Simulator(CAMERA, device=device).batch(3, "raw", capture=gs.Burst(2))
        for device in (name, together(name, 2))
    )
    np.testing.assert_array_equal(np.array(one(leaves, seed=4)), np.array(two(leaves, seed=4)))
    assert [*map(len, two.labels)] == [*map(len, one.labels)]


def test_a_batch_is_over_when_an_item_is_wrong(name):
    leaves, simulator = cameras.cubes(3, SIZE), gs.Simulator(CAMERA, device=together(name, 2))
    batch = simulator.batch(3, "raw")
    expected = np.array(batch(leaves, exposure_time=0.01))
    with pytest.raises(GpusimError, match="exposure"):
        batch(leaves, exposure_time=[0.01, -1.0, 0.01])
    np.testing.assert_array_equal(np.array(batch(leaves, exposure_time=0.01)), expected)


def test_pictures_of_a_network(name):
    pictures = np.random.default_rng(5).random((4, 3, 32, 40)).astype(np.float32)
    for tolerance in (None, 1e-2):
        one, two = (
            gs.PictureBatch(CAMERA, device=device, output="codes", tolerance=tolerance)(pictures)
            for device in (name, together(name, 2))
        )
        np.testing.assert_array_equal(one, two)


# ---- commands


def test_commands_write_what_one_device_writes(name, tmp_path, monkeypatch, capsys):
    random, photographs = np.random.default_rng(3), tmp_path / "photographs"
    photographs.mkdir()
    for number in range(5):
        values = np.uint8(255 * random.random((24, 36, 3)))
        Image.fromarray(values).resize((48, 32)).save(photographs / f"p{number}.png")
    frames = ["--camera", "phone", "--seed", "3"]
    shaken = ["video", "deadleaves", "--size", "64x48", "--frames", "7", "--shake", "2"]
    folders = []
    for device in (name, together(name, 2)):
        folder = tmp_path / str(len(folders))
        folder.mkdir()
        folders.append(folder)
        monkeypatch.chdir(folder)
        for command in (
            ["video", str(photographs), "--segment", "2", "-o", "f.npz"],
            [*shaken, "--segment", "3", "-o", "shaken.mp4"],
            [*shaken, "--segment", "2", "--blur", "-o", "blurred.npz"],
            ["video", "shaken.mp4", "--segment", "2", "-o", "again.npz"],
            ["pairs", str(photographs), "-o", "pairs", "--each", "3", "--in-shard", "7"],
        ):
            assert not main([*command, *frames, "--device", device])
    one, two = (
        {str(p.relative_to(f)): p.read_bytes() for p in sorted(f.rglob("*")) if p.is_file()}
        for f in folders
    )
    assert (
        len(one)
        == 5 + 1 + 7 + 7 + 3 + 4  # frames, a video, frames, tar files of 15 pairs; manifests
    )
    assert one == two
    capsys.readouterr()
    (photographs / "p3.png").write_bytes(b"damaged")
    errors = []
    for device in (name, together(name, 2)):
        video = ["video", str(photographs), "--segment", "2", "-o", f"{len(errors)}.npz"]
        assert main([*video, *frames, "--device", device])
        errors.append(capsys.readouterr().err.splitlines()[-1].partition("<")[0])
    assert errors[0] == errors[1] and "p3.png" in errors[0]
    asked = ["simulate", "ramp", "--camera", "phone", "-o", "x.png", "--device", f"{name},{name}"]
    assert main(asked)
    assert f"{name},{name}: several devices, wanted one" in capsys.readouterr().err


def test_pipelines_run_together_in_order():
    """Each in its own thread: both wait for each other at every item."""
    meet = threading.Barrier(2, timeout=20)

    def numbers(first):
        for number in range(first, 10, 2):
            meet.wait()
            yield number

    assert [*run_together([numbers(0), numbers(1)])] == [*range(10)]
    turns = [0, 0, 1, 0, 1]
    assert [*run_together(["abc", "de"], turns)] == [*"abdce"]
    assert [*run_together(["abcd", "", "e"])] == [*"aebcd"]
    assert [*run_together(["abc"])] == [*"abc"]


def test_an_error_of_one_pipeline_ends_the_others():
    ended, made = [], []

    def endless():
        try:
            for number in count():
                made.append(number)
                yield number
        finally:
            ended.append(True)

    def failing():
        yield -1
        raise Fails

    found = []
    with pytest.raises(Fails):
        for item in run_together([endless(), failing()]):
            found.append(item)
    assert found == [0, -1, 1] and ended == [True]
    assert len(made) <= 2 + 2  # two were taken, two are ahead
    running = run_together([endless(), endless()])
    assert next(running) == 0
    running.close()
    assert len(ended) == 3
