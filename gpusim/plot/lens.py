"""Point spread and modulation transfer functions of a lens, by wavelength and by channel."""

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import BadData, OutOfRange, UnknownName, format_value
from gpusim.domain.spectrum import Spectrum
from gpusim.measure.lens import (
    ACROSS,
    check_spread,
    lens_mtf,
    pixel_mtf,
    point_spread,
    sensed_light,
    spread_reach,
)
from gpusim.optics.lenses import lens_of
from gpusim.plot.canvas import (
    QUIET,
    axes_of,
    channel_colors,
    curve,
    finish,
    legend_once,
    panels,
    wavelength_color,
    widen_limit,
)

WAVELENGTHS = (450.0, 550.0, 650.0)  # [nm] default
POINTS = 241  # frequencies of a curve
DECADES = 4  # shown of a point spread


def mtf(
    camera: Camera,
    of: Any = None,
    ax: Any = None,
    *,
    direction: str = "across",
    place: Sequence[float] = (0.0, 0.0),
    light: str | Spectrum = "D65",
    pixel: bool = False,
    label: str = "",
) -> Any:
    """Plot the modulation transfer function of a camera's lens.

    Frequencies are on the sensor. Lateral colour, which shifts the image, is left out.

    Args:
        camera: camera to plot.
        of: wavelengths [nm] and letters of channels, one or several; None is 450, 550, 650 nm and
            every channel. A channel averages the wavelengths of the light by its quantum
            efficiency.
        ax: matplotlib axes; None makes a new figure.
        direction: "across" (along rows) or "down".
        place: field point (y, x); 1 is the frame's corner.
        light: name of an illuminant, or its relative power in energy units.
        pixel: include the pixel aperture; its own transfer function is drawn in grey.
        label: name in the legend, for several cameras on one `ax`.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or a channel does not respond to the light.
        Missing: if matplotlib is not installed.
        OutOfRange: if a wavelength or place is out of range.
        UnknownName: if the direction, a channel or an illuminant is unknown.
    """
    of, place = _check_curves(checked_camera(camera), of), _field(place)
    if direction not in ("across", "down"):
        raise UnknownName("direction", direction, ("across", "down"))
    sensor = camera.sensor
    nyquist = 0.5e-3 / sensor.pixel_pitch  # [cycle/mm]
    frequencies = np.linspace(0, _highest_frequency(camera, of, nyquist), POINTS)
    own = np.abs(pixel_mtf(camera, 1e3 * frequencies, direction))
    ax, colors = axes_of(ax), channel_colors(sensor.channels)
    right = widen_limit(ax, frequencies[-1])
    for one in of:
        response = lens_mtf(camera, one, 1e3 * frequencies, direction, place, light)
        if pixel:
            response = response * own
        name, is_channel = f"{label} {_name(one)}".strip(), isinstance(one, str)
        curve(
            ax,
            frequencies,
            response,
            colors[one] if is_channel else wavelength_color(one),
            name,
            first=is_channel,
        )
    aperture_label = f"{label} pixel aperture only".strip()
    ax.plot(frequencies, own, color=QUIET, linestyle=":", label=legend_once(ax, aperture_label))
    ax.axvline(nyquist, color=QUIET, linewidth=0.8)
    ax.text(nyquist, 1.0, " Nyquist", color="0.4", fontsize="small", va="top", clip_on=True)
    ax.set_xlim(0, right)
    ax.set_ylim(0, 1.05)
    parts = "lens and pixel" if pixel else "lens"
    at = "" if not any(place) else f" at field ({place[0]:g}, {place[1]:g})"
    return finish(
        ax,
        f"{camera.name}, f/{camera.optics.f_number:g}",
        f"MTF of the {parts}, {direction}{at}",
        "frequency on the sensor [cycle/mm]",
        "modulation transfer",
    )


