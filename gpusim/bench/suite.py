"""`gpusim bench run`: all rows, verified and timed in rounds, against the limits of the device."""

import datetime
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from gpusim.backends import Device
from gpusim.bench.limits import ceilings, choose_best
from gpusim.bench.machine import Watch, find_commit
from gpusim.bench.pipelines import Pipeline, list_pipelines
from gpusim.bench.result import FORMAT, KIND, score_rows, sum_up
from gpusim.bench.stages import Stage, check_stages
from gpusim.bench.subject import Check, Work, digest_values, find_worst, write_size
from gpusim.domain.errors import BadFile, DeviceError, one_line
from gpusim.domain.progress import announced
from gpusim.judge.verify import verify_apart
from gpusim.kernels.stage import stage_names

SIZES = (640, 480), (1280, 720), (1920, 1080)
QUICK_SIZES = ((1280, 720),)
ROUNDS = 3
SECONDS, QUICK_SECONDS = 0.4, 0.1  # of the repetitions of a row in a round
LEAST, MOST = 3, 1000  # repetitions in a round; a slow row has one
KEPT = 0.15  # of the device's free memory, for rows that need not be prepared again
PLACE = "cpu", "cores", "device", "driver", "compiler"  # of a machine: keys that affect times
Subject = Stage | Pipeline
# function from names of stages to the rows of `gpusim.judge.verify.verify`
Verify = Callable[[list[str]], Iterable[dict]]


def all_subjects() -> list[Subject]:
    """Return every stage, in the order in which light passes them, and the twelve pipelines."""
    return [*(Stage(name) for name in stage_names()), *list_pipelines()]


def make_verifier(device: Device) -> Verify:
    """Return the function that verifies stages of a device in a child process.

    A kernel that crashes fails its stage and not the run. Nothing judges the NumPy device: it is
    the reference.

    Args:
        device: The device.
    """
    if device.kind == "numpy":
        why = "the reference itself"
        return lambda names: [
            {"stage": name, "case": "", "max_error": 0.0, "tolerance": 0.0, "why": why}
            for name in names
        ]
    return lambda names: verify_apart(device.name, names)


@dataclass
class Row:
    """A subject in a size, while it is measured."""

    subject: Subject
    size: tuple[int, int]
    found: dict[str, Any]
    work: Work | None = None

    @property
    def is_good(self) -> bool:
        """True unless it has failed."""
        return bool(self.found["verified"])

    def fail(self, reason: str):
        """Make it a row that has failed: without times."""
        named = {key: self.found[key] for key in ("name", "kind", "family", "size", "hash")}
        self.found = {**named, "verified": False, "failed": one_line(reason)}
        self.work = None


