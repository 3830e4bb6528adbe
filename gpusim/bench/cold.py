"""The time to build all kernels when none is on disk, measured in a process with empty caches."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gpusim
from gpusim.backends import Device, open_device
from gpusim.bench.stages import ERROR_SIZE, Stage
from gpusim.domain.progress import announced

PATIENCE = 900.0  # [s] for all kernels
CHILD = """
import sys
folder = sys.argv.pop(1)
if folder not in sys.path:  # a checkout that is not installed
    sys.path.insert(0, folder)
from gpusim.bench.cold import main
main()
"""


def measure_cold_build(device: Device, stages: list[str]) -> float | None:
    """Return the time to build the kernels of stages without any cache on disk [s].

    A child process with empty caches runs each stage twice. The first run builds the kernels; the
    second one's time is subtracted.

    Args:
        device: The device.
        stages: Names of stages.

    Returns:
        The time; None if the child fails or takes too long.
    """
    folder = str(Path(gpusim.__file__).parents[1])
    with announced("building all kernels anew"), tempfile.TemporaryDirectory() as cache:
        caches = {
            "XDG_CACHE_HOME": cache,
            "POCL_CACHE_DIR": f"{cache}/pocl",
            "CUDA_CACHE_PATH": f"{cache}/cuda",
            "WARP_CACHE_PATH": f"{cache}/warp",
        }
        try:
            # -P: this package, and not another one in the current folder
            ended = subprocess.run(
                [sys.executable, "-P", "-c", CHILD, folder, device.name, *stages],
                env=os.environ | caches,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=True,
            )
            return float(json.loads(ended.stdout.splitlines()[-1]))
        except (subprocess.SubprocessError, ValueError, IndexError):
            return None


def main() -> None:
    """Print the difference between the first and the second run of all stages [s]."""
    _, name, *stages = sys.argv
    device, spent = open_device(name), []
    for _ in range(2):
        begin = time.perf_counter()
        for stage in stages:
            Stage(stage).start(device, ERROR_SIZE).run()
        device.sync()
        spent.append(time.perf_counter() - begin)
    print(json.dumps(spent[0] - spent[1]))
