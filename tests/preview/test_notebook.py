"""The preview in Jupyter: what the widget's controls do, what it shows, and that a kernel runs it."""

import io
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from cameras import FIRST
from PIL import Image

import gpusim as gs
from gpusim.apps.preview.controls import CONTROLS, LIGHTS
from gpusim.apps.preview.notebook import FILES, GIVEN, Preview
from gpusim.apps.preview.notebook_fields import Number
from gpusim.apps.preview.overrides import Given, table_of
from gpusim.apps.preview.panels import DEFAULTS, PANELS
from gpusim.apps.preview.producer import Picture
from gpusim.apps.preview.state import State
from gpusim.domain.errors import BadData, GpusimError
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.camera.cameras import camera_names, camera_table

SCENE = gs.chart("colorchecker", size=(96, 64))
EXPOSURE, F_NUMBER = "sensor.exposure_time_ms", "optics.f_number"


class Fake:
    """Pictures that take a while, of one grey."""

    def __init__(self):
        self.made = []
        self.goes_on = threading.Event()
        self.goes_on.set()

    def half_picture(self, state, number):
        return None

    def picture(self, state, number, drafts=False):
        time.sleep(0.02)
        assert self.goes_on.wait(60)
        self.made.append(state)
        facts = {
            "draft": False,
            "exposure": 0.01,
            "gain": 1.0,
            "error": 1e-4,
            "verdict": "met",
            "unknown": (),
            "left out": (),
            "metered": {EXPOSURE: 10.0},
            "shape": (8, 8),
        }
        return Picture(np.full((8, 8, 3), 100, np.uint8), number, 20.0, facts)

    def inputs(self, needs, has_irradiance):
        raise RuntimeError("the GPU has fallen off the bus")


def settled(widget):
    """Pixels of the picture that stays, (rows, cols, 3)."""
    end = time.monotonic() + 100
    while not widget.is_settled:
        assert time.monotonic() < end
        time.sleep(0.01)
    assert widget.image.format == "png"
    return np.asarray(Image.open(io.BytesIO(widget.image.value)))


def wait_until(is_so):
    end = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def faked():
    state = State("phone", is_live=False)
    made = Preview(Fake(), state, camera_table("phone")[1])
    yield made
    made.close()


@pytest.fixture
def widget():
    made = gs.preview(SCENE, "phone", device="opencl")
    yield made
    made.close()


def test_a_slider_changes_the_picture_and_undo_takes_it_back(widget):
    exposure = widget.controls[EXPOSURE]
    first = settled(widget)
    exposure.switch.value = True  # it is automatic
    exposure.number.value = 20.0
    bright = settled(widget)
    histogram = widget.panels.opened["histogram"].content
    wait_until(lambda: histogram.value)
    before = histogram.value
    dim = CONTROLS[EXPOSURE].to_place(5.0)
    exposure.slider.value = dim
    dark = settled(widget)
    assert dark.mean() < 0.8 * bright.mean()
    wait_until(lambda: histogram.value != before)
    time_ms = CONTROLS[EXPOSURE].to_value(dim)
    assert 4.9 < time_ms < 5.1 and exposure.number.value == time_ms
    assert widget.camera.sensor.exposure_time == time_ms / 1e3
    assert (
        f"exposure {time_ms:.4g} ms" in widget._description.value
        and "(met)" in widget._description.value
    )
    widget._undo.click()
    assert (
        np.array_equal(settled(widget), bright)
        and exposure.number.value == 20.0
        and exposure.slider.value == CONTROLS[EXPOSURE].to_place(20.0)
    )
    widget._redo.click()
    assert np.array_equal(settled(widget), dark)
    exposure.switch.value = False
    assert np.array_equal(settled(widget), first) and exposure.slider.disabled
    # the camera's own choice is shown, to four digits
    assert exposure.number.value == float(f"{1e3 * widget.frame().exposure_time:.4g}")
    assert widget.state.changes[EXPOSURE] == "auto"


def test_what_settles_is_what_a_simulator_makes(widget):
    """After controls of every kind, the lens's with drafts, one after the other."""
    moves = [
        (EXPOSURE, 12.5),
        (F_NUMBER, 2.8),
        ("noise.read_e", 8.0),
        ("optics.object_distance_m", 0.5),
        ("processor.demosaic", "bilinear"),
        ("light", LIGHTS[2]),
        ("luminance", 300.0),
        ("frame", 7),
        ("seed", 3),
        ("optics.defocus_um", 4.0),
        ("tolerance", "exact"),
        ("view", "rendered"),
    ]
    for name, value in moves:
        control = widget.controls[name]
        if getattr(control, "switch", None):
            control.switch.value = True
        getattr(control, "number", control).value = value
        shown = settled(widget)
        assert not widget._error.value, name
        scene = gs.chart(
            "colorchecker",
            size=(96, 64),
            light=widget.state.light or "D65",
            luminance=widget.state.luminance or 100.0,
        )
        frame = gs.Simulator(widget.camera, device="opencl", tolerance=widget.state.asked)(
            scene, seed=widget.state.seed, first=widget.state.frame
        )
        assert np.array_equal(shown, frame.rgb), name
    assert np.array_equal(widget.frame().raw, frame.raw) and widget.state.frame == 7
    widget.controls["view"].value = "raw"
    assert not np.array_equal(settled(widget), shown)


