"""The hard cases on every device: what `gpusim verify --hard` runs."""

import json

import pytest
from devices import KINDS

from gpusim.backends import open_device
from gpusim.cli.main import main
from gpusim.judge.hard import case, hard

LONG = {1, 2, 3, 4, 8, 13, 18, 19, 24, 28, 29}  # take more than about 5 s
NUMBERS = [
    pytest.param(number, marks=pytest.mark.slow) if number in LONG else number
    for number in range(1, 31)
]


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("number", NUMBERS)
def test_hard_case(number, device):
    (row,) = hard(open_device(device), [number])
    assert row["ok"], f"{row['asked']}: got {row['got']:.3g} of {row['limit']:.3g}, {row['why']}"


def test_there_are_thirty():
    assert not list(hard(open_device("numpy"), []))  # which has read all of them
    assert sorted(case.CASES) == list(range(1, 31))


@pytest.mark.parametrize(
    "run",
    [
        lambda device: 1 / 0,
        lambda device: (float("nan"), 1.0, "no number"),
        lambda device: (2.0, 1.0, "too much"),
    ],
)
def test_what_fails_is_a_line_and_a_status(run, monkeypatch, capsys, tmp_path):
    """A device that raises, a figure that is none, one beyond its limit: never a skip."""
    monkeypatch.setattr(
        "gpusim.judge.hard.CASES", {27: case.Case(27, "made to fail", "nothing", run)}
    )
    assert (
        main(["verify", "--hard", "--device", "numpy", "--json", str(tmp_path / "rows.json")]) == 1
    )
    out = capsys.readouterr().out
    assert "FAIL numpy      27 made to fail" in out and "0 passed, 1 failed" in out
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert row["ok"] is False and row["number"] == 27


def test_the_worst_is_told():
    """The farthest beyond its limit, where a limit of 0 allows nothing and NaN is beyond all."""
    found = case.worst(case.Found(1, 2, "half"), case.Found(3, 4, "more"), case.Found(0, 0, "none"))
    assert found[:2] == (3, 4) and "half" in found.words and "none" in found.words
    assert case.worst(found, case.Found(1, 0, "one"))[:2] == (1, 0)
    assert case.worst(found, case.Found(float("nan"), 1, "lost")).words.startswith("lost")
