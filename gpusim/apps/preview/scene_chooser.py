"""The scene on the preview's page: charts, sizes, files and how they are read."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from nicegui import run, ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.receiver import build_receiver, take_all_drops
from gpusim.apps.preview.scene_choice import (
    DEFAULT_SIZE,
    OPTIONS,
    SceneChoice,
    checked_size,
    parse_option,
)
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.uploads import ENVI_DATA, SCENES
from gpusim.data.charts import CHARTS
from gpusim.domain.errors import BadData, BadFile, GpusimError, OutOfRange
from gpusim.domain.scene import PANORAMA
from gpusim.io.scene.bands import SUFFIXES as BANDS
from gpusim.io.scene.option_texts import format_size

SIZES = ("320x240", "640x480", "768x512", "1280x720", "1920x1080")
AS_STARTED = "as started"  # the scenes of the command line


class SceneChooser:
    """Elements that choose the scene.

    Args:
        session: Session of the client.
        change: Function that takes changed fields of the state.
    """

    def __init__(self, session: Session, change: Callable[..., None]):
        self._session, self._change = session, change
        self._first = session.state.scene
        self._size = self._first.size or DEFAULT_SIZE  # of the next chart
        # one that cannot be opened, and the scene that stayed
        self._tried: SceneChoice | None = None
        self._stayed = ""
        self._error = ""
        self._is_updating = False
        self._shown = ""  # key of the scene whose settings are in the elements
        self._takes: tuple[str, ...] = ()
        self._fields: dict[str, Any] = {}

    @property
    def _choice(self) -> SceneChoice:
        """The scene whose settings are shown: after an undo, no more the one that was tried."""
        own = self._session.state.scene
        return self._tried if self._tried and self._stayed == own.key else own

    def build(self) -> None:
        """Make the elements."""
        with ui.row(wrap=False).classes("w-full items-center gap-2"):
            self._name = ui.select([*CHARTS], label="scene").classes("grow").props(mark("scene"))
            self._name.on_value_change(self._unless_updating(self._choose_name))
            self._sizes = ui.select(list(SIZES), label="size", new_value_mode="add-unique")
            self._sizes.classes("w-36").props(mark("size"))
            self._sizes.on_value_change(self._unless_updating(self._choose_size))
        self._said = ui.label().classes("gp-wrong").props(mark("scene error"))
        self._wanted = ui.label().classes("gp-busy whitespace-pre-wrap break-all")
        self._wanted.props(mark("wanted"))
        label = "drop a scene's file on the page, or choose it"
        take_all_drops(build_receiver("scene file", label, SCENES, self._session, self._take))
        self._reading = ui.expansion("how the scene is read").classes("w-full")
        with self._reading.props(mark("reading")):
            self._options = ui.column().classes("w-full gap-1")
        ui.timer(0.5, self.update)
        self.update()

    def update(self) -> None:
        """Show the scene of the settings."""
        choice, uploads = self._choice, self._session.producer.shelf.uploads
        if choice.key != self._shown:  # else it would undo what is being typed
            self._shown = choice.key
            self._show_choice(choice)
        self._said.text = self._error if choice is self._tried or not self._tried else ""
        state = self._session.state
        missing = uploads.missing(state.scene.files | state.used_files)
        self._wanted.text = "\n".join(
            [
                f"This link needs {name}, SHA-256 {sha}: drop it below."
                for name, sha in missing.items()
            ]
        )
        for label in (self._said, self._wanted):
            label.visible = bool(label.text)

    def _show_choice(self, choice):
        self._is_updating = True
        try:
            names = [AS_STARTED] if self._first.is_given else []
            names += [*CHARTS, *([choice.name] if choice.files else [])]
            if self._name.options != names:
                self._name.set_options(names)
            self._name.value = choice.name or AS_STARTED
            self._show_size(choice)
            self._show_options(choice)
        finally:
            self._is_updating = False

    def _show_size(self, choice):
        has_size = "size" in choice.takes or (choice.size is not None and not choice.is_given)
        self._sizes.visible = has_size
        if not has_size:
            return
        text = format_size(choice.size or DEFAULT_SIZE)
        if text not in self._sizes.options:
            self._sizes.set_options([*self._sizes.options, text])
        self._sizes.value = text
        self._size = choice.size or DEFAULT_SIZE

    def _show_options(self, choice):
        """Show a field for each option that the scene takes."""
        takes = tuple(name for name in choice.takes if name in OPTIONS)
        if takes != self._takes:
            self._takes, self._fields = takes, {}
            self._options.clear()
            with self._options:
                for name in takes:
                    self._fields[name] = self._make_field(name)
        for name, field in self._fields.items():
            text = choice.options.get(name)
            field.value = text or None if OPTIONS[name].choices else text or ""

    def _make_field(self, name):
        option = OPTIONS[name]
        if option.choices:
            field: Any = ui.select(list(option.choices), label=option.label, clearable=True)
            field.on_value_change(self._unless_updating(partial(self._choose_option, name)))
        else:
            field = ui.input(option.label).tooltip(option.wanted)
            field.on("change", lambda: self._choose_option(name, field.value))
        return field.classes("w-full").props(mark(f"option {name}"))

    # actions

    def _unless_updating(self, does):
        """Return the handler of an element's values; the ones that `update` sets change nothing."""
        return lambda event: None if self._is_updating else does(event.value)

    async def _choose_name(self, name):
        if name is None or name == self._choice.name:
            return
        if name == AS_STARTED:
            await self.show(self._first)
        elif name in CHARTS:
            await self.show(SceneChoice(name, size=self._size))

    async def _choose_size(self, text):
        if text is None:
            return
        try:
            await self.show(replace(self._choice, size=checked_size(text)))
        except OutOfRange as error:
            self._error, self._shown = str(error), ""
            self._sizes.set_options([one for one in self._sizes.options if one != text])
            self.update()

    async def _choose_option(self, name, text):
        options = {key: value for key, value in self._choice.options.items() if key != name}
        options |= {name: text.strip()} if text and text.strip() else {}
        try:
            if name in options:
                parse_option(name, options[name])
        except BadData as error:
            self._error = str(error)
            self.update()
            return
        await self.show(replace(self._choice, options=options))

    async def _take(self, files):
        await self.show(choice_of_files(files, self._choice))

    async def show(self, choice: SceneChoice) -> None:
        """Show a scene; one that cannot be opened leaves the last one, and says why."""
        shelf = self._session.producer.shelf
        self._error, self._tried = "", None
        if not choice.is_given:
            try:
                scene = await run.io_bound(shelf.open, choice)
            except GpusimError as error:
                self._error, self._tried = str(error), choice
                self._stayed = self._session.state.scene.key
                self._reading.value = bool(choice.files)
                self.update()
                return
            if scene is None:
                return  # the server ends
            if scene.projection == PANORAMA and choice.size is None:
                choice = replace(choice, size=self._size)
                shelf.put(choice, scene)
        self._change(scene=choice)
        self.update()


