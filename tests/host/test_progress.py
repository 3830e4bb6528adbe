"""The channel of long work, and its line on a terminal."""

import io
import sys
import time

import pytest

import gpusim as gs
from gpusim.cli import progress
from gpusim.cli.main import main
from gpusim.domain.progress import announce_each, announced, listening


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_listeners_hear_of_work_that_fails_too():
    heard, other = [], []
    with listening(heard.append), pytest.raises(ValueError, match="no"):
        with listening(other.append), announced("compiling one"):
            pass
        with announced("compiling two"):
            raise ValueError("no")
    with announced("compiling three"):
        pass
    assert heard == ["compiling one", None, "compiling two", None]
    assert other == ["compiling one", None]


def test_work_inside_other_work_gives_way_to_it():
    heard = []
    with listening(heard.append), announced("planning"), announced("compiling"):
        pass
    assert heard == ["planning", "compiling", "planning", None]


def test_each_item_is_announced_while_it_is_made():
    heard = []

    def items():
        for number in range(2):
            heard.append(f"making {number}")
            yield number

    with listening(heard.append):
        assert list(announce_each(items(), "{} done".format)) == [0, 1]
    assert heard == ["0 done", "making 0", None, "1 done", "making 1", None, "2 done", None]


def test_the_reference_and_the_cases_of_verify_are_announced(capsys):
    heard = []
    simulate = gs.Simulator(gs.open_camera("phone"), device="numpy")
    with listening(heard.append):
        simulate(gs.chart("flat", size=(6, 4)), verify=True)
        assert main(["verify", "--stage", "display.encode", "--device", "numpy"]) == 0
    capsys.readouterr()
    assert "computing the float64 reference" in heard and "verifying, 1 cases done" in heard


def test_long_work_has_a_line_that_goes(monkeypatch):
    monkeypatch.setattr(progress, "WAIT", 0.01)
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress.showing_progress():
        with announced("compiling"):
            while "compiling" not in sys.stderr.getvalue():
                time.sleep(0.01)
        shown = sys.stderr.getvalue()
        print("a result")
    assert shown.startswith("\rcompiling (0 s in all)\x1b[K") and shown.endswith("\r\x1b[K")
    assert sys.stderr.getvalue() == shown


def test_short_work_and_other_outputs_have_none(monkeypatch):
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress.showing_progress(), announced("compiling"):
            pass
        assert stream.getvalue() == ""
