"""Plots of scenes, cameras and frames, one call each; matplotlib draws them (`pip install 'gpusim[plot]'`).

Every function takes `ax`, axes of matplotlib to draw on, and returns them; None: those of a new figure.
"""

from gpusim.plot.lens import mtf, psf
from gpusim.plot.light import scene
from gpusim.plot.pictures import sfr
from gpusim.plot.sensor import raw, snr

__all__ = ["mtf", "psf", "raw", "scene", "sfr", "snr"]
