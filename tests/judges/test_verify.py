"""`gpusim verify` survives a kernel that crashes or hangs: its row says so, and the other stages are judged."""

import json
import os
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path

import pytest
from devices import DEVICES, KINDS

import gpusim.judge.verify
from gpusim.backends import open_device
from gpusim.cli.main import main
from gpusim.domain.errors import DeviceError
from gpusim.judge.verify import verify, verify_apart
from gpusim.kernels.stage import stage_module

# Python runs a module `sitecustomize` when it starts: here in every child that judges stages.
CHILD = """
import os, sys, time
if any("verify_child" in argument for argument in sys.orig_argv):
    sys.path.insert(0, {root!r})
    {start}
    import gpusim.kernels.spectral.materials as module
    right = module.materials
    def materials(*arguments, **options):
        {stage}
    module.materials = materials
"""
ROOT = str(Path(__file__).parents[2])
BEFORE, BROKEN, AFTER = "sensor.flag", "spectral.materials", "processor.linear"
STAGES = [BEFORE, BROKEN, AFTER]


@pytest.fixture
def children(monkeypatch, tmp_path):
    """Makes the children that start from now on run other code: at their start, or in place of the stage."""

    def change(stage="return right(*arguments, **options)", start="pass"):
        (tmp_path / "sitecustomize.py").write_text(
            CHILD.format(root=ROOT, start=start, stage=stage)
        )
        path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
        monkeypatch.setenv("PYTHONPATH", path)

    return change


@pytest.fixture
def started(monkeypatch):
    """The child processes that were started."""
    processes, start = [], subprocess.Popen
    monkeypatch.setattr(
        subprocess, "Popen", lambda *a, **k: processes.append(start(*a, **k)) or processes[-1]
    )
    return processes


@pytest.mark.parametrize("name", KINDS)
def test_a_child_gives_the_rows_of_this_process(name, started):
    assert list(verify_apart(name, STAGES)) == list(verify(open_device(name), STAGES))
    assert [process.poll() for process in started] == [0]


@pytest.mark.parametrize("name", KINDS)
def test_a_stage_that_crashes_is_named_and_the_others_are_judged(name, children, started):
    right = list(verify_apart(name, [BEFORE, AFTER]))
    started.clear()
    children("print('a driver prints'); sys.stderr.write('assertion failed\\n'); os.abort()")
    rows = list(verify_apart(name, STAGES))
    assert len(started) == 2  # one more, for the stages after it
    (crashed,) = [row for row in rows if row["stage"] == BROKEN]
    assert [row for row in rows if row is not crashed] == right
    assert crashed["case"] == "(crashed)" and crashed["device"] == open_device(name).name
    assert crashed["why"] == "its process died of SIGABRT: assertion failed"
    assert not crashed["ok"] and crashed["max_error"] == float("inf")


@pytest.mark.slow
def test_a_stage_that_hangs_is_ended(children, started):
    """On all devices at once: each waits without work."""
    for name in DEVICES:
        list(verify(open_device(name), [AFTER]))  # compiled, so that the children answer soon
    children("time.sleep(1e4)")
    begin = time.monotonic()
    with ThreadPoolExecutor() as pool:
        found = list(
            pool.map(lambda name: list(verify_apart(name, [BROKEN, AFTER], patience=20)), DEVICES)
        )
    assert time.monotonic() - begin < 120
    for name, (hung, *rest) in zip(DEVICES, found, strict=True):
        assert hung["stage"] == BROKEN and "hangs: nothing came" in hung["why"]
        assert rest == list(verify(open_device(name), [AFTER]))
    ends = [process.poll() for process in started]
    assert sorted(ends) == [-signal.SIGKILL] * len(DEVICES) + [0] * len(DEVICES)


def test_the_last_stage_may_crash_and_a_child_may_stop_quietly(children, started):
    children("os._exit(0)")
    rows = list(verify_apart("numpy", [BEFORE, BROKEN]))
    assert rows[-1]["stage"] == BROKEN and "ended with status 0" in rows[-1]["why"]
    assert all(row["ok"] for row in rows[:-1]) and len(started) == 1


def test_a_device_that_crashes_when_it_is_opened_has_one_row(children, started):
    children(start="os.kill(os.getpid(), 11)")
    (row,) = verify_apart("numpy", STAGES)
    assert row["stage"] == "(open)" and "SIGSEGV" in row["why"] and len(started) == 1


def test_a_crash_at_the_end_is_a_failure(children):
    children(start="import atexit; atexit.register(os.abort)")
    *rows, last = verify_apart("numpy", [BEFORE])
    assert all(row["ok"] for row in rows) and rows
    assert last["stage"] == f"(after {BEFORE})" and "SIGABRT" in last["why"]


def test_a_device_that_cannot_be_opened_is_an_error():
    with pytest.raises(DeviceError, match="no OpenCL device '99'"):
        list(verify_apart("opencl:99", STAGES))


def test_no_child_is_left_when_the_rows_are_not_read_to_the_end(children, started):
    children("time.sleep(1e4)")
    rows = verify_apart("numpy", STAGES)
    next(rows)
    rows.close()
    assert started[0].poll() is not None


def test_the_command_counts_failures(tmp_path, capsys, children):
    file = tmp_path / "v.json"
    command = ["verify", "--device", "opencl", "--stage", BROKEN, "--json", str(file)]

    def judge():
        status = main(command)
        return status, capsys.readouterr().out, json.loads(file.read_text())

    status, out, rows = judge()
    assert status == 0 and "0 failed" in out
    keys = {"stage", "device", "case", "max_error", "tolerance", "ok"}
    assert set(rows[0]) >= keys
    children("return right(*arguments, **options) * 1.001")
    assert judge()[0] == 1
    children("raise RuntimeError('the device is gone')")
    status, out, rows = judge()
    assert status == 1 and "the device is gone" in out and rows[0]["max_error"] is None
    children("os.abort()")
    status, out, rows = judge()
    assert status == 1 and rows[0]["max_error"] is None
    (line,) = [line for line in out.splitlines() if "FAIL" in line]
    assert BROKEN in line and "its process died of SIGABRT" in line and "0 passed, 1 failed" in out


def test_cases_that_need_float64_are_not_run_without_it_and_the_others_are(monkeypatch, capsys):
    """The stage itself would refuse them, and that would end the rows of its other cases."""
    device, module = open_device("opencl"), stage_module("sensor.noise")
    cases = list(islice(module.cases(), 3))  # 1x1, 1x1 in electrons, 1x1 with exact photons
    monkeypatch.setattr(module, "cases", lambda: [cases[2], *cases[:2]])
    monkeypatch.setattr(device, "has_fp64", False)
    rows = list(verify(device, ["sensor.noise"]))
    assert [bool(row["skipped"]) for row in rows] == [True, False, False]
    assert all(row["ok"] for row in rows) and "float64" in rows[0]["skipped"]
    monkeypatch.setattr(gpusim.judge.verify, "verify_devices", lambda *_: rows)
    assert main(["verify"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("skip") and "needs float64" in said[0]
    assert said[-1] == "2 passed, 0 failed, 1 not run"
