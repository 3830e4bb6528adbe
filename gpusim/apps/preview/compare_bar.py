"""The page's bar of snapshots: keep a camera, and compare with it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nicegui import ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.comparison import OWN, list_differences
from gpusim.apps.preview.control import PLACES
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.state import COMPARISONS, MOST_SNAPSHOTS
from gpusim.domain.errors import GpusimError

NOTHING = "nothing"
BLINK = 0.7  # [s] that each of two pictures is shown


class CompareBar:
    """Elements of the comparison.

    Args:
        session: Session of the client.
        set_state: Called with changed fields of the State.
        on_turn: Called after another picture was shown by blinking.
    """

    def __init__(
        self, session: Session, set_state: Callable[..., None], on_turn: Callable[[], None]
    ):
        self._session, self._set, self._on_turn = session, set_state, on_turn
        with ui.element("div").classes("gp-bar"):
            self._button("keep", "keep this camera", "keep this camera, to compare others with it")
            self._against = self._choice("against", "compare with", [NOTHING], self._choose)
            self._compare = self._choice("compare", "how", list(COMPARISONS), self._choose_how)
            self._split: Any = ui.slider(
                min=0, max=PLACES, on_change=lambda event: self._slide(event.value)
            )
            self._split.props(f'{mark("split")} aria-label="this camera | the other"').classes(
                "w-40"
            )
            self._pair = [
                self._button("take", "take", "go on with the snapshot's camera; snapshots stay"),
                self._button(
                    "swap", "swap", "go on with the snapshot's camera; its name is this one's then"
                ),
                self._button("drop", "drop", "remove the snapshot"),
                self._button("differences", "differences", "settings in which the cameras differ"),
            ]
        self._blink = ui.timer(BLINK, self._turn, active=False)

    def _button(self, name, words, tip):
        button = ui.button(words, on_click=getattr(self, f"_{name}"))
        return button.props(f"flat dense no-caps {mark(name)}").tooltip(tip)

    def _choice(self, name, label, choices, does):
        select = ui.select(choices, label=label, on_change=lambda event: does(event.value))
        return select.props(f'dense options-dense {mark(name)} aria-label="{label}"').classes(
            "w-36"
        )

    def show(self):
        """Put the settings into the elements."""
        state = self._session.state
        self._against.set_options([NOTHING, *state.snapshots], value=state.against or NOTHING)
        self._compare.value = state.compare
        self._split.value = PLACES * state.split
        is_pair = state.against is not None
        for element in (self._compare, *self._pair):
            element.visible = is_pair
        self._split.visible = is_pair and state.compare == "split"
        self._blink.active = is_pair and state.compare == "blink"

    # actions

    def _keep(self):
        state = self._session.state
        if len(state.snapshots) >= MOST_SNAPSHOTS:
            ui.notify(
                f"{MOST_SNAPSHOTS} cameras are kept, the most; drop one first", type="negative"
            )
            return
        letters = (chr(ord("B") + place) for place in range(MOST_SNAPSHOTS))
        free = next(letter for letter in letters if letter not in state.snapshots)
        with ui.dialog(value=True) as dialog, ui.card():
            name = ui.input("name", value=free).props(f"autofocus {mark('keep name')}")

            def keep():
                word = (name.value or "").strip()[:40] or free
                if word == NOTHING or word in self._session.state.snapshots:
                    ui.notify(f"{word!r} is taken; choose another name", type="negative")
                    return
                dialog.close()
                after = self._session.state.keep(word)
                self._set(snapshots=after.snapshots, against=after.against)

            name.on("keydown.enter", keep)
            ui.button("keep", on_click=keep).props(f"dense no-caps {mark('keep it')}")

    def _choose(self, name):
        self._set(against=None if name == NOTHING else name)

    def _choose_how(self, how):
        self._set(compare=how, split=0.5)

    def _slide(self, place):
        self._set("split", split=place / PLACES)

    def _swap(self):
        state = self._session.state
        if state.against is not None:
            other = state.snapshots[state.against]
            kept = {"camera": state.camera, "changes": state.changes}
            self._set(**other, snapshots={**state.snapshots, state.against: kept})

    def _take(self):
        state = self._session.state
        if state.against is not None:
            self._set(**state.snapshots[state.against])

    def _drop(self):
        state = self._session.state
        if state.against is not None:
            after = state.drop(state.against)
            self._set(snapshots=after.snapshots, against=after.against)

    def _turn(self):
        """Show the other picture."""
        session, state = self._session, self._session.state
        if state.against is not None:
            session.history.replace(replace(state, split=float(state.split < 0.5)))
            session.touch()
            self._on_turn()

    def _differences(self):
        state = self._session.state
        try:
            names = [OWN, *(name for name in state.snapshots)]
            states = [state, *(state.snapshot(name) for name in state.snapshots)]
            rows = list_differences(states)
        except GpusimError as error:
            ui.notify(str(error), type="negative")
            return
        columns = [
            {"name": str(place), "label": word, "field": str(place), "align": "left"}
            for place, word in enumerate(["setting", *names])
        ]
        cells = [{str(place): word for place, word in enumerate(row)} for row in rows]
        with ui.dialog(value=True), ui.card().classes("max-w-none"):
            ui.table(rows=cells, columns=columns).props(f"dense flat {mark('difference table')}")
            if not rows:
                ui.label("The cameras do not differ.")
