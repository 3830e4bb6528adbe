"""`gpusim look`: every panel in a file, and what is refused; what windows and notebooks show of objects."""

import io
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import gpusim as gs
from gpusim.cli.look import PANELS
from gpusim.cli.main import main
from gpusim.domain.errors import BadData

FEWER = {
    "psf": ["--of", "550,650"],
    "mtf": ["--of", "550,600"],
    "spectra": ["--at", "30,30", "--at", "3,4,20,50"],
}

SCENELESS = {"psf", "mtf", "camera", "snr", "ptc"}  # panels of a camera
HOSTED = {"scene", "spectra", "psf", "mtf", "camera", "snr", "locus"}  # without a device


@pytest.mark.parametrize(
    ("what", "options"),
    [
        ("mtf", ["--strict"]),
        ("mtf", ["--border", "zero"]),
        ("psf", ["--luminance", "5"]),
        ("scene", ["--tolerance", "video"]),
        ("spectra", ["--strict"]),
        ("spectra", ["--of", "550"]),
        ("camera", ["--size", "20x20"]),
    ],
)
def test_an_option_that_a_panel_does_not_use_is_refused(what, options, tmp_path, capsys):
    out = tmp_path / "a.png"
    scene = ["colorchecker", "--size", "40x30"] if what in ("scene", "spectra") else []
    assert main(["look", *scene, "--what", what, *options, "-o", str(out)]) == 2
    assert capsys.readouterr().err == (
        f"gpusim: {options[0]}: look --what {what} does not use it; leave it out\n"
    )
    assert not out.exists()


@pytest.mark.parametrize("what", PANELS)
def test_look_writes_a_picture(what, tmp_path):
    from PIL import Image

    scene = "slanted-edge" if what == "sfr" else "colorchecker"
    out = tmp_path / "a.png"
    options = [scene, "--size", "72x60"] if what not in SCENELESS else []
    options += ["--border", "reflect"] if what not in SCENELESS | {"scene", "spectra"} else []
    options += ["--device", "numpy"] if what not in HOSTED else []
    asked = ["look", *options, "--what", what, *FEWER.get(what, []), "-o", str(out)]
    assert main(asked) == 0
    codes = np.asarray(Image.open(out).convert("RGB"))
    assert min(codes.shape[:2]) > 150 and codes.std() > 10 and list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--what", "raw"], "no window can be opened here; wanted a file, such as -o look.png"),
        (["-o", "a.bmp"], "a picture of a plot has the suffix .png, .pdf, .svg, .jpg"),
        (["--what", "mtf", "--of", "550,X", "-o", "a.png"], "unknown channel 'X'"),
        (
            ["--what", "spectra", "--at", "480,3", "-o", "a.png"],
            "at = (480, 3): allowed is columns 0 .. 479",
        ),
        (["nothing", "-o", "a.png"], "nothing"),
        (
            ["colorchecker", "--what", "mtf", "-o", "a.png"],
            "SCENE: look --what mtf does not use it",
        ),
    ],
)
def test_look_refuses_in_one_line(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["look", *arguments]) == 2
    told = capsys.readouterr().err
    assert words in told and told.count("\n") == 1 and not list(tmp_path.iterdir())


# --------------------------------------------------------------------------------------------- windows and notebooks


class Cells(HTMLParser):
    """Texts of a table's cells, and whether every tag is closed in turn."""

    def __init__(self, text):
        super().__init__()
        self.open, self.texts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def frame():
    return gs.Simulator(gs.open_camera("phone"), device="numpy")(
        gs.chart("colorchecker", size=(96, 64))
    )


def read(png):
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_notebooks_show_pictures(frame):
    """As IPython asks for them; small ones enlarged by whole numbers, large ones by few of their samples."""
    from IPython.core import formatters

    png = formatters.PNGFormatter()
    np.testing.assert_array_equal(read(png(frame))[1::3, 1::3], frame.rgb)
    scene = gs.chart("colorchecker", size=(300, 200), samples_per_pixel=2)
    codes = gs.plot.scene(scene).images[0].get_array()
    np.testing.assert_allclose(read(png(scene)), 255 * codes, atol=0.51)
    large = read(png(gs.chart("colorchecker", size=(2100, 1400))))
    assert (
        max(large.shape) <= 1050
        and np.abs(np.median(large[:9, :9], axis=(0, 1)) - 255 * codes[0, 0]).max() <= 1
    )
    unseen = gs.scene_from(np.ones((2, 8, 8)), [900.0, 950.0], light="blackbody-3000K")
    assert png(unseen) is None


def test_notebooks_show_tables(frame):
    from IPython.core.formatters import HTMLFormatter

    html = HTMLFormatter()
    camera = Cells(html(replace(frame.camera, name="<b>mine")))
    assert not camera.open and camera.texts[0] == "Camera <b>mine"
    assert (
        any(text.startswith("f/1.8, 4.44 mm") for text in camera.texts)
        and "automatic" in camera.texts
    )
    report = Cells(html(frame.report))
    assert not report.open and {stage.stage for stage in frame.report.stages} < {*report.texts}
    assert f"{frame.report.account.total.rms:.2g} rms" in report.texts


def test_show_opens_a_window(frame, monkeypatch):
    from matplotlib import pyplot

    monkeypatch.setattr("gpusim.plot.canvas.WITHOUT_WINDOW", ())
    opened = []
    monkeypatch.setattr(pyplot, "show", lambda: opened.append(pyplot.gcf()))
    scene = gs.chart("flat", size=(24, 16))
    shown = [one.show() for one in (frame, scene, frame.report)]
    assert opened == shown and [len(figure.axes) for figure in shown] == [1, 2, 2]
    pyplot.close("all")


def test_show_without_a_window_says_so(frame):
    import matplotlib

    matplotlib.use("agg")
    with pytest.raises(
        BadData, match=r"Frame.show\(\): no window can be opened here; wanted gs.plot"
    ):
        frame.show()
