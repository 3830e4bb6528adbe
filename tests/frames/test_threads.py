"""Threads and processes: what they draw is what one thread draws alone."""

import multiprocessing
import pickle
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from devices import ALL, ALL_KINDS, DEVICES, KINDS

import gpusim as gs
from gpusim.backends import open_device
from gpusim.domain.errors import DeviceError
from gpusim.optics.field import FieldBlur

THREADS, FRAMES = 8, 50
SIZE = (40, 32)


@pytest.fixture(autouse=True)
def impatient():
    """Threads change places as often as Python lets them."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(before)


def simulators(device):
    """Cameras whose frames launch the same kernels with other arguments."""
    return [gs.Simulator(gs.open_camera(name), device=device) for name in ("phone", "figure8")]


def drawn(simulator, exposure, frame):
    """Digital numbers and display codes of an exposure."""
    raw = exposure.raw(seed=7, first=frame)
    return [np.array(simulator.device.numpy(part)) for part in (raw, exposure.codes(raw))]


def scene_of(number):
    return gs.chart("ramp", size=SIZE, luminance=20.0 * (1 + number))


def in_threads(work):
    """What `work(thread)` gives in each of the threads, which begin together."""
    start = threading.Barrier(THREADS)

    def begin(number):
        start.wait()
        return work(number)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(begin, range(THREADS)))


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("device", KINDS)
def test_threads_give_the_same_bits(device, shared):
    """Eight threads, fifty frames each, of Simulators of their own or shared: all that one thread gives alone."""
    scenes, ours = [scene_of(number) for number in range(2)], simulators(device)
    exposures = [simulator.expose(scene) for simulator, scene in zip(ours, scenes, strict=True)]
    means = [
        np.array(one.device.numpy(exposure.mean))
        for one, exposure in zip(ours, exposures, strict=True)
    ]
    alone = [
        [drawn(simulator, exposure, frame) for frame in range(FRAMES)]
        for simulator, exposure in zip(ours, exposures, strict=True)
    ]

    def work(thread):
        own = ours if shared else simulators(device)
        wrong = []
        for frame in range(FRAMES):
            camera = (thread + frame) % 2
            if frame in (0, 25):  # from the scene on, while others draw
                exposure = own[camera].expose(scenes[camera])
                if not np.array_equal(own[camera].device.numpy(exposure.mean), means[camera]):
                    wrong.append(("mean", camera))
            if not all(
                map(
                    np.array_equal,
                    drawn(own[camera], exposures[camera], frame),
                    alone[camera][frame],
                )
            ):
                wrong.append(("frame", camera, frame))
        return wrong

    assert in_threads(work) == [[]] * THREADS


@pytest.mark.parametrize("device", ALL)
def test_each_thread_times_its_own_stages(device):
    device = open_device(device)

    def work(thread):
        with device.timed() as ms:
            for _ in range(20):
                with device.charged(f"stage {thread}"):
                    if device.kind == "numpy":
                        with device.host_work():
                            np.ones(1000).sum()
                    else:
                        values = device.array(np.ones(1000, np.float32))
                        device.launch(
                            "common.copy", "copy", (1000,), values, device.empty((1000,)), 1000
                        )
        return dict(ms)

    for thread, ms in enumerate(in_threads(work)):
        assert set(ms) == {f"stage {thread}"} and ms[f"stage {thread}"] > 0


def test_a_device_is_opened_once():
    found = in_threads(lambda _: open_device("warp:cpu"))
    assert len(set(map(id, found))) == 1


def elsewhere(method, work, *arguments):
    """What a function gives in a process of its own, started by `method`, which must not die or keep silent."""
    context = multiprocessing.get_context(method)
    answers, sender = context.Pipe(duplex=False)
    process = context.Process(target=answer, args=(sender, work, arguments))
    process.start()
    sender.close()  # the child's end alone is open: where it dies, the pipe ends
    try:
        assert answers.poll(120), "no answer within 120 s"
        return answers.recv()
    finally:
        process.kill()
        process.join()


def answer(sender, work, arguments):
    sender.send(work(*arguments))


def redrawn(blob):
    """Digital numbers of a pickled Simulator and Exposure."""
    simulator, exposure = pickle.loads(blob)
    return simulator.device.name, np.array(simulator.device.numpy(exposure.raw(seed=5)))


def test_an_exposure_of_a_varying_blur_is_pickled():
    camera = gs.open_camera("phone")
    camera = replace(camera, optics=replace(camera.optics, lateral_color=1e-3))
    exposure = gs.Simulator(camera, device="numpy", tolerance=1e-2).expose(scene_of(0))
    assert exposure.plan.find(FieldBlur) is not None
    again = pickle.loads(pickle.dumps(exposure))
    np.testing.assert_array_equal(
        again.plan.find(FieldBlur).coefficients, exposure.plan.find(FieldBlur).coefficients
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("camera", ["phone", pytest.param("mono", marks=pytest.mark.slow)])
def test_simulators_and_exposures_go_to_other_processes(device, camera):
    simulator = gs.Simulator(gs.open_camera(camera), device=device, tolerance=1e-3)
    exposure = simulator.expose(scene_of(0))
    raw = np.array(simulator.device.numpy(exposure.raw(seed=5)))
    blob = pickle.dumps((simulator, exposure))
    name, there = elsewhere("spawn", redrawn, blob)
    assert name == device
    assert np.array_equal(there, raw)
    frame = exposure.frame(seed=5)
    assert np.array_equal(pickle.loads(pickle.dumps(frame)).rgb, frame.rgb)


def used(*devices):
    """What the first use of each device in this process gives."""
    given = []
    for device in devices:
        try:
            gs.Simulator(gs.open_camera("phone"), device=device)(scene_of(0))
            given.append("works")
        except DeviceError as error:
            given.append(str(error))
    return given


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork"
)
@pytest.mark.parametrize("device", DEVICES)
def test_a_forked_process_is_told_so(device):
    """Drivers do not survive a fork: an error at once, and no silence without end; NumPy goes on."""
    assert used(device) == ["works"]
    refused, numpy = elsewhere("fork", used, device, "numpy")
    assert (
        f"{device}: this process was forked" in refused
        and "spawn" in refused
        and "\n" not in refused
    )
    assert numpy == "works"
