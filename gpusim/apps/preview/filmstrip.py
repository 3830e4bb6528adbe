"""Recent scenes on the preview's page, as small pictures."""

import base64
import io
from collections.abc import Awaitable, Callable
from functools import partial

from nicegui import ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.scene_choice import SceneChoice
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.shelf import Recent
from gpusim.io.scene.option_texts import format_size

HEIGHT = 54  # of a small picture [pixel]
MOST_RECENT = 12


class Filmstrip:
    """Small pictures of recent scenes; a click shows the scene again.

    Args:
        session: Session of the client.
        show: Coroutine that shows a scene.
    """

    def __init__(self, session: Session, show: Callable[[SceneChoice], Awaitable[None]]):
        self._session, self._show = session, show
        self._built: list[str] = []

    def build(self) -> None:
        """Make the elements."""
        self._row = ui.row(wrap=False).classes("w-full overflow-x-auto gap-1")
        self._row.props(mark("filmstrip"))
        ui.timer(0.5, self.update)

    def update(self) -> None:
        """Add the scene of the last picture, if it is new."""
        recent, shown = self._session.producer.shelf.recent, self._session.shown
        state = self._session.state
        if shown is not None and shown.facts.get("scene") == state.scene.key not in recent:
            recent[state.scene.key] = Recent(state.scene, thumbnail(shown.codes))
            for key in list(recent)[:-MOST_RECENT]:
                del recent[key]
        if [*recent] == self._built:
            return
        self._built = [*recent]
        self._row.visible = len(recent) > 1
        self._row.clear()
        with self._row:
            for number, one in enumerate(recent.values()):
                self._build_one(number, one)

    def _build_one(self, number, one):
        size = one.choice.size
        words = " ".join([one.choice.name or "as started", *([format_size(size)] if size else [])])
        button = ui.element("button").props(f'type="button" aria-label="show {words}"')
        button.props(mark(f"recent {number}")).classes("shrink-0").tooltip(words)
        button.on("click", partial(self._show, one.choice))
        with button:
            ui.html(f'<img src="{one.picture}" alt="" height="{HEIGHT}">', sanitize=False)


def thumbnail(codes) -> str:
    """Return a small JPEG of a picture (rows, cols, 3) as a data address."""
    from PIL import Image

    width = max(1, round(codes.shape[1] * HEIGHT / codes.shape[0]))
    file = io.BytesIO()
    Image.fromarray(codes).resize((min(width, 4 * HEIGHT), HEIGHT)).save(file, "JPEG", quality=80)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"
