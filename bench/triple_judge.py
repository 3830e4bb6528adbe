"""The planner's verdicts on random questions, judged by independent sums (`--kinds combined`).

A frame is made with its noise and its picture, to find crashes. Its mean electrons are compared
with the interval between the answers of the sums. Frames that the sums do not cover are counted
separately, and so are those with the verdict "cannot be judged".
"""

import signal
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import triple_captures
import triple_features
import triple_mixed
import triple_outside
import triple_scenes

import gpusim as gs
from gpusim.domain.account import SAFETY, Tolerance
from gpusim.domain.errors import GpusimError, OutOfRange
from gpusim.judge.combinations import NoWay
from gpusim.pipeline.report import Error

KINDS = {
    "old": triple_mixed.OLD,
    "combined": triple_mixed.MIXED,
    "features": triple_features.DEVELOPMENT,
    "features-held-out": triple_features.HELD_OUT,
}
LIMIT = 150  # [s] for a question
JUST = 0.98  # a tolerance "near" over the planner's limit
SURE = 1e-6  # of the frame's light: accuracy of the sums, in addition to a share of each pixel's
SLOW = 10  # number of listed plans


class TookTooLong(Exception):
    """A question is not answered within its limit."""


def asked(
    seed: int, *, kinds: str, device: str, data=None, limit: int = LIMIT, only_met: bool = False
) -> list[dict]:
    """Return the row of a seed, in a list; an empty list if its measured data is missing.

    limit: time limit [s]. only_met: skip the sums for frames that are not reported as met.
    """
    row: dict = {"name": f"{kinds} {seed}", "seed": seed, "kinds": kinds, "words": f"{seed}"}
    began, rows = time.perf_counter(), [row]
    signal.signal(signal.SIGALRM, _give_up)
    signal.alarm(limit)
    try:
        question = _question(seed, kinds, data)
        if question is None:
            return []
        row |= {
            "words": question.words,
            "features": question.features,
            "tolerance": question.tolerance,
        }
        if kinds.startswith("features"):
            rows = [row | one for one in _captured(question, device, row, only_met)]
        else:
            row |= _answered(question, device, row, only_met)
    except TookTooLong:
        row |= {
            "status": "too slow",
            "text": f"more than {limit} s, in {row.get('doing', 'drawing')}",
        }
    except NoWay as reason:
        row |= {"status": "no way", "text": f"no way in the API: {reason}"}
    except GpusimError as refusal:
        row |= {"status": "refused", "text": f"{type(refusal).__name__}: {refusal}"}
    except Exception as error:  # count failures instead of ignoring them
        row |= {
            "status": "crash",
            "text": f"in {row.get('doing')}: " + "".join(traceback.format_exception(error)[-3:]),
        }
    finally:
        signal.alarm(0)
    return [one | {"seconds": time.perf_counter() - began} for one in rows]


def _question(seed, kinds, data):
    """Return the question of a seed, None if its data is missing."""
    if kinds.startswith("features"):
        return triple_features.triple(seed)
    return triple_mixed.triple(seed) if kinds == "combined" else triple_scenes.triple(seed, data)


def _captured(question, device, row, only_met):
    """Yield the verdict on each exposure of a question with captures, and the result of the sums."""
    row["doing"], began = "the frames", time.process_time()
    simulator = gs.Simulator(question.camera, device=device, tolerance=question.tolerance)
    asked = triple_captures.exposures(question, simulator)
    planning, tolerance = time.process_time() - began, Tolerance.parse(question.tolerance)
    for number, one in enumerate(asked):
        row["doing"] = f"the outside's sums of frame {number + 1} of {len(asked)}"
        found = {"status": "ok", "planning_s": planning, "frame": number}
        found |= _verdict(one.account, tolerance) | {"left_out": list(one.left_out)}
        if only_met and found["state"] != "met":
            yield found | {"within": None, "why": "not called met"}
            continue
        began = time.process_time()
        try:
            truth = triple_captures.answers(question, one)
        except (OutOfRange, MemoryError) as reason:
            yield found | {"within": None, "why": str(reason)[:160]}
            continue
        found |= _compared(truth, one.mean, question.camera.sensor.read_sigma, tolerance)
        yield found | {"truth_s": time.process_time() - began}


