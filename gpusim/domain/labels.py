"""What a window and a notebook show of an object: its plot and its picture or table, which `gpusim.plot` makes.

That package is above all that it plots, and needs matplotlib, so `gpusim` hands in how to load it.
"""

from collections.abc import Callable
from typing import Any

load: Callable[[], Any] | None = None  # gives `gpusim.plot.notebook`


class Shown:
    """An object that can be plotted in one call."""

    def show(self) -> Any:
        """Its plot in a window or below a notebook's cell; returns the figure of matplotlib.

        Of a frame the picture, of a scene its radiance and the spectra of pixels that are clicked, of a camera quantum
        efficiency, point spread, MTF and SNR, of a report the bars of times and errors: see `gpusim.plot`. Raises
        GpusimError: without matplotlib, or where there is no window to open.
        """
        return _above().show(self)


class Pictured(Shown):
    """An object that notebooks show as a picture."""

    def _repr_png_(self) -> bytes | None:
        return _above().png(self)


class Tabled(Shown):
    """An object that notebooks show as a table."""

    def _repr_html_(self) -> str:
        return _above().html(self)


def _above() -> Any:
    assert load is not None  # `gpusim` has set it
    return load()
