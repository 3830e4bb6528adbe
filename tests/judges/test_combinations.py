"""The matrix of pairs of features: its states, its text, the command, and the block in docs/limits.md."""

import pickle
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from devices import KINDS

import gpusim as gs
from gpusim.apps.routes import make
from gpusim.cli.main import main
from gpusim.domain.errors import BadData
from gpusim.judge import combinations as matrix
from gpusim.judge.combinations import FEATURES, NAMES, Made, combinations

DOCS = Path(__file__).parents[2] / "docs"
WANTED = {  # the parts of the matrix: names that files, reports and docs use for them
    *("measured spread", "Zernike", "blades", "obscuration", "mask", "Seidel"),
    *("distortion", "lateral colour", "low-pass", "optical axis", "calibration", "fisheye"),
    *("depth", "layers", "highlights", "supersampling", "several lights", "several views"),
    *("stacked", "quad-Bayer", "binning", "rolling shutter", "motion"),
    *("reads", "burst", "bracket", "video", "preview", "batch"),
}


def states(made_of, *names):
    """State of each pair of a `make` that returns `made_of(case)`."""
    device = gs.open_device("numpy")
    cells = combinations(device, lambda case, _: made_of(case), names)
    return {(cell.first, cell.second): cell for cell in cells}


def numbers(case):
    """Frames that depend on everything: a stand-in that is as fast as its features."""
    bits = pickle.dumps((case.camera, sorted(case.captures), sorted(case.outputs)))
    return Made([np.frombuffer(bits, np.uint8).astype(float)])


def test_all_features_are_there_once():
    assert set(NAMES) == WANTED
    assert len(NAMES) == len(WANTED) == 29
    for feature in FEATURES:
        assert set(feature.excludes) <= WANTED - {feature.name}


def test_a_pair_runs_or_is_excluded_by_physics():
    found = states(numbers, "measured spread", "blades", "stacked", "quad-Bayer", "batch")
    assert found["blades", "batch"].state == "runs"
    assert found["measured spread", "blades"].state == "physics"
    assert "whole lens" in found["measured spread", "blades"].why
    assert found["stacked", "quad-Bayer"].state == "error"  # the stand-in shows a difference
    assert len(found) == 5 + 10


def test_a_feature_without_effect_is_found():
    found = states(lambda case: Made([np.ones(3) * bool(case.captures)]), "blades", "burst")
    assert found["blades", "blades"].state == "ignored"
    assert found["burst", "burst"].state == "runs"
    assert found["blades", "burst"].state == "ignored"


def test_an_effect_that_only_a_pair_leaves_out_is_found():
    def made_of(case):
        both = case.captures and case.camera.optics.pupil.blades
        left = {"sampling": 0.02} | ({"depth": float("inf")} if both else {})
        return replace(numbers(case), left_out=left)

    found = states(made_of, "blades", "burst")
    assert found["blades", "blades"].state == "runs"
    assert found["blades", "burst"].state == "left out"
    assert found["blades", "burst"].why == "depth (inf)"


@pytest.mark.parametrize(
    ("error", "state"),
    [(matrix.NoWay("this way"), "no way"), (BadData("no"), "refused"), (ValueError(), "error")],
)
def test_errors_are_cells(error, state):
    def made_of(case):
        if case.captures and case.outputs:
            raise error
        return numbers(case)

    found = states(made_of, "burst", "batch")
    assert found["burst", "batch"].state == state
    assert not found["burst", "batch"].is_good


def test_frames_that_are_not_finite_are_errors():
    found = states(lambda case: Made([np.full(2, np.nan)]), "burst")
    assert found["burst", "burst"].state == "error"


@pytest.mark.parametrize("name", KINDS)
def test_pairs_of_real_frames(name):
    device = gs.open_device(name)
    cells = list(combinations(device, make, ("obscuration", "several lights", "batch")))
    assert [cell.state for cell in cells] == ["runs"] * 6, [cell.why for cell in cells]


def test_the_command_prints_the_matrix(capsys, tmp_path):
    file = tmp_path / "cells.json"
    words = "verify --combinations --device numpy --feature stacked --feature quad-Bayer"
    assert main([*words.split(), "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "stacked x quad-Bayer: physics: stacked pixels see all channels" in out
    assert "1 pairs; p excluded by physics: 1" in out
    assert "3 passed, 0 failed" in out
    assert '"state": "physics"' in file.read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--combinations --hard", "--hard: --combinations makes frames"),
        ("--combinations --stage sensor.noise", "--stage: --combinations makes frames"),
        ("--combinations --feature blade", "did you mean 'blades'"),
        ("--combinations --tolerance much", "unknown tolerance"),
        ("--feature blades", "--feature: only --combinations uses it"),
        ("--tolerance video", "--tolerance: only --combinations uses it"),
    ],
)
def test_wrong_options_are_refused_in_one_line(words, message, capsys):
    assert main(["verify", "--device", "numpy", *words.split()]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def block():
    """Rows of the matrix in docs/limits.md, and the lines after it."""
    sys.path.insert(0, str(DOCS))
    try:
        import combinations as page
    finally:
        sys.path.remove(str(DOCS))
    text = page.PAGE.read_text().partition(page.FIRST)[2].partition(page.LAST)[0]
    lines = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line] for line in lines]
    return page, rows[2:], [line for line in text.splitlines() if line.startswith("- ")]


def test_the_page_has_every_feature_and_reason():
    _, rows, lines = block()
    assert [row[0] for row in rows] == NAMES
    marks = {*matrix.MARKS.values(), ""}
    assert all(len(row) == 31 and set(row[2:]) <= marks for row in rows)
    for feature in FEATURES:
        for other, reason in feature.excludes.items():
            assert any(reason in line and other in line for line in lines)


def test_the_page_is_filled_from_cells():
    page, _, _ = block()
    cells = [matrix.Cell("blades", "batch", "no way", "not yet")]
    text = page.filled(f"before\n{page.FIRST}\nold\n{page.LAST}\nafter", cells)
    assert text.startswith("before\n")
    assert text.endswith("after")
    assert "old" not in text
    assert "1 pairs: - no way in the API (1)." in text
    assert "- no way in the API: blades x batch: not yet" in text
