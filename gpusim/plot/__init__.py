"""Plots of scenes, cameras and frames, one call each; matplotlib draws them (`pip install 'gpusim[plot]'`).

Most functions take `ax`, axes of matplotlib to draw on, and return them; None: those of a new figure. What is more than
one picture takes `figure` and returns it.
"""

from gpusim.plot.cameras import camera, efficiency
from gpusim.plot.errors import error, plan
from gpusim.plot.lens import mtf, psf
from gpusim.plot.light import inspect, optical_image, scene, spectra
from gpusim.plot.pictures import color_checker, colors, delta_e, picture, sfr
from gpusim.plot.sensor import noise, photon_transfer, raw, snr

__all__ = [
    "camera",
    "color_checker",
    "colors",
    "delta_e",
    "efficiency",
    "error",
    "inspect",
    "mtf",
    "noise",
    "optical_image",
    "photon_transfer",
    "picture",
    "plan",
    "psf",
    "raw",
    "scene",
    "sfr",
    "snr",
    "spectra",
]
