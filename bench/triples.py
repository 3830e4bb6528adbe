"""Checks predictions and verdicts on random scenes, cameras and tolerances.

`python bench/triples.py --half development --data FOLDER --json triples.json` asks and judges;
`python bench/triples.py --summary triples.json` prints the summary again. `python bench/triples.py
--kinds combined --seeds 34000:34200 --workers 16 --json combined.json` uses the independent judge.
"""

import contextlib
import json
import re
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, replace
from functools import partial
from math import isfinite
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import triple_judge
from results import count, finish, load, parser, ready, start
from triple_scenes import DEVELOPMENT, HELD_OUT, TOLERANCES, triple
from triple_summary import summary

import gpusim as gs
from gpusim.bench.timing import find_rms
from gpusim.domain.account import Tolerance
from gpusim.domain.errors import BadFile, GpusimError, OutOfRange
from gpusim.judge.speeds import frame_ms
from gpusim.judge.truth import mean_and_truth, require_truth
from gpusim.pipeline.report import Error
from gpusim.planner.choices import Blur

HALVES = {"development": DEVELOPMENT, "held-out": HELD_OUT}
LADDER = TOLERANCES[:6]  # relative RMS errors, from loose to tight
MONOTONE = 20  # scenes of a half for every step of the ladder
REPEAT = 5  # frames that are timed


def main():
    """Ask, judge, print and store."""
    made = parser(__doc__)
    made.add_argument(
        "--kinds",
        choices=triple_judge.KINDS,
        help="judge new seeds of these kinds by independent sums",
    )
    made.add_argument(
        "--limit",
        type=count,
        default=triple_judge.LIMIT,
        metavar="SECONDS",
        help=f"time limit of a question of --kinds (default: {triple_judge.LIMIT})",
    )
    made.add_argument(
        "--only-met", action="store_true", help="with --kinds: judge only frames reported as met"
    )
    made.add_argument(
        "--half", choices=HALVES, default="development", help="seeds (default: development)"
    )
    made.add_argument("--seeds", metavar="LIST", help="only these of them, for example 3,5,20-29")
    made.add_argument(
        "--data", type=Path, metavar="FOLDER", help="folder of measured scenes (default: none)"
    )
    made.add_argument("--jobs", "--workers", type=count, default=1, help="processes (default: 1)")
    made.add_argument(
        "--time", action="store_true", help="also time frames with and without the tolerance"
    )
    made.add_argument(
        "--brute", action="store_true", help="judge the reference by independent sums"
    )
    made.add_argument(
        "--monotone", action="store_true", help="ask some scenes for every tolerance instead"
    )
    made.add_argument(
        "--summary", metavar="FILE", help="print the summary of a stored result and end"
    )
    arguments = made.parse_args()
    if arguments.kinds:
        ask_kinds(arguments)
        return
    if arguments.summary:
        print(summary(load(arguments.summary)["rows"])[0])
        return
    device, old = ready(arguments, "triples")
    if arguments.data is not None and not arguments.data.is_dir():
        raise BadFile(arguments.data, "is not a folder")
    seeds = [
        seed
        for seed in HALVES[arguments.half]
        if seed in chosen(arguments.seeds, HALVES[arguments.half])
    ]
    ask = partial(
        ladder if arguments.monotone else partial(asked, brute=arguments.brute),
        device=device.name,
        data=arguments.data,
        timed=arguments.time,
    )
    if arguments.monotone and not arguments.seeds:
        seeds = seeds[:: len(seeds) // MONOTONE]
    rows = run(
        ask,
        seeds,
        arguments.jobs,
        quiet=arguments.half == "held-out",
        kept=arguments.json and Path(f"{arguments.json}.rows"),
    )
    print(summary(rows)[0])
    finish(arguments, "triples", device, rows, old, half=arguments.half)


def ask_kinds(arguments):
    """Judge new questions by independent sums; rows go to FILE.rows, to continue later."""
    if arguments.summary:
        rows = [
            row
            for line in Path(arguments.summary).read_text().splitlines()
            for row in json.loads(line)[1]
        ]
        print(triple_judge.summary(rows))
        return
    device, old = ready(arguments, "triples")
    seeds = sorted(chosen(arguments.seeds, triple_judge.KINDS[arguments.kinds]))
    ask = partial(
        triple_judge.asked,
        kinds=arguments.kinds,
        device=device.name,
        data=arguments.data,
        limit=arguments.limit,
        only_met=arguments.only_met,
    )
    rows = run(
        ask,
        seeds,
        arguments.jobs,
        kept=arguments.json and Path(f"{arguments.json}.rows"),
        words=triple_judge.line,
        apart=triple_judge.run,
    )
    print(triple_judge.summary(rows))
    finish(arguments, "triples", device, rows, old, kinds=arguments.kinds)


def chosen(text: str | None, allowed) -> set:
    """Parse a list of numbers, for example 3,5,20-29; None means all allowed. Raises BadFile."""
    if text is None:
        return set(allowed)
    found = set()
    for part in text.split(","):
        match = re.fullmatch(r"(\d{1,6})(?:([-:])(\d{1,6}))?", part)
        if not match:
            raise BadFile(
                f"--seeds {text}", f"{part!r} is no seed; wanted numbers such as 3,5,20-29 or 0:160"
            )
        last = int(match[3] or match[1])
        found |= set(range(int(match[1]), last + (match[2] != ":")))
    return found


def run(
    ask, seeds, jobs: int = 1, quiet: bool = False, kept: Path | None = None, words=None, apart=None
) -> list[dict]:
    """Return the rows of all seeds, in order, by several processes if requested.

    kept: a file that receives each row, one line of JSON for each seed; an interrupted run
    continues from it. words: of a row, instead of `line`. apart: runs them in processes that may
    die.
    """
    found: dict = {}
    if kept and kept.is_file():
        found = {
            seed: rows
            for seed, rows in map(json.loads, kept.read_text().splitlines())
            if seed in seeds
        }
    seeds, todo = list(seeds), [seed for seed in seeds if seed not in found]

    def add(seed, rows):
        found[seed] = rows
        if kept:
            with kept.open("a") as file:
                file.write(json.dumps([seed, plain(rows)]) + "\n")
        for row in [] if quiet else rows:
            print(f"{len(found)}/{len(seeds)} {(words or line)(row)}", flush=True)

    if apart:
        apart(ask, todo, jobs, add)
    elif jobs == 1:
        for seed in todo:
            add(seed, ask(seed))
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(ask, seed): seed for seed in todo}
            for future in as_completed(futures):
                add(futures[future], future.result())
    return [row for seed in seeds for row in found[seed]]


