"""Pixel-integrated transfer function of a diffraction-limited lens, float64, as for plans."""

from gpusim.optics.tables import airy, otf

__all__ = ["airy", "otf"]
