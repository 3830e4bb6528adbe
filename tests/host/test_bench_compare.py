"""Comparisons of results: verdicts, statuses, refusals, tables, pages, histories, the page's script."""

import json
import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from bench_results import fail_row, made_results, row_names, write_results

from gpusim.bench.compare import compare_files, pair_rounds
from gpusim.cli.main import main

ROOT = Path(__file__).parents[2]


def compared(tmp_path, results, **options):
    return compare_files(write_results(tmp_path, results), **options)


def words(comparison, number, column=0):
    return comparison.columns[column].verdicts[row_names(60)[number]].words


def test_planted_changes_get_their_verdicts(tmp_path):
    results = made_results(30, 5, sides=3, change={3: 0.1, 7: -0.2})
    fail_row(results[1], 5)
    found = compared(tmp_path, results)
    assert [words(found, number) for number in (3, 5, 7, 8)] == [
        "slower",
        "wrong",
        "faster",
        "same",
    ]
    assert words(found, 5, 1) == "same"
    counted = [verdict.words for verdict in found.columns[1].verdicts.values()]
    assert counted.count("same") == 28
    assert found.status() == 1


@pytest.mark.parametrize(
    "change, damage, options, status",
    (
        ({}, None, {}, 0),
        ({2: -0.3}, None, {}, 0),
        ({2: 0.1}, None, {}, 1),
        ({2: 0.1}, None, {"worst": 0.2}, 0),
        ({2: 0.1}, None, {"worst": 0.05}, 1),
        ({}, None, {"worst": 0.001}, 125),
        ({2: 0.1}, None, {"names": ["spectral"]}, 0),
        ({2: 0.1}, None, {"names": ["sensor.row02"]}, 1),
        ({}, "fail", {}, 1),
        ({}, "fail both", {}, 0),
        ({}, "mend", {}, 0),
        ({}, "lose", {}, 125),
        ({}, "hash", {}, 125),
        ({}, "hash", {"other_kernels": True}, 0),
        ({2: 0.1}, "hash", {}, 1),
        ({}, "short", {}, 125),
    ),
)
def test_status(tmp_path, change, damage, options, status):
    base, other = results = made_results(30, 5, change=change)
    if damage in ("fail", "fail both"):
        fail_row(other, 4)
    if damage in ("mend", "fail both"):
        fail_row(base, 4)
    if damage == "lose":
        del other["rows"][4]
    if damage == "hash":
        other["rows"][4]["hash"] = "another"
    if damage == "short":
        del other["rows"][4]["rounds"][2:]
    assert compared(tmp_path, results, **options).status() == status


def test_two_rounds_cannot_be_judged(tmp_path):
    found = compared(tmp_path, made_results(30, 2, change={1: 1.0}))
    assert {verdict.words for verdict in found.columns[0].verdicts.values()} == {"cannot be judged"}
    assert found.status() == 125


def test_all_slower_decides_the_status_unless_rows_are_selected(tmp_path):
    results = made_results(30, 6, common=0.2, change={0: -1 / 6})
    assert compared(tmp_path, results).status() == 1
    found = compared(tmp_path, results, names=["spectral.row00"])
    assert found.columns[0].verdicts.keys() == {"spectral.row00 640x480"}
    assert found.status() == 0


def test_rounds_in_blocks_are_said_and_widen(tmp_path):
    visible = {}
    for alternate in (True, False):
        found = compared(tmp_path, made_results(30, 4, alternate=alternate)).columns[0]
        assert any("do not alternate" in note for note in found.notes) is not alternate
        visible[alternate] = np.median([each.change.visible for each in found.verdicts.values()])
    assert visible[False] > 2 * visible[True]


@pytest.mark.parametrize(
    "order, pairs",
    (
        ("abab", [(0, 0), (1, 1)]),
        ("abba", [(0, 0), (1, 1)]),
        ("aaabbb", [(2, 0)]),
        ("aaabbbabab", [(2, 0), (3, 2), (4, 3)]),
        ("ababa", [(0, 0), (1, 1)]),
        ("", []),
    ),
)
def test_rounds_are_paired_with_their_neighbours(order, pairs):
    """Two rows each, by hand."""
    rounds = {
        side: [{"at": float(i)} for i, name in enumerate(order) if name == side] for side in "ab"
    }
    later = {side: [{"at": each["at"] + 0.5} for each in rounds[side]] for side in "ab"}
    assert pair_rounds([[rounds[side], later[side]] for side in "ab"]) == pairs
    at_once = [[rounds[side], [{"at": each["at"] + 9} for each in rounds[side]]] for side in "ab"]
    assert pair_rounds(at_once) == []


