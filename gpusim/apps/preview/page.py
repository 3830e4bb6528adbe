"""The preview's page: controls, the picture and its data."""

import time
from dataclasses import replace
from functools import partial
from typing import Any

from nicegui import ui

from gpusim.apps.preview.canvas import Canvas, mark
from gpusim.apps.preview.compare_bar import CompareBar
from gpusim.apps.preview.comparison import describe_step, name_pictures
from gpusim.apps.preview.control import Control, as_text
from gpusim.apps.preview.controls import CONTROLS, GROUPS, LUMINANCE, TOLERANCES, VIEWS
from gpusim.apps.preview.dock import Dock
from gpusim.apps.preview.errormap import ErrorMap
from gpusim.apps.preview.fields import Field, Group
from gpusim.apps.preview.filmstrip import Filmstrip
from gpusim.apps.preview.labels import describe_exposure, describe_plan
from gpusim.apps.preview.light_chooser import LightChooser
from gpusim.apps.preview.receiver import notify_errors
from gpusim.apps.preview.recipes import Start
from gpusim.apps.preview.saving import SaveMenu
from gpusim.apps.preview.scene_chooser import SceneChooser
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.style import STYLE
from gpusim.domain.errors import GpusimError
from gpusim.io.camera.cameras import camera_names, camera_table

