"""Summary of the results of `bench/triples.py`: right and wrong verdicts."""

from itertools import pairwise

import numpy as np

BAND = 2.5  # of predicted over true
NOISE = 1.25  # of times: allowed slowdown of a loose tolerance against a tight one
ROUNDING = 3e-7  # relative RMS of float32 below which errors do not fall in order


def summary(rows: list[dict]) -> tuple[str, dict]:
    """Return a table as text and the same numbers in a dict."""
    plain, ladders = (
        [row for row in rows if not row.get("ladder")],
        [row for row in rows if row.get("ladder")],
    )
    told, parts = [], {}
    if plain:
        parts["promise"] = promise(plain)
        told += promise_lines(parts["promise"])
        brute = [row for row in plain if row.get("brute")]
        if brute:
            parts["truth"] = truth(brute)
            told += truth_lines(parts["truth"])
        if any("frame_ms" in row for row in plain):
            parts["times"] = times(plain)
            told += [
                f"tolerance {name}: {found['speed_up']:.2f} times as fast as exact (wall, median of "
                f"{found['count']}), {found['stages']:.2f} by stages"
                + (
                    f"; predicted over measured {found['predicted_over_measured']:.2f}"
                    if found["predicted_over_measured"]
                    else ""
                )
                for name, found in parts["times"].items()
            ]
    if ladders:
        parts["order"] = order(ladders)
        told += [
            f"ladders: {parts['order']['ladders']}; less accurate at a tighter tolerance: "
            f"{'; '.join(parts['order']['less_accurate']) or 'none'}",
            f"slower at a looser one: {'; '.join(parts['order']['slower']) or 'none'}",
        ]
    return "\n".join(told), parts


def promise(rows) -> dict:
    """Return counts for all rows and each tolerance, with the seeds of wrong verdicts."""
    good = [row for row in rows if row["status"] == "ok"]
    met, unmet = ([row for row in good if row["met"] is said] for said in (True, False))
    ratios = [row for row in good if row["ratio"]]
    tails = [row for row in ratios if not 1 / BAND <= row["ratio"] <= BAND]
    by_rms = [row["ratio_rms"] for row in good if row["ratio_rms"]]
    return {
        "rows": len(rows),
        "ok": len(good),
        "met": len(met),
        "unmet": len(unmet),
        "undecided": len(good) - len(met) - len(unmet),
        "crashes": [(row["seed"], row["text"]) for row in rows if row["status"] == "crash"],
        "refused": [(row["seed"], row["text"]) for row in rows if row["status"] == "refused"],
        "met_within": sum(row["within"] for row in met),
        "unmet_beyond": sum(not row["within"] for row in unmet),
        "silent": [
            (row["seed"], row["words"], row["nearest"], worst(row))
            for row in met
            if not row["within"]
        ],
        "needless": [
            (row["seed"], row["words"], row["nearest"], row["verdict"])
            for row in unmet
            if row["within"]
        ],
        "ratios": len(ratios),
        "in_band": len(ratios) - len(tails),
        "quantiles": quantiles(row["ratio"] for row in ratios),
        "rms_ratios": len(by_rms),
        "rms_in_band": sum(1 / BAND <= ratio <= BAND for ratio in by_rms),
        "rms_quantiles": quantiles(by_rms),
        "tails": [
            (row["seed"], row["ratio"], row["bound"], worst(row), row["words"])
            for row in sorted(tails, key=lambda row: row["ratio"])
        ],
        "rms_tails": [
            (row["seed"], row["ratio_rms"], row["true"]["rms"], worst(row), row["words"])
            for row in sorted(
                (row for row in good if row["ratio_rms"]), key=lambda row: row["ratio_rms"]
            )
            if not 1 / BAND <= row["ratio_rms"] <= BAND
        ],
        "tolerances": {
            name: of_tolerance([row for row in good if row["tolerance"] == name])
            for name in dict.fromkeys(row["tolerance"] for row in good)
        },
    }


def of_tolerance(rows) -> dict:
    """Return the counts of one tolerance's rows."""
    ratios = [row["ratio_rms"] for row in rows if row["ratio_rms"]]
    return {
        "count": len(rows),
        "met": sum(row["met"] is True for row in rows),
        "within": sum(row["within"] for row in rows),
        "silent": sum(row["met"] is True and not row["within"] for row in rows),
        "needless": sum(row["met"] is False and row["within"] for row in rows),
        "in_band": sum(1 / BAND <= ratio <= BAND for ratio in ratios),
        "ratios": len(ratios),
        "ratio": float(np.median(ratios)) if ratios else None,
        "used": float(np.median([row["true"][row["bound"]] / row["allowed"] for row in rows])),
    }


def worst(row) -> str:
    """Return the largest of a row's named bounds, in its tolerance's unit if there is one."""
    bounds = {
        name: bound.get(row["bound"]) or bound["rms"] or 0.0
        for name, bound in row["bounds"].items()
    }
    return max(bounds, key=bounds.get) if bounds else "nothing"


def quantiles(values) -> list[float]:
    """Return the 0, 5, 25, 50, 75, 95 and 100 % quantiles."""
    values = list(values)
    return (
        [float(value) for value in np.percentile(values, (0, 5, 25, 50, 75, 95, 100))]
        if values
        else []
    )


