"""Files of open figures."""

from os import PathLike
from pathlib import Path

from gpusim.io.atomic import atomic_path
from gpusim.plot.canvas import matplotlib

DPI = 100


def save_figures(stem: str | PathLike) -> list[Path]:
    """Save all open figures of matplotlib as STEM_1.png, STEM_2.png, ..., and close them.

    A script that ends with this call leaves its pictures on any machine. In a notebook the figures
    are shown and closed already, and nothing is saved.

    Args:
        stem: Begin of the files' names, such as "out/night".

    Returns:
        The files, in the order of the figures.

    Raises:
        BadFile: A file cannot be written.
        Missing: Matplotlib is not installed.
    """
    pyplot = matplotlib()
    saved = []
    for count, number in enumerate(pyplot.get_fignums(), 1):
        path = Path(f"{stem}_{count}.png")
        with atomic_path(path) as temporary:
            pyplot.figure(number).savefig(temporary, dpi=DPI, bbox_inches="tight")
        pyplot.close(number)
        print(f"saved {path}")
        saved.append(path)
    return saved