def _give_up(*_):
    raise TookTooLong


def _answered(question, device, row, only_met):
    """Return the planner's verdict, the frame, and whether both agree with the sums."""
    row["doing"], began = "planning", time.process_time()
    simulator = gs.Simulator(question.camera, device=device, tolerance=question.tolerance)
    if question.is_near:
        question = _moved(question, simulator)
        simulator = gs.Simulator(question.camera, device=device, tolerance=question.tolerance)
        began = time.process_time()
    plan = simulator.plan(question.scene)
    row |= {
        "planning_s": time.process_time() - began,
        "tolerance": question.tolerance,
        "doing": "exposing",
    }
    exposure = simulator.expose(question.scene)
    tolerance = Tolerance.parse(question.tolerance)
    account = exposure.plan.account.at(exposure.exposure_time)
    row |= _verdict(account, tolerance) | {"left_out": plan.left_out, "doing": "the frame"}
    exposure.frame()  # noise, raw values and the picture
    mean = np.array(simulator.device.numpy(exposure.mean), np.float64)
    row |= {"doing": "the outside's sums"}
    if only_met and row["state"] != "met":
        return {"status": "ok", "within": None, "why": "not called met"}
    return {"status": "ok"} | _outside(question, exposure.exposure_time, mean, tolerance)


def _verdict(account, tolerance):
    """Return the planner's verdict and its figures."""
    verdict = account.verdict(tolerance)
    return {
        "state": getattr(verdict, "state", "met" if verdict.is_met else "not met"),
        "verdict": str(verdict),
        "predicted": {
            "rms": account.total.rms,
            "p999_sigma": account.total.p999_sigma,
            "max_sigma": account.total.max_sigma,
        },
        "bounds": {
            name: bound.rms if np.isfinite(bound.rms) else None
            for name, bound in account.bounds.items()
        },
    }


def _moved(question, simulator):
    """Return the question with the tolerance that is just met by prediction, of the same kind."""
    exposure = simulator.expose(question.scene)
    rms = exposure.plan.account.total.rms * SAFETY / JUST
    return replace(question, tolerance=f"{rms:.4g}") if 2e-6 < rms < 0.5 else question


def _outside(question, seconds, mean, tolerance):
    """Return whether a frame is within its tolerance by the sums, None if they do not cover it."""
    began = time.process_time()
    try:
        found = triple_outside.answers(question.scene, question.camera, seconds)
    except (OutOfRange, MemoryError) as reason:
        return {"within": None, "why": str(reason)[:160]}
    compared = _compared(found, mean, question.camera.sensor.read_sigma, tolerance)
    return compared | {"truth_s": time.process_time() - began}


def _compared(found, mean, read, tolerance):
    """Return whether mean electrons are within a tolerance by the answers of the sums."""
    off, true = found.distance(mean)
    size = float(np.sqrt(np.mean(true**2)))
    sure = np.maximum(off - found.sure * true - SURE * size, 0)
    raw, least = Error.between(true + off, true, read), Error.between(true + sure, true, read)
    is_open = not raw.meets(tolerance) and least.meets(tolerance)
    return {
        "within": None if is_open else raw.meets(tolerance),
        "why": "beyond by less than these sums are sure of",
        "nearest": raw.nearest(tolerance)[1],
        "over": raw.nearest(tolerance)[0],
        "true": {"rms": raw.rms, "p999_sigma": raw.p999_sigma, "max_sigma": raw.max_sigma},
        "answers": len(found.means),
        "gain": float(mean.sum() / true.sum()) if true.sum() else 1.0,
    }


