"""The preview's widget in JupyterLab, in a browser: what a user of a notebook sees and does."""

import importlib.util
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from browsers import browser, free_port, running
from PIL import Image

import gpusim as gs
from gpusim.apps.preview.controls import CONTROLS

pytestmark = pytest.mark.slow
SCENE = gs.chart("colorchecker", size=(240, 160))
CELL = """\
import gpusim as gs
widget = gs.preview(gs.chart("colorchecker", size=(240, 160)), "phone", device="opencl")
widget"""
LAB = (
    "--no-browser --allow-root --IdentityProvider.token= "
    "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate --LabApp.news_url=None"
)
PICTURE = "img.widget-image"
ELEMENT = f"document.querySelector('{PICTURE}')"
# pixels of the picture, as the browser has decoded them
PIXELS = f"""() => {{
  const picture = {ELEMENT}, canvas = document.createElement("canvas");
  canvas.width = picture.naturalWidth; canvas.height = picture.naturalHeight;
  if (!canvas.width) return null;  // the next picture is being decoded
  const context = canvas.getContext("2d");
  context.drawImage(picture, 0, 0);
  return [canvas.height, [...context.getImageData(0, 0, canvas.width, canvas.height).data]];
}}"""
F_NUMBER = "optics.f_number"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The folder and the page of a notebook, whose cell with the widget has run."""
    for name in ("jupyterlab", "ipywidgets", "nbformat"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed; wanted: pip install -e '.[test,browser]'")
    import nbformat

    folder, own = tmp_path_factory.mktemp("notebooks"), tmp_path_factory.mktemp("jupyter")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3"}
    nbformat.write(notebook, folder / "preview.ipynb")
    port = free_port()
    command = [sys.executable, "-m", "jupyterlab", *LAB.split(), f"--ServerApp.port={port}"]
    places = {f"JUPYTER_{name}_DIR": str(own) for name in ("CONFIG", "DATA", "RUNTIME")}
    address, log = f"http://127.0.0.1:{port}", own / "server.log"
    with (
        browser() as chromium,
        log.open("w") as output,
        running(command, f"{address}/api", cwd=folder, env=os.environ | places, stdout=output),
    ):
        page = chromium.new_page(viewport={"width": 1280, "height": 1150})
        page.set_default_timeout(60000)
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on(
            "console",
            lambda line: errors.append(line.text) if line.type in ("error", "warning") else None,
        )
        page.goto(f"{address}/lab/tree/preview.ipynb")
        # a cell that is run before there is a kernel is not run, without a word
        page.get_by_text("(ipykernel) | Idle").wait_for()
        page.locator(".jp-CodeCell .cm-content").click()
        start = time.monotonic()
        page.keyboard.press("Shift+Enter")
        page.locator(PICTURE).wait_for()
        page.wait_for_function(f"{ELEMENT}.naturalWidth > 0")
        print(f"first picture {time.monotonic() - start:.1f} s after the cell was run")
        yield SimpleNamespace(page=page, folder=folder, errors=errors, log=log)


@pytest.fixture(autouse=True)
def quiet(lab):
    """Nothing that a test does may leave an error in the browser, the notebook or the server's log."""
    yield
    assert not lab.errors
    assert not lab.page.locator('[data-mime-type="application/vnd.jupyter.stderr"]').count()
    assert not lab.page.locator('[data-mime-type="application/vnd.jupyter.error"]').count()
    assert "Traceback" not in lab.log.read_text()


def ask(page, code):
    """Text that a new cell prints."""
    cells = page.locator(".jp-CodeCell")
    asked = cells.nth(cells.count() - 1)
    asked.locator(".cm-content").click()
    page.keyboard.insert_text(f"print('said', {code})")
    page.keyboard.press("Shift+Enter")
    said = asked.locator(".jp-OutputArea-output")
    said.wait_for()
    return said.inner_text().strip().removeprefix("said ")


def frame(**changes):
    """The frame of the camera with some keys changed, made without the widget."""
    camera = gs.open_camera("phone").with_(**changes)
    return gs.Simulator(camera, device="opencl", tolerance="1e-3")(SCENE)


def shown(page):
    """Pixels of the picture on the page, (rows, cols, 3)."""
    rows, pixels = page.wait_for_function(PIXELS).json_value()
    return np.array(pixels, np.uint8).reshape(rows, -1, 4)[..., :3]


def wait_for(page, wanted):
    """Wait until the picture on the page has these pixels."""
    end = time.monotonic() + 60
    while not np.array_equal(shown(page), wanted):
        assert time.monotonic() < end
        page.wait_for_timeout(100)


def row_of(page, label, section=None):
    """The row of fields with a label, in a section of controls that is opened if it is not."""
    row = page.locator(".widget-hbox").filter(has=page.get_by_text(label, exact=True)).last
    if section and not row.is_visible():
        page.locator(".jupyter-widget-Collapse-header").get_by_text(section, exact=True).click()
    return row


