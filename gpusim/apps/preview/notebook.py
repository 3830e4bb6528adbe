"""The preview in Jupyter: controls and picture as a widget."""

import asyncio
import atexit
from dataclasses import replace
from functools import cache, partial
from html import escape
from os import PathLike
from pathlib import Path
from threading import Thread
from typing import Any

import ipywidgets
from ipywidgets import HTML, Dropdown, HBox, Layout, VBox

from gpusim.apps.preview.control import as_text, parse
from gpusim.apps.preview.controls import CONTROLS, GROUPS, LIGHTS, LUMINANCE, OWN, TOLERANCES, VIEWS
from gpusim.apps.preview.labels import describe_exposure, describe_plan
from gpusim.apps.preview.notebook_fields import Number
from gpusim.apps.preview.notebook_panels import SUFFIXES, Panels
from gpusim.apps.preview.overrides import Given, table_of
from gpusim.apps.preview.panels import PANELS
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.recipes import CAMERA, SAVED
from gpusim.apps.preview.scene_choice import DEFAULT_SIZE, SceneChoice, checked_size
from gpusim.apps.preview.session import DEVICE, HEAD, JPEG, PNG, Session
from gpusim.apps.preview.state import History, State
from gpusim.apps.video.scenes import Still
from gpusim.backends import open_device
from gpusim.captures.capture import Capture
from gpusim.data.charts import CHARTS
from gpusim.domain.camera import Camera
from gpusim.domain.errors import GpusimError, OutOfRange, UnknownName
from gpusim.domain.scene import checked_scene
from gpusim.io.atomic import atomic_path
from gpusim.io.camera.cameras import camera_table
from gpusim.io.scene.option_texts import format_size
from gpusim.io.scene.scenes import open_scene
from gpusim.pipeline.frame import Frame

LIVE_PERIOD = 0.1  # [s] least time between pictures of live noise
GIVEN = "the given one"  # scene
FILES = (CAMERA, "report.txt", *(f"frame{suffix}" for suffix in SAVED))
PANEL_FILES = tuple(f"{name}{suffix}" for name in PANELS for suffix in SUFFIXES)
STYLE = {"description_width": "9em"}


def open_widget(
    scene, camera, device="auto", tolerance: str | None = "1e-3", capture: Capture | None = None
) -> "Preview":
    """Return the widget of `gs.preview`."""
    tolerance = "exact" if tolerance is None else str(tolerance)
    if tolerance not in TOLERANCES:
        raise UnknownName("tolerance of a preview", tolerance, TOLERANCES)
    scene = checked_scene(open_scene(scene) if isinstance(scene, str | PathLike) else scene)
    state: State
    if isinstance(camera, Camera):
        state = Given(camera.name, tolerance=tolerance, is_live=False, given=camera)
        table = table_of(camera)
    else:
        state = State(str(camera), tolerance=tolerance, is_live=False)
        table = camera_table(state.camera)[1]
        state.build()  # raises errors here
    device = open_device(device) if isinstance(device, str) else device
    return Preview(Producer(Still(scene, 1), device, LIVE_PERIOD, capture), state, table)


