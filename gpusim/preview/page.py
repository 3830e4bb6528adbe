"""The preview's page: controls, the picture, and what is known of it."""

import secrets
import tempfile
import time
from dataclasses import replace
from functools import partial
from math import isfinite, log
from pathlib import Path
from typing import Any

from nicegui import app, ui

from gpusim.data.cameras import camera_names, camera_table
from gpusim.domain.errors import GpusimError
from gpusim.preview.controls import CONTROLS, GROUPS, LIGHTS, OWN, PLACES, TOLERANCES, VIEWS, Control
from gpusim.preview.known import histogram, of_exposure, of_plan
from gpusim.preview.producer import Producer
from gpusim.preview.session import Session
from gpusim.preview.state import State

LEFT = 600.0  # [s] that a session without a page is kept
MOST_SESSIONS = 16  # each holds its scene on the device
PATIENT = 1.0  # [s] of a picture, after which the page says that it is being made
OPEN = ("Exposure", "Lens")  # groups, at first
FORMATS = (".png", ".dng", ".exr", ".npz")
# A control that glides to its new place has the page laid out and painted at every refresh of the screen
STYLE = """
.q-slider *, .q-field, .q-field *, .q-checkbox *, .q-focus-helper {
    transition: none !important; animation: none !important;
}
"""


def mark(name: str) -> str:
    """Properties of an element by which tests find it."""
    return f'data-mark="{name}"'


class Picture(ui.element, component="picture.js"):  # type: ignore[call-arg]  # where there is no NiceGUI
    """The canvas. url: of its websocket. width, height: of the frames [pixel]."""

    def __init__(self, url: str, width: int, height: int):
        super().__init__()
        self._props.update(url=url, width=width, height=height)


class Sessions:
    """Those of all clients by their tokens; what nobody has used for long goes. made: a Producer. first: State."""

    def __init__(self, made, first: State):
        self._made, self._first = made, first
        self._known: dict[str, Session] = {}

    def of(self, token: str, link: str = "") -> tuple[str, Session]:
        """A client's, by its token, or a new one, with the settings of a link. Raises BadData."""
        now = time.monotonic()
        for name, session in list(self._known.items()):
            if now - session.used > LEFT:
                del self._known[name]
        if token in self._known:
            self._known[token].used = now
            return token, self._known[token]
        while len(self._known) >= MOST_SESSIONS:
            del self._known[min(self._known, key=lambda name: self._known[name].used)]
        state = State.of_link(link, self._first.camera) if link else self._first
        token = secrets.token_urlsafe(16)
        self._known[token] = Session(self._made(), state)
        return token, self._known[token]

    def known(self, token: str) -> Session | None:
        """A client's, or None."""
        return self._known.get(token)


