"""Times of several forms of one task, measured in turns, and the rows that tell them."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def find_quartiles(times: ArrayLike, key: str = "ms") -> dict[str, float]:
    """Return smallest, quartiles and largest of times, for a row.

    Args:
        times: Times [ms], or ratios.
        key: Begin of the keys.
    """
    values = np.percentile(np.asarray(times, np.float64), (0, 25, 50, 75, 100))
    return {
        f"{key}_{name}": float(value)
        for name, value in zip(("least", "p25", "p50", "p75", "most"), values, strict=True)
    }


def find_rms(values: ArrayLike, truth: ArrayLike) -> float:
    """Return the RMS difference over the RMS of the truth, in float64.

    Args:
        values: Values.
        truth: True values, of that shape.
    """
    truth = np.asarray(truth, np.float64)
    return float(
        np.sqrt(np.mean((np.asarray(values, np.float64) - truth) ** 2) / np.mean(truth**2))
    )


def time_in_turns(
    forms: dict[str, Callable[[], Any]], repeat: int, warm: int = 1, turn_ms: float = 0.0
) -> dict[str, np.ndarray]:
    """Return milliseconds of one call of each form in every round, name -> array (repeat,).

    Rounds alternate between all forms, so that other work on the machine affects all of them.

    Args:
        forms: Name -> function that does the work and waits.
        repeat: Rounds.
        warm: Rounds before them that are not counted.
        turn_ms: A turn lasts about as long [ms], by further calls of a form that is faster; a processor and a GPU are
            not at their full clock just after something else. 0: each turn is one call.
    """
    times: dict[str, list[float]] = {name: [] for name in forms}
    calls = dict.fromkeys(forms, 1)
    for number in range(-warm, repeat):
        for name, run in forms.items():
            begin = time.perf_counter()
            for _ in range(calls[name]):
                run()
            taken = 1e3 * (time.perf_counter() - begin) / calls[name]
            if number >= 0:
                times[name].append(taken)
            else:
                calls[name] = max(1, round(turn_ms / max(taken, 1e-3)))
    return {name: np.array(taken) for name, taken in times.items()}


def compare_times(
    times: dict[str, np.ndarray],
    bases: dict[str, str],
    errors: dict[str, str] | None = None,
    each: dict[str, int] | None = None,
) -> list[dict[str, Any]]:
    """Return rows of forms timed in rounds, each with its ratio to a base within a round.

    Args:
        times: Name -> times, see `time_in_turns`.
        bases: Name of a form -> name of its base. "over" is the base's time over the form's.
        errors: Error of each in words, if known.
        each: Frames per call of a form, by default 1.
    """
    each, errors = each or {}, errors or {}
    scaled = {name: taken / each.get(name, 1) for name, taken in times.items()}
    rows = []
    for name, taken in scaled.items():
        row = {"name": name, **find_quartiles(taken)}
        if bases.get(name) in scaled:
            row |= {"base": bases[name], **find_quartiles(scaled[bases[name]] / taken, "over")}
        rows.append(row | {"error": errors.get(name, "")})
    return rows


def print_times(rows: list[dict[str, Any]]) -> None:
    """Print rows of `peer_rows`."""
    for row in rows:
        if "failed" in row:
            print(f"{row['name']:42s} {row['failed']}", flush=True)
            continue
        over = (
            f"{row['base']} over it {row['over_p50']:.2f} ({row['over_p25']:.2f} .. {row['over_p75']:.2f})"
            if "base" in row
            else ""
        )
        print(
            f"{row['name']:42s} {row['ms_p50']:9.3f} ms ({row['ms_p25']:.3f} .. {row['ms_p75']:.3f})  {over:50s} "
            f"{row['error']}",
            flush=True,
        )
