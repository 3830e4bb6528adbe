"""Pixel-integrated transfer function of any pupil, float64; the planner uses it too."""

from gpusim.optics.tables import pupil

__all__ = ["pupil"]