def test_the_newest_settings_win(faked):
    """What is set while a picture is made is not made one after the other."""
    settled(faked)
    gain, before = faked.controls["sensor.analog_gain"], len(faked._producer.made)
    faked._producer.goes_on.clear()
    for place in range(200, 400):
        gain.slider.value = place
    faked._producer.goes_on.set()
    settled(faked)
    made = faked._producer.made
    last = CONTROLS["sensor.analog_gain"].to_value(399)
    assert len(made) - before <= 2 and made[-1].changes["sensor.analog_gain"] == last > 1
    faked._undo.click()  # one slider's movements are one step
    assert faked.state.changes == {} and gain.number.value == 1.0


def test_a_slider_that_is_moved_is_sent_nothing(faked):
    """It would jump back to where it was."""
    control, sent = faked.controls[F_NUMBER], []
    control.slider.observe(lambda change: sent.append(change.new), "value")
    for place in (321, 322, 5, 999):
        control.slider.value = place
    assert sent == [321, 322, 5, 999]
    assert control.number.value == faked.state.changes[F_NUMBER] == CONTROLS[F_NUMBER].to_value(999)


def test_places_of_sliders():
    """Each is a value of its own, and the value's place: a slider stays where it was put."""
    for control in CONTROLS.values():
        if not control.choices and not control.is_text:
            values = [control.to_value(place) for place in range(control.places + 1)]
            assert [control.to_place(value) for value in values] == [*range(len(values))]
            assert not control.is_whole or all(isinstance(value, int) for value in values)


def test_sliders_stand_on_whole_places(faked):
    """A browser sends a slider back that stands between two steps; test_jupyterlab.py looks at it there."""
    for name, field in faked.controls.items():
        if isinstance(field, Number):
            slider = field.slider
            assert type(slider.value) is int and slider.step == 1 and slider.min == 0, name
            assert slider.max == field._control.places, name


def test_jpegs_while_a_slider_is_moved(faked):
    settled(faked)
    formats = []
    faked.image.observe(lambda change: formats.append(faked.image.format), "value")
    faked.controls[F_NUMBER].slider.value = 400
    settled(faked)
    assert formats == ["jpeg", "png"]


def test_the_last_good_picture_stays(widget):
    good = settled(widget)
    field = widget.controls[F_NUMBER].number
    field.value = -1.0
    assert (
        np.array_equal(settled(widget), good)
        and "f-number = -1.0: allowed is" in widget._error.value
    )
    with pytest.raises(GpusimError, match="f-number = -1"):
        widget.frame()
    field.value = float("nan")  # a field that was emptied
    assert widget.state.changes[F_NUMBER] == -1.0
    field.value = 4.0
    assert not np.array_equal(settled(widget), good) and not widget._error.value


def test_noise_is_live(widget):
    """Each picture has other noise; it stops with a picture without loss."""
    settled(widget)
    seen = []
    widget.image.observe(lambda change: seen.append(change.new), "value")
    widget.controls["is_live"].value = True
    end = time.monotonic() + 60
    while len(seen) < 6:
        assert time.monotonic() < end
        time.sleep(0.01)
    assert len({*seen[1:]}) == len(seen) - 1 and widget.image.format == "jpeg"
    widget.controls["is_live"].value = False
    settled(widget)


def test_a_pixel_is_read_out(widget):
    """The mean electrons of the widget's own frame at this place."""
    settled(widget)
    row, column = widget.panels.place
    row.value, column.value = 40, 17
    electrons = f"{widget.frame().mean[40, 17]:.4g} e-"
    said = widget.panels.pixel
    wait_until(lambda: "row 40  column 17  " in said.value and electrons in said.value)


def test_panels_are_opened(widget):
    """All of the page's, with their choices; each shows something, follows the picture, and is saved."""
    panels = widget.panels
    assert panels.switches.keys() == PANELS.keys() and panels.opened.keys() == {*DEFAULTS}
    for name, switch in panels.switches.items():
        switch.value = True
        assert panels.opened[name].chosen.keys() == PANELS[name].options.keys()
    settled(widget)
    wait_until(lambda: all(one.content.value for one in panels.opened.values()))
    for name, one in panels.opened.items():
        assert "fails" not in one.content.value and one.content.value.count("<") > 1, name
    shown = panels.opened["budget"].content.value
    widget.controls["noise.read_e"].number.value = 40.0
    wait_until(lambda: panels.opened["budget"].content.value != shown)
    profile = panels.opened["profile"]
    shown = profile.content.value
    profile.choices["along"].value = "column"
    wait_until(lambda: profile.content.value != shown)
    panels.switches["psf"].value = False
    assert "psf" not in panels.opened
    with pytest.raises(GpusimError, match="unknown open panel 'psf'"):
        widget.save("psf.csv")


