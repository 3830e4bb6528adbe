"""The benchmark: its result files, its scores, wrong answers, further rounds, warnings and mistakes."""

import copy
import json
import math
import os
import shutil

import numpy as np
import pytest

import gpusim.bench.subject as subject
from gpusim.backends import open_device
from gpusim.backends.device import kernel_folder
from gpusim.bench import limits, suite
from gpusim.bench.machine import SMI, Watch
from gpusim.bench.pipelines import Pipeline, list_pipelines
from gpusim.bench.result import find_fault, read_result, score_rows, sum_up, write_result
from gpusim.bench.stages import Stage
from gpusim.bench.subject import Check, Work
from gpusim.cli.benching import with_subcommand
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile, DeviceError

SIZE = (24, 16)
LIMITS = dict.fromkeys(
    ("copy_gbps", "fma_gflops", "local_gbps", "launch_us", "upload_gbps", "download_gbps"), 1.0
)


def row(name="optics.mosaic 64x48", family="optics", **more):
    return {
        "name": name,
        "kind": "stage",
        "family": family,
        "size": "64x48",
        "hash": "abc",
        "verified": True,
        "rounds": [{"at": 1.0, "ms": [1.0, 2.0]}],
        "ms_p20": 1.2,
        "ms_p50": 1.5,
        "ms_p80": 1.8,
        "floor_ms": 0.3,
        "attained": 0.2,
        **more,
    }


def failed(name="optics.blur 64x48", family="optics"):
    kept = ("name", "kind", "family", "size", "hash")
    return {key: row(name, family)[key] for key in kept} | {"verified": False, "failed": "error 1"}


def result(*rows, **more):
    return {
        "bench": "suite",
        "format": 1,
        "device": "opencl:0",
        "machine": {"warnings": []},
        "commit": None,
        "dirty": None,
        "date": "2026-01-02T03:04:05+00:00",
        "hash": "abc",
        "limits": LIMITS,
        "cold_build_s": None,
        "quick": True,
        "scores": {"all": None},
        "rows": list(rows),
        **more,
    }


# ---- result files


def test_a_result_is_read_as_it_was_written(tmp_path):
    path, wanted = tmp_path / "a.json", result(row(), failed())
    write_result(wanted, path)
    assert read_result(path) == wanted


def without(key):
    return lambda found: found.pop(key)


