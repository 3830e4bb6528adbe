"""Every device of a host: what the first gives, the second gives bit for bit, by every path and command.

Two NVIDIA GPUs, by Warp and by OpenCL, if there are two; PoCL everywhere, split in two. A second GPU that does not work
fails here, and is not skipped.
"""

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import cameras
import numpy as np
import pytest
from every_path import made_on, require_equal
from PIL import Image

import gpusim as gs
from gpusim.backends import open_device, probe
from gpusim.backends.driver import cl_devices, pyopencl
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.errors import DeviceError

STAGES = (
    "spectral.integrate",
    "optics.mosaic",
    "optics.falloff",
    "sensor.noise",
    "processor.malvar",
    "display.encode",
)
RUN = """
import json, sys
from gpusim.cli.main import main
for arguments in json.loads(sys.argv[1]):
    failure = main(arguments)
    if failure:
        sys.exit(f"{arguments}: {failure}")
"""
WARP = [
    entry["name"] for entry in probe.devices() if entry["name"].startswith("warp:cuda")
]  # usable or not


def opencl_gpus():
    """Names of OpenCL's GPUs of one make, at least two; whether they work is not asked."""
    try:
        found = cl_devices()
    except DeviceError:  # no pyopencl
        return []
    gpu = pyopencl().device_type.GPU
    names = [device.name if device.type & gpu else "" for device in found]
    return next(
        (
            [f"opencl:{number}" for number, other in enumerate(names) if other == name]
            for name in names
            if name and names.count(name) > 1
        ),
        [],
    )


OPENCL = opencl_gpus()


def pair(names, what):
    return pytest.param(
        tuple(names[:2]),
        id=what,
        marks=pytest.mark.skipif(len(names) < 2, reason=f"this host has no second GPU for {what}"),
    )


@pytest.fixture(scope="module")
def halves():
    """PoCL's processor as two devices with contexts of their own."""
    cl, whole = pyopencl(), open_device("opencl:pocl").cl_device
    if whole.max_compute_units < 2:
        pytest.skip("PoCL has one compute unit, which cannot be split")
    parts = whole.create_sub_devices(
        [cl.device_partition_property.EQUALLY, whole.max_compute_units // 2]
    )
    return [OpenCLDevice(part, f"opencl:half {number}") for number, part in enumerate(parts[:2])]


@pytest.fixture(params=[pair(WARP, "warp"), pair(OPENCL, "opencl"), "pocl"])
def two(request):
    return (
        request.getfixturevalue("halves")
        if request.param == "pocl"
        else [open_device(name) for name in request.param]
    )


@pytest.mark.slow
def test_every_path_is_the_same_on_the_second_device(two):
    assert two[0] is not two[1]
    require_equal(*(made_on(device) for device in two))


def test_devices_work_in_threads_at_once(two):
    start = threading.Barrier(2)

    def work(device):
        start.wait()
        return [made_on(device, camera="mono") for _ in range(2)]

    with ThreadPoolExecutor(2) as pool:
        (first, again), (second, last) = pool.map(work, two)
    for other in (again, second, last):
        require_equal(first, other)


def test_one_simulator_on_both(two):
    scenes = cameras.cubes(7, (96, 64))
    one, both = (
        gs.Simulator(cameras.PHONE, device=device, tolerance=4e-4) for device in (two[0], two)
    )
    for output in ("raw", "codes"):
        frames = (
            [np.array(frame) for frame in simulator.stream(scenes, output, seed=3)]
            for simulator in (one, both)
        )
        for frame, other in zip(*frames, strict=True):
            np.testing.assert_array_equal(frame, other)
    batches = [simulator.batch(3, "codes") for simulator in (one, both)]
    for first in range(3):
        frames = (batch(scenes[first : first + 3], seed=first) for batch in batches)
        np.testing.assert_array_equal(*map(two[0].numpy, frames))


def test_what_one_device_made_is_used_by_the_other(two):
    values = np.random.default_rng(1).random((50, 70)).astype(np.float32)
    arrays = [two[0].array(values)]
    for device in (two[1], two[0], two[1]):
        arrays.append(device.array(arrays[-1]))
        target = device.empty(values.shape)
        device.launch(
            "common.copy",
            "copy",
            (values.size,),
            device.reshape(arrays[-1], (values.size,)),
            device.reshape(target, (values.size,)),
            values.size,
        )
        arrays.append(target)
        np.testing.assert_array_equal(device.numpy(target), values)


def run(folder, device, environment, commands):
    """Commands in one process, in a folder; what they wrote, by name."""
    folder.mkdir()
    asked = [[*command, "--device", device] for command in commands]
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", RUN, json.dumps(asked)],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, f"{device}: {done.stderr[-2000:]}"
    return {
        str(path.relative_to(folder)): path for path in sorted(folder.rglob("*")) if path.is_file()
    }


@pytest.mark.parametrize(
    "names, environment",
    [
        pytest.param(
            WARP[:2],
            {},
            id="warp",
            marks=pytest.mark.skipif(len(WARP) < 2, reason="no second CUDA device"),
        ),
        pytest.param(
            OPENCL[:2],
            {},
            id="opencl",
            marks=pytest.mark.skipif(len(OPENCL) < 2, reason="no second OpenCL GPU"),
        ),
        pytest.param(
            ["opencl:0", "opencl:1"],
            {"POCL_DEVICES": "pthread pthread"},
            id="pocl",
            marks=pytest.mark.skipif(
                not any("pocl" in device.version.lower() for device in cl_devices()[:1]),
                reason="the first OpenCL device is not PoCL, which alone can be asked for two",
            ),
        ),
    ],
)
@pytest.mark.slow
def test_every_command_works_on_the_second_device(names, environment, tmp_path):
    random, photographs = np.random.default_rng(3), tmp_path / "photographs"
    photographs.mkdir()
    for number in range(4):
        Image.fromarray(np.uint8(255 * random.random((24, 36, 3)))).resize((48, 32)).save(
            photographs / f"p{number}.png"
        )
    frames = ["--camera", "phone", "--seed", "3"]
    commands = [
        [
            "verify",
            *(part for stage in STAGES for part in ("--stage", stage)),
            "--json",
            "verify.json",
        ],
        ["simulate", "ramp", *frames, "--size", "48x32", "--tolerance", "4e-4", "-o", "one.png"],
        ["simulate", "deadleaves", *frames, "--size", "48x32", "-o", "raw.npz"],
        [
            "video",
            str(photographs),
            *frames,
            "--segment",
            "2",
            "-o",
            "frames.npz",
            "--shard",
            "0/2",
        ],
        [
            "video",
            str(photographs),
            *frames,
            "--segment",
            "2",
            "-o",
            "frames.npz",
            "--shard",
            "1/2",
        ],
        ["pairs", *sorted(map(str, photographs.iterdir())), *frames, "-o", "pairs", "--each", "2"],
    ]
    first, second = (
        run(tmp_path / name.replace(":", "-"), name, environment, commands) for name in names
    )
    assert first.keys() == second.keys() and len(first) > 4
    for name in first.keys() - {"verify.json"}:  # which has its device's name
        assert first[name].read_bytes() == second[name].read_bytes(), name
    listed = subprocess.run(
        [sys.executable, "-P", "-m", "gpusim", "devices"],
        env=os.environ | environment | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=500,
    ).stdout
    for name in names:
        (line,) = (line for line in listed.splitlines() if line.startswith(name))
        assert "unusable" not in line and "GB/s" in line, line
