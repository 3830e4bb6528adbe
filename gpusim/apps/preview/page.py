"""The preview's page: controls, the picture and its data."""

import time
from dataclasses import replace
from math import isfinite
from typing import Any

from nicegui import app, run, ui

from gpusim.apps.preview.canvas import Canvas, mark
from gpusim.apps.preview.controls import (
    CONTROLS,
    GROUPS,
    LUMINANCE,
    PLACES,
    TOLERANCES,
    VIEWS,
    Control,
)
from gpusim.apps.preview.curves import histogram, response
from gpusim.apps.preview.filmstrip import Filmstrip
from gpusim.apps.preview.labels import describe_exposure, describe_plan
from gpusim.apps.preview.light_chooser import LightChooser
from gpusim.apps.preview.measures import SPAN
from gpusim.apps.preview.receiver import notify_errors
from gpusim.apps.preview.recipes import Start
from gpusim.apps.preview.saving import SaveMenu
from gpusim.apps.preview.scene_chooser import SceneChooser
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.sessions import Sessions
from gpusim.apps.preview.state import State
from gpusim.domain.errors import GpusimError
from gpusim.io.camera.cameras import camera_names, camera_table

PATIENT = 1.0  # [s] of a picture, after which the page says that it is being made
OPEN = ("Scene", "Exposure", "Lens")  # groups, at first
QUIET = "text-sm text-neutral-300 font-mono"
ROW = "w-full items-center gap-2"
# A control that glides to its new place has the page laid out and painted at every refresh of the
# screen
STYLE = """
.q-slider *, .q-field, .q-field *, .q-checkbox *, .q-focus-helper {
    transition: none !important; animation: none !important;
}
"""


