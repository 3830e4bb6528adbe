"""`gpusim look`: every panel in a file, and what is refused."""

import numpy as np
import pytest

from gpusim.cli import main
from gpusim.look import PANELS

pytest.importorskip("matplotlib", reason="plots are of matplotlib")

FEWER = {"psf": ["--of", "550,650"], "mtf": ["--of", "550,600"], "spectra": ["--at", "30,30", "--at", "3,4,20,50"]}


@pytest.mark.parametrize("what", PANELS)
def test_look_writes_a_picture(what, tmp_path):
    from PIL import Image

    scene = "slanted-edge" if what == "sfr" else "colorchecker"
    out = tmp_path / "a.png"
    assert main(["look", scene, "--what", what, "--size", "72x60", "--border", "reflect", "--device", "numpy",
                 *FEWER.get(what, []), "-o", str(out)]) == 0
    codes = np.asarray(Image.open(out).convert("RGB"))
    assert min(codes.shape[:2]) > 150 and codes.std() > 10 and list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("arguments, words", [
    (["--what", "raw"], "no window can be opened here; wanted a file, such as -o look.png"),
    (["-o", "a.bmp"], "a picture of a plot has the suffix .png, .pdf, .svg, .jpg"),
    (["--what", "mtf", "--of", "550,X", "-o", "a.png"], "unknown channel 'X'"),
    (["--what", "spectra", "--at", "480,3", "-o", "a.png"], "at = (480, 3): allowed is columns 0 .. 479"),
    (["nothing", "-o", "a.png"], "nothing"),
])
def test_look_refuses_in_one_line(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["look", *arguments, "--device", "numpy"]) == 2
    told = capsys.readouterr().err
    assert words in told and told.count("\n") == 1 and not list(tmp_path.iterdir())
