"""The light of the scene on the preview's page: a name, a temperature, or a lamp's file."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.controls import OWN
from gpusim.apps.preview.receiver import build_receiver
from gpusim.apps.preview.session import Session
from gpusim.data.lights import FILES, TEMPERATURE, illuminant, illuminant_names
from gpusim.domain.errors import GpusimError

DAYLIGHT = 4000.0  # [K] from which a temperature is daylight's; below it is a blackbody's


class LightChooser:
    """Elements that choose the light.

    Args:
        session: Session of the client.
        change: Function that takes changed fields of the state.
    """

    def __init__(self, session: Session, change: Callable[..., None]):
        self._session, self._change = session, change
        self._is_updating = False
        self._name: Any = None
        self._kelvin: Any = None

    def build(self) -> None:
        """Make the elements."""
        names = [name for name in illuminant_names() if "<" not in name]
        with ui.row(wrap=False).classes("w-full items-center gap-2"):
            self._name = ui.select([OWN, *names], label="light", with_input=True)
            self._name.on_value_change(lambda event: self._choose(event.value))
            self._name.classes("grow").props(mark("light"))
            self._kelvin = ui.number(label="temperature", suffix="K").classes("w-32")
            self._kelvin.props(mark("temperature"))
            self._kelvin.on("change", lambda: self._take_temperature(self._kelvin.value))
        build_receiver(
            "lamp file", "drop a lamp's spectrum here", FILES, self._session, self._take_files
        )
        self.update()

    def update(self) -> None:
        """Show the light of the settings."""
        light = self._session.state.light
        self._is_updating = True
        try:
            if (light or OWN) not in self._name.options:
                self._name.options.append(light)
                self._name.update()
            self._name.value = light or OWN
            match = TEMPERATURE.fullmatch((light or "").lower())
            self._kelvin.value = float(match[2]) if match else None
        finally:
            self._is_updating = False

    def _choose(self, name):
        if self._is_updating or name is None:
            return
        self._change(light=None if name == OWN else name)

    def _take_temperature(self, kelvin):
        if self._is_updating:
            return
        light = None
        if kelvin is not None:
            light = f"{'daylight' if kelvin >= DAYLIGHT else 'blackbody'}-{kelvin:g}K"
            try:
                illuminant(light)
            except GpusimError as error:
                self._kelvin.error = str(error)
                return
        self._kelvin.error = None
        self._change(light=light)

    async def _take_files(self, files):
        """Show the light of a file that was sent. files: name -> SHA-256."""
        (name, sha), *_ = files.items()
        uploads = self._session.producer.shelf.uploads
        try:
            illuminant(uploads.path(name, sha))
        except GpusimError as error:
            raise uploads.shorten(error) from error
        self._change(light=name, files=self._session.state.files | {name: sha})