def test_rounds_without_a_neighbour_are_left_out_aloud(tmp_path):
    results = made_results(30, 5)
    for row in results[1]["rows"]:
        del row["rounds"][4]
    found = compared(tmp_path, results).columns[0]
    assert found.notes[0].startswith("4 rounds: ")
    assert found.notes[1] == "5 and 4 rounds, 4 of each are compared: neighbours in time"
    assert not any("alternate" in note for note in found.notes)


def run(capsys, *arguments):
    status = main(["bench", "compare", *arguments])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_refusals_are_one_line(tmp_path, capsys):
    results = made_results(10, 3, sides=4)
    for row in results[1]["rows"]:
        row["hash"] = "another"
    for row in results[2]["rows"]:
        row["name"], row["size"] = row["name"].replace("640x480", "64x48"), "64x48"
    results[3]["machine"]["device"] = "another"
    a, other_kernels, other_size, other_device = write_results(tmp_path, results)
    (tmp_path / "text.json").write_text("no JSON")
    (tmp_path / "list.json").write_text("[]")
    cases = (
        ((a,), "one file; wanted two or more"),
        ((a, other_kernels), "--other-kernels"),
        ((a, other_size), "wanted a run of the same rows, size 640x480"),
        ((a, str(tmp_path / "none.json")), "cannot be read"),
        ((a, str(tmp_path / "text.json")), "is not JSON"),
        ((a, str(tmp_path / "list.json")), "is not a result"),
        ((a, other_device, "--row", "optics.row1"), "did you mean"),
        (
            (a, other_device, "--html", str(tmp_path / "text.json" / "page.html")),
            "cannot be written",
        ),
        ((a, other_device, "--history"), "wanted one machine"),
        ((a, a, "--history", "--worst", "5%"), "--worst"),
        ((a, a, "--history", "--other-kernels"), "--other-kernels"),
    )
    for arguments, part in cases:
        status, out, error = run(capsys, *arguments)
        assert (status, out, error.count("\n")) == (2, "", 1) and part in error, (arguments, error)
    for text in ("0", "-3%", "abc", "1e9%", "nan"):
        with pytest.raises(SystemExit) as stop:
            main(["bench", "compare", a, a, "--worst", text])
        assert stop.value.code == 2 and capsys.readouterr().err.count("\n") == 1


def test_table_and_both_forms_of_the_command(tmp_path, capsys):
    results = made_results(30, 5, change={3: 0.1})
    fail_row(results[1], 5)
    results[1]["machine"]["warnings"] = [f"warning {number}" for number in range(9)]
    results[1]["limits"] = results[1]["limits"] | {"copy_gbps": 20.0}
    a, b = write_results(tmp_path, results)
    status, out, error = run(capsys, a, b)
    assert (status, error) == (1, "")
    assert out.count(" same ") >= 28 and "warning 2" in out and "and 6 more warnings" in out
    assert "warning 3" not in out and "copy_gbps x2.00" in out
    assert "  slower: processor.row03 640x480: x1.10" in out
    assert "  wrong: pipelines.row05 640x480: error 1, tolerance 1e-5" in out
    lines = [line for line in out.splitlines() if " | " in line]
    assert len(lines) == 2 + 30 + 7 and len({line.index("|") for line in lines}) == 1
    assert main(["bench", "--compare", a, b]) == 1
    assert capsys.readouterr().out == out


def test_equal_names_of_files_are_told_apart(tmp_path, capsys):
    results = made_results(10, 3, sides=3)
    paths = []
    for name, result in zip(("one", "two", "three"), results, strict=True):
        (tmp_path / name).mkdir()
        paths += write_results(tmp_path / name, [result])
    out = run(capsys, *paths)[1]
    assert all(f"{name}/a" in out for name in ("one", "two", "three"))


