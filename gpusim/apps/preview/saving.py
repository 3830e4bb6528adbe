"""Files and texts that the preview's page saves: camera, frame, report, and how to make a frame again."""

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

from nicegui import ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.receiver import notify_errors
from gpusim.apps.preview.recipes import (
    CAMERA,
    SAVED,
    Start,
    address_of,
    command_line,
    notebook_cell,
    notes_on_command,
)
from gpusim.apps.preview.session import Session
from gpusim.domain.errors import GpusimError
from gpusim.domain.scene import PANORAMA
from gpusim.io.camera.cameras import camera_names

ADDRESS = "return location.origin + location.pathname"


class SaveMenu:
    """The menu "Save".

    Args:
        session: Session of the client.
        start: How the preview was started.
    """

    def __init__(self, session: Session, start: Start):
        self._session, self._start = session, start

    def build(self) -> None:
        """Make the elements."""
        with (
            ui.button("Save", icon="save", color=None).props(f"dense flat no-caps {mark('save')}"),
            ui.menu(),
        ):
            self._build_item(CAMERA, "save camera", self._save_camera)
            for suffix in SAVED:
                self._build_item(f"frame{suffix}", f"save {suffix}", partial(self._save, suffix))
            self._build_item("report.txt", "save report", self._save_report)
            self._build_item("link, command, notebook cell", "show link", self._show)

    def _build_item(self, words, name, does):
        ui.menu_item(words, does).props(mark(name))

    @property
    def _number(self):
        shown = self._session.shown
        return shown.number if shown else self._session.state.frame

    def _save_camera(self):
        with notify_errors():
            state = self._session.state
            self._session.producer.build(state)  # raises if there is no such camera
            ui.download.content(state.toml(), CAMERA)

    async def _save(self, suffix):
        session = self._session
        with notify_errors():
            arguments = session.producer, session.state, self._number, suffix
            data = await session.compute(read_saved, *arguments)
            ui.download.content(data, f"frame{suffix}")

    async def _save_report(self):
        session = self._session
        with notify_errors():
            frame = await session.compute(session.producer.frame, session.state, self._number)
            ui.download.content(f"{frame.report}\n", "report.txt")

    async def _show(self):
        state, number = replace(self._session.state, frame=self._number), self._number
        start, shelf = self._start, self._session.producer.shelf
        page = await ui.run_javascript(ADDRESS, timeout=10.0)
        try:
            choice = state.scene
            is_panorama = bool(choice.files) and shelf.open(choice).projection == PANORAMA
            cell = notebook_cell(state, number, start, is_panorama)
        except GpusimError as error:
            cell = f"# {error}\n"
        command = command_line(state, number, start)
        with ui.dialog(value=True) as dialog, ui.card().classes("max-w-[900px] w-full"):
            ui.label("The page with these settings:")
            ui.code(address_of(page, state), language="text").props(mark("link")).classes("w-full")
            for words in _notes_on_link(state):
                ui.label(words).classes("text-sm")
            ui.label(
                f"This frame on the command line. {' '.join(notes_on_command(state, number, start))}"
            )
            ui.code(command, language="bash").props(mark("command")).classes("w-full")
            ui.label("This frame in Python:")
            ui.code(cell, language="python").props(mark("cell")).classes("w-full")
            ui.button("close", on_click=dialog.close).props("flat")


def _notes_on_link(state):
    """Return what a user of the link must know, as sentences."""
    notes = []
    if state.scene.is_given:
        notes.append(
            "It shows the scenes of the preview that opens it: start that one as this one."
        )
    if names := [*state.scene.files, *state.used_files]:
        notes.append(f"Where it is opened, the page asks for {', '.join(names)}.")
    if state.camera not in camera_names():
        notes.append(
            f"No link holds a camera's file: send {CAMERA}, and start the preview with it."
        )
    return notes


def read_saved(producer, state, number: int, suffix: str) -> bytes:
    """Return the bytes of a frame's file. Raises as `Producer.frame` and `Frame.save` do."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"frame{suffix}"
        producer.frame(state, number).save(path)
        return path.read_bytes()
