"""CONTRIBUTING.md names files that exist, and a reader that is added as it says works."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from gpusim.io.scene.readers import READERS

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
FILE = re.compile(r"`((?:[\w.-]+/)*[\w.-]+\.(?:py|md|yml|cl|toml)|(?:[\w.-]+/)+(?:run\w*)?)`")
EXAMPLE = "kernels/sensor/crosstalk"  # files that are yet to be added
NEW = {"gpusim/io/scene/NAME.py", "gpusim/planner/knobs/NAME.py"}

READER = '''"""Grey scenes as text, .grey: reflectances that are the same at all wavelengths."""

import numpy as np

from gpusim.io.files import reading


def read_grey(path):
    """Return reflectances (rows, cols). Raises BadFile."""
    with reading(path, "a table of numbers"):
        return np.loadtxt(path, np.float32, ndmin=2)
'''
ENTRY = """def _grey(path, white):
    values = read_grey(path)
    return scene_of_planes(path, white, np.array([400.0, 700.0]), np.stack([values, values]), KINDS[0])


CHARTS_TAKE ="""
USE = """
from pathlib import Path
import numpy as np
import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import GpusimError
from gpusim.io.scene.readers import scene_files

Path("a.grey").write_text("0.2 0.4 0.6\\n0.8 0.1 0.3\\n")
Path("bad.grey").write_text("0.2 x\\n")
scene = gs.open_scene("a.grey")
assert scene.shape == (2, 3) and scene.content.values[1, 1, 0] == np.float32(0.8)
for name, options in (("bad.grey", {}), ("a.grey", {"scale": 2.0}), ("a.unknown", {})):
    try:
        gs.open_scene(name, **options)
    except GpusimError as error:
        print(error)
assert [path.name for path in scene_files(Path("."))] == ["a.grey", "bad.grey"]
assert main(["simulate", "a.grey", "--camera", "mono", "--device", "numpy", "-o", "a.png"]) == 0
"""


def test_the_files_that_it_names_exist():
    names = {name for name in FILE.findall(TEXT) if not name.startswith(EXAMPLE)} - NEW
    assert len(names) > 15
    assert [name for name in sorted(names) if not (ROOT / name).exists()] == []


def kinds():
    """Suffixes of every kind of scene file, those of one reader together."""
    found = {}
    for suffix, reader in READERS.items():
        found.setdefault(reader, []).append(suffix)
    return [" ".join(suffixes) for suffixes in found.values()]


@pytest.mark.parametrize("suffixes", kinds())
def test_every_kind_of_file_is_in_the_help_and_in_the_documentation(suffixes):
    for file in ("gpusim/cli/options.py", "docs/files.md"):
        words = set(re.findall(r"\.\w+", (ROOT / file).read_text()))
        assert words & set(suffixes.split()), f"{file} does not name {suffixes}"


def test_a_reader_is_one_file_and_one_entry(tmp_path):
    tree = tmp_path / "tree"
    for folder in ("gpusim", "kernels"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, tree / folder, ignore=ignored)
    (tree / "gpusim/io/scene/grey.py").write_text(READER)
    readers = tree / "gpusim/io/scene/readers.py"
    text = readers.read_text()
    for old, new in (
        (
            "from gpusim.io.scene.iset",
            "from gpusim.io.scene.grey import read_grey\nfrom gpusim.io.scene.iset",
        ),
        ("CHARTS_TAKE =", ENTRY),
        ("READERS = {\n", 'READERS = {\n    ".grey": Reader(_grey),\n'),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    readers.write_text(text)
    code = f"import sys; sys.path.insert(0, {str(tree)!r})\n" + USE
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    damaged, refused, unknown, *_ = done.stdout.splitlines()
    assert damaged.startswith("bad.grey: ")
    assert refused.startswith("scale = 2.0: allowed is for ") and "a.grey" in refused
    assert ".grey" in unknown


def test_every_dependency_has_a_lowest_version():
    """`.ci/run_lowest` installs these; tools for tests, documentation and benchmarks may float."""
    extras = (ROOT / ".ci/run_lowest").read_text().partition("lowest.py ")[2].partition(" >")[0]
    command = [sys.executable, str(ROOT / ".ci/lowest.py"), *extras.split()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    lowest = {line.partition("==")[0].lower() for line in done.stdout.splitlines()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    wanted = project["dependencies"] + [one for name in extras.split() for one in optional[name]]
    assert {re.match(r"[\w.-]+", one)[0].lower() for one in wanted} == lowest
    assert set(optional) - set(extras.split()) <= {
        "test",
        "browser",
        "docs",
        "bench",
        "ray",
        "optiland",
    }