class Preview(HBox):
    """A picture, and the controls that change it. `close` ends it.

    Attributes:
        controls: Name -> field, of all of `CONTROLS` and of "view", "is_live", "tolerance", "scene",
            "size", "light", "luminance", "seed" and "frame": a Number, or a widget with a `value`.
        panels: Panels of measurements, with the fields of the pixel that is read out.
        file: Field with the name of a file that `save` writes: one of FILES or PANEL_FILES, or another.
        image: An ipywidgets.Image: a JPEG while a control moves, then a PNG.
    """

    def __init__(self, producer: Producer, state: State, table: dict):
        self.controls: dict = {}
        self.image = ipywidgets.Image(layout=Layout(width="100%", object_fit="contain"))
        self._producer, self._table, self._history = producer, table, History(state)
        self._texts: dict[
            str, tuple[Any, str]
        ] = {}  # values of text controls, and how they are typed
        self._is_updating = False  # True while the settings change the controls
        self._requested_version = 0  # of the settings
        self._shown_version = -1
        self._error = HTML()
        self._description = HTML("the first picture is being made")
        self._saved = HTML()
        self.panels = Panels()
        super().__init__(
            [self._make_picture_column(), self._make_control_column()],
            layout=Layout(flex_flow="row wrap"),
        )
        self._update_controls()
        self._session = _Session(producer, state, self._show)
        work = self._session.run(), self.panels.follow(self._session)
        self._serving = [asyncio.run_coroutine_threadsafe(one, _loop()) for one in work]

    @property
    def state(self) -> State:
        """The present settings."""
        return self._history.state

    @property
    def camera(self) -> Camera:
        """The camera with these settings. Raises GpusimError if there is none."""
        return self.state.build()

    def frame(self) -> Frame:
        """Return the frame of a Simulator of `camera`, with this seed and number.

        Raises GpusimError.
        """
        return DEVICE.submit(self._producer.frame, self.state, self.state.frame).result()

    def save(self, name: str | PathLike) -> None:
        """Write the frame, its report or the camera to a file.

        name: Its name: a suffix of `Frame.save`; .txt for the report; .toml for the camera; .csv or
            .svg, after the name of an open panel, for its content. Raises GpusimError.
        """
        path = Path(name)
        if path.suffix == ".toml":
            self.camera  # noqa: B018  raises if there is none
            text = self.state.toml()
        elif path.suffix == ".txt":
            text = f"{self.frame().report}\n"
        elif path.suffix in SUFFIXES:
            text = self.panels.text(path.stem, path.suffix)
        else:
            self.frame().save(path)
            return
        with atomic_path(path) as temporary:
            temporary.write_text(text)

    @property
    def is_settled(self) -> bool:
        """Whether the picture or message belongs to the present settings, and is final if it stands still."""
        return self._shown_version == self._requested_version

    def close(self):
        """Stop making pictures."""
        for one in self._serving:
            one.cancel()
        super().close()

    # its parts

    def _make_picture_column(self):
        view = self.controls["view"] = ipywidgets.ToggleButtons(
            options=VIEWS, style={"button_width": "auto"}
        )
        view.observe(lambda change: self._change_setting("view", change.new), "value")
        steps = []
        for name, step in (("undo", self._history.undo), ("redo", self._history.redo)):
            steps.append(ipywidgets.Button(icon=name, tooltip=name, layout=Layout(width="3em")))
            steps[-1].on_click(partial(self._step, step))
        self._undo, self._redo = steps
        live = self._add_field("is_live", ipywidgets.ToggleButton(description="live noise"))
        top = [self.image, HBox([view, live, *steps], layout=Layout(flex_flow="row wrap"))]
        shown = [*top, self._error, self._description, self.panels]
        return VBox([*shown, self._make_saving()], layout=Layout(flex="1 1 480px"))

    def _make_saving(self):
        """Return the fields that write a file."""
        self.file = ipywidgets.Combobox(
            value=FILES[0], options=(*FILES, *PANEL_FILES), description="file"
        )
        button = self._save_button = ipywidgets.Button(description="save", icon="save")
        button.on_click(lambda _: self._save())
        return HBox([self.file, button, self._saved], layout=Layout(flex_flow="row wrap"))

    def _make_control_column(self):
        groups = [
            VBox([self._make_field(control) for control in controls])
            for controls in GROUPS.values()
        ]
        scene = self._add_choice("scene", "scene", (GIVEN, *CHARTS))
        size = ipywidgets.Text(description="size", style=STYLE, continuous_update=False)
        size = self._add_field("size", size)
        light = self._add_choice("light", "light", (OWN, *LIGHTS))
        luminance = self.controls["luminance"] = Number(
            LUMINANCE, True, partial(self._change_setting, "luminance")
        )
        accordion = ipywidgets.Accordion(
            [*groups, VBox([scene, size, light, luminance])],
            titles=(*GROUPS, "Scene and light"),
            selected_index=0,
        )
        numbers = [
            self._add_whole_number("seed", "noise seed"),
            self._add_whole_number("frame", "noise frame"),
        ]
        tolerance = self._add_choice("tolerance", "tolerance", TOLERANCES)
        return VBox([tolerance, *numbers, accordion], layout=Layout(flex="0 1 420px"))

    def _make_field(self, control):
        """Return the widget of a control."""
        if control.choices:
            return self._add_choice(control.name, control.label, control.choices)
        if control.is_text:
            field = ipywidgets.Combobox(
                options=control.suggested,
                description=control.label,
                tooltip=control.words,
                style=STYLE,
                continuous_update=False,
            )
            return self._add_field(control.name, field)
        number = Number(
            control, control.off is not None, partial(self._change_setting, control.name)
        )
        self.controls[control.name] = number
        return number

    def _add_choice(self, name, label, choices):
        return self._add_field(name, Dropdown(options=choices, description=label, style=STYLE))

    def _add_whole_number(self, name, label):
        number = ipywidgets.BoundedIntText(max=2**32 - 1, description=label, style=STYLE)
        return self._add_field(name, number)

    def _add_field(self, name, field):
        """Return a field whose values change the setting of this name."""
        self.controls[name] = field
        field.observe(lambda change: self._change_setting(name, change.new), "value")
        return field

    # actions of the controls

    def _change_setting(self, name, value, is_slid=False):
        """Change a setting, and ask for its picture. is_slid: by a slider that may still move."""
        if self._is_updating:
            return
        if name == "light" and value == OWN:
            value = None
        changes = {name: value}
        if name in ("scene", "size"):
            try:
                changes = {"scene": self._choose_scene(name, value)}
            except GpusimError as error:
                self._error.value = _red(str(error))
                self._update_controls()
                return
        if name in CONTROLS:
            changes = {"changes": self._change_camera(CONTROLS[name], value)}
        self._history.set(replace(self.state, **changes), name if is_slid else "")
        self._request_picture()

    def _change_camera(self, control, value):
        """Return the changes of the camera with one more; an empty text takes it back."""
        others = {key: one for key, one in self.state.changes.items() if key != control.name}
        if control.is_text:
            return others | ({control.name: parse(value)} if value else {})
        if control.is_whole and isinstance(value, float) and value.is_integer():
            value = int(value)
        return others | {control.name: value}

    def _choose_scene(self, name, value):
        """Return the scene with another name or size. Raises OutOfRange."""
        choice = self.state.scene
        if name == "scene":
            size = choice.size or DEFAULT_SIZE
            return SceneChoice() if value == GIVEN else SceneChoice(value, size=size)
        if choice.is_given:
            raise OutOfRange("size", value, "for charts: choose one as the scene")
        return replace(choice, size=checked_size(value))

    def _save(self):
        """Write the file of the field, and say so."""
        name = self.file.value
        try:
            self.save(name)
        except GpusimError as error:
            self._saved.value = _red(str(error))
        else:
            self._saved.value = escape(f"{name} is written")

    def _step(self, step, _):
        if step():
            self._request_picture()

    def _request_picture(self):
        """Ask the session for a picture of the present settings."""
        self._requested_version += 1
        _loop().call_soon_threadsafe(self._session.set, self.state)
        self._update_controls()

    def _update_controls(self):
        """Put the settings into the controls."""
        state = self.state
        self._is_updating = True
        try:
            for name, field in self.controls.items():
                control = CONTROLS.get(name)
                value = state.value(control, self._table) if control else self._value(name)
                if isinstance(field, Number):
                    field.show(value)
                    continue
                if control and control.is_text:
                    if name not in self._texts or self._texts[name][0] != value:
                        self._texts[name] = value, as_text(value)  # takes 0.1 ms
                    value = self._texts[name][1]
                # one that the page does not offer
                if isinstance(field, Dropdown) and value not in field.options:
                    field.options = (*field.options, value)
                field.value = value
        finally:
            self._is_updating = False

    def _value(self, name):
        """Return what the field of a setting that is no camera's shows."""
        scene = self.state.scene
        if name == "scene":
            return scene.name or GIVEN
        if name == "size":
            return format_size(scene.size) if scene.size else ""
        value = getattr(self.state, name)
        return OWN if name == "light" and value is None else value

    # output, in the thread of the session

    async def _show(self, version, kind, data):
        """Show the picture of a version of the settings, or the error."""
        session = self._session
        self._error.value = _red(session.error) if session.error else ""
        if data:
            with self.image.hold_sync():
                self.image.format = "png" if kind == PNG else "jpeg"
                self.image.value = data[HEAD.size :]
            shown = session.shown
            for name, value in shown.facts["metered"].items():
                self.controls[name].show_metered(value)
            first = f"frame {shown.number}  made in {shown.ms:.0f} ms"
            text = escape(
                "\n".join([first, describe_exposure(shown.facts), describe_plan(shown.facts)])
            )
            style = "white-space:pre-wrap;line-height:1.4"
            self._description.value = f'<pre style="{style}">{text}</pre>'
            self.panels.request(kind == PNG)
        if kind == PNG or not data or session.state.is_live:
            self._shown_version = version


def _red(words):
    return f'<span style="color:#d33">{escape(words)}</span>'


class _Session(Session):
    """A session that shows its pictures.

    show: coroutine of version, kind and bytes (None if there is an `error`).
    """

    def __init__(self, producer, state, show):
        super().__init__(producer, state)
        self._show = show

    async def run(self):
        """Make pictures on request."""
        painted: asyncio.Queue = asyncio.Queue()

        async def send(_):
            painted.put_nowait(None)  # a notebook does not say when it has painted

        await self.serve(send, painted.get)

    async def _make_picture(self, version, settles):
        data = await super()._make_picture(version, settles)
        await self._show(version, PNG if settles else JPEG, data)
        return data


@cache
def _loop():
    """Return the event loop of all widgets. The loop of the kernel stops while a cell runs."""
    loop = asyncio.new_event_loop()

    def run():
        asyncio.set_event_loop(loop)
        loop.run_forever()
        tasks = asyncio.all_tasks(loop)
        for task in tasks:
            task.cancel()
        loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))

    def end():
        loop.call_soon_threadsafe(loop.stop)
        thread.join()

    thread = Thread(target=run, name="gpusim-notebook", daemon=True)
    thread.start()
    atexit.register(end)
    return loop
