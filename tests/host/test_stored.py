"""Arrays on disk: found by a second process, harmless if damaged or not writable, bounded, and turned off."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from gpusim.domain import stored as module
from gpusim.domain.pupil import Pupil
from gpusim.domain.stored import stored

CALLS = []


@stored
def slow(pupil, values, factor):
    CALLS.append(factor)
    time.sleep(2 * module.SLOW)
    return values * factor, pupil.obscuration, len(values)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder for stored arrays; no call was counted."""
    monkeypatch.setenv("GPUSIM_TABLES", str(tmp_path / "tables"))
    monkeypatch.setattr(module, "_held", {})
    CALLS.clear()
    return tmp_path / "tables"


def call(factor=2.0, obscuration=0.25):
    array, hole, count = slow(Pupil(0, obscuration), np.arange(5.0), factor)
    assert array.dtype == np.float64
    assert np.array_equal(array, np.arange(5.0) * factor)
    assert (type(hole), hole, type(count), count) == (float, obscuration, int, 5)


def test_a_result_is_found_by_its_constants(folder):
    call()
    call()
    assert CALLS == [2.0]
    call(3.0)
    call(2.0, 0.5)
    assert CALLS == [2.0, 3.0, 2.0]
    assert len(list(folder.iterdir())) == 3


@pytest.mark.parametrize(
    "damage",
    [lambda data: b"", lambda data: data[:-9], lambda data: data[:60] + b"x" + data[61:]],
)
def test_a_damaged_file_is_computed_again(folder, damage):
    call()
    (path,) = folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    call()
    call()
    assert CALLS == [2.0, 2.0]


def test_folders_that_cannot_be_written_do_no_harm(folder, monkeypatch):
    folder.write_text("a file in the place of the folder")
    call()
    call()
    assert CALLS == [2.0, 2.0]
    monkeypatch.setenv("GPUSIM_TABLES", "/proc/none")
    call()
    assert CALLS == [2.0, 2.0, 2.0]


def test_nothing_is_kept_if_it_is_turned_off(folder, monkeypatch):
    monkeypatch.setenv("GPUSIM_TABLES", "")
    call()
    call()
    assert CALLS == [2.0, 2.0]
    assert not folder.exists()


def test_the_oldest_files_go(folder, monkeypatch):
    call(1.0)
    size = next(folder.iterdir()).stat().st_size
    monkeypatch.setattr(module, "MOST", 5 * size)
    for factor in range(2, 12):
        call(float(factor))
        assert sum(path.stat().st_size for path in folder.iterdir()) <= 5 * size
    CALLS.clear()
    call(11.0)
    call(1.0)
    assert CALLS == [1.0]


LENS = """
import numpy as np
import gpusim as gs
from gpusim.optics.lenses import open_lens
camera = gs.open_camera("phone").with_(zernike_waves=(0, 0, 0, 0.3, 0.1, 0.1, 0.1))
lens = open_lens(camera.optics, 1e-6)
kernels = lens.kernels(np.linspace(400, 700, 7), (0.3, 0.2), 101)
from gpusim.optics.rays import polar_table
table = polar_table(camera.optics.pupil, lens.waves(np.linspace(400, 700, 7)))[0]
import hashlib
print(hashlib.sha256(kernels.tobytes() + table.tobytes()).hexdigest())
"""


def test_a_second_process_finds_the_tables_of_a_lens(tmp_path):
    folder = tmp_path / "tables"
    said = []
    for named in (str(folder), str(folder), ""):
        environment = os.environ | {"GPUSIM_TABLES": named}
        run = subprocess.run(
            [sys.executable, "-c", LENS],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        said.append(
            (run.stdout, sorted((one.name, one.stat().st_size) for one in folder.iterdir()))
        )
    assert said[0] == said[1] == said[2]
    assert len(said[0][1]) == 2
