"""What a lens does to a point and to contrast: point spreads and transfer functions, by wavelength and by channel."""

from numbers import Real
from typing import Any

import numpy as np

from gpusim.data.lights import light_of
from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import BadData, OutOfRange, UnknownName, shown
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.optics.lens import lens_of
from gpusim.optics.weights import product_weights
from gpusim.plot.canvas import (
    QUIET,
    axes_of,
    channel_colors,
    curve,
    finish,
    legend_once,
    panels,
    wavelength_color,
    widened,
)

WAVELENGTHS = (450.0, 550.0, 650.0)  # [nm] drawn where none are named
STEP = 20.0  # [nm] between the wavelengths that stand for a channel's
POINTS = 241  # frequencies of a curve
ACROSS = 161  # samples along a point spread's picture
RINGS = 5.0  # Airy radii around the middle of it
DECADES = 4  # of a point spread's picture


def mtf(
    camera: Camera,
    of=None,
    ax=None,
    *,
    direction: str = "across",
    place=(0.0, 0.0),
    light="D65",
    pixel: bool = False,
    label: str = "",
) -> Any:
    """Modulation transfer of a camera's lens against the frequency on the sensor.

    of: wavelengths [nm] and letters of channels, one or several; None: 450, 550, 650 nm and every channel. A channel
    sees the light (an illuminant's name, or a relative power in energy units) by its quantum efficiency.
    direction: "across" (along rows) or "down". place: field point (y, x), 1 the frame's corner; lateral colour, which
    moves the image, is left out. pixel: of lens and pixel aperture together; the aperture's own is drawn in grey.
    label: what the legend names it by, where several cameras are drawn on one `ax`.
    Returns the axes. Raises BadData, Missing, OutOfRange, UnknownName.
    """
    of, place = _asked(checked_camera(camera), of), _field(place)
    if direction not in ("across", "down"):
        raise UnknownName("direction", direction, ("across", "down"))
    sensor, lens = camera.sensor, lens_of(camera)
    aperture = sensor.aperture[direction == "across"]
    nyquist = 0.5e-3 / sensor.pixel_pitch  # [cycle/mm]
    frequencies = np.linspace(0, _most(camera, of, nyquist), POINTS)
    own = np.sinc(1e3 * frequencies * aperture)
    fy, fx = (0.0, 1e3 * frequencies) if direction == "across" else (1e3 * frequencies, 0.0)
    ax, colors = axes_of(ax), channel_colors(sensor.channels)
    right = widened(ax, frequencies[-1])
    for one in of:
        nodes, weights = _light_of(camera, one, light)
        response = np.abs(weights @ lens.transfer(nodes, fy, fx, place)) * (
            np.abs(own) if pixel else 1
        )
        name, is_channel = f"{label} {_name(one)}".strip(), isinstance(one, str)
        curve(
            ax,
            frequencies,
            response,
            colors[one] if is_channel else wavelength_color(one),
            name,
            first=is_channel,
        )
    alone = f"{label} pixel aperture alone".strip()
    ax.plot(frequencies, np.abs(own), color=QUIET, linestyle=":", label=legend_once(ax, alone))
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


