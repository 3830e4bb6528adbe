"""The elements of the controls on the preview's page."""

from collections.abc import Callable
from functools import partial
from math import isfinite
from typing import Any

from nicegui import ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.control import Control, as_text, parse
from gpusim.domain.errors import format_value

OPEN = ("Scene", "Exposure", "Lens")  # groups, at first


class Field:
    """The row of a control: its name, and a slider with a number, a choice or a text.

    Args:
        control: The control.
        on_change: Called with a new value, and whether it is a step of its own of the history.
        on_reset: Called when the value of the camera's file is wanted again.
        name: Name for tests. None: the control's.
    """

    def __init__(
        self,
        control: Control,
        on_change: Callable[[Any, bool], None],
        on_reset: Callable[[], None],
        name: str | None = None,
    ):
        self.control, self._name = control, name or control.name
        self._on_change, self._on_reset = on_change, on_reset
        self._is_showing = False  # while the row follows the settings, and not they it
        self._shown: tuple | None = None  # arguments of `show`
        self.slider: Any = None
        self.switch: Any = None
        with ui.element("div").classes("gp-row") as self.row:
            if control.off is not None:
                self.switch = ui.checkbox(on_change=self._turn)
                words = f"{control.label}: use a number instead of {control.off}"
                self._mark(self.switch, f"{self._name} on", words).props("dense")
                self.switch.tooltip(f"off: {control.off}")
            self.label = ui.label(control.label).classes("gp-name")
            if control.choices:
                self.input = self._make_choice()
            elif control.is_text:
                self.input = self._make_text()
            else:
                self.input = self._make_number()
        self.row.on("dblclick", on_reset)

    def _mark(self, element, name, words):
        """Name an element for tests and for screen readers."""
        return element.props(f'{mark(name)} aria-label="{words}"')

    def _make_choice(self):
        choices = {
            index: str(choice).lower() if isinstance(choice, bool) else str(choice)
            for index, choice in enumerate(self.control.choices)
        }
        select = ui.select(choices, on_change=self._choose).props("dense options-dense")
        return self._mark(select, self._name, self.control.label).classes("grow")

    def _make_text(self):
        text = ui.input(placeholder=self.control.words).props("dense")
        self._mark(text, f"{self._name} text", self.control.label).classes("grow min-w-0")
        text.on("change", lambda: self._type(text.value))
        if self.control.suggested:
            button = ui.button(icon="arrow_drop_down").props("flat dense round size=sm")
            with self._mark(button, f"{self._name} choose", f"choose: {self.control.label}"):
                with ui.menu():
                    for word in self.control.suggested:
                        item = ui.menu_item(word, partial(self._type, word))
                        item.props(mark(f"{self._name} = {word}"))
        return text

    def _make_number(self):
        self.slider = ui.slider(
            min=0, max=self.control.places, value=0, on_change=self._slide
        ).classes("grow min-w-0")
        self._mark(self.slider, self._name, self.control.label)
        number = ui.number(suffix=self.control.unit or None).classes("w-28 shrink-0")
        self._mark(number, f"{self._name} number", f"{self.control.label}, number")
        number.props("dense borderless")
        number.on("change", lambda: self._take(number.value))
        return number

    # what the user does

    def _slide(self, event):
        if not self._is_showing:
            self._on_change(self.control.to_value(event.value), False)

    def _take(self, value):
        if value is None or not isfinite(value):
            if self._shown is not None:
                shown, self._shown = self._shown, None  # the box does not show it any more
                self.show(*shown)
            return
        self._on_change(
            int(value) if self.control.is_whole and value == int(value) else value, True
        )

    def _turn(self, event):
        if not self._is_showing:
            is_on, control = event.value, self.control
            self._on_change(control.to_value(self.slider.value) if is_on else control.off, True)

    def _choose(self, event):
        if not self._is_showing and event.value is not None:
            self._on_change(self.control.choices[event.value], True)

    def _type(self, text):
        if self._is_showing or self._shown is None or text == _text_of(self._shown[0]):
            return
        if text:
            self._on_change(parse(text), True)
        else:
            self._on_reset()

    # what the page shows

    def show(self, value: Any, is_changed: bool, reason: str = "", metered: float | None = None):
        """Show a value.

        Args:
            value: As in a camera file.
            is_changed: Whether it was changed on the page.
            reason: Why it is not used; "" if it is.
            metered: What the camera chose, for a control that is off.
        """
        if self._shown == (value, is_changed, reason, metered):
            return
        # of a number that is typed just now, only the camera's choice may change
        is_typed = self._shown is not None and self._shown[:3] == (value, is_changed, reason)
        self._shown = value, is_changed, reason, metered
        self._is_showing = True
        try:
            self.label.classes(add="gp-changed" if is_changed else "", remove="gp-changed")
            self.input.error = reason or None
            if self.control.choices:
                self._show_choice(value)
            elif self.control.is_text:
                self.input.value = _text_of(value)
            else:
                self._show_number(value, metered, is_typed)
        finally:
            self._is_showing = False

    def _show_choice(self, value):
        same = (
            index
            for index, choice in enumerate(self.control.choices)
            if type(choice) is type(value) and choice == value
        )
        place = next(same, None)
        self.input.props(remove="label")
        if place is None and value is not None:  # one of the file that the page does not offer
            self.input.props(f'label="{as_text(value)}"')
        self.input.value = place

    def _show_number(self, value, metered, is_typed):
        control = self.control
        has_number = isinstance(value, int | float) and value != control.off
        at = value if has_number else metered
        if at is not None:
            place = control.to_place(at)
            if self.slider.value != place:
                self.slider.value = place
        if not is_typed:
            self.input.value = value if has_number else None
        self.input.props(f'placeholder="{self._words(value, metered)}"')
        if self.switch is not None:
            self.switch.value = has_number

    def _words(self, value, metered):
        """Return what stands in the empty box of a control without a number."""
        if metered is not None:
            return f"{self.control.off}: {metered:.4g}"
        if isinstance(value, str):
            return value
        if value is None:
            return "not set"
        return "a curve" if isinstance(value, dict) else f"{format_value(value)}"

    def is_found(self, words: str) -> bool:
        """Return whether a search for some words finds this control."""
        control = self.control
        text = f"{control.label} {control.section} {control.key} {control.unit}".lower()
        return all(word in text for word in words.lower().split())


def _text_of(value):
    """Return what stands in the box of a text; nothing for a list without items."""
    return "" if value == [] else as_text(value)


class Group:
    """A group of rows that can be folded.

    Args:
        name: Its title.
        words: Other words with which a search finds the whole group.
    """

    def __init__(self, name: str, words: str = ""):
        self.name, self.fields = name, list[Field]()
        self._words = f"{name} {words}".lower()
        self._was_open: bool | None = None  # before a search
        self.element = ui.expansion(name, value=name in OPEN)
        self.element.classes("w-full").props(f"dense {mark(f'group {name}')}")

    def search(self, words: str) -> None:
        """Show the rows that a search finds, and open the group if it finds some; all without words."""
        is_whole = all(word in self._words for word in words.lower().split())
        for field in self.fields:
            field.row.visible = is_whole or field.is_found(words)
        is_found = is_whole or any(field.row.visible for field in self.fields)
        self.element.visible = is_found
        if self._was_open is None:
            self._was_open = self.element.value
        self.element.value = is_found if words else self._was_open
        if not words:
            self._was_open = None