def promise_lines(found: dict) -> list[str]:
    """Return `promise` as text."""
    lines = [
        f"{found['rows']} triples: {found['ok']} judged, {len(found['refused'])} refused, "
        f"{len(found['crashes'])} crashed",
        f"reported as met: {found['met']} (within the tolerance: {found['met_within']}); as NOT met: "
        f"{found['unmet']} (beyond it: {found['unmet_beyond']}); undecided: {found['undecided']}",
        f"predicted over true, in the tolerance's unit: {found['in_band']} of {found['ratios']} within 1/{BAND} .. "
        f"{BAND}; quantiles {shown(found['quantiles'])}",
        f"predicted over true, rms: {found['rms_in_band']} of {found['rms_ratios']}; quantiles "
        f"{shown(found['rms_quantiles'])}",
        f"{'tolerance':10s} {'count':>5s} {'met':>4s} {'within':>6s} {'silent':>6s} {'needless':>8s} "
        f"{'rms ratios in band':>18s} {'median':>6s} {'true over allowed, median':>25s}",
    ]
    lines += [
        f"{name:10s} {one['count']:5d} {one['met']:4d} {one['within']:6d} {one['silent']:6d} "
        f"{one['needless']:8d} {one['in_band']:9d} of {one['ratios']:5d} {one['ratio'] or 0:6.2f} "
        f"{one['used']:25.2g}"
        for name, one in found["tolerances"].items()
    ]
    lines += [f"crash {seed}: {text}" for seed, text in found["crashes"]]
    lines += [f"refused {seed}: {text}" for seed, text in found["refused"]]
    lines += [
        f"silent miss {nearest} (largest: {name}): {words}"
        for _, words, nearest, name in found["silent"]
    ]
    lines += [
        f"needless NOT met, {nearest} (predicted {said}): {words}"
        for _, words, nearest, said in found["needless"]
    ]
    lines += [
        f"predicted over true {ratio:.3g} {bound} (largest: {name}): {words}"
        for _, ratio, bound, name, words in found["tails"]
    ]
    return lines + [
        f"predicted over true {ratio:.3g} rms of {true:.2g} (largest: {name}): {words}"
        for _, ratio, true, name, words in found["rms_tails"]
    ]


def shown(values) -> str:
    """Return numbers in a row."""
    return " ".join(f"{value:.3g}" for value in values)


def truth(rows) -> dict:
    """Return the difference of `gpusim.judge.truth` and the brute force, and their verdicts."""
    judged = [row for row in rows if "refused" not in row["brute"]]
    by_size = sorted(judged, key=lambda row: -row["brute"]["truth"])
    return {
        "judged": len(judged),
        "refused": len(rows) - len(judged),
        "quantiles": quantiles(row["brute"]["truth"] for row in judged),
        "worst": [
            (
                row["seed"],
                row["brute"]["truth"],
                row["brute"]["frame"],
                row["true"]["rms"],
                row["words"],
            )
            for row in by_size[:8]
        ],
        "lenses": sorted({row["lens"] for row in judged}),
        "borders": sorted({row["border"] for row in judged}),
    }


def truth_lines(found: dict) -> list[str]:
    """Return `truth` as text."""
    return [
        f"reference against brute force: {found['judged']} triples ({found['refused']} refused), lenses "
        f"{', '.join(found['lenses'])}; borders {', '.join(found['borders'])}; relative rms "
        f"{shown(found['quantiles'])}",
        *(
            f"reference {off:.2g} from it, frame {frame:.2g} from it and {true:.2g} from the reference: {words}"
            for _, off, frame, true, words in found["worst"]
        ),
    ]


def times(rows) -> dict:
    """Return speed-ups for each tolerance, and the accuracy of predicted times."""
    timed = [row for row in rows if row.get("frame_ms")]
    found = {}
    for name in dict.fromkeys(row["tolerance"] for row in timed):
        own = [row for row in timed if row["tolerance"] == name]
        known = [row["predicted_ms"] / row["frame_ms"] for row in own if row["predicted_ms"]]
        found[name] = {
            "count": len(own),
            "speed_up": float(np.median([row["exact_ms"] / row["frame_ms"] for row in own])),
            "stages": float(
                np.median([row["exact_stages_ms"] / row["frame_stages_ms"] for row in own])
            ),
            "predicted_over_measured": float(np.median(known)) if known else None,
        }
    return found


def order(rows) -> dict:
    """Return the tolerances of a ladder, loose to tight, that get less accurate or faster."""
    ladders: dict = {}
    for row in rows:
        if row["status"] == "ok":
            ladders.setdefault(row["seed"], []).append(row)
    less, slower = [], []
    for seed, steps in ladders.items():
        for loose, tight in pairwise(steps):
            name = f"seed {seed}, {loose['tolerance']} to {tight['tolerance']}"
            if tight["true"]["rms"] > max(loose["true"]["rms"], ROUNDING) * 1.02:
                less.append(f"{name}: {loose['true']['rms']:.2g} to {tight['true']['rms']:.2g}")
            if loose.get("frame_ms") and loose["frame_ms"] > NOISE * tight["frame_ms"]:
                slower.append(f"{name}: {loose['frame_ms']:.3g} to {tight['frame_ms']:.3g} ms")
    return {"ladders": len(ladders), "less_accurate": less, "slower": slower}