def undo(page):
    page.locator(".fa-undo").click()


def test_the_first_picture(lab):
    """It has the frame's own pixels, and to be shown has changed no setting."""
    wanted = frame().rgb
    assert wanted.std() > 20  # of 255: no uniform picture
    wait_for(lab.page, wanted)
    assert ask(lab.page, "widget.state.changes, widget.state.is_live") == "{} False"


def test_a_slider_is_moved_by_keys(lab):
    page, control = lab.page, CONTROLS[F_NUMBER]
    handle = row_of(page, "f-number", "Lens").locator(".noUi-handle")
    for _ in range(25):
        handle.press("ArrowRight")
    place = control.to_place(gs.open_camera("phone").optics.f_number) + 25
    number = control.to_value(place)
    wait_for(page, frame(**{F_NUMBER: number}).rgb)
    assert ask(page, "widget.state.changes, widget.camera.optics.f_number") == (
        f"{{'{F_NUMBER}': {number}}} {number}"
    )
    assert float(row_of(page, "f-number").locator("input").input_value()) == number
    undo(page)
    wait_for(page, frame().rgb)


def test_a_number_is_typed(lab):
    """One that cannot be is refused in a line, and the last picture stays."""
    page = lab.page
    field = row_of(page, "gain", "Exposure").locator("input")
    field.fill("2.5")
    field.press("Enter")
    bright = frame(**{"sensor.analog_gain": 2.5}).rgb
    wait_for(page, bright)
    field.fill("-1")
    field.press("Enter")
    page.get_by_text("gain = -1.0: allowed is").wait_for()
    assert np.array_equal(shown(page), bright)
    undo(page)
    undo(page)
    wait_for(page, frame().rgb)


def test_noise_is_live(lab):
    page, seen = lab.page, []
    live = page.get_by_role("button", name="live noise")
    live.click()
    end = time.monotonic() + 60
    while len(seen) < 5:
        assert time.monotonic() < end
        picture = shown(page)
        if not any(np.array_equal(picture, other) for other in seen):
            seen.append(picture)
    live.click()
    wait_for(page, frame().rgb)


def test_a_pixel_is_read_out(lab):
    page, made = lab.page, frame()
    letter = made.camera.sensor.cfa[40 % 2][17 % 2]
    for name, place in (("row", 40), ("column", 17)):
        field = row_of(page, "row").locator(".widget-text").filter(has_text=name).locator("input")
        field.fill(str(place))
        field.press("Enter")
    page.get_by_text(f"row 40 column 17 {letter} {made.mean[40, 17]:.4g} e-").wait_for()


def test_a_panel_is_opened(lab):
    """Those of the page are there; one that is opened shows the noise of the camera that is set."""
    page = lab.page
    page.get_by_role("button", name="Noise budget").click()
    panel = page.locator(".widget-vbox").filter(has=page.locator("b", has_text="Noise budget")).last
    panel.locator("svg").first.wait_for()
    before = panel.inner_html()
    spectrum = page.locator(".widget-vbox").filter(has=page.locator("b", has_text="Spectrum")).last
    spectrum.locator("select").select_option("irradiance")
    spectrum.get_by_text("irradiance [W m").wait_for()
    spectrum.locator("select").select_option("radiance")
    field = row_of(page, "read [e⁻]", "Noise").locator("input[type=number]")
    field.fill("40")
    field.press("Enter")
    page.wait_for_function(
        "([panel, before]) => panel.innerHTML !== before", arg=[panel.element_handle(), before]
    )
    undo(page)
    wait_for(page, frame().rgb)
    page.get_by_role("button", name="Noise budget").click()
    panel.wait_for(state="detached")


def test_files_are_saved_beside_the_notebook(lab):
    page = lab.page
    field = row_of(page, "file").locator("input")
    for file in ("frame.png", "report.txt", "camera.toml"):
        field.fill(file)
        field.press("Enter")
        page.locator(".jupyter-button").get_by_text("save", exact=True).click()
        page.get_by_text(f"{file} is written").wait_for()
    assert np.array_equal(np.asarray(Image.open(lab.folder / "frame.png")), frame().rgb)
    assert gs.open_camera(lab.folder / "camera.toml").optics == gs.open_camera("phone").optics
    assert "ms" in (lab.folder / "report.txt").read_text()


def test_picture_of_the_notebook(lab, tmp_path):
    """What docs/preview.md shows; PREVIEW_PICTURES=docs/pictures keeps it there."""
    folder = Path(os.environ.get("PREVIEW_PICTURES", tmp_path))
    row_of(lab.page, "f-number", "Lens").wait_for()
    lab.page.locator(".jp-CodeCell .cm-content").first.click()
    lab.page.keyboard.press("Control+b")  # without the list of files
    lab.page.add_style_tag(content=".Toastify { display: none }")  # JupyterLab's news
    lab.page.wait_for_timeout(1000)
    lab.page.screenshot(path=folder / "preview-jupyterlab.png")
