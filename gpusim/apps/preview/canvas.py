"""The picture on the preview's page: zoom, dragging, and the rectangle of a measured edge."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from gpusim.apps.preview.crop import enlarge
from gpusim.apps.preview.session import Session

CLICK = 3.0  # [pixel of the frame] that the mouse may move in a click
MOUSE = ["mousedown", "mousemove", "mouseup"]  # events of the mouse


def mark(name: str) -> str:
    """Return the properties of an element by which tests find it."""
    return f'data-mark="{name}"'


class Picture(ui.element, component="picture.js"):  # type: ignore[call-arg]  # without NiceGUI
    """The canvas. url: address of its websocket. width, height: size of the frames [pixel]."""

    def __init__(self, url: str, width: int, height: int):
        super().__init__()
        self._props.update(url=url, width=width, height=height)


class Canvas:
    """The picture of a session.

    Args:
        session: Session of the client.
        token: Token of the session, for the address of the websocket.
        shape: Rows and columns of the frames.

    Attributes:
        at: Row and column of the frame under the pointer, or None.
        edge: Rows and columns of the part whose edge is measured, or None.
        measures: Whether dragging selects an edge instead of moving the picture.
        on_pick: Function of the row and column of a click, which then does not enlarge the picture; or None.
    """

    def __init__(self, session: Session, token: str, shape: tuple[int, int]):
        self.session, self._token, self._shape = session, token, shape
        self.at: tuple[int, int] | None = None
        self.edge: tuple[slice, slice] | None = None
        self.measures = False
        self.on_pick: Callable[[int, int], object] | None = None
        self._count = 1  # pictures side by side
        self._aspect = shape[1] / shape[0]  # of all of them
        self._width = shape[1]  # of the picture on the screen [pixel]
        self._names: tuple[tuple[str, ...], bool] = (), False
        self._held: tuple | None = None  # start of a drag: row, column of the canvas, and the crop

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        return self._shape

    def build(self) -> None:
        """Make the elements."""
        rows, cols = self._shape
        with ui.element("div").classes("gp-picture") as self._box:
            self._box.style(f"--gp-aspect: {self._aspect:.6f}")
            self._picture: Any = Picture(f"/picture/{self._token}", cols, rows).on(
                "size", self._on_size
            )
            # separate, because the image is positioned relative to itself
            with ui.element("div").classes("absolute inset-0").props("aria-hidden=true"):
                self._overlay: Any = (
                    ui.interactive_image(size=(cols, rows), events=MOUSE, on_mouse=self._on_mouse)
                    .props(mark("overlay"))
                    .style("width: 100%; height: 100%")
                )
                self._overlay.on("wheel.prevent", self._on_wheel, ["deltaY"], throttle=0.1)
            self._captions: Any = ui.element("div").classes("gp-captions").props(mark("captions"))

    def follow(self, shape: tuple[int, int], count: int) -> None:
        """Take frames of another shape, rows and columns, of which all is shown first.

        count: pictures side by side.
        """
        is_new = count != self._count
        if shape != self._shape:
            self._shape, self.at, self.edge = shape, None, None
            self._overlay._props["size"] = shape[::-1]
            self._overlay.update()
            self._set_crop(None)
            is_new = True
        self._count = count
        if is_new:
            self._draw_edge()
        aspect = count * shape[1] / shape[0]
        if aspect != self._aspect:
            self._aspect = aspect
            self._box.style(f"--gp-aspect: {aspect:.6f}")

    def name_pictures(self, names: tuple[str, ...], are_apart: bool) -> None:
        """Write a name over each picture. are_apart: whether they are side by side."""
        if (names, are_apart) == self._names:
            return
        self._names = names, are_apart
        self._captions.clear()
        with self._captions:
            for name in names:
                with ui.element("div").style("flex: 1" if are_apart else ""):
                    ui.label(name)

    def _on_wheel(self, event):
        self.zoom(1 if event.args["deltaY"] < 0 else -1)

    def _on_mouse(self, event):
        place = event.image_y, event.image_x
        row, col = self.at = self._find_pixel(*place)
        if event.type == "mousedown":
            self._held = *place, self.session.crop
        if self._held is None or not (event.buttons or event.type == "mouseup"):
            self._held = None
            return
        y, x, crop = self._held
        if self.measures:
            top, left = self._find_pixel(y, x)
            self.edge = tuple(slice(min(pair), max(pair) + 1) for pair in ((top, row), (left, col)))
            self._draw_edge()
        elif crop is not None:
            rows, cols = self._shape
            down, right = (y - place[0]) * crop.rows / rows, (x - place[1]) * crop.cols / cols
            self._set_crop(crop.move(round(down), round(right), self._shape))
        if event.type == "mouseup":
            self._held = None
            if not self.measures and abs(y - place[0]) + abs(x - place[1]) < CLICK:
                if self.on_pick is not None:
                    return self.on_pick(row, col)
                if self.session.crop is None:
                    self.zoom(1)
                else:
                    self.fit()

    def _find_pixel(self, y, x):
        """Return row and column of the frame at a place of the canvas, in units of the whole frame."""
        corner, size = self._window()
        x = x * self._count % self._shape[1]
        return tuple(
            min(max(start + int(place * own / n), 0), n - 1)
            for start, place, own, n in zip(corner, (y, x), size, self._shape, strict=True)
        )

    def _window(self):
        """Return the corner and the size of the part of the frame that is shown."""
        crop = self.session.crop
        return ((crop.top, crop.left), (crop.rows, crop.cols)) if crop else ((0, 0), self._shape)

    def _on_size(self, event):
        self._width = int(event.args["width"])

    def zoom(self, step: int) -> None:
        """Enlarge (step 1) or shrink (-1) the picture around the pointer."""
        at = self.at or (self._shape[0] // 2, self._shape[1] // 2)
        self._set_crop(
            enlarge(self.session.crop, step, at, self._shape, self._width // self._count)
        )

    def fit(self) -> None:
        """Show the whole picture."""
        self._set_crop(None)

    def _set_crop(self, crop):
        if crop != self.session.crop:
            self.session.crop = crop
            self._picture.style(f"image-rendering: {'pixelated' if crop else 'auto'}")
            self.session.touch()
            self._draw_edge()

    def _draw_edge(self):
        """Draw the rectangle of the measured edge on each picture, in percent of the canvas.

        The browser keeps the units of the first frame's pixels when frames change their size.
        """
        shown = []
        if self.edge is not None:
            (y, high), (x, wide) = (
                (100 * (part.start - start) / own, 100 * (part.stop - part.start) / own)
                for part, start, own in zip(self.edge, *self._window(), strict=True)
            )
            count = self._count
            shown = [
                f'<rect x="{(100 * place + x) / count:.3f}%" y="{y:.3f}%" width="{wide / count:.3f}%" '
                f'height="{high:.3f}%" fill="none" stroke="#ffd54f" stroke-width="2" '
                'vector-effect="non-scaling-stroke"/>'
                for place in range(count)
            ]
        self._overlay.content = "".join(shown)