class Page(HTMLParser):
    """Checks that elements are closed in order, and that nothing is loaded."""

    VOID = ("meta",)

    def __init__(self):
        super().__init__()
        self.open, self.texts, self.cells = [], [], []

    def handle_starttag(self, tag, attributes):
        assert tag not in ("script", "link", "img", "iframe")
        assert not {"src", "href"} & {name for name, _ in attributes}
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.cells.append(0)
        if tag in ("td", "th"):
            self.cells[-1] += int(dict(attributes).get("colspan", 1))

    def handle_startendtag(self, tag, attributes):
        assert tag in ("line", "circle", "polyline")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        self.texts.append(text)


def read_page(path):
    text, page = path.read_text(), Page()
    page.feed(text)
    assert not page.open and "@import" not in text and "url(" not in text
    return page


def test_page_of_a_comparison(tmp_path, capsys):
    results = made_results(30, 5, sides=3, change={3: 0.1})
    results[1]["machine"]["driver"] = "<b>a & b</b>"
    fail_row(results[0], 4)
    fail_row(results[1], 5)
    fail_row(results[2], 4)
    results[2]["rows"][9]["hash"] = "another"
    del results[2]["rows"][11]
    paths = write_results(tmp_path, results)
    run(capsys, *paths, "--html", str(tmp_path / "page.html"))
    page = read_page(tmp_path / "page.html")
    assert any("<b>a & b</b>" in text for text in page.texts)
    for name in row_names(30):
        assert name in page.texts
    seen = ("▲ slower", "✗ wrong", "✗ wrong in both", "✓ mended", "? other kernels", "= same")
    assert set(seen) <= set(page.texts)
    assert any("slower: processor.row03 640x480: x1.1" in text for text in page.texts)
    assert set(page.cells[2:]) == {1 + 3 + 2 * 7}  # below both lines of heads all rows are as long


def test_a_page_names_the_largest_changes(tmp_path, capsys):
    change = {number: 0.1 * number for number in range(1, 15)}
    a, b = write_results(tmp_path, made_results(40, 5, change=change))
    run(capsys, a, b, "--html", str(tmp_path / "page.html"))
    lines = [text for text in read_page(tmp_path / "page.html").texts if "▲ slower: " in text]
    assert [name for name in row_names(15)[:4:-1]] == [line.split(": ")[1] for line in lines]
    assert "and 4 more rows" in (tmp_path / "page.html").read_text()


def test_history(tmp_path, capsys):
    results = made_results(30, 4, sides=4)
    for result in results[2:]:
        for row in (result["rows"][3],):
            row["hash"] = "another"
            row["ms_p50"] *= 1.3
            for each in row["rounds"]:
                each["ms"] = [1.3 * ms for ms in each["ms"]]
    fail_row(results[3], 6)
    page, picture = tmp_path / "page.html", tmp_path / "picture.png"
    a, b, c, d = write_results(tmp_path, results)
    status, out, _ = run(
        capsys, "--history", c, a, d, b, "--html", str(page), "--picture", str(picture)
    )
    assert status == 0
    lines = out.splitlines()
    assert [line.split()[:3] for line in lines[1:5]] == [
        [name, f"2026-01-0{day}T00:00", f"{day - 1}" * 10] for day, name in enumerate("abcd", 1)
    ]
    row = next(line for line in lines if line.startswith("processor.row03"))
    assert "slower x1.3" in row and row.endswith("other kernels at c")
    assert next(line for line in lines if line.startswith("spectral.row06")).endswith("wrong at d")
    assert sum("slower" in line for line in lines) == 2  # its row, and the result
    found = read_page(page)
    assert any("slower x1.3" in text for text in found.texts)
    assert set(row_names(30)) <= set(found.texts)
    assert picture.stat().st_size > 10_000


def test_history_of_chosen_rows(tmp_path, capsys):
    paths = write_results(tmp_path, made_results(30, 3, sides=3))
    out = run(capsys, "--history", *paths, "--row", "optics.row01")[1]
    assert sum("640x480" in line for line in out.splitlines()) == 1


def test_pictures(tmp_path, capsys):
    from PIL import Image

    results = made_results(30, 4, sides=3, change={3: 0.1})
    fail_row(results[1], 5)
    paths = write_results(tmp_path, results)
    for name in ("picture.png", "picture.svg"):
        assert run(capsys, *paths, "--picture", str(tmp_path / name))[0] == 1
    with Image.open(tmp_path / "picture.png") as picture:
        assert np.ptp(np.asarray(picture.convert("RGB")), axis=(0, 1)).min() > 200
    assert "<svg" in (tmp_path / "picture.svg").read_text()


