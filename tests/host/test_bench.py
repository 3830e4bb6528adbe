"""The scripts in bench/: what they store is read again, compared and shown, and no figure of theirs is pasted."""

import json
import os
import runpy
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).parents[2] / "bench"
sys.path.append(str(BENCH))

import drivers  # noqa: E402
import memory  # noqa: E402
import results  # noqa: E402
import runner  # noqa: E402
import tables  # noqa: E402

from gpusim.bench import timing  # noqa: E402
from gpusim.bench.loops import time_in_process  # noqa: E402
from gpusim.domain.errors import BadFile, DeviceError  # noqa: E402
from gpusim.kernels.stage import stage_module, stage_names  # noqa: E402

MACHINE = {
    "cpu": "some CPU",
    "cores": 2,
    "device": "some device",
    "driver": "some driver",
    "python": "3.12",
}
ABOUT = {
    "device": "opencl:0",
    "machine": MACHINE,
    "commit": "abc",
    "dirty": False,
    "date": "2026-01-02T03:04:05+00:00",
}


def timed(name, p25, p50, p75, **more):
    return {
        "name": name,
        "ms_least": p25,
        "ms_p25": p25,
        "ms_p50": p50,
        "ms_p75": p75,
        "ms_most": p75,
        **more,
    }


def result(bench="noise", rows=(), **more):
    return {"bench": bench, **ABOUT, "rows": list(rows), **more}


STAGE = {
    "kind": "stage",
    "size": "64x48",
    "verified": True,
    "ms_p20": 1.0,
    "ms_p50": 2.0,
    "ms_p80": 3.0,
    "bytes": 16_000_000,
    "operations": None,
    "attained": 0.5,
    "bound": None,
    "rel_rms_error": 1e-7,
    "max_error": 0.0,
}
FRAME = {
    "megapixels": 2.0736,
    "planes": 4,
    "planning_ms": 100.0,
    "bytes_predicted": 2**21,
    "bytes_peak": 2**20,
    "rss": 2**22,
    "bands": 31,
}
EXAMPLES = [
    result(
        "suite",
        [
            STAGE | {"name": "optics.blur 64x48"},
            STAGE | {"name": "optics.blur 32x24", "size": "32x24"},
            {
                "name": "optics.falloff 64x48",
                "size": "64x48",
                "verified": False,
                "failed": "error 1",
            },
        ],
        limits={"copy_gbps": 10.0, "fma_gflops": 100.0},
        scores={"optics": None, "all": 0.5},
    ),
    result("loops", [timed("a loop", 1.0, 2.0, 4.0, events_ms=1.0, check="rms 1")], tolerance=None),
    result(
        "scaling",
        [
            timed("1920x1080, 31 bands", 1.0, 2.0736, 4.0, **FRAME),
            {"name": "8K", "failed": "no room"},
            timed("1280x720, 31 bands", 1.0, 1.8432, 2.0, **FRAME | {"megapixels": 0.9216}),
        ],
    ),
    result(
        "threads",
        [
            timed("1 of 2", 7.0, 8.0, 9.0, threads=1, busy=1.0),
            timed("2 of 2", 4.0, 5.0, 6.0, threads=2, busy=1.9),
        ],
    ),
    result(
        "peers",
        [
            timed("SciPy", 7.0, 8.0, 9.0, error="rms 1"),
            {"name": "torch", "failed": "not installed"},
            timed(
                "ours",
                1.0,
                2.0,
                3.0,
                error="",
                base="SciPy",
                over_p25=3.0,
                over_p50=4.0,
                over_p75=5.0,
            ),
        ],
    ),
    result(
        "triples",
        [
            {
                "name": "seed 1",
                "seed": 1,
                "words": "1: a scene",
                "status": "ok",
                "tolerance": "1e-3",
                "met": True,
                "within": False,
                "nearest": "0.002 of 0.001 rms",
                "verdict": "",
                "bound": "rms",
                "allowed": 1e-3,
                "true": {"rms": 2e-3},
                "ratio": 0.25,
                "ratio_rms": 0.25,
                "bounds": {"border": {"rms": 5e-4}},
            }
        ],
        half="development",
    ),
    result(
        "tolerances",
        [
            timed(
                "phone, deadleaves, 1e-3",
                1.0,
                2.0,
                3.0,
                tolerance="1e-3",
                exact_p50=4.0,
                baseline_p50=8.0,
                predicted_ms=3.0,
                stages_ms=2.5,
                error=2e-4,
                met=True,
            )
        ],
        size=[64, 48],
        cameras=["phone"],
        charts=["deadleaves"],
    ),
    result(
        "runner",
        [
            {
                "name": "sensor.noise",
                "form": "cpu",
                "cases": 9,
                "left": 1,
                "wrong": {"c": [2], "python": []},
                "error": {"c": 0.5, "python": 0.5},
                "ms": {"c": [3.0, 2.1], "python": [2.0, 4.0]},
                "times": 1.05,
            }
        ],
        title="some driver",
        rounds=2,
    ),
    result(
        "color",
        [{"name": "ridge", "table": "Errors", "cells": ["1.0", "2.0"]}],
        columns={"Errors": ["method", "D65", "A"]},
    ),
]