class Page:
    """One client's page.

    title: of the page. shape: rows and columns of its first frames. start: how the preview was started.
    """

    def __init__(
        self, session: Session, token: str, title: str, shape: tuple[int, int], start: Start
    ):
        self.session, self._title = session, title
        self._scene = SceneChooser(session, self._set)
        self._light = LightChooser(session, self._set)
        self._films = Filmstrip(session, self._scene.show)
        self._saving = SaveMenu(session, start)
        self._canvas = Canvas(session, token, shape)
        self._fields: dict[str, Any] = {}
        self._is_updating = False  # while the page follows the settings, and not they it
        self._is_step = False  # whether the next change is one, whatever was before
        self._last_control = ""  # the control that was moved last
        self._refused = ""  # the control with an error message
        self._table: dict = {}

    def build(self):
        """Make the page's elements."""
        ui.page_title(f"gpusim: {self._title}")
        ui.dark_mode(True)
        ui.add_css(STYLE)
        ui.query("body").classes("bg-neutral-900")
        with ui.row(wrap=True).classes("w-full items-start gap-4 p-2"):
            with ui.column().classes("grow basis-[640px] min-w-[280px] gap-2"):
                self._build_known()
                self._build_picture()
                self._build_measures()
            with ui.column().classes("w-full max-w-[420px] gap-1"):
                self._build_top()
                for name, controls in GROUPS.items():
                    with _group(name):
                        for control in controls:
                            self._build_control(control)
                self._build_scene()
        ui.keyboard(on_key=self._on_key)
        ui.timer(0.25, self._refresh)
        ui.timer(0.5, self._statistics)
        self._update_controls()

    def _build_picture(self):
        self._canvas.build()
        self._films.build()
        with ui.row().classes(ROW):
            view = ui.toggle(list(VIEWS), on_change=lambda event: self._set(view=event.value))
            self._keep("view", view.props("dense no-caps"))
            self._switch("live", "play" if self._is_moving else "live noise", self._live)
            self._icon("undo", "undo (Ctrl+Z)", self._undo)
            self._icon("redo", "redo (Ctrl+Y)", self._redo)
            self._icon("zoom_out", "smaller (-)", lambda: self._canvas.zoom(-1))
            larger = "larger, without loss (+); drag to move"
            self._icon("zoom_in", larger, lambda: self._canvas.zoom(1))
            words = "drag over a slanted edge: its frequency response (ISO 12233)"
            self._switch("measure", "edge", self._measure).tooltip(words)
            self._button("error map", "error map", self._error_map)
        with ui.row().classes(ROW):
            if self._is_moving:
                self._icon("skip_previous", "frame before (,)", lambda: self._step(-1))
                self._icon("skip_next", "next frame (.)", lambda: self._step(1))
                last = self.session.producer.frames - 1
                self._bar("frame", "frame", last, self._scrub, "grow max-w-[300px]")
            words = "keep this camera as B, and compare others with it"
            self._button("set B", "set B", self._set_other).tooltip(words)
            self._button("swap", "swap A and B", self._swap)
            self._button("no B", "no B", lambda: self._set(against=None))
            self._bar("split", "A | B", PLACES, self._split, "w-40")

    # elements

    def _keep(self, name, element, classes=""):
        """Register an element: the page finds it by its name, and so do tests."""
        self._fields[name] = element.classes(classes).props(mark(name))
        return element

    def _button(self, name, words, does):
        button = ui.button(words, on_click=does).props("flat dense no-caps")
        return self._keep(name, button)

    def _icon(self, icon, words, does):
        button = ui.button(icon=icon, on_click=does).props(f'flat dense aria-label="{words}"')
        self._keep(icon, button.tooltip(words))

    def _switch(self, name, words, on_change):
        switch = ui.switch(words, on_change=lambda event: on_change(event.value))
        return self._keep(name, switch)

    def _bar(self, name, words, most, on_change, classes):
        slider = ui.slider(min=0, max=most, on_change=lambda event: on_change(event.value))
        return self._keep(name, slider.props(f'aria-label="{words}"'), classes)

    def _choice(self, name, label, choices, on_change, classes="w-full"):
        select = ui.select(
            list(choices), label=label, on_change=lambda event: on_change(event.value)
        )
        self._keep(name, select, classes)

    @property
    def _is_moving(self):
        return self.session.producer.period > 0

    def _build_known(self):
        for name, classes in (
            ("error", "text-red-400"),
            ("busy", "text-amber-400"),
            ("known", QUIET),
            ("left out", "text-xs text-neutral-400"),
        ):
            self._keep(name, ui.label(), f"{classes} whitespace-pre-wrap")

    def _build_measures(self):
        for name in ("pixel", "histogram", "difference", "edge", "response"):
            if name in ("histogram", "response"):
                self._fields[name] = ui.html("", sanitize=False).classes("w-full max-w-[640px]")
            else:
                self._keep(name, ui.label(), QUIET)

    def _build_top(self):
        with ui.row().classes(ROW):
            names = camera_names()
            own = self.session.state.camera
            cameras = [*names, *([] if own in names else [own])]
            self._choice("camera", "camera", cameras, self._camera, "grow")
            self._choice("tolerance", "tolerance", TOLERANCES, self._tolerance, "grow")
            self._saving.build()

    def _build_scene(self):
        with _group("Scene"):
            self._scene.build()
        with _group("Light"):
            self._light.build()
            self._slider("luminance", LUMINANCE, self._luminance)

    def _build_control(self, control: Control):
        def on_change(value):
            self._change_setting(control, value)

        if control.choices:
            self._choice(control.name, control.label, control.choices, on_change)
        else:
            self._slider(control.name, control, on_change)

    def _slider(self, name, control, on_change):
        with ui.row(wrap=False).classes(f"{ROW} -my-1"):
            is_on = None
            if control.off is not None:
                is_on = ui.checkbox(
                    on_change=lambda event: self._turn_on(control, event.value, slider.value)
                )
                is_on.props("dense").props(mark(f"{name} on"))
            ui.label(control.label).classes("w-24 text-sm shrink-0")

            def slid(place):
                self._slide(on_change, control.to_value(place))

            slider = self._bar(name, control.label, PLACES, slid, "grow")
            number = ui.number(suffix=control.unit or None).classes("w-28 shrink-0")
            number.props("dense borderless").props(mark(f"{name} number"))
            number.on("change", lambda: self._take_number(on_change, number.value))
        self._fields[name] = (slider, number, is_on, control)

    # actions of the controls

    def _slide(self, on_change, value):
        if not self._is_updating:
            on_change(value)

    def _take_number(self, on_change, value):
        """Take a typed number, as a separate step of the history."""
        self._is_step = True
        if value is not None and isfinite(value):
            on_change(float(value))
        else:
            self._update_controls()

    def _turn_on(self, control, is_on, place):
        if not self._is_updating:
            self._change_setting(control, control.to_value(place) if is_on else control.off)

    def _change_setting(self, control, value):
        self._set(control.name, changes={**self.session.state.changes, control.name: value})

    def _set(self, by="", **changes):
        if self._is_updating:
            return
        if by in self._fields:
            self._last_control = by
        self.session.set(replace(self.session.state, **changes), "" if self._is_step else by)
        self._is_step = False
        self._update_controls(by)

    def _camera(self, name):
        self._set(camera=name, changes={})

    def _tolerance(self, name):
        self._set(tolerance=name)

    def _luminance(self, value):
        self._set("luminance", luminance=value)

    def _split(self, place):
        self._set("split", split=place / PLACES)

    def _live(self, is_live):
        self._set(is_live=is_live, frame=self.session.number)

    def _measure(self, is_on):
        self._canvas.measures = is_on

    def _step(self, step):
        self._set(is_live=False, frame=(self.session.number + step) % self.session.producer.frames)

    def _scrub(self, number):
        if number is not None and number != self.session.number:
            self._set("frame", is_live=False, frame=int(number))

    def _set_other(self):
        state = self.session.state
        self._set(against={"camera": state.camera, "changes": state.changes})

    def _swap(self):
        state = self.session.state
        if state.against:
            self._set(**state.against, against={"camera": state.camera, "changes": state.changes})

    def _undo(self):
        self._step_history(self.session.history.undo)

    def _redo(self):
        self._step_history(self.session.history.redo)

    def _step_history(self, step):
        if step():
            self.session.touch()
            self._update_controls()

    def _on_key(self, event):
        if not event.action.keydown or (event.action.repeat and event.key == " "):
            return
        if event.modifiers.ctrl and event.key.name in ("z", "y"):
            (self._undo if event.key.name == "z" else self._redo)()
        elif event.key.name == " ":
            self._live(not self.session.state.is_live)
        elif event.key.name in "1234" and not event.modifiers.ctrl:
            self._set(view=VIEWS[int(event.key.name) - 1])
        elif event.key.name in ("+", "-"):
            self._canvas.zoom(1 if event.key.name == "+" else -1)
        elif event.key.name in (",", ".") and self._is_moving:
            self._step(1 if event.key.name == "." else -1)

    async def _error_map(self):
        session = self.session
        ui.notify("the exact frame is computed in float64: this takes seconds to minutes")
        with notify_errors():
            compare = await session.compute(session.producer.error, session.state, session.number)
            self._show_error_map(*await run.io_bound(compare))

    def _show_error_map(self, codes, error):
        from PIL import Image

        with ui.dialog(value=True), ui.card().classes("max-w-none").props(mark("error dialog")):
            ui.label(
                f"mean electrons less their truth: {error.rms:.2g} rms, {error.p999_sigma:.2g} of a pixel's noise "
                f"at 99.9 %, {error.max_sigma:.2g} at most; full red is {SPAN:g} rms too much, full blue less"
            )
            ui.image(Image.fromarray(codes)).classes("w-[80vw] max-w-full")

    # output of the page

    def _update_controls(self, only=""):
        """Put the settings into the controls.

        only: the control that moved, if no other can have changed.
        """
        state = self.session.state
        if only in ("split", "frame"):
            return
        if only not in CONTROLS:
            try:
                _, self._table = camera_table(state.camera)
            except GpusimError:
                return
        self._is_updating = True
        try:
            for control in [CONTROLS[only]] if only in CONTROLS else CONTROLS.values():
                self._show(control.name, state.value(control, self._table))
            if only in CONTROLS:
                return
            self._show("luminance", state.luminance)
            for name in ("view", "camera", "tolerance"):
                self._fields[name].value = getattr(state, name)
            self._fields["live"].value = state.is_live
            for name in ("swap", "no B", "split"):
                self._fields[name].visible = state.against is not None
            self._fields["split"].value = PLACES * state.split
            self._scene.update()
            self._light.update()
            if self._is_moving:
                self._fields["frame"].value = state.frame
        finally:
            self._is_updating = False

    def _show(self, name, value):
        field = self._fields[name]
        if not isinstance(field, tuple):
            field.value = value
            return
        slider, number, is_on, control = field
        there = isinstance(value, int | float) and value != control.off
        if there:
            place = control.to_place(value)
            if slider.value != place:
                slider.value = place
        number.value = value if there else None
        if is_on is not None:
            is_on.value = there

    def _refresh(self):
        session = self.session
        session.used = time.monotonic()
        self._fields["error"].text = session.error
        wrong = self._last_control if session.error else ""
        if wrong != self._refused:
            for name, error in ((self._refused, None), (wrong, session.error)):
                if name:
                    field = self._fields[name]
                    (field[1] if isinstance(field, tuple) else field).error = error
            self._refused = wrong
        waits = 0.0 if session.begun is None else time.monotonic() - session.begun
        self._fields["busy"].text = f"computing since {waits:.0f} s" if waits > PATIENT else ""
        shown = session.shown
        if shown is None:
            return
        self._canvas.follow(shown.codes.shape[:2])
        if self._is_moving and session.state.is_live:
            self._is_updating = True
            self._fields["frame"].value = shown.number
            self._is_updating = False
        self._fields["known"].text = (
            f"frame {shown.number}  {session.rate:4.1f} fps  {session.latency:4.0f} ms  made in {shown.ms:4.0f} ms  "
            f"{describe_exposure(shown.facts)}"
        )
        self._fields["left out"].text = describe_plan(shown.facts)

    async def _statistics(self):
        session = self.session
        if session.shown is None or session.error:
            return
        part = self._canvas.edge if self._canvas.measures else None
        try:
            found = await session.compute(
                session.producer.statistics,
                session.state,
                session.shown.number,
                self._canvas.at,
                part,
            )
        except Exception:
            return  # the picture says it, also of a device that fails
        self._fields["histogram"].content = histogram(found)
        if pixel := found.get("pixel"):
            self._fields["pixel"].text = (
                f"row {pixel['row']}  column {pixel['col']}  {pixel['electrons']:.4g} e-  "
                f"{pixel['dn']:.4g} DN  SNR {pixel['snr']:.1f} dB"
            )
        difference = ""
        if "difference" in found:
            difference = f"ColorChecker: mean Delta E 2000 {found['difference']:.2f}"
        self._fields["difference"].text = difference
        edge = found.get("edge", {})
        text, curve = edge.get("why", ""), ""
        if "mtf50" in edge:
            text = f"MTF50 {edge['mtf50']:.3f} cycle/pixel, edge at {edge['angle']:.1f} degrees"
            curve = response(edge)
        self._fields["edge"].text = text
        self._fields["response"].content = curve


