"""Pixel-integrated transfer function of a diffraction-limited lens, float64; the planner reads it as well."""

from gpusim.optics.tables import airy, otf

__all__ = ["airy", "otf"]