class Page:
    """One client's page. title: of the scene; shape: rows and columns of its frames."""

    def __init__(self, session: Session, token: str, title: str, shape: tuple[int, int], scene: str):
        self.session, self._token, self._title, self._shape, self._scene = session, token, title, shape, scene
        self._fields: dict[str, Any] = {}
        self._setting = False  # while the page follows the settings, and not they it
        self._at: tuple[int, int] | None = None
        self._is_step = False  # whether the next change is one, whatever was before
        self._turned = ""  # the control that was moved last
        self._refused = ""  # one beside which a reason stands
        self._table: dict = {}

    def build(self):
        """Make the page's elements."""
        ui.page_title(f"gpusim: {self._title}")
        ui.dark_mode(True)
        ui.add_css(STYLE)
        ui.query("body").classes("bg-neutral-900")
        with ui.row(wrap=True).classes("w-full items-start gap-4 p-2"):
            with ui.column().classes("grow basis-[640px] min-w-[280px] gap-2"):
                self._build_picture()
                self._build_known()
            with ui.column().classes("w-full max-w-[420px] gap-1"):
                self._build_top()
                for name, controls in GROUPS.items():
                    with ui.expansion(name, value=name in OPEN).classes("w-full").props(mark(f"group {name}")):
                        for control in controls:
                            self._build_control(control)
                self._build_scene()
        ui.keyboard(on_key=self._on_key)
        ui.timer(0.25, self._refresh)
        ui.timer(0.5, self._statistics)
        self._follow()

    def _build_picture(self):
        rows, cols = self._shape
        with ui.element("div").classes("relative w-full"):
            Picture(f"/picture/{self._token}", cols, rows)
            with ui.element("div").classes("absolute inset-0"):  # of its own: the image is placed relative to itself
                ui.interactive_image(size=(cols, rows), events=["mousemove"], on_mouse=self._on_mouse)
        with ui.row().classes("w-full items-center gap-2"):
            self._fields["view"] = ui.toggle(list(VIEWS), on_change=lambda event: self._set(view=event.value)).props(
                "dense no-caps").props(mark("view"))
            self._fields["live"] = ui.switch("live noise", on_change=lambda event: self._live(event.value)).props(
                mark("live"))
            ui.button(icon="undo", on_click=self._undo).props("flat dense").tooltip("undo (Ctrl+Z)").props(mark("undo"))
            ui.button(icon="redo", on_click=self._redo).props("flat dense").tooltip("redo (Ctrl+Y)").props(mark("redo"))

    def _build_known(self):
        self._fields["error"] = ui.label().classes("text-red-400 whitespace-pre-wrap").props(mark("error"))
        self._fields["busy"] = ui.label().classes("text-amber-400").props(mark("busy"))
        self._fields["known"] = ui.label().classes("text-sm text-neutral-300 font-mono").props(mark("known"))
        self._fields["pixel"] = ui.label().classes("text-sm text-neutral-300 font-mono").props(mark("pixel"))
        self._fields["histogram"] = ui.html("", sanitize=False).classes("w-full max-w-[640px]")
        self._fields["left out"] = ui.label().classes("text-xs text-neutral-400 whitespace-pre-wrap").props(
            mark("left out"))

    def _build_top(self):
        with ui.row().classes("w-full items-center gap-2"):
            names = camera_names()
            own = self.session.state.camera
            self._fields["camera"] = ui.select([*names, *([] if own in names else [own])], label="camera", on_change=(
                lambda event: self._camera(event.value))).classes("grow").props(mark("camera"))
            self._fields["tolerance"] = ui.select(list(TOLERANCES), label="tolerance", on_change=lambda event: (
                self._set(tolerance=event.value))).classes("grow").props(mark("tolerance"))
            with ui.button("Save", icon="save").props("dense").props(mark("save")), ui.menu():
                ui.menu_item("camera.toml", self._save_camera).props(mark("save camera"))
                for suffix in FORMATS:
                    ui.menu_item(f"frame{suffix}", partial(self._save_frame, suffix)).props(mark(f"save {suffix}"))
                ui.menu_item("link and command line", self._show_link).props(mark("show link"))

    def _build_scene(self):
        with ui.expansion("Light").classes("w-full").props(mark("group Light")):
            self._fields["light"] = ui.select([OWN, *LIGHTS], label="light", on_change=lambda event: self._set(
                light=None if event.value == OWN else event.value)).classes("w-full").props(mark("light"))
            self._slider("luminance", "white", "cd/m2", 0.1, 1e5, True, lambda value: self._set("luminance",
                                                                                                luminance=value))

    def _build_control(self, control: Control):
        name = control.name
        if control.choices:
            self._fields[name] = ui.select(list(control.choices), label=control.label, on_change=lambda event: (
                self._turn(control, event.value))).classes("w-full").props(mark(name))
            return
        self._slider(name, control.label, control.unit, control.low, control.high, control.is_log,
                     lambda value: self._turn(control, value), control)

    def _slider(self, name, label, unit, low, high, is_log, turned, control=None):
        def to_place(value):
            value = min(max(value, low), high)
            return round(PLACES * (log(value / low) / log(high / low) if is_log else (value - low) / (high - low)))

        def to_value(place):
            part = place / PLACES
            return float(f"{low * (high / low) ** part if is_log else low + (high - low) * part:.4g}")

        with ui.row(wrap=False).classes("w-full items-center gap-2 -my-1"):
            is_on = None
            if control is not None and control.off is not None:
                is_on = ui.checkbox(on_change=lambda event: self._switch(control, event.value, to_value(slider.value))
                                    ).props("dense").props(mark(f"{name} on"))
            ui.label(label).classes("w-24 text-sm shrink-0")
            slider = ui.slider(min=0, max=PLACES, on_change=lambda event: self._slid(turned, to_value(event.value))
                               ).classes("grow").props(f'aria-label="{label}"').props(mark(name))
            number = ui.number(suffix=unit or None).props("dense borderless").classes("w-28 shrink-0").props(
                mark(f"{name} number")).on("change", lambda: self._typed(turned, number.value))
        self._fields[name] = (slider, number, is_on, to_place, control)

    # what a control does

    def _slid(self, turned, value):
        if not self._setting:
            turned(value)

    def _typed(self, turned, value):
        """A number was entered: a step of its own, also beside those of the slider."""
        self._is_step = True
        if value is not None and isfinite(value):
            turned(float(value))
        else:
            self._follow()

    def _switch(self, control, is_on, value):
        if not self._setting:
            self._turn(control, value if is_on else control.off)

    def _turn(self, control, value):
        self._set(control.name, changes={**self.session.state.changes, control.name: value})

    def _set(self, by="", **changes):
        if self._setting:
            return
        if by in self._fields:
            self._turned = by
        self.session.set(replace(self.session.state, **changes), "" if self._is_step else by)
        self._is_step = False
        self._follow(by)

    def _camera(self, name):
        self._set(camera=name, changes={})

    def _live(self, is_live):
        self._set(is_live=is_live, frame=self.session.number)

    def _undo(self):
        if self.session.history.undo():
            self.session.touch()
            self._follow()

    def _redo(self):
        if self.session.history.redo():
            self.session.touch()
            self._follow()

    def _on_key(self, event):
        if not event.action.keydown or (event.action.repeat and event.key == " "):
            return
        if event.modifiers.ctrl and event.key.name in ("z", "y"):
            (self._undo if event.key.name == "z" else self._redo)()
        elif event.key.name == " ":
            self._live(not self.session.state.is_live)
        elif event.key.name in "1234" and not event.modifiers.ctrl:
            self._set(view=VIEWS[int(event.key.name) - 1])

    def _on_mouse(self, event):
        self._at = int(event.image_y), int(event.image_x)

    # what the page shows

    def _follow(self, only=""):
        """Put the settings into the controls. only: the one that was moved, where no other can have changed."""
        state = self.session.state
        if only not in CONTROLS:
            try:
                _, self._table = camera_table(state.camera)
            except GpusimError:
                return
        self._setting = True
        try:
            for control in [CONTROLS[only]] if only in CONTROLS else CONTROLS.values():
                self._show(control.name, state.value(control, self._table))
            if only in CONTROLS:
                return
            self._show("luminance", state.luminance)
            for name, value in (("view", state.view), ("live", state.is_live), ("camera", state.camera),
                                ("tolerance", state.tolerance), ("light", state.light or OWN)):
                self._fields[name].value = value
        finally:
            self._setting = False

    def _show(self, name, value):
        field = self._fields[name]
        if not isinstance(field, tuple):
            field.value = value
            return
        slider, number, is_on, to_place, control = field
        there = isinstance(value, int | float) and (control is None or value != control.off)
        if there:
            place = to_place(value)
            if slider.value != place:
                slider.value = place
        number.value = value if there else None
        if is_on is not None:
            is_on.value = there

    def _refresh(self):
        session = self.session
        session.used = time.monotonic()
        self._fields["error"].text = session.error
        wrong = self._turned if session.error else ""
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
        self._fields["known"].text = (
            f"frame {shown.number}  {session.rate:4.1f} fps  {session.latency:4.0f} ms  made in {shown.ms:4.0f} ms  "
            f"{of_exposure(shown.facts)}")
        self._fields["left out"].text = of_plan(shown.facts)

    async def _statistics(self):
        session = self.session
        if session.shown is None or session.error:
            return
        try:
            found = await session.computed(session.producer.statistics, session.state, self._at)
        except Exception:
            return  # the picture says it, also of a device that fails
        self._fields["histogram"].content = histogram(found)
        if pixel := found.get("pixel"):
            self._fields["pixel"].text = (f"row {pixel['row']}  column {pixel['col']}  {pixel['electrons']:.4g} e-  "
                                          f"{pixel['dn']:.4g} DN  SNR {pixel['snr']:.1f} dB")

    # what is saved

    def _save_camera(self):
        try:
            self.session.state.built()
            ui.download.content(self.session.state.toml(), "camera.toml")
        except GpusimError as error:
            ui.notify(str(error), type="negative")

    async def _save_frame(self, suffix):
        session = self.session
        number = session.shown.number if session.shown else session.state.frame
        try:
            data = await session.computed(_saved, session.producer, session.state, number, suffix)
        except GpusimError as error:
            ui.notify(str(error), type="negative")
            return
        ui.download.content(data, f"frame{suffix}")

    def _show_link(self):
        state = self.session.state
        with ui.dialog() as dialog, ui.card().classes("max-w-[640px]"):
            ui.label("The page with these settings:")
            ui.code(f"/?state={_quoted(state.link())}").props(mark("link"))
            ui.label("The same on the command line, with the camera saved beside it:")
            ui.code(state.command(self._scene)).props(mark("command"))
        dialog.open()