def measure(
    device: Device,
    subjects: list[Subject],
    sizes: Iterable[tuple[int, int]],
    *,
    rounds: int = ROUNDS,
    seconds: float = SECONDS,
    verify: Verify | None = None,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Return a result: every subject in every size, verified and timed.

    Args:
        device: The device.
        subjects: Stages and pipelines.
        sizes: Columns and rows.
        rounds: How often all rows are timed, one after the other.
        seconds: Time for the repetitions of a row in a round [s].
        verify: Verifies stages; None: in a child process.
        watch: Watches the machine; None begins now.

    Returns:
        The result, see `gpusim.bench.result`, with `cold_build_s` None and `quick` False.

    Raises:
        DeviceError: The device cannot be measured.
    """
    watch = Watch(device) if watch is None else watch
    limits = ceilings(device)
    rows = begin_rows(device, subjects, sizes, make_verifier(device) if verify is None else verify)
    _run_rounds(device, rows, rounds, seconds, watch)
    limits = choose_best(limits, ceilings(device))  # other work may have disturbed the first ones
    return _result(device, rows, limits, watch)


def append_round(
    stored: dict[str, Any],
    path: str,
    device: Device,
    *,
    seconds: float | None = None,
    verify: Verify | None = None,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Return a stored result with one more round of all its rows, which are verified again.

    The limits stay as they were measured, and so do the floors.

    Args:
        stored: The result.
        path: Its file, for messages.
        device: The device.
        seconds: Time for the repetitions of a row in a round [s]; None: as in the stored rounds.
        verify: Verifies stages; None: in a child process.
        watch: Watches the machine; None begins now.

    Raises:
        BadFile: The result is of another device, machine or commit, of other kernels or inputs, or
            of rows that this version does not know.
    """
    watch = Watch(device) if watch is None else watch
    _check_place(stored, path, device, watch.facts())
    known = {subject.name: subject for subject in all_subjects()}
    rows, old = [], {row["name"]: row for row in stored["rows"]}
    for name, row in old.items():
        subject = known.get(name.rpartition(" ")[0])
        if subject is None:
            raise BadFile(path, f"{name}: this version has no such row; run it anew with --json")
        size = _read_size(path, row)
        if _digest(subject, size) != row["hash"]:
            raise BadFile(
                path, f"{name}: is of other kernels or inputs than these; run it anew with --json"
            )
        rows.append((subject, size))
    made = begin_rows(device, rows, None, make_verifier(device) if verify is None else verify)
    for row in made:
        before = old[row.found["name"]]
        if not before["verified"]:
            row.fail(before["failed"])
        elif row.is_good:
            row.found["rounds"] = list(before["rounds"])
    if seconds is None:
        seconds = QUICK_SECONDS if stored["quick"] else SECONDS
    _run_rounds(device, made, 1, seconds, watch)
    result = _result(device, made, stored["limits"], watch)
    warnings = dict.fromkeys([*stored["machine"]["warnings"], *result["machine"]["warnings"]])
    result["machine"]["warnings"] = list(warnings)
    return result | {key: stored[key] for key in ("cold_build_s", "quick")}


def begin_rows(
    device: Device,
    subjects: Iterable[Any],
    sizes: Iterable[tuple[int, int]] | None,
    verify: Verify,
) -> list[Row]:
    """Return the rows of subjects, verified but not timed.

    Args:
        device: The device.
        subjects: Subjects, or pairs of a subject and its size if `sizes` is None.
        sizes: Columns and rows.
        verify: Verifies stages.
    """
    pairs = list(subjects)
    if sizes is not None:
        pairs = [(subject, size) for size in sizes for subject in pairs]
    unique = list(dict.fromkeys(subject for subject, _ in pairs))
    verdicts = verify_subjects(device, unique, verify)
    rows = []
    for subject, size in pairs:
        text = write_size(size)
        found = {
            "name": f"{subject.name} {text}",
            "kind": subject.kind,
            "family": subject.family,
            "size": text,
            "hash": _digest(subject, size),
            "verified": True,
        }
        row = Row(subject, size, found | verdicts[subject] | {"rounds": []})
        if not row.is_good:
            row.fail(row.found["failed"])
        rows.append(row)
    return rows


@lru_cache(maxsize=512)
def _digest(subject, size):
    """Return the SHA-256 of a row's sources and inputs."""
    return digest_values(subject.digest(), write_size(size))


def verify_subjects(device: Device, subjects: list[Subject], verify: Verify) -> dict:
    """Return the keys of a row that tell how a subject has met its truth, by subject.

    Args:
        device: The device.
        subjects: Stages and pipelines.
        verify: Verifies stages.
    """
    names = [subject.name for subject in subjects if isinstance(subject, Stage)]
    checks = check_stages(names, verify) if names else {}
    found = {}
    for subject in subjects:
        with announced(f"verifying {subject.name}"):
            try:
                if not isinstance(subject, Stage):
                    checks[subject.name] = list(subject.check(device))
                found[subject] = _verdict(checks[subject.name] or checks.get("", []))
                if found[subject]["verified"] and isinstance(subject, Stage):
                    found[subject]["rel_rms_error"] = subject.rms_error(device)
            except Exception as error:  # a driver may raise anything; the other rows still run
                found[subject] = _failure(f"{type(error).__name__}: {error}")
    return found


def _verdict(checks: list[Check]) -> dict:
    """Return the keys of a row by its checks."""
    if not checks:
        return _failure("nothing verified it")
    found = find_worst(checks)
    if not found.is_good:
        error = f"error {found.error:.3g}, tolerance {found.tolerance:.3g}"
        return _failure(f"{found.case}: {error} ({found.why})")
    return {
        "verified": True,
        "rel_rms_error": None,
        "max_error": found.error,
        "tolerance": found.tolerance,
        "case": found.case,
    }


def _failure(reason):
    return {"verified": False, "failed": reason}


def _run_rounds(device, rows, rounds, seconds, watch):
    """Time all rows once per round, one after the other."""
    budget, done, begin = KEPT * device.memory, 0, time.perf_counter()
    total = rounds * len(rows)
    for number in range(1, rounds + 1):
        for place, row in enumerate(rows, 1):
            if row.is_good:
                left = (time.perf_counter() - begin) / done * (total - done) if done else 0.0
                words = f"round {number} of {rounds}, row {place} of {len(rows)}"
                words += f", about {left:.0f} s left" if left else ""
                with announced(f"{words}: {row.found['name']}"):
                    budget = _run_row(device, row, seconds, budget)
            done += 1
        watch.sample()


def _run_row(device, row, seconds, budget):
    """Time a row, keep its work if there is room, and return the bytes of room that are left."""
    is_new = row.work is None
    try:
        work = row.subject.start(device, row.size) if is_new else row.work
        if is_new:
            work.run()  # built, and planned
            launches = device.count_launches(work.run)  # recorded
            counts = {"bytes": work.moved, "operations": work.operations, "launches": launches}
            row.found |= counts
        at = time.time()
        row.found["rounds"].append({"at": at, "ms": time_work(device, work, seconds)})
    except Exception as error:  # a driver may raise anything; the other rows still run
        row.fail(f"{type(error).__name__}: {error}")
        return budget
    if is_new and work.nbytes <= budget:
        row.work = work
        return budget - work.nbytes
    return budget


def time_work(device: Device, work: Work, seconds: float) -> list[float]:
    """Return the times of repetitions [ms].

    Args:
        device: The device.
        work: The work, which has run before.
        seconds: Time for all repetitions [s]. One repetition is enough if it takes longer.

    Raises:
        DeviceError: The device's clock does not run.
    """
    begin = time.perf_counter()
    while device.is_gpu and time.perf_counter() < begin + seconds / 4:
        work.run()  # a GPU's clock goes up
        device.sync()
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < MOST:
        started = time.perf_counter()
        if work.is_wall:
            work.run()
            device.sync()
            times.append(1e3 * (time.perf_counter() - started))
        else:
            with device.timed() as ms:
                work.run()
            times.append(sum(ms.values()))
        if times[-1] <= 0:
            raise DeviceError(f"{device.name}: its clock gives no time")
        now = time.perf_counter()
        if now - begin >= seconds and (len(times) >= LEAST or now - started > seconds):
            break
    return times


def find_floor(row: dict[str, Any], limits: dict[str, float | None]) -> dict[str, Any]:
    """Return floor_ms, the least time for a row within the limits, and bound, the limit that sets it.

    Args:
        row: A row with bytes, operations (or None) and launches.
        limits: The limits of the device. Without them both are None.
    """
    copy, fma, launch = (limits[key] for key in ("copy_gbps", "fma_gflops", "launch_us"))
    if copy is None or fma is None or launch is None:
        return {"floor_ms": None, "bound": None}
    parts = {
        "memory": row["bytes"] / copy / 1e6,
        "arithmetic": (row["operations"] or 0) / fma / 1e6,
        "launches": row["launches"] * launch / 1e3,
    }
    bound = max(parts, key=lambda name: parts[name])
    return {"floor_ms": parts[bound], "bound": bound}


def _result(device, measured, limits, watch):
    """Return the result of measured rows."""
    commit, is_dirty = find_commit()
    rows = [
        sum_up(row.found | find_floor(row.found, limits)) if row.is_good else row.found
        for row in measured
    ]
    return {
        "bench": KIND,
        "format": FORMAT,
        "device": device.name,
        "machine": watch.facts(),
        "commit": commit,
        "dirty": is_dirty,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "hash": digest_values(*sorted(row["hash"] for row in rows)),
        "limits": limits,
        "cold_build_s": None,
        "quick": False,
        "scores": score_rows(rows),
        "rows": rows,
    }


def _check_place(stored, path, device, facts):
    """Raise BadFile unless a result is of this device, machine and commit."""
    if stored["device"] != device.name:
        raise BadFile(path, f"is of device {stored['device']}, not of {device.name}")
    commit, _ = find_commit()
    if stored["commit"] != commit:
        raise BadFile(path, f"is of commit {stored['commit']}, not of {commit}")
    for key in PLACE:
        if stored["machine"].get(key) != facts[key]:
            raise BadFile(
                path,
                f"is of another machine: {key} {stored['machine'].get(key)!r}, not {facts[key]!r}",
            )


def _read_size(path, row):
    """Return the columns and rows of a stored row."""
    try:
        cols, rows = map(int, row["size"].split("x"))
    except ValueError:
        raise BadFile(path, f"{row['name']}: the size {row['size']!r} is not COLSxROWS") from None
    return cols, rows
