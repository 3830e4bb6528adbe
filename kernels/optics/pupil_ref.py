"""Pixel-integrated transfer function of any pupil, float64; the planner reads it as well."""

from gpusim.optics.tables import pupil

__all__ = ["pupil"]
