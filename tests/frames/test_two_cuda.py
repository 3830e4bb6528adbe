"""Two CUDA devices in one process, by a double that refuses what mixes them: see fake_cuda.py."""

import threading
from concurrent.futures import ThreadPoolExecutor

import cameras
import devices
import fake_cuda
import numpy as np
import pytest
from every_path import made_on, require_equal

import gpusim as gs
from gpusim.domain.errors import BadData


@pytest.fixture(scope="module")
def native():
    """PoCL, launched as on a GPU, for kernels that are OpenCL's text."""
    return devices.apart()


@pytest.fixture
def two(monkeypatch, native):
    return fake_cuda.two_cuda(monkeypatch, native)


def test_the_double_refuses_what_cuda_refuses(two):
    with pytest.raises(
        RuntimeError,
        match="Event from device cuda:1 cannot be recorded on stream from device cuda:0",
    ):
        fake_cuda.FAKE.record_event(fake_cuda.Event(two[1].wp_device))
    array = two[0].array(np.ones(4, np.float32))
    with pytest.raises(RuntimeError, match="a launch on cuda:1 of an array of cuda:0"):
        two[1].launch("common.copy", "copy", (4,), array, two[1].empty((4,)), 4)
    with pytest.raises(RuntimeError, match="a race"):
        two[1].wp_device.stream.uses(array.memory)


@pytest.mark.slow  # in threads at once, below, by another camera
def test_every_path_is_the_same_on_the_second_device(two):
    require_equal(*(made_on(device) for device in two))


@pytest.mark.slow
def test_devices_work_in_threads_at_once(two):
    start = threading.Barrier(2)

    def work(device):
        start.wait()
        return made_on(device, camera="mono")

    with ThreadPoolExecutor(2) as pool:
        require_equal(*pool.map(work, two))


def test_what_one_device_made_is_used_by_the_other(two):
    """A copy between them waits for the work on both."""
    values = np.arange(12, dtype=np.float32)
    there = two[0].array(np.zeros_like(values))
    for _ in range(2):
        two[0].launch("common.copy", "copy", (12,), two[0].array(values), there, 12)
        here = two[1].array(there)
        assert here.device is two[1].wp_device
        np.testing.assert_array_equal(two[1].numpy(here), values)
    picture = gs.chart("flat", size=(16, 12))
    cube = two[0].array(picture.content.bands_at(slice(None)))
    scene = gs.scene_from(cube, picture.wavelengths)
    raws = [
        gs.Simulator(gs.open_camera("phone"), device=device).loop(scene, 0.01).raw(seed=1)
        for device in two
    ]
    np.testing.assert_array_equal(
        *(device.numpy(raw) for device, raw in zip(two, raws, strict=True))
    )


def test_a_callers_stream_is_one_of_the_same_device(two):
    ones = two[1].array(np.ones(4, np.float32))
    with two[1].on_stream(
        0
    ):  # CUDA's default stream: of cuda:1, though cuda:0 is the default device
        two[1].launch("common.copy", "copy", (4,), ones, two[1].empty((4,)), 4)
        two[1].fetch(ones)()
    before = two[1].wp_device.stream

    class Stream:
        cuda_stream, device_index = 77, 0

    with (
        pytest.raises(BadData, match="CUDA stream: one of cuda:0, wanted one of cuda:1"),
        two[1].on_stream(Stream()),
    ):
        pass
    assert two[1].wp_device.stream is before


def test_memory_of_the_other_device_is_known_by_its_address(two, monkeypatch):
    """The CUDA array interface names no device: the driver does."""
    monkeypatch.setattr("gpusim.backends.warp.ordinal_of", lambda address: 0)
    asked = []
    monkeypatch.setattr(fake_cuda.FAKE, "synchronize_device", asked.append)

    class Foreign:
        def __init__(self, of):
            self.__cuda_array_interface__ = {
                "shape": (4,),
                "typestr": "<f4",
                "data": (of.ptr, False),
                "version": 3,
                "stream": 1,
            }

        def __array__(self, dtype=None, copy=None):
            return np.arange(4, dtype=np.float32)

    array = two[1]._by_interface(Foreign(two[0].array(np.ones(4, np.float32))))
    assert array.device is two[0].wp_device and asked == [two[0].wp_device]


def test_one_simulator_on_both(two, monkeypatch):
    """Streams and batches by both have the bits of one, and nothing is read before it is there."""
    monkeypatch.setattr("gpusim.backends.probe.hardware_id", lambda device: "one card")
    scenes = cameras.cubes(7, (40, 32))
    simulators = [gs.Simulator(cameras.PHONE, device=device) for device in (two[0], [*two])]
    one, both = (
        [np.array(simulator.device.numpy(frame)) for frame in simulator.stream(scenes, "codes")]
        for simulator in simulators
    )
    for frame, other in zip(one, both, strict=True):
        np.testing.assert_array_equal(frame, other)
    batches = [simulator.batch(3, "codes") for simulator in simulators]
    for first in range(3):
        one, both = (batch(scenes[first : first + 3], seed=first) for batch in batches)
        assert both.device is two[0].wp_device
        np.testing.assert_array_equal(two[0].numpy(one), two[0].numpy(both))