def test_a_panel_shows_the_irradiance(widget):
    """It is computed once the picture stands still."""
    settled(widget)
    spectrum = widget.panels.opened["spectrum"]
    spectrum.choices["quantity"].value = "irradiance"
    wait_until(lambda: "irradiance [W m" in spectrum.content.value)


def test_other_channels_are_offered(widget):
    """Of a camera with other filters."""
    settled(widget)
    widget.panels.switches["psf"].value = True
    channel = widget.panels.opened["psf"].choices["channel"]
    wait_until(lambda: widget.panels.opened["psf"].content.value)
    assert channel.options == ("G", "R", "B")
    widget.controls["sensor.cfa"].value = '["RG", "GB"]'


def test_a_text_is_a_value_of_a_camera_file(widget):
    """An empty one takes the change back; one that cannot be is refused in a line."""
    first, field = settled(widget), widget.controls["sensor.cfa"]
    was = field.value
    field.value = '["GR", "BG"]'
    assert widget.camera.sensor.cfa == ("GR", "BG")
    assert not np.array_equal(settled(widget), first) and not widget._error.value
    field.value = ""
    assert field.value == was and np.array_equal(settled(widget), first)
    field.value = "moon"
    assert np.array_equal(settled(widget), first) and "moon" in widget._error.value


def test_what_a_widget_saves(widget, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    widget.controls[EXPOSURE].switch.value = True
    widget.controls[EXPOSURE].number.value = 12.5
    wait_until(lambda: widget.panels.opened["histogram"].parts)
    for name in (*FILES, "mine.png", "histogram.csv", "histogram.svg"):
        widget.file.value = name
        widget._save_button.click()
        assert widget._saved.value == f"{name} is written" and (tmp_path / name).stat().st_size
    assert np.array_equal(np.load("frame.npz")["dn"], widget.frame().raw)
    assert np.array_equal(np.asarray(Image.open("mine.png")), settled(widget))
    assert gs.open_camera("camera.toml").sensor.exposure_time == 0.0125
    assert "ms" in (tmp_path / "report.txt").read_text()
    assert "</svg>" in (tmp_path / "histogram.svg").read_text()
    assert len((tmp_path / "histogram.csv").read_text().splitlines()) > 10
    for name, words in (
        ("frame.xyz", "unknown output format"),
        (".", "unknown output format"),
        ("budget.csv", "unknown open panel"),
    ):
        widget.file.value = name
        widget._save_button.click()
        assert words in widget._saved.value


def test_a_chart_is_chosen_as_the_scene(widget):
    first, scene, size = settled(widget), widget.controls["scene"], widget.controls["size"]
    scene.value, size.value = "deadleaves", "80x50"
    own = gs.open_scene("deadleaves", size=(80, 50))
    frame = gs.Simulator(gs.open_camera("phone"), device="opencl", tolerance="1e-3")(own)
    assert np.array_equal(settled(widget), frame.rgb)
    size.value = "0x50"
    assert "allowed is COLSxROWS" in widget._error.value and size.value == "80x50"
    scene.value = GIVEN
    assert np.array_equal(settled(widget), first) and size.value == ""
    size.value = "80x50"
    assert "choose one as the scene" in widget._error.value and size.value == ""


def test_a_widget_that_is_closed_makes_no_more_pictures(faked):
    settled(faked)
    faked.close()
    made = len(faked._producer.made)
    faked.controls[F_NUMBER].slider.value = 400
    time.sleep(0.3)
    assert len(faked._producer.made) == made


@pytest.mark.parametrize("names", [FIRST, pytest.param(camera_names(), marks=pytest.mark.slow)])
def test_a_camera_object_is_changed_as_its_file_is(names):
    """Every control, one after the other; a camera that is not changed is the object's own, bit for bit."""
    random = np.random.default_rng(2)
    for name in names:
        camera, table = gs.open_camera(name), camera_table(name)[1]
        file, given = State(name), Given(camera.name, given=camera)
        assert repr(given.build()) == repr(camera)
        for control in CONTROLS.values():
            own, written = given.value(control, table_of(camera)), file.value(control, table)
            if control.key == "cfa" and isinstance(written, str):  # an object has its rows
                written = list(MOSAICS[written])
            # curves and files are objects without a name there
            assert own == written or (own is None and control.is_text), control.name
            value = (
                control.choices[random.integers(len(control.choices))]
                if control.choices
                else float(control.low + (control.high - control.low) * random.random())
            )
            changes = {control.name: value}
            try:
                wanted = repr(replace(file, changes=changes).build())
            except GpusimError:
                with pytest.raises(GpusimError):
                    replace(given, changes=changes).build()
                continue
            assert repr(replace(given, changes=changes).build()) == wanted, control.name
    with pytest.raises(BadData, match="an object without a file"):
        given.toml()


def test_a_widget_of_a_camera_object():
    camera = replace(gs.open_camera("mono"), name="my own")
    widget = gs.preview("flat", camera, device="opencl", tolerance=None)
    assert widget.controls[F_NUMBER].number.value == camera.optics.f_number
    widget.controls[F_NUMBER].number.value = 5.6
    shown = settled(widget)
    own = replace(camera, optics=replace(camera.optics, f_number=5.6))
    assert np.array_equal(shown, gs.Simulator(own, device="opencl")(gs.open_scene("flat")).rgb)
    widget.close()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (("moon", "phone"), "unknown scene 'moon'"),
        ((3, "phone"), "wanted a Scene"),
        (("flat", "fone"), "did you mean"),
        (("flat", 3), "unknown camera '3'"),
        (("flat", "phone", "1e-7"), "unknown tolerance of a preview '1e-7'"),
    ],
)
def test_what_cannot_be_shown_is_said_at_once(asked, words):
    scene, camera, *tolerance = asked
    with pytest.raises(GpusimError, match=words):
        gs.preview(scene, camera, device="numpy", tolerance=(*tolerance, "1e-3")[0])