def psf(
    camera: Camera,
    of: Any = None,
    ax: Any = None,
    *,
    place: Sequence[float] = (0.0, 0.0),
    light: str | Spectrum = "D65",
    figure: Any = None,
) -> Any:
    """Plot the point spread function of a camera's lens, in decades below its peak.

    The outline of the pixel's aperture is drawn in it.

    Args:
        camera: camera to plot.
        of: wavelengths and channels, see `mtf`.
        ax: matplotlib axes for one wavelength or channel; None makes a new figure.
        place: field point, see `mtf`.
        light: illuminant, see `mtf`.
        figure: matplotlib figure for several pictures next to each other; None makes a new one.

    Returns:
        The axes of one picture, the figure of several.

    Raises:
        BadData: if the camera has no lens (`optics.model = "none"`), or an argument has the wrong
            type.
        Missing: if matplotlib is not installed.
        OutOfRange: if a wavelength or place is out of range.
        UnknownName: if a channel or an illuminant is unknown.
    """
    several = of is None or isinstance(of, (list, tuple, np.ndarray))
    of, place = _check_curves(checked_camera(camera), of), _field(place)
    check_spread(camera)
    if several and ax is not None:
        raise BadData(
            f"psf: {len(of)} pictures on one ax; use figure =, or of = one wavelength or channel"
        )
    if not several:
        energy, step = point_spread(camera, of[0], place, light)
        drawn = _spread(
            camera,
            energy,
            step,
            axes_of(ax, (4.8, 4.0)),
            f"{camera.name}: point spread, {_name(of[0])}, f/{camera.optics.f_number:g}",
        )
        drawn.axes.figure.colorbar(drawn, ax=drawn.axes, label="irradiance relative to the peak")
        return drawn.axes
    cols = min(len(of), 3)
    rows = -(-len(of) // cols)
    figure, axes = panels(figure, rows, cols, (3.2 * cols + 1, 3.0 * rows + 0.4))
    lights = [sensed_light(camera, one, light) for one in of]
    reach = max(spread_reach(camera, nodes, place) for nodes, _ in lights)
    known: dict = {}  # channels share their wavelengths
    for one, (nodes, weights), ax in zip(of, lights, axes.flat, strict=False):
        if tuple(nodes) not in known:
            known[tuple(nodes)] = lens_of(camera).sampled_spread(nodes, place, reach, ACROSS)
        energy, step = known[tuple(nodes)]
        drawn = _spread(camera, np.tensordot(weights, energy, 1), step, ax, _name(one))
    for ax in axes.flat[len(of) :]:
        ax.set_axis_off()
    figure.colorbar(drawn, ax=axes, label="irradiance relative to the peak", shrink=0.8)
    figure.suptitle(
        f"{camera.name}: point spread of the lens, f/{camera.optics.f_number:g}", fontsize="medium"
    )
    return figure


def _spread(camera, energy, step, ax, title):
    """Draw a point spread with the outline of the pixel's aperture."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Rectangle

    half = 1e6 * step / 2 * np.array(energy.shape)  # [um]
    extent = (-half[1], half[1], half[0], -half[0])
    drawn = ax.imshow(
        np.maximum(energy / energy.max(), 10.0**-DECADES),
        norm=LogNorm(10.0**-DECADES, 1),
        cmap="magma",
        extent=extent,
        interpolation="nearest",
    )
    height, width = (1e6 * side for side in camera.sensor.aperture)
    ax.add_patch(
        Rectangle(
            (-width / 2, -height / 2), width, height, fill=False, edgecolor="w", linewidth=0.8
        )
    )
    ax.set_title(title, fontsize="medium")
    ax.set_xlabel("[µm]")
    ax.set_ylabel("[µm]")
    return drawn


def _check_curves(camera, of):
    """Return wavelengths and letters of channels as a checked list."""
    channels = camera.sensor.channels
    if of is None:
        return [*WAVELENGTHS, *channels]
    found = list(of) if isinstance(of, (list, tuple, np.ndarray)) else [of]
    for one in found:
        if isinstance(one, str):
            if one not in channels:
                raise UnknownName("channel", one, channels)
        elif not (isinstance(one, Real) and 10 <= one <= 1e5):
            raise OutOfRange("of", one, "wavelengths within 10 .. 1e5 nm, or letters of channels")
    if not found:
        raise BadData("of: nothing to draw; wanted wavelengths [nm] or letters of channels")
    return found


def _field(place):
    """Return a checked field point (y, x)."""
    try:
        y, x = (float(one) for one in place)
    except (TypeError, ValueError):
        raise BadData(
            f"place = {format_value(place)}: wanted a field point (y, x), 1 the frame's corner"
        ) from None
    if not np.hypot(y, x) <= 1 + 1e-9:
        raise OutOfRange("place", (y, x), "up to 1, the frame's corner, from the axis")
    return y, x


def _name(one):
    """Return the name of a wavelength or channel in the plot."""
    return f"channel {one}" if isinstance(one, str) else f"{one:g} nm"


def _highest_frequency(camera, of, nyquist):
    """Return the highest frequency drawn [cycle/mm]: the lens's cut-off, at most 3 Nyquist."""
    shortest = min([one for one in of if not isinstance(one, str)] or [WAVELENGTHS[0]])
    return min(1e-3 * lens_of(camera).cutoff(shortest), 3 * nyquist)