def line(row: dict) -> str:
    """Return a row as text."""
    if row["status"] != "ok":
        return f"{row['words'] or row['name']}: {row['status']} {row.get('text', '')[:200]}"
    said = {True: "met", False: "NOT met", None: "says nothing"}[row["met"]]
    return (
        f"{row['words']}: {said}, {'within' if row['within'] else 'BEYOND'}; rms {row['true']['rms']:.2g} "
        f"predicted {row['total']['rms'] or 0:.2g}; {row['seconds']:.1f} s"
    )


def asked(
    seed: int,
    *,
    device: str,
    data: Path | None = None,
    tolerance: str | None = None,
    timed: bool = False,
    brute: bool = False,
) -> list[dict]:
    """Return the row of a seed in a list, empty if data is missing. tolerance: replaces its own."""
    row: dict = {"name": f"seed {seed}", "seed": seed, "words": ""}
    began = time.perf_counter()
    try:
        question = triple(seed, data)
        if question is None:
            return []
        question = replace(question, tolerance=tolerance or question.tolerance)
        row |= {
            "words": question.words,
            "kind": question.kind,
            "border": question.border,
            "lens": question.lens,
            "tolerance": question.tolerance,
            "form": question.scene.content.form,
            "samples_per_pixel": question.scene.samples_per_pixel,
            "shape": question.scene.shape,
        }
        row |= judged(question, device, brute, timed)
        if timed and row["status"] == "ok":
            row |= times(question, device)
    except Exception as error:  # count failures instead of ignoring them
        row |= {"status": "crash", "text": "".join(traceback.format_exception(error)[-3:])}
    return [plain(row | {"seconds": time.perf_counter() - began})]


