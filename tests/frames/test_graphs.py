"""Kernels of a CUDA device that one call starts: they do what separate calls do, whatever changes between starts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from devices import GPUS

import gpusim as gs
from gpusim.backends import open_device
from gpusim.backends.graphs import Graph
from gpusim.backends.tape import Tape, recording

CUDA = [name for name in GPUS if name.startswith("warp:cuda")]
pytestmark = pytest.mark.skipif(not CUDA, reason="no CUDA device")
SIZE = 1000


def copies(device, arrays):
    """Return commands that copy each array to the next one."""
    tape = Tape()
    with recording(tape):
        for source, target in pairwise(arrays):
            device.launch("common.copy", "copy", (SIZE,), source, target, SIZE)
    return tape


@pytest.mark.parametrize("name", CUDA)
def test_a_graph_takes_other_arrays_between_its_starts(name):
    device, random = open_device(name), np.random.default_rng(1)
    first, other = (random.random(SIZE).astype(np.float32) for _ in range(2))
    given = device.array(first)
    arrays = [given, *(device.array(np.zeros(SIZE, np.float32)) for _ in range(3))]
    tape = copies(device, arrays)
    (graph,) = device.gather(tape.commands)
    assert isinstance(graph, Graph)
    for values in (first, other, first):
        for array in arrays[1:]:
            array.fill_(0)
        replaced = device.array(values)
        assert tape.exchange([(given, replaced)])
        given = replaced
        device.start([graph])
        np.testing.assert_array_equal(device.numpy(arrays[-1]), values)
    with device.timed() as ms:  # each kernel apart
        device.start([graph])
    assert set(ms) == {"common.copy"} and ms["common.copy"] > 0


@pytest.mark.parametrize("name", CUDA)
def test_a_single_kernel_and_copies_are_no_graph(name):
    device = open_device(name)
    arrays = [device.array(np.ones(SIZE, np.float32)) for _ in range(2)]
    commands = copies(device, arrays).commands
    assert device.gather(commands) == commands


@pytest.mark.parametrize("name", CUDA)
def test_a_loop_of_scenes_launches_graphs(name):
    simulator, chart = (
        gs.Simulator(gs.open_camera("phone"), device=name),
        gs.chart("deadleaves", size=(64, 48)),
    )
    bands = chart.content.bands_at(slice(None)).astype(np.float32)
    scenes = [
        replace(chart, content=gs.Cube(chart.wavelengths, bands * np.float32(1 + 0.1 * k)))
        for k in range(6)
    ]
    loop = simulator.loop(scenes[0], 0.01)
    for number, scene in enumerate(scenes):
        found = np.array(loop.update(scene=scene).raw(seed=2, first=number))
        fresh = np.array(simulator.loop(scene, 0.01).raw(seed=2, first=number))
        np.testing.assert_array_equal(found, fresh)
    started = [part for parts in loop._repeat._commands.values() for part in parts]
    assert any(isinstance(part, Graph) for part in started)