def psf(camera: Camera, of=None, ax=None, *, place=(0.0, 0.0), light="D65", figure=None) -> Any:
    """Point spread of a camera's lens as a picture in decades below its peak, the pixel's aperture drawn in it.

    of, place, light: see `mtf`. One wavelength or channel is drawn on `ax`; several, each beside the other, on `figure`
    or on a new one. Returns the axes or the figure. Raises BadData (the lens does not blur), Missing,
    OutOfRange, UnknownName.
    """
    several = of is None or isinstance(of, (list, tuple, np.ndarray))
    of, place = _asked(checked_camera(camera), of), _field(place)
    if lens_of(camera).is_pointlike:
        raise BadData(
            f'psf: {camera.name} has model = "none" in [optics], no lens that blurs; wanted another'
        )
    if several and ax is not None:
        raise BadData(
            f"psf: {len(of)} pictures on one ax; wanted figure =, or of = one wavelength or channel"
        )
    if not several:
        nodes, weights = _light_of(camera, of[0], light)
        reach = _reach(camera, nodes, place)
        energy, step = lens_of(camera).sampled_spread(nodes, place, reach, ACROSS)
        drawn = _spread(
            camera,
            np.tensordot(weights, energy, 1),
            step,
            axes_of(ax, (4.8, 4.0)),
            f"{camera.name}: point spread, {_name(of[0])}, f/{camera.optics.f_number:g}",
        )
        drawn.axes.figure.colorbar(drawn, ax=drawn.axes, label="irradiance over that of the peak")
        return drawn.axes
    cols = min(len(of), 3)
    rows = -(-len(of) // cols)
    figure, axes = panels(figure, rows, cols, (3.2 * cols + 1, 3.0 * rows + 0.4))
    lights = [_light_of(camera, one, light) for one in of]
    reach = max(_reach(camera, nodes, place) for nodes, _ in lights)
    known: dict = {}  # channels share their wavelengths
    for one, (nodes, weights), ax in zip(of, lights, axes.flat, strict=False):
        if tuple(nodes) not in known:
            known[tuple(nodes)] = lens_of(camera).sampled_spread(nodes, place, reach, ACROSS)
        energy, step = known[tuple(nodes)]
        drawn = _spread(camera, np.tensordot(weights, energy, 1), step, ax, _name(one))
    for ax in axes.flat[len(of) :]:
        ax.set_axis_off()
    figure.colorbar(drawn, ax=axes, label="irradiance over that of the peak", shrink=0.8)
    figure.suptitle(
        f"{camera.name}: point spread of the lens, f/{camera.optics.f_number:g}", fontsize="medium"
    )
    return figure


def _spread(camera, energy, step, ax, title):
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


def _reach(camera, wavelengths, place):
    """How far from its middle a point spread is drawn [m]."""
    optics, pitch = camera.optics, camera.sensor.pixel_pitch
    rays = pitch * lens_of(camera).spread(wavelengths, float(np.hypot(*place)))
    return max(RINGS * float(optics.airy_radius(max(wavelengths))), 0.75 * pitch, 1.5 * rays)


def _asked(camera, of):
    """Wavelengths and letters, checked."""
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
    """A field point, checked."""
    try:
        y, x = (float(one) for one in place)
    except (TypeError, ValueError):
        raise BadData(
            f"place = {shown(place)}: wanted a field point (y, x), 1 the frame's corner"
        ) from None
    if not np.hypot(y, x) <= 1 + 1e-9:
        raise OutOfRange("place", (y, x), "up to 1, the frame's corner, from the axis")
    return y, x


def _light_of(camera, one, light):
    """Wavelengths [nm] of a channel's light on the sensor, and their shares; of a wavelength, itself."""
    if not isinstance(one, str):
        return np.array([float(one)]), np.ones(1)
    sensor, (shortest, longest) = camera.sensor, lens_of(camera).wavelengths
    light = photons_from_energy(light_of(light))
    low = max(sensor.qe.wavelengths[0], light.wavelengths[0], shortest)
    high = min(sensor.qe.wavelengths[-1], light.wavelengths[-1], longest)
    if not low < high:
        raise BadData(f"channel {one}: sees nothing of the light {light.name} through the lens")
    nodes = np.linspace(low, high, int(np.ceil((high - low) / STEP)) + 1)
    number = sensor.channels.index(one)
    curve = Spectrum(sensor.qe.wavelengths, sensor.qe.values[number])
    through = camera.optics.transmission
    weights = product_weights(
        nodes, light, curve, *([through] if isinstance(through, Spectrum) else [])
    )
    if not weights.sum() > 0:
        raise BadData(f"channel {one}: sees nothing of the light {light.name} through the lens")
    return nodes, weights / weights.sum()


def _name(one):
    return f"channel {one}" if isinstance(one, str) else f"{one:g} nm"


def _most(camera, of, nyquist):
    """Highest frequency drawn [cycle/mm]: the lens's cut-off where it has one, three times Nyquist at most."""
    shortest = min([one for one in of if not isinstance(one, str)] or [WAVELENGTHS[0]])
    return min(1e-3 * lens_of(camera).cutoff(shortest), 3 * nyquist)