@pytest.fixture
def stored(tmp_path):
    """A folder with a result of every form of table."""
    for example in EXAMPLES:
        (tmp_path / f"{example['bench']}-here.json").write_text(json.dumps(example))
    return tmp_path


def marks(*names):
    return "".join(
        f"words\n<!-- {name} -->\npasted {name}\n<!-- end of {name} -->\n" for name in names
    )


def test_readme_has_what_the_command_writes():
    text = (BENCH / "README.md").read_text()
    assert tables.filled(text, tables.stored_results(BENCH / "results")) == text


def test_readme_has_a_place_for_every_table():
    text = (BENCH / "README.md").read_text()
    for name in tables.TABLES:
        assert text.count(f"<!-- {name} -->") == 1 == text.count(f"<!-- end of {name} -->"), name


def test_tables_are_made_of_the_results_alone(stored):
    names = [example["bench"] for example in EXAMPLES]
    once = tables.filled(marks(*names, "noise"), tables.stored_results(stored))
    assert tables.filled(once, tables.stored_results(stored)) == once
    assert once.count("words") == len(names) + 1
    assert (
        "pasted noise" in once and once.count("pasted") == 1
    )  # nothing stored backs it: it is left
    for row in (
        "| optics.blur | 1 | 2 | 3 | 8 |  | 0.50 |  | 1.0e-07 | 0.0e+00 |",
        "| optics.falloff | no speed: error 1 |",
        "| a loop | 2 | 1 .. 4 | 1 | 2.00 | rms 1 |",
        "| 1920x1080, 31 bands | 2.07 | 1 .. 4 | 1 | 1.00 | 4 | 100 | 2 | 1 | 4 |",
        "| 1280x720, 31 bands | 1.84 | 1 .. 2 | 2 | 2.00 |",
        "| 8K | no room |",
        "| 2 of 2 | 5 | 4 .. 6 | 1.60 | 0.80 | 1.90 |",
        "| ours | 2 | 1 .. 3 | SciPy | 4.00 (3.00 .. 5.00) |  |",
        "| torch | not installed |",
        "| 1e-3 | 1 | 1 | 0 | 1 | 0 | 0.25 | 2 |",
        "some driver, least of 2 rounds: times within 5% in 1 of 1 stages, equal verdicts in 0.",
        "| sensor.noise | cpu | 9 | 8 | 9 | 2.1 | 2 | 1.050 |",
        "| ridge | 1.0 | 2.0 |",
        "10 GB/s copied, 100 GFLOP/s measured",
        "commit abc, 2026-01-02",
    ):
        assert row in once, row


def test_result_without_a_place_is_refused(stored):
    with pytest.raises(BadFile, match="no place for the tables of color"):
        tables.filled("no marks", tables.stored_results(stored))


def test_result_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "r.json"
    results.save(EXAMPLES[0], path)
    assert results.load(path) == EXAMPLES[0]


