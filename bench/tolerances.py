"""Time saved by a tolerance, compared with exact frames and with NumPy and SciPy.

    python bench/tolerances.py --device opencl --size 1920x1080 --json bench/results/tolerances-NAME.json

Frames are new cubes to raw. Cubes of 31 bands are on the device; for the baseline
(gpusim/bench/baseline.py) they are on the host, which computes it. The baseline makes the same frame as
gpusim without a tolerance. Errors are in the mean electrons (gpusim/judge/truth.py). Predicted
times are for all stages of a frame, including codes, and are compared with measured times of these
stages. The result has a row for every question; the table has one for every tolerance, with
medians, minima and maxima.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from results import add_repeat, add_size, finish, parser, ready, start
from triple_scenes import TOLERANCES

import gpusim as gs
from gpusim.bench.baseline import Baseline
from gpusim.bench.loops import SECONDS, make_cube, resident_scene
from gpusim.bench.timing import find_quartiles, find_rms, time_in_turns
from gpusim.domain.content import Cube
from gpusim.judge.speeds import Speeds, frame_ms
from gpusim.judge.truth import true_mean
from gpusim.planner.choices import Blur

CAMERAS = ("phone", "machine-vision", "mono", "figure8")
CHARTS = ("deadleaves", "colorchecker", "slanted-edge")
STEADY, GPU_STEADY = (
    3,
    100,
)  # frames of a timed call: enough to make the first and last negligible


def main():
    """Print and store the rows."""
    made = parser(__doc__)
    add_size(made)
    add_repeat(made, 5)
    made.add_argument("--cameras", nargs="+", default=CAMERAS, help=f"default: {' '.join(CAMERAS)}")
    arguments = made.parse_args()
    device, old = ready(arguments, "tolerances")
    with TemporaryDirectory() as folder:  # cached speeds may be old
        rows = all_rows(arguments, device, Speeds(device, Path(folder) / "speeds.json"))
    print("\n".join(table(rows)))
    finish(
        arguments,
        "tolerances",
        device,
        rows,
        old,
        size=arguments.size,
        repeat=arguments.repeat,
        cameras=list(arguments.cameras),
        charts=list(CHARTS),
    )


def all_rows(arguments, device, speeds) -> list[dict]:
    """Return the rows of all questions; they are printed when they are ready."""
    rows = []
    for camera in [gs.open_camera(name) for name in arguments.cameras]:
        for chart in CHARTS:
            for row in asked(
                device, camera, gs.chart(chart, size=arguments.size), speeds, arguments.repeat
            ):
                rows.append(row)
                print(line(row), flush=True)
    return rows


def asked(device, camera, picture, speeds, repeat) -> list[dict]:
    """Return a row for every tolerance."""
    values = make_cube(picture)
    scenes = [
        resident_scene(device, replace(picture, content=Cube(picture.wavelengths, values * gain)))
        for gain in np.float32((1, 1.01))
    ]
    simulators = {
        name: gs.Simulator(camera, device=device, tolerance=name) for name in (*TOLERANCES, None)
    }
    loops = {name: simulator.loop(scenes[0], SECONDS) for name, simulator in simulators.items()}
    on_host = replace(picture, content=Cube(picture.wavelengths, values))
    baseline, truth = (
        Baseline(simulators[None], on_host),
        true_mean(gs.Simulator, camera, on_host, simulators[None].plan(on_host), SECONDS),
    )
    steady = GPU_STEADY if device.is_gpu else STEADY
    forms = {name: lambda loop=loop: frames(loop, scenes, steady) for name, loop in loops.items()}
    walls = time_in_turns(
        {**forms, "baseline": lambda: baseline.raw(values, SECONDS)}, repeat, warm=1
    )
    exposures = {
        name: simulator.expose(scenes[0], SECONDS) for name, simulator in simulators.items()
    }
    rows = []
    for name in TOLERANCES:
        taken, plan, own = walls[name] / steady, loops[name].plan, exposures[name].plan
        measured = stages(loops[name], scenes)
        rows.append(
            {
                "name": f"{camera.name}, {picture.name}, {name}",
                "tolerance": name,
                **find_quartiles(taken),
                **find_quartiles(walls[None] / steady / taken, "exact"),
                **find_quartiles(walls["baseline"] / taken, "baseline"),
                "predicted_ms": sum(frame_ms(simulators[name], plan, speeds).values()),
                "stages_ms": measured,
                "error": find_rms(device.numpy(exposures[name].mean), truth),
                "predicted": own.account.total.rms,
                "met": own.verdict.is_met,
                "planes": None if plan.find(Blur) is None else plan.count,
                "period": plan.period,
            }
        )
    return rows


def frames(loop, scenes, count):
    """Compute raw values of `count` new scenes."""
    for k in range(count):
        loop.update(scene=scenes[k % 2]).raw(seed=1, first=k)
    loop.simulator.device.sync()


def stages(loop, scenes) -> float:
    """Return the milliseconds of all stages of a frame, including codes: the median of a few."""
    return float(
        np.median(
            [loop.update(scene=scenes[k % 2]).frame(seed=1, first=k).report.ms for k in range(5)]
        )
    )


def line(row) -> str:
    """Return a row as text."""
    return (
        f"{row['name']:44s} {row['ms_p50']:8.3f} ms, {row['exact_p50']:5.2f} times as fast as exact, "
        f"{row['baseline_p50']:6.2f} as the baseline; rms {row['error']:.1e} ({row['predicted']:.1e} predicted); "
        f"predicted over measured time {row['predicted_ms'] / row['stages_ms']:.2f}"
    )


def by_tolerance(rows) -> list[dict]:
    """Return minimum, median and maximum for every tolerance."""
    found = []
    for name in dict.fromkeys(row["tolerance"] for row in rows):
        own = [row for row in rows if row["tolerance"] == name]
        found.append(
            {
                "tolerance": name,
                **{
                    key: find_quartiles([row[f"{key}_p50"] for row in own], key)
                    for key in ("exact", "baseline")
                },
                "time": find_quartiles(
                    [row["predicted_ms"] / row["stages_ms"] for row in own], "time"
                ),
                "error": float(np.median([row["error"] for row in own])),
                "met": sum(row["met"] for row in own),
                "count": len(own),
            }
        )
    return found


def table(rows) -> list[str]:
    """Return `by_tolerance` as text, and the number of times predicted within a factor of 1.5."""
    lines = [
        f"{one['tolerance']:10s} {one['exact']['exact_p50']:6.2f} times as fast as exact "
        f"({one['exact']['exact_least']:.2f} .. {one['exact']['exact_most']:.2f}), "
        f"{one['baseline']['baseline_p50']:7.2f} as the baseline ({one['baseline']['baseline_least']:.2f} .. "
        f"{one['baseline']['baseline_most']:.2f}); rms {one['error']:.1e}; met {one['met']} of {one['count']}"
        for one in by_tolerance(rows)
    ]
    return [*lines, f"predicted time within a factor of 1.5: {within(rows)}"]


def within(rows) -> str:
    """Return the number of times predicted within a factor of 1.5, and the range of the ratio."""
    ratios = [row["predicted_ms"] / row["stages_ms"] for row in rows]
    good = sum(1 / 1.5 <= ratio <= 1.5 for ratio in ratios)
    return f"{good} of {len(rows)} ({min(ratios):.2f} .. {max(ratios):.2f})"


if __name__ == "__main__":
    start(main)