def run(ask, seeds, workers: int, add):
    """Ask all seeds. A process that dies is a crash, and the others continue."""
    todo = list(seeds)
    while todo:
        done = set()
        try:
            with ProcessPoolExecutor(
                min(workers, len(todo)), mp_context=get_context("spawn")
            ) as pool:
                futures = {pool.submit(ask, seed): seed for seed in todo}
                for future in as_completed(futures):
                    rows = future.result()
                    add(futures[future], rows)
                    done.add(futures[future])
        except BrokenProcessPool:
            todo = [seed for seed in todo if seed not in done]
            for seed in todo[: 2 * workers]:  # one of these; each by itself
                try:
                    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                        add(seed, pool.submit(ask, seed).result())
                except BrokenProcessPool:
                    add(
                        seed,
                        [
                            {
                                "name": f"{seed}",
                                "seed": seed,
                                "words": f"{seed}",
                                "status": "crash",
                                "text": "its process died",
                            }
                        ],
                    )
                done.add(seed)
        todo = [seed for seed in todo if seed not in done]


def line(row: dict) -> str:
    """Return a row as text."""
    if row["status"] != "ok":
        return f"{row['words']}: {row['status']} {row.get('text', '')[:300]}"
    judged = {None: f"outside does not say: {row.get('why')}", True: "within", False: "BEYOND"}[
        row["within"]
    ]
    return (
        f"{row['words']}: {row['state']}, {judged} {row.get('nearest', '')}; planning {row['planning_s']:.1f} s, "
        f"truth {row.get('truth_s', 0):.1f} s, gain {row.get('gain', 1) - 1:+.1e}"
    )


def summary(rows: list[dict]) -> str:
    """Return how often the verdicts are right, and the seeds of the others."""
    good = [row for row in rows if row["status"] == "ok"]
    says = {
        state: [row for row in good if row["state"] == state]
        for state in ("met", "not met", "not judged")
    }
    met = [row for row in says["met"] if row["within"] is not None]
    false = sorted((row for row in met if not row["within"]), key=lambda row: -row["over"])
    unmet = [row for row in says["not met"] if row["within"] is not None]
    unsure = [row for row in says["not judged"] if row["within"] is not None]
    found = [
        f"{len(rows)} asked: {len(good)} answered, {sum(row['status'] == 'refused' for row in rows)} refused, "
        f"{sum(row['status'] == 'no way' for row in rows)} without a way in the API, "
        f"{sum(row['status'] == 'too slow' for row in rows)} too slow, "
        f"{sum(row['status'] == 'crash' for row in rows)} crashed; judged by independent sums: "
        f"{sum(row['within'] is not None for row in good)}",
        f"met: {len(says['met'])}, judged {len(met)}: true {len(met) - len(false)}, false {len(false)}"
        + (f" ({100 * (1 - len(false) / len(met)):.1f} % true)" if met else ""),
        f"not met: {len(says['not met'])}, judged {len(unmet)}, beyond the tolerance "
        f"{sum(not row['within'] for row in unmet)}",
        f"cannot be judged by the planner: {len(says['not judged'])}, judged by the sums {len(unsure)}, beyond "
        f"{sum(not row['within'] for row in unsure)}",
    ]
    found += [f"crash: {row['words']}: {row['text']}" for row in rows if row["status"] == "crash"]
    found += [
        f"false met, {row['nearest']} (rms predicted {row['predicted']['rms']:.2g}, gain {row['gain'] - 1:+.1e})"
        f": {row['words']}"
        for row in false
    ]
    reasons = Counter(
        row["text"].partition(", got")[0][:110]
        for row in rows
        if row["status"] in ("refused", "no way")
    )
    found += [f"refused {count} times: {text}" for text, count in reasons.most_common()]
    found += [
        f"too slow: {row['words']}: {row['text']}" for row in rows if row["status"] == "too slow"
    ]
    reasons = Counter(row["why"][:80] for row in good if row["within"] is None)
    found += [
        f"not covered by the sums, {count} times: {text}" for text, count in reasons.most_common(8)
    ]
    slow = sorted((row for row in good), key=lambda row: -row["planning_s"])[:SLOW]
    return "\n".join(
        [*found, *(f"plan of {row['planning_s']:.1f} s: {row['words']}" for row in slow)]
    )