def test_without_matplotlib_the_rest_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    a, b = write_results(tmp_path, made_results(10, 3))
    page = tmp_path / "page.html"
    status, out, error = run(
        capsys, a, b, "--html", str(page), "--picture", str(tmp_path / "p.png")
    )
    assert status == 2 and "pip install" in error and "same" in out and page.exists()
    assert not (tmp_path / "p.png").exists()


def test_results_are_read_as_the_suite_writes_them(tmp_path):
    """A result of one round after another, by the functions of the suite."""
    from gpusim.bench.result import read_result, write_result

    result = made_results(10, 3)[0]
    write_result(result, tmp_path / "a.json")
    assert read_result(tmp_path / "a.json") == json.loads(json.dumps(result))
    assert compare_files([tmp_path / "a.json", tmp_path / "a.json"]).status() == 0


# `gpusim bench run` of a checkout whose row processor.row03 is slow if there is a file `slow`
FAKE_RUN = """
import json, os, pathlib, random, sys, time
path = sys.argv[sys.argv.index("--append" if "--append" in sys.argv else "--json") + 1]
result = json.load(open(path if "--append" in sys.argv else "template.json"))
for row in result["rows"]:
    ms = 1.0 + 0.2 * (os.path.exists("slow") and row["name"].startswith("processor.row03"))
    ms *= 1 + 0.003 * random.random()
    row["rounds"] = row["rounds"] * ("--append" in sys.argv) + [{"at": time.time(), "ms": [ms] * 3}]
pathlib.Path(path).write_text(json.dumps(result))
"""


@pytest.mark.slow
@pytest.mark.parametrize("first_slow", (2, 5, None))
def test_the_script_for_bisection_finds_the_slow_commit(tmp_path, first_slow):
    """The script of the page, with programs that only write results."""
    script = (
        (ROOT / "docs" / "benchmark-compare.md").read_text().split("```sh\n")[2].split("```")[0]
    )
    script = script.replace("processor.bilinear", "processor.row03").replace(
        "/tmp/", f"{tmp_path}/"
    )
    (tmp_path / "bisect.sh").write_text(script)
    tools = tmp_path / "tools"
    tools.mkdir()
    for name, module in (("python", ""), ("gpusim", "-m gpusim")):
        path = "" if name == "python" else f"PYTHONPATH={ROOT} "
        (tools / name).write_text(f'#!/bin/sh\n{path}exec {sys.executable} {module} "$@"\n')
        (tools / name).chmod(0o755)
    work, template = tmp_path / "work", made_results(20, 1)[0]
    (work / "gpusim").mkdir(parents=True)
    (work / "gpusim" / "__main__.py").write_text(FAKE_RUN)
    (work / "template.json").write_text(json.dumps(template))
    environment = os.environ | {
        "PATH": f"{tools}:{os.environ['PATH']}",
        "GIT_CONFIG_GLOBAL": os.devnull,
        "GIT_CONFIG_NOSYSTEM": "1",
        **{
            f"GIT_{who}_{what}": "a@b"
            for who in ("AUTHOR", "COMMITTER")
            for what in ("NAME", "EMAIL")
        },
    }

    def git(*arguments):
        return subprocess.run(
            ["git", *arguments],
            cwd=work,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    git("init", "-q", "-b", "main")
    for number in range(6):
        (work / "number").write_text(str(number))
        if number == first_slow:
            (work / "slow").touch()
        git("add", "-A")
        git("commit", "-q", "-m", f"step {number}")
    git("worktree", "add", "-q", "--detach", "../good", "HEAD~5")
    git("bisect", "start", "HEAD", "HEAD~5")
    said = git("bisect", "run", "sh", str(tmp_path / "bisect.sh"))
    found = git("show", "-s", "--format=%s", "refs/bisect/bad").stdout.strip()
    if first_slow is None:  # git takes the last commit's word for bad
        first_slow = 5
    assert found == f"step {first_slow}", said.stdout + said.stderr
    assert "is the first bad commit" in said.stdout