def _saved(producer, state, number, suffix):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"frame{suffix}"
        producer.frame(state, number).save(path)
        return path.read_bytes()


def _quoted(text):
    from urllib.parse import quote

    return quote(text, safe="")


def mount(made, first: State, title: str, shape: tuple[int, int], scene: str) -> Sessions:
    """Put the page and its websocket into NiceGUI's application. made: gives a client's Producer."""
    from fastapi import WebSocket, WebSocketDisconnect

    sessions = Sessions(made, first)

    @ui.page("/")
    def page(s: str = "", state: str = ""):
        try:
            token, session = sessions.of(s, state)
        except GpusimError as error:
            ui.label(str(error)).classes("text-red-500")
            return
        Page(session, token, title, shape, scene).build()
        ui.run_javascript(f"history.replaceState(null, '', '/?s={token}')")

    @app.websocket("/picture/{token}")
    async def picture(socket: WebSocket, token: str):
        session = sessions.known(token)
        if session is None:
            await socket.close(1008)
            return
        await socket.accept()

        async def acknowledged():
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect
            if len(message.get("text") or message.get("bytes") or "") > 16:
                await socket.close(1009)
                raise WebSocketDisconnect

        try:
            await session.serve(socket.send_bytes, acknowledged)
        except (WebSocketDisconnect, RuntimeError):
            pass  # it has gone

    return sessions


def producer_of(scene, device) -> Producer:
    """A client's own, on the device that all of them share."""
    return Producer(scene, device)