def choice_of_files(files: dict[str, str], before: SceneChoice) -> SceneChoice:
    """Return the scene of files that were sent together.

    Args:
        files: Name -> SHA-256.
        before: The scene before: the data of an ENVI file may follow its header.

    Returns:
        The scene: of one file, of an ENVI header with its data, or of a folder of bands.

    Raises:
        BadFile: If the files are neither.
    """
    names = list(files)
    headers = [name for name in names if name.lower().endswith(".hdr")]
    data = [name for name in names if name.lower().endswith(ENVI_DATA)]
    if len(names) == 1 and not data:
        return SceneChoice(names[0], files)
    if data and not headers and before.suffix == ".hdr":
        return replace(before, files=before.files | files)
    if data and not headers:
        raise BadFile(data[0], "the samples of an ENVI file; send its header .hdr with it")
    if len(headers) == 1 and len(headers) + len(data) == len(names):
        return SceneChoice(headers[0], files)
    if all(name.lower().endswith(BANDS) for name in names):
        stem = re.split(r"[\W_]*\d", names[0])[0]
        return SceneChoice(f"{stem or 'scene'} bands", files)
    raise BadFile(
        names[0],
        f"{len(names)} files at once; allowed are one scene, an ENVI header with its data, or the bands of "
        "a scene; send other scenes one by one",
    )
