"""Blocks of the README and of the documentation run as they are pasted.

Every Python block runs by itself. So do the commands of the README and of the pages for beginners. The reader's own
files are there: photographs, a scene with depth, a picture and a depth map of Blender, a panorama.
"""

import re
import shlex
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import gpusim as gs

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = {
    f"{page.stem}-{number}": block
    for page in PAGES
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S)
    )
}
# pages whose commands run; not `gpusim preview`, a server, and `gpusim video`, here of 300 frames: other tests run both
FIRST = ["README", "start", "design", "train", "render", "report"]
LINE = re.compile(r"^(?:pip install \. && )?(gpusim (?:simulate|plan|look|pairs) .*)$", re.M)
QUOTED = re.compile(r"`(gpusim simulate [^`]* -o [^`]*)`")
COMMANDS = [
    f"{page.stem}: {found}"
    for page in PAGES
    if page.stem in FIRST
    for pattern in (LINE, QUOTED)
    for found in pattern.findall(page.read_text())
]
NEEDS = {"mitsuba": "mitsuba", "h5py": "h5py", "gs.preview": "anywidget"}  # word -> package


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that blocks read."""
    import OpenEXR
    from PIL import Image
    from skimage import data

    folder = tmp_path_factory.mktemp("files")
    (folder / "photos").mkdir()
    scene = gs.scene_from(data.astronaut()[:64, 200:296])
    depth = np.where(np.arange(96) < 48, 0.7, 2.0) * np.ones((64, 1))
    gs.save_scene(replace(scene, depth=depth.astype(np.float32)), folder / "balls.npz")
    for name in ("photo.png", "photo.jpg"):
        Image.fromarray(data.astronaut()[:64, 200:296]).save(folder / name)
    for number in range(2):
        photo = Image.fromarray(data.astronaut()[60 * number : 60 * number + 64, 200:296])
        photo.save(folder / "photos" / f"{number}.png")
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    light = np.random.default_rng(1).random((3, 48, 96), np.float32)
    rgb = dict(zip("RGB", light, strict=True))
    for name in ("image0001", "studio"):
        OpenEXR.File(kind, rgb).write(str(folder / f"{name}.exr"))
    depth = np.full((48, 96), 2.0, np.float32)
    OpenEXR.File(kind, {"V": depth}).write(str(folder / "depth0001.exr"))
    return folder


def test_there_are_blocks_and_all_import_gpusim():
    """A block that is pasted alone knows only its own imports."""
    assert len(BLOCKS) >= 15
    assert [
        name
        for name, block in BLOCKS.items()
        if re.search(r"\bgs\.", block) and not re.search(r"^import gpusim as gs$", block, re.M)
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_runs_as_pasted(name, files, tmp_path):
    for word, package in NEEDS.items():
        if word in BLOCKS[name] and find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)
    command = [sys.executable, "-P", "-W", "ignore", "-c", BLOCKS[name]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_runs_as_pasted(command, files, tmp_path):
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)
    _, _, words = command.partition(": gpusim ")
    run = [sys.executable, "-P", "-m", "gpusim", *shlex.split(words)]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    for name in map(Path, re.findall(r"(?:-o|--report) (\S+)", words)):
        assert list(tmp_path.glob(f"{name.stem}*{name.suffix}")), name
