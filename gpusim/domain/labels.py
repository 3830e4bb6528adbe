"""Display of objects in windows and notebooks, through `gpusim.plot`.

`gpusim.plot` imports the domain and needs matplotlib. `gpusim` therefore sets `load`, which imports
it when needed.
"""

from collections.abc import Callable
from typing import Any

load: Callable[[], Any] | None = None  # returns the module `gpusim.plot.notebook`


class Shown:
    """An object that can be plotted with one call."""

    def show(self) -> Any:
        """Plot the object in a window, or below the cell of a notebook.

        A frame shows its picture; a scene its radiance and the spectra of clicked pixels; a camera
        its quantum efficiency, point spread, MTF and SNR; a report bars of times and errors. See
        `gpusim.plot`.

        Returns:
            The matplotlib figure.

        Raises:
            GpusimError: Matplotlib is missing, or no window can be opened.
        """
        return _notebook().show(self)


class Pictured(Shown):
    """An object that notebooks show as a picture."""

    def _repr_png_(self) -> bytes | None:
        return _notebook().png(self)


class Tabled(Shown):
    """An object that notebooks show as a table."""

    def _repr_html_(self) -> str:
        return _notebook().html(self)


def _notebook() -> Any:
    """Return the module `gpusim.plot.notebook`."""
    assert load is not None  # `gpusim` has set it
    return load()
