"""Axes to draw on, and the colours in which channels, wavelengths and spectra of light are drawn."""

import numpy as np

from gpusim.data.colorimetry import adaptation, cmf
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, Missing

CHANNELS = {
    "R": (0.84, 0.15, 0.16),
    "G": (0.17, 0.63, 0.17),
    "B": (0.12, 0.35, 0.80),
    "Y": (0.35, 0.35, 0.35),
    "W": (0.45, 0.45, 0.45),
    "C": (0.09, 0.65, 0.75),
    "M": (0.80, 0.20, 0.65),
    "E": (0.05, 0.55, 0.45),
}
# of letters not in it
OTHERS = ((0.90, 0.55, 0.10), (0.50, 0.30, 0.65), (0.55, 0.34, 0.29), (0.50, 0.50, 0.13))
# ways of matplotlib to draw
WITHOUT_WINDOW = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
STYLES = ("-", "--", "-.", ":")
LIGHTEST = 0.5  # of a line's codes on white
BAR = 1.3  # inches of a colour bar
QUIET = "0.55"  # grey of lines that are no data


def matplotlib():
    """The library's package of plain calls, `matplotlib.pyplot`. Raises Missing."""
    try:
        from matplotlib import pyplot
    except ImportError:
        raise Missing(
            "plot: matplotlib is not installed; wanted: pip install 'gpusim[plot]'"
        ) from None
    return pyplot


def window(what: str, other: str):
    """`matplotlib.pyplot` where it can open windows, or notebooks show its figures. Raises BadData, Missing.

    what: that wants one, other: what to use where there is none; both for the message.
    """
    pyplot = matplotlib()
    if pyplot.get_backend().lower() in WITHOUT_WINDOW:
        raise BadData(f"{what}: no window can be opened here; wanted {other}")
    return pyplot


def axes_of(ax, size=(6.4, 4.4)):
    """The axes given, or those of a new figure of so many inches where that is None. Raises BadData, Missing."""
    if ax is None:
        return matplotlib().subplots(figsize=size, layout="constrained")[1]
    if not (hasattr(ax, "plot") and hasattr(ax, "imshow")):
        raise BadData(
            f"ax: {type(ax).__name__}, wanted axes of matplotlib, such as matplotlib.pyplot.gca()"
        )
    return ax


def panels(figure, rows: int, cols: int, size):
    """Axes (rows, cols) on a figure of matplotlib, or on a new one of so many inches where that is None."""
    if figure is None:
        figure = matplotlib().figure(figsize=size, layout="constrained")
    if not hasattr(figure, "subplots"):
        raise BadData(f"figure: {type(figure).__name__}, wanted a figure of matplotlib")
    return figure, figure.subplots(rows, cols, squeeze=False)


def image(ax, codes, title=""):
    """A picture (rows, cols, 3) whose pixels stay pixels, without ticks."""
    ax.imshow(codes, interpolation="nearest" if max(codes.shape[:2]) < 256 else None)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(title, fontsize="medium")
    return ax


def picture_size(shape, beside: float = 0.0) -> tuple[float, float]:
    """Inches of a figure for a picture of (rows, cols) with a title; beside: for a colour bar."""
    rows, cols = shape
    width = min(8.0, 5.0 * cols / rows)
    return max(width, 3.5) + beside, max(width * rows / cols, 1.5) + 0.5


def error_map(ax, values, title, label, **colors):
    """Numbers (rows, cols) in colours, with their bar; colors: of `imshow`."""
    drawn = ax.imshow(values, **colors)
    ax.figure.colorbar(drawn, ax=ax, label=label, extend="both" if colors["vmin"] < 0 else "max")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(title, fontsize="medium")
    return ax


def curve(ax, x, y, color, label, first: int = 0, **options):
    """A line, dashed by how many of its colour there are: those of several cameras can be told apart on one axes.

    first: number of the first one's dashes in STYLES.
    """
    before = sum(line.get_color() == color for line in ax.get_lines() if len(line.get_xdata()) > 1)
    ax.plot(
        x, y, color=color, linestyle=STYLES[(first + before) % len(STYLES)], label=label, **options
    )


def legend_once(ax, label: str) -> str:
    """The label, or one that legends leave out where they have it already."""
    return "_nolegend_" if any(line.get_label() == label for line in ax.get_lines()) else label


def widened(ax, high: float) -> float:
    """The right limit that shows up to `high` and what was drawn before."""
    return max(high, ax.get_xlim()[1]) if ax.get_lines() else high


def finish(ax, name, title, x, y):
    """Title, labels of both axes, a faint grid and a legend; of axes that have another's the title without the name."""
    ax.set_title(
        title[0].upper() + title[1:] if ax.get_title() or not name else f"{name}: {title}",
        fontsize="medium",
    )
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(True, color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.legend(frameon=False, fontsize="small")
    return ax


def channel_colors(channels) -> dict:
    """A colour for each letter of a mosaic."""
    others = iter(OTHERS * len(channels))
    return {letter: CHANNELS.get(letter) or next(others) for letter in channels}


def wavelength_color(nanometres: float) -> tuple:
    """Color of light of one wavelength in sRGB, in its gamut and dark enough for a line on white; grey if unseen."""
    xyz = cmf().at(nanometres)
    if not xyz.sum() > 1e-4:
        return (0.4, 0.4, 0.4) if nanometres < 550 else (0.25, 0.1, 0.1)
    linear = np.maximum(DISPLAYS["srgb"].rgb_from_xyz @ xyz, 0)
    linear = linear / linear.max()
    return readable(DISPLAYS["srgb"].encode(linear))


def readable(codes) -> tuple:
    """A colour 0 .. 1 (3,) made dark enough for a line on white."""
    codes = np.clip(codes, 0, 1)
    return tuple(
        float(value) for value in codes * min(1.0, LIGHTEST / max(codes @ (0.3, 0.6, 0.1), 1e-9))
    )


def srgb(xyz, white=None) -> np.ndarray:
    """Codes of sRGB, 0 .. 1 (rows, cols, 3), of XYZ (3, rows, cols), clipped; white: XYZ that become its white."""
    display = DISPLAYS["srgb"]
    matrix = display.rgb_from_xyz
    if white is not None:
        matrix = matrix @ adaptation(white, display.xyz_from_rgb.sum(1))
    return np.clip(
        display.encode(np.clip(np.moveaxis(np.tensordot(matrix, xyz, 1), 0, -1), 0, 1)), 0, 1
    )
