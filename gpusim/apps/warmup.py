"""Compilation of the kernels of usual frames before they are needed, by several processes.

`python -m gpusim.apps.warmup DEVICE CAMERA TOLERANCE SCENE` computes one frame, in such a process.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

from gpusim.domain.errors import GpusimError

if TYPE_CHECKING:
    from gpusim.domain.scene import Scene

SCENES = ("chart", "photograph", "cube", "depth")
CAMERAS = ("phone", "machine-vision", "figure8", "mono")  # others share nearly all of their kernels
# Kernels run in groups of 128, 8 and 1 on CPUs: each number of columns and pixels takes them all
COLS, ROWS = 777, 517
MOST = 16  # processes
EXACT = "exact"  # no tolerance


@dataclass(frozen=True)
class Warmed:
    """A frame whose kernels were compiled.

    Attributes:
        words: Its scene, camera and tolerance.
        seconds: Time of its process [s].
        error: Why there is no frame; "" if there is one.
    """

    words: str
    seconds: float
    error: str


def warm_up(
    device: str, cameras: Sequence[str], tolerances: Sequence[str], scenes: Sequence[str] = SCENES
) -> Iterator[Warmed]:
    """Compute a frame of each scene by each camera with each tolerance.

    The first frame has kernels that most others need, too: it runs alone.

    Args:
        device: Name of the device.
        cameras: Names of cameras or camera files.
        tolerances: Presets, relative RMS errors, or EXACT.
        scenes: Some of SCENES.

    Yields:
        Each frame.
    """
    first, *others = product(cameras, tolerances, scenes)
    yield _warm(device, *first)
    with ThreadPoolExecutor(min(os.cpu_count() or 1, MOST)) as pool:
        yield from pool.map(lambda kind: _warm(device, *kind), others)


def _warm(device, camera, tolerance, scene):
    """Compute a frame in a process."""
    start = time.monotonic()
    command = [sys.executable, "-m", __name__, device, camera, tolerance, scene]
    end = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    last = (end.stderr.strip().splitlines() or [f"status {end.returncode}"])[-1]
    words = f"{scene} by {camera}, {tolerance}"
    return Warmed(words, time.monotonic() - start, last if end.returncode else "")


def _open_scene(name) -> "Scene":
    """Return one of SCENES."""
    import numpy as np

    from gpusim.data.charts import chart
    from gpusim.domain.content import Cube
    from gpusim.io.scene.scenes import picture

    if name == "chart":
        return chart("colorchecker", size=(COLS, ROWS))
    if name == "photograph":
        codes = np.random.default_rng(1).integers(0, 256, (ROWS, COLS, 3), dtype=np.uint8)
        return picture(codes)
    leaves = chart("deadleaves", size=(COLS, ROWS))
    if name == "depth":
        return replace(leaves, depth=np.linspace(1, 4, ROWS * COLS).reshape(ROWS, COLS))
    bands = leaves.content.on_host().bands_at(slice(None))
    return replace(leaves, content=Cube(leaves.wavelengths, bands.astype(np.float32)))


def _compute(device, camera, tolerance, scene):
    from gpusim.io.camera.cameras import open_camera
    from gpusim.pipeline.simulator import Simulator

    wanted = None if tolerance == EXACT else tolerance
    simulator = Simulator(open_camera(camera), device=device, tolerance=wanted)
    frame = simulator(_open_scene(scene), seed=1)
    assert frame.raw is not None and frame.rgb is not None


if __name__ == "__main__":
    try:
        _compute(*sys.argv[1:])
    except GpusimError as error:
        sys.exit(str(error))
