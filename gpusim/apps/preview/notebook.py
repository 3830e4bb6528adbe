"""The preview in Jupyter: controls and picture as a widget."""

import asyncio
import atexit
import time
from dataclasses import replace
from functools import cache, partial
from html import escape
from math import isfinite, log10
from os import PathLike
from threading import Thread

import ipywidgets
from ipywidgets import HTML, Dropdown, HBox, Layout, VBox

from gpusim.apps.preview.control import PLACES, Control
from gpusim.apps.preview.controls import CONTROLS, GROUPS, LIGHTS, LUMINANCE, OWN, TOLERANCES, VIEWS
from gpusim.apps.preview.labels import describe_exposure, describe_plan
from gpusim.apps.preview.measures import Where
from gpusim.apps.preview.overrides import Given, table_of
from gpusim.apps.preview.panels_kept import Kept
from gpusim.apps.preview.panels_light import histogram
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.session import DEVICE, HEAD, JPEG, PNG, Session
from gpusim.apps.preview.state import History, State
from gpusim.apps.video.scenes import Still
from gpusim.backends import open_device
from gpusim.captures.capture import Capture
from gpusim.domain.camera import Camera
from gpusim.domain.errors import UnknownName
from gpusim.domain.scene import checked_scene
from gpusim.io.camera.cameras import camera_table
from gpusim.io.scene.scenes import open_scene
from gpusim.pipeline.frame import Frame

HISTOGRAM_INTERVAL = 0.5  # [s] between histograms, while a slider is moved
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
    return Preview(Producer(Still(scene, 1), device, capture=capture), state, table)


