"""Panels of measurements in the widget in Jupyter."""

import asyncio
from html import escape

import ipywidgets
from ipywidgets import HTML, Dropdown, HBox, Layout, VBox

from gpusim.apps.preview.figures import PARTS_STYLE, Part, save_csv, save_svg
from gpusim.apps.preview.measures import Inputs, Where
from gpusim.apps.preview.panels import DEFAULTS, PANELS, Panel
from gpusim.apps.preview.panels_kept import Kept
from gpusim.apps.preview.panels_light import describe_pixel
from gpusim.apps.preview.session import Session
from gpusim.domain.errors import BadData, UnknownName
from gpusim.pipeline.cache import same

INTERVAL = 0.5  # [s] between updates, while a slider is moved or noise is live
SUFFIXES = (".csv", ".svg")  # of files of a panel
CHANNELS = ("R", "G", "B")  # until there is a picture
WRAPPED = {"flex_flow": "row wrap"}


class Opened(VBox):
    """A panel with its choices and its content.

    Args:
        panel: Panel.
        channels: Letters of the camera's channels.
        on_choice: Function that is called after a choice.

    Attributes:
        panel: Panel.
        choices: Name of an option -> its field.
        content: HTML of its parts.
        parts: Its parts, for files.
    """

    def __init__(self, panel: Panel, channels: tuple[str, ...], on_choice):
        self.panel, self.parts = panel, list[Part]()
        self.content = HTML()
        self.choices = {
            name: Dropdown(
                options=choices,
                description=name,
                style={"description_width": "auto"},
                layout=Layout(width="auto"),
            )
            for name, choices in panel.choices(channels).items()
        }
        self._inputs: tuple | None = None  # of the content
        for field in self.choices.values():
            field.observe(lambda change: on_choice(), "value")
        head = HBox([HTML(f"<b>{panel.title}</b>"), *self.choices.values()])
        head.layout = Layout(**WRAPPED)
        super().__init__([head, self.content], layout=Layout(flex="1 1 300px", max_width="640px"))

    @property
    def chosen(self) -> dict[str, str]:
        """The present choices."""
        return {name: field.value for name, field in self.choices.items()}

    def offer(self, channels: tuple[str, ...]) -> None:
        """Offer the channels of another camera."""
        for name, choices in self.panel.choices(channels).items():
            field = self.choices[name]
            if set(field.options) != set(choices):
                chosen = field.value if field.value in choices else choices[0]
                field.options = choices
                field.value = chosen

    def read(self, found: Inputs, where: Where, kept: Kept) -> None:
        """Show the content for a picture and a place, unless it is shown already."""
        chosen = self.chosen
        inputs = self.panel.inputs(found, where, chosen)
        if not same(self._inputs, inputs):
            self.parts, self.content.value = self.panel.content(found, where, chosen, kept)
            self._inputs = inputs

    def refuse(self, error: Exception) -> None:
        """Show an error in place of the content."""
        self.parts, self.content.value, self._inputs = [], self.panel.explain(error), None


class Panels(VBox):
    """The read-out of a pixel, and panels that are opened by buttons and follow the picture.

    Attributes:
        place: Fields of the row and the column of the pixel that is read out.
        pixel: Its values.
        switches: Name of a panel -> the button that opens and closes it.
        opened: Name of an open panel -> its Opened.
    """

    def __init__(self):
        self.opened: dict[str, Opened] = {}
        self._made: dict[str, Opened] = {}  # also those that are closed
        self.pixel, self._area = HTML(), HBox(layout=Layout(**WRAPPED))
        self._kept, self._channels, self._is_final = Kept(), CHANNELS, False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wanted = {False: asyncio.Event(), True: asyncio.Event()}  # of slow panels: True
        self.place = tuple(
            ipywidgets.BoundedIntText(
                max=10**6,
                description=name,
                layout=Layout(width="9em"),
                style={"description_width": "4em"},
            )
            for name in ("row", "column")
        )
        for field in self.place:
            field.observe(lambda change: self.request(), "value")
        self.switches = {}
        for name, panel in PANELS.items():
            switch = self.switches[name] = ipywidgets.ToggleButton(
                description=panel.title, layout=Layout(width="auto")
            )
            switch.observe(lambda change, name=name: self._switch(name, change.new), "value")
        switches = HBox([*self.switches.values()], layout=Layout(**WRAPPED))
        style = HTML(f"<style>{PARTS_STYLE}</style>", layout=Layout(display="none"))
        super().__init__([HBox([*self.place, self.pixel]), switches, style, self._area])
        for name in DEFAULTS:
            self.switches[name].value = True

    def _switch(self, name, is_open):
        if is_open:
            if name not in self._made:
                self._made[name] = Opened(PANELS[name], self._channels, self.request)
            self.opened[name] = self._made[name]
        else:
            del self.opened[name]
        self._area.children = [*self.opened.values()]
        self.request()

    def text(self, name: str, suffix: str) -> str:
        """Return the text of a file of an open panel. suffix: one of SUFFIXES.

        Raises UnknownName if the panel is not open, BadData if it has no drawing.
        """
        if name not in self.opened:
            raise UnknownName("open panel", name, tuple(self.opened))
        parts = self.opened[name].parts
        if suffix == ".csv":
            return save_csv(parts)
        if not any(part.svg() for part in parts):
            raise BadData(f"{name}: no drawing to save; wanted one in the panel, or a .csv file")
        return save_svg(parts)

    def request(self, is_final: bool | None = None) -> None:
        """Request an update. is_final: whether the picture stays; None: as before."""
        if is_final is not None:
            self._is_final = is_final
        if self._loop is not None:
            for event in self._wanted.values():
                self._loop.call_soon_threadsafe(event.set)

    async def follow(self, session: Session) -> None:
        """Update the panels on request, the slow ones by themselves."""
        self._loop = asyncio.get_running_loop()
        await asyncio.gather(self._follow(session, False), self._follow(session, True))

    async def _follow(self, session, is_slow):
        wanted = self._wanted[is_slow]
        while True:
            await wanted.wait()
            wanted.clear()
            if session.shown is not None:
                await self._update(session, is_slow)
                await asyncio.sleep(INTERVAL)

    async def _update(self, session, is_slow):
        row, column = (field.value for field in self.place)
        where = Where(session.shown.facts["shape"], (row, column))
        opened = [one for one in self._area.children if one.panel.is_slow == is_slow]
        if is_slow and not opened:
            return
        needs = {one: set(one.panel.needs(one.chosen, where)) for one in opened}
        lit = [one for one in opened if "irradiance" in needs[one]]
        if lit and self._is_final:
            try:
                await session.compute(session.producer.irradiance)
            except Exception as error:
                for one in lit:
                    one.refuse(error)
                opened = [one for one in opened if one not in lit]
        names = frozenset({"mean"}.union(*needs.values()) - {"irradiance"})
        try:
            found = await session.compute(session.producer.inputs, names, bool(lit))
        except Exception:
            return  # the next picture says it, also of a device that fails
        await asyncio.to_thread(self._read, opened, found, where)

    def _read(self, opened, found, where):
        self._channels = found.camera.sensor.channels
        for one in opened:
            one.offer(self._channels)
            one.read(found, where, self._kept)
        self.pixel.value = escape(describe_pixel(found, where))
