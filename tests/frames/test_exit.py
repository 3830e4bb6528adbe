"""The end of a process while devices still work: no crash, however it ends."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from devices import KINDS

BEGIN = """
import sys, threading
import gpusim as gs
from gpusim.backends import open_device
scene = gs.chart("deadleaves", size=(960, 640))
simulate = gs.Simulator(gs.open_camera("phone"), device=sys.argv[1])
loop = simulate.loop(scene, 0.01)
def work():
    global x
    x = loop.output("irradiance")
"""
# How it ends -> what is done last, and the status
ENDS = {
    "plain": ("work()", 0),
    "in a function": (
        "def main():\n    y = gs.Simulator(gs.open_camera('mono'), device=sys.argv[1])\n"
        "    z = y.loop(scene, .01)\n    a = z.raw(), z.output('irradiance')\nmain()",
        0,
    ),
    "exit": ("work()\nsys.exit(3)", 3),
    "an error": ("work()\nraise ValueError('no')", 1),
    "a thread": ("threading.Thread(target=work).start()", 0),
    "a thread that nobody waits for": (
        "other = simulate.loop(scene, 0.02)\ndef on():\n    while True:\n"
        "        other.output('irradiance')\n        other.raw()\n"
        "threading.Thread(target=on, daemon=True).start()\nwork()",
        0,
    ),
    "Ctrl-C": (
        "import os, signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nwork()\n"
        "os.kill(os.getpid(), signal.SIGINT)\nwork()",
        -2,
    ),
    "a stream": ("frames = simulate.stream([scene] * 3, 'raw')\nx = next(frames)", 0),
    "a device that is dropped": (
        "from gpusim.backends.opencl import OpenCLDevice\n"
        "device = open_device(sys.argv[1])\nis_opencl = device.kind == 'opencl'\n"
        "other = OpenCLDevice(device.cl_device, 'opencl:7') if is_opencl else device\n"
        "gs.Simulator(gs.open_camera('phone'), device=other).loop(scene, .01).raw()\n"
        "del other",
        0,
    ),
}


def ended(end, device):
    """Status and message of a process that ends so."""
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", BEGIN + ENDS[end][0], device],
        capture_output=True,
        text=True,
        timeout=300,
    )
    return done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "device", [name for name in KINDS if name != "warp:cpu"]
)  # which has nothing pending
@pytest.mark.parametrize(
    "end", ["plain", "a thread that nobody waits for", "a device that is dropped"]
)
def test_a_process_ends_while_its_device_works(end, device):
    status, message = ended(end, device)
    assert status == ENDS[end][1], message


@pytest.mark.slow
@pytest.mark.parametrize("device", KINDS)
def test_200_processes_end_while_their_device_works(device):
    """More at once than there are processors, so that work is left when they end."""
    ends = [end for _ in range(23) for end in ENDS][:200]
    with ThreadPoolExecutor(2 * (os.cpu_count() or 1)) as pool:
        found = list(pool.map(lambda end: ended(end, device), ends))
    assert [
        (end, status, message[-300:])
        for end, (status, message) in zip(ends, found, strict=True)
        if status != ENDS[end][1]
    ] == []
