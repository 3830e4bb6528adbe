"""The dock: panels of measurements that are opened from a menu and follow the picture."""

import asyncio
import json
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from nicegui import ui

from gpusim.apps.preview.canvas import Canvas, mark
from gpusim.apps.preview.figures import PARTS_STYLE, Part, save_csv, save_svg
from gpusim.apps.preview.measures import Inputs, Where
from gpusim.apps.preview.panels import DEFAULTS, PANELS, PLACES, Panel
from gpusim.apps.preview.panels_kept import Kept
from gpusim.apps.preview.panels_light import describe_pixel
from gpusim.apps.preview.session import Session
from gpusim.pipeline.cache import same

# pause between refreshes: times the device's work of the last one, times the host's; [s] at most
PAUSE, HOST_PAUSE, LONGEST_PAUSE = 4.0, 2.0, 1.0
REST = 0.4  # [s] without other settings, after which slow inputs are computed
HOST = ThreadPoolExecutor(1, "gpusim-panels")  # for panels that take milliseconds
SLOW = ThreadPoolExecutor(1, "gpusim-slow-panels")
STYLE = """
.panel-grid { display: grid; gap: 8px; grid-template-columns: repeat(auto-fill, minmax(min(300px, 100%), 1fr)); }
.panel { border: 1px solid color-mix(in srgb, currentColor 25%, transparent); border-radius: 6px; padding: 4px 8px; }
"""
# of an SVG text, a PNG with twice its pixels of the screen, which the browser then saves
SAVE_PNG = """
const picture = new Image();
picture.onload = () => {
  const canvas = document.createElement("canvas");
  canvas.width = picture.naturalWidth; canvas.height = picture.naturalHeight;
  canvas.getContext("2d").drawImage(picture, 0, 0);
  const link = document.createElement("a");
  link.href = canvas.toDataURL("image/png"); link.download = %s; link.click();
};
picture.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(%s);
"""


class Content(ui.element, component="panel.js"):  # type: ignore[call-arg]  # without NiceGUI
    """HTML that changes often, outside of Vue's rendering."""


class Card:
    """A panel on the page. Attributes: parts: what it shows."""

    def __init__(self, panel: Panel, channels: tuple[str, ...], on_close):
        self.panel = panel
        self.parts: list[Part] = []
        self.chosen = {name: one[0] for name, one in panel.choices(channels).items()}
        self.look: tuple | None = None  # what decides whether it is looked at again
        self.inputs: tuple | None = None  # of what is shown
        self.is_busy = False
        self._on_close, self._channels, self._html = on_close, channels, ""

    def build(self) -> None:
        """Make the elements."""
        name, title = self.panel.name, self.panel.title
        props = f'{mark(f"panel {name}")} role="group" aria-label="{title}"'
        self.element: Any = ui.element("section").classes("panel").props(props)
        with self.element:
            with ui.row().classes("w-full items-center gap-2"):
                ui.label(title).classes("grow text-sm")
                self._choices: dict[str, Any] = {
                    option: self._build_choice(option, choices)
                    for option, choices in self.panel.choices(self._channels).items()
                }
                with self._button("download", f"save {title}", f"save {name}"), ui.menu():
                    for suffix, does in (
                        ("csv", self._save_csv),
                        ("svg", self._save_svg),
                        ("png", self._save_png),
                    ):
                        item = ui.menu_item(f"{name}.{suffix}", does)
                        item.props(mark(f"save {name}.{suffix}"))
                self._button("close", f"close {title}", f"close {name}", self._on_close)
            self._content: Any = Content().on("ready", self._send)

    def _build_choice(self, option, choices):
        name = f"{self.panel.name} {option}"
        select = ui.select(
            list(choices),
            value=self.chosen[option],
            on_change=lambda event: self.chosen.update({option: event.value}),
        )
        return select.props(f'dense options-dense borderless aria-label="{name}" {mark(name)}')

    def _button(self, icon, words, name, does=None):
        button = ui.button(icon=icon, on_click=does).props("flat dense round size=sm")
        return button.props(f'aria-label="{words}" {mark(name)}').tooltip(words)

    def offer(self, channels: tuple[str, ...]) -> None:
        """Offer the channels of another camera."""
        if channels == self._channels or self.element.is_deleted:
            return
        self._channels = channels
        for option, choices in self.panel.choices(channels).items():
            chosen = self.chosen[option] if self.chosen[option] in choices else choices[0]
            self.chosen[option] = chosen
            self._choices[option].set_options(list(choices), value=chosen)

    def show(self, parts: list[Part], html: str) -> None:
        """Show other contents. html: of the parts, or the reason why there are none."""
        self.parts = parts
        if html != self._html and not self.element.is_deleted:
            self._html = html
            self._send()

    def _send(self):
        self._content.run_method("show", self._html)

    def _save_csv(self):
        ui.download.content(save_csv(self.parts), f"{self.panel.name}.csv")

    def _save_svg(self):
        if self._has_drawings():
            ui.download.content(save_svg(self.parts), f"{self.panel.name}.svg")

    def _save_png(self):
        if self._has_drawings():
            name, text = f"{self.panel.name}.png", save_svg(self.parts)
            ui.run_javascript(SAVE_PNG % (json.dumps(name), json.dumps(text)))

    def _has_drawings(self):
        """Return whether there is something to draw, and say so if there is not."""
        found = any(part.svg() for part in self.parts)
        if not found:
            ui.notify(
                f"{self.panel.title}: no drawing to save; wanted one on the page, or save CSV"
            )
        return found


