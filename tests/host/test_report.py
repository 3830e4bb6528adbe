"""A report in words: the verdict first, and a meaning for every named error."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import pytest

import gpusim as gs
from gpusim.domain.account import UNKNOWN, Account, Bound, Tolerance
from gpusim.pipeline.causes import BESIDE, CAUSES
from gpusim.pipeline.report import Error, Report, StageReport

ROOT = Path(__file__).parents[2]
SOURCES = [
    *(ROOT / "gpusim" / "planner").rglob("*.py"),
    *(ROOT / "gpusim" / "captures").rglob("*.py"),
    ROOT / "gpusim" / "optics" / "depth.py",
]
HOLDERS = {"bounds", "predicted", "beside", "found"}  # dictionaries of named errors


def constants(tree):
    """Texts that a module gives names in capitals."""
    return {
        target.id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name) and isinstance(node.value.value, str)
    }


def holder(node):
    """The name that an expression ends in, such as "bounds" of `notes.bounds`."""
    return getattr(node, "id", getattr(node, "attr", ""))


def named_errors():
    """(name, file) of every named error that the planner and captures make, from their source text."""
    shared = {"SAMPLING": "spectral sampling"}
    for path in SOURCES:
        tree = ast.parse(path.read_text())
        known = shared | constants(tree)

        def text(node, known=known):
            if isinstance(node, ast.Name):
                return known.get(node.id)
            return node.value if isinstance(node, ast.Constant) else None

        for node in ast.walk(tree):
            keys = []
            if isinstance(node, ast.Assign):
                keys += [
                    target.slice
                    for target in node.targets
                    if isinstance(target, ast.Subscript) and holder(target.value) in HOLDERS
                ]
                if isinstance(node.value, ast.Dict) and any(
                    holder(target) in HOLDERS for target in node.targets
                ):
                    keys += node.value.keys
            elif isinstance(node, ast.Call) and holder(node.func) == "leave_out":
                keys += node.args[2:3]
            elif isinstance(node, ast.BinOp) and isinstance(node.right, ast.Dict):
                keys += node.right.keys if holder(node.left) in HOLDERS else []
            for key in keys:
                name = text(key)
                if isinstance(name, str):
                    yield name, path.name


def test_every_named_error_has_words():
    found = dict(named_errors())
    assert len(found) > 25 and {"planes", "border", "scene sampling"} <= found.keys()
    assert [f"{name} ({file})" for name, file in found.items() if name not in CAUSES | BESIDE] == []


def report(**changes):
    """A report with three known errors and one that is not known."""
    bounds = {
        "planes": Bound(1e-4, 0.05, 0.1),
        "border": Bound(8e-5, 0.04, 0.2),
        "transforms": Bound(2e-7, 1e-4, 2e-4),
    }
    given = {
        "scene": {"name": "chart", "cols": 60, "rows": 40},
        "camera": {"name": "phone", "exposure_time_s": 0.0125, "iso": 52.0},
        "device": {"name": "opencl:0"},
        "frame": 3,
        "seed": 1,
        "stages": [
            StageReport("optics.far", "Gaussians", 3.0),
            StageReport("optics.airy", "", 0.0),
        ],
        "account": Account(bounds),
        "beside": {"scene sampling": 0.05},
        "left_out": ["finer structure: relative rms 0.05, predicted", "DSNU: at most 1e-4 sigma"],
        "wall_ms": 10.0,
        "plan": "abc",
        "notes": ["the scene is a test"],
    }
    return Report(**(given | changes))


def judged(tolerance, **changes):
    asked = Tolerance.parse(tolerance)
    one = report(tolerance=asked, **changes)
    return replace(one, verdict=one.account.verdict(asked, "a larger tolerance would be met"))


@pytest.mark.parametrize(
    ("made", "first"),
    [
        (
            report(),
            "no tolerance given: predicted error 0.00013 relative rms, most of it planes: 0.0001",
        ),
        (judged("video"), "tolerance met: 0.064 of 0.1 sigma at 99.9 %, predicted"),
        (
            judged("1e-5"),
            "tolerance NOT met: 0.00013 of 1e-05 rms, predicted (times 1.5 to be sure), most of it planes: "
            "0.0001; a larger tolerance would be met",
        ),
        (
            judged("video", error=Error(1e-4, 0.01, 0.2, 0.3)),
            "tolerance NOT met: true error 0.2 of 0.1 sigma at 99.9 %; predicted met: 0.064 of 0.1 sigma "
            "at 99.9 %",
        ),
        (
            judged("video", account=Account({"field of view": UNKNOWN})),
            "tolerance cannot be judged: field of view; the known errors are 0 of 0.1 sigma at 99.9 %, "
            "predicted",
        ),
        (
            report(tolerance=Tolerance.parse("video")),
            "tolerance not judged: the plan is a draft",
        ),
    ],
)
def test_the_first_line_is_the_verdict(made, first):
    assert str(made).split("\n")[0] == made.table().split("\n")[0] == first


def test_words_have_the_time_then_the_causes_by_size():
    lines = str(judged("video")).split("\n")
    assert lines[1:3] == [
        "  chart 60x40 by phone on opencl:0: exposure 12.5 ms, ISO 52, frame 3",
        "  time: 3.00 ms for the stages, 10.00 ms with planning and copies; slowest: optics.far 3.00 ms",
    ]
    causes = [line for line in lines if re.match("    (planes|border), ", line)]
    assert [line.split(",")[0].strip() for line in causes] == ["planes", "border"]
    assert f"{CAUSES['border'].meaning}; {CAUSES['border'].remedy}" in causes[1]
    assert "    smaller: transforms 0.0001" in lines
    assert any(line.startswith("    scene sampling, 0.05 of the light: ") for line in lines)
    # the first has its cause above
    assert "  not modelled: DSNU: at most 1e-4 sigma" in lines
    assert lines[-1] == "  note: the scene is a test"


def test_errors_that_are_not_known_are_named():
    text = str(judged("video", account=Account({"field of view": UNKNOWN}, doubt="a wide blur")))
    assert "    field of view, not known: " in text and "    not certain: a wide blur" in text


def test_the_table_has_every_stage_and_error():
    table = report(error=Error(1e-4, 0.01, 0.2, 0.3)).table()
    for words in (
        "optics.far                  3.00 ms  Gaussians",
        "sum of stages               3.00 ms  of 10.00 ms with planning and copies",
        "predicted: transforms             rms 2e-07, 99.9 % 0.0001 sigma, largest 0.0002 sigma",
        "predicted: all together           rms 0.00013",
        "not in the total: scene sampling 0.05",
        "true error: rms 0.0001, largest local 0.01, 99.9 % 0.2 sigma, largest 0.3 sigma",
        "predicted over true relative rms: 1.3",
        "not modelled: finer structure: relative rms 0.05, predicted",
        "plan: abc",
        "note: the scene is a test",
    ):
        assert f"  {words}" in table, words


def test_a_frame_says_its_verdict_first():
    simulate = gs.Simulator(gs.open_camera("phone"), device="numpy", tolerance="video")
    made = simulate(gs.chart("colorchecker", size=(24, 16)), verify=True).report
    assert str(made).startswith("tolerance met: true error ") and "optics.airy" in made.table()


def test_the_page_explains_every_cause():
    page = (ROOT / "docs" / "report.md").read_text()
    for name, cause in (CAUSES | BESIDE).items():
        assert f"| {name} | {cause.meaning} | {cause.remedy} |" in page, name


def test_the_page_explains_every_line():
    """Lines of a report with all of its parts, without figures and names of causes."""
    page = (ROOT / "docs" / "report.md").read_text()
    full = judged("video", error=Error(1e-4, 0.01, 0.2, 0.3))
    doubtful = judged("video", account=Account(full.account.bounds, doubt="a wide blur"))
    for line in [*str(full).split("\n"), *str(doubtful).split("\n"), *full.table().split("\n")]:
        word = re.match(r" *([a-z ]+):", line)
        if word and not line.startswith(("tolerance", "  optics", "    ")):
            assert f"`{word[1]}" in page, line
    for word in ("smaller", "not certain", "sum of stages", "optics.far", "tolerance NOT met"):
        assert f"`{word}" in page, word
