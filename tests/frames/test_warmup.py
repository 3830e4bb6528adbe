"""`gpusim warmup` on devices that compile: later frames of these kinds build no program."""

import subprocess
import sys

import pytest

from gpusim.apps import warmup
from gpusim.cli.main import main

# None cannot be called: a build from text would fail
AGAIN = """
from gpusim.apps import warmup
from gpusim.backends import caches
caches.prepare_build = None
warmup._compute("opencl:pocl", "mono", "video", "chart")
"""


def test_a_camera_that_cannot_be_used_is_named(capsys):
    assert main(["warmup", "--device", "numpy", "--camera", "none"]) == 2
    assert main(["warmup", "--device", "numpy", "--tolerance", "none"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_a_frame_that_fails_is_said(monkeypatch, capsys):
    kinds = [warmup.Warmed("chart by mono, exact", 1.0, ""), warmup.Warmed("cube", 1.0, "no")]
    monkeypatch.setattr(warmup, "SCENES", ("chart", "cube"))
    monkeypatch.setattr(warmup, "warm_up", lambda *_: iter(kinds))
    command = ["warmup", "--device", "numpy", "--camera", "mono", "--tolerance", "exact"]
    assert main(command) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["chart by mono, exact: 1.0 s", "cube: no"]
    assert lines[2].startswith("1 of 2 kinds of frames on numpy: ")


@pytest.mark.parametrize(
    "scene", [*warmup.SCENES[:-1], pytest.param(warmup.SCENES[-1], marks=pytest.mark.slow)]
)
def test_processes_compute_each_scene(scene, monkeypatch):
    monkeypatch.setattr(warmup, "COLS", 48)
    monkeypatch.setattr(warmup, "ROWS", 32)
    warmup._compute("numpy", "mono", "video", scene)


def test_a_process_that_fails_says_why():
    (found,) = warmup.warm_up("numpy", ["no such camera"], ["video"], ["chart"])
    assert "no such camera" in found.error and "\n" not in found.error
    assert found.words == "chart by no such camera, video"


@pytest.mark.slow
def test_frames_after_it_build_no_program(tmp_path, monkeypatch):
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    (found,) = warmup.warm_up("opencl:pocl", ["mono"], ["video"], ["chart"])
    assert found.error == ""
    command = [sys.executable, "-W", "ignore", "-c", AGAIN]
    end = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (end.returncode, end.stderr) == (0, "")