def setting(*keys, value):
    def change(found):
        for key in keys[:-1]:
            found = found[key]
        found[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (setting("bench", value="noise"), '"bench" is "noise", wanted "suite"'),
        (setting("format", value=2), '"format" is 2, this version reads 1'),
        (without("limits"), '"limits" is missing'),
        (setting("limits", value={}), '"limits" has no "copy_gbps"'),
        (setting("limits", value=LIMITS | {"launch_us": -1}), '"launch_us" is -1'),
        (setting("quick", value=1), '"quick" is 1'),
        (setting("rows", value={}), '"rows" is {}'),
        (setting("rows", 0, value=[]), "row 1: wanted an object"),
        (setting("rows", 0, "kind", value="frame"), 'row 1: "kind" is "frame"'),
        (setting("rows", 0, "ms_p50", value=True), 'row 1: "ms_p50" is true'),
        (setting("rows", 0, "rounds", value=[]), 'row 1: "rounds" is empty'),
        (setting("rows", 0, "rounds", 0, value=1), "row 1: a round is no object"),
        (setting("rows", 0, "rounds", 0, "ms", value=[1, 0]), "no list of times above 0"),
        (setting("rows", 0, "rounds", 0, "ms", value=["1"]), "no list of times above 0"),
        (setting("rows", 1, "name", value="optics.mosaic 64x48"), "row 2: the name"),
        (setting("rows", 1, "failed", value=None), 'row 2: "failed" is null'),
    ],
)
def test_a_wrong_result_is_refused_in_one_line(change, said, tmp_path):
    found = copy.deepcopy(result(row(), failed()))
    change(found)
    (tmp_path / "a.json").write_text(json.dumps(found))
    with pytest.raises(BadFile) as refused:
        read_result(tmp_path / "a.json")
    assert said in str(refused.value) and "\n" not in str(refused.value)
    assert not find_fault(result(row(), failed()))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"\xff", "is not JSON"),
        (b"{", "is not JSON"),
        (b"[]", "wanted an object"),
        (b'{"bench": NaN}', "no number of JSON"),
        (None, "cannot be read"),
    ],
)
def test_a_file_that_is_no_result_is_refused(text, said, tmp_path):
    if text is not None:
        (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(BadFile, match=said):
        read_result(tmp_path / "a.json")


# ---- scores and floors


def test_scores_are_geometric_means():
    """sqrt(0.1 x 0.4) = 0.2; the cube root of 0.1 x 0.4 x 0.2 is that, too."""
    rows = [
        row("a", attained=0.1),
        row("b", attained=0.4),
        row("c", "sensor", attained=0.2),
    ]
    assert score_rows(rows) == pytest.approx({"optics": 0.2, "sensor": 0.2, "all": 0.2})


def test_a_row_beyond_its_limit_does_not_make_up_for_another():
    """sqrt(0.25 x 1), not sqrt(0.25 x 4)."""
    found = score_rows([row("a", attained=0.25), row("b", attained=4.0)])
    assert found == pytest.approx({"optics": 0.5, "all": 0.5})


def test_a_wrong_answer_leaves_no_score():
    found = score_rows([row("a", attained=0.9), failed(), row("c", "sensor", attained=0.5)])
    assert found == {"optics": None, "sensor": pytest.approx(0.5), "all": None}
    assert score_rows([row(attained=None)]) == {"optics": None, "all": None}


def test_percentiles_are_of_all_repetitions():
    rounds = [{"at": 0.0, "ms": [5.0, 1.0]}, {"at": 9.0, "ms": [2.0, 4.0, 3.0, 6.0]}]
    found = sum_up(row(rounds=rounds, floor_ms=0.7))
    assert (found["ms_p20"], found["ms_p50"], found["ms_p80"]) == (2.0, 3.5, 5.0)
    assert found["attained"] == pytest.approx(0.2)
    assert sum_up(row(floor_ms=None))["attained"] is None


@pytest.mark.parametrize(
    ("moved", "operations", "launches", "floor", "bound"),
    [
        (4_000_000, 1_000_000, 10, 2.0, "memory"),  # 4 MB at 2 GB/s
        (4_000_000, 40_000_000, 10, 4.0, "arithmetic"),  # 40 MFLOP at 10 GFLOP/s
        (4_000_000, None, 1000, 5.0, "launches"),  # a thousand of 5 us
    ],
)
def test_the_floor_is_the_largest_of_three(moved, operations, launches, floor, bound):
    measured = LIMITS | {"copy_gbps": 2.0, "fma_gflops": 10.0, "launch_us": 5.0}
    counts = {"bytes": moved, "operations": operations, "launches": launches}
    found = suite.find_floor(counts, measured)
    assert found == {"floor_ms": pytest.approx(floor), "bound": bound}
    assert suite.find_floor(counts, dict.fromkeys(LIMITS))["floor_ms"] is None


def test_the_best_of_limits_are_the_largest_rates_and_the_least_time():
    first = LIMITS | {"copy_gbps": 2.0, "launch_us": 5.0, "upload_gbps": None}
    second = LIMITS | {"copy_gbps": 3.0, "launch_us": 4.0, "upload_gbps": None}
    assert limits.choose_best(first, second) == second
    assert limits.choose_best(second, first) == second


# ---- runs


def trusting(names):
    return [
        {"stage": name, "case": "a", "max_error": 0.0, "tolerance": 0.0, "why": ""}
        for name in names
    ]


def measure(*subjects, device="numpy", verify=trusting, **settings):
    device = open_device(device)
    return suite.measure(device, list(subjects), [SIZE], seconds=0.0, verify=verify, **settings)


def test_rounds_go_over_all_rows_in_turn():
    found = measure(Stage("sensor.flag"), Stage("display.encode"), rounds=3)
    assert not find_fault(found) and found["limits"]["copy_gbps"] is None
    times = sorted((each["at"], name["name"]) for name in found["rows"] for each in name["rounds"])
    assert [name for _, name in times] == ["sensor.flag 24x16", "display.encode 24x16"] * 3
    assert all(math.isfinite(one["ms_p50"]) for one in found["rows"])


def pipeline(name="a", error=0.0, run=lambda: None):
    work = Work(run, 1000, None, 0, True)
    return Pipeline(name, lambda device, size: work, lambda device: [Check("it", error, 0.5, "b")])


def test_a_pipeline_that_errs_or_raises_has_no_speed():
    def crash():
        raise RuntimeError("the driver\nis gone")

    found = measure(pipeline("wrong", 0.6), pipeline("crashes", run=crash), pipeline("good"))
    wrong, crashed, good = found["rows"]
    assert wrong["failed"] == "it: error 0.6, tolerance 0.5 (b)"
    assert crashed["failed"] == "RuntimeError: the driver is gone"
    assert good["verified"] and (good["max_error"], good["tolerance"]) == (0.0, 0.5)


def test_a_stage_that_nothing_has_verified_has_no_speed():
    (found,) = measure(Stage("sensor.flag"), verify=lambda names: [])["rows"]
    assert found["failed"] == "nothing verified it"


def test_repetitions_are_few_for_slow_rows_and_at_least_three_for_fast_ones(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(suite.time, "perf_counter", lambda: clock[0])

    def takes(seconds):
        def run():
            clock[0] += seconds

        return Work(run, 0, None, 0, True)

    device = open_device("numpy")
    assert suite.time_work(device, takes(0.5), 0.25) == pytest.approx([500])
    assert suite.time_work(device, takes(0.125), 0.125) == pytest.approx([125] * 3)
    assert suite.time_work(device, takes(0.0625), 0.25) == pytest.approx([62.5] * 4)


def test_a_clock_that_stands_is_no_time(monkeypatch):
    monkeypatch.setattr(suite.time, "perf_counter", lambda: 0.0)
    with pytest.raises(DeviceError, match="its clock gives no time"):
        suite.time_work(open_device("numpy"), Work(lambda: None, 0, None, 0, True), 0.0)


# ---- one more round


@pytest.fixture
def stored(tmp_path):
    """The path of a stored result of the NumPy device, without a load that its machine had."""
    path = tmp_path / "a.json"
    write_result(measure(Stage("sensor.flag"), Stage("display.encode"), rounds=1), path)
    return path


def append(path):
    device = open_device("numpy")
    return suite.append_round(read_result(path), str(path), device, seconds=0.0, verify=trusting)


def test_append_adds_a_round_to_every_row(stored):
    before, after = read_result(stored), append(stored)
    assert not find_fault(after) and after["limits"] == before["limits"]
    for old, new in zip(before["rows"], after["rows"], strict=True):
        assert new["rounds"][:1] == old["rounds"] and len(new["rounds"]) == 2
        times = [ms for each in new["rounds"] for ms in each["ms"]]
        assert new["ms_p50"] == pytest.approx(float(np.median(times)))
    assert after["hash"] == before["hash"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (setting("device", value="opencl:9"), "is of device opencl:9, not of numpy"),
        (setting("commit", value="abc"), "is of commit abc, not of "),
        (setting("machine", "driver", value="b"), "is of another machine: driver 'b'"),
        (setting("rows", 0, "hash", value="b"), "is of other kernels or inputs than these"),
        (setting("rows", 0, "name", value="optics.gone 24x16"), "this version has no such row"),
        (setting("rows", 0, "size", value="big"), "the size 'big' is not COLSxROWS"),
    ],
)
def test_append_refuses_other_measurements(change, said, stored):
    found = read_result(stored)
    change(found)
    write_result(found, stored)
    with pytest.raises(BadFile, match=said):
        append(stored)


# ---- hashes


def test_a_hash_changes_with_the_stages_files_and_the_shared_ones(tmp_path, monkeypatch):
    folder = tmp_path / "kernels"
    shutil.copytree(kernel_folder(), folder)
    monkeypatch.setattr(subject, "kernel_folder", lambda: folder)

    def digests():
        subject.digest_sources.cache_clear()
        return [Stage(name).digest() for name in ("sensor.flag", "display.encode")] + [
            list_pipelines()[0].digest()
        ]

    try:
        first = digests()
        assert first == digests() and len({*first}) == 3
        with (folder / "sensor" / "flag.cl").open("a") as file:
            file.write("\n")
        second = digests()
        assert [old == new for old, new in zip(first, second, strict=True)] == [False, True, False]
        with (folder / "common" / "philox.clh").open("a") as file:
            file.write("\n")
        third = digests()
        assert not any(old == new for old, new in zip(second, third, strict=True))
    finally:
        subject.digest_sources.cache_clear()


def test_a_hash_tells_inputs_apart():
    digest = subject.digest_values
    assert digest(np.zeros(2)) != digest(np.zeros(2, np.float32)) != digest(np.zeros((1, 2)))
    assert digest({"a": 1, "b": 2}) != digest({"a": 2, "b": 1})
    assert digest([1], [2]) != digest([1, 2]) and digest("1") != digest(1)


# ---- the machine


def fake_root(tmp_path, busy, clocks=(3000.0,)):
    """A root with /proc, in which all cores have done `busy` ticks of work and idled 100."""
    proc = tmp_path / "proc"
    proc.mkdir(exist_ok=True)
    (proc / "stat").write_text(f"cpu {busy} 0 0 100 0 0 0 {busy // 10} 0 0\n")
    (proc / "cpuinfo").write_text(
        "model name\t: some CPU\n" + "".join(f"cpu MHz\t\t: {clock}\n" for clock in clocks)
    )
    return tmp_path


def test_a_busy_machine_warns(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (900.0, 0.0, 0.0))
    device = open_device("numpy")
    watch = Watch(device, fake_root(tmp_path, 0))
    watch.sample()
    fake_root(tmp_path, 10**7, clocks=(1000.0, 1500.0))
    watch.sample()
    facts = watch.facts()
    assert facts["cpu"] == "some CPU" and facts["clock_mhz"] == [1500.0, 3000.0]
    # 10^7 ticks of others and 10^6 of the host, of 1.1 x 10^7
    assert facts["others"] == pytest.approx(10 / 11, abs=1e-3)
    for words in (
        "busy before the run: load 900.0",
        "other processes took 91 %",
        "took 9 %",
        "the clock changed between 1500 and 3000 MHz",
    ):
        assert any(words in warning for warning in facts["warnings"]), words
    assert len(facts["warnings"]) == 4


def test_a_quiet_machine_does_not_warn(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    watch = Watch(open_device("numpy"), fake_root(tmp_path, 0))
    watch.sample()
    (tmp_path / "proc" / "stat").write_text("cpu 0 0 0 1000 0 0 0 0 0 0\n")
    assert watch.facts()["warnings"] == []


def test_a_system_that_tells_nothing_gives_none(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "getloadavg", raising=False)
    watch = Watch(open_device("numpy"), tmp_path)
    watch.sample()
    facts = watch.facts()
    assert facts["warnings"] == []
    for key in ("load", "others", "clock_mhz", "temperature", "governor"):
        assert facts[key] is None, key


def test_a_hot_processor_warns(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    zone = tmp_path / "sys" / "class" / "thermal" / "thermal_zone0"
    throttle = tmp_path / "sys/devices/system/cpu/cpu0/thermal_throttle"
    for folder in (zone, throttle):
        folder.mkdir(parents=True)
    (zone / "temp").write_text("95000\n")
    (throttle / "package_throttle_count").write_text("3\n")
    watch = Watch(open_device("numpy"), tmp_path)
    (throttle / "package_throttle_count").write_text("4\n")
    watch.sample()
    facts = watch.facts()
    assert facts["temperature"] == 95.0 and facts["warnings"] == [
        "the processor lowered its clock because of heat",
        "hot: 95 degrees C",
    ]


def test_a_gpus_state_is_read_from_its_driver(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    said = dict(zip(SMI, ("60", "1980", "1980", "30", "0x0000000000000001"), strict=True))
    device = open_device("numpy")
    monkeypatch.setattr(type(device), "is_gpu", True)
    watch = Watch(device, tmp_path, lambda device: list(said.values()))
    watch.sample()
    said |= {"clocks.sm": "1200", "clocks_throttle_reasons.active": "0x0000000000000024"}
    watch.sample()
    facts = watch.facts()
    assert facts["clock_mhz"] == [1200.0, 1980.0] and facts["temperature"] == 60.0
    assert facts["warnings"] == [
        "the GPU was busy before the run: 30 %",
        "the clock changed between 1200 and 1980 MHz",
        "the GPU lowered its clock: heat, power cap",
    ]


# ---- limits of a device


def test_numpy_has_no_limits():
    assert set(limits.ceilings(open_device("numpy")).values()) == {None}


# ---- the pipelines


def test_there_are_twelve_pipelines():
    assert len({one.name for one in list_pipelines()}) == 12


# ---- the command line


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("", "run"),
        ("--quick --json a", "run --quick --json a"),
        ("run --quick", "run --quick"),
        ("--help", "--help"),
        ("nonsense", "nonsense"),
        ("--pareto ramp --size 8x8", "pareto ramp --size 8x8"),
        ("--device numpy --pareto=ramp", "pareto --device numpy ramp"),
        ("--compare a b --html c", "compare a b --html c"),
        ("--pack folder", "pack folder"),
    ],
)
def test_forms_without_a_subcommand(given, wanted):
    known = ("run", "compare", "pack", "pareto")
    assert with_subcommand(given.split(), known) == wanted.split()


def test_a_form_of_an_unknown_subcommand_stays():
    assert with_subcommand(["--pack", "a"], ["run"]) == ["run", "--pack", "a"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("nonsense", "invalid choice: 'nonsense'"),
        ("--device nonsense", "unknown device 'nonsense'"),
        ("--device numpy --stage optics.blurr", "did you mean 'optics.blur'"),
        ("--device numpy --only vidio", "unknown stage or pipeline 'vidio'; did you mean 'video'"),
        ("--device numpy --size 0x0", "size = 0 x 0"),
        ("--device numpy --size big", "wanted COLSxROWS"),
        ("--device numpy --rounds 0", "wanted a whole number"),
        (f"--device numpy --json {__file__}/a.json", "cannot be written"),
        ("--append missing.json", "cannot be read"),
        ("--append a.json --quick", "--quick: --append repeats the rows of its file"),
        ("--append a.json --json b.json", "--json: --append repeats the rows of its file"),
    ],
)
def test_mistakes_are_said_in_one_line(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["bench", *arguments.split()])
    except SystemExit as stop:
        status = stop.code
    error = capsys.readouterr().err
    assert status == 2 and said in error and error.count("\n") == 1, error


def test_the_command_prints_writes_and_appends(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "QUICK_SECONDS", 0.0)
    path = tmp_path / "a.json"
    options = "--device numpy --quick --size 24x16 --stage sensor.flag --rounds 2".split()
    assert main(["bench", *options, "--json", str(path)]) == 0
    printed = capsys.readouterr().out
    assert (
        "numpy: " in printed and "limits: none" in printed and "cold build: not measured" in printed
    )
    assert sum(line.startswith("sensor.flag 24x16") for line in printed.splitlines()) == 1
    assert len(read_result(path)["rows"][0]["rounds"]) == 2
    assert main(["bench", "--append", str(path)]) == 0
    assert len(read_result(path)["rows"][0]["rounds"]) == 3


def test_the_command_says_what_failed_and_warns(capsys, tmp_path, monkeypatch):
    def unequal(device):
        return lambda names: [replace_error(one) for one in trusting(names)]

    def replace_error(one):
        return one | {"max_error": 1.0, "why": "planted"}

    monkeypatch.setattr(suite, "QUICK_SECONDS", 0.0)
    monkeypatch.setattr(suite, "make_verifier", unequal)
    monkeypatch.setattr(os, "getloadavg", lambda: (900.0, 0.0, 0.0))
    options = "--device numpy --quick --size 24x16 --stage sensor.flag".split()
    assert main(["bench", *options]) == 1
    printed = capsys.readouterr().out
    assert (
        "sensor.flag 24x16" in printed and "no speed: a: error 1, tolerance 0 (planted)" in printed
    )
    assert "warning: the machine was busy before the run: load 900.0" in printed
    assert "1 of 1 rows failed their verification and have no speed" in printed