def test_against_tells_what_changed():
    old = result(
        rows=[
            *(timed(name, 9.0, 10.0, 11.0) for name in ("same", "slower", "faster")),
            {"name": "least and most", "ms_least": 1.0, "ms_p50": 2.0, "ms_most": 3.0},
            timed("gone", 1.0, 1.0, 1.0),
            {"name": "failed", "failed": "why"},
        ]
    )
    new = result(
        rows=[
            timed("same", 10.5, 12.0, 13.0),
            timed("slower", 18.0, 20.0, 22.0),
            timed("faster", 4.0, 5.0, 6.0),
            timed("least and most", 2.5, 3.0, 3.5),
            timed("new", 1.0, 1.0, 1.0),
            timed("failed", 1.0, 1.0, 1.0),
        ]
    )
    head, *lines = results.against(old, new).splitlines()
    assert head.startswith("now over abc")
    found = {line[:40].strip(): line[40:].split() for line in lines}
    assert found["same"] == ["1.20", "0.95", "..", "1.44", "same"]  # 10.5 / 11 and 13 / 9
    assert found["slower"] == ["2.00", "1.64", "..", "2.44", "slower"]
    assert found["faster"] == ["0.50", "0.36", "..", "0.67", "faster"]
    assert found["least and most"][-1] == "same"
    assert (found["gone"][-1], found["new"][-1], found["failed"][-1]) == ("gone", "new", "times")


def test_against_compares_text_by_its_table():
    def texts(first, second):
        return result(
            "color",
            [
                {"name": "ridge", "table": "A", "cells": [first]},
                {"name": "ridge", "table": "B", "cells": [second]},
            ],
        )

    lines = results.against(texts("1", "2"), texts("1", "3")).splitlines()[1:]
    assert lines[0].endswith("same") and lines[1].endswith("was 2, is 3")


@pytest.mark.parametrize("key", ["cpu", "cores", "device", "driver"])
def test_against_warns_of_another_machine_in_one_line(key):
    other = result(machine=MACHINE | {key: "another"})
    warning, _ = results.against(result(), other).splitlines()
    assert warning.startswith("warning") and key in warning and "'another' now" in warning
    assert "warning" not in results.against(result(), result(commit="other"))
    assert "warning" not in results.against(result(limits=1), result(limits=2))
    assert "size [1, 2] then, [3, 4] now" in results.against(
        result(size=[1, 2]), result(size=[3, 4])
    )


def test_quartiles_and_ratios_are_of_the_rounds():
    rows = timing.compare_times(
        {"base": 2.0 * np.arange(1, 6), "form": np.full(5, 2.0)},
        {"form": "base"},
        {"form": "rms 1"},
        {"form": 2},
    )
    assert [rows[0][f"ms_{part}"] for part in ("least", "p25", "p50", "p75", "most")] == [
        2,
        4,
        6,
        8,
        10,
    ]
    assert rows[1]["ms_p50"] == 1.0 and rows[1]["error"] == "rms 1"  # two frames in a call
    assert [rows[1][f"over_{part}"] for part in ("least", "p50", "most")] == [2, 6, 10]


def test_loop_that_does_not_fit_is_a_row_and_no_failure():
    asked = {
        "device": "numpy",
        "size": [10**6, 10**6],
        "bands": 31,
        "tolerance": None,
        "camera": "phone",
        "repeat": 1,
    }
    assert time_in_process(asked)["failed"].startswith(
        "DoesNotFit: three times a scene of 1000000x"
    )


@pytest.mark.parametrize(
    "name", [name for name in stage_names() if hasattr(stage_module(name), "operations")]
)
def test_operations_of_a_stage_grow_with_its_pixels(name):
    module = stage_module(name)
    small, large = (module.operations(**module.bench(*size)) for size in ((96, 160), (192, 320)))
    # four times the pixels; of transforms more by their logarithm, less by the border of 64 pixels
    assert 2 < large / small < 5 and small >= 96 * 160


def test_rounds_alternate_and_leave_the_warm_ones_out():
    order = []
    times = timing.time_in_turns(
        {"a": lambda: order.append("a"), "b": lambda: order.append("b")}, repeat=2, warm=1
    )
    assert order == ["a", "b"] * 3 and {name: len(taken) for name, taken in times.items()} == {
        "a": 2,
        "b": 2,
    }


def test_a_turn_of_a_fast_form_has_many_calls_and_gives_the_time_of_one():
    calls = []

    def sleep():
        calls.append(time.sleep(0.002))

    times = timing.time_in_turns({"a": sleep, "b": lambda: time.sleep(0.03)}, 2, turn_ms=20.0)
    # each sleep takes at least as long as asked: at most 10 calls in a turn, and one in the warm round
    assert 3 <= len(calls) <= 1 + 2 * 10
    assert np.all(times["a"] >= 2.0) and np.all(times["b"] >= 30.0)


