"""Plots of scenes, cameras and frames with matplotlib (`pip install 'gpusim[plot]'`).

Most functions take `ax`, matplotlib axes to draw on, and return them; None makes a new figure.
Functions that draw several pictures take `figure` and return it.
"""

from gpusim.plot.cameras import camera, efficiency
from gpusim.plot.errors import error, plan
from gpusim.plot.files import save_figures
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
    "save_figures",
    "scene",
    "sfr",
    "snr",
    "spectra",
]
