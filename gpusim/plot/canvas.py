"""Axes to draw on, and colours for channels, wavelengths and spectra of light."""

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
# for other letters
OTHERS = ((0.90, 0.55, 0.10), (0.50, 0.30, 0.65), (0.55, 0.34, 0.29), (0.50, 0.50, 0.13))
# matplotlib backends that open no window
WITHOUT_WINDOW = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
STYLES = ("-", "--", "-.", ":")
LIGHTEST = 0.5  # luma of the lightest line on white
BAR = 1.3  # [inch] width of a colour bar
QUIET = "0.55"  # grey of guide lines


def matplotlib():
    """Return `matplotlib.pyplot`; raise Missing if matplotlib is not installed."""
    try:
        from matplotlib import pyplot
    except ImportError:
        raise Missing(
            "plot: matplotlib is not installed; wanted: pip install 'gpusim[plot]'"
        ) from None
    return pyplot


def window(what: str, other: str):
    """Return `matplotlib.pyplot` if it can show figures in a window or notebook.

    what: feature that needs the window. other: alternative without one; both for the message.
    Raises BadData, Missing.
    """
    pyplot = matplotlib()
    if pyplot.get_backend().lower() in WITHOUT_WINDOW:
        raise BadData(f"{what}: no window can be opened here; wanted {other}")
    return pyplot


def axes_of(ax, size=(6.4, 4.4)):
    """Return the given axes, or axes of a new figure of `size` inches if `ax` is None.

    Raises BadData, Missing.
    """
    if ax is None:
        return matplotlib().subplots(figsize=size, layout="constrained")[1]
    if not (hasattr(ax, "plot") and hasattr(ax, "imshow")):
        raise BadData(
            f"ax: {type(ax).__name__}, wanted axes of matplotlib, for example matplotlib.pyplot.gca()"
        )
    return ax


def panels(figure, rows: int, cols: int, size):
    """Return a figure with axes (rows, cols): the given one, or a new one of `size` inches."""
    if figure is None:
        figure = matplotlib().figure(figsize=size, layout="constrained")
    if not hasattr(figure, "subplots"):
        raise BadData(f"figure: {type(figure).__name__}, wanted a figure of matplotlib")
    return figure, figure.subplots(rows, cols, squeeze=False)


def is_frame(what) -> bool:
    """Return whether an object has the attributes of a frame that plots use."""
    return all(hasattr(what, name) for name in ("raw", "linear", "camera"))


def require_frame(frame, name: str):
    """Raise BadData unless `frame` is a frame; name: name of the plot for the message."""
    if not is_frame(frame):
        raise BadData(f"{name}: {type(frame).__name__}, wanted a frame")


def _remove_ticks(ax, title):
    """Remove the ticks of axes with a picture, and set its title."""
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(title, fontsize="medium")
    return ax


def image(ax, codes, title=""):
    """Draw a picture (rows, cols, 3) without ticks; small ones with sharp pixels."""
    ax.imshow(codes, interpolation="nearest" if max(codes.shape[:2]) < 256 else None)
    return _remove_ticks(ax, title)


def picture_size(shape, bar: float = 0.0) -> tuple[float, float]:
    """Return the size of a figure for a picture of (rows, cols) with a title [inch].

    bar: width for a colour bar [inch].
    """
    rows, cols = shape
    width = min(8.0, 5.0 * cols / rows)
    return max(width, 3.5) + bar, max(width * rows / cols, 1.5) + 0.5


def error_map(ax, values, title, label, **colors):
    """Draw numbers (rows, cols) as colours with a colour bar; colors: arguments of `imshow`."""
    drawn = ax.imshow(values, **colors)
    ax.figure.colorbar(drawn, ax=ax, label=label, extend="both" if colors["vmin"] < 0 else "max")
    return _remove_ticks(ax, title)


def curve(ax, x, y, color, label, first: int = 0, **options):
    """Draw a line; its dashes depend on how many lines have its colour on the axes.

    This separates the curves of several cameras. first: index in STYLES for the first line.
    """
    before = sum(line.get_color() == color for line in ax.get_lines() if len(line.get_xdata()) > 1)
    ax.plot(
        x, y, color=color, linestyle=STYLES[(first + before) % len(STYLES)], label=label, **options
    )


def legend_once(ax, label: str) -> str:
    """Return the label, or one that legends omit if they already have it."""
    return "_nolegend_" if any(line.get_label() == label for line in ax.get_lines()) else label


def widen_limit(ax, high: float) -> float:
    """Return the right limit that shows up to `high` and the earlier lines."""
    return max(high, ax.get_xlim()[1]) if ax.get_lines() else high


def finish(ax, name, title, x, y):
    """Set title, axis labels, grid and legend; axes that already have a title get no name."""
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
    """Return a colour for each letter of a mosaic."""
    others = iter(OTHERS * len(channels))
    return {letter: CHANNELS.get(letter) or next(others) for letter in channels}


def wavelength_color(nanometres: float) -> tuple:
    """Return the sRGB colour of a wavelength, readable on white; grey if it is invisible."""
    xyz = cmf().at(nanometres)
    if not xyz.sum() > 1e-4:
        return (0.4, 0.4, 0.4) if nanometres < 550 else (0.25, 0.1, 0.1)
    linear = np.maximum(DISPLAYS["srgb"].rgb_from_xyz @ xyz, 0)
    linear = linear / linear.max()
    return readable(DISPLAYS["srgb"].encode(linear))


def readable(codes) -> tuple:
    """Return a colour 0 .. 1 (3,), made dark enough for a line on white."""
    codes = np.clip(codes, 0, 1)
    return tuple(
        float(value) for value in codes * min(1.0, LIGHTEST / max(codes @ (0.3, 0.6, 0.1), 1e-9))
    )


def srgb(xyz, white=None) -> np.ndarray:
    """Return clipped sRGB codes 0 .. 1 (rows, cols, 3) of XYZ (3, rows, cols).

    white: XYZ that become the white of sRGB.
    """
    display = DISPLAYS["srgb"]
    matrix = display.rgb_from_xyz
    if white is not None:
        matrix = matrix @ adaptation(white, display.xyz_from_rgb.sum(1))
    return np.clip(
        display.encode(np.clip(np.moveaxis(np.tensordot(matrix, xyz, 1), 0, -1), 0, 1)), 0, 1
    )