def _group(name):
    """Return a group of controls that can be folded."""
    group = ui.expansion(name, value=name in OPEN)
    return group.classes("w-full").props(mark(f"group {name}"))


def mount(made, first: State, title: str, shape: tuple[int, int], start: Start) -> Sessions:
    """Add the page and its websocket to NiceGUI's application.

    made: makes a client's Producer. first: settings of a new page. Others: see `Page`.
    """
    from fastapi import WebSocket, WebSocketDisconnect

    sessions = Sessions(made, first)

    @ui.page("/")
    def page(s: str = "", state: str = ""):
        try:
            token, session = sessions.of(s, state)
        except GpusimError as error:
            ui.label(str(error)).classes("text-red-500")
            return
        Page(session, token, title, shape, start).build()
        ui.run_javascript(f"history.replaceState(null, '', '/?s={token}')")

    @app.websocket("/picture/{token}")
    async def picture(socket: WebSocket, token: str):
        session = sessions.find(token)
        if session is None:
            await socket.close(1008)
            return
        await socket.accept()

        async def wait_for_paint():
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect
            if len(message.get("text") or message.get("bytes") or "") > 16:
                await socket.close(1009)
                raise WebSocketDisconnect

        try:
            await session.serve(socket.send_bytes, wait_for_paint)
        except (WebSocketDisconnect, RuntimeError):
            pass  # it has gone

    return sessions