def plain(value):
    """Return the same for JSON: numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not isfinite(value) else value


def judged(question, device: str, brute: bool = False, timed: bool = False) -> dict:
    """Return the planner's verdict on a question, and the true error of the frame.

    brute: also judge the reference. timed: predict the time of a frame.
    """
    tolerance = Tolerance.parse(question.tolerance)
    try:
        simulator = gs.Simulator(question.camera, device=device, tolerance=question.tolerance)
        exposure = simulator.expose(question.scene)
        plan = exposure.plan
        account = plan.account.at(exposure.exposure_time)
        verdict = account.verdict(tolerance, plan.verdict.remedy)
        require_truth(question.camera, question.scene)
        mean, truth = mean_and_truth(simulator, question.scene, exposure)
    except GpusimError as refusal:
        return {"status": "refused", "text": f"{type(refusal).__name__}: {refusal}"}
    error = Error.between(mean, truth, question.camera.sensor.read_sigma)
    true = {"rms": error.rms, "p999_sigma": error.p999_sigma, "max_sigma": error.max_sigma}
    bound = next(key for key in true if getattr(tolerance, key) is not None)
    promised, total = getattr(account.total, bound), account.total.rms
    row = {
        "status": "ok",
        "met": verdict.is_met,
        "verdict": str(verdict),
        "by": verdict.by,
        "within": error.meets(tolerance),
        "nearest": error.nearest(tolerance)[1],
        "bound": bound,
        "allowed": getattr(tolerance, bound),
        "true": true,
        "max_local": error.max_local,
        "total": asdict(account.total),
        "bounds": {name: asdict(one) for name, one in account.bounds.items()},
        "beside": plan.beside,
        "ratio": over(promised, true[bound]),
        "ratio_rms": over(total, error.rms),
        "models": plan.models,
        "left_out": plan.left_out,
        "expected_time": plan.account.seconds,
        "planes": None if plan.find(Blur) is None else plan.count,
        "period": plan.period,
        "samples": plan.scene.content.shape,
        "q": [float(plan.q.min()), float(plan.q.max())],
        "predicted_ms": sum(frame_ms(simulator, plan).values()) if timed else None,
        "exposure_time": exposure.exposure_time,
        "largest_e": float(mean.max()),
    }
    return row | (compared(question, exposure.exposure_time, mean, truth) if brute else {})


def over(predicted: float | None, true: float) -> float | None:
    """Return predicted over true, None if one of them is unknown or 0."""
    return predicted / true if predicted and true else None


def compared(question, seconds: float, mean, truth) -> dict:
    """Relative RMS errors of the truth and of a frame against sums that share nothing with either."""
    import triple_outside

    try:
        (own,) = triple_outside.answers(question.scene, question.camera, seconds, wide=3).means
    except OutOfRange as refusal:
        return {"brute": {"refused": str(refusal)}}
    return {
        "brute": {
            "truth": find_rms(np.maximum(truth, 0), own),  # sums are not negative
            "frame": find_rms(mean, own),
            "truth_sigma": Error.between(truth, own, question.camera.sensor.read_sigma).max_sigma,
        }
    }


def times(question, device: str) -> dict:
    """Return milliseconds of planning and of the steady state.

    New scenes, with the tolerance and exact. Frames alternate between both, so other work on the
    machine affects both.
    """
    scenes = [
        replace(
            question.scene,
            content=question.scene.content.with_planes(question.scene.content.planes.copy()),
        )
        if question.scene.content.form != "picture"
        else replace(question.scene)
        for _ in range(2)
    ]
    loops, found = {}, {}
    for name, tolerance in (("frame", question.tolerance), ("exact", None)):
        simulator = gs.Simulator(question.camera, device=device, tolerance=tolerance)
        begin = time.perf_counter()
        simulator.plan(question.scene)
        found[f"{name}_planning_ms"] = 1e3 * (time.perf_counter() - begin)
        loops[name] = simulator.loop(question.scene, exposure_time=0.01)
        loops[name].frame()
    walls: dict = {name: [] for name in loops}
    stages: dict = {name: [] for name in loops}
    for number in range(REPEAT + 1):
        for name, loop in loops.items():
            begin = time.perf_counter()
            raw = loop.update(scene=scenes[0]).raw()
            loop.simulator.device.numpy(raw)  # waits; a frame is small
            taken = 1e3 * (time.perf_counter() - begin)
            report = loop.update(scene=scenes[1]).frame().report  # all its stages, including codes
            if number:
                walls[name].append(taken)
                stages[name].append(report.ms)
    found |= {f"{name}_ms": float(np.median(values)) for name, values in walls.items()}
    return found | {
        f"{name}_stages_ms": float(np.median(values)) for name, values in stages.items()
    }


def ladder(seed: int, *, device: str, data: Path | None = None, timed: bool = False) -> list[dict]:
    """Return the rows of a seed for every tolerance of LADDER."""
    rows: list = []
    for tolerance in LADDER:
        for row in asked(seed, device=device, data=data, tolerance=tolerance, timed=timed):
            rows.append(row | {"name": f"{row['name']} at {tolerance}", "ladder": True})
    return rows


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        start(main)
    sys.exit()
