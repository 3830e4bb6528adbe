"""The devices that tests run on: every one that works. Those that do not fail one test, with their causes.

That test is in test_stages.py: a driver that cannot build an empty kernel is one failure, not one of every stage.
"""

import pytest

from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.probe import devices
from gpusim.backends.select import open_device

_ENTRIES = [entry for entry in devices() if entry["name"] != "numpy" and not entry["error"]]
BROKEN = {entry["name"]: entry["error"] for entry in devices() if entry["error"]}
DEVICES = [entry["name"] for entry in _ENTRIES]
GPUS = [entry["name"] for entry in _ENTRIES if entry["gpu"]]
ALL = ["numpy", *DEVICES]

# Stages run on all of them. What is longer runs on one of each kind, and with `-m slow` on a second driver for the same
# processor (PoCL beside PoCL, say).
_KINDS = [(entry["name"].partition(":")[0], entry["gpu"]) for entry in _ENTRIES]
KINDS = [
    name if kind not in _KINDS[:number] else pytest.param(name, marks=pytest.mark.slow)
    for number, (name, kind) in enumerate(zip(DEVICES, _KINDS, strict=True))
]
ALL_KINDS = ["numpy", *KINDS]


def apart(of=OpenCLDevice, is_gpu=True):
    """A CPU's OpenCL device whose memory is apart from the host's, as a GPU's is. of: its class.

    is_gpu: whether kernels are launched as on a GPU, too.
    """
    shared = open_device("opencl:pocl")
    device = of(shared.cl_device, shared.name)
    device.is_gpu, device.on_host = is_gpu, False
    device._copies = device._cl.CommandQueue(device.context)
    return device