@pytest.fixture
def run(monkeypatch, capsys):
    """A script in this process, which has loaded what all of them need: its exit status, and what it says of errors."""

    def of(script, *arguments):
        monkeypatch.setattr(sys, "argv", [str(BENCH / script), *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(BENCH / script), run_name="__main__")
        return ended.value.code, capsys.readouterr().err

    return of


@pytest.mark.parametrize(
    ("script", "arguments", "said"),
    [
        ("tables.py", ("--results", "missing"), "is not a folder"),
        ("tables.py", ("--readme", "missing/README.md"), "cannot be read"),
        ("noise.py", ("--device", "nonsense"), "unknown device"),
        ("loops.py", ("--device", "numpy", "--size", "0x0"), "size = 0 x 0"),
        ("loops.py", ("--device", "numpy", "--size", "big"), "wanted COLSxROWS"),
        ("noise.py", ("--device", "numpy", "--repeat", "0"), "wanted a whole number"),
        ("noise.py", ("--device", "numpy", "--json", f"{__file__}/a.json"), "cannot be written"),
        ("two_devices.py", ("--device", "numpy,numpy"), "numpy twice"),
        ("runner.py", ("--device", "numpy"), "an OpenCL device"),
        ("runner.py", ("--seconds", "0"), "seconds = 0.0"),
        ("noise.py", ("--device", "numpy", "--against", "missing.json"), "cannot be read"),
    ],
)
def test_mistakes_are_said_in_one_line(script, arguments, said, run):
    status, error = run(script, *arguments)
    assert status == 2 and said in error and error.count("\n") == 1, error


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no JSON", "is no JSON"),
        ("[]", "is no result"),
        ('{"bench": "noise"}', "is no result"),
        (json.dumps(EXAMPLES[0]), "is a result of 'suite'; wanted one of 'noise'"),
    ],
)
def test_what_is_no_result_is_refused(text, said, run, tmp_path):
    (tmp_path / "old.json").write_text(text)
    status, error = run("noise.py", "--device", "numpy", "--against", tmp_path / "old.json")
    assert status == 2 and said in error and error.count("\n") == 1, error


def test_table_of_a_result_that_lacks_something_is_refused(stored):
    lacking = result("loops", [{"name": "a loop"}])
    (stored / "loops-here.json").write_text(json.dumps(lacking))
    with pytest.raises(BadFile, match=r"loops-here.json: lacks values of its table"):
        tables.filled(
            marks("suite", "loops", "scaling", "threads", "peers", "color"),
            tables.stored_results(stored),
        )


def test_command_writes_the_readme(stored, tmp_path):
    for name in ("suite", "scaling"):  # they have figures, which take seconds
        (stored / f"{name}-here.json").unlink()
    readme = tmp_path / "README.md"
    readme.write_text(
        marks("loops", "threads", "peers", "triples", "tolerances", "runner", "color")
    )
    subprocess.run(
        [sys.executable, BENCH / "tables.py", "--results", stored, "--readme", readme], check=True
    )
    assert readme.read_text() == tables.filled(
        marks("loops", "threads", "peers", "triples", "tolerances", "runner", "color"),
        tables.stored_results(stored),
    )


def test_a_process_of_its_own_finds_what_this_one_finds(tmp_path, monkeypatch):
    """Packages may be on PYTHONPATH alone."""
    (tmp_path / "only_there.py").write_text("def one(number):\n    return {'twice': 2 * number}\n")
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    )
    assert results.in_process("only_there", {"number": 4}) == {"twice": 8}


INDEX = """gpusim-pack 1
stage sensor.noise
case cpu 0 one
case gpu 0 one
case cpu 2 three
stage optics.mosaic
case gpu 0 one
"""


