"""Every example of the gallery runs by itself, saves its figures, warns of nothing and takes 30 s of two cores."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "docs" / "examples").glob("*.py"))
CORES, SECONDS = 2, 30


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, tmp_path):
    """Processor time, which other work on the machine does not change."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [
            sys.executable,
            "-W",
            "error::RuntimeWarning",
            "-W",
            "error::DeprecationWarning:__main__",
            str(path),
        ],
        env=os.environ | {"MPLBACKEND": "agg"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (
        sum(getattr(after, key) - getattr(before, key) for key in ("ru_utime", "ru_stime"))
        <= CORES * SECONDS
    )
    saved = sorted(file.name for file in tmp_path.iterdir())
    assert saved and saved == sorted(f"{path.stem}_{n + 1}.png" for n in range(len(saved)))


def test_every_example_has_its_place_in_the_gallery():
    order = (
        (Path(__file__).parents[2] / "docs" / "conf.py").read_text().partition("class InTurn")[2]
    )
    assert [path.stem for path in EXAMPLES if f'"{path.stem}"' not in order] == []
