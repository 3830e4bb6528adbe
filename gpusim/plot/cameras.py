"""Overview of a camera: quantum efficiency, point spread, MTF and SNR."""

from typing import Any

import numpy as np

from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.spectrum import Spectrum
from gpusim.optics.lenses import lens_of
from gpusim.plot.canvas import QUIET, axes_of, channel_colors, finish, panels
from gpusim.plot.lens import mtf, psf
from gpusim.plot.sensor import snr


def efficiency(camera: Camera, ax: Any = None) -> Any:
    """Plot the quantum efficiency of every channel and the transmission of the lens.

    Efficiency is in electrons per photon in the pixel's aperture.

    Args:
        camera: camera to plot.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type.
        Missing: if matplotlib is not installed.
    """
    sensor, optics = checked_camera(camera).sensor, camera.optics
    ax, wavelengths = axes_of(ax), sensor.qe.wavelengths
    for (letter, color), curve in zip(
        channel_colors(sensor.channels).items(), sensor.qe.values, strict=True
    ):
        ax.plot(wavelengths, curve, color=color, label=f"channel {letter}")
    through = optics.transmission if isinstance(optics.transmission, Spectrum) else None
    if through is not None or optics.transmission_at(wavelengths).max() < 1:
        ax.plot(
            wavelengths,
            optics.transmission_at(wavelengths),
            color=QUIET,
            linestyle="--",
            label="lens",
        )
    sensitive = np.flatnonzero(sensor.qe.values.max(axis=0) > 0)
    ax.set_xlim(wavelengths[sensitive[0]], wavelengths[sensitive[-1]])
    ax.set_ylim(0, 1.05 * ax.get_ylim()[1])
    return finish(
        ax, camera.name, "quantum efficiency", "wavelength [nm]", "efficiency [e⁻/photon]"
    )


def camera(camera: Camera, figure: Any = None) -> Any:
    """Plot a camera's quantum efficiency, point spread, MTF and SNR.

    Args:
        camera: camera to plot.
        figure: matplotlib figure; None makes a new one.

    Returns:
        The figure.

    Raises:
        BadData: if an argument has the wrong type.
        Missing: if matplotlib is not installed.
    """
    checked_camera(camera)
    figure, axes = panels(figure, 2, 2, (12.0, 8.0))
    efficiency(camera, axes[0, 0])
    mtf(camera, None, axes[0, 1])
    if lens_of(camera).is_pointlike:
        axes[1, 0].set_axis_off()
    else:
        letters = camera.sensor.channels
        psf(camera, letters[1] if len(letters) > 1 else letters[0], axes[1, 0])
    snr(camera, axes[1, 1])
    return figure
