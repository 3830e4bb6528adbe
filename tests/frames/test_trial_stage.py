"""A stage is added as CONTRIBUTING.md says: four files, and lines in three others, none of which can be forgotten.

The stage mixes each pixel's mean electrons with those of its four neighbours (crosstalk).
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FILES = {
    "crosstalk.py": """
import numpy as np
from gpusim.kernels.stage import Case, stage


@stage
def crosstalk(device, mean, share):
    rows, cols = mean.shape
    out = device.empty((rows, cols))
    device.launch("sensor.crosstalk", "crosstalk", (rows, cols), device.array(mean), out, rows, cols, float(share))
    return out


def cases():
    mean = np.random.default_rng(1).random((7, 5)).astype(np.float32)
    yield Case("7x5", {"mean": mean, "share": 0.2}, 8 * 2.0**-24, "seven roundings of float32, and one of the share")


def bench(rows, cols):
    return {"mean": np.ones((rows, cols), np.float32), "share": 0.1}
""",
    "crosstalk_ref.py": """
import numpy as np


def crosstalk(mean, share):
    wide = np.pad(np.asarray(mean, np.float64), 1, mode="edge")
    near = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    return (1 - share) * wide[1:-1, 1:-1] + share / 4 * near
""",
    "crosstalk.cl": """
__kernel void crosstalk(__global const float *restrict mean, __global float *restrict out, const int rows,
                        const int cols, const float share)
{
    const int x = get_global_id(0), y = get_global_id(1);
    GUARD(x >= cols || y >= rows)
    const float near = mean[max(y - 1, 0) * cols + x] + mean[min(y + 1, rows - 1) * cols + x]
                     + mean[y * cols + max(x - 1, 0)] + mean[y * cols + min(x + 1, cols - 1)];
    out[y * cols + x] = (1.0f - share) * mean[y * cols + x] + 0.25f * share * near;
}
""",
    "crosstalk_warp.py": """
import warp as wp


@wp.kernel
def crosstalk(mean: wp.array2d[float], out: wp.array2d[float], rows: int, cols: int, share: float):
    y, x = wp.tid()
    near = mean[max(y - 1, 0), x] + mean[min(y + 1, rows - 1), x]
    near = near + mean[y, max(x - 1, 0)] + mean[y, min(x + 1, cols - 1)]
    out[y, x] = (1.0 - share) * mean[y, x] + 0.25 * share * near
""",
}
LINES = {  # file: (the line after which they go, lines)
    "gpusim/domain/sensor.py": ("    row_time: float = 0.0\n", "    crosstalk: float = 0.0\n"),
    "gpusim/pipeline/imaging.py": (
        "            work=float(self.pixels * layers),\n        )\n\n",
        """        if self.sensor.crosstalk and cfa is not None:
            chain.add(
                "sensor.crosstalk",
                {"share": self.sensor.crosstalk},
                words=f"{self.sensor.crosstalk:g} of the electrons from neighbours",
                nbytes=4 * self.pixels,
                work=float(self.pixels),
            )

""",
    ),
    "gpusim/judge/truth.py": (
        "    found = []\n    for part, own, flat in zip(parts, wanted, flats, strict=True):\n",
        None,  # see `TRUTH`
    ),
}
TRUTH = (
    "    return found\n\n\ndef _within",
    """    if camera.sensor.crosstalk:
        wide = np.pad(found[0], 1, mode="edge")
        near = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
        found = [(1 - camera.sensor.crosstalk) * found[0] + camera.sensor.crosstalk / 4 * near]
    return found


def _within""",
)
USE = """
from pathlib import Path
import numpy as np
import gpusim as gs
from gpusim.kernels.stage import compare

Path("crosstalk.toml").write_text('base = "phone"\\n[sensor]\\ncrosstalk = 0.2\\nexposure_time_ms = 20\\n')
plain, mixed = gs.open_camera("phone").with_(exposure_time_ms=20), gs.open_camera("crosstalk.toml")
scene = gs.chart("deadleaves", size=(48, 32), seed=3)
for name in ("opencl", "warp:cpu"):
    device = gs.open_device(name)
    for case, error in compare("sensor.crosstalk", device):
        assert error <= case.tolerance, (name, case.name, error)
    simulate = gs.Simulator(mixed, device=device, tolerance=1e-3)
    report = simulate(scene, seed=1, verify=True).report
    assert "sensor.crosstalk" in report.table(), "the report is silent"
    order = [stage.stage for stage in report.stages]
    assert order.index("sensor.collect") < order.index("sensor.crosstalk") < order.index("sensor.noise")
    assert report.error.rms < 1e-3, f"true error {report.error.rms}"
    for start, end in ((plain, mixed), (mixed, plain)):
        loop = gs.Simulator(start, device=device).loop(scene)
        fresh = gs.Simulator(end, device=device).loop(scene)
        for output in ("mean", "raw", "codes"):
            before = np.array(device.numpy(loop.output(output, seed=1)))
            after = np.array(device.numpy(loop.update(camera=end).output(output, seed=1)))
            wanted = np.array(device.numpy(fresh.output(output, seed=1)))
            np.testing.assert_array_equal(after, wanted)
            assert not np.array_equal(before, after)
            loop.update(camera=start)
print("all is well")
"""


def add_stage(folder, forgotten=None):
    """Copy the package to a folder with the stage in it, but for the lines of a file that is forgotten."""
    for name in ("gpusim", "kernels"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name, text in FILES.items():
        (folder / "kernels" / "sensor" / name).write_text(text)
    for name, (place, lines) in LINES.items():
        if name == forgotten:
            continue
        path = folder / name
        text = path.read_text()
        place, new = (place, place + lines) if lines else TRUTH
        assert text.count(place) == 1, f"{name}: {place!r}"
        path.write_text(text.replace(place, new))


def use_stage(folder):
    """Run a program with the package of a folder. Returns what it printed and its last line of errors."""
    (folder / "use.py").write_text(USE)
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "use.py"], cwd=folder, env=environment, capture_output=True, text=True
    )
    return done.stdout, (done.stderr.strip().splitlines() or [""])[-1]


@pytest.mark.slow
def test_a_stage_is_four_files_and_three_edits(tmp_path):
    add_stage(tmp_path)
    assert use_stage(tmp_path) == ("all is well\n", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forgotten", "message"),
    [
        ("gpusim/domain/sensor.py", "unknown key 'crosstalk'"),
        ("gpusim/pipeline/imaging.py", "the report is silent"),
        ("gpusim/judge/truth.py", "true error 0."),
    ],
)
def test_none_of_them_can_be_forgotten(tmp_path, forgotten, message):
    add_stage(tmp_path, forgotten)
    found, error = use_stage(tmp_path)
    assert not found and message in error