class Preview(HBox):
    """A picture, and the controls that change it. `close` ends it.

    Attributes:
        controls: Name -> field, of all of `CONTROLS` and of "view", "tolerance", "light",
            "luminance", "seed" and "frame": a Number, or a widget with a `value`.
        image: An ipywidgets.Image: a JPEG while a control moves, then a PNG.
    """

    def __init__(self, producer: Producer, state: State, table: dict):
        self.controls: dict = {}
        self.image = ipywidgets.Image(layout=Layout(width="100%", object_fit="contain"))
        self._producer, self._table, self._history = producer, table, History(state)
        self._is_updating = False  # True while the settings change the controls
        self._requested_version = 0  # of the settings
        self._shown_version = -1
        self._histogram_time = 0.0  # when the last histogram was made
        self._error = HTML()
        self._description = HTML("the first picture is being made")
        self._histogram = HTML(layout=Layout(max_width="640px"))
        super().__init__(
            [self._make_picture_column(), self._make_control_column()],
            layout=Layout(flex_flow="row wrap"),
        )
        self._update_controls()
        self._session = _Session(producer, state, self._show)
        self._serving = asyncio.run_coroutine_threadsafe(self._session.run(), _loop())

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

    @property
    def is_settled(self) -> bool:
        """Whether the picture or message belongs to the present settings, and is final."""
        return self._shown_version == self._requested_version

    def close(self):
        """Stop making pictures."""
        self._serving.cancel()
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
        top = [self.image, HBox([view, *steps])]
        shown = [*top, self._error, self._description, self._histogram]
        return VBox(shown, layout=Layout(flex="1 1 480px"))

    def _make_control_column(self):
        groups = [
            VBox([self._make_field(control) for control in controls])
            for controls in GROUPS.values()
        ]
        light = self._add_choice("light", "light", (OWN, *LIGHTS))
        luminance = self.controls["luminance"] = Number(
            LUMINANCE, True, partial(self._change_setting, "luminance")
        )
        accordion = ipywidgets.Accordion(
            [*groups, VBox([light, luminance])], titles=(*GROUPS, "Light"), selected_index=0
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
        if name in CONTROLS:
            changes = {"changes": self.state.changes | changes}
        self._history.set(replace(self.state, **changes), name if is_slid else "")
        self._request_picture()

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
                value = state.value(control, self._table) if control else getattr(state, name)
                if isinstance(field, Number):
                    field.show(value)
                    continue
                value = OWN if name == "light" and value is None else value
                # one that the page does not offer
                if isinstance(field, Dropdown) and value not in field.options:
                    field.options = (*field.options, value)
                field.value = value
        finally:
            self._is_updating = False

    # output, in the thread of the session

    async def _show(self, version, kind, data):
        """Show the picture of a version of the settings, or the error."""
        session = self._session
        self._error.value = (
            f'<span style="color:#d33">{escape(session.error)}</span>' if session.error else ""
        )
        if data:
            with self.image.hold_sync():
                self.image.format = "png" if kind == PNG else "jpeg"
                self.image.value = data[HEAD.size :]
            shown = session.shown
            first = f"frame {shown.number}  made in {shown.ms:.0f} ms"
            text = escape(
                "\n".join([first, describe_exposure(shown.facts), describe_plan(shown.facts)])
            )
            style = "white-space:pre-wrap;line-height:1.4"
            self._description.value = f'<pre style="{style}">{text}</pre>'
            if kind == PNG or time.monotonic() - self._histogram_time > HISTOGRAM_INTERVAL:
                await self._update_histogram()
        if kind == PNG or not data:
            self._shown_version = version

    async def _update_histogram(self):
        try:
            found = await self._session.compute(self._producer.inputs, frozenset({"raw"}))
        except Exception:
            return  # the next picture says it, also of a device that fails
        where = Where(found.scene.shape)
        parts = histogram(found, where, {"scale": "log"}, Kept())
        self._histogram.value = "".join(part.html() for part in parts)
        self._histogram_time = time.monotonic()


class Number(HBox):
    """A slider and a number field, which also takes values beyond the slider's ends.

    Args:
        control: Control.
        has_switch: Whether a switch sets the control to its `off`.
        on_change: Function that is called with a new value, and with True if the slider was moved.

    Attributes:
        slider: Slider between the ends of the control.
        number: Field that also takes values beyond them.
        switch: Checkbox, or None.
    """

    def __init__(self, control: Control, has_switch: bool, on_change):
        self._control, ends = control, (control.low, control.high)
        low, high = map(log10, ends) if control.is_log else ends
        kind = ipywidgets.FloatLogSlider if control.is_log else ipywidgets.FloatSlider
        # until there is a value
        middle = 10 ** ((low + high) / 2) if control.is_log else (low + high) / 2
        self.slider = kind(
            middle,
            min=low,
            max=high,
            step=(high - low) / PLACES,
            readout=False,
            layout=Layout(flex="1 1 6em", min_width="6em"),
        )
        self.number = ipywidgets.FloatText(middle, layout=Layout(width="6.5em"))
        self.switch = None
        if has_switch:
            self.switch = ipywidgets.Checkbox(indent=False, layout=Layout(width="1.5em"))
        unit = f" [{control.unit}]" if control.unit else ""
        self.slider.observe(lambda change: on_change(float(f"{change.new:.4g}"), True), "value")
        self.number.observe(
            lambda change: on_change(change.new) if isfinite(change.new) else None, "value"
        )
        if self.switch:
            self.switch.observe(
                lambda change: on_change(self.number.value if change.new else control.off), "value"
            )
        label = ipywidgets.Label(control.label + unit, layout=Layout(width="10.5em"))
        parts = [label, self.slider, self.number]
        super().__init__([self.switch, *parts] if self.switch else parts)

    def show(self, value):
        """Show a value. A control that is off, or has no number, is greyed out."""
        control = self._control
        has_number = isinstance(value, int | float) and value != control.off
        if has_number:
            # not the moving slider: the value would arrive after it has moved on
            if f"{value:.4g}" != f"{self.slider.value:.4g}":
                self.slider.value = min(max(value, control.low), control.high)
            self.number.value = value
        self.slider.disabled = self.number.disabled = not has_number
        if self.switch:
            self.switch.value = has_number


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
