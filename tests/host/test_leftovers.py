"""Temporary files of processes that were killed: the next run removes them, and none of a process that lives."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gpusim.apps.video.manifest import keep_manifest
from gpusim.domain import leftovers
from gpusim.domain.leftovers import remove_leftovers, temporary_name
from gpusim.io.atomic import atomic_path, check_output
from gpusim.io.scene.readers import scene_files

WRITER = """
import sys
from gpusim.io.atomic import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("all of it")
    print(temporary.name, flush=True)
    sys.stdin.readline()
"""


def writer(path):
    """A process that waits while its file is half written, and the file's temporary name."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    return process, process.stdout.readline().strip()


def write(folder):
    leftovers.remove_leftovers_once.cache_clear()  # as another process does
    with atomic_path(folder / "b.txt") as temporary:
        temporary.write_text("b")


def begin_a_set(folder):
    with keep_manifest(folder / "set.json", {}, "it", lambda: False):
        pass


@pytest.mark.skipif(os.name != "posix", reason="nobody can tell there")
@pytest.mark.parametrize("run", [write, begin_a_set, lambda folder: check_output(folder / "c.txt")])
@pytest.mark.parametrize(
    "is_reaped", [True, False]
)  # a process that ended, and one whose parent did not ask for it
def test_what_a_killed_process_left_is_removed_and_nothing_of_one_that_lives(
    run, is_reaped, tmp_path
):
    killed, left = writer(tmp_path / "one.tar")
    living, written = writer(tmp_path / "two.tar")
    killed.kill()
    if is_reaped:
        killed.wait()
    else:
        os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
    assert {left, written} <= set(os.listdir(tmp_path)) and left.endswith(".tar")
    run(tmp_path)
    assert {name for name in os.listdir(tmp_path) if name.startswith(".")} == {written}
    living.communicate("\n")
    killed.communicate()
    assert (tmp_path / "two.tar").read_text() == "all of it"
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def changed(**parts):
    """Name of a temporary file of this process with other parts."""
    name = temporary_name(".npz")
    found = re.fullmatch(
        r"\.gpusim-(?P<host>.*?)-(?P<boot>.*?)-(?P<pid>.*?)-(?P<start>.*?)-(?P<last>.*)", name
    )
    return ".gpusim-" + "-".join({**found.groupdict(), **parts}.values())


@pytest.mark.skipif(sys.platform != "linux", reason="starts and boots are known there")
def test_a_writer_is_known_by_its_host_its_boot_its_number_and_its_start(tmp_path):
    free = next(pid for pid in range(4_000_000, 1, -1) if not Path(f"/proc/{pid}").exists())
    before_boot = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) - 60
    names = {  # name -> when it was written, and whether it goes
        changed(): (None, False),
        changed(start="7"): (None, True),
        changed(pid=str(free)): (None, True),
        changed(pid="1"): (None, True),  # which is there, and started at another time
        changed(host="0" * 8, start="7"): (None, False),
        changed(host="0" * 8, boot="0" * 8): (before_boot, False),
        changed(boot="0" * 8): (before_boot, True),
        changed(boot="0" * 8, last="0" * 8): (None, False),  # of a copy of this host
        ".gpusim-12345678.tar": (before_boot, False),
        ".gpusim-notes": (before_boot, False),
    }
    for name, (when, _) in names.items():
        (tmp_path / name).touch()
        if when:
            os.utime(tmp_path / name, (when, when))
    (tmp_path / changed(pid=str(free), last="1" * 8) / "inner").mkdir(parents=True)
    remove_leftovers(tmp_path)
    assert set(os.listdir(tmp_path)) == {name for name, (_, goes) in names.items() if not goes}
    remove_leftovers(tmp_path / "no such folder")


def test_a_process_that_nobody_may_signal_is_alive(tmp_path, monkeypatch):
    def refuse(pid, number):
        raise PermissionError

    (tmp_path / changed(pid="1", start="")).touch()
    monkeypatch.setattr(os, "kill", refuse)
    monkeypatch.setattr(
        leftovers, "_read", lambda path: ""
    )  # as if the system said nothing of processes
    leftovers._place.cache_clear()
    (tmp_path / changed(pid="1", start="")).touch()
    remove_leftovers(tmp_path)
    leftovers._place.cache_clear()
    assert len(os.listdir(tmp_path)) == 2


def test_temporary_and_hidden_files_are_no_scenes(tmp_path):
    for name in ("b.png", "a_2.PNG", temporary_name(".png"), "._b.png", "c.txt"):
        (tmp_path / name).touch()
    (tmp_path / "d.png").mkdir()
    assert [path.name for path in scene_files(tmp_path)] == ["a_2.PNG", "b.png"]


@pytest.mark.skipif(os.name != "posix", reason="there is no SIGKILL")
def test_a_folder_lent_to_a_killed_process_is_removed(tmp_path):
    code = (
        "import os, signal; from gpusim.backends.caches import lent_folder; print(lent_folder(), flush=True)\n"
        "if {}: os.kill(os.getpid(), signal.SIGKILL)"
    )
    there = []
    for is_killed in (True, False):
        done = subprocess.run(
            [sys.executable, "-c", code.format(is_killed)],
            capture_output=True,
            text=True,
            env=os.environ | {"TMPDIR": str(tmp_path)},
        )
        assert done.returncode == (-signal.SIGKILL if is_killed else 0), done.stderr
        there.append(os.listdir(tmp_path))
    assert (
        len(there[0]) == 1
        and Path(tmp_path, there[0][0]).name.startswith(".gpusim-")
        and there[1] == []
    )