FOCUS = "optics.object_distance_m"
PATIENT = 1.0  # [s] of a picture, after which the page says that it is being made


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
        self._dock, self._errors = Dock(session, self._canvas), ErrorMap(session)
        self._elements: dict[str, Any] = {}
        self._fields: dict[str, Field] = {}
        self._groups: list[Group] = []
        self._is_updating = False  # while the page follows the settings, and not they it
        self._metered: dict = {}  # what the camera chose, by the names of controls
        self._held: dict = {}  # those of the session that are shown
        self._table: dict = {}

    def build(self):
        """Make the page's elements."""
        ui.page_title(f"gpusim: {self._title}")
        self._theme = ui.dark_mode(True)
        ui.add_css(STYLE)
        ui.add_head_html("<script>document.documentElement.lang = 'en'</script>")
        with ui.element("div").classes("gp-page"):
            with ui.element("div").classes("gp-head"):
                self._build_head()
            with ui.element("div").classes("gp-stage"):
                self._canvas.build()
            with ui.element("div").classes("gp-tools"):
                self._films.build()
                self._build_tools()
            below = ui.element("div").classes("gp-below")
            with below.props('tabindex=0 role=region aria-label="measurements"'):
                self._dock.build()
            with ui.element("div").classes("gp-side"):
                self._build_side()
        ui.keyboard(on_key=self._on_key)
        ui.timer(0.25, self._refresh)
        ui.timer(0.1, self._dock.refresh)
        self._update_controls()

    def _build_head(self):
        with ui.element("div").classes("gp-bar"):
            with ui.element("h1").classes("gp-title"):
                self._heading = ui.label(self._title)
            self._icon("undo", "undo (Ctrl+Z)", self._undo)
            self._icon("redo", "redo (Ctrl+Y)", self._redo)
            self._icon("history", "steps, to go back to any of them", self._show_history)
            self._icon("contrast", "light or dark page", self._theme.toggle)
            self._icon("fullscreen", "full screen", ui.fullscreen().toggle)
            self._saving.build()

    def _build_tools(self):
        with ui.element("div").classes("gp-bar"):
            view = ui.toggle(list(VIEWS), on_change=lambda event: self._set(view=event.value))
            self._keep("view", view.props("dense no-caps toggle-color=blue-9"))
            self._switch("live", "play" if self._is_moving else "live noise", self._live)
            self._icon("zoom_out", "smaller (-)", lambda: self._canvas.zoom(-1))
            larger = "larger, without loss (+); click in the picture; drag to move"
            self._icon("zoom_in", larger, lambda: self._canvas.zoom(1))
            self._icon("fit_screen", "the whole picture (0)", self._canvas.fit)
            words = "drag over a slanted edge: its frequency response (ISO 12233)"
            self._switch("measure", "edge", self._measure).tooltip(words)
            words = "click in the picture: the camera focuses on the distance there"
            self._switch("pick focus", "focus", self._pick_focus).tooltip(words)
            self._button("error map", "error map", self._errors.open)
            words = "stripes on clipped pixels: red saturated, blue at digital number 0"
            self._switch("clipping", "clipping", self._mark_clipping).tooltip(words)
            if self._is_moving:
                self._icon("skip_previous", "frame before (,)", lambda: self._step(-1))
                self._icon("skip_next", "next frame (.)", lambda: self._step(1))
                last = self.session.producer.frames - 1
                self._bar("frame", "frame", last, self._scrub, "w-60")
        self._compare = CompareBar(self.session, self._set, self._name_pictures)
        for name, classes in (
            ("error", "gp-wrong"),
            ("busy", "gp-busy"),
            ("known", "gp-known"),
            ("left out", "gp-quiet"),
            ("clipped", "gp-known"),
        ):
            self._keep(name, ui.label(), classes)

    def _build_side(self):
        with ui.element("div").classes("gp-bar"):
            names = camera_names()
            own = self.session.state.camera
            cameras = [*names, *([] if own in names else [own])]
            self._choice("camera", "camera", cameras, self._camera, "grow")
            self._choice("tolerance", "tolerance", TOLERANCES, self._tolerance, "grow")
        search = ui.input(placeholder="search the controls", on_change=self._search)
        search.props(f'dense clearable {mark("search")} aria-label="search the controls"')
        search.classes("w-full")
        with self._group(
            "Scene", "chart size file samples per pixel outside field of view"
        ).element:
            self._scene.build()
        for name, controls in GROUPS.items():
            group = self._group(name)
            with group.element:
                group.fields = [self._build_control(control) for control in controls]
        group = self._group("Light", "illuminant temperature lamp file")
        with group.element:
            self._light.build()
            reset = partial(self._set, luminance=None)
            self._luminance = Field(LUMINANCE, self._take_luminance, reset, "luminance")
            group.fields = [self._luminance]

    def _group(self, name, words=""):
        self._groups.append(Group(name, words))
        return self._groups[-1]

    def _build_control(self, control: Control):
        change, reset = partial(self._change, control.name), partial(self._reset, control.name)
        field = self._fields[control.name] = Field(control, change, reset)
        return field

    def _search(self, event):
        for group in self._groups:
            group.search(event.value or "")

    # elements

    def _keep(self, name, element, classes=""):
        """Register an element: the page finds it by its name, and so do tests."""
        self._elements[name] = element.classes(classes).props(mark(name))
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

    # actions of the controls

    def _change(self, name, value, is_step):
        """Take a value of a control. is_step: whether it is a step of its own, unlike a slider's."""
        if self._is_updating:
            return
        self.session.set(self.session.state.change(name, value), name, is_step)
        self._update_controls(name)

    def _reset(self, name):
        self.session.forget_held(name)
        if name in self.session.state.changes:
            self.session.set(self.session.state.reset(name))
        self._update_controls()

    def _take_luminance(self, value, is_step):
        if not self._is_updating:
            state = replace(self.session.state, luminance=value)
            self.session.set(state, "luminance", is_step)
            self._update_controls()

    def _set(self, by="", **changes):
        if self._is_updating:
            return
        self.session.set(replace(self.session.state, **changes), by)
        self._update_controls(by)

    def _camera(self, name):
        self._set(camera=name, changes={})

    def _tolerance(self, name):
        self._set(tolerance=name)

    def _live(self, is_live):
        self._set(is_live=is_live, frame=self.session.number)

    def _mark_clipping(self, is_on):
        self._set(marks_clipped=is_on)

    def _measure(self, is_on):
        self._canvas.measures = is_on

    def _pick_focus(self, is_on):
        self._canvas.on_pick = self._focus if is_on else None

    async def _focus(self, row, col):
        with notify_errors():
            distance = await self.session.compute(self.session.producer.distance, (row, col))
            self._change(FOCUS, float(f"{distance:.4g}"), True)

    def _step(self, step):
        self._set(is_live=False, frame=(self.session.number + step) % self.session.producer.frames)

    def _scrub(self, number):
        if number is not None and number != self.session.number:
            self._set("frame", is_live=False, frame=int(number))

    def _undo(self):
        self._step_history(self.session.history.undo)

    def _redo(self):
        self._step_history(self.session.history.redo)

    def _step_history(self, step):
        if self.session.step(step):
            self._update_controls()

    def _show_history(self):
        states, at = self.session.history.steps
        with ui.dialog(value=True) as dialog, ui.card().props(mark("steps")):
            with ui.column().classes("gap-0 max-h-[70vh] overflow-y-auto"):
                for place in reversed(range(len(states))):
                    words = (
                        describe_step(states[place - 1], states[place]) if place else "the start"
                    )
                    button = ui.button(words, on_click=partial(self._go_to, dialog, place))
                    color = "primary" if place == at else "secondary"
                    button.props(
                        f"flat dense no-caps align=left color={color} {mark(f'step {place}')}"
                    )

    def _go_to(self, dialog, place):
        dialog.close()
        self._step_history(partial(self.session.history.go_to, place))

    def _on_key(self, event):
        if not event.action.keydown or (event.action.repeat and event.key == " "):
            return
        if event.modifiers.ctrl and event.key.name in ("z", "y"):
            (self._undo if event.key.name == "z" else self._redo)()
        elif event.key.name == " ":
            self._live(not self.session.state.is_live)
        elif event.key.name in "123456" and not event.modifiers.ctrl:
            self._set(view=VIEWS[int(event.key.name) - 1])
        elif event.key.name in ("+", "-"):
            self._canvas.zoom(1 if event.key.name == "+" else -1)
        elif event.key.name == "0":
            self._canvas.fit()
        elif event.key.name in (",", ".") and self._is_moving:
            self._step(1 if event.key.name == "." else -1)

    # output of the page

    def _update_controls(self, only=""):
        """Put the settings into the controls.

        only: the control that moved, if no other can have changed.
        """
        state = self.session.state
        if only in ("split", "frame"):
            return
        self._is_updating = True
        try:
            if only not in CONTROLS:
                _, self._table = camera_table(state.camera)
            for name in [only] if only in CONTROLS else CONTROLS:
                self._show(name)
            if only in CONTROLS:
                return
            given = state.luminance is not None
            self._luminance.show(state.luminance, given)
            for name in ("view", "camera", "tolerance"):
                self._elements[name].value = getattr(state, name)
            self._elements["live"].value = state.is_live
            self._elements["clipping"].value = state.marks_clipped
            self._compare.show()
            self._name_pictures()
            self._scene.update()
            self._light.update()
            if self._is_moving:
                self._elements["frame"].value = state.frame
        except GpusimError:
            return  # of the camera's file; the picture says it
        finally:
            self._is_updating = False

    def _name_pictures(self):
        """Write the scene's name over the page, and on compared pictures the cameras'."""
        state = self.session.state
        title = state.scene.name or self._title
        if self._heading.text != title:
            self._heading.text = title
            ui.page_title(f"gpusim: {title}")
        self._canvas.name_pictures(name_pictures(state), state.compare == "side by side")

    def _show(self, name):
        """Show a control: its value, one that is not used with the reason, and what the camera chose."""
        state, held = self.session.state, self.session.held.get(name)
        field = self._fields[name]
        value = held.value if held else state.value(field.control, self._table)
        metered = self._metered.get(name) if value == field.control.off else None
        field.show(value, name in state.changes, held.reason if held else "", metered)

    def _refresh(self):
        session = self.session
        session.used = time.monotonic()
        held = dict(session.held)
        self._elements["error"].text = session.error or "; ".join(
            f"{CONTROLS[name].label} = {as_text(one.value)} is not used: {one.reason}"
            for name, one in held.items()
        )
        changed = {
            name for name in {**held, **self._held} if held.get(name) != self._held.get(name)
        }
        self._held = held
        waits = 0.0 if session.begun is None else time.monotonic() - session.begun
        self._elements["busy"].text = f"computing since {waits:.0f} s" if waits > PATIENT else ""
        shown = session.shown
        if shown is not None:
            if shown.facts["metered"] != self._metered:
                self._metered = shown.facts["metered"]
                changed |= {*self._metered}
            self._show_facts(shown)
        for name in changed:
            self._show(name)

    def _show_facts(self, shown):
        session = self.session
        self._canvas.follow(shown.facts["shape"], shown.count)
        pick = self._elements["pick focus"]
        pick.visible = shown.facts["has depth"]
        if not pick.visible and pick.value:
            pick.value = False  # clicks enlarge again
        if self._is_moving and session.state.is_live:
            self._is_updating = True
            self._elements["frame"].value = shown.number
            self._is_updating = False
        self._elements["known"].text = (
            f"frame {shown.number}  {session.rate:4.1f} fps  {session.latency:4.0f} ms  made in {shown.ms:4.0f} ms  "
            f"{describe_exposure(shown.facts)}"
        )
        self._elements["left out"].text = describe_plan(shown.facts)
        self._elements["clipped"].text = shown.facts.get("clipped", "")