class Dock:
    """Panels of a session.

    Args:
        session: Session of the client.
        canvas: Canvas with the pointer and the selected part.
    """

    def __init__(self, session: Session, canvas: Canvas):
        self.session, self._canvas = session, canvas
        self.cards: dict[str, Card] = {}
        self._kept, self._is_busy, self._due = Kept(), False, 0.0
        self._version, self._since = -1, 0.0
        self._look_of_pixel: tuple | None = None  # of the line of the pixel
        self._tasks: set[asyncio.Future] = set()  # of slow panels
        self._channels = ("R", "G", "B")

    def build(self, names: tuple[str, ...] = DEFAULTS) -> None:
        """Make the elements. names: panels that are open at first."""
        ui.add_css(STYLE + PARTS_STYLE)
        with ui.column().classes("w-full gap-1").props(mark("dock")):
            with ui.row().classes("w-full items-center gap-2"):
                self._pixel: Any = ui.label().classes("grow text-sm font-mono").props(mark("pixel"))
                button = ui.button("panels", icon="add_chart").props("flat dense no-caps")
                button.props(f'aria-label="choose panels" {mark("panels")}')
                with button, ui.menu().props("auto-close=false"), ui.column().classes("p-2 gap-0"):
                    self._switches = {
                        name: ui.checkbox(panel.title, on_change=partial(self._switch, name)).props(
                            f"dense {mark(f'open {name}')}"
                        )
                        for name, panel in PANELS.items()
                    }
            self._area: Any = ui.element("div").classes("panel-grid w-full")
        for name in names:
            self._switches[name].value = True

    def _switch(self, name, event):
        if event.value and name not in self.cards:
            card = Card(PANELS[name], self._channels, lambda: self._switches[name].set_value(False))
            with self._area:
                card.build()
            self.cards[name] = card
        elif not event.value and name in self.cards:
            self.cards.pop(name).element.delete()

    @property
    def where(self) -> Where:
        """Places of the picture that panels look at."""
        part = self._canvas.edge if self._canvas.measures else None
        numbers = part and (part[0].start, part[1].start, part[0].stop, part[1].stop)
        return Where(self._canvas.shape, self._canvas.at, numbers)

    async def refresh(self) -> None:
        """Bring all open panels up to date, unless it is too early or nothing has changed."""
        session, now = self.session, time.monotonic()
        if session.version != self._version:
            self._version, self._since = session.version, now
        if self._is_busy or session.shown is None or now < self._due:
            return
        # a scene that moves is another one in each frame
        is_moving = session.producer.period > 0 and session.state.is_live
        where, rests = self.where, now - self._since > REST and not is_moving
        looks = {card: self._look(card, where, rests) for card in self.cards.values()}
        cards = [card for card in looks if not card.is_busy and card.look != looks[card]]
        pixel = _One(session.shown), where.at
        if not cards and pixel == self._look_of_pixel:
            return
        self._is_busy = True
        try:
            pause = await self._update(cards, where, rests)
            self._due = time.monotonic() + min(pause, LONGEST_PAUSE)
            self._look_of_pixel = pixel
            for card in cards:
                card.look = looks[card]
        finally:
            self._is_busy = False

    def _look(self, card, where, rests):
        """Return what decides whether a card is looked at again."""
        panel = card.panel
        places = tuple(getattr(where, name) for name in panel.follows if name in PLACES)
        waits = rests and "irradiance" in panel.needs(card.chosen, where)
        return _One(self.session.shown), places, waits, tuple(card.chosen.items())

    async def _update(self, cards, where, rests) -> float:
        """Update cards; return the pause after the work, slow inputs apart [s]."""
        producer, needs = self.session.producer, {"mean"} if where.at else set()
        for card in cards:
            needs.update(card.panel.needs(card.chosen, where))
        if "irradiance" in needs and rests:
            try:
                await self.session.compute(producer.irradiance)
            except Exception as error:
                bad = [one for one in cards if "irradiance" in one.panel.needs(one.chosen, where)]
                cards = [card for card in cards if card not in bad]
                for card in bad:
                    card.show([], card.panel.explain(error))
        has_irradiance = any(
            "irradiance" in card.panel.needs(card.chosen, where) for card in self.cards.values()
        )
        inputs = partial(producer.inputs, frozenset(needs - {"irradiance"}), has_irradiance)
        try:
            found, on_device = await self.session.compute(_measure_time, inputs)
        except Exception as error:  # the picture also says it
            for card in cards:
                card.show([], card.panel.explain(error))
            return LONGEST_PAUSE
        self._channels = found.camera.sensor.channels
        for card in cards:
            card.offer(self._channels)
        quick = [card for card in cards if not card.panel.is_slow]
        work = partial(self._read, quick, found, where)
        loop = asyncio.get_running_loop()
        (text, results), on_host = await loop.run_in_executor(HOST, _measure_time, work)
        if not self._pixel.is_deleted:
            self._pixel.text = text
        for card, result in zip(quick, results, strict=True):
            if result is not None:
                card.show(*result)
        for card in cards:
            if card.panel.is_slow:
                card.is_busy = True
                task = asyncio.ensure_future(self._update_slow(card, found, where))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        return PAUSE * on_device + HOST_PAUSE * on_host

    async def _update_slow(self, card, found, where):
        loop = asyncio.get_running_loop()
        try:
            [result] = (await loop.run_in_executor(SLOW, self._read, [card], found, where))[1]
            if result is not None:
                card.show(*result)
        finally:
            card.is_busy = False

    def _read(self, cards, found: Inputs, where: Where):
        """Return the line of the pixel, and parts and HTML of each card, None if unchanged."""
        results: list[tuple | None] = []
        for card in cards:
            chosen = dict(card.chosen)
            inputs = card.panel.inputs(found, where, chosen)
            if same(card.inputs, inputs):
                results.append(None)
                continue
            results.append(card.panel.content(found, where, chosen, self._kept))
            card.inputs = inputs
        return describe_pixel(found, where), results


class _One:
    """An object that equals only itself."""

    def __init__(self, value):
        self._value = value

    def __eq__(self, other):
        return isinstance(other, _One) and self._value is other._value

    __hash__ = object.__hash__


def _measure_time(work):
    """Return the result of a function, and the time it took [s]."""
    start = time.perf_counter()
    return work(), time.perf_counter() - start