def test_what_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(
        GpusimError, match=r"^preview: ipywidgets is not installed; .* 'gpusim\[notebook\]'$"
    ):
        gs.preview("flat", "phone")


@pytest.mark.parametrize(
    "imports",
    [
        "",
        "import gpusim.apps.preview.session",
        "from gpusim.apps.preview import state",
        "gs.preview; import gpusim.apps.preview.state",
        "import gpusim.cli.main",
        "from gpusim import preview",
        "from gpusim import *",
    ],
)
def test_a_function_and_a_package_have_one_name(imports):
    code = (
        f"import gpusim as gs, sys; {imports}\ntry: gs.preview('moon', 'phone')\n"
        "except gs.GpusimError as error: print(error)\n"
        "print(gs.preview is sys.modules['gpusim.apps.preview'])\n"
        "import gpusim.apps.preview.session as session; print(gs.preview.session is session)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert said.stdout.splitlines()[0].startswith("unknown scene 'moon'"), said.stderr
    assert said.stdout.split()[-2:] == ["True", "True"]


@pytest.mark.parametrize("end", ["", "widget.close(); time.sleep(0.3)"])
def test_a_program_with_a_widget_ends_in_silence(end):
    code = (
        "import gpusim as gs, time; widget = gs.preview('flat', 'mono', device='numpy')\n"
        f"while not widget.is_settled: time.sleep(0.01)\n{end}"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


@pytest.mark.slow
def test_a_kernel_runs_it():
    """Changes come as a browser sends them, by messages, of which the kernel runs one after the other."""
    import nbclient
    import nbformat

    make = (
        "import time, gpusim as gs\n"
        "widget = gs.preview(gs.chart('colorchecker', size=(96, 64)), 'phone', device='opencl')\n"
        "while not widget.is_settled: time.sleep(0.01)\n"
        "first, seen = widget.image.value, []\n"
        "widget.image.observe(lambda change: seen.append(change.new), 'value')\n"
        "print(widget.controls['optics.f_number'].slider.model_id)\n"
        "widget"
    )
    look = (
        "while not widget.is_settled: time.sleep(0.01)\n"
        "print(widget.camera.optics.f_number, widget.image.value != first, widget.image.format, len(seen) < 50)"
    )
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(text) for text in (make, look)]
    )
    client = nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3")
    with client.setup_kernel():
        said, shown = client.execute_cell(notebook.cells[0], 0).outputs
        for k in range(100):
            content = {
                "comm_id": said.text.strip(),
                "data": {"method": "update", "state": {"value": 200 + k}, "buffer_paths": []},
            }
            client.kc.shell_channel.send(client.kc.session.msg("comm_msg", content))
        last = CONTROLS[F_NUMBER].to_value(299)
        assert (
            client.execute_cell(notebook.cells[1], 1).outputs[0].text == f"{last} True png True\n"
        )
    assert "application/vnd.jupyter.widget-view+json" in shown.data
    # what has come to the browser
    states = [
        state for state in client.widget_state.values() if state.get("_model_name") == "ImageModel"
    ]
    assert [state["format"] for state in states] == ["png"]
