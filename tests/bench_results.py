"""Results of a benchmark that never ran: known times, known noise, for tests of comparisons."""

import json

import numpy as np

from gpusim.bench.result import find_fault, score_rows, sum_up

FAMILIES = ("spectral", "optics", "sensor", "processor", "display", "pipelines")
LIMITS = dict.fromkeys(
    ("copy_gbps", "fma_gflops", "local_gbps", "launch_us", "upload_gbps", "download_gbps"), 10.0
)
START = 1.7e9  # [s] since the epoch


def row_names(count):
    return [f"{FAMILIES[i % 6]}.row{i:02d} 640x480" for i in range(count)]


def made_results(
    count=30,
    rounds=5,
    *,
    sides=2,
    noise=0.005,
    seed=1,
    change=None,
    alternate=True,
    common=0.0,
    repetitions=9,
):
    """Return results of the same rows.

    Noise of a round [log], common to its repetitions; change: row's number -> slowdown of all sides
    but the first; common: slowdown of all rows of these.
    """
    rng = np.random.default_rng(seed)
    base = np.exp(rng.uniform(-3, 4, count))  # [ms]
    results = []
    for side in range(sides):
        rows = []
        for i, name in enumerate(row_names(count)):
            ms = base[i] * (1 + (change or {}).get(i, 0.0) * (side > 0)) * (1 + common * (side > 0))
            measured = []
            for number in range(rounds):
                order = number * sides + side if alternate else side * rounds + number
                level = ms * np.exp(noise * rng.standard_normal())
                times = level * np.exp(0.002 * rng.standard_normal(repetitions))
                measured.append({"at": START + 100 * order + i, "ms": times.tolist()})
            row = {
                "name": name,
                "kind": "pipeline" if FAMILIES[i % 6] == "pipelines" else "stage",
                "family": FAMILIES[i % 6],
                "size": "640x480",
                "hash": f"hash {i}",
                "verified": True,
                "rounds": measured,
                "floor_ms": base[i] / 3,
                "rel_rms_error": 1e-7,
                "max_error": 1e-6,
                "tolerance": 1e-5,
            }
            rows.append(sum_up(row))
        result = {
            "bench": "suite",
            "format": 1,
            "device": "opencl:0",
            "machine": {
                "cpu": "a CPU",
                "device": "a device",
                "driver": f"driver {side}",
                "warnings": [],
            },
            "commit": f"{side}" * 40,
            "dirty": False,
            "date": f"2026-01-{side + 1:02d}T00:00:00+00:00",
            "hash": "all",
            "limits": LIMITS,
            "cold_build_s": None,
            "quick": False,
            "scores": score_rows(rows),
            "rows": rows,
        }
        assert find_fault(result) == ""
        results.append(result)
    return results


def write_results(folder, results, names="abcdefgh"):
    """Write results to files and return their paths."""
    paths = [folder / f"{name}.json" for name, _ in zip(names, results, strict=False)]
    for path, result in zip(paths, results, strict=True):
        path.write_text(json.dumps(result))
    return [str(path) for path in paths]


def fail_row(result, number, reason="error 1, tolerance 1e-5"):
    """Let a row fail its verification."""
    row = result["rows"][number]
    kept = {key: row[key] for key in ("name", "kind", "family", "size", "hash")}
    result["rows"][number] = {**kept, "verified": False, "failed": reason}