def test_verdicts_of_c_and_python_agree_case_by_case(monkeypatch):
    """A case that is not in the pack counts on neither side; one that fails in C, or has another error there, does."""
    cases = [{"max_error": error, "tolerance": 2.0, "ok": error <= 2} for error in (1.0, 9.0, 0.5)]
    monkeypatch.setattr(runner, "verify", lambda device, stages: iter(cases))
    monkeypatch.setattr(runner, "open_form", lambda name, form: None)
    for form, said, error, wanted in (
        ("cpu", "", 1.0, True),
        ("cpu", "", 1.001, False),
        ("cpu", "     wrong: sensor.noise/2, cpu form: three: error 3", 1.0, False),
        ("cpu", "     wrong: optics.mosaic/2, cpu form: three: error 3", 1.0, True),
    ):
        row = runner.judge_stage("sensor.noise", INDEX, results.open_device("numpy"))
        assert (row["form"], row["cases"], row["left"]) == ("cpu", 2, 1)
        failed = "sensor.noise" in said
        found = {"form": form, "cases": 3 - failed, "max_error": error, "tolerance": 2.0}
        runner.add_verdicts(row, found, said)
        assert runner.agrees(row) is wanted, said
    with pytest.raises(DeviceError, match="cases of form gpu"):
        runner.add_verdicts(row, found | {"form": "gpu"}, "")


def verified(title, is_gpu, rows, bits):
    """A result of bench/drivers.py."""
    more = {"title": title, "source": "here", "gpu": is_gpu, "bits": bits}
    return result("drivers", rows, **more, busy_machine=True, wall_s=61.2, processor_s=40.0)


def test_the_page_of_drivers_has_the_tables_of_all_stored_results():
    page = (BENCH.parent / "docs" / "drivers.md").read_text()
    stored = [results.load(path) for path in sorted(drivers.STORED.glob("*.json"))]
    assert len(stored) > 6 and drivers.filled(page, stored) == page
    with pytest.raises(BadFile, match="no place for the tables"):
        drivers.filled("a page", stored)


def test_a_driver_that_fails_says_where_and_why():
    good = {"name": "optics.blur", "cases": 5, "passed": 5}
    bad = {"name": "optics.far", "cases": 4, "passed": 3, "failed": "63x65: error 2 of 1"}
    text = drivers.tables(
        [
            verified("good", False, [good], {"noise": 0, "noise, exact": 0}),
            verified("bad", True, [good, bad], {"noise": 3}),
        ]
    )
    assert (
        "| good | here | some device, some driver | 1 of 1 | 5 of 5 | equal | 61 (shared) | 40 |"
        in text
    )
    assert "| 1 of 2 | 8 of 9 | noise: 3 values differ |" in text.partition("## GPUs")[2]
    assert "- bad, `optics.far`: 63x65: error 2 of 1" in text
    assert drivers.bits_text({"noise": 0}) == "equal, no float64"
    assert drivers.bits_text({"failed": "no memory"}) == "no frame: no memory"


def test_cases_of_a_stage_become_one_row():
    def case(name, error, skipped=""):
        is_ok = error <= 2.0
        return {
            "case": name,
            "max_error": error,
            "tolerance": 2.0,
            "ok": is_ok,
            "why": "so",
            "skipped": skipped,
        }

    cases = [case("first", 1.0), case("second", 3.0), case("third", 0.0, "needs float64")]
    row = drivers.stage_row("optics.blur", cases)
    assert row == {
        "name": "optics.blur",
        "cases": 2,
        "passed": 1,
        "used": 0.5,
        "skipped": 1,
        "failed": "second: error 3 of 2",
    }
    crashed = drivers.stage_row("optics.blur", [case("(crashed)", float("inf"))])
    assert crashed["failed"] == "(crashed): so"


LOG = """
Uninitialized value written to local memory address 0x10000000000a0
\tKernel: columns
\tAt line 103 (column 5) of input.cl:
\t  PASSES
\t

Uninitialized value written to local memory address 0x1000000000140
\tKernel: columns

OCLGRIND FATAL ERROR (/home/someone/oclgrind/src/core/common.cpp:917)
Unsupported GEP base type: 2
\tKernel: malvar
"""


def test_messages_of_oclgrind_are_counted_by_kind():
    found = memory.messages(LOG)
    assert found["messages"] == {
        "Uninitialized value written to local memory address #": 2,
        "OCLGRIND FATAL ERROR (common.cpp:#)": 1,
    }
    assert found["example"].endswith("Kernel: columns At line 103 (column 5) of input.cl: PASSES")
    assert memory.messages("") == {"messages": {}}
