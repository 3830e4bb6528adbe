"""The dialog of the error map: progress, the map, and cancelling."""

import asyncio
import time
from typing import Any

from nicegui import run, ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.measures import SPAN
from gpusim.apps.preview.session import Session
from gpusim.domain.errors import GpusimError, one_line


class ErrorMap:
    """Error maps of a session, one at a time.

    Args:
        session: Session of the client.
    """

    def __init__(self, session: Session):
        self._session = session
        self._begun: float | None = None  # when the map that is computed was begun
        self._number = 0  # of the last request; a result of another one is dropped

    async def open(self) -> None:
        """Compute the map of the picture that is shown, and show it in a dialog."""
        if self._begun is not None:
            waits = time.monotonic() - self._begun
            ui.notify(f"an error map is still computed, since {waits:.0f} s: wait for its end")
            return
        session, self._begun = self._session, time.monotonic()
        self._number += 1
        number = self._number
        self._build()
        try:
            compare = await session.compute(session.producer.error, session.state, session.number)
            found = await run.io_bound(compare)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            if number == self._number:
                words = str(error) if isinstance(error, GpusimError) else f"error map: {error}"
                self._end(one_line(words))
        else:
            if number == self._number and found is not None:
                self._show(*found)
        finally:
            self._begun = None

    def _build(self):
        with ui.dialog(value=True).props("persistent") as self._dialog:
            with ui.card().classes("max-w-none").props(mark("error dialog")) as self._card:
                props = f'role="status" {mark("error progress")}'
                self._words: Any = ui.label().props(props)
                self._button = ui.button("Cancel", on_click=self._cancel).props(
                    f"flat no-caps {mark('error cancel')}"
                )
        self._timer = ui.timer(0.5, self._tick)
        self._tick()

    def _tick(self):
        if self._begun is not None:
            waits = time.monotonic() - self._begun
            self._words.text = f"computing the exact frame in float64 since {waits:.0f} s; it takes seconds to minutes"

    def _cancel(self):
        if self._begun is not None:
            self._number += 1
            ui.notify("cancelled: the computation runs on to its end, and its result is dropped")
        self._timer.deactivate()
        self._dialog.close()

    def _end(self, words):
        """Replace the progress by a line of text."""
        self._timer.deactivate()
        self._words.text = words
        self._button.text = "Close"

    def _show(self, codes, error):
        from PIL import Image

        self._end(
            f"mean electrons less their truth: {error.rms:.2g} rms, {error.p999_sigma:.2g} of a pixel's noise "
            f"at 99.9 %, {error.max_sigma:.2g} at most; full red is {SPAN:g} rms too much, full blue less"
        )
        with self._card:
            ui.image(Image.fromarray(codes)).classes("w-[80vw] max-w-full").props(
                'alt="map of the error"'
            )
